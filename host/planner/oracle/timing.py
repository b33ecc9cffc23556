"""Compares durations of the planner with those of toppra (paths, without jerk) and ruckig (lines, phase synchronised).

    cargo run --release -p planner --example timing -- 200 1000 > timing.jsonl
    python host/planner/oracle/timing.py timing.jsonl

Fails where a motion is shorter than the optimum by more than 0.5 % (then it breaks a limit), or where the median or the largest ratio
is above what the page docs/measured/timing.md states.
"""

import json
import sys
import time

import numpy as np
import ruckig
import toppra
import toppra.algorithm
import toppra.constraint

toppra.setup_logging("ERROR")


def of_toppra(row):
    path = toppra.SplineInterpolator(np.array(row["s"]), np.array(row["q"]))
    limits = [
        toppra.constraint.JointVelocityConstraint(np.array([[-v, v] for v in row["v"]])),
        toppra.constraint.JointAccelerationConstraint(np.array([[-a, a] for a in row["a"]])),
    ]
    begun = time.process_time()
    grid = np.linspace(0, row["s"][-1], len(row["s"]))
    found = toppra.algorithm.TOPPRA(limits, path, gridpoints=grid, parametrizer="ParametrizeConstAccel")
    motion = found.compute_trajectory(0, 0)
    return motion.duration, time.process_time() - begun


def of_ruckig(row):
    joints = len(row["from"])
    given = ruckig.InputParameter(joints)
    given.current_position, given.target_position = row["from"], row["to"]
    given.max_velocity, given.max_acceleration, given.max_jerk = row["v"], row["a"], row["j"]
    given.synchronization = ruckig.Synchronization.Phase
    begun = time.process_time()
    motion = ruckig.Trajectory(joints)
    if ruckig.Ruckig(joints).calculate(given, motion) != ruckig.Result.Working:
        raise SystemExit(f"ruckig finds no motion: {row['from']} {row['to']}")
    return motion.duration, time.process_time() - begun


def table(name, ratios, ours, theirs):
    low, median, high = np.min(ratios), np.median(ratios), np.max(ratios)
    print(f"{name}: {len(ratios)} motions, duration ratio least {low:.4f}, median {median:.4f}, largest {high:.4f}; "
          f"CPU {1e3 * np.median(ours):.3f} ms against {1e3 * np.median(theirs):.3f} ms")
    return low, median, high


def main(file):
    paths, lines, jerk = [], [], []
    for text in open(file):
        row = json.loads(text)
        if row["kind"] == "path":
            best, took = of_toppra(row)
            paths.append((row["without_jerk"][0] / best, row["took_s"], took))
            jerk.append((row["with_jerk"][0] / best, row["with_jerk"][1], row["took_jerk_s"]))
        else:
            best, took = of_ruckig(row)
            lines.append((row["duration_s"] / best, row["took_s"], took))
    low, median, high = table("paths against toppra, no jerk limit", *zip(*paths))
    ratios, knots, took = zip(*jerk)
    print(f"the same paths with a jerk limit: ratio median {np.median(ratios):.3f}, largest {np.max(ratios):.3f}; knots median "
          f"{np.median(knots):.0f}, most {max(knots)}; CPU {1e3 * np.median(took):.1f} ms, 99 % {1e3 * np.quantile(took, 0.99):.1f} ms")
    low_line, median_line, high_line = table("lines against ruckig, with jerk limit", *zip(*lines))
    good = min(low, low_line) > 0.995 and median <= 1.02 and high <= 1.10 and median_line <= 1.02 and high_line <= 1.10
    if not good:
        raise SystemExit("a ratio is not what docs/measured/timing.md states")


main(*sys.argv[1:])
