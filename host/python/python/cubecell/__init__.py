"""Throws of robot arms of drive modules: robots, plans, checks, simulation, gains, flights and logs.

Units are in the names: m, rad, s, A. The world frame is that of the arm's base, z up. Arrays are numpy arrays with one row per
sample. What is refused raises :class:`CubecellError` with the message of ``cubectl`` and its exit code. Long calls let other threads
run, and Ctrl-C ends them.

    >>> import cubecell
    >>> robot = cubecell.Robot("powercube6")
    >>> plan = cubecell.plan(robot, [1.0, 1.0, -1.0], fast=True)
    >>> cubecell.check(plan).ok
    True
    >>> cubecell.simulate(plan).outcome
    'landed'
"""

from ._flight import Flight, fly, landing
from ._log import Log, Table
from ._native import CubecellError
from ._plan import Finding, Gains, Motion, Plan, Report, check, plan, tune
from ._robot import Robot
from ._simulate import Run, simulate
from ._sweep import Swept, sweep, sweep_summary

__all__ = [
    "CubecellError",
    "Finding",
    "Flight",
    "Gains",
    "Log",
    "Motion",
    "Plan",
    "Report",
    "Robot",
    "Run",
    "Swept",
    "Table",
    "check",
    "fly",
    "landing",
    "plan",
    "simulate",
    "sweep",
    "sweep_summary",
    "tune",
]
