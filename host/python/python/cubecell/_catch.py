"""Catches of balls and discs in flight."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._arrays import Doubles, to_point
from ._motion import Motion
from ._request import BallOptions, DiscOptions, request
from ._robot import Robot, source_of


def _rows(values: Any) -> Doubles:
    return np.array(values, dtype=np.float64)


def _motion(data: dict[str, Any] | None) -> Motion | None:
    return None if data is None else Motion(**{name: _rows(values) for name, values in data.items()})


@dataclass(frozen=True)
class Crossing:
    """How the ball crossed the plane of the mouth of the cup."""

    #: Distance from the axis of the cup, m.
    miss_m: float
    #: Angle to the axis, rad.
    angle_rad: float
    #: Speed against the cup, m/s.
    speed_m_s: float


@dataclass(frozen=True)
class BallChoice:
    """The catch that the catcher chose last."""

    #: ``matched``: the hand moves with the ball. ``hold``: it stands.
    mode: str
    #: When the ball is at the middle of the mouth, in s after the release.
    after_release_s: float
    #: Middle of the mouth then, m, in the world of the cell.
    p_m: Doubles
    #: Direction of the cup.
    axis: Doubles
    #: Joints at the catch.
    q_rad: Doubles
    qd_rad_s: Doubles
    #: Predicted probability of the catch.
    probability: float
    #: Largest share of an acceleration limit that the motion uses.
    used: float
    #: Ball against hand at the catch, m/s.
    relative_m_s: float
    #: The motion with its stop; times in s after the release.
    motion: Motion = field(repr=False)


@dataclass(frozen=True)
class Decisions:
    """What came of each forecast of the flight: one row per forecast; ``nan`` where nothing was foreseen."""

    after_release_s: Doubles
    decision: NDArray[np.str_]
    #: Predicted probability of the catch under way.
    probability: Doubles
    #: Standard deviation of the foreseen ball across its flight at the catch, m.
    sigma_m: Doubles
    #: Foreseen distance of the ball from the axis of the cup at the catch, m.
    off_m: Doubles
    #: Candidates that were judged.
    judged: NDArray[np.int64]


@dataclass(frozen=True)
class Trace:
    """Where things were in the trial: one row per time, in the world of the cell."""

    after_release_s: Doubles
    ball_m: Doubles
    #: Middle of the mouth of the cup.
    mouth_m: Doubles
    #: Joints of the catcher.
    q_rad: Doubles


@dataclass(frozen=True)
class BallCatch:
    """One trial in the simulated cell."""

    #: What the catcher reports, from what its tracker saw: ``caught``, ``missed``, ``declined: ...`` and so on.
    reported: str
    #: Whether the ball lay in the cup at the end: the word of the witness, which the catcher cannot see.
    caught: bool
    #: The exit code of ``cubectl catch``, and its text.
    exit_code: int
    text: str
    crossing: Crossing | None
    choice: BallChoice | None
    decisions: Decisions = field(repr=False)
    trace: Trace = field(repr=False)
    #: What the cell saw, in order: ``after_release_s``, ``event`` and, where it applies, ``arm``, ``speed_m_s``, ``part``.
    events: list[dict[str, Any]] = field(repr=False)
    #: Pose of the catcher's base in the world of the cell, 4 x 4.
    base: Doubles = field(repr=False)
    #: Largest shares of the limits that were used, planned and executed.
    limits: dict[str, Any] = field(repr=False)
    #: No limit was passed, and the arms did not touch.
    within_limits: bool
    #: Why the arm refused motions, in words.
    refusals: list[str] = field(repr=False)


def catch_ball(
    position_m: ArrayLike,
    velocity_m_s: ArrayLike,
    *,
    robot: Robot | str | os.PathLike[str] = "powercube6",
    step_s: float = 0.005,
    **options: Unpack[BallOptions],
) -> BallCatch:
    """Lets an arm with a cup catch a ball, as ``cubectl catch --ball`` does: one trial in the simulated cell, in virtual time.

    The ball starts at ``position_m`` with ``velocity_m_s`` in the base frame of the arm. A simulated tracker sees it; each forecast
    may change the motion under way. Whether it is caught is decided by the simulated contact of ball and cup. The same seed gives the
    same trial. ``step_s`` is the step of the table of the motion.

    A ball that is missed or declined is a result, not an exception; :class:`CubecellError` is raised if something is refused.
    """
    numbers = [*to_point(position_m, "a position"), *to_point(velocity_m_s, "a velocity")]
    data = json.loads(_native.catch_ball(request(options, robot=source_of(robot), ball=numbers), float(step_s)))
    choice, motion, crossing = data["choice"], _motion(data["motion"]), data["crossing"]
    if choice is not None:
        for name in ("p_m", "axis", "q_rad", "qd_rad_s"):
            choice[name] = _rows(choice[name])

    def column(name: str) -> list[Any]:
        return [decision[name] for decision in data["decisions"]]

    return BallCatch(
        reported=data["reported"],
        caught=data["caught"],
        exit_code=data["exit_code"],
        text=data["text"],
        crossing=None if crossing is None else Crossing(**crossing),
        choice=None if choice is None or motion is None else BallChoice(**choice, motion=motion),
        decisions=Decisions(
            after_release_s=_rows(column("after_release_s")),
            decision=np.array(column("decision"), dtype=np.str_),
            probability=_rows(column("probability")),
            sigma_m=_rows(column("sigma_m")),
            off_m=_rows(column("off_m")),
            judged=np.array(column("judged"), dtype=np.int64),
        ),
        trace=Trace(
            after_release_s=_rows(data["trace"]["t_s"]),
            ball_m=_rows(data["trace"]["ball_m"]).reshape(-1, 3),
            mouth_m=_rows(data["trace"]["mouth_m"]).reshape(-1, 3),
            q_rad=_rows(data["trace"]["q_rad"]).reshape(-1, 6),
        ),
        events=data["events"],
        base=_rows(data["x_wb"]),
        limits=data["limits"],
        within_limits=data["within_limits"],
        refusals=data["refusals"],
    )


@dataclass(frozen=True)
class DiscWitness:
    """What the geometry of disc and gripper says, whatever the catcher claims."""

    caught: bool
    #: First body of the arm that the disc touched, and when; ``None`` for none.
    touched: dict[str, Any] | None
    #: The disc in the gripper where it was caught, or nearest to it: time, depth, height, tilt, distances.
    seen: dict[str, float] | None
    #: Smallest distance of disc and arm before the catch, m.
    clearance_m: float | None
    #: Largest speeds and accelerations of the joints.
    speed_rad_s: Doubles
    acceleration_rad_s2: Doubles


@dataclass(frozen=True)
class DiscRule:
    """The rule of the paper, which knows no joint limits, in steps of 10 ms."""

    #: Step at which the disc is in reach, and at which it is captured; ``None`` if it never is.
    in_reach_step: int | None
    captured_step: int | None
    #: Joint speeds that the rule demands.
    speed_demanded_rad_s: Doubles
    #: How far the hand is from the disc in the last step, m.
    short_m: float | None
    witness: DiscWitness


@dataclass(frozen=True)
class DiscPlan:
    """A catch within the limits of the joints."""

    #: When the disc is caught, in s since the start of its flight.
    t_s: float
    #: Depth of the tip inside the rim, m.
    depth_m: float
    #: From when to when the arm waits on its way.
    waits_s: tuple[float, float]
    #: Joints at the catch.
    q_rad: Doubles
    qd_rad_s: Doubles
    #: Disc against hand at the catch, m/s: along, up, across.
    relative_m_s: Doubles
    #: Largest shares of the limits of speed and acceleration.
    speed_use: float
    acceleration_use: float
    witness: DiscWitness
    #: The motion; times in s since the start of the flight.
    motion: Motion = field(repr=False)


@dataclass(frozen=True)
class DiscFlight:
    """The flight of the disc: one row per time."""

    t_s: Doubles
    position_m: Doubles
    velocity_m_s: Doubles
    #: Normal of the disc.
    normal: Doubles


@dataclass(frozen=True)
class DiscCatch:
    """A flight of a disc, and what the rule of the paper and the plan within the limits make of it."""

    #: The exit code of ``cubectl catch``, and its text.
    exit_code: int
    text: str
    #: The rule of the paper; ``None`` in air, for which the paper has none.
    rule: DiscRule | None
    #: The catch within the limits; ``None`` if there is none or none was asked for.
    plan: DiscPlan | None
    #: Why there is no catch within the limits.
    declined: str | None
    flight: DiscFlight = field(repr=False)


def _witness(data: dict[str, Any]) -> DiscWitness:
    for name in ("speed_rad_s", "acceleration_rad_s2"):
        data[name] = _rows(data[name])
    return DiscWitness(**data)


def catch_disc(
    position_m: ArrayLike,
    velocity_m_s: ArrayLike,
    *,
    robot: Robot | str | os.PathLike[str] = "pincher4",
    step_s: float = 0.005,
    **options: Unpack[DiscOptions],
) -> DiscCatch:
    """Plans the catch of a disc in flight with an arm of four joints, as ``cubectl catch --start --velocity`` does.

    The disc starts at ``position_m`` with ``velocity_m_s`` in the base frame of the arm, on a parabola or, with ``air``, with lift and
    drag of a disc that spins. ``step_s`` is the step of the tables. The geometry of disc and gripper judges rule and plan.

    A disc that cannot be caught is a result, not an exception; :class:`CubecellError` is raised if something is refused.
    """
    start, velocity = to_point(position_m, "a position"), to_point(velocity_m_s, "a velocity")
    fields = request(options, robot=source_of(robot), start=start, velocity=velocity)
    data = json.loads(_native.catch_disc(fields, float(step_s)))
    rule, plan, motion = data["rule"], data["plan"], _motion(data["motion"])
    if rule is not None:
        rule["speed_demanded_rad_s"] = _rows(rule["speed_demanded_rad_s"])
        rule["witness"] = _witness(rule["witness"])
    declined = None if plan is None else plan.get("declined")
    found = None
    if plan is not None and declined is None and motion is not None:
        for name in ("q_rad", "qd_rad_s", "relative_m_s"):
            plan[name] = _rows(plan[name])
        plan["waits_s"] = (plan["waits_s"][0], plan["waits_s"][1])
        plan["witness"] = _witness(plan["witness"])
        found = DiscPlan(**plan, motion=motion)
    return DiscCatch(
        exit_code=data["exit_code"],
        text=data["text"],
        rule=None if rule is None else DiscRule(**rule),
        plan=found,
        declined=declined,
        flight=DiscFlight(**{name: _rows(values) for name, values in data["flight"].items()}),
    )
