"""A sweep over many targets on a Dask cluster, each shard a task.

    dask scheduler --port 8786
    dask worker tcp://127.0.0.1:8786 --nworkers 2 --nthreads 1
    python sweep_on_dask.py tcp://127.0.0.1:8786 OUT SHARDS KEYWORDS

``KEYWORDS`` are those of :func:`cubecell.sweep` as JSON, such as ``{"targets": "targets.csv", "fast": true}``. ``OUT`` is a folder
that all workers see under the same name. A shard that a lost worker was making is given to another one. The files have the same bytes as those of ``cubectl plan sweep --shards SHARDS``.
"""

# Dask has few types of its own.
# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import json
import sys
from typing import Any

import cubecell
from distributed import Client, as_completed


def make(number: int, shards: int, out: str, keywords: dict[str, Any]) -> int:
    """Makes one shard, on a worker; 1 if it was not there."""
    return cubecell.sweep("powercube6", out, shard=(number, shards), **keywords).made


def main(scheduler: str, out: str, shards: int, keywords: dict[str, Any]) -> None:
    with Client(scheduler) as client:
        # Not pure for Dask: what counts is the file, so each run looks whether it is there.
        tasks = [client.submit(make, number, shards, out, keywords, pure=False) for number in range(1, shards + 1)]
        for done, task in enumerate(as_completed(tasks), start=1):
            task.result()
            print(f"{done} of {shards} shards", flush=True)
    reported = cubecell.sweep_summary(out)
    assert not reported["missing_shards"], reported
    print(f"{reported['thrown']} throws, {reported['relaxed']} relaxed, {reported['refused']} refused; CRC-32 {reported['crc32']}")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), json.loads(sys.argv[4]))
