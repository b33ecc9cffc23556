#!/usr/bin/env python3
"""Golden vectors from libraries that are not ours, through our own URDF export.

    cargo run -q -p robot-model --example to_urdf -- powercube6 > target/powercube6.urdf   (and the other robots)
    python3 -m venv target/oracle && target/oracle/bin/pip install pin==4.1.0 mujoco==4.0.0
    target/oracle/bin/python robots/model/oracle/golden.py target robots/model/tests/data

With `--check` at the end nothing is written: the files there must be what would be written, to 1e-11.

Pinocchio reads the URDF and computes everything that is written; MuJoCo reads the same URDF, and poses, mass matrix
and torques of both must agree to 1e-9 before a line is written, so an error in one of them does not become golden.
States are drawn from a fixed seed inside the joint ranges.
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

ROBOTS = ["powercube6", "kr16_2", "pincher4"]
STATES = 6
AGREE = 1e-9
GRAVITY = 9.81  # both libraries read URDF without gravity: Pinocchio assumes 9.81, MuJoCo is given it


def pinocchio_vectors(model, q, v, a):
    data = model.createData()
    release = model.getFrameId("release")
    ee = model.getFrameId("ee")
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    pin.forwardKinematics(model, data, q, v, np.zeros_like(v))
    pin.updateFramePlacements(model, data)
    pin.computeJointJacobians(model, data, q)
    bias = pin.getFrameClassicalAcceleration(model, data, release, aligned).vector
    jacobian = pin.getFrameJacobian(model, data, release, aligned)
    tau = pin.rnea(model, data, q, v, a).copy()
    # Results are views into their data object: a fresh one for each, kept until they are copied.
    for_derivatives, for_mass, for_gravity = model.createData(), model.createData(), model.createData()
    by_q, by_v, by_a = (np.array(m) for m in pin.computeRNEADerivatives(model, for_derivatives, q, v, a))
    mass = np.triu(pin.crba(model, for_mass, q))
    mass = mass + np.triu(mass, 1).T
    gravity = pin.computeGeneralizedGravity(model, for_gravity, q).copy()
    assert np.abs(np.triu(by_a) - np.triu(mass)).max() < AGREE
    return {
        "q": q, "qd": v, "qdd": a,
        "x_we": data.oMf[ee].homogeneous, "x_wb": data.oMf[release].homogeneous,
        "jacobian": jacobian, "bias_acceleration": bias,
        "tau": tau, "gravity": gravity,
        "tau_by_q": by_q, "tau_by_qd": by_v, "mass": mass,
    }


def check_with_mujoco(path, vectors):
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.gravity[:] = [0, 0, -GRAVITY]
    # Contacts would add forces; only the dynamics of the chain are compared.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    for v in vectors:
        data.qpos[:], data.qvel[:], data.qacc[:] = v["q"], v["qd"], v["qdd"]
        mujoco.mj_inverse(model, data)
        assert np.abs(data.qfrc_inverse - v["tau"]).max() < AGREE * max(1, np.abs(v["tau"]).max()), "torque"
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        assert np.abs(mass - v["mass"]).max() < AGREE * max(1, np.abs(v["mass"]).max()), "mass matrix"


def largest_difference(a, b):
    if isinstance(a, dict):
        assert a.keys() == b.keys(), (a.keys(), b.keys())
        return max(largest_difference(a[k], b[k]) for k in a)
    x, y = np.asarray(a), np.asarray(b)
    return np.abs(x - y).max() / max(1, np.abs(y).max())


def main():
    urdfs, out = Path(sys.argv[1]), Path(sys.argv[2])
    check = "--check" in sys.argv[3:]
    for name in ROBOTS:
        path = urdfs / f"{name}.urdf"
        model = pin.buildModelFromUrdf(str(path))
        assert np.allclose(model.gravity.linear, [0, 0, -GRAVITY])
        rng = np.random.default_rng(2026)
        vectors = []
        for _ in range(STATES):
            q = rng.uniform(model.lowerPositionLimit, model.upperPositionLimit)
            vectors.append(pinocchio_vectors(model, q, rng.uniform(-3, 3, model.nv), rng.uniform(-15, 15, model.nv)))
        check_with_mujoco(path, vectors)
        plain = [{k: np.asarray(x).tolist() for k, x in v.items()} for v in vectors]
        made_with = {"pinocchio": pin.__version__, "mujoco": mujoco.__version__, "numpy": np.__version__}
        if check:
            known = json.loads((out / f"{name}.json").read_text())["states"]
            assert len(known) == len(plain), f"{name}: {len(known)} states in the file"
            off = max(largest_difference(a, b) for a, b in zip(plain, known))
            assert off < 1e-11, f"{name}: the vectors in the repository are off by {off:.1e}"
            print(f"{name}: {len(plain)} states agree to {off:.1e}")
            continue
        lines = ",\n".join("  " + json.dumps(v) for v in plain)
        (out / f"{name}.json").write_text(f'{{"made_with": {json.dumps(made_with)}, "states": [\n{lines}\n]}}\n')
        print(f"{name}: {STATES} states, total mass {sum(i.mass for i in model.inertias[1:]):.3f} kg")


if __name__ == "__main__":
    main()
