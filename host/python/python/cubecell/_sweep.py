"""Throws to many targets, as CSV part files."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Unpack

from . import _native
from ._request import SearchOptions, request
from ._robot import Robot, source_of


@dataclass(frozen=True)
class Swept:
    """What came of the shards that were asked for."""

    #: Shards that were made now.
    made: int
    #: Shards that were there already.
    there: int


def sweep(
    robot: Robot | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    targets: str | os.PathLike[str] | None = None,
    x_m: Sequence[float] | None = None,
    y_m: Sequence[float] | None = None,
    z_m: Sequence[float] | None = None,
    shard: tuple[int, int] | None = None,
    shards: int | None = None,
    draws: int = 0,
    **options: Unpack[SearchOptions],
) -> Swept:
    """Plans throws to many targets, as ``cubectl plan sweep`` does: the same options make files of the same bytes.

    Targets are a CSV file with the columns ``x_m, y_m, z_m``, or a grid: each of ``x_m``, ``y_m`` and ``z_m`` is from, to
    and step. ``shard`` is the number of a shard, from 1, and how many there are: one file of the folder ``out``. ``shards`` makes all
    of so many, neither a shard for 100 targets. ``draws`` are disturbed throws to each target. Shards that are there are not made again. A call uses all cores, or as many as ``RAYON_NUM_THREADS`` says.

    Raises :class:`CubecellError` if something is refused; the folder of another sweep is, and is left as it is. Ctrl-C ends the call;
    files that are there are whole.
    """
    made, there = _native.sweep(
        request(
            options,
            robot=source_of(robot),
            out=out,
            targets=targets,
            x=x_m,
            y=y_m,
            z=z_m,
            shard=None if shard is None else f"{shard[0]}/{shard[1]}",
            shards=shards,
            draws=draws or None,
        )
    )
    return Swept(made, there)


def sweep_summary(out: str | os.PathLike[str]) -> dict[str, Any]:
    """What the parts of a sweep say together, as ``cubectl plan sweep --summary OUT --json`` prints it."""
    reported: dict[str, Any] = json.loads(_native.sweep_summary(os.fspath(out)))
    return reported
