#!/usr/bin/env python3
"""Golden vectors of every type of protocol::cyphal, made by pycyphal and nunavut from the .dsdl files.

Each line is `TYPE INPUT OUTPUT`: bytes in hexadecimal (`-` = none) as they may come from the bus, and the bytes
that result from reading and writing them again with the reference implementation (`invalid` = it refuses them).
Inputs are random objects, and the same bytes cut, extended and altered. Deterministic: the committed file
protocol/tests/cyphal_vectors.txt is the output of this script, and CI compares.

Needs CYPHAL_PATH with the public regulated data types and protocol/dsdl.
"""

import math
import random
import sys

import pycyphal.dsdl
import pydsdl

import cubecell
import cubecell.command
import uavcan.diagnostic
import uavcan.file
import uavcan.node
import uavcan.node.port
import uavcan.register

PER_TYPE = 16
LONGEST = 700  # bytes of input; larger objects are drawn again

TYPES = {
    "Heartbeat": uavcan.node.Heartbeat_1_0,
    "GetInfo.Response": uavcan.node.GetInfo_1_0.Response,
    "port.List": uavcan.node.port.List_1_0,
    "register.Value": uavcan.register.Value_1_0,
    "register.Access.Request": uavcan.register.Access_1_0.Request,
    "register.Access.Response": uavcan.register.Access_1_0.Response,
    "register.List.Request": uavcan.register.List_1_0.Request,
    "register.List.Response": uavcan.register.List_1_0.Response,
    "ExecuteCommand.Request": uavcan.node.ExecuteCommand_1_3.Request,
    "ExecuteCommand.Response": uavcan.node.ExecuteCommand_1_3.Response,
    "file.Read.Request": uavcan.file.Read_1_1.Request,
    "file.Read.Response": uavcan.file.Read_1_1.Response,
    "file.Write.Request": uavcan.file.Write_1_1.Request,
    "file.Write.Response": uavcan.file.Write_1_1.Response,
    "diagnostic.Record": uavcan.diagnostic.Record_1_1,
    "JointState": cubecell.JointState_1_0,
    "GroupState": cubecell.GroupState_1_2,
    "Stop": cubecell.Stop_1_0,
    "ArmPrepare": cubecell.command.ArmPrepare_1_0,
    "ArmOffer": cubecell.command.ArmOffer_1_0,
    "ArmConfirm": cubecell.command.ArmConfirm_1_0,
    "Trajectory": cubecell.command.Trajectory_1_0,
    "ClearFault": cubecell.command.ClearFault_1_0,
    "Home": cubecell.command.Home_1_0,
    "Jog": cubecell.command.Jog_1_0,
    "Gripper": cubecell.command.Gripper_1_0,
    "Refusal": cubecell.command.Refusal_1_0,
    "Challenge": cubecell.command.Challenge_1_0,
    "Authorization": cubecell.command.Authorization_1_0,
    "Unlock": cubecell.command.Unlock_1_0,
    "TargetState": cubecell.TargetState_1_0,
    "TargetAnswer": cubecell.TargetAnswer_1_0,
    "Run": cubecell.command.Run_1_0,
    "ClockReading": cubecell.command.ClockReading_1_0,
    "Room": cubecell.command.Room_1_0,
}

# What the schema allows and the meaning does not: states of the group that are not defined.
STATE_MAX = 9


def draw(model, rng):
    """Random object of a DSDL type, as the nested lists and dicts that pycyphal builds objects from."""
    if isinstance(model, pydsdl.DelimitedType):
        return draw(model.inner_type, rng)
    if isinstance(model, pydsdl.UnionType):
        field = rng.choice(model.fields)
        return {field.name: draw(field.data_type, rng)}
    if isinstance(model, pydsdl.CompositeType):
        return {f.name: draw(f.data_type, rng) for f in model.fields_except_padding}
    if isinstance(model, pydsdl.ArrayType):
        if isinstance(model, pydsdl.FixedLengthArrayType):
            length = model.capacity
        else:
            length = min(model.capacity, rng.choice([0, 1, 2, 3, rng.randint(0, model.capacity), model.capacity]))
        return [draw(model.element_type, rng) for _ in range(length)]
    if isinstance(model, pydsdl.BooleanType):
        return rng.random() < 0.5
    if isinstance(model, pydsdl.FloatType):
        top = float(model.inclusive_value_range.max)
        return rng.choice([0.0, 1.0, -1.0, math.inf, -math.inf, top, rng.uniform(-10, 10), rng.uniform(-1e-4, 1e-4)])
    low, high = (int(x) for x in model.inclusive_value_range)
    return rng.choice([low, high, rng.randint(low, high)])


def has_nan(value):
    if isinstance(value, float):
        return math.isnan(value)
    if isinstance(value, dict):
        return any(has_nan(v) for v in value.values())
    if isinstance(value, (list, tuple)):
        return any(has_nan(v) for v in value)
    return False


def write(obj):
    return b"".join(pycyphal.dsdl.serialize(obj))


def alter(data, rng):
    """The same bytes, perhaps cut, extended or changed."""
    data = bytearray(data)
    kind = rng.randrange(4)
    if kind == 0 and data:
        del data[rng.randrange(len(data)):]
    elif kind == 1:
        data += bytes(rng.randrange(256) for _ in range(rng.randint(1, 9)))
    elif data:
        for _ in range(kind - 1):
            data[rng.randrange(min(len(data), 24))] = rng.choice([0, 255, rng.randrange(256)])
    return bytes(data)


def vectors(dtype, rng):
    model = pycyphal.dsdl.get_model(dtype)
    made = 0
    while made < PER_TYPE:
        obj = pycyphal.dsdl.update_from_builtin(dtype(), draw(model, rng))
        data = write(obj)
        if made % 2 == 1:
            data = alter(data, rng)
        if len(data) > LONGEST:
            continue
        read = pycyphal.dsdl.deserialize(dtype, [memoryview(data)])
        if read is None:
            yield data, "invalid"
        elif has_nan(pycyphal.dsdl.to_builtin(read)) or getattr(read, "state", 0) > STATE_MAX:
            continue
        elif getattr(read, "differing_setting", 1) == 0:
            # Values without a setting mean nothing; the three numbers are not sent if they are zero.
            if read.differing_found or read.differing_expected:
                continue
            yield data, write(read)[:-12].hex()
        else:
            yield data, write(read).hex() or "-"
        made += 1


def main():
    rng = random.Random(20260101)
    print("# Made by tests/interop/cyphal/make_vectors.py; do not edit.")
    for name, dtype in TYPES.items():
        for data, result in vectors(dtype, rng):
            print(name, data.hex() or "-", result)


if __name__ == "__main__":
    sys.exit(main())
