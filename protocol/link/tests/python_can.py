"""python-can, unmodified, against the echo server: handshake, 11- and 29-bit frames, remote frames,
two clients at once, and many connections while the bus is busy.

    python python_can.py SPEC

SPEC is what the server prints: socketcand://HOST:PORT/BUS, slcan://HOST:PORT or slcan:DEVICE.
"""

import itertools
import sys
import threading
import time

import can

spec = sys.argv[1]
kind, place = spec.split(":", 1)


def connect():
    if kind == "socketcand":
        address, channel = place.removeprefix("//").split("/")
        host, port = address.split(":")
        return can.Bus(interface="socketcand", channel=channel, host=host, port=int(port))
    # pyserial opens TCP ports as socket://HOST:PORT.
    channel = f"socket:{place}" if place.startswith("//") else place
    # python-can waits two seconds after opening by default, for adapters that start up.
    return can.Bus(interface="slcan", channel=channel, bitrate=1_000_000, sleep_after_open=0.1)


def exchange(bus, message):
    """The answer to `message`: same id and format, data inverted."""
    bus.send(message)
    while True:
        answer = bus.recv(timeout=5)
        assert answer is not None, f"no answer to {message}"
        if answer.arbitration_id == message.arbitration_id:
            return answer


def check_answer(bus, identifier, extended, data):
    message = can.Message(arbitration_id=identifier, is_extended_id=extended, data=data)
    answer = exchange(bus, message)
    assert answer.is_extended_id == extended, answer
    assert bytes(answer.data) == bytes(byte ^ 0xFF for byte in data), (answer, data)
    assert kind == "slcan" or abs(answer.timestamp - time.time()) < 10, f"time stamp {answer.timestamp} is not Unix time"


with connect() as bus:
    count = 0
    for extended, identifiers in (
        (False, (0x000, 0x0A5, 0x7FF)),
        (True, (0x00000000, 0x0000007F, 0x7FF, 0x800, 0x1FFFFFFF)),
    ):
        for identifier, length in itertools.product(identifiers, range(9)):
            check_answer(bus, identifier, extended, bytes(range(length)))
            count += 1
    print(f"{count} frames answered, 11 and 29 bits, 0 to 8 bytes")

    # A serial line has one end, a port has room for a second client.
    if place.startswith("//"):
        other = connect()
        time.sleep(0.2)
        bus.send(can.Message(arbitration_id=0x321, is_extended_id=False, data=b"\x01\x02"))
        seen = {bytes(other.recv(timeout=5).data) for _ in range(2)}
        # The sender's frame and the echo; the sender itself gets the echo alone.
        assert seen == {b"\x01\x02", b"\xfe\xfd"}, seen
        assert bytes(bus.recv(timeout=5).data) == b"\xfe\xfd"
        assert bus.recv(timeout=0.2) is None
        other.shutdown()
        print("a second client sees the frame and its echo, the sender only the echo")

    # A remote frame goes through; over socketcand, python-can cannot read the answer and must not
    # stumble over it.
    bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=4))
    if kind == "slcan":
        answer = bus.recv(timeout=5)
        assert answer.is_remote_frame and answer.dlc == 4, answer
    check_answer(bus, 0x124, False, b"\x55")
    print("remote frame sent, the connection still works")

if kind != "socketcand":
    # The rest is about its handshake.
    sys.exit()

stop = threading.Event()


def babble():
    with connect() as bus:
        while not stop.is_set():
            bus.send(can.Message(arbitration_id=0x10, is_extended_id=False, data=bytes(8)))
            time.sleep(0.0005)


babbler = threading.Thread(target=babble)
babbler.start()
try:
    for _ in range(30):
        with connect() as bus:
            check_answer(bus, 0x0A5, False, b"\x01")
    print("30 handshakes while another client babbles")
finally:
    stop.set()
    babbler.join()
