"""Reads the MCAP log of a recording with the public Python packages, and holds it against the candump log beside it.

    check_log.py PATH --robot ROBOT.toml --layout LAYOUT.json [--with-fault]    PATH.mcap and PATH.log of one recording

Two files, two formats, other people's readers: every frame must be in both, and every number in the viewer's topics must be
the one that its frame carries. The text log is read by the expression below and by python-can, which knows it by its ending.
The public schemas must be those of their publisher's package, and every panel of the layout must find what it shows.
"""

import argparse
import itertools
import json
import math
import re
import struct
import tomllib
from collections import Counter, defaultdict

import can
import make_schemas
from google.protobuf import descriptor_pb2
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

LINE = re.compile(r"\((\d+)\.(\d{6})\) \S+ ([0-9A-F]{3}|[0-9A-F]{8})#([0-9A-F]*)( [TR])?$")
ACT_POS, CUR, POS_STATE_DIO = 0x3C, 0x4D, 0x62


def candump(path):
    """Frames of the text log: time in µs, id, extended, data."""
    for line in open(path, encoding="ascii"):
        found = LINE.match(line.strip())
        if found is None:
            continue  # error frames
        seconds, micros, identifier, data = found.group(1, 2, 3, 4)
        extended = len(identifier) == 8
        raw = int(identifier, 16)
        if extended and raw >> 29:
            continue
        yield int(seconds) * 1_000_000 + int(micros), raw, extended, bytes.fromhex(data)


def python_can(path):
    """The same, by python-can's choice of a reader for this file name."""
    for message in can.LogReader(path):
        if not message.is_error_frame:
            time_us = round(message.timestamp * 1e6)
            yield time_us, message.arbitration_id, message.is_extended_id, bytes(message.data)


def readings(frames):
    """What drives report, read from their bytes: (time, module) -> position in rad or None."""
    for time_us, identifier, extended, data in frames:
        if extended or not 0x0A1 <= identifier <= 0x0BF or len(data) < 6:
            continue
        ramp = data[0] == 0x0B and data[1] in (0x0E, 0x10, 0x11, 0x12) and len(data) == 8
        value = data[0] == 0x0A and data[1] in (ACT_POS, POS_STATE_DIO)
        if ramp or value:
            yield time_us, identifier - 0x0A0, struct.unpack_from("<f", data, 2)[0]


def is_motion_order(can_id, extended, data):
    """Whether a frame orders a PowerCube to move (command 0x0B)."""
    return not extended and can_id >> 5 == 7 and data[:1] == b"\x0b"


def cycles(reported, addresses):
    """Angles of each control cycle: it ends when all drives have sent theirs, or one sends it again."""
    angles, fresh = [None] * len(addresses), set()
    for time_us, module, q_rad in reported:
        if module not in addresses:
            continue
        joint = addresses.index(module)
        if joint in fresh:
            yield time_us, list(angles)
            fresh = set()
        angles[joint] = q_rad
        fresh.add(joint)
        if len(fresh) == len(addresses):
            yield time_us, list(angles)
            fresh = set()


def times(a, b):
    """Product of two quaternions x, y, z, w."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def turned(q, p):
    """A point turned by a quaternion."""
    x, y, z, w = q
    return times(times(q, (*p, 0.0)), (-x, -y, -z, w))[:3]


def chain(robot, angles):
    """Poses of the links in the world, from the numbers of the robot file alone: modified Denavit-Hartenberg (Craig),
    RotX(alpha) TransX(a) RotZ(q) TransZ(d)."""
    where, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)

    def along(step):
        return tuple(a + b for a, b in zip(where, turned(turn, step)))

    for joint, q_rad in zip(robot["joint"], angles):
        frame = joint["frame"]
        half = math.radians(frame["alpha_deg"]) / 2
        turn = times(turn, (math.sin(half), 0.0, 0.0, math.cos(half)))
        where = along((frame["a_m"], 0.0, 0.0))
        turn = times(turn, (0.0, 0.0, math.sin(q_rad / 2), math.cos(q_rad / 2)))
        where = along((0.0, 0.0, frame["d_m"]))
        yield where, turn


PART = re.compile(r'(\[:\])?(?:\{(\w+)=="([^"]*)"\})?$')


def resolve(path, messages):
    """Values that a viewer's message path finds; fails if it names what is not there."""
    topic = max((t for t in messages if path == t or path.startswith(t + ".")), key=len, default=None)
    assert topic is not None, f"layout: {path}: no such topic in {sorted(messages)}"
    values = messages[topic]
    for part in filter(None, path[len(topic) :].split(".")):
        name = re.match(r"\w+", part).group()
        every, field, wanted = PART.match(part[len(name) :]).groups()
        values = [getattr(value, name) for value in values]
        if every:
            values = [one for value in values for one in value]
        if field:
            values = [value for value in values if getattr(value, field) == wanted]
    assert values, f"layout: {path}: nothing there"
    return values


