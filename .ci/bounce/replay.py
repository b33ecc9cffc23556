"""Catches of the simulated cell, played again by MuJoCo: does the ball stay in the cup there too?

    replay.py CUBECTL CELL ROBOT [--throws N] [--agree SHARE] [--seed S] [--jobs N]

Balls are drawn at the catcher of the cell file, each with a restitution from 0.15 to 0.7. `cubectl catch --ball` catches them; two of three
arms count on a cup without bounce, so that they try what the ball will not stay in. Of what it executed only the joints, and the path of the
ball until 40 ms before it touches the cup, are taken. MuJoCo moves the arm's cup (capsules for the wall, a cylinder for the bottom) by these
joints, throws the ball from there, and says whether it lies in the cup in the end. Its contact is a spring and a damper; the damper for a
restitution is found by drops, which are printed. Friction and rolling resistance act as forces by the definitions of the cell file. Arm and cup
are an own reading of the two files. Ends with code 1 if fewer throws than the given share agree.
"""

import argparse
import concurrent.futures
import json
import math
import os
import pathlib
import random
import subprocess
import sys
import tempfile
import tomllib

import mujoco
import numpy as np

# Steps in flight; nearer than NEAR_M to a surface, where a ball rests, rolls or slides; in a bounce: nearer than CLOSE_M and faster to or from the
# surface than HIT_M_S, or deeper in it than HIT_M. A step knows the contacts of the one before, so either distance is more than two of the longer
# steps at 6 m/s: a ball that is deep in the spring before its damper acts bounces too high.
FLIGHT_S, SLOW_S, FINE_S = 2e-4, 1e-4, 1e-5
NEAR_M, CLOSE_M, HIT_M_S, HIT_M = 0.003, 0.0013, 0.1, 1e-5
# Angular frequency of ball and spring, rad/s: a contact lasts 0.8 ms, and the ball is 1 mm deep at 4 m/s.
SPRING_RAD_S = 4000.0
# A ball that slips is stopped with this time constant, as far as friction can, s.
SLIP_S = 2e-4
MASS_KG = 0.03
BEFORE_S = 0.04
# A ball that has not left the cup this long after it touched it lies in it, s.
AFTER_S = 1.5
# A ball that was in the cup and is this far from the hand has left it, m.
AWAY_M = 0.3
CAPSULES = 96
# Joints follow the executed ones whatever the ball does: inertia about each axis, kg m2, beside that of a ball of some grams.
ARMATURE = 1e5
RESTITUTIONS = (0.15, 0.7)


def numbers(values):
    return " ".join(f"{value:.12g}" for value in values)


