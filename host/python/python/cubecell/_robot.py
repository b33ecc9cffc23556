"""Robots."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike

from . import _native
from ._arrays import Doubles, to_array, to_bytes


class Robot:
    """A robot arm of four to seven joints.

    ``source`` is a built-in name (``powercube6``, ``kr16_2``, ``pincher4``) or the path of a robot file, as ``--robot`` of ``cubectl``
    takes it. Raises :class:`CubecellError` with file, line and key if the file is refused.
    """

    def __init__(self, source: str | os.PathLike[str]) -> None:
        self._native = _native.Robot(os.fspath(source))
        limits = to_array(self._native.limits(), 5, len(self.joint_names))
        #: Smallest angles, rad.
        self.q_min_rad: Doubles = limits[0]
        #: Largest angles, rad.
        self.q_max_rad: Doubles = limits[1]
        #: Largest speeds, rad/s.
        self.qd_max_rad_s: Doubles = limits[2]
        #: Largest accelerations, rad/s².
        self.qdd_max_rad_s2: Doubles = limits[3]
        #: Largest jerks, rad/s³.
        self.qddd_max_rad_s3: Doubles = limits[4]

    @property
    def source(self) -> str:
        """What it was loaded from."""
        return self._native.source

    @property
    def name(self) -> str:
        """Name in the robot file."""
        return self._native.name

    @property
    def joint_names(self) -> list[str]:
        """Names of the joints, base first."""
        return self._native.joint_names

    @property
    def gravity_m_s2(self) -> float:
        """Gravity of its world in m/s², positive."""
        return self._native.gravity_m_s2

    def _rows(self, q_rad: ArrayLike) -> Doubles:
        q = np.asarray(q_rad, dtype=np.float64)
        n = len(self.joint_names)
        if q.ndim not in (1, 2) or q.shape[-1] != n:
            raise ValueError(f"{self.name} has {n} joints, got an array of shape {q.shape}")
        return q

    def hand(self, q_rad: ArrayLike) -> Doubles:
        """Pose of the ball in the hand in the world (m), 4 x 4, for angles in rad of shape (n,) or (samples, n)."""
        q = self._rows(q_rad)
        return to_array(self._native.hand(to_bytes(q)), *q.shape[:-1], 4, 4)

    def gravity_torques(self, q_rad: ArrayLike) -> Doubles:
        """Torques in Nm that hold the arm against gravity, for angles in rad of shape (n,) or (samples, n)."""
        q = self._rows(q_rad)
        return to_array(self._native.gravity_torques(to_bytes(q)), *q.shape)

    def __repr__(self) -> str:
        return f"Robot({self.source!r})"


def source_of(robot: Robot | str | os.PathLike[str]) -> str:
    return robot.source if isinstance(robot, Robot) else os.fspath(robot)
