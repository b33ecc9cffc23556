"""Where does the ball of an industrial robot land, with commands that lead by its lag and without?

python follow_landings.py
"""

import sys

import numpy as np

import cubecell


def main() -> None:
    for lag_ms in (0.0, 20.0, 40.0):
        plan = cubecell.plan_follow("kr16_2", [2.5, 0.0, 0.6], starts=8, lag_ms=lag_ms)
        report = cubecell.check(plan)
        if not report.ok:
            sys.exit("; ".join(report.findings))
        points = plan.set_points
        followed_ms = 1e3 * np.ptp(points.t_s[points.phase == "follow"])
        run = cubecell.simulate_follow(plan)
        print(f"commands lead by {lag_ms:.0f} ms, ball on its flight for {followed_ms:.0f} ms: {run.text}")
        if run.outcome != "landed":
            sys.exit("the throw did not land")


if __name__ == "__main__":
    main()
