"""An arm that stays connected: home, move, follow a path, gripper, state, stop."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._arrays import Doubles, to_bytes
from ._bus import Bus
from ._robot import Robot, source_of


@dataclass(frozen=True)
class Moved:
    """A motion that has ended where it should."""

    #: Duration of the motion, s; 0 if the arm was there.
    duration_s: float
    #: Planned angles at the end, rad.
    q_rad: Doubles
    #: Largest distance of a joint from the motion, and from its end at the end, rad; ``None`` if too few samples were heard.
    off_rad: float | None
    end_off_rad: float | None
    #: The same in words.
    text: str


@dataclass(frozen=True)
class ArmState:
    """What the controller reports."""

    #: ``idle``, ``ready``, ``stopped``, ``fault`` and others.
    state: str
    #: Number of the latched fault, as ``cubectl explain`` knows it.
    fault: int | None
    homed: NDArray[np.bool_]
    #: Measured angles, rad; ``None`` while the controller knows no drives or is in a fault.
    q_rad: Doubles | None


class Gripper:
    """The gripper of an arm."""

    def __init__(self, native: _native.Arm) -> None:
        self._native = native

    def open(self) -> None:
        """Opens it."""
        self._native.gripper(True)

    def close(self) -> None:
        """Closes it."""
        self._native.gripper(False)


@dataclass(frozen=True)
class ServoState:
    """The newest state that a stream has sent to the arm; the arm is there 80 ms later."""

    #: Since the begin of the stream, s.
    t_s: float
    q_rad: Doubles
    qd_rad_s: Doubles
    #: What keeps the arm from what it was asked for; ``None``: nothing.
    limited: str | None
    #: Commands that could not be followed, such as a place out of reach, and why the last one.
    refused: int
    last_refused: str | None


class Servo:
    """A stream of commands, from :meth:`Arm.servo`: a context manager.

    Each command holds until the next one, or until ``hold_s`` is over. After the block, ``result`` has what became of the stream, under
    the names of ``cubectl servo --json``.
    """

    def __init__(self, native: _native.Stream) -> None:
        self._native = native
        #: What became of the stream; ``None`` while it is under way.
        self.result: dict[str, Any] | None = None

    def joints(self, q_rad: ArrayLike) -> None:
        """To these angles, rad."""
        self._send("q_rad", q_rad)

    def speeds(self, qd_rad_s: ArrayLike) -> None:
        """With these joint speeds, rad/s."""
        self._send("qd_rad_s", qd_rad_s)

    def hand(self, to: ArrayLike) -> None:
        """The hand to x, y, z in m, base frame, or with roll, pitch, yaw in rad."""
        place = np.asarray(to, dtype=np.float64)
        self._send("pose_m_rad" if place.shape == (6,) else "point_m", place)

    def twist(self, speed: ArrayLike) -> None:
        """The hand with vx, vy, vz in m/s and wx, wy, wz in rad/s, base frame."""
        self._send("twist_m_s_rad_s", speed)

    def wait(self, span_s: float) -> ServoState:
        """Lets time pass, and gives the newest state. The time of a simulated cell passes in no other way."""
        self._native.wait(float(span_s))
        return self.state

    @property
    def state(self) -> ServoState:
        """The newest state; before the first tick it is empty."""
        text = self._native.state()
        if not text:
            nothing = np.empty(0)
            return ServoState(0.0, nothing, nothing, None, 0, None)
        state = json.loads(text)
        q_rad, qd_rad_s = np.array(state["q_rad"]), np.array(state["qd_rad_s"])
        return ServoState(**{**state, "q_rad": q_rad, "qd_rad_s": qd_rad_s})

    def end(self) -> dict[str, Any]:
        """The arm comes to rest, and the stream is over. A stop, or a fault on the way, raises."""
        if self.result is None:
            self.result = json.loads(self._native.end())
        return self.result

    def __enter__(self) -> Servo:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()

    def _send(self, key: str, numbers: ArrayLike) -> None:
        values = np.asarray(numbers, dtype=np.float64).tolist()
        self._native.send(json.dumps({key: values}))


class Arm:
    """A connected arm, from :func:`connect`. Each call returns when the arm stands.

    Calls of several threads are done one after the other; :meth:`stop` interrupts the one at work. What does not end as it should
    raises :class:`CubecellError` with the message and exit code of ``cubectl``. Ctrl-C brings the arm to rest along its path and then
    raises ``KeyboardInterrupt``. The end of a ``with`` block ends the connection; if a motion is at work, or an exception ends the
    block, the arm is stopped first.
    """

    def __init__(self, native: _native.Arm) -> None:
        self._native = native
        self.gripper = Gripper(native)

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self._native.joints

    @property
    def progress(self) -> str:
        """The step at work, such as ``home`` or ``run``; empty between calls. For other threads."""
        return self._native.progress()

    def home(self) -> Doubles:
        """Lets joints without a zero find it; the measured angles, rad."""
        return np.array(json.loads(self._native.home())["q_rad"], dtype=np.float64)

    def move(
        self,
        joints: ArrayLike | None = None,
        *,
        by: Mapping[int, float] | None = None,
        to: ArrayLike | None = None,
        straight: bool = False,
        speed_share: float = 0.2,
        obstacles: Sequence[Sequence[float]] = (),
        ball: bool = False,
        way_seed: int = 1,
    ) -> Moved:
        """Goes around itself, the floor and ``obstacles`` (centre and half edges, m), as ``cubectl move`` does.

        ``joints``: angles, rad, base first. ``by``: joints, numbered from 1, turned by angles, rad. ``to``: x, y, z of the hand in m,
        base frame, or with roll, pitch, yaw in rad; with ``straight`` on a straight line. One of the three.
        """
        if sum(goal is not None for goal in (joints, by, to)) != 1:
            raise ValueError("give one of joints, by and to")
        if straight and to is None:
            raise ValueError("straight is for to")
        how = _how(speed_share, way_seed, obstacles, ball)
        if joints is not None:
            text = self._native.move_joints(to_bytes(np.asarray(joints, dtype=np.float64)), how)
        elif by is not None:
            if any(joint < 1 for joint in by):
                raise ValueError("joints are numbered from 1")
            text = self._native.move_by([(joint - 1, float(angle)) for joint, angle in by.items()], how)
        else:
            text = self._native.move_hand(to_bytes(np.asarray(to, dtype=np.float64)), straight, how)
        return _moved(text)

    def run(
        self,
        q_rad: ArrayLike,
        t_s: ArrayLike | None = None,
        *,
        speed_share: float = 0.3,
        blend_rad: float = 0.02,
        obstacles: Sequence[Sequence[float]] = (),
        ball: bool = False,
        way_seed: int = 1,
    ) -> Moved:
        """Follows rows of joint angles, rad, after a way to the first one.

        With ``t_s`` at these times, or refused with joint, time, value and limit; else as fast as ``speed_share`` of the limits allows,
        at most ``blend_rad`` beside a row.
        """
        rows = np.asarray(q_rad, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.joints:
            raise ValueError(f"rows of {self.joints} angles are needed, not an array of shape {rows.shape}")
        times = None if t_s is None else np.asarray(t_s, dtype=np.float64)
        if times is not None and times.shape != rows.shape[:1]:
            raise ValueError(f"{rows.shape[0]} rows need as many times, not an array of shape {times.shape}")
        how = _how(speed_share, way_seed, obstacles, ball)
        at = None if times is None else to_bytes(times)
        return _moved(self._native.run(at, to_bytes(rows), float(blend_rad), how))

    def servo(
        self,
        *,
        speed_share: float = 0.2,
        hold_s: float = 0.2,
        obstacles: Sequence[Sequence[float]] = (),
        ball: bool = False,
    ) -> Servo:
        """Follows commands as they come, 10 to 200 a second, as ``cubectl servo`` does; the arm must be homed.

        Whatever is asked for, it keeps a share of its speeds, accelerations and jerks, its joint ranges, and 10 mm from itself, the
        floor and ``obstacles``. It comes to rest at the end of the ``with`` block, and when no command has come for ``hold_s``. Other
        calls of the arm wait for the end; :meth:`stop` ends it.
        """
        if not (0.0 < hold_s < 60.0):
            raise ValueError("hold_s is above 0 and below 60")
        return Servo(_native.servo(self._native, _how(speed_share, 1, obstacles, ball), float(hold_s)))

    def state(self) -> ArmState:
        """What the controller reports now."""
        reported = json.loads(self._native.state())
        q_rad = reported["q_rad"]
        return ArmState(
            state=reported["state"],
            fault=reported["fault"],
            homed=np.array(reported["homed"], dtype=np.bool_),
            q_rad=None if q_rad is None else np.array(q_rad, dtype=np.float64),
        )

    def stop(self) -> None:
        """Brings the arm to rest along its path. The call at work, in another thread, raises; the next motion ends the stop."""
        self._native.stop()

    def clear(self) -> None:
        """Clears the latched fault; nothing moves."""
        self._native.clear()

    def close(self) -> None:
        """Ends the connection, after the call at work."""
        self._native.close()

    def __enter__(self) -> Arm:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is not None or self.progress:
                self.stop()
        finally:
            self.close()


def connect(
    bus: str = "sim",
    *,
    robot: Robot | str | os.PathLike[str] | None = None,
    may_move: bool = False,
    seed: int | None = None,
    scenario: str | os.PathLike[str] | None = None,
    controller: int | None = None,
    key_file: str | os.PathLike[str] | None = None,
    record: str | os.PathLike[str] | None = None,
    rsi: str | os.PathLike[str] | None = None,
) -> Arm:
    """Connects to the arm on a bus; ``sim`` is a simulated cell that stays until the connection is closed.

    On every other bus a controller must be there, and ``may_move=True`` says that nobody is near: a program cannot ask. ``record``
    keeps every frame in ``record.log`` and ``record.mcap``. ``rsi:udp://HOST:PORT`` leads an industrial robot, whose program ``rsi``
    describes, from where its program begins; it is answered until the connection is closed. After a stop connect again.

        >>> import cubecell
        >>> with cubecell.connect() as arm:
        ...     q = arm.home()
        ...     moved = arm.move(to=[0.5, 0.0, 0.5])
        >>> moved.off_rad < 0.01
        True
    """
    if bus != "sim" and not may_move:
        raise ValueError("this arm may be real: connect with may_move=True once nobody is near")
    connection: dict[str, Any] = {
        "bus": Bus(bus, robot, seed, scenario)._joined(),
        "controller": controller,
        "key_file": None if key_file is None else os.fspath(key_file),
        "record": None if record is None else os.fspath(record),
        "rsi": None if rsi is None else os.fspath(rsi),
    }
    return Arm(_native.Arm(connection))


def _how(speed_share: float, way_seed: int, obstacles: Sequence[Sequence[float]], ball: bool) -> dict[str, Any]:
    boxes = [[float(value) for value in box] for box in obstacles]
    if any(len(box) != 6 for box in boxes):
        raise ValueError("an obstacle has six numbers: its centre and its half edges")
    return {"speed_share": float(speed_share), "seed": int(way_seed), "obstacles": boxes, "ball": ball}


def _moved(text: str) -> Moved:
    moved = json.loads(text)
    return Moved(**{**moved, "q_rad": np.array(moved["q_rad"], dtype=np.float64)})
