"""What drives and controller reported, from the bytes of a recording."""

import struct

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

ACT_POS, POS_STATE_DIO = 0x3C, 0x62


def positions(path):
    """What each module reported, read from the bytes of its answers: (time of the session in µs, rad), in order."""
    reported = {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            if channel.topic != "/bus/frames" or decoded.extended or not 0x0A1 <= decoded.id <= 0x0BF:
                continue
            data = bytes(decoded.data)
            ramp = len(data) == 8 and data[0] == 0x0B and data[1] in (0x0E, 0x10, 0x11, 0x12)
            value = len(data) >= 6 and data[0] == 0x0A and data[1] in (ACT_POS, POS_STATE_DIO)
            if ramp or value:
                q_rad = struct.unpack_from("<f", data, 2)[0]
                reported.setdefault(decoded.id - 0x0A0, []).append((decoded.time_us, q_rad))
    return reported


def plan_begins(path):
    """When the last run began by the controller's own time of it, in s of the session: a few ms late, as its words take time."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        reported = [d for *_, d in reader.iter_decoded_messages(topics=["/group"])]
    while reported[-1].state != "running":
        reported.pop()
    begins = []
    while reported[-1].state == "running":
        group = reported.pop()
        if group.plan_time_s > 0:
            begins.append(group.time_us * 1e-6 - group.plan_time_s)
    return min(begins)
