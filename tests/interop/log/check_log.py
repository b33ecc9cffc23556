"""Reads the MCAP log of a recording with the public Python packages, and holds it against the candump log beside it.

    check_log.py PATH        PATH.mcap and PATH.candump of one recording

Two files, two formats, two readers: every frame must be in both, and every number in the viewer's topics must be the one
that its frame carries.
"""

import re
import struct
import sys
from collections import Counter

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


def readings(frames):
    """What drives tell, read from their bytes: (time, module) -> position in rad or None."""
    for time_us, identifier, extended, data in frames:
        if extended or not 0x0A1 <= identifier <= 0x0BF or len(data) < 6:
            continue
        ramp = data[0] == 0x0B and data[1] in (0x0E, 0x10, 0x11, 0x12) and len(data) == 8
        value = data[0] == 0x0A and data[1] in (ACT_POS, POS_STATE_DIO)
        if ramp or value:
            yield time_us, identifier - 0x0A0, struct.unpack_from("<f", data, 2)[0]


def main(path):
    text = list(candump(path + ".candump"))
    topics, schemas, frames, positions, events = Counter(), {}, [], [], []
    with open(path + ".mcap", "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None, "the file has no summary: it was not finished"
        last = 0
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            topics[channel.topic] += 1
            schemas[channel.topic] = schema.name
            assert message.log_time >= last, f"{channel.topic}: time runs backwards"
            last = message.log_time
            if channel.topic == "/bus/frames":
                frames.append((decoded.time_us, decoded.id, decoded.extended, bytes(decoded.data)))
            elif channel.topic.startswith("/module/") and decoded.position_rad != 0.0:
                positions.append((decoded.time_us, decoded.module, decoded.position_rad))
            elif channel.topic == "/events":
                events.append((message.log_time, decoded))
        assert summary.statistics.message_count == sum(topics.values())
    assert len(text) > 1000, f"only {len(text)} frames in the text log"
    assert frames == text, "the two logs have different frames"
    expected = [reading for reading in readings(text) if reading[2] != 0.0]
    assert positions == expected, "positions are not those of the frames"
    for topic, schema in [
        ("/group", "cubectl.GroupState"),
        ("/joint/1", "cubectl.JointState"),
        ("/joint/6", "cubectl.JointState"),
        ("/events", "foxglove.Log"),
    ]:
        assert schemas.get(topic) == schema, f"{topic}: {schemas.get(topic)}"
    for time_ns, event in events:
        stamp = event.timestamp.seconds * 1_000_000_000 + event.timestamp.nanos
        assert stamp == time_ns and event.message and event.name, event
    for topic in sorted(topics):
        print(f"{topic:14} {schemas[topic]:22} {topics[topic]:7}")
    print(f"{len(frames)} frames the same in both logs, {len(positions)} positions, {len(events)} events")


main(sys.argv[1])
