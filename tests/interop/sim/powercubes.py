"""python-can, unmodified, against `hil-sim serve`: scan, read, home, move; everything the protocol reference demands.

    python powercubes.py socketcand HOST PORT
    python powercubes.py slcan DEVICE

Written from the protocol's description alone; shares no line with the simulator.
"""

import statistics
import struct
import sys
import time

import can

GET, PUT, ACK, ALL = 0x0C0, 0x0E0, 0x0A0, 0x100
ACCEPTED = 0x64
NOT_OK, MOTION, RAMP_END = 0x01, 0x10, 0x20
HOME_OK, ERROR, HALTED = 0x2, 0x1, 0x4
PATIENCE_S = 2.0

latencies_ms = []


class Silence(Exception):
    """No answer in time."""


def frame(identifier, data):
    return can.Message(arbitration_id=identifier, is_extended_id=False, data=data)


def ask(bus, base, module, data, patience_s=PATIENCE_S):
    """Sends a request and returns the answer's data: the next frame on the module's ACK id that repeats the first bytes."""
    echoed = bytes(data[:1]) if len(data) == 1 else bytes(data[:2])
    sent = time.perf_counter()
    bus.send(frame(base + module, data))
    while True:
        left = sent + patience_s - time.perf_counter()
        answer = bus.recv(timeout=max(left, 0))
        if answer is None:
            raise Silence(f"module {module} is silent on {bytes(data).hex(' ')}")
        if answer.arbitration_id == ACK + module and bytes(answer.data).startswith(echoed):
            latencies_ms.append(1e3 * (time.perf_counter() - sent))
            assert not answer.is_extended_id and not answer.is_remote_frame, answer
            return bytes(answer.data)


def get(bus, module, parameter, kind):
    data = ask(bus, GET, module, [0x0A, parameter])
    assert len(data) == 2 + struct.calcsize(kind), f"0A {parameter:02X}: DLC {len(data)}"
    return struct.unpack("<" + kind, data[2:])[0]


def put(bus, module, parameter, value):
    data = ask(bus, PUT, module, [0x08, parameter, *struct.pack("<f", value)])
    assert data == bytes([0x08, parameter, ACCEPTED]), f"SET {parameter:02X}: {data.hex(' ')}"


def simple(bus, module, command):
    data = ask(bus, PUT, module, [command])
    assert data == bytes([command]), f"command {command:02X}: DLC must be 1, got {data.hex(' ')}"


def scan(bus):
    """Version word of all addresses; asked all at once, or the silent ones would take their time one after the other."""
    for module in range(1, 32):
        bus.send(frame(GET + module, [0x0A, 0x1D]))
    found = {}
    while (answer := bus.recv(timeout=PATIENCE_S)) is not None:
        assert bytes(answer.data[:2]) == b"\x0a\x1d" and len(answer.data) == 4, f"version: {answer}"
        found[answer.arbitration_id - ACK] = struct.unpack("<H", bytes(answer.data[2:]))[0]
    return found


def position_state(bus, module):
    data = ask(bus, GET, module, [0x0A, 0x62])
    assert len(data) == 8, f"0A 62: DLC {len(data)}"
    return struct.unpack("<fBB", data[2:])


def home(bus, module):
    simple(bus, module, 0x00)
    simple(bus, module, 0x01)
    start = time.monotonic()
    state = get(bus, module, 0x27, "I")
    assert not state & HOME_OK, f"HOME_OK must fall until homing has ended, state {state:#010x}"
    while not (state & HOME_OK and state & 0x8000):
        assert time.monotonic() - start < 60, f"homing takes too long, state {state:#010x}"
        assert not state & ERROR, f"error during homing, state {state:#010x}"
        time.sleep(0.1)
        state = get(bus, module, 0x27, "I")
    return time.monotonic() - start


def ramp_extended(bus, module, target, velocity, acceleration):
    """Three frames as the manufacturer's library sends them; the last answer has the position before the move."""
    put(bus, module, 0x4F, velocity)
    put(bus, module, 0x50, acceleration)
    data = ask(bus, PUT, module, [0x0B, 0x0E, *struct.pack("<f", target)])
    assert len(data) == 8, f"0B 0E: DLC {len(data)}"
    return struct.unpack("<fBB", data[2:])


def connect(arguments):
    match arguments:
        case ["socketcand", host, port]:
            return can.Bus(interface="socketcand", channel="can0", host=host, port=int(port))
        case ["slcan", device]:
            return can.Bus(interface="slcan", channel=device, bitrate=1_000_000, sleep_after_open=0)
    raise SystemExit(__doc__)


def main():
    bus = connect(sys.argv[1:])
    found = scan(bus)
    assert sorted(found) == [1, 2, 3, 4, 5, 6], found
    print("found", {module: f"{version:#06x}" for module, version in found.items()})

    for module in found:
        q = get(bus, module, 0x3C, "f")
        low, high = get(bus, module, 0x45, "f"), get(bus, module, 0x46, "f")
        serial, state = get(bus, module, 0x1A, "I"), get(bus, module, 0x27, "I")
        v_max, a_max = get(bus, module, 0x48, "f"), get(bus, module, 0x4A, "f")
        assert low <= q <= high and v_max > 0 and a_max > 0 and get(bus, module, 0x20, "B") == module
        position, short, _ = position_state(bus, module)
        assert abs(position - q) < 0.01, (position, q)
        not_ok = state & (ERROR | HALTED) or not state & HOME_OK
        assert bool(short & NOT_OK) == bool(not_ok), f"short state {short:#04x} beside state {state:#010x}"
        print(f"module {module}: serial {serial}, {q:+.4f} rad in [{low:+.3f}, {high:+.3f}], state {state:#010x}")

    module = 6
    print(f"module {module}: homed in {home(bus, module):.1f} s")
    start, short, _ = position_state(bus, module)
    assert not short & NOT_OK, f"short state {short:#04x} after homing"

    target, velocity, acceleration = start + 0.5, 0.5, 2.0
    before, _, _ = ramp_extended(bus, module, target, velocity, acceleration)
    assert abs(before - start) < 0.01, "the answer holds the position before the move"
    began = time.monotonic()
    moving = False
    while True:
        position, short, _ = position_state(bus, module)
        moving |= bool(short & MOTION)
        if short & RAMP_END:
            break
        assert time.monotonic() - began < 10, f"no RAMP_END, at {position}"
        time.sleep(0.01)
    took = time.monotonic() - began
    assert moving and abs(position - target) < 0.01, (moving, position, target)
    # Trapezoid: distance / v + v / a.
    ideal = 0.5 / velocity + velocity / acceleration
    assert ideal - 0.1 < took < ideal + 0.5, f"took {took:.3f} s, ideal {ideal:.3f} s"
    print(f"module {module}: {start:+.4f} -> {position:+.4f} rad in {took:.2f} s (ideal {ideal:.2f} s)")

    bus.send(frame(ALL, [0x02]))
    time.sleep(0.1)
    state = get(bus, module, 0x27, "I")
    assert state & HALTED, f"HALTED after the broadcast, state {state:#010x}"
    simple(bus, module, 0x00)
    assert not get(bus, module, 0x27, "I") & HALTED, "RESET clears HALTED"

    latencies_ms.sort()
    count = len(latencies_ms)
    print(
        f"{count} answers: median {statistics.median(latencies_ms):.2f} ms, "
        f"99 % {latencies_ms[int(0.99 * (count - 1))]:.2f} ms, worst {latencies_ms[-1]:.2f} ms"
    )
    bus.shutdown()


main()
