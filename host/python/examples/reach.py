"""How dear is a throw, over range and height of its target? A table of planned throws.

python reach.py [STEPS]
"""

import sys

import numpy as np

import cubecell


def main(steps: int) -> None:
    robot = cubecell.Robot("powercube6")
    planned = 0
    print("range m   height m   objective   release m/s")
    for height_m in np.linspace(-1.0, 0.0, steps):
        for range_m in np.linspace(0.8, 2.0, steps):
            try:
                plan = cubecell.plan(robot, [range_m, 0.0, height_m], fast=True)
            except cubecell.CubecellError as refused:
                print(f"{range_m:7.2f}   {height_m:8.2f}   {str(refused).splitlines()[0]}")
                continue
            planned += 1
            speed = np.linalg.norm(plan.data["release"]["velocity_m_s"])
            print(f"{range_m:7.2f}   {height_m:8.2f}   {plan.objective:9.2f}   {speed:11.2f}")
    if planned == 0:
        sys.exit("no target was in reach")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