class TwoArmCell:
    def __init__(self, cell, robot):
        self.cell = tomllib.loads(pathlib.Path(cell).read_text(encoding="utf-8"))
        self.robot = tomllib.loads(pathlib.Path(robot).read_text(encoding="utf-8"))
        assert self.robot["frame_convention"] == "modified_dh"
        self.ball, self.cup, self.catcher = self.cell["ball"], self.cell["cup"], self.cell["arm"][1]
        self.gravity = self.robot["world"]["gravity_m_s2"]

    def ball_xml(self):
        radius, mass = self.ball["radius_m"], MASS_KG
        inertia = self.ball["inertia"] * mass * radius**2
        return (
            f'<body name="ball"><freejoint/><inertial pos="0 0 0" mass="{mass}" diaginertia="{numbers([inertia] * 3)}"/>'
            f'<geom name="ball" type="sphere" size="{radius}"/></body>'
        )

    def pair_xml(self, name, damping):
        # Friction is not left to MuJoCo (`rub`): its convex cone raises the restitution of a ball that slips.
        return (
            f'<pair geom1="ball" geom2="{name}" condim="1" gap="{NEAR_M}" '
            f'solref="{numbers([-SPRING_RAD_S**2, -2.0 * damping * SPRING_RAD_S])}" solimp="0.99 0.99 0.001 0.5 2"/>'
        )

    def model(self, bodies, pairs):
        return mujoco.MjModel.from_xml_string(
            f'<mujoco><compiler angle="radian"/><option timestep="{FINE_S}" gravity="0 0 {-self.gravity}" solver="Newton" '
            f'iterations="20" tolerance="1e-10"/><worldbody>{bodies}{self.ball_xml()}</worldbody>'
            f"<contact>{''.join(pairs)}</contact></mujoco>"
        )

    def drop(self, damping, speed=3.0):
        """Speed after over speed before a ball hits a plate; mean over where in a step it touches."""
        plate = '<geom name="plate" type="box" size="1 1 0.1" pos="0 0 -0.1" contype="0" conaffinity="0"/>'
        model = self.model(plate, [self.pair_xml("plate", damping)])
        after = []
        for phase in (0.125, 0.375, 0.625, 0.875):
            data = mujoco.MjData(model)
            data.qpos[2], data.qvel[2] = self.ball["radius_m"] + (1 + phase) * speed * FINE_S, -speed
            while data.time < 3 * FINE_S or (data.qpos[2] < self.ball["radius_m"] and data.time < 0.05):
                mujoco.mj_step(model, data)
            after.append(max(data.qvel[2], 0.0) / speed)
        return float(np.mean(after))

    def damping(self, restitution):
        low, high = 0.0, 3.0
        for _ in range(25):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.drop(middle) > restitution else (low, middle)
        return 0.5 * (low + high)

    def arm_model(self, damping):
        cup, names = self.cup, ["bottom"] + [f"wall{k}" for k in range(CAPSULES)]
        half, rho = 0.5 * cup["wall_m"], cup["inner_radius_m"] + 0.5 * cup["wall_m"]
        # From the end-effector frame; the capsule's round end is the rim.
        top, bottom = cup["mouth_from_ee_m"] - half, cup["mouth_from_ee_m"] - cup["depth_m"]
        free = 'contype="0" conaffinity="0" mass="1e-6"'
        geoms = f'<geom name="bottom" type="cylinder" size="{rho} {half}" pos="0 0 {bottom - half}" {free}/>'
        for k in range(CAPSULES):
            x, y = rho * math.cos(2 * math.pi * k / CAPSULES), rho * math.sin(2 * math.pi * k / CAPSULES)
            ends = numbers([x, y, top, x, y, bottom - half])
            geoms += f'<geom name="wall{k}" type="capsule" size="{half}" fromto="{ends}" {free}/>'
        assert "end_effector" not in self.robot, "the hand's frame is that of the last link"
        bodies = ""
        for joint in self.robot["joint"]:
            frame = joint["frame"]
            assert not frame.get("offset_deg")
            # Craig: RotX(alpha) TransX(a) RotZ(q) TransZ(d); d along the joint's axis may come before the turn.
            alpha = math.radians(frame["alpha_deg"])
            place = [frame["a_m"], -math.sin(alpha) * frame["d_m"], math.cos(alpha) * frame["d_m"]]
            turn = [math.cos(alpha / 2), math.sin(alpha / 2), 0.0, 0.0]
            bodies += (
                f'<body pos="{numbers(place)}" quat="{numbers(turn)}"><joint type="hinge" axis="0 0 1" armature="{ARMATURE}"/>'
                '<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-6 1e-6 1e-6"/>'
            )
        base = self.catcher
        assert base["base_rpy_deg"][:2] == [0, 0]
        yaw = math.radians(base["base_rpy_deg"][2]) / 2
        hand = f'<body name="hand">{geoms}</body>'
        arm = f'<body pos="{numbers(base["base_m"])}" quat="{numbers([math.cos(yaw), 0, 0, math.sin(yaw)])}">'
        arm += bodies + hand + "</body>" * (len(self.robot["joint"]) + 1)
        return self.model(arm, [self.pair_xml(name, damping) for name in names])

    def rub(self, model, data, ball, hand):
        """Force (N) and torque (Nm) of air, friction and rolling resistance on the ball, from the normal forces of this step; and whether it is in a bounce."""
        radius, inertia, mu, roll = self.ball["radius_m"], self.ball["inertia"], self.cup["friction"], self.cup["rolling"]
        v, spin = data.qvel[-6:-3], data.xmat[ball].reshape(3, 3) @ data.qvel[-3:]
        force, torque = -MASS_KG * self.ball["drag_1_m"] * np.linalg.norm(v) * v, np.zeros(3)
        moving, pressed, hits = np.zeros(6), np.zeros(6), False
        if data.ncon:
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, hand, moving, 0)
        for k in range(data.ncon):
            if data.contact[k].dist > CLOSE_M:
                continue
            mujoco.mj_contactForce(model, data, k, pressed)
            at, normal = data.contact[k].pos, data.contact[k].frame[:3]
            lever = at - data.xpos[ball]
            against = v - (moving[3:] + np.cross(moving[:3], at - data.xpos[hand]))
            hits |= abs(normal @ against) > HIT_M_S or data.contact[k].dist < -HIT_M
            if pressed[0] <= 0.0:
                continue
            along = against - normal * (normal @ against)
            slip = along + np.cross(spin, lever)
            slip -= normal * (normal @ slip)
            # What stops the slip of a ball that may turn; what slows one that rolls.
            rubbed = -slip * MASS_KG * inertia / (1.0 + inertia) / SLIP_S
            rubbed *= min(1.0, mu * pressed[0] / max(np.linalg.norm(rubbed), 1e-12))
            rolled = min(roll * pressed[0], MASS_KG * np.linalg.norm(along) / SLIP_S)
            force += rubbed - rolled * along / max(np.linalg.norm(along), 1e-12)
            rate = np.linalg.norm(spin)
            turned = min(roll * pressed[0], MASS_KG * radius * rate / SLIP_S) * inertia * radius
            torque += np.cross(lever, rubbed) - turned * spin / max(rate, 1e-12)
        return [*force, *torque], hits

    def inside(self, model, data):
        """Place of the ball in the cup's frame: below the plane of the mouth and within the wall."""
        hand = model.body("hand").id
        at = data.xmat[hand].reshape(3, 3).T @ (data.body("ball").xpos - data.xpos[hand])
        return at[2] < self.cup["mouth_from_ee_m"] and math.hypot(at[0], at[1]) < self.cup["inner_radius_m"]

    def replay(self, damping, catch):
        """Whether the ball lies in the cup in the end, by MuJoCo."""
        trace = catch["trace"]
        times, ball, joints = np.array(trace["t_s"]), np.array(trace["ball_m"]), np.array(trace["q_rad"])
        touch_s = next(e["after_release_s"] for e in catch["events"] if e["event"] == "hit the cup")
        first = max(1, int(np.searchsorted(times, touch_s - BEFORE_S)))
        model = self.arm_model(damping)
        data = mujoco.MjData(model)
        n = len(self.robot["joint"])
        motion = Motion(times, joints)
        # A difference over both neighbours is the velocity of a parabola in the middle.
        data.qpos[n : n + 3] = ball[first]
        data.qvel[n : n + 3] = (ball[first + 1] - ball[first - 1]) / (times[first + 1] - times[first - 1])
        data.qpos[n + 3 : n + 7] = [1.0, 0.0, 0.0, 0.0]
        ball_id, hand_id, still_s = model.body("ball").id, model.body("hand").id, 0.0
        hits = False
        t_s = times[first]
        end_s = min(times[-1], touch_s + AFTER_S)
        while t_s < end_s:
            q, qd, qdd = motion.at(t_s)
            data.qpos[:n], data.qvel[:n], data.qfrc_applied[:n] = q, qd, ARMATURE * qdd
            step_s = FLIGHT_S if not data.ncon else FINE_S if hits else SLOW_S
            model.opt.timestep = step_s
            mujoco.mj_step(model, data)
            data.xfrc_applied[ball_id], hits = self.rub(model, data, ball_id, hand_id)
            t_s += step_s
            against = np.linalg.norm(data.qvel[n : n + 3] - data.cvel[hand_id, 3:])
            # A ball that moves with the hand for a tenth of a second lies.
            still_s = still_s + step_s if against < 0.1 else 0.0
            away = np.linalg.norm(data.xpos[ball_id] - data.xpos[hand_id])
            if t_s > touch_s and (away > AWAY_M or still_s > 0.1):
                break
        data.qpos[:n], data.qvel[:n] = motion.at(t_s)[:2]
        mujoco.mj_forward(model, data)
        return self.inside(model, data)


