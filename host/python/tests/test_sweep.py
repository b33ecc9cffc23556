"""Sweeps: part files against the program's, read with the csv module, and made on Dask workers of which one is killed."""

import contextlib
import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cubecell
import pytest

CUBECTL = os.environ["CUBECTL"]
EXAMPLE = Path(__file__).parent.parent / "examples" / "sweep_on_dask.py"
GRID = ["--x=0.7,1.9,0.3", "--y=-0.4,0.4,0.4", "--z=-1,0,0.5"]
FAST = ["--form", "paper", "--fast", "--starts", "2"]


def cubectl(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([CUBECTL, *words], capture_output=True, text=True)


def files(folder: Path) -> dict[str, bytes]:
    """All files of a folder, what is left of killed processes as well."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def parts(folder: Path) -> dict[str, bytes]:
    return {name: data for name, data in files(folder).items() if not name.endswith(".tmp")}


def read(part: Path) -> list[dict[str, Any]]:
    """The rows of a part: numbers, words, and None for what is not there."""
    lines = [line for line in part.read_text().splitlines() if not line.startswith("#")]

    def value(name: str, text: str) -> Any:
        return text if name in ("outcome", "note") else float(text) if text else None

    return [{name: value(name, text) for name, text in row.items()} for row in csv.DictReader(lines)]


def test_a_sweep_has_the_bytes_of_the_program(tmp_path: Path) -> None:
    reported = cubectl("plan", "sweep", *GRID, *FAST, "--shards", "5", "--out", str(tmp_path / "program"))
    assert reported.returncode == 0, reported.stderr
    x, y, z = [0.7, 1.9, 0.3], [-0.4, 0.4, 0.4], [-1.0, 0.0, 0.5]
    for number in (5, 3, 1, 2, 4):
        made = cubecell.sweep(
            "powercube6", tmp_path / "mine", x_m=x, y_m=y, z_m=z, shard=(number, 5), fast=True, starts=2, form="paper"
        )
        assert made == cubecell.Swept(made=1, there=0)
    assert files(tmp_path / "mine") == files(tmp_path / "program")
    again = cubecell.sweep(
        "powercube6", tmp_path / "mine", x_m=x, y_m=y, z_m=z, shards=5, fast=True, starts=2, form="paper"
    )
    assert again == cubecell.Swept(made=0, there=5)
    summary = cubectl("plan", "sweep", "--summary", str(tmp_path / "program"), "--json")
    assert cubecell.sweep_summary(tmp_path / "mine") == json.loads(summary.stdout)
    with pytest.raises(cubecell.CubecellError, match="seed: 1 there, 2 asked for") as refused:
        cubecell.sweep(
            "powercube6", tmp_path / "mine", x_m=x, y_m=y, z_m=z, shards=5, fast=True, starts=2, seed=2, form="paper"
        )
    assert refused.value.exit_code == 4


def test_rows_are_the_plans_of_the_program(tmp_path: Path) -> None:
    rows = [(1.0, 1.0, -1.0), (9.0, 0.0, 0.0), (1.4, -0.5, -0.5), (0.9, 0.2, -0.25)]
    lines = ["x_m,y_m,z_m", *(",".join(map(repr, row)) for row in rows)]
    (tmp_path / "targets.csv").write_text("\n".join(lines) + "\n")
    words = [*FAST, "--draws", "50", "--hit-radius-m", "0.05"]
    made = cubectl("plan", "sweep", "--targets", str(tmp_path / "targets.csv"), *words, "--shards", "2", "--out", str(tmp_path / "out"))
    assert made.returncode == 0, made.stderr
    table = [row for path in sorted((tmp_path / "out").glob("*.csv")) for row in read(path)]
    assert [row["row"] for row in table] == list(range(len(rows)))
    for row, target in zip(table, rows, strict=True):
        assert (row["x_m"], row["y_m"], row["z_m"]) == target
        single = ["--target=" + ",".join(map(repr, target)), *FAST, "--hit-radius-m", "0.05", "--json"]
        reported = cubectl("plan", "throw", *single)
        if reported.returncode != 0:
            assert row["outcome"] == "refused" and row["note"] in reported.stderr and row["objective"] is None
            continue
        plan = json.loads(reported.stdout)
        release, landing = plan["release"], plan["landing"]
        assert row["outcome"] == "thrown" and row["note"] == ""
        assert row["objective"] == plan["objective"]["value"]
        assert (row["release_s"], row["duration_s"]) == (plan["release_time_s"], plan["end_time_s"])
        assert (row["flight_s"], row["hit_probability"]) == (landing["flight_s"], landing["hit_probability"])
        assert [row[f"release_{axis}_m"] for axis in "xyz"] == release["position_m"]
        assert [row[f"release_v{axis}_m_s"] for axis in "xyz"] == release["velocity_m_s"]
        for name, key, unit in (("q", "q_rad", "rad"), ("qd", "qd_rad_s", "rad_s"), ("qdd", "qdd_rad_s2", "rad_s2")):
            assert [row[f"release_{name}{joint}_{unit}"] for joint in range(1, 7)] == release[key]
        assert row["plan_crc32"] == zlib.crc32(reported.stdout.encode())
        assert row["draws_landed"] == 50 and 0 <= row["draws_hit"] <= 50
        # The share of hits and the probability by another rule: 50 draws are within 0.3 of it but once in ten thousand.
        assert abs(row["draws_hit"] / 50 - row["hit_probability"]) < 0.3
    assert [row["outcome"] for row in table].count("refused") == 1


def wait_for(what: str, holds: Iterator[bool]) -> None:
    """Looks until it holds; the end of patience is far beyond what it takes."""
    end = time.monotonic() + 120
    for held in holds:
        if held:
            return
        assert time.monotonic() < end, what
        time.sleep(0.02)


def test_a_worker_of_dask_is_killed_in_mid_run_and_the_bytes_are_the_same(tmp_path: Path) -> None:
    # All in reach: two milliseconds each.
    grid = ["--x=1.0,1.4,0.01", "--y=-0.1,0.1,0.1", "--z=-1,-0.5,0.05"]
    keywords = {"x_m": [1.0, 1.4, 0.01], "y_m": [-0.1, 0.1, 0.1], "z_m": [-1, -0.5, 0.05], "form": "paper", "fast": True, "starts": 2}
    shards = 24
    whole = cubectl("plan", "sweep", *grid, *FAST, "--shards", str(shards), "--out", str(tmp_path / "whole"))
    assert whole.returncode == 0, whole.stderr
    environment = {**os.environ, "RAYON_NUM_THREADS": "1"}
    with contextlib.ExitStack() as stack:

        def start(*words: str) -> subprocess.Popen[str]:
            log = stack.enter_context((tmp_path / f"{len(started)}.log").open("w"))
            process = subprocess.Popen([sys.executable, *words], env=environment, stdout=log, stderr=log, text=True, cwd=tmp_path)
            started.append(process)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        started: list[subprocess.Popen[str]] = []
        address_file = tmp_path / "scheduler.json"
        start("-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(address_file))
        wait_for("the scheduler", (address_file.exists() for _ in iter(int, 1)))
        words = ["-m", "distributed.cli.dask_worker", "--scheduler-file", str(address_file), "--nthreads", "1", "--no-nanny"]
        first = start(*words, "--no-dashboard")
        start(*words, "--no-dashboard")
        address = json.loads(address_file.read_text())["address"]
        out = tmp_path / "out"
        run = start(str(EXAMPLE), address, str(out), str(shards), json.dumps(keywords))
        # In mid-run: a part is whole, and at least half are not.
        wait_for("a part", (len(list(out.glob("*.csv"))) > 0 for _ in iter(int, 1)))
        first.send_signal(signal.SIGKILL)
        assert len(list(out.glob("*.csv"))) < shards / 2
        assert run.wait(timeout=300) == 0, "\n".join(log.read_text() for log in tmp_path.glob("*.log"))
    assert parts(out) == parts(tmp_path / "whole")
    assert re.fullmatch("[0-9a-f]{8}", cubecell.sweep_summary(out)["crc32"])
