"""Motions of all joints over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import _native
from ._arrays import Doubles, to_array, to_bytes, to_times


@dataclass(frozen=True)
class Motion:
    """A motion read at times: one row per time, one column per joint."""

    t_s: Doubles
    q_rad: Doubles
    qd_rad_s: Doubles
    qdd_rad_s2: Doubles


def sampled(json: str, end_s: float, t_s: ArrayLike | None, step_s: float) -> Motion:
    """The motion of a plan file at times, by default from 0 to its end in steps."""
    if t_s is None:
        t_s = np.append(np.arange(0.0, end_s, step_s), end_s)
    times = to_times(t_s)
    rows = to_array(_native.sample(json, to_bytes(times)), len(times), 3, -1)
    return Motion(times, rows[:, 0], rows[:, 1], rows[:, 2])
