"""Catches: the package against the program, and the results against their witnesses."""

import json
import math
import os
import subprocess
from typing import Any

import cubecell
import numpy as np
import pytest

CUBECTL = os.environ["CUBECTL"]
BALL = [2.2, 0.1, 0.4, -2.6, -0.1, 3.0]


def cubectl(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([CUBECTL, *words], capture_output=True, text=True)


def ball_words(ball: list[float], *words: str) -> list[str]:
    return ["catch", "--ball=" + ",".join(map(repr, ball)), *words, "--json"]


def same(mine: Any, data: Any) -> bool:
    """Equal, where an array is a list and `nan` is null."""
    if isinstance(mine, np.ndarray):
        mine = mine.tolist()
    if isinstance(data, list):
        return len(mine) == len(data) and all(map(same, mine, data))
    return mine == data or (data is None and isinstance(mine, float) and math.isnan(mine))


@pytest.mark.parametrize("options", [{}, {"hand": "hold", "seed": 7}, {"jerk": True}, {"fault": ["tracker-dead:0.1"]}])
def test_a_trial_is_that_of_the_program(options: dict[str, Any]) -> None:
    words = ["--jerk"] if options.get("jerk") else []
    words += [f"--fault={fault}" for fault in options.get("fault", [])]
    words += [f"--{name}={options[name]}" for name in ("hand", "seed") if name in options]
    data = cubectl(*ball_words(BALL, *words))
    mine = cubecell.catch_ball(BALL[:3], BALL[3:], **options)
    assert mine.exit_code == data.returncode
    theirs = json.loads(data.stdout)
    assert (mine.reported, mine.caught) == (theirs["reported"], theirs["caught"])
    assert (mine.crossing is None) == (theirs["crossing"] is None) and (mine.choice is None) == (theirs["choice"] is None)
    for name, value in (theirs["crossing"] or {}).items():
        assert getattr(mine.crossing, name) == value
    for name, value in (theirs["choice"] or {}).items():
        assert same(getattr(mine.choice, name), value), name
    assert len(mine.decisions.decision) == len(theirs["decisions"])
    for name in ("after_release_s", "decision", "probability", "sigma_m", "off_m", "judged"):
        assert same(getattr(mine.decisions, name), [decision[name] for decision in theirs["decisions"]]), name
    assert mine.limits == theirs["limits"] and mine.refusals == theirs["refusals"] and mine.within_limits


def test_the_word_of_the_witness_is_where_the_ball_lies() -> None:
    caught = cubecell.catch_ball(BALL[:3], BALL[3:])
    assert caught.caught and caught.reported == "caught" and caught.exit_code == 0 and caught.choice is not None
    trace, choice = caught.trace, caught.choice
    # The ball flies freely until the catch, in the frame of the arm as it was asked for.
    flying = (trace.after_release_s > 0.0) & (trace.after_release_s < choice.after_release_s - 0.05)
    ball_m = (trace.ball_m[flying] - caught.base[:3, 3]) @ caught.base[:3, :3]
    # The planner's flight, with the drag of the cell file; the cell steps by itself, in milliseconds.
    flight = cubecell.fly(BALL[:3], BALL[3:], trace.after_release_s[flying], drag_per_m=0.0284)
    assert np.abs(ball_m - flight.position_m).max() < 1e-3
    # At the end it lies in the cup; the mouth is a cup's depth above it.
    assert np.linalg.norm(trace.ball_m[-1] - trace.mouth_m[-1]) < 0.1
    assert any(event["event"] == "rests in the cup" and event["arm"] == "catcher" for event in caught.events)
    # The motion ends at rest and passes the catch as it says.
    motion = choice.motion
    assert np.abs(motion.qd_rad_s[-1]).max() < 1e-9
    at = [np.interp(choice.after_release_s, motion.t_s, motion.q_rad[:, joint]) for joint in range(6)]
    assert np.abs(np.array(at) - choice.q_rad).max() < 1e-3
    declined = cubecell.catch_ball([5.0, 5.0, 0.4], [1.0, 1.0, 3.0])
    assert not declined.caught and declined.reported.startswith("declined") and declined.exit_code == 3 and declined.choice is None
    assert "next:" in declined.text


def test_a_disc_is_caught_as_the_program_does() -> None:
    data = cubectl("catch", "--start=0.5,-1.0,1.2", "--velocity=0.0,4.0,0.0", "--json")
    mine = cubecell.catch_disc([0.5, -1.0, 1.2], [0.0, 4.0, 0.0])
    theirs = json.loads(data.stdout)
    assert data.returncode == mine.exit_code == 0 and mine.plan is not None and mine.rule is not None
    for of, name in ((mine.plan, "plan"), (mine.rule, "rule")):
        for key, value in theirs[name].items():
            if key == "witness":
                for word, seen in value.items():
                    assert same(getattr(of.witness, word), seen), (name, word)
            else:
                assert same(list(getattr(of, key)) if key == "waits_s" else getattr(of, key), value), (name, key)
    plan, flight = mine.plan, mine.flight
    assert plan.witness.caught and not plan.witness.touched
    arm = cubecell.Robot("pincher4")
    assert np.all(np.abs(plan.motion.qd_rad_s) <= arm.qd_max_rad_s * (1 + 1e-9))
    parabola = np.array([0.5, -1.0, 1.2]) + np.array([0.0, 4.0, 0.0]) * flight.t_s[:, None]
    parabola[:, 2] -= 0.5 * arm.gravity_m_s2 * flight.t_s**2
    assert np.abs(flight.position_m - parabola).max() < 2e-3
    at = [np.interp(plan.t_s, plan.motion.t_s, plan.motion.q_rad[:, joint]) for joint in range(4)]
    assert np.abs(np.array(at) - plan.q_rad).max() < 5e-3


def test_a_disc_that_cannot_be_caught_is_a_result_and_wrong_input_is_refused() -> None:
    fast = cubecell.catch_disc([0.5, -2.6, 0.7], [0.0, 12.0, 1.0])
    assert fast.plan is None and fast.declined is not None and fast.exit_code == 3 and "next:" in fast.text
    alone = cubecell.catch_disc([0.5, -1.0, 1.05], [-2.0, 4.0, 1.0], no_limits=True)
    assert alone.plan is None and alone.declined is None and alone.rule is not None and alone.rule.captured_step == 42
    air = cubecell.catch_disc([0.5, -2.2, 0.7], [0.0, 3.8, 1.5], air=True, wind=[0.5, 0.0, 0.0], spin_rad_s=40.0)
    assert air.rule is None
    for call, code in (
        (lambda: cubecell.catch_disc([0.5, -1.0, -1.0], [0.0, 4.0, 0.0]), 4),
        (lambda: cubecell.catch_disc([0.5, -1.0, 1.0], [0.0, 4.0, 0.0], robot="powercube6"), 4),
        (lambda: cubecell.catch_disc([0.5, -1.0, 1.0], [0.0, 4.0, 0.0], wind=[1, 0, 0]), 4),
        (lambda: cubecell.catch_ball([50.0, 0.0, 0.0], [0.0, 0.0, 0.0]), 4),
        (lambda: cubecell.catch_ball(BALL[:3], BALL[3:], fault=["rain"]), 2),
        (lambda: cubecell.catch_ball(BALL[:3], BALL[3:], robot="pincher4"), 4),
        (lambda: cubecell.catch_ball(BALL[:3], BALL[3:], step_s=0.0), 4),
        (lambda: cubecell.catch_ball(BALL[:3], BALL[3:], cell="no/such/cell.toml"), 4),
    ):
        with pytest.raises(cubecell.CubecellError) as refused:
            call()
        assert refused.value.exit_code == code, refused.value
