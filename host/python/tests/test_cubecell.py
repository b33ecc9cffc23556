"""The package against closed forms, and against itself."""

import json
from pathlib import Path

import cubecell
import numpy as np
import pytest

TARGET_M = [1.0, 1.0, -1.0]


@pytest.fixture(scope="module")
def plan() -> cubecell.Plan:
    return cubecell.plan("powercube6", TARGET_M, fast=True)


def test_a_plan_that_is_tampered_with_fails_the_check(plan: cubecell.Plan) -> None:
    assert cubecell.check(plan).ok
    data = json.loads(plan.json)
    data["target"]["position_m"][0] += 0.02
    wrong = cubecell.check(cubecell.Plan(json.dumps(data)))
    assert not wrong.ok and "landing on the target" in [f.what for f in wrong.findings if f.enforced and not f.ok]
    with pytest.raises(cubecell.CubecellError, match="is for robot"):
        cubecell.check(cubecell.Plan(plan.json, robot="kr16_2"))


def test_a_plan_is_sampled_within_the_limits(plan: cubecell.Plan) -> None:
    robot = cubecell.Robot("powercube6")
    motion = plan.sample(step_s=1e-3)
    assert motion.q_rad.shape == (len(motion.t_s), 6)
    assert np.all(motion.q_rad >= robot.q_min_rad) and np.all(motion.q_rad <= robot.q_max_rad)
    assert np.all(np.abs(motion.qd_rad_s) <= robot.qd_max_rad_s * (1 + 1e-6))
    # Positions and speeds belong together: a difference of positions is the mean speed.
    speed = np.diff(motion.q_rad[:-1], axis=0) / np.diff(motion.t_s[:-1])[:, None]
    middle = plan.sample((motion.t_s[1:-1] + motion.t_s[:-2]) / 2).qd_rad_s
    assert np.abs(speed - middle).max() < 1e-3
    motion.q_rad[0, 0] = 0.0  # Arrays belong to the user.
    with pytest.raises(ValueError, match="finite"):
        plan.sample([0.0, np.nan])


def test_the_ball_leaves_the_hand_where_the_plan_says_and_flies_to_the_target(plan: cubecell.Plan) -> None:
    robot = cubecell.Robot("powercube6")
    release = plan.data["release"]
    hand_m = robot.hand(plan.sample(plan.release_time_s).q_rad)[0, :3, 3]
    assert np.allclose(hand_m, release["position_m"], atol=1e-9)
    before, after = (robot.hand(plan.sample(plan.release_time_s + dt).q_rad)[0, :3, 3] for dt in (-1e-5, 1e-5))
    assert np.allclose((after - before) / 2e-5, release["velocity_m_s"], atol=1e-4)
    met = cubecell.landing(hand_m, release["velocity_m_s"], TARGET_M[2], gravity_m_s2=robot.gravity_m_s2)
    assert met is not None and np.linalg.norm(met[0] - TARGET_M) < 1e-4


def test_simulated_throws_land_and_repeat(plan: cubecell.Plan) -> None:
    runs = [cubecell.simulate(plan, seed=seed) for seed in (1, 1, 2)]
    landings_m = []
    for run in runs:
        assert run.outcome == "landed" and run.error is None and run.landing_m is not None
        assert np.linalg.norm(run.landing_m - TARGET_M) < run.tolerance_m
        assert run.analysis is not None and len(run.analysis["joints"]) == 6
        landings_m.append(run.landing_m)
    assert np.array_equal(landings_m[0], landings_m[1])
    assert not np.array_equal(landings_m[0], landings_m[2])


def test_gains_and_faults_reach_the_simulated_cell(plan: cubecell.Plan, tmp_path: Path) -> None:
    gains = cubecell.tune("powercube6", period_ms=5.0)
    with_gains, without = cubecell.simulate(plan, gains=gains), cubecell.simulate(plan)
    assert with_gains.outcome == "landed"
    assert with_gains.landing_m is not None and without.landing_m is not None
    assert not np.array_equal(with_gains.landing_m, without.landing_m)
    gains.write(tmp_path / "gains.toml")
    assert cubecell.Gains.read(tmp_path / "gains.toml") == gains
    changed = cubecell.Gains(gains.toml.replace("k_pos_1_s2 = -", "k_pos_1_s2 = -9"))
    assert changed != gains
    with pytest.raises(cubecell.CubecellError):
        cubecell.simulate(plan, gains=changed)
    scenarios = Path(__file__).parents[3] / "hil-sim" / "scenarios"
    run = cubecell.simulate(plan, scenario=scenarios / "silent_joint.toml")
    assert run.outcome in ("stopped", "not_thrown") and run.error is not None


def test_a_flight_without_drag_is_a_parabola_and_with_drag_is_shorter() -> None:
    t = np.linspace(0.0, 1.0, 11)
    p, v = np.array([0.1, 0.2, 1.0]), np.array([2.0, -1.0, 3.0])
    flight = cubecell.fly(p, v, t)
    assert np.allclose(flight.position_m, p + v * t[:, None] - 0.5 * 9.81 * np.array([0, 0, 1]) * t[:, None] ** 2, atol=1e-12)
    assert np.allclose(flight.velocity_m_s, v - 9.81 * np.array([0, 0, 1]) * t[:, None], atol=1e-12)
    free, slowed = cubecell.landing(p, v, 0.0), cubecell.landing(p, v, 0.0, drag_per_m=0.1)
    assert free is not None and slowed is not None
    assert np.linalg.norm(slowed[0][:2] - p[:2]) < np.linalg.norm(free[0][:2] - p[:2])
    assert cubecell.landing([0, 0, 0], [0, 0, -1], 1.0) is None
    with pytest.raises(cubecell.CubecellError, match="drag"):
        cubecell.fly(p, v, t, drag_per_m=-1.0)


def test_robots_of_other_sizes_and_wrong_shapes() -> None:
    four = cubecell.Robot("pincher4")
    assert len(four.joint_names) == 4 and four.hand(np.zeros((5, 4))).shape == (5, 4, 4)
    hand = four.hand(np.zeros(4))
    assert hand.shape == (4, 4) and np.allclose(hand[:3, :3] @ hand[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.allclose(hand[3], [0, 0, 0, 1])
    assert four.gravity_torques(np.zeros((3, 4))).shape == (3, 4)
    with pytest.raises(ValueError, match="has 4 joints"):
        four.hand(np.zeros(6))
    with pytest.raises(ValueError, match="three numbers"):
        cubecell.plan(four, [1.0, 2.0])
    with pytest.raises(cubecell.CubecellError, match="no_such_robot") as refused:
        cubecell.Robot("no_such_robot")
    assert refused.value.exit_code == 4


def test_the_package_is_typed() -> None:
    folder = Path(cubecell.__file__).parent
    assert (folder / "py.typed").is_file() and (folder / "_native.pyi").is_file()
