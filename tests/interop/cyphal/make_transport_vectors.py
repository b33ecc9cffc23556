#!/usr/bin/env python3
"""Golden vectors of the Cyphal/CAN transport, made by pycyphal: what leaves, and what arrives after losses.

`tx ID TID PAYLOAD FRAME...`   a transfer (CAN id, number, payload) and the data bytes of its frames.
`rx EXTENT`                    begins a script for a fresh receiver; then, in order:
`frame US DATA`                a frame of one session arrives at this time;
`got TID PAYLOAD`              the frame above completed this transfer (payload cut to the extent).

Hexadecimal except EXTENT, US and TID; `-` = no bytes. Frames are lost and doubled at random, as a bus does it; pauses
longer than the transfer-ID timeout lie between transfers. Deterministic: the committed file
protocol/tests/cyphal_transport_vectors.txt is the output of this script, and CI compares.
"""

import random
import sys

from pycyphal.transport import Priority, Timestamp, TransferFrom
from pycyphal.transport.can._identifier import MessageCANID, ServiceCANID
from pycyphal.transport.can._session._transfer_reassembler import TransferReassembler
from pycyphal.transport.can._session._transfer_sender import serialize_transfer

FRAME_PAYLOAD = 7
TIMEOUT_NS = 2_000_000_000
SOURCE = 7


def frames_of(identifier, transfer_id, payload):
    return list(serialize_transfer(identifier, transfer_id, [memoryview(payload)], FRAME_PAYLOAD))


def data_of(frame):
    return bytes(frame.compile().data).hex()


def identifiers(rng):
    priority = rng.choice(list(Priority))
    if rng.random() < 0.5:
        return MessageCANID(priority, rng.randrange(128), rng.randrange(8192)).compile([])
    source, destination = rng.sample(range(128), 2)
    return ServiceCANID(priority, source, destination, rng.randrange(512), rng.random() < 0.5).compile([])


def transmissions(rng):
    for length in [*range(0, 30), 255, 256, 313]:
        payload = rng.randbytes(length)
        identifier, transfer_id = identifiers(rng), rng.randrange(32)
        frames = " ".join(data_of(f) for f in frames_of(identifier, transfer_id, payload))
        yield f"tx {identifier:08x} {transfer_id} {payload.hex() or '-'} {frames}"


def reception(rng):
    extent = rng.choice([7, 40, 64])
    yield f"rx {extent}"
    identifier = ServiceCANID(Priority.NOMINAL, SOURCE, 42, 384, True).compile([])
    receiver = TransferReassembler(SOURCE, extent)
    now_us = 1000
    transfer_id = rng.randrange(32)
    for _ in range(14):
        now_us += 2_500_000 if rng.random() < 0.1 else 100
        payload = rng.randbytes(rng.choice([0, 3, 7, 8, 12, 13, 14, 20, 40, 41, 70]))
        for frame in frames_of(identifier, transfer_id, payload):
            fate = rng.random()
            for _ in range(0 if fate < 0.07 else 2 if fate < 0.14 else 1):
                now_us += 100
                yield f"frame {now_us} {data_of(frame)}"
                got = receiver.process_frame(
                    Timestamp(system_ns=0, monotonic_ns=now_us * 1000), Priority.NOMINAL, frame, TIMEOUT_NS
                )
                if isinstance(got, TransferFrom):
                    arrived = b"".join(got.fragmented_payload)[:extent]
                    yield f"got {got.transfer_id} {arrived.hex() or '-'}"
        transfer_id = (transfer_id + 1) % 32


def main():
    rng = random.Random(20260102)
    print("# Made by tests/interop/cyphal/make_transport_vectors.py; do not edit.")
    for line in transmissions(rng):
        print(line)
    for _ in range(40):
        for line in reception(rng):
            print(line)


if __name__ == "__main__":
    sys.exit(main())
