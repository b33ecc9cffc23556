"""Where does the ball land, over many simulated cells? One plan, thrown with gains designed for another control period.

python landings.py [THROWS]
"""

import sys
from collections import Counter

import numpy as np

import cubecell


def main(throws: int) -> None:
    target_m = np.array([1.0, 1.0, -1.0])
    plan = cubecell.plan("powercube6", target_m, fast=True)
    gains = cubecell.tune("powercube6", period_ms=5.0)
    for name, used in (("gains of the program", None), ("gains for 5 ms", gains)):
        runs = [cubecell.simulate(plan, seed=seed, gains=used) for seed in range(1, throws + 1)]
        landings_m = np.array([run.landing_m for run in runs if run.landing_m is not None])
        away_mm = 1e3 * np.linalg.norm(landings_m[:, :2] - target_m[:2], axis=1)
        outcomes = ", ".join(f"{count} {outcome}" for outcome, count in Counter(run.outcome for run in runs).items())
        print(f"{name}: {outcomes}; from the target: median {np.median(away_mm):.2f} mm, largest {away_mm.max():.2f} mm")
        if any(run.outcome != "landed" for run in runs):
            sys.exit("a throw did not land")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
