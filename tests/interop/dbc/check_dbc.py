"""Reads the generated DBC file (first argument) with cantools and decodes frames with it.

The expected values are written here by hand from the protocol reference, so that neither the Rust
codec nor the generator is its own witness.
"""

import sys

import cantools

# The ramp-extended trace of the reference (module 5), then one frame of each kind.
# (frame, signals that must be there with these values)
TRACE = [
    ("0E5#084F0000803E", {"Command": "SET_PARAMETER", "SetParameter": "TargetVel", "Set_TargetVel": 0.25}),
    ("0A5#084F64", {"Command": "SET_PARAMETER", "SetParameter": "TargetVel", "SetAccepted": 0x64}),
    ("0E5#08500000003F", {"Command": "SET_PARAMETER", "SetParameter": "TargetAcc", "Set_TargetAcc": 0.5}),
    ("0A5#085064", {"Command": "SET_PARAMETER", "SetParameter": "TargetAcc", "SetAccepted": 0x64}),
    ("0E5#0B0E0000803F", {"Command": "SET_MOTION", "Motion": "FRAMPX", "FRAMPX_Target": 1.0}),
    (
        "0A5#0B0E000000BF1042",
        {
            "Command": "SET_MOTION",
            "Motion": "FRAMPX",
            "FRAMPX_Position": -0.5,
            "FRAMPX_NOT_OK": 0,
            "FRAMPX_MOTION": 1,
            "FRAMPX_RAMP_END": 0,
            "FRAMPX_Inputs": 0b0010,
            "FRAMPX_Outputs": 0b0100,
        },
    ),
    ("0C5#0A3C", {"Command": "GET_PARAMETER", "GetParameter": "ActPos"}),
    ("0A5#0A3C0000803F", {"GetParameter": "ActPos", "Get_ActPos": 1.0}),
    ("0A5#0A5AFEFFFFFF", {"GetParameter": "PosInc", "Get_PosInc": -2}),
    ("0A5#0A1D1446", {"GetParameter": "DefVersion", "Get_DefVersion": 0x4614}),
    ("0A5#0A542000", {"GetParameter": "ActC0", "Get_ActC0": 32}),
    ("0A5#0A2203", {"GetParameter": "DefCanBaud", "Get_DefCanBaud": 3}),
    (
        "0A5#0A2702800000",
        {"Get_CubeState_HOME_OK": 1, "Get_CubeState_RAMP_END": 1, "Get_CubeState_ERROR": 0},
    ),
    (
        "0A5#0A620000803E0190",
        {
            "Get_PosStateDio_Position": 0.25,
            "Get_PosStateDio_NOT_OK": 1,
            "Get_PosStateDio_MOTION": 0,
            "Get_PosStateDio_Inputs": 0,
            "Get_PosStateDio_Outputs": 0b1001,
        },
    ),
    ("0E5#0B100000003E3200", {"Motion": "FSTEPX", "FSTEPX_Target": 0.125, "FSTEPX_Time": 50}),
    ("0E5#0B0918FCFFFF", {"Motion": "IRAMP", "IRAMP_Target": -1000}),
    ("0A5#0B13E80300002000", {"Motion": "IRAMPX", "IRAMPX_Position": 1000, "IRAMPX_RAMP_END": 1}),
    ("0A5#0B0464", {"Motion": "FRAMP", "FRAMP_Accepted": 0x64}),
    ("065#06000000", {"State_ERROR": 0, "State_HOME_OK": 1, "State_HALTED": 1, "State_MOTION": 0}),
    ("100#0900", {"Command": "BAUD", "BaudCode": "125000 bit/s"}),
    ("100#0700", {"Command": "WATCHDOG"}),
]


def main() -> int:
    database = cantools.database.load_file(sys.argv[1], strict=True)
    assert len(database.messages) == 1 + 6 * 4, len(database.messages)
    failures = 0
    for text, expected in TRACE:
        # The reference's trace is of module 5, which is in the file.
        identifier, data = text.split("#")
        decoded = database.decode_message(int(identifier, 16), bytes.fromhex(data), allow_truncated=True)
        for name, value in expected.items():
            if name not in decoded or decoded[name] != value:
                failures += 1
                print(f"{text}: {name} is {decoded.get(name)!r}, not {value!r}", file=sys.stderr)
        # Nothing of another parameter or motion may appear: only bits of the same group.
        groups = {name.split("_")[0] + "_" + name.split("_")[1] for name in expected if "_" in name}
        groups |= {name.split("_")[0] for name in expected if "_" in name and not name.startswith(("Get_", "Set_"))}
        foreign = [
            name
            for name in decoded
            if name not in expected
            and name not in ("Command", "SetParameter", "GetParameter", "Motion")
            and not any(name.startswith(group + "_") for group in groups)
        ]
        if foreign:
            failures += 1
            print(f"{text}: signals of another frame: {foreign}", file=sys.stderr)

    # And back: what cantools encodes is what the reference sends.
    encoded = database.encode_message(
        0x0E5, {"Command": "SET_MOTION", "Motion": "FRAMPX", "FRAMPX_Target": 1.0}, padding=False
    )
    if not encoded.startswith(bytes.fromhex("0B0E0000803F")):
        failures += 1
        print(f"encoded FRAMPX: {encoded.hex()}", file=sys.stderr)
    print(f"{len(TRACE) + 1} frames against cantools {cantools.__version__}: {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
