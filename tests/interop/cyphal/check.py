#!/usr/bin/env python3
"""pycyphal, unmodified, against the demo node (protocol/link/examples/cyphal_node.rs) over socketcand.

    check.py HOST PORT services     registers of every type, commands, node info, port list, stop
    check.py HOST PORT upload       a 7 680-byte file.Write, read back; hashes must agree
    check.py HOST PORT upload-lossy the same; frames must have been lost on the way

Exits with an assertion if anything differs.
"""

import asyncio
import hashlib
import logging
import random
import sys
import time

import pycyphal
from pycyphal.presentation import Presentation
from pycyphal.transport.can import CANTransport
from pycyphal.transport.can.media.socketcand import SocketcandMedia
from pycyphal.transport.commons.crc import CRC64WE

import cubecell
import uavcan.file
import uavcan.node
import uavcan.node.port
import uavcan.primitive
import uavcan.register

NODE = 42
# An address for each run: transfer numbers begin at 0 again, and one that repeats the last number of the run before
# within two seconds is a duplicate by the rules of the transport.
OURS = {"services": 100, "upload": 102, "upload-lossy": 103}
FILE = "trajectory"
FILE_LEN = 7680
PIECE = 256
COMMAND_REVERSE = 100
COMMAND_FILE_CRC = 101
STOP_SUBJECT = 1000


class Peer:
    """The demo node as seen by pycyphal; repeats what is not answered in time."""

    def __init__(self, presentation):
        self.presentation = presentation
        self.clients = {}
        self.repeated = 0

    async def call(self, dtype, request, timeout=1.0, attempts=1):
        service = pycyphal.dsdl.get_fixed_port_id(dtype)
        client = self.clients.get(service)
        if client is None or client.dtype is not dtype:
            if client is not None:  # pycyphal has one type for a service at a time.
                client.close()
            client = self.clients[service] = self.presentation.make_client_with_fixed_service_id(dtype, NODE)
        client.response_timeout = timeout
        for attempt in range(attempts):
            self.repeated += attempt > 0
            result = await client.call(request)
            if result is not None:
                return result[0]
        raise AssertionError(f"no answer from {dtype} in {attempts} attempts")

    async def access(self, name, value=None, **options):
        request = uavcan.register.Access_1.Request(name=uavcan.register.Name_1(name), value=value)
        return await self.call(uavcan.register.Access_1, request, **options)

    async def register_names(self):
        names = []
        while True:
            request = uavcan.register.List_1.Request(len(names))
            name = (await self.call(uavcan.register.List_1, request)).name.name.tobytes().decode()
            if not name:
                return names
            names.append(name)

    async def command(self, number, parameter=b"", dtype=uavcan.node.ExecuteCommand_1_3, **options):
        return await self.call(dtype, dtype.Request(number, parameter), **options)


def write(value):
    return b"".join(pycyphal.dsdl.serialize(value))


def altered(value):
    """Another value of the same type and length: elements in reverse order, or all zero; bits inverted."""
    kind = next(k for k in pycyphal.dsdl.to_builtin(value))
    array = getattr(value, kind).value
    turned = ~array if kind == "bit" else array[::-1].copy()
    array = turned if any(turned != array) else array * 0
    return uavcan.register.Value_1(**{kind: type(getattr(value, kind))(array)})


