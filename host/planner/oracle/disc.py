#!/usr/bin/env python3
"""Kinematics of paper 001 by Pinocchio, for `tests/disc_oracle.rs`.

    python host/planner/oracle/disc.py target/pincher4.urdf host/planner/tests/data/disc_kinematics.json [--check]

Two formulations that share nothing: Pinocchio's chain from our URDF export, and a product of exponentials of the unit
twists that the paper prints (`pin.exp6`; linear part first). Both must agree before a line is written. Written for each
state: pose and Jacobian of the terminal point (world axes), and the Jacobian to the rates of roll, pitch and yaw by
Pinocchio's `rpy` module. With `--check` the file there must be what would be written, to 1e-11.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

STATES = 8
AGREE = 1e-12
# Unit twists (omega, v) of section 2.1, centimetres.
PRINTED = [
    ([0, 0, 1], [0, 0, 0]),
    ([1, 0, 0], [0, 12.0, 0]),
    ([1, 0, 0], [0, 43.5, 0]),
    ([1, 0, 0], [0, 75.0, 0]),
]


def by_exponentials(q):
    """Terminal frame; the angle of joint 1 of the screws is that of the DH table less 90 degrees."""
    out = pin.SE3.Identity()
    for (omega, v), angle in zip(PRINTED, q - np.array([np.pi / 2, 0, 0, 0])):
        out = out * pin.exp6(pin.Motion(np.array(v) / 100 * angle, np.array(omega, float) * angle))
    rest = np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0]], float)
    return out * pin.SE3(rest, np.array([0, 0, 0.945]))


def state(model, q):
    data = model.createData()
    ee = model.getFrameId("ee")
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    pose = data.oMf[ee].copy()
    assert np.abs(pose.homogeneous - by_exponentials(q).homogeneous).max() < AGREE, "chain and exponentials differ"
    jacobian = pin.getFrameJacobian(model, data, ee, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    rpy = pin.rpy.matrixToRpy(pose.rotation)
    rates = pin.rpy.computeRpyJacobianInverse(rpy, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    rpy_jacobian = np.vstack([jacobian[:3], rates @ jacobian[3:]])
    return {"q": q, "pose": pose.homogeneous, "jacobian": jacobian, "rpy": rpy, "rpy_jacobian": rpy_jacobian}


def main():
    model = pin.buildModelFromUrdf(sys.argv[1])
    out = Path(sys.argv[2])
    rng = np.random.default_rng(2026)
    states = []
    while len(states) < STATES:
        q = rng.uniform(model.lowerPositionLimit, model.upperPositionLimit)
        made = state(model, q)
        # Roll and yaw are not distinct where the hand points up or down.
        if abs(np.cos(made["rpy"][1])) > 0.1:
            states.append({k: np.asarray(v).tolist() for k, v in made.items()})
    if "--check" in sys.argv[3:]:
        known = json.loads(out.read_text())["states"]
        assert len(known) == len(states), f"{len(known)} states in the file"
        off = max(np.abs(np.asarray(a[k]) - np.asarray(b[k])).max() for a, b in zip(states, known) for k in a)
        assert off < 1e-11, f"the vectors in the repository are off by {off:.1e}"
        print(f"disc kinematics: {len(states)} states agree to {off:.1e}")
        return
    lines = ",\n".join("  " + json.dumps(s) for s in states)
    made_with = {"pinocchio": pin.__version__, "numpy": np.__version__}
    out.write_text(f'{{"made_with": {json.dumps(made_with)}, "states": [\n{lines}\n]}}\n')
    print(f"disc kinematics: {len(states)} states")


if __name__ == "__main__":
    main()