class Motion:
    """Cubics through the executed joints, with the speeds of their neighbours' differences."""

    def __init__(self, times, joints):
        self.times, self.joints, self.speeds = times, joints, np.gradient(joints, times, axis=0)

    def at(self, t_s):
        k = min(max(int(np.searchsorted(self.times, t_s)) - 1, 0), len(self.times) - 2)
        h = self.times[k + 1] - self.times[k]
        s = min(max((t_s - self.times[k]) / h, 0.0), 1.0)
        (a, b), (u, w) = self.joints[k : k + 2], self.speeds[k : k + 2] * h
        c2, c3 = 3 * (b - a) - 2 * u - w, u + w - 2 * (b - a)
        return (
            a + s * (u + s * (c2 + s * c3)),
            (u + s * (2 * c2 + 3 * s * c3)) / h,
            (2 * c2 + 6 * s * c3) / h**2,
        )


def draw(draw_from):
    """Place (m) and velocity (m/s) of a ball in the catcher's base frame: it passes 0.65 m before the base."""
    u = draw_from.uniform
    at, away = (0.65, u(-0.3, 0.3), u(0.05, 0.65)), (u(2.0, 2.6), u(-0.4, 0.4), u(0.0, 0.6))
    flight_s = u(0.55, 0.85)
    v = [(b - a) / flight_s for a, b in zip(away, at)]
    return [*away, v[0], v[1], v[2] + 0.5 * 9.81 * flight_s]


