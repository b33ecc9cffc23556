"""odrive-can, unmodified, against `hil-sim serve-motors`: index search, position, trapezoid, velocity, watchdog, requests, errors.

    python odrive.py HOST PORT

Its axes speak 0.6: 0 knows its place, 1 searches its index first. Without an order for 500 ms they give no torque.
"""

import asyncio
import sys

import can
from odrive_can.odrive import DriveError, ODriveCAN

PATIENCE_S = 5.0


async def wait(what, true, feed=None):
    for _ in range(int(PATIENCE_S / 0.02)):
        if await true() if asyncio.iscoroutinefunction(true) else true():
            return
        if feed:
            feed()
        await asyncio.sleep(0.02)
    raise AssertionError(f"not within {PATIENCE_S} s: {what}")


async def position(axis):
    return (await axis.get_encoder_estimates())["Pos_Estimate"]


def heartbeat(axis):
    return axis._last_heartbeat.data


async def main(host, port):
    def bus():
        return can.Bus(interface="socketcand", host=host, port=port, channel="can0")

    shoulder, wrist = ODriveCAN(0, bus()), ODriveCAN(1, bus())
    await shoulder.start()
    await wrist.start()
    shoulder.check_alive()
    shoulder.check_errors()
    assert heartbeat(shoulder)["Axis_State"] == "IDLE", heartbeat(shoulder)
    supply = await shoulder.get_bus_voltage_current()
    assert abs(supply["Bus_Voltage"] - 24.0) < 0.1, supply

    # Position, direct: the client's frames of mode, state and set point.
    shoulder.set_controller_mode("POSITION_CONTROL", "PASSTHROUGH")
    await asyncio.wait_for(shoulder.set_axis_state("CLOSED_LOOP_CONTROL"), PATIENCE_S)

    def hold(turns):
        return lambda: shoulder.set_input_pos(turns)

    async def at_two():
        return abs(await position(shoulder) - 2.0) < 0.01

    await wait("2 turns", at_two, hold(2.0))
    print("position: held", await position(shoulder))

    # A trapezoid is over when the axis says so.
    shoulder.set_controller_mode("POSITION_CONTROL", "TRAP_TRAJ")
    shoulder.set_traj_vel_limit(4.0)
    shoulder.set_traj_accel_limits(8.0, 8.0)
    shoulder.set_input_pos(6.0)
    await wait("it is under way", lambda: heartbeat(shoulder)["Trajectory_Done_Flag"] == 0, lambda: shoulder.set_traj_vel_limit(4.0))
    await wait("it has arrived", lambda: heartbeat(shoulder)["Trajectory_Done_Flag"] == 1, lambda: shoulder.set_traj_vel_limit(4.0))
    arrived = await position(shoulder)
    # A pause of this client for longer than the watchdog ends the motion, too.
    assert abs(arrived - 6.0) < 0.05, (arrived, heartbeat(shoulder))
    print("trapezoid: arrived at", arrived)

    # Nobody orders anything: no torque, and an error with its name in the client's table.
    await wait("it starves", lambda: heartbeat(shoulder)["Axis_State"] == "IDLE")
    try:
        shoulder.check_errors()
        raise AssertionError("no error")
    except DriveError as error:
        print("watchdog:", error)
        assert "WATCHDOG" in str(error), error
    shoulder.clear_errors()
    await wait("cleared", lambda: heartbeat(shoulder)["Axis_Error"] == "NONE")

    # The other axis refuses torque until it has found its index.
    wrist.set_axis_state_no_wait("CLOSED_LOOP_CONTROL")
    await wait("refused", lambda: heartbeat(wrist)["Procedure_Result"] == "NOT_CALIBRATED")
    assert heartbeat(wrist)["Axis_State"] == "IDLE"
    wrist.set_axis_state_no_wait("ENCODER_INDEX_SEARCH")
    await wait("it searches", lambda: heartbeat(wrist)["Axis_State"] == "ENCODER_INDEX_SEARCH")
    await wait("found", lambda: heartbeat(wrist)["Axis_State"] == "IDLE")
    wrist.set_controller_mode("VELOCITY_CONTROL", "PASSTHROUGH")
    await asyncio.wait_for(wrist.set_axis_state("CLOSED_LOOP_CONTROL"), PATIENCE_S)

    async def turns():
        return abs((await wrist.get_encoder_estimates())["Vel_Estimate"] - 3.0) < 0.05

    await wait("3 turns/s", turns, lambda: wrist.set_input_vel(3.0))
    print("velocity:", await wrist.get_encoder_estimates())
    wrist.set_input_vel(0.0)
    wrist.stop()
    await wait("idle", lambda: heartbeat(shoulder)["Axis_State"] == "IDLE")
    shoulder.stop()


asyncio.run(main(sys.argv[1], int(sys.argv[2])))
