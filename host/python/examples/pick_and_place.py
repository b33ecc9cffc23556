"""From power-on to pick and place: home, go above a place, down, close, up, over, down, open. Ten times, and no drift.

    python pick_and_place.py             in the simulated cell
    python pick_and_place.py can0        with an arm; nobody may be near
"""

import sys

import cubecell
import numpy as np

BUS = sys.argv[1] if len(sys.argv) > 1 else "sim"
CYCLES = 10
#: Places of the hand, m, base frame.
PICK, PLACE, ABOVE_M = np.array([0.5, 0.15, 0.45]), np.array([0.5, -0.15, 0.45]), np.array([0.0, 0.0, 0.15])


def main() -> None:
    robot = cubecell.Robot("powercube6")
    with cubecell.connect(BUS, may_move=True) as arm:
        arm.home()
        arm.gripper.open()
        # The first way chooses the posture; all later ones are straight lines from it.
        arm.move(to=PICK + ABOVE_M)
        begin = arm.state().q_rad
        assert begin is not None
        for cycle in range(CYCLES):
            for place, work in ((PICK, arm.gripper.close), (PLACE, arm.gripper.open)):
                arm.move(to=place + ABOVE_M, straight=True)
                arm.move(to=place, straight=True)
                work()
                arm.move(to=place + ABOVE_M, straight=True)
            print(f"cycle {cycle + 1} of {CYCLES}")
        arm.move(to=PICK + ABOVE_M, straight=True)
        end = arm.state().q_rad
        assert end is not None
    drift_mrad = 1e3 * float(np.abs(end - begin).max())
    print(f"{robot.name}: after {CYCLES} cycles at most {drift_mrad:.2f} mrad from where the first one began")
    assert drift_mrad < 2.0, "the arm has drifted"


if __name__ == "__main__":
    main()