def one(task):
    files, cubectl, folder, number, seed = task
    cell = TwoArmCell(*files)
    rng = random.Random(seed * 100_003 + number)
    restitution = RESTITUTIONS[0] + (RESTITUTIONS[1] - RESTITUTIONS[0]) * rng.random()
    file = folder / f"cell-{number}.toml"
    text = pathlib.Path(files[0]).read_text(encoding="utf-8")
    head, cup = text.split("[cup]")
    before = f"restitution = {cell.cup['restitution']}"
    assert cup.index(before) < cup.index("[ground]")
    file.write_text(f"{head}[cup]{cup.replace(before, f'restitution = {restitution:.6f}', 1)}", encoding="utf-8")
    kind = rng.choice(["matched", "hold", "hold", "either"])
    # One arm of three knows the cup; the others try what will bounce out.
    belief = ["--restitution", "0"] if number % 3 else []
    ball = ",".join(f"{value:.4f}" for value in draw(rng))
    words = [cubectl, "catch", "--json", "--robot", "powercube6", "--cell", file, "--hand", kind, *belief]
    words += ["--seed", str(number), "--cooperative", "--ball", ball]
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False)
    if not done.stdout.startswith("{"):
        raise SystemExit(f"{' '.join(map(str, words))}: {done.stderr}")
    catch = json.loads(done.stdout)
    crossing = catch["crossing"]
    touched = any(event["event"] == "hit the cup" for event in catch["events"])
    early = any(event["event"] == "hit a link" for event in catch["events"] if event.get("part") != "fingers")
    if catch["choice"] is None or crossing is None or not touched or crossing["miss_m"] > 0.04:
        return number, None
    damping = cell.damping(restitution)
    return number, {
        "restitution": restitution,
        "mode": catch["choice"]["mode"],
        "speed": crossing["speed_m_s"],
        "link": early,
        "cell": catch["caught"],
        "mujoco": cell.replay(damping, catch),
    }


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("cubectl", type=pathlib.Path)
    parser.add_argument("cell", type=pathlib.Path)
    parser.add_argument("robot", type=pathlib.Path)
    parser.add_argument("--throws", type=int, default=100)
    parser.add_argument("--agree", type=float, default=0.95)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    args = parser.parse_args()
    cell = TwoArmCell(args.cell, args.robot)
    print("restitution: damping ratio of the contact, restitution of drops with 1, 3 and 5 m/s")
    for restitution in (0.15, 0.3, 0.5, 0.7):
        damping = cell.damping(restitution)
        drops = [cell.drop(damping, speed) for speed in (1.0, 3.0, 5.0)]
        print(f"  {restitution:.2f}: {damping:.4f}, {', '.join(f'{drop:.3f}' for drop in drops)}")
        assert all(abs(drop - restitution) < 0.02 for drop in drops), "a drop does not have the restitution that it was calibrated for"
    results, number = [], 0
    with tempfile.TemporaryDirectory() as folder, concurrent.futures.ProcessPoolExecutor(args.jobs) as pool:
        # Draws that no arm tries to catch are no replay: more are drawn, in a fixed order.
        while len(results) < args.throws and number < 10 * args.throws:
            batch = range(number, number + args.throws - len(results))
            number = batch.stop
            tasks = [((args.cell, args.robot), args.cubectl, pathlib.Path(folder), k, args.seed) for k in batch]
            results += [(k, result) for k, result in pool.map(one, tasks) if result]
    same = sum(result["cell"] == result["mujoco"] for _, result in results)
    kept = sum(result["cell"] for _, result in results)
    for k, result in results:
        if result["cell"] != result["mujoco"]:
            words = {True: "in the cup", False: "out"}
            print(
                f"  throw {k}: {result['mode']}, restitution {result['restitution']:.3f}, {result['speed']:.2f} m/s against the hand: "
                f"{words[result['cell']]} in the cell, {words[result['mujoco']]} by MuJoCo{'; it hit a link' if result['link'] else ''}"
            )
    print(f"{same} of {len(results)} catches agree; {kept} lie in the cup, {len(results) - kept} bounced out ({number} drawn)")
    few = len(results) < args.throws
    one_sided = min(kept, len(results) - kept) < 0.1 * len(results)
    if few or one_sided or same < args.agree * len(results):
        sys.exit(f"fewer than {args.agree:.0%} agree, or there were too few replays, or nearly all had the same end")


if __name__ == "__main__":
    main()
