"""Logs as tables."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._arrays import to_array

#: Columns of one length by their names; ``pandas.DataFrame`` takes it (but for ``data``, which has two dimensions).
Table = dict[str, NDArray[Any]]


class Log:
    """A recording of a bus as tables.

    ``path`` is a text log (``bus.log``) or the folder of a throw. Times ``t_s`` are seconds as the log counts them. A log that was
    cut off is read up to its last whole line. Raises :class:`CubecellError` if it cannot be read.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        path = Path(path)
        self._fill(_native.read_log(path / "bus.log" if path.is_dir() else path))

    @classmethod
    def of_columns(cls, reported: dict[str, Any]) -> Log:
        """The tables of columns from the native half; see :meth:`Bus.record`."""
        log = cls.__new__(cls)
        log._fill(reported)
        return log

    def _fill(self, reported: dict[str, Any]) -> None:
        #: What was cut off at the end of the log, in words, if something was.
        self.torn: str | None = reported["torn"]

        def column(name: str, kind: type[Any] = np.float64) -> NDArray[Any]:
            values = reported[name]
            if isinstance(values, list):
                return np.array(values, dtype=np.str_)
            return to_array(values, -1).astype(kind, copy=False)

        #: Every frame: ``data`` has eight columns, of which the first ``length`` count.
        self.frames: Table = {
            "t_s": column("frames.t_s"),
            "id": column("frames.id", np.uint32),
            "extended": column("frames.extended", np.bool_),
            "sent": column("frames.sent", np.bool_),
            "length": column("frames.length", np.uint8),
            "data": np.frombuffer(reported["frames.data"], dtype=np.uint8).reshape(-1, 8),
        }
        #: Positions that drives (by their addresses) reported, rad.
        self.positions: Table = {
            "t_s": column("positions.t_s"),
            "module": column("positions.module", np.uint8),
            "position_rad": column("positions.position_rad"),
        }
        #: Motor currents that drives reported, A.
        self.currents: Table = {
            "t_s": column("currents.t_s"),
            "module": column("currents.module", np.uint8),
            "current_a": column("currents.current_a"),
        }
        #: Joints (from 1) as the controller reported them: rad, rad/s, and the tracking error in rad.
        self.joints: Table = {
            "t_s": column("joints.t_s"),
            "joint": column("joints.joint", np.uint8),
            "q_rad": column("joints.q_rad"),
            "qd_rad_s": column("joints.qd_rad_s"),
            "error_q_rad": column("joints.error_q_rad"),
        }
        #: The group as the controller reported it: state in words, cause of a fault (0: none), time in the plan in s, bus load (0 to 1).
        self.group: Table = {
            "t_s": column("group.t_s"),
            "state": column("group.state"),
            "fault_cause": column("group.fault_cause", np.uint16),
            "plan_s": column("group.plan_s"),
            "bus_load": column("group.bus_load"),
        }
        #: Lines of text for people, as nodes sent them.
        self.records: Table = {
            "t_s": column("records.t_s"),
            "severity": column("records.severity"),
            "text": column("records.text"),
        }
