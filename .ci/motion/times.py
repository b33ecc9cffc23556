"""Durations of the package's time laws beside those of toppra (along a path) and ruckig (from rest to rest)."""

import math
import time

import cubecell
import numpy as np
import ruckig
import toppra
import toppra.algorithm
import toppra.constraint
import toppra.interpolator

toppra.setup_logging("ERROR")


class Rounded(toppra.interpolator.AbstractGeometricPath):
    """Lines through points with corners rounded within `blend_rad`, from the description in the package: from delta before a corner to
    delta after it the direction turns by 3x² - 2x³. Parameterised by length.
    """

    def __init__(self, points, blend_rad):
        legs = np.diff(points, axis=0)
        lengths = np.linalg.norm(legs, axis=1)
        along = legs / lengths[:, None]
        turns = np.linalg.norm(np.diff(along, axis=0), axis=1)
        cut = np.minimum(16 / 3 * blend_rad / turns, np.minimum(lengths[:-1], lengths[1:]) / 2)
        before, after = np.concatenate([[0.0], cut]), np.concatenate([cut, [0.0]])
        self.pieces, s = [], 0.0
        for k, length in enumerate(lengths - before - after):
            if length > 1e-9:
                self.pieces.append((s, length, points[k] + before[k] * along[k], along[k], along[k]))
                s += length
            if k < len(cut):
                self.pieces.append((s, 2 * cut[k], points[k + 1] - cut[k] * along[k], along[k], along[k + 1]))
                s += 2 * cut[k]
        self.length, self._dof = s, points.shape[1]
        self.starts = np.array([piece[0] for piece in self.pieces])

    def __call__(self, places, order=0):
        single = np.ndim(places) == 0
        rows = [self._at(s, order) for s in np.atleast_1d(places)]
        return rows[0] if single else np.array(rows)

    def _at(self, s, order):
        begin, width, start, one, other = self.pieces[max(0, np.searchsorted(self.starts, s, side="right") - 1)]
        x = min(max((s - begin) / width, 0.0), 1.0)
        if order == 0:
            turned = x**3 - 0.5 * x**4
            return start + width * (one * (x - turned) + other * turned)
        if order == 1:
            return one + (other - one) * (3 * x**2 - 2 * x**3)
        return (other - one) * 6 * x * (1 - x) / width

    @property
    def dof(self):
        return self._dof

    @property
    def path_interval(self):
        return np.array([0.0, self.length])

    @property
    def waypoints(self):
        return None

    def grid(self, on_piece):
        ends = [np.linspace(begin, begin + width, on_piece + 1)[1:] for begin, width, *_ in self.pieces]
        return np.concatenate([[0.0], *ends])


def path_case(robot, rng):
    """Points of a path, and by how much its corners are rounded, rad."""
    count = int(rng.integers(3, 9))
    points = rng.uniform(robot.q_min_rad, robot.q_max_rad, (count, len(robot.joint_names)))
    return points, float(rng.uniform(0.02, 0.4))


def with_toppra(robot, points, blend_rad):
    """Duration by toppra along the rounded path, s, the path, and CPU time, s."""
    path = Rounded(points, blend_rad)
    limits = [np.stack([-limit, limit], axis=1) for limit in (robot.qd_max_rad_s, robot.qdd_max_rad_s2)]
    grid = path.grid(48)
    begun = time.process_time()
    constraints = [
        toppra.constraint.JointVelocityConstraint(limits[0]),
        toppra.constraint.JointAccelerationConstraint(limits[1]),
    ]
    solver = toppra.algorithm.TOPPRA(constraints, path, gridpoints=grid, parametrizer="ParametrizeConstAccel")
    found = solver.compute_trajectory(0.0, 0.0)
    took_s = time.process_time() - begun
    return (math.nan if found is None else float(found.duration)), path, took_s


def with_ruckig(start, goal, limits, synchronization=ruckig.Synchronization.Time):
    """Duration by ruckig from rest to rest, s, and CPU time, s."""
    begun = time.process_time()
    asked = ruckig.InputParameter(len(start))
    asked.current_position, asked.target_position = list(start), list(goal)
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = ([float(x) for x in limit] for limit in limits)
    asked.synchronization = synchronization
    found = ruckig.Trajectory(len(start))
    result = ruckig.Ruckig(len(start)).calculate(asked, found)
    took_s = time.process_time() - begun
    assert result in (ruckig.Result.Working, ruckig.Result.Finished), result
    return found.duration, took_s


def with_ruckig_on_line(start, goal, limits):
    """The same for a motion whose joints stay on the line between both: one axis, from 0 to 1."""
    way = np.abs(np.asarray(goal) - start)
    return with_ruckig([0.0], [1.0], [[float(np.min(limit / way))] for limit in limits])[0]


def ours(robot, points, limits, blend_rad=0.0):
    """The package's motion and its CPU time, s."""
    begun = time.process_time()
    way = cubecell.along(robot, points, *limits, blend_rad=blend_rad)
    return way, time.process_time() - begun


def excess(way, limits):
    """Largest use of limits by a motion, as a share: of speeds, accelerations and, if there is one, jerks."""
    motion = way.sample(step_s=1e-3)
    used = [np.abs(motion.qd_rad_s) / limits[0], np.abs(motion.qdd_rad_s2) / limits[1]]
    return max(float(share.max()) for share in used)
