"""Moves and time laws of the package beside independent programs; prints the tables of docs/measured/moving.md.

    compare.py [--moves N] [--paths N] [--points N] [--seed S]

`--moves` counts per scene. Ends with code 1 if the package calls a move impossible that OMPL finds, if MuJoCo sees a contact on one of
its motions, or if a duration is above the bound that stands at its row.
"""

import argparse
import importlib.metadata
import pathlib
import time

import cubecell
import independent
import numpy as np
import ompl_ways
import scenes
import times

ROBOTS = pathlib.Path(__file__).parents[2] / "robots"
SHARE = 0.2
# Time for one search of OMPL, s.
LIMIT_S = 10.0
# Bodies that MuJoCo has deeper in each other than this count as touching, m.
DEPTH_M = 1e-6
wrong = []


def check(holds, what):
    if not holds:
        wrong.append(what)
        print(f"WRONG: {what}")


def percentile(values, share):
    return float(np.percentile(values, share)) if len(values) else float("nan")


def touching(contacts, way):
    """Deepest contact over a motion, at each ms, m."""
    return min(contacts.touch(q_rad) for q_rad in way.sample(step_s=1e-3).q_rad)


def moves(count, seed):
    robot = cubecell.Robot("powercube6")
    ompl_ways.seed(seed)
    print(
        "| scene | moves | found | OMPL | not straight | CPU p50, p99, ms | OMPL | duration p50, s | OMPL | ratio p50, p95, largest | contact |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    total = Counted()
    for number, (name, boxes) in enumerate(scenes.SCENES.items()):
        around = cubecell.Surroundings(robot, boxes)
        contacts = independent.Contacts(ROBOTS / "powercube6.toml", boxes)
        planner = ompl_ways.Planner(robot, around)
        counted = Counted()
        for k, (start, goal) in enumerate(scenes.moves(robot, around, np.random.default_rng([seed, number]), count)):
            begun = time.process_time()
            try:
                way = around.way(start, goal, speed_share=SHARE)
            except cubecell.CubecellError:
                way = None
            between = time.process_time()
            corners = planner.corners(start, goal, LIMIT_S)
            theirs = None if corners is None else around.through(corners, speed_share=SHARE)
            counted.add(way, theirs, around.is_free_line(start, goal), between - begun, time.process_time() - between)
            check(way is not None or theirs is None, f"{name}, move {k}: only OMPL finds a way")
            if way is not None:
                deepest = touching(contacts, way)
                counted.in_contact += deepest < -DEPTH_M
                check(deepest >= -DEPTH_M, f"{name}, move {k}: MuJoCo has bodies {-1e3 * deepest:.3f} mm in each other")
        counted.print(name)
        total.extend(counted)
    total.print("all")


class Counted:
    """What came of moves; times and ratios are of those whose line is not free and for which both found a way."""

    def __init__(self):
        self.moves = self.found = self.found_ompl = self.around = self.in_contact = 0
        self.cpu_ms, self.cpu_ompl_ms, self.took_s, self.took_ompl_s, self.ratios = [], [], [], [], []

    def add(self, way, theirs, is_straight, cpu_s, cpu_ompl_s):
        self.moves += 1
        self.found += way is not None
        self.found_ompl += theirs is not None
        if is_straight or way is None or theirs is None:
            return
        self.around += 1
        self.cpu_ms.append(1e3 * cpu_s)
        self.cpu_ompl_ms.append(1e3 * cpu_ompl_s)
        self.took_s.append(way.duration_s)
        self.took_ompl_s.append(theirs.duration_s)
        self.ratios.append(way.duration_s / theirs.duration_s)

    def extend(self, other):
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    def print(self, name):
        def two(values):
            return f"{percentile(values, 50):.0f}, {percentile(values, 99):.0f}" if values else "–"

        ratios = self.ratios
        ratio = f"{percentile(ratios, 50):.2f}, {percentile(ratios, 95):.2f}, {max(ratios):.2f}" if ratios else "–"
        took = [f"{percentile(values, 50):.2f}" if values else "–" for values in (self.took_s, self.took_ompl_s)]
        print(
            f"| {name} | {self.moves} | {self.found} | {self.found_ompl} | {self.around} | {two(self.cpu_ms)} | {two(self.cpu_ompl_ms)} | "
            f"{took[0]} | {took[1]} | {ratio} | {self.in_contact} |",
            flush=True,
        )


def row(what, ratios, cpu, cpu_other, bound):
    """A line of the table of durations, and its check: the median and the largest ratio that are allowed."""
    median, largest = percentile(ratios, 50), max(ratios)
    print(
        f"| {what} | {len(ratios)} | {median:.4f} | {percentile(ratios, 95):.4f} | {largest:.4f} | "
        f"{percentile(cpu, 50):.2f} | {percentile(cpu_other, 50):.2f} |",
        flush=True,
    )
    if bound is not None:
        check(median <= bound[0] and largest <= bound[1], f"{what}: median {median:.4f}, largest {largest:.4f}")


def durations(paths, points, seed):
    print("| compared with | cases | ratio p50 | p95 | largest | CPU p50, ms | theirs |")
    print("|---|---|---|---|---|---|---|")
    robot = cubecell.Robot("powercube6")
    rng = np.random.default_rng([seed, 100])
    ratios, cpu, cpu_other = [], [], []
    limits = (robot.qd_max_rad_s, robot.qdd_max_rad_s2)
    for _ in range(paths):
        drawn, blend_rad = times.path_case(robot, rng)
        way, took_s = times.ours(robot, drawn, limits, blend_rad)
        other_s, _, other_took_s = times.with_toppra(robot, drawn, blend_rad)
        check(times.excess(way, limits) <= 1 + 1e-6, "a motion exceeds its limits")
        ratios.append(way.duration_s / other_s)
        cpu.append(1e3 * took_s)
        cpu_other.append(1e3 * other_took_s)
    row("toppra, rounded paths, no jerk limit", ratios, cpu, cpu_other, (1.02, 1.10))
    for source in ("powercube6", "kr16_2", "pincher4"):
        robot = cubecell.Robot(source)
        limits = (robot.qd_max_rad_s, robot.qdd_max_rad_s2, robot.qddd_max_rad_s3)
        lines(robot, f"ruckig, {source}", points, seed, lambda _: limits, (1.02, 1.10))
    robot = cubecell.Robot("powercube6")
    own = (robot.qd_max_rad_s, robot.qdd_max_rad_s2, robot.qddd_max_rad_s3)
    lines(robot, "ruckig, limits drawn", points, seed, lambda rng: [limit * rng.uniform(0.3, 3.0, limit.shape) for limit in own], None)


def lines(robot, what, count, seed, limits_of, bound):
    """From rest to rest against ruckig: each joint as fast as it can and all together at the end, and on a line."""
    rng = np.random.default_rng([seed, 200])
    ratios, on_line, cpu, cpu_other = [], [], [], []
    for _ in range(count):
        start, goal = rng.uniform(robot.q_min_rad, robot.q_max_rad, (2, len(robot.joint_names)))
        limits = limits_of(rng)
        way, took_s = times.ours(robot, [start, goal], limits)
        other_s, other_took_s = times.with_ruckig(start, goal, limits)
        check(times.excess(way, limits) <= 1 + 1e-6, f"{what}: a motion exceeds its limits")
        ratios.append(way.duration_s / other_s)
        on_line.append(way.duration_s / times.with_ruckig_on_line(start, goal, limits))
        cpu.append(1e3 * took_s)
        cpu_other.append(1e3 * other_took_s)
    row(what, ratios, cpu, cpu_other, bound)
    # A piece that is shorter than a controller takes is one with its neighbour, which costs a little.
    # Limits that are drawn make pieces shorter than a controller takes, which are one with their neighbours.
    row(f"{what}, on a line", on_line, cpu, cpu_other, (1.001, 1.001 if bound else 1.01))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moves", type=int, default=100)
    parser.add_argument("--paths", type=int, default=200)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    used = ("ompl", "mujoco", "toppra", "ruckig")
    print(", ".join(f"{name} {importlib.metadata.version(name)}" for name in used) + f"; seed {args.seed}\n")
    if args.moves:
        moves(args.moves, args.seed)
        print()
    durations(args.paths, args.points, args.seed)
    raise SystemExit(f"{len(wrong)} checks failed" if wrong else 0)


if __name__ == "__main__":
    main()
