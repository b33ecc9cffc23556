"""Throws that follow the flight: the package against the program, and plans against closed forms."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import cubecell
import numpy as np
import pytest

CUBECTL = os.environ["CUBECTL"]
TARGET_M = [2.5, 0.0, 0.6]


def cubectl(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([CUBECTL, *words], capture_output=True, text=True)


def timeless(plan: dict[str, Any]) -> dict[str, Any]:
    """A plan without the time that its search took."""
    return {**plan, "search": {**plan["search"], "time_s": 0.0}}


@pytest.fixture(scope="module")
def plan() -> cubecell.FollowPlan:
    return cubecell.plan_follow("kr16_2", TARGET_M, starts=4)


def test_plans_are_those_of_the_program(plan: cubecell.FollowPlan) -> None:
    reported = cubectl("plan", "throw", "--robot", "kr16_2", "--target=2.5,0.0,0.6", "--starts", "4", "--json")
    assert reported.returncode == 0, reported.stderr
    assert timeless(json.loads(reported.stdout)) == timeless(plan.data)
    words = ["--robot", "powercube6", "--follow", "--target=1.2,0.0,-0.5", "--seed", "3", "--starts", "4", "--lag-ms", "10"]
    reported = cubectl("plan", "throw", *words, "--json")
    mine = cubecell.plan_follow("powercube6", [1.2, 0.0, -0.5], seed=3, starts=4, lag_ms=10, follow=True)
    assert reported.returncode == 0, reported.stderr
    assert timeless(json.loads(reported.stdout)) == timeless(mine.data)


def test_refusals_are_those_of_the_program() -> None:
    cases: list[tuple[list[float], list[str], dict[str, Any]]] = [
        ([9.0, 0.0, 0.6], ["--starts", "2"], {"starts": 2}),
        (TARGET_M, ["--fast"], {"fast": True}),
        (TARGET_M, ["--tilt-max-deg", "90"], {"tilt_max_deg": 90}),
        (TARGET_M, ["--drag-per-m", "0.1"], {"drag_per_m": 0.1}),
    ]
    for target_m, words, options in cases:
        target = "--target=" + ",".join(map(str, target_m))
        reported = cubectl("plan", "throw", "--robot", "kr16_2", target, *words)
        with pytest.raises(cubecell.CubecellError) as refused:
            cubecell.plan_follow("kr16_2", target_m, **options)
        assert refused.value.exit_code == reported.returncode != 0
        assert str(refused.value).removeprefix("error: ").splitlines()[0] in reported.stderr, reported.stderr
    with pytest.raises(cubecell.CubecellError, match="ask for `follow`"):
        cubecell.plan_follow("powercube6", [1.0, 1.0, -1.0])
    with pytest.raises(cubecell.CubecellError, match="has 4 joints"):
        cubecell.plan_follow("pincher4", [1.0, 1.0, -1.0])
    with pytest.raises(cubecell.CubecellError, match="plan_follow"):
        cubecell.plan("kr16_2", TARGET_M)
    with pytest.raises(ValueError, match="does not follow"):
        cubecell.FollowPlan(cubecell.plan("powercube6", [1.0, 1.0, -1.0], fast=True).json)


def test_the_check_is_that_of_the_program_and_finds_what_was_changed(plan: cubecell.FollowPlan, tmp_path: Path) -> None:
    plan.write(tmp_path / "plan.json")
    assert cubecell.FollowPlan.read(tmp_path / "plan.json").json == plan.json
    reported = cubectl("plan", "check", "--json", str(tmp_path / "plan.json"))
    report = cubecell.check(plan)
    assert reported.returncode == 0 and report.ok
    assert json.loads(reported.stdout) == {"good": True, **report.__dict__}
    data = json.loads(plan.json)
    data["steps"][plan.data["window"][0] + 1]["q_rad"][1] += 0.01
    wrong = cubecell.check(cubecell.FollowPlan(json.dumps(data)))
    assert not wrong.ok and any("off its parabola" in finding for finding in wrong.findings)
    with pytest.raises(cubecell.CubecellError, match="is for robot"):
        cubecell.check(cubecell.FollowPlan(plan.json, robot="powercube6"))


def test_a_ball_that_leaves_anywhere_on_the_window_flies_to_the_target(plan: cubecell.FollowPlan) -> None:
    robot = cubecell.Robot("kr16_2")
    points = plan.set_points
    followed = points.phase == "follow"
    assert np.count_nonzero(followed) == plan.followed_points >= 3
    assert np.allclose(np.diff(points.t_s), 0.012, atol=1e-12)
    motion = plan.sample(points.t_s)
    assert np.allclose(motion.q_rad, points.q_rad, atol=1e-12) and np.allclose(motion.qd_rad_s, points.qd_rad_s, atol=1e-12)
    assert points.t_s[followed][0] <= plan.release_time_s <= points.t_s[followed][-1]
    for t_s in points.t_s[followed]:
        # Speeds of the hand by differences of its places: nothing that the planner differentiates.
        before, at, after = (robot.hand(plan.sample(t_s + dt).q_rad)[0, :3, 3] for dt in (-1e-5, 0.0, 1e-5))
        met = cubecell.landing(at, (after - before) / 2e-5, TARGET_M[2], gravity_m_s2=robot.gravity_m_s2)
        assert met is not None and np.linalg.norm(met[0] - TARGET_M) < 5e-3
    assert np.all(motion.q_rad >= robot.q_min_rad) and np.all(motion.q_rad <= robot.q_max_rad)


def test_simulated_throws_are_those_of_the_program(plan: cubecell.FollowPlan, tmp_path: Path) -> None:
    plan.write(tmp_path / "plan.json")
    out = tmp_path / "throw"
    words = ["--robot", "kr16_2", "--plan", str(tmp_path / "plan.json"), "--seed", "1", "--out", str(out)]
    reported = cubectl("throw", *words)
    summary = json.loads((out / "summary.json").read_text())
    del summary["command_line"]
    run = cubecell.simulate_follow(plan, seed=1)
    assert run.summary == summary and reported.returncode == summary["exit_code"] == 0, reported.stderr
    assert run.outcome == "landed" and run.landing_m is not None and run.miss_m is not None
    assert abs(np.linalg.norm(run.landing_m[:2] - TARGET_M[:2]) - run.miss_m) < 1e-12
    table = np.loadtxt(out / "motion.csv", delimiter=",", skiprows=1)
    assert len(table) == len(run.t_s) and run.plan_started_s is not None
    # The axes come late behind their set points, and stand where they were sent.
    assert np.abs(run.actual_rad - run.set_rad).max() > 1e-3
    assert np.abs(run.actual_rad[-1] - run.set_rad[-1]).max() < 1e-4
    led = cubecell.plan_follow("kr16_2", TARGET_M, starts=4, lag_ms=24)
    late = cubecell.simulate_follow(led, tolerance_m=1e-6)
    assert late.outcome == "missed" and late.summary["exit_code"] == 11
