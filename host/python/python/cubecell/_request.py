"""Requests: keyword arguments with the names of the options of ``cubectl``, ``_`` for ``-``. What is not given has the default there."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike


class _Throw(TypedDict, total=False):
    #: Which throws are allowed.
    form: Literal["best", "paper"]
    #: Seed of the random starts.
    seed: int
    #: Random starts after the stored ones.
    starts: int


class SearchOptions(_Throw, total=False):
    """How to look for a throw: the options of ``cubectl plan throw`` and ``plan sweep``, described by their ``--help``."""

    #: Take the first stored throw that leads there.
    fast: bool
    time_budget_s: float
    #: What to make small; ``hit`` needs a region.
    objective: Literal["effort", "time", "energy", "spread", "hit"]
    #: Weights of time, braking ratio and jerk.
    weights: ArrayLike
    hit_radius_m: float
    #: Half edges of a rectangle, m.
    hit_box: ArrayLike
    jitter_s: float
    #: File with measured delays of the gripper, ms.
    release_delays: str | os.PathLike[str]
    #: Shares of the limits that a plan may use.
    speed_use: float
    acceleration_use: float
    free_spin: bool
    null_delay: bool
    #: Pairs of ms and mm.
    delay_window: Sequence[ArrayLike]
    clean_release: bool
    clearance_m: float
    range_margin_rad: float
    #: Boxes: centre and half edges, m.
    obstacle: Sequence[ArrayLike]
    drag_per_m: float
    #: Spin of the ball times its lift constant, 1/s.
    magnus_rad_s: ArrayLike
    finger_release: bool
    #: Direction out of an opening that is the target; needs its radius.
    opening_normal: ArrayLike
    opening_radius_m: float
    incidence_max_deg: float
    #: Velocity of a target that moves, m/s.
    target_velocity: ArrayLike
    #: Its way: rows of coefficients of t, t², ... in m/s, m/s², ...
    target_course: Sequence[ArrayLike]
    #: Ranges: smallest and largest.
    arrival_speed_m_s: ArrayLike
    arrival_descent_deg: ArrayLike
    radius_m: ArrayLike
    elevation_deg: ArrayLike
    flight_s: ArrayLike
    duration_s: ArrayLike
    braking_ratio: ArrayLike


class PlanOptions(SearchOptions, total=False):
    """Options of ``cubectl plan throw``."""

    #: Throw with the release at one instant, also with an industrial robot.
    no_follow: bool


class FollowOptions(_Throw, total=False):
    """Options of ``cubectl plan throw`` for throws that follow the flight."""

    #: Follow with any arm of six joints.
    follow: bool
    #: First-order lag of the robot, by which its commands lead, ms.
    lag_ms: float
    #: Time between two set points, ms.
    period_ms: float
    tilt_max_deg: float
    ramps_deg_s2: float
    limits: Literal["controller", "robot-file"]
    #: Of the grid of the paper form.
    resolution: float
    refine: int
    ramps: Literal["synchronised", "own"]
    criterion: Literal["j2", "points"]
    #: Six and two weights of the criteria.
    weights_w: ArrayLike
    weights_g: ArrayLike


class LedOptions(TypedDict, total=False):
    """Options of ``cubectl throw`` for the simulated industrial robot."""

    #: Of the simulated robot.
    seed: int
    #: File with what is true of the robot.
    scenario: str | os.PathLike[str]
    #: Its description: ``kr-c2``, ``kr-c2-tcp``, ``kr-c4``, ``kr-c4-12ms`` or a file.
    rsi: str | os.PathLike[str]
    #: Share of the robot's speeds and accelerations on the way to the start.
    speed_share: float
    #: A landing farther from the target is a miss, m.
    tolerance_m: float


class GainsOptions(TypedDict, total=False):
    """Options of ``cubectl tune``."""

    #: A joint from 1, or all.
    joint: int | Literal["all"]
    #: Control period, 1 to 40 ms.
    period_ms: float
    #: Share of the period.
    jitter: float
    #: Largest and smallest delay from sample to command, ms.
    delay_ms: float
    delay_min_ms: float
    estimator_alpha: float
    estimator_beta: float
    #: Plan file whose accelerations are set aside, or the share that a motion uses.
    plan: str | os.PathLike[str]
    reference_share: float
    #: Initial errors to recover from, rad and rad/s.
    error: Sequence[float]
    design: Literal["saturated", "paper"]


class BallOptions(TypedDict, total=False):
    """Options of ``cubectl catch --ball``."""

    hand: Literal["either", "matched", "hold"]
    #: The catcher knows beforehand how the ball flies.
    cooperative: bool
    #: Keep the jerk limits as well.
    jerk: bool
    #: Restitution of ball and cup that the catcher counts on.
    restitution: float
    #: Such as ``frames-lost:0.1`` or ``tracker-dead:0.2``.
    fault: Sequence[str]
    #: File of the cell.
    cell: str | os.PathLike[str]
    seed: int


class DiscOptions(TypedDict, total=False):
    """Options of ``cubectl catch`` for a disc."""

    #: Lift and drag of a disc that spins, instead of a parabola.
    air: bool
    #: In air, m/s.
    wind: ArrayLike
    spin_rad_s: float
    #: Keep the jerk limits as well.
    jerk: bool
    #: Only the rule of the paper.
    no_limits: bool


def request(options: Mapping[str, Any], **fields: Any) -> str:
    """The text of a request for the native half."""
    given = {name: value for name, value in {**options, **fields}.items() if value is not None}
    for name, value in given.items():
        try:
            given[name] = json.loads(json.dumps(value, allow_nan=False, default=_plain))
        except ValueError as error:
            raise ValueError(f"{name}: {value!r} is not finite") from error
    return json.dumps(given)


def _plain(value: Any) -> Any:
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"{value!r} is not a value of a request")
