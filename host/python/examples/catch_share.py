"""Which balls are caught? Balls at random towards the arm, caught with the hand at rest; what the catcher reports against the witness.

python catch_share.py [BALLS]
"""

import sys
from collections import Counter

import numpy as np

import cubecell


def main(balls: int) -> None:
    rng = np.random.default_rng(1)
    reported, miss_mm = Counter[str](), []
    for seed in range(1, balls + 1):
        position_m = [2.2, rng.uniform(-0.9, 0.9), rng.uniform(0.2, 0.6)]
        velocity_m_s = [rng.uniform(-3.4, -1.8), rng.uniform(-0.4, 0.4), rng.uniform(2.5, 3.5)]
        catch = cubecell.catch_ball(position_m, velocity_m_s, hand="hold", seed=seed)
        reported[catch.reported] += 1
        if (catch.reported == "caught") != catch.caught:
            sys.exit(f"ball {seed}: the catcher reports {catch.reported!r}, the ball is {'' if catch.caught else 'not '}in the cup")
        if catch.caught and catch.crossing is not None:
            miss_mm.append(1e3 * catch.crossing.miss_m)
    print(", ".join(f"{count} {word}" for word, count in reported.most_common()))
    if miss_mm:
        print(f"off the axis of the cup: median {np.median(miss_mm):.1f} mm, largest {max(miss_mm):.1f} mm")
    disc = cubecell.catch_disc([0.5, -1.0, 1.2], [0.0, 4.0, 0.0])
    if disc.plan is None or not disc.plan.witness.caught:
        sys.exit("the disc was not caught")
    print(f"disc: caught after {disc.plan.t_s:.3f} s with {100 * disc.plan.speed_use:.0f} % of the joint speeds")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
