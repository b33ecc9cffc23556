"""damiao-motor, unmodified, against `hil-sim serve-motors`: identity, modes, set points, time-out, zero.

    CAN_CONFIG='{"host": HOST, "port": PORT, "tcp_tune": true}' python damiao.py

Its motors are one 8009 at 1, which answers on 0x11, and one 4310 at 2, which answers on 0x12.
"""

import sys
import time

from damiao_motor.core.controller import DaMiaoController
from damiao_motor.core.motor import MOTOR_TYPE_PRESETS

PATIENCE_S = 3.0


def wait(what, true, patience_s=PATIENCE_S):
    end = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < end, f"{what}: {[motor.get_states() for motor in controller.motors.values()]}"
        time.sleep(0.005)


def read(motor, register):
    """The register as the motor has it now: the client keeps what it has read once."""
    with motor.registers_lock:
        motor.registers.pop(register, None)
    return motor.get_register(register, timeout=PATIENCE_S)


def state(motor):
    return motor.get_states()


def command(motor, seconds, **set_point):
    """The set point at 100 Hz."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        motor.send_cmd_mit(**set_point)
        time.sleep(0.01)


def status(motor, wanted):
    def heard():
        motor.request_motor_feedback()
        time.sleep(0.02)
        return state(motor).get("status") == wanted

    wait(f"status {wanted}", heard)


controller = DaMiaoController(channel="can0", bustype="socketcand")
try:
    shoulder = controller.add_motor(1, 0x11, "8009")
    wrist = controller.add_motor(2, 0x12, "4310")
    for motor, name, gear in [(shoulder, "8009", 9), (wrist, "4310", 10)]:
        preset = MOTOR_TYPE_PRESETS[name]
        ranges = [read(motor, register) for register in (21, 22, 23)]
        assert ranges == [preset["p_max"], preset["v_max"], preset["t_max"]], ranges
        assert read(motor, 20) == gear and read(motor, 10) == 1
    print("identity: ranges and gears are those of the client's table")

    # The frame of a set point, byte by byte.
    golden = shoulder.encode_cmd_msg(1.0, 2.0, 3.0, 100.0, 2.0)
    assert golden.hex() == "8a3c85a333666871", golden.hex()

    shoulder.set_can_timeout(100)
    time.sleep(0.05)
    assert read(shoulder, 9) == 2000

    shoulder.enable()
    status(shoulder, "ENABLED")
    command(shoulder, 1.0, target_position=0.5, target_velocity=0.0, stiffness=40.0, damping=4.0, feedforward_torque=0.0)
    wait("it holds 0.5 rad", lambda: abs(state(shoulder)["pos"] - 0.5) < 0.01)
    assert abs(state(shoulder)["vel"]) < 0.05, state(shoulder)
    print("set points: held", state(shoulder)["pos"])

    # Nobody commands: it gives no torque until its fault is cleared.
    time.sleep(0.3)
    status(shoulder, "LOST_COMM")
    shoulder.enable()
    status(shoulder, "LOST_COMM")
    shoulder.clear_error()
    status(shoulder, "DISABLED")
    print("time-out: torque off until it was cleared")

    shoulder.set_zero_position()
    status(shoulder, "DISABLED")
    wait("zero here", lambda: abs(state(shoulder)["pos"]) < 0.01)

    # Another mode, on the other motor. The first one hears nothing of it. Not by `ensure_control_mode`: it verifies what it wrote with the
    # value that it had read before.
    wrist.write_register(10, 2)
    time.sleep(0.05)
    assert read(wrist, 10) == 2
    wrist.enable()
    status(wrist, "ENABLED")
    wrist.send_cmd_pos_vel(target_position=1.0, velocity_limit=2.0)

    def arrived():
        wrist.request_motor_feedback()
        time.sleep(0.02)
        return abs(state(wrist)["pos"] - 1.0) < 0.02 and abs(state(wrist)["vel"]) < 0.05

    wait("position mode", arrived)
    wrist.disable()
    status(wrist, "DISABLED")
    assert abs(state(shoulder)["pos"]) < 0.01
    print("position mode: arrived at", state(wrist)["pos"])
finally:
    controller.shutdown()
sys.exit(0)
