"""The flight of a ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import _native
from ._arrays import Doubles, to_array, to_bytes, to_point, to_times

STANDARD_GRAVITY_M_S2 = 9.81


@dataclass(frozen=True)
class Flight:
    """A flying ball: one row per time."""

    t_s: Doubles
    position_m: Doubles
    velocity_m_s: Doubles


def fly(
    position_m: ArrayLike,
    velocity_m_s: ArrayLike,
    t_s: ArrayLike,
    *,
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2,
    drag_per_m: float = 0.0,
    magnus_rad_s: ArrayLike = (0.0, 0.0, 0.0),
) -> Flight:
    """The flight from a release, at times in s after it.

    ``drag_per_m`` is the deceleration over the square of the speed, ``magnus_rad_s`` the spin times its lift constant: the
    acceleration is gravity - drag |v| v + magnus x v. The planner uses the same code.
    """
    times = to_times(t_s)
    p, v = to_point(position_m, "a position"), to_point(velocity_m_s, "a velocity")
    air = (gravity_m_s2, drag_per_m, to_point(magnus_rad_s, "a Magnus vector"))
    rows = to_array(_native.flight(p, v, to_bytes(times), air), len(times), 6)
    return Flight(times, rows[:, :3], rows[:, 3:])


def landing(
    position_m: ArrayLike,
    velocity_m_s: ArrayLike,
    height_m: float,
    *,
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2,
    drag_per_m: float = 0.0,
    magnus_rad_s: ArrayLike = (0.0, 0.0, 0.0),
) -> tuple[Doubles, float] | None:
    """Where (m) and when (s) a ball comes down on the plane at a height; ``None`` if it does not. As :func:`fly`."""
    p, v = to_point(position_m, "a position"), to_point(velocity_m_s, "a velocity")
    air = (gravity_m_s2, drag_per_m, to_point(magnus_rad_s, "a Magnus vector"))
    met = _native.landing(p, v, height_m, air)
    return None if met is None else (np.array(met[:3]), met[3])
