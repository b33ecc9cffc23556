"""Ways of an arm between bodies, without an arm: contact, search and times."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._arrays import Doubles, to_bytes
from ._motion import Motion, sampled
from ._robot import Robot


@dataclass(frozen=True)
class Way:
    """A motion from rest to rest: cubics between knots."""

    #: The plan file, which ``cubectl run`` takes.
    json: str
    #: When the arm is at each knot, s.
    t_s: Doubles = field(init=False, repr=False, compare=False)
    #: Joint angles at the knots, rad.
    q_rad: Doubles = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        knots = json.loads(self.json)["motion"]["knots"]
        for name in ("t_s", "q_rad"):
            object.__setattr__(self, name, np.array([knot[name] for knot in knots], dtype=np.float64))

    @property
    def duration_s(self) -> float:
        """How long it takes, s."""
        return float(self.t_s[-1])

    def sample(self, t_s: ArrayLike | None = None, step_s: float = 0.005) -> Motion:
        """The motion at times in s, by default from start to end in steps."""
        return sampled(self.json, self.duration_s, t_s, step_s)


class Surroundings:
    """A robot, its floor, and boxes that nothing may touch: centre and half edges, m, base frame; ``ball``: the hand holds the ball.

    >>> import cubecell
    >>> robot = cubecell.Robot("powercube6")
    >>> post = cubecell.Surroundings(robot, [[0.45, 0.0, 0.5, 0.05, 0.05, 0.2]])
    >>> way = post.way([-1.0, -1.0, -1.4, 0.0, 0.5, 0.0], [1.0, -1.0, -1.4, 0.0, 0.5, 0.0])
    >>> bool(post.contacts(way.sample().q_rad).any())
    False
    """

    def __init__(self, robot: Robot, obstacles: Sequence[Sequence[float]] = (), ball: bool = False) -> None:
        self._robot = robot
        boxes = [[float(value) for value in box] for box in obstacles]
        if any(len(box) != 6 for box in boxes):
            raise ValueError("an obstacle has six numbers: its centre and its half edges")
        self._native = _native.Surroundings(robot._native, to_bytes(boxes), ball)

    def contacts(self, q_rad: ArrayLike) -> NDArray[np.bool_]:
        """Whether two bodies touch, for each row of angles in rad."""
        return np.array(self._native.contacts(to_bytes(self._robot._rows(q_rad))), dtype=np.bool_)

    def is_free_line(self, from_rad: ArrayLike, to_rad: ArrayLike) -> bool:
        """Whether no two bodies touch, at any instant, while the joints go evenly from one pose to another."""
        return self._native.is_free_line(self._ends(from_rad, to_rad))

    def way(
        self, from_rad: ArrayLike, to_rad: ArrayLike, *, speed_share: float = 0.2, way_seed: int = 1
    ) -> Way | None:
        """The way of ``cubectl move``; ``None`` if the arm is there."""
        text = self._native.way(self._ends(from_rad, to_rad), float(speed_share), int(way_seed))
        return Way(text) if text else None

    def through(self, corners_rad: ArrayLike, *, speed_share: float = 0.2) -> Way | None:
        """The motion along lines through rows of angles, each corner rounded as much as is free; ``None`` if all are one place."""
        text = self._native.through(to_bytes(self._robot._rows(corners_rad)), float(speed_share))
        return Way(text) if text else None

    def _ends(self, from_rad: ArrayLike, to_rad: ArrayLike) -> bytes:
        ends = [np.asarray(end, dtype=np.float64) for end in (from_rad, to_rad)]
        return to_bytes(self._robot._rows(np.stack(ends)))


def along(
    robot: Robot,
    q_rad: ArrayLike,
    qd_max_rad_s: ArrayLike,
    qdd_max_rad_s2: ArrayLike,
    qddd_max_rad_s3: ArrayLike | None = None,
    *,
    blend_rad: float = 0.02,
) -> Way:
    """The fastest motion along lines through rows of angles, corners rounded within ``blend_rad``; without a largest jerk it has none.

    Two bodies may touch on it: :meth:`Surroundings.contacts` says so.
    """
    given = [qd_max_rad_s, qdd_max_rad_s2] + ([] if qddd_max_rad_s3 is None else [qddd_max_rad_s3])
    limits = np.concatenate([robot._rows(limit) for limit in given])
    rows = robot._rows(q_rad)
    return Way(_native.along(robot._native, to_bytes(rows), float(blend_rad), to_bytes(limits)))