def check_layout(layout, messages, fault):
    """Every panel of the layout is placed once and finds its topic."""

    def panels(node):
        return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])

    placed = panels(layout["layout"])
    assert sorted(placed) == sorted(layout["configById"]), "layout: panels and their settings differ"
    shown = 0
    for name, config in layout["configById"].items():
        paths = [path["value"] for path in config.get("paths", [])]
        paths += [config[key] for key in ("topicToRender", "topicPath") if config.get(key)]
        paths += list(config.get("topics", {}))
        assert paths, f"layout: {name} shows nothing"
        for path in paths:
            if path == "/freeze" and not fault:
                continue
            resolve(path, messages)
            shown += 1
    return shown


def close(a, b, tolerance):
    return all(abs(x - y) <= tolerance for x, y in zip(a, b, strict=True))


def main(path, robot, layout, fault):
    text = list(candump(path + ".log"))
    with open(path + ".log", encoding="ascii") as file:
        errors = sum(LINE.match(line.strip()) is None or int(line.split()[2].split("#")[0], 16) >> 29 != 0 for line in file)
    # python-can takes error frames without the bus-error bit for data frames.
    if errors == 0:
        assert list(python_can(path + ".log")) == text, "python-can reads other frames"
    topics, schemas, messages = Counter(), {}, defaultdict(list)
    stamped, frames, positions = defaultdict(list), [], []
    with open(path + ".mcap", "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None, "the file has no summary: it was not finished"
        last = 0
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            topics[channel.topic] += 1
            schemas[channel.topic] = schema
            messages[channel.topic].append(decoded)
            stamped[channel.topic].append(message.log_time)
            assert message.log_time >= last, f"{channel.topic}: time runs backwards"
            last = message.log_time
            if channel.topic == "/bus/frames":
                frames.append((decoded.time_us, decoded.id, decoded.extended, bytes(decoded.data)))
            elif channel.topic.startswith("/module/") and decoded.position_rad != 0.0:
                positions.append((decoded.time_us, decoded.module, decoded.position_rad))
        assert summary.statistics.message_count == sum(topics.values())
        about = {record.name: record.metadata for record in reader.iter_metadata()}["recording"]
        assert about["robot"] == robot["name"] and about["times"] == "virtual time from zero", about
    assert len(text) > 1000, f"only {len(text)} frames in the text log"
    assert frames == text, "the two logs have different frames"
    reported = list(readings(text))
    assert positions == [one for one in reported if one[2] != 0.0], "positions are not those of the frames"
    public = {"/joints": "JointStates", "/tf": "FrameTransforms", "/scene": "SceneUpdate", "/events": "Log"}
    wanted = {"/group": "cubectl.GroupState", "/joint/1": "cubectl.JointState", "/joint/6": "cubectl.JointState"}
    wanted |= {topic: "foxglove." + name for topic, name in public.items()}
    for topic, schema in wanted.items():
        assert topic in schemas and schemas[topic].name == schema, f"{topic}: {schemas.get(topic)}"
    published = descriptor_pb2.FileDescriptorSet.FromString(make_schemas.descriptors())
    for topic in public:
        found = descriptor_pb2.FileDescriptorSet.FromString(schemas[topic].data)
        assert found == published, f"{topic}: the schema is not the published one"

    def ns(stamp):
        return stamp.seconds * 1_000_000_000 + stamp.nanos

    for time_ns, event in zip(stamped["/events"], messages["/events"]):
        assert ns(event.timestamp) == time_ns and event.message and event.name, event

    # Joints at control rate: each cycle, from the bytes of the text log.
    names = [joint["name"] for joint in robot["joint"]]
    addresses = [joint["drive"]["address"] for joint in robot["joint"]]
    expected = list(cycles(reported, addresses))
    shown = [
        (time_ns // 1000, [{j.name: j.position for j in one.joints}.get(name) for name in names])
        for time_ns, one in zip(stamped["/joints"], messages["/joints"])
    ]
    assert shown == expected, "/joints are not the drives' answers by control cycle"
    full = [one for one in expected if None not in one[1]]
    assert len(messages["/tf"]) == len(full) > 100, "/tf"
    # At control rate: one message for each period while a plan is driven. It ends with the last motion order: then the
    # drives hold, and the controller asks by turns for an angle with the state and for the state alone.
    orders = [time_us for time_us, can_id, extended, data in text if is_motion_order(can_id, extended, data)]
    reported_group = [(t // 1000, g.state, g.cycle_us) for t, g in zip(stamped["/group"], messages["/group"])]
    runs = [list(run) for state, run in itertools.groupby(reported_group, lambda reported: reported[1]) if state == "running"]
    for run in runs:
        begin, _, period_us = run[0]
        end = max(time_us for time_us in orders if time_us <= run[-1][0])
        shown_then, periods = sum(begin <= time_us < end for time_us, _ in full), (end - begin) / period_us
        assert abs(shown_then - periods) <= 2, f"/joints: {shown_then} in {periods} control periods"
        print(f"{shown_then} messages of /joints in {periods:.1f} control periods of a plan")
    # Frames: the chain of the robot file, computed here.
    for (time_us, angles), one in list(zip(full, messages["/tf"]))[:: max(1, len(full) // 50)]:
        links = {t.child_frame_id: t for t in one.transforms}
        for i, (where, turn) in enumerate(chain(robot, angles)):
            link = links[f"link{i + 1}"]
            assert link.parent_frame_id == "world" and ns(link.timestamp) == time_us * 1000
            t, r = link.translation, link.rotation
            assert close((t.x, t.y, t.z), where, 1e-9), f"link{i + 1} at {time_us} us"
            sign = 1 if sum(a * b for a, b in zip(turn, (r.x, r.y, r.z, r.w))) > 0 else -1
            assert close((r.x, r.y, r.z, r.w), [sign * c for c in turn], 1e-9), f"link{i + 1} at {time_us} us"
    # Bodies stand in frames that exist; the ball comes and goes with the gripper.
    frames_known = {t.child_frame_id for t in messages["/tf"][0].transforms} | {"world"}
    entities = [entity for update in messages["/scene"] for entity in update.entities]
    assert entities and all(e.frame_id in frames_known and e.frame_locked for e in entities), "/scene"
    boxes = sum(len(part["box"]) for part in [robot["base"], *robot["link"]])
    # A viewer that jumps in time gets the last update before, and no other.
    for update in messages["/scene"]:
        bodies = [e.id for e in update.entities if e.id != "ball"]
        assert len(set(bodies)) == len(bodies) and len(bodies) in (0, boxes), "/scene: bodies"
    shown = [any(e.id != "ball" for e in update.entities) for update in messages["/scene"]]
    assert shown[-1] and shown == sorted(shown), "/scene: each update has the bodies from the first that has"
    grips = [g.gripper_open for g in messages["/group"]]
    changes = [g for before, g in zip([True] + grips, grips) if g != before]
    ball = [any(e.id == "ball" for e in update.entities) for update in messages["/scene"]]
    ball = [there for before, there in zip([False] + ball, ball) if there != before]
    assert ball == [not change for change in changes], "/scene: the ball and the gripper differ"
    gone = [d.id for update in messages["/scene"] for d in update.deletions]
    assert gone == ["ball"] * changes.count(True), "/scene: what is deleted"
    panels = check_layout(layout, messages, fault)

    for topic in sorted(topics):
        print(f"{topic:14} {schemas[topic].name:26} {topics[topic]:7}")
    rate = (len(full) - 1) / ((full[-1][0] - full[0][0]) * 1e-6)
    by = "and to python-can" if errors == 0 else f"beside {errors} error frames"
    print(f"{len(frames)} frames the same in both logs {by}, {len(positions)} positions")
    print(f"{len(expected)} cycles of joints ({rate:.0f} in a second), {len(full)} of frames, {panels} paths of the layout found")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("path")
    parser.add_argument("--robot", required=True)
    parser.add_argument("--layout", required=True)
    parser.add_argument("--with-fault", action="store_true")
    args = parser.parse_args()
    with open(args.robot, "rb") as file, open(args.layout, encoding="utf-8") as layout_file:
        main(args.path, tomllib.load(file), json.load(layout_file), args.with_fault)
