"""Throws and catches of robot arms: robots, plans, checks, simulation, gains, flights, catches, buses and logs.

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

from ._arm import Arm, ArmState, Gripper, Moved, Servo, ServoState, connect
from ._bus import Bus, Modules
from ._catch import (
    BallCatch,
    BallChoice,
    Crossing,
    Decisions,
    DiscCatch,
    DiscFlight,
    DiscPlan,
    DiscRule,
    DiscWitness,
    Trace,
    catch_ball,
    catch_disc,
)
from ._flight import Flight, fly, landing
from ._follow import FollowPlan, FollowReport, FollowRun, SetPoints, plan_follow, simulate_follow
from ._log import Log, Table
from ._motion import Motion
from ._native import CubecellError
from ._plan import Finding, Gains, Plan, Report, check, plan, tune
from ._request import BallOptions, DiscOptions, FollowOptions, GainsOptions, LedOptions, PlanOptions, SearchOptions
from ._robot import Robot
from ._simulate import Run, simulate
from ._sweep import Swept, sweep, sweep_summary
from ._ways import Surroundings, Way, along

__all__ = [
    "Arm",
    "ArmState",
    "BallCatch",
    "BallChoice",
    "BallOptions",
    "Bus",
    "Crossing",
    "CubecellError",
    "Decisions",
    "DiscCatch",
    "DiscFlight",
    "DiscOptions",
    "DiscPlan",
    "DiscRule",
    "DiscWitness",
    "Finding",
    "Flight",
    "FollowOptions",
    "FollowPlan",
    "FollowReport",
    "FollowRun",
    "Gains",
    "GainsOptions",
    "Gripper",
    "LedOptions",
    "Log",
    "Modules",
    "Motion",
    "Moved",
    "Plan",
    "PlanOptions",
    "Report",
    "Robot",
    "Run",
    "SearchOptions",
    "Servo",
    "ServoState",
    "SetPoints",
    "Surroundings",
    "Swept",
    "Table",
    "Trace",
    "Way",
    "along",
    "catch_ball",
    "catch_disc",
    "check",
    "connect",
    "fly",
    "landing",
    "plan",
    "plan_follow",
    "simulate",
    "simulate_follow",
    "sweep",
    "sweep_summary",
    "tune",
]
