"""canopen (BaseNode402), unmodified, against `hil-sim serve-motors`: identity, maps, states, homing, set points, supervision.

    CAN_CONFIG='{"host": HOST, "port": PORT, "tcp_tune": true}' python cia402.py

Its servo is node 3.
"""

import pathlib
import time

import canopen
from canopen import objectdictionary as od
from canopen.profiles.p402 import BaseNode402
from canopen.sdo import SdoAbortedError

U8, I8, U16, I16, U32, I32, TEXT = (
    od.UNSIGNED8,
    od.INTEGER8,
    od.UNSIGNED16,
    od.INTEGER16,
    od.UNSIGNED32,
    od.INTEGER32,
    od.VISIBLE_STRING,
)
PERIOD_S = 0.01
COUNTS_PER_TURN = 409_600
NAMES = {
    0x1000: U32, 0x1001: U8, 0x1008: TEXT, 0x1017: U16, 0x1022: U8, 0x6007: I16, 0x603F: U16, 0x6040: U16, 0x6041: U16, 0x6060: I8,
    0x6061: I8, 0x6064: I32, 0x6065: U32, 0x607A: I32, 0x607C: I32, 0x6098: I8, 0x6502: U32, 0x60FF: I32,
}  # fmt: skip
RECORDS = {0x1016: [U8, U32], 0x1018: [U8] + 4 * [U32], 0x1029: [U8, U8], 0x60C2: [U8, U8, I8]}


def dictionary():
    every = od.ObjectDictionary()

    def variable(index, sub, kind, parent=None):
        var = od.ODVariable(f"object {index:04x}:{sub}", index, sub)
        var.data_type, var.parent = kind, parent
        (parent.add_member if parent is not None else every.add_object)(var)

    for index, kind in NAMES.items():
        variable(index, 0, kind)
    records = dict(RECORDS)
    for number in range(4):
        for base in (0x1400, 0x1800):
            records[base + number] = [U8, U32, U8]
            records[base + 0x200 + number] = [U8] + 8 * [U32]
    for index, kinds in records.items():
        record = od.ODRecord(f"record {index:04x}", index)
        for sub, kind in enumerate(kinds):
            variable(index, sub, kind, record)
        every.add_object(record)
    return every


def wait(what, true, patience_s=3.0):
    end = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < end, what
        time.sleep(0.005)


def aborted(code, act):
    try:
        act()
    except SdoAbortedError as error:
        assert error.code == code, error
        return
    raise AssertionError(f"nothing was refused with {code:#x}")


network = canopen.Network()
network.connect(interface="socketcand", channel="can0")
try:
    node = BaseNode402(3, dictionary())
    network.add_node(node)
    node.nmt.state = "RESET"
    node.nmt.wait_for_bootup(3.0)
    node.sdo[0x1017].raw = 100
    node.nmt.wait_for_heartbeat(3.0)
    assert node.nmt.state == "PRE-OPERATIONAL"
    assert node.sdo[0x1000].raw & 0xFFFF == 402
    assert node.sdo[0x1008].raw == "simulated servo of CiA 402"
    aborted(0x06010002, lambda: setattr(node.sdo[0x1000], "raw", 1))
    aborted(0x06020000, lambda: node.sdo.upload(0x2000, 0))
    aborted(0x06090011, lambda: node.sdo.upload(0x1018, 9))
    print("identity: profile 402,", node.sdo[0x1008].raw)

    # The sheet that the servo stores, in blocks and in segments: 127 segments of 7 bytes are a block.
    sheet = pathlib.Path("hil-sim/src/drive/cia402/simulated_servo.eds").read_bytes()
    assert len(sheet) > 10 * 127 * 7 and node.sdo[0x1022].raw == 0
    for in_blocks in (True, False):
        with node.sdo.open(0x1021, 0, "rb", block_transfer=in_blocks) as stored:
            assert stored.read() == sheet, in_blocks
    print("sheet:", len(sheet), "bytes in blocks and in segments")

    # The maps, as this client sets them.
    node.pdo.read()
    node.rpdo[1].clear()
    node.rpdo[1].add_variable(0x6040)
    node.rpdo[1].add_variable(0x607A)
    node.tpdo[1].clear()
    node.tpdo[1].add_variable(0x6041)
    node.tpdo[1].add_variable(0x6064)
    for pdo in (node.rpdo[1], node.tpdo[1]):
        pdo.trans_type, pdo.enabled = 1, True
        pdo.save()
    node.tpdo[2].clear()
    node.tpdo[2].add_variable(0x6061)
    node.tpdo[2].trans_type, node.tpdo[2].enabled = 1, True
    node.tpdo[2].save()
    node.sdo[0x60C2][1].raw, node.sdo[0x60C2][2].raw = 1, -2
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    node.rpdo[1].start(PERIOD_S)
    network.sync.start(PERIOD_S)
    wait("process data", lambda: node.state == "SWITCH ON DISABLED")

    node.sdo[0x6098].raw = 37
    assert node.homing(timeout=5), "homing"
    node.state = "READY TO SWITCH ON"
    print("homing: here is zero")

    node.op_mode = "CYCLIC SYNCHRONOUS POSITION"
    assert node.op_mode == "CYCLIC SYNCHRONOUS POSITION"
    node.rpdo[1][0x607A].raw = node.tpdo[1][0x6064].raw
    node.state = "OPERATION ENABLED"
    # Half a radian in a second.
    end, steps = COUNTS_PER_TURN // 12, 100
    for step in range(1, steps + 1):
        node.rpdo[1][0x607A].raw = end * step // steps
        time.sleep(PERIOD_S)
    wait("the last set point", lambda: abs(node.tpdo[1][0x6064].raw - end) < 5)
    print("set points: held at", node.tpdo[1][0x6064].raw, "counts")

    # Nobody's heartbeat comes: a fault, an emergency, and a reset.
    network.send_message(0x77F, b"\x05")
    node.sdo[0x1029][1].raw = 1
    node.sdo[0x1016][1].raw = 0x7F << 16 | 100
    network.send_message(0x77F, b"\x05")
    wait("a fault", lambda: node.state == "FAULT")
    assert node.emcy.active[-1].code == 0x8130, node.emcy.active
    assert node.sdo[0x603F].raw == 0x8130
    node.reset_from_fault()
    assert node.state == "OPERATION ENABLED", node.state
    assert node.sdo[0x1001].raw == 0
    node.state = "SWITCH ON DISABLED"
    print("supervision: fault 8130, cleared")
finally:
    network.sync.stop()
    network.disconnect()
