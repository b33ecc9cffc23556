"""Contact by MuJoCo, with bodies from an own reading of the robot file: shares no code with the package.

The file's table `[collision]` says which pairs are tested: boxes of links that differ by at least `link_distance_min`, the floor
from `floor_from_link` on, and obstacles against all that moves.
"""

import math
import tomllib
from pathlib import Path

import mujoco
import numpy as np

FLOOR, OBSTACLE = 1 << 20, 1 << 21


def numbers(values):
    return " ".join(f"{value:.17g}" for value in values)


def box(body, contype, conaffinity):
    assert not any(body.get("rpy_deg", [0.0])), "boxes of this reader are not turned"
    return (
        f'<geom type="box" pos="{numbers(body["center_m"])}" size="{numbers(body["half_m"])}" '
        f'contype="{contype}" conaffinity="{conaffinity}"/>'
    )


class Contacts:
    """Which configurations touch."""

    def __init__(self, file, obstacles):
        robot = tomllib.loads(Path(file).read_text(encoding="utf-8"))
        assert robot["frame_convention"] == "modified_dh"
        rule = robot["collision"]
        assert not rule.get("untested")
        joints, links = robot["joint"], robot["link"]
        self.joints = len(joints)

        def tested(link):
            """Bits of the links, floor and obstacles against which a link is tested."""
            others = sum(1 << k for k in range(self.joints + 1) if abs(k - link) >= rule["link_distance_min"])
            floor = FLOOR if link >= rule["floor_from_link"] else 0
            return others | floor | (OBSTACLE if link > 0 else 0)

        open_bodies = ""
        for k, (joint, link) in enumerate(zip(joints, links), 1):
            frame = joint["frame"]
            assert not frame.get("offset_deg")
            # Craig: RotX(alpha) TransX(a) RotZ(q) TransZ(d); d along the joint's axis may come before the turn.
            alpha = math.radians(frame["alpha_deg"])
            place = [frame["a_m"], -math.sin(alpha) * frame["d_m"], math.cos(alpha) * frame["d_m"]]
            turn = [math.cos(alpha / 2), math.sin(alpha / 2), 0.0, 0.0]
            # Inertia is needed by the parser, not by contacts.
            open_bodies += f'<body pos="{numbers(place)}" quat="{numbers(turn)}"><joint type="hinge" axis="0 0 1"/>'
            open_bodies += "".join(box(body, 1 << k, tested(k)) for body in link["box"])
        base = "".join(box(body, 1, tested(0)) for body in robot["base"]["box"])
        around = "".join(
            box({"center_m": b[:3], "half_m": b[3:]}, OBSTACLE, 0) for b in obstacles
        )
        self.model = mujoco.MjModel.from_xml_string(
            '<mujoco><compiler angle="radian"/><option><flag filterparent="disable"/></option><worldbody>'
            f'<geom type="plane" pos="0 0 {robot["world"]["floor_z_m"]}" size="9 9 1" contype="{FLOOR}" conaffinity="0"/>'
            f"{around}<body>{base}{open_bodies}{'</body>' * self.joints}</body></worldbody></mujoco>"
        )
        self.data = mujoco.MjData(self.model)

    def touch(self, q_rad):
        """Deepest contact, m: negative where bodies overlap, infinite without one."""
        self.data.qpos[:] = q_rad
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        return float(np.min(self.data.contact.dist)) if self.data.ncon else math.inf
