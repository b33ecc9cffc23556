"""Throws whose hand follows the flight of the ball while the gripper opens: those of industrial robots."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._arrays import Doubles, to_point
from ._motion import Motion, sampled
from ._request import FollowOptions, LedOptions, request
from ._robot import Robot, source_of


@dataclass(frozen=True)
class SetPoints:
    """What the robot is led through: one row per set point, one column per axis."""

    #: Times from the first set point, s; one period apart.
    t_s: Doubles
    #: ``accelerate``, ``follow`` or ``decelerate``.
    phase: NDArray[np.str_]
    #: Angles that the axes shall have.
    q_rad: Doubles
    #: Speeds that the axes shall have.
    qd_rad_s: Doubles
    #: What is commanded so that the lag of the robot executes ``q_rad``.
    command_rad: Doubles


@dataclass(frozen=True)
class FollowPlan:
    """A planned throw that follows the flight of the ball."""

    #: The plan file, as ``cubectl plan throw --json`` writes it.
    json: str
    #: Where the robot comes from, if not from where the plan file says.
    robot: str | None = None
    #: The plan file as a dictionary; ``cubectl plan schema`` describes it.
    data: dict[str, Any] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        data = json.loads(self.json)
        if data.get("kind") != "follow":
            raise ValueError(f"a plan of kind {data.get('kind', 'throw')!r} does not follow the flight: see Plan")
        object.__setattr__(self, "data", data)

    @classmethod
    def read(cls, path: str | os.PathLike[str], robot: Robot | None = None) -> FollowPlan:
        """Reads a plan file; ``robot`` replaces the one that it names."""
        return cls(Path(path).read_text(encoding="utf-8"), robot.source if robot else None)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes the plan file."""
        Path(path).write_text(self.json, encoding="utf-8")

    @property
    def followed_points(self) -> int:
        """Set points at which the ball is on its flight."""
        return int(self.data["followed_points"])

    @property
    def release_time_s(self) -> float:
        """When the jaws no longer touch the ball, in s since the start."""
        return float(self.data["release_time_s"])

    @property
    def end_time_s(self) -> float:
        """When the motion ends, in s since the start."""
        return float(self.data["steps"][-1]["t_s"])

    @property
    def set_points(self) -> SetPoints:
        """All set points."""
        steps = self.data["steps"]

        def column(name: str) -> Doubles:
            return np.array([step[name] for step in steps], dtype=np.float64)

        phase = np.array([step["phase"] for step in steps], dtype=np.str_)
        return SetPoints(column("t_s"), phase, column("q_rad"), column("qd_rad_s"), column("command_rad"))

    def sample(self, t_s: ArrayLike | None = None, step_s: float = 0.005) -> Motion:
        """The motion between the set points at times in s, by default from start to end in steps.

        Cubics through position and speed of the set points, as the robot is led.
        """
        return sampled(self.json, self.end_time_s, t_s, step_s)


@dataclass(frozen=True)
class FollowReport:
    """What the check of a throw that follows the flight measured."""

    #: What is wrong, in words; empty for a plan that holds what it claims.
    findings: list[str]
    #: Largest distance of the ball from its flight at the followed set points, m.
    off_parabola_m: float
    #: Largest distance from the target of a ball that is released at a followed set point, m.
    landing_m: float
    #: The same for the angles that the lag executes, m; 0 where the plan allows for no lag.
    executed_landing_m: float
    #: Smallest distance of bodies over the motion, m.
    nearest_m: float
    #: Smallest distance of the free ball from arm and hand, m.
    ball_m: float

    @property
    def ok(self) -> bool:
        """Whether everything that the plan claims holds."""
        return not self.findings


def plan_follow(
    robot: Robot | str | os.PathLike[str],
    target_m: ArrayLike,
    **options: Unpack[FollowOptions],
) -> FollowPlan:
    """Plans a throw to a target (m, world) whose hand follows the flight while the gripper opens.

    As ``cubectl plan throw`` does for industrial robots (``kr16_2``), and with ``follow=True`` for any arm of six joints: the
    same options and seed give the same plan, but for the time of the search in it.

    Raises :class:`CubecellError` if something is refused or no throw reaches the target (exit code 3). Ctrl-C ends the call.
    """
    source = source_of(robot)
    target = to_point(target_m, "a target")
    return FollowPlan(_native.plan_follow(request(options, robot=source, target=target)), source)


@dataclass(frozen=True)
class FollowRun:
    """A simulated throw that follows the flight: the motion of the robot, one row per cycle of its controller."""

    #: ``landed``, ``missed``, ``not_released``, ``stopped`` or ``not_thrown``, as in ``summary.json``.
    outcome: str
    #: The outcome in words.
    text: str
    #: Where the simulated ball came down, m.
    landing_m: Doubles | None
    #: Distance of the landing from the target, m.
    miss_m: float | None
    #: When the plan began, in the time of ``t_s``; ``None`` if it did not.
    plan_started_s: float | None
    #: Times since the robot's program began, s.
    t_s: Doubles = field(repr=False)
    #: Set point of the axes.
    set_rad: Doubles = field(repr=False)
    #: Axes, without noise.
    actual_rad: Doubles = field(repr=False)
    #: What ``cubectl throw`` writes to ``summary.json``.
    summary: dict[str, Any] = field(repr=False)


def simulate_follow(plan: FollowPlan, **options: Unpack[LedOptions]) -> FollowRun:
    """Throws with the simulated industrial robot (KR C2 over RSI), in virtual time, as ``cubectl throw --robot kr16_2 --plan`` does.

    The plan is opened, and turned about the first axis, where the ball lands nearest for the lag of the robot. A throw that fails is a
    result, not an exception; :class:`CubecellError` is raised if something is refused.
    """
    robot = plan.robot or str(plan.data["robot"]["source"])
    text, rows = _native.simulate_follow(plan.json, request(options, robot=robot))
    summary = json.loads(text)
    cycles = np.frombuffer(rows, dtype=np.dtype("<f8")).reshape(-1, 13).astype(np.float64, copy=False)
    landing = summary["landing"]
    return FollowRun(
        outcome=summary["outcome"],
        text=summary["outcome_text"],
        landing_m=None if landing is None else np.array(landing["position_m"]),
        miss_m=None if landing is None else landing["error_m"],
        plan_started_s=summary["plan_started_s"],
        t_s=cycles[:, 0],
        set_rad=cycles[:, 1:7],
        actual_rad=cycles[:, 7:],
        summary=summary,
    )
