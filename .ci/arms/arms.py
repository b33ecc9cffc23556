"""Public arms from their URDF files: import, check, move, and throws at drawn targets; prints the table of docs/measured/arms.md.

    arms.py CUBECTL ROBOTS OUT [--targets N] [--arm NAME ...]

ROBOTS is the folder `robots` of the package example-robot-data. Every throw that lands within its tolerance counts; a target that no
throw reaches counts as refused. Anything else is named, and the program ends with code 1.
"""

import argparse
import concurrent.futures
import json
import math
import pathlib
import random
import re
import subprocess
import sys
import time
import tomllib

# Name, URDF file, words of the import. No values of an arm are given: whatever is missing is the importer's to fill in.
ARMS = [
    ("ur3", "ur_description/urdf/ur3_robot.urdf", []),
    ("ur5", "ur_description/urdf/ur5_robot.urdf", []),
    ("ur10", "ur_description/urdf/ur10_robot.urdf", []),
    ("ur3 with gripper", "ur_description/urdf/ur3_gripper.urdf", []),
    ("ur5 with gripper", "ur_description/urdf/ur5_gripper.urdf", []),
    ("panda", "panda_description/urdf/panda.urdf", []),
    ("kinova j2s6s200", "kinova_description/robots/kinova.urdf", []),
    ("xarm7", "xarm_description/urdf/xarm7.urdf", []),
    ("z1", "z1_description/urdf/z1.urdf", []),
    ("so100", "so_arm_description/urdf/so100.urdf", []),
    ("so100, four joints", "so_arm_description/urdf/so100.urdf", ["--end-effector", "wrist"]),
    ("so101", "so_arm_description/urdf/so101.urdf", []),
    ("talos, left arm", "talos_data/robots/talos_left_arm.urdf", []),
]


def run(words):
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def targets(robot, number):
    """Drawn around the arm: from a third to one time its length away, from the floor (at most a length below) up to a third of it."""
    file = tomllib.loads(robot.read_text())
    lengths = [math.dist((0, 0, 0), joint["frame"]["xyz_m"]) for joint in file["joint"][1:]]
    length = sum(lengths) + math.dist((0, 0, 0), file["gripper"]["release_origin_m"])
    draw = random.Random(1)
    low = max(file["world"]["floor_z_m"], -length)
    for _ in range(number):
        away, angle = draw.uniform(0.4, 1.0) * length, math.radians(draw.uniform(-90, 90))
        yield away * math.cos(angle), away * math.sin(angle), draw.uniform(low + 0.05, max(low + 0.1, length / 3))


def throw(cubectl, robot, target, out):
    began = time.monotonic()
    point = ",".join(f"{v:.3f}" for v in target)
    code, said = run([cubectl, "throw", "--robot", robot, "--target", point, "--out", out])
    took = time.monotonic() - began
    if code == 0:
        return "thrown", took, json.loads((out / "summary.json").read_text())["landing_error_m"]
    if "no throw reaches" in said:
        blocked = re.search(r"blocked by: (.*)", said)
        return "out of reach" + (f" ({blocked[1]})" if blocked else ""), took, None
    return f"{point}: {said.strip().splitlines()[-1] if said.strip() else code}: {said[-600:]}", took, None


def row(cubectl, robots, out, name, urdf, words, number):
    folder = out / re.sub(r"\W+", "-", name)
    folder.mkdir(parents=True, exist_ok=True)
    robot = folder / "arm.toml"
    wrong = []
    code, said = run([cubectl, "robot", "import", robots / urdf, "--out", robot, "--force", *words])
    (folder / "import.txt").write_text(said)
    if code != 0:
        return f"| {name} | import: {said.strip()} | | | | |", [f"{name}: {said}"]
    joints = re.search(r"(\d+) joints", said)[1]
    boxes = robot.read_text().count("center_m")
    code, said = run([cubectl, "robot", "check", robot])
    (folder / "check.txt").write_text(said)
    # Values are assumed, so there is something to look at.
    if code != 9 or "to plan and to simulate" not in said:
        wrong.append(f"{name}: check: {code}: {said[-400:]}")
    implausible = re.search(r"(\d+) values are implausible", said)
    code, said = run([cubectl, "move", "--robot", robot, "--by", "1=+20deg,2=-10deg", "--home"])
    moved = "yes" if code == 0 else "no"
    if code != 0:
        wrong.append(f"{name}: move: {said[-600:]}")
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        todo = enumerate(targets(robot, number))
        thrown = list(pool.map(lambda job: throw(cubectl, robot, job[1], folder / f"throw-{job[0]}-{time.time_ns()}"), todo))
    landed = [error for what, _, error in thrown if what == "thrown"]
    beyond = [what for what, _, _ in thrown if what.startswith("out of reach")]
    others = [what for what, _, _ in thrown if what != "thrown" and not what.startswith("out of reach")]
    wrong += [f"{name}: {what}" for what in others]
    times = sorted(took for _, took, _ in thrown)
    worst = f"{1e3 * max(landed):.1f}" if landed else "–"
    return (
        f"| {name} | {joints} | {boxes} | {implausible[1] if implausible else '–'} | {moved} | {len(landed)} | {len(beyond)} "
        f"| {len(others)} | {worst} | {times[len(times) // 2]:.0f} |",
        wrong,
    )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("cubectl", type=pathlib.Path)
    parser.add_argument("robots", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--targets", type=int, default=20)
    parser.add_argument("--arm", action="append", dest="arms", help="only this one; may be given several times")
    args = parser.parse_args()
    print("| arm | joints | boxes | implausible | moved | landed | out of reach | other | largest miss, mm | median time, s |")
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    wrong = []
    for name, urdf, words in ARMS:
        if args.arms and name not in args.arms:
            continue
        line, found = row(args.cubectl.resolve(), args.robots, args.out, name, urdf, words, args.targets)
        print(line, flush=True)
        wrong += found
    for what in wrong:
        print(what, file=sys.stderr)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
