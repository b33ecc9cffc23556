"""Throws in the simulated cell."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import _native
from ._arrays import Doubles
from ._plan import Gains, Plan


@dataclass(frozen=True)
class Run:
    """A simulated throw."""

    #: ``landed``, ``missed``, ``not_released``, ``stopped`` or ``not_thrown``, as in ``summary.json``.
    outcome: str
    #: The outcome in words.
    text: str
    #: A landing farther than this from the target counts as missed, m.
    tolerance_m: float
    #: Why the job ended early.
    error: str | None
    #: Where the simulated ball came down, m.
    landing_m: Doubles | None
    #: How long it flew, s.
    flight_s: float | None
    #: Distance of the landing from the target, m.
    miss_m: float | None
    #: The run against its plan: tracking errors, currents, landing from the measured motion.
    analysis: dict[str, Any] | None = field(repr=False)


def simulate(
    plan: Plan,
    *,
    seed: int = 1,
    gains: Gains | None = None,
    scenario: str | os.PathLike[str] | None = None,
) -> Run:
    """Throws in the simulated cell: controller, bus, drives, arm and ball, in virtual time.

    ``seed`` draws what differs from cell to cell; the same seed gives the same run. ``gains`` replace those of the program, and
    bring their control period. ``scenario`` is a file of faults, as ``cubectl throw --scenario`` takes it. A throw that fails is a
    result, not an exception; :class:`CubecellError` is raised if something is refused. Ctrl-C ends the simulation.
    """
    request = {
        "plan": plan.json,
        "robot": plan.robot,
        "seed": seed,
        "gains": None if gains is None else gains.toml,
        "scenario": None if scenario is None else os.fspath(scenario),
    }
    reported = json.loads(_native.simulate(request))
    landed = reported["landing_m"]
    reported["landing_m"] = None if landed is None else np.array(landed)
    return Run(**reported)
