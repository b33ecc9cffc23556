"""The maker's DBC of CANSimple, as odrive-can brings it, against the frames of a motion that our controller made with simulated ODrives.

    python odrive_frames.py BUS_LOG

Every 11-bit frame of the log belongs to an axis, and the DBC knows it; what the controller sends is what its file says.
"""

import math
import sys

from odrive_can import get_dbc

JOINTS = range(9, 15)
# The joints, and the hand: it is asked where it stands only when it is found.
NODES = [*JOINTS, 15]
ASKED = {"Get_Version", "Get_Encoder_Estimates"}

dbc = get_dbc("odrive-cansimple-0.6.10")
kinds = {}
for message in dbc.messages:
    node, _, name = message.name.partition("_")
    if node == "Axis0":
        kinds[message.frame_id & 0x1F] = (name, message)
seen = {name: [] for name, _ in kinds.values()}
requests = dict.fromkeys(ASKED, 0)
for line in open(sys.argv[1]):
    frame = line.split()[2]
    identifier, data = frame.split("#")
    if len(identifier) > 3:
        continue
    node, command = int(identifier, 16) >> 5, int(identifier, 16) & 0x1F
    assert node in NODES, line
    name, message = kinds[command]
    payload = bytes.fromhex(data)
    if not payload:
        assert name in ASKED or name in {"Clear_Errors", "Estop"}, line
        if name in ASKED:
            requests[name] += 1
        continue
    # Orders without parameters may have one byte.
    if message.length > len(payload):
        assert name == "Clear_Errors", line
        continue
    seen[name].append((node, message.decode(payload[: message.length], decode_choices=True)))

assert all(count >= len(NODES) for count in requests.values()), requests
assert sum(map(len, seen.values())) > 10_000
for node in NODES:
    of = {name: [fields for at, fields in rows if at == node] for name, rows in seen.items()}
    assert str(of["Set_Axis_State"][-1]["Axis_Requested_State"]) == "CLOSED_LOOP_CONTROL"
    mode = of["Set_Controller_Mode"][-1]
    assert [str(mode["Control_Mode"]), str(mode["Input_Mode"])] == ["POSITION_CONTROL", "PASSTHROUGH"], mode
    assert any("WATCHDOG" in str(f["Axis_Error"]) for f in of["Heartbeat"]), "no watchdog was proven"
    assert str(of["Heartbeat"][-1]["Axis_State"]) == "CLOSED_LOOP_CONTROL"
    points, estimates = of["Set_Input_Pos"], of["Get_Encoder_Estimates"]
    least = 500 if node in JOINTS else 1
    assert len(points) > 500 and len(estimates) >= least, (node, len(points), len(estimates))
    last = points[-1]
    assert math.isclose(last["Input_Pos"], estimates[-1]["Pos_Estimate"], abs_tol=1e-3), (last, estimates[-1])
    assert last["Vel_FF"] == 0.0
    # 72 deg/s of the joint, which the axis counts.
    fastest = max(abs(point["Vel_FF"]) for point in points)
    assert fastest <= 0.2 * 1.25, fastest
print({name: len(rows) for name, rows in seen.items() if rows}, "requests", requests)
