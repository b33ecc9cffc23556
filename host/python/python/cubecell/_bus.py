"""Buses: who is there, how the modules are, which frames pass."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._arrays import Doubles
from ._log import Log
from ._robot import Robot, source_of


@dataclass(frozen=True)
class Modules:
    """Drive modules: one row per module; ``nan`` for numbers that are not known."""

    #: The bus as a person would name it.
    bus: str
    #: Whether the modules were asked. If not, another node speaks to them, and this is what was heard.
    asked: bool
    #: Addresses.
    module: NDArray[np.uint8]
    position_rad: Doubles
    current_a: Doubles
    #: Whether it knows its zero.
    homed: NDArray[np.bool_]
    #: State in words, as ``cubectl explain`` knows them; empty if not known.
    state: NDArray[np.str_]
    #: Addresses of modules that must be there and are not.
    missing: list[int]
    #: The controller that was heard, if modules were not asked.
    controller: dict[str, Any] | None = field(repr=False)
    #: Everything that was reported of each module, with serial number, firmware, supplies and temperature where they were asked for.
    details: list[dict[str, Any]] = field(repr=False)


@dataclass(frozen=True)
class Bus:
    """A bus as ``cubectl --bus`` names it; each call joins it and leaves it again.

    ``spec`` is ``sim`` (the simulated cell inside this program, in virtual time; each call has a new one), ``can0``,
    ``socketcand://host:port/bus``, ``slcan:/dev/ttyACM0`` or ``slcan://host:port``. Nothing is set and nothing moves: modules are asked
    for values, and not even that while a controller or another host speaks to them.

    Every call raises :class:`CubecellError` with the next step in its text: with exit code 7 if the bus cannot be reached or is
    lost, 8 if no module answers in time. Calls let other threads run, and Ctrl-C ends them.
    """

    spec: str = "sim"
    #: Whose modules must be there, and whose cell is simulated.
    robot: Robot | str | os.PathLike[str] | None = None
    #: Seed of the simulated cell.
    seed: int | None = None
    #: Faults of the simulated cell, as ``cubectl arm status --scenario`` takes them.
    scenario: str | os.PathLike[str] | None = None

    def _joined(self) -> dict[str, Any]:
        robot = None if self.robot is None else source_of(self.robot)
        scenario = None if self.scenario is None else os.fspath(self.scenario)
        return {"bus": self.spec, "robot": robot, "seed": self.seed, "scenario": scenario}

    def scan(self, modules: Iterable[int] | None = None) -> Modules:
        """State and position of the modules that answer; ``modules`` are the addresses that are looked for, by default all.

        Modules that must be there and do not answer are in ``missing``.
        """
        return self._modules(modules, False)

    def status(self, modules: Iterable[int] | None = None) -> Modules:
        """The same, as ``cubectl arm status`` prints it.

        Raises :class:`CubecellError` (exit code 8) if one of ``modules`` does not answer, or one of the robot: that of the simulated
        cell, or ``robot`` of this bus.
        """
        return self._modules(modules, True)

    def record(self, seconds: float, *, controller: bool = False) -> Log:
        """The frames that pass in so many seconds, as tables. Nothing is sent.

        In a simulated cell ``controller`` lets a controller start up, so that there is something to hear.
        """
        return Log.of_columns(_native.bus_record(self._joined(), float(seconds), controller))

    def _modules(self, modules: Iterable[int] | None, all_must_answer: bool) -> Modules:
        ids = None if modules is None else [int(module) for module in modules]
        return _modules(_native.bus_modules(self._joined(), ids, all_must_answer))


def _modules(text: str) -> Modules:
    reported = json.loads(text)
    rows = reported["modules"]

    def numbers(name: str) -> Doubles:
        return np.array([row.get(name) for row in rows], dtype=np.float64)

    return Modules(
        bus=reported["bus"],
        asked=reported.get("asked", True),
        module=np.array([row["module"] for row in rows], dtype=np.uint8),
        position_rad=numbers("position_rad"),
        current_a=numbers("current_a"),
        homed=np.array([bool(row["homed"]) for row in rows], dtype=np.bool_),
        state=np.array([row["state"] or "" for row in rows], dtype=np.str_),
        missing=reported["missing"],
        controller=reported.get("controller"),
        details=rows,
    )
