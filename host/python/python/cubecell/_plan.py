"""Plans, their check, and gains."""

from __future__ import annotations

import json
import os
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Unpack, overload

from numpy.typing import ArrayLike

from . import _native
from ._arrays import to_point
from ._follow import FollowPlan, FollowReport
from ._motion import Motion, sampled
from ._request import GainsOptions, PlanOptions, request
from ._robot import Robot, source_of


@dataclass(frozen=True)
class Plan:
    """A planned throw."""

    #: The plan file, as ``cubectl plan throw --json`` writes it.
    json: str
    #: Where the robot comes from, if not from where the plan file says.
    robot: str | None = None
    #: What was given up of what was asked for, in words; ``None`` for nothing, and for plans that were read.
    note: str | None = field(default=None, compare=False)
    #: The plan file as a dictionary; ``cubectl plan schema`` describes it.
    data: dict[str, Any] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "data", json.loads(self.json))

    @classmethod
    def read(cls, path: str | os.PathLike[str], robot: Robot | None = None) -> Plan:
        """Reads a plan file; ``robot`` replaces the one that it names."""
        return cls(Path(path).read_text(encoding="utf-8"), robot.source if robot else None)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes the plan file."""
        Path(path).write_text(self.json, encoding="utf-8")

    @property
    def objective(self) -> float:
        """What the search made small."""
        return float(self.data["objective"]["value"])

    @property
    def release_time_s(self) -> float:
        """When the ball leaves the hand, in s since the start."""
        return float(self.data["release_time_s"])

    @property
    def end_time_s(self) -> float:
        """When the motion ends, in s since the start."""
        return float(self.data["end_time_s"])

    def sample(self, t_s: ArrayLike | None = None, step_s: float = 0.005) -> Motion:
        """The motion at times in s, by default from start to end in steps."""
        return sampled(self.json, self.end_time_s, t_s, step_s)


def plan(
    robot: Robot | str | os.PathLike[str],
    target_m: ArrayLike,
    **options: Unpack[PlanOptions],
) -> Plan:
    """Plans the best throw to a target (m, world), as ``cubectl plan throw`` does: same options, same seed, same plan.

    Raises :class:`CubecellError` if something is refused or no throw reaches the target (exit code 3). Ctrl-C ends the search. Throws
    of industrial robots follow the flight of the ball: :func:`plan_follow`.
    """
    source = source_of(robot)
    text, note = _native.plan(request(options, robot=source, target=to_point(target_m, "a target")))
    return Plan(text, source, note)


@dataclass(frozen=True)
class Finding:
    """One thing that was checked."""

    #: What.
    what: str
    #: Whether it holds.
    ok: bool
    #: Worst value, with what it is measured against.
    worst: str
    #: When, in s since the start; ``None`` if it is not about an instant.
    at_s: float | None
    #: Whether the plan claims it; other findings are for information.
    enforced: bool


@dataclass(frozen=True)
class Report:
    """Everything that was checked."""

    findings: list[Finding]
    #: Instants at which the motion was looked at.
    samples: int

    @property
    def ok(self) -> bool:
        """Whether everything that the plan claims holds."""
        return all(finding.ok or not finding.enforced for finding in self.findings)


@overload
def check(plan: Plan) -> Report: ...
@overload
def check(plan: FollowPlan) -> FollowReport: ...
def check(plan: Plan | FollowPlan) -> Report | FollowReport:
    """Checks a plan by other means than the planner's, as ``cubectl plan check`` does.

    Raises :class:`CubecellError` if the plan cannot be read or is for another robot.
    """
    reported = json.loads(_native.check(plan.json, plan.robot))
    if isinstance(plan, FollowPlan):
        del reported["good"]
        return FollowReport(**reported)
    return Report([Finding(**finding) for finding in reported["findings"]], reported["samples"])


@dataclass(frozen=True)
class Gains:
    """Feedback gains with their certificates."""

    #: The gains file, as ``cubectl tune --out`` writes it.
    toml: str
    #: The gains file as a dictionary.
    data: dict[str, Any] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "data", tomllib.loads(self.toml))

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Gains:
        """Reads a gains file; what is wrong with it is reported where it is used."""
        return cls(Path(path).read_text(encoding="utf-8"))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes the gains file."""
        Path(path).write_text(self.toml, encoding="utf-8")


def tune(robot: Robot | str | os.PathLike[str], **options: Unpack[GainsOptions]) -> Gains:
    """Designs gains with certificates for a control period, as ``cubectl tune`` does.

    Raises :class:`CubecellError`, with the condition that binds, if a joint cannot be tuned.
    """
    return Gains(_native.tune(source_of(robot), request(options)))