async def check_services(peer):
    heartbeats = peer.presentation.make_subscriber_with_fixed_subject_id(uavcan.node.Heartbeat_1)
    port_lists = peer.presentation.make_subscriber_with_fixed_subject_id(uavcan.node.port.List_1)

    info = await peer.call(uavcan.node.GetInfo_1, uavcan.node.GetInfo_1.Request())
    assert info.name.tobytes().decode() == "org.cubecell.demo", info
    assert info.unique_id.tobytes() == b"demo-node-000001"
    assert list(info.software_image_crc) == [0xFEDCBA9876543210]
    print("GetInfo:", info.name.tobytes().decode())

    names = await peer.register_names()
    assert len(names) == 19 and names[0] == "uavcan.node.description", names
    kinds = set()
    for name in names:
        before = await peer.access(name)
        kind = next(k for k in pycyphal.dsdl.to_builtin(before.value))
        if not before.mutable:
            after = await peer.access(name, altered(before.value))
            assert write(after.value) == write(before.value), f"{name} is not mutable"
            continue
        kinds.add(kind)
        wanted = altered(before.value)
        assert write(wanted) != write(before.value), name
        after = await peer.access(name, wanted)
        assert write(after.value) == write(wanted), (name, wanted, after)
        assert after.mutable and after.persistent
        again = await peer.access(name)
        assert write(again.value) == write(wanted), (name, wanted, again)
    expected = {"string", "unstructured", "bit"}
    expected |= {f"{t}{w}" for t in ("integer", "natural") for w in (8, 16, 32, 64)} | {"real16", "real32", "real64"}
    assert kinds == expected, kinds ^ expected
    assert (await peer.access("no.such")).value.empty is not None
    print(f"registers: {len(names)} listed, {len(kinds)} types written and read back")

    answer = await peer.command(COMMAND_REVERSE, b"abc")
    assert (answer.status, answer.output.tobytes()) == (0, b"cba"), answer
    assert (await peer.command(9999)).status == uavcan.node.ExecuteCommand_1_3.Response.STATUS_BAD_COMMAND
    older = await peer.command(COMMAND_REVERSE, b"abc", dtype=uavcan.node.ExecuteCommand_1_1)
    assert older.status == 0
    print("commands: status and output, also by a client of version 1.1")

    stops = peer.presentation.make_publisher(cubecell.Stop_1, STOP_SUBJECT)
    stops.priority = pycyphal.transport.Priority.EXCEPTIONAL
    for _ in range(3):
        assert await stops.publish(cubecell.Stop_1(reason=cubecell.Stop_1.REASON_OPERATOR))
    heard = (await peer.access("demo.stops_heard")).value.natural32.value[0]
    assert heard == 3, heard
    print("stop: 3 sent, 3 heard")

    seen = []
    deadline = time.monotonic() + 8.0
    while len(seen) < 3 and time.monotonic() < deadline:
        got = await heartbeats.receive_for(1.5)
        if got and got[1].source_node_id == NODE:
            seen.append(got)
    assert len(seen) == 3, seen
    uptimes = [message.uptime for message, _ in seen]
    numbers = [transfer.transfer_id for _, transfer in seen]
    assert uptimes == [uptimes[0] + n for n in range(3)], uptimes
    assert numbers == [(numbers[0] + n) % 32 for n in range(3)], numbers
    assert (seen[0][0].health.value, seen[0][0].mode.value, seen[0][0].vendor_specific_status_code) == (1, 2, 7)
    print("heartbeat: uptimes", uptimes)

    while True:
        got = await port_lists.receive_for(max(0.1, deadline + 4 - time.monotonic()))
        assert got, "no port list within the period"
        if got[1].source_node_id == NODE:
            break
    heartbeats.close()
    port_lists.close()
    stops.close()
    servers = [i for i, on in enumerate(got[0].servers.mask) if on]
    assert servers == [384, 385, 406, 408, 409, 430, 435], servers
    assert [s.value for s in got[0].publishers.sparse_list] == [7509, 7510, 8184]
    assert [s.value for s in got[0].subscribers.sparse_list] == [STOP_SUBJECT]
    print("port list: servers", servers)


async def check_upload(peer, lossy):
    # 40 frames of a request take a few milliseconds here; with 1/60 loss every other one is incomplete.
    options = {"timeout": 0.15, "attempts": 40} if lossy else {"timeout": 2.0, "attempts": 1}
    data = random.Random(7).randbytes(FILE_LEN)
    path = uavcan.file.Path_2(FILE)
    begin = time.monotonic()
    for offset in [*range(0, FILE_LEN, PIECE), FILE_LEN]:
        piece = uavcan.primitive.Unstructured_1(data[offset:offset + PIECE])
        request = uavcan.file.Write_1_1.Request(offset=offset, path=path, data=piece)
        answer = await peer.call(uavcan.file.Write_1_1, request, **options)
        assert answer.error.value == 0, (offset, answer)
    seconds = time.monotonic() - begin

    crc = int.from_bytes(CRC64WE.new(data).value_as_bytes, "big")
    answer = await peer.command(COMMAND_FILE_CRC, **options)
    assert answer.status == 0 and int.from_bytes(answer.output.tobytes(), "little") == crc, answer
    register = await peer.access("file.crc64", **options)
    assert register.value.natural64.value[0] == crc

    names = []
    while True:
        request = uavcan.file.List_0_2.Request(entry_index=len(names), directory_path=uavcan.file.Path_2("/"))
        answer = await peer.call(uavcan.file.List_0_2, request, **options)
        name = answer.entry_base_name.path.tobytes().decode()
        if not name:
            break
        names.append(name)
    assert names == [FILE], names

    back = b""
    while True:
        request = uavcan.file.Read_1_1.Request(offset=len(back), path=path)
        answer = await peer.call(uavcan.file.Read_1_1, request, **options)
        assert answer.error.value == 0
        piece = answer.data.value.tobytes()
        back += piece
        if len(piece) < PIECE:
            break
    assert hashlib.sha256(back).digest() == hashlib.sha256(data).digest()

    lost = int((await peer.access("demo.frames_lost", **options)).value.natural32.value[0])
    if lossy:
        assert lost > 20 and peer.repeated > 5, (lost, peer.repeated)
    else:
        assert (lost, peer.repeated) == (0, 0), (lost, peer.repeated)
    print(f"upload: {FILE_LEN} bytes, crc64 {crc:016x}, {lost} frames lost, {peer.repeated} calls repeated, "
          f"{seconds:.2f} s")


async def main(host, port, what):
    transport = CANTransport(SocketcandMedia("can0", host, int(port)), OURS[what])
    presentation = Presentation(transport)
    peer = Peer(presentation)
    try:
        if what == "services":
            await check_services(peer)
        else:
            await check_upload(peer, lossy=what == "upload-lossy")
    finally:
        for client in peer.clients.values():
            client.close()
        presentation.close()


if __name__ == "__main__":
    # python-can warns of every message that arrives in two pieces.
    logging.getLogger("can").setLevel(logging.ERROR)
    asyncio.run(main(*sys.argv[1:]))
