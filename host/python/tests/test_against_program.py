"""The package against the program: the same words give the same files. CUBECTL names the program."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import cubecell
import numpy as np
import pytest

CUBECTL = os.environ["CUBECTL"]


def cubectl(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([CUBECTL, *words], capture_output=True, text=True)


def test_a_hundred_plans_are_those_of_the_program_byte_for_byte() -> None:
    rng = np.random.default_rng(18)
    differ, planned = [], 0
    for number in range(100):
        range_m, angle = rng.uniform(0.5, 2.3), rng.uniform(-np.pi, np.pi)
        target_m = [float(range_m * np.cos(angle)), float(range_m * np.sin(angle)), float(rng.uniform(-1.0, 0.4))]
        form = "best" if number % 2 == 0 else "paper"
        words = ["plan", "throw", "--json", "--robot", "powercube6", "--form", form, "--seed", str(number)]
        words += ["--target=" + ",".join(map(repr, target_m)), "--starts", "2"]
        reported = cubectl(*words)
        try:
            mine = cubecell.plan("powercube6", target_m, form="best" if form == "best" else "paper", seed=number, starts=2)
        except cubecell.CubecellError as error:
            refusal = json.loads(reported.stdout)
            same = reported.returncode == error.exit_code == refusal["code"] and str(error) in reported.stderr
        else:
            planned += 1
            same = reported.returncode == 0 and reported.stdout == mine.json + "\n"
            same = same and (mine.note or "") in reported.stderr
        if not same:
            differ.append((number, target_m, reported.returncode))
    print(f"{planned} of 100 targets were planned, {100 - planned} refused")
    assert not differ
    # Both ways to end are compared.
    assert 50 <= planned < 100


def test_refusals_are_those_of_the_program() -> None:
    cases: list[tuple[list[str], dict[str, Any]]] = [
        (["--jitter-s", "1"], {"jitter_s": 1}),
        (["--opening-normal", "1,0,0"], {"opening_normal": [1, 0, 0]}),
        (["--lag-ms", "5"], {"lag_ms": 5}),
    ]
    for words, options in cases:
        reported = cubectl("plan", "throw", "--target=1,1,-1", *words)
        with pytest.raises(cubecell.CubecellError) as refused:
            cubecell.plan("powercube6", [1.0, 1.0, -1.0], **options)
        assert refused.value.exit_code == reported.returncode != 0
        first = str(refused.value).splitlines()[0].removeprefix("error: ")
        assert first in reported.stderr, (first, reported.stderr)


def test_a_wrong_field_is_refused_by_its_name() -> None:
    cases: list[tuple[dict[str, Any], str]] = [
        ({"no_such_option": 1}, "there is no field `no_such_option`"),
        ({"weights": [1, 2]}, "weights: invalid length 2, expected an array of length 3"),
        ({"starts": "many"}, 'starts: invalid type: string "many", expected usize'),
        ({"form": "round"}, "form: unknown variant `round`, expected `paper` or `best`"),
        ({"target_course": [[1, 2]]}, "target_course: expected 3 numbers separated by commas, got 2"),
        ({"hit_radius_m": 0.1, "hit_box": [0.1, 0.1]}, "`hit_box` and `hit_radius_m` exclude each other"),
        ({"out": "plan.json"}, "there is no field `out`"),
    ]
    for options, text in cases:
        with pytest.raises(cubecell.CubecellError) as refused:
            cubecell.plan("powercube6", [1.0, 1.0, -1.0], **options)
        lines = str(refused.value).splitlines()
        assert refused.value.exit_code == 2 and text in lines[0] and lines[1].startswith("  next: "), lines
    with pytest.raises(ValueError, match="clearance_m: nan is not finite"):
        cubecell.plan("powercube6", [1.0, 1.0, -1.0], clearance_m=float("nan"))


def test_plans_are_read_by_the_program(tmp_path: Path) -> None:
    plan = cubecell.plan("powercube6", [1.0, 1.0, -1.0], fast=True)
    plan.write(tmp_path / "plan.json")
    assert cubecell.Plan.read(tmp_path / "plan.json").json == plan.json
    reported = cubectl("plan", "check", "--json", str(tmp_path / "plan.json"))
    report = cubecell.check(plan)
    assert reported.returncode == 0 and report.ok
    assert all(f'"what": "{finding.what}"' in reported.stdout for finding in report.findings)


def test_gains_are_those_of_the_program(tmp_path: Path) -> None:
    for period_ms, design in ((3.0, "saturated"), (17.0, "paper")):
        out = tmp_path / f"{design}.toml"
        words = ["--period-ms", str(period_ms), "--design", design, "--no-trial", "--out", str(out)]
        assert cubectl("tune", *words).returncode == 0
        gains = cubecell.tune("powercube6", period_ms=period_ms, design="paper" if design == "paper" else "saturated")
        assert gains.toml == out.read_text()
        assert gains.data["period_s"] == period_ms / 1e3 and len(gains.data["joint"]) == 6
    reported = cubectl("tune", "--period-ms=-1.0", "--no-trial")
    with pytest.raises(cubecell.CubecellError) as refused:
        cubecell.tune("powercube6", period_ms=-1.0)
    assert refused.value.exit_code == reported.returncode != 0 and str(refused.value) in reported.stderr


def test_a_log_as_tables_is_the_text_read_by_hand(tmp_path: Path) -> None:
    out = tmp_path / "throw"
    assert cubectl("throw", "--target", "1,1,-1", "--out", str(out)).returncode == 0
    log = cubecell.Log(out)
    lines = (out / "bus.log").read_text().splitlines()
    assert len(log.frames["t_s"]) == len(lines) > 1000 and log.torn is None
    for i in range(0, len(lines), 97):
        stamp, _, frame, *_ = lines[i].split(" ")
        identifier, data = frame.split("#")
        assert abs(log.frames["t_s"][i] - float(stamp.strip("()"))) < 1e-9
        assert log.frames["id"][i] == int(identifier, 16) and log.frames["extended"][i] == (len(identifier) == 8)
        assert log.frames["data"][i, : log.frames["length"][i]].tobytes() == bytes.fromhex(data)
    for table in (log.frames, log.positions, log.currents, log.joints, log.group, log.records):
        assert len({len(column) for column in table.values()}) == 1
    assert set(log.positions["module"]) == set(log.currents["module"]) == {1, 2, 3, 4, 5, 6}
    assert "running" in log.group["state"]
    (out / "bus.log").write_text("\n".join(lines[:50]) + "\n(0000000001.00")
    torn = cubecell.Log(out)
    assert torn.torn is not None and len(torn.frames["t_s"]) == 50
    with pytest.raises(cubecell.CubecellError) as refused:
        cubecell.Log(tmp_path / "missing.log")
    assert refused.value.exit_code == 4
