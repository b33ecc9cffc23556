//! Settings that only PowerCubes have.

use crate::fault::{Cause, Refusal};
use crate::registers::family::{self, GROUP, JOINT, bit, family_registers, natural, real, reals};
use crate::registers::{FamilyRegisters, FamilySetting, RegisterInfo, Wider, Writable};
use crate::settings::Settings;

family_registers! {
    check check;
    MONITORING "cycle.monitoring": bool = bit(true), GROUP, 0.0, 1.0, AtRest, No, "read one drive's current or state word per cycle, in turn";
    IN_FLIGHT_MAX "drives.in_flight_max": u32 = natural(4), GROUP, 1.0, 8.0, AtRest, No, "drives with a request in flight at the same time";
    REACH_RAD "ramp.reach_rad": f32 = real(3.0), GROUP, 0.5, 6.3, AtRest, More, "distance of the target of a motion command ahead of the measured position";
    WATCHDOG_ENABLE "watchdog.enable": bool = bit(true), GROUP, 0.0, 1.0, NextStart, Less, "switch the drives' watchdogs on";
    GRIPPER_ADDRESS "gripper.address": u32 = natural(6), GROUP, 0.0, 31.0, AtRest, No, "module whose output drives the gripper, 0 for the board's own output";
    GRIPPER_LINE "gripper.line": u32 = natural(0), GROUP, 0.0, 3.0, AtRest, No, "output line of that module";
    SLOW_CURRENT_A "joint.slow_current_a": f32 = reals([15.0, 15.0, 15.0, 7.5, 7.5, 7.5, 7.5, 7.5]), JOINT, 0.1, 60.0, AtRest, More, "current limit of the drive while homing and jogging";
    HOME_V_RAD_S "joint.home_v_rad_s": f32 = real(-0.1), JOINT, -0.5, 0.5, AtRest, No, "speed of homing with its direction, of the drive";
}

fn check(settings: &Settings) -> Result<(), Refusal> {
    let is_wrong = |joint: &_| {
        let limits = settings.joint.at(*joint);
        // Written so that NaN fails.
        let in_order = HOME_V_RAD_S.at(settings, *joint).abs() <= limits.v_max_rad_s
            && SLOW_CURRENT_A.at(settings, *joint) <= limits.current_max_a;
        !in_order
    };
    match settings.joints().find(is_wrong) {
        Some(joint) => Err(Refusal::at(Cause::SettingsInvalid, joint)),
        None => Ok(()),
    }
}
