//! What a drive holds beside its ramp registers: the one list of it, what it must be before the group is armed, and the slow look
//! at whether it still is.
//!
//! | what | must be | written by |
//! |---|---|---|
//! | current limit | `joint.current_max_a`; less in a jog and in a homing | finding, homing, jogging, and here |
//! | configuration | as found, with the watchdog as set, answers to writes, motions that start at once | finding |
//! | homing speed | `joint.home_v_rad_s` | each homing, before it begins |
//! | ramp speed and acceleration | [`Loaded`](super::ramp::Loaded) | each motion, before it begins |
//!
//! A jog or a homing that is stopped leaves its lower current behind: it is put back while the joints stand. Whoever else
//! writes to the drives is found by reading both again, standing and in a run, in the place of a current reading.

use protocol::JointIndex;
use protocol::powercube::{Config, Parameter, Request, Value};

use super::{Mode, PowerCubes};
use crate::fault::{Cause, Fault};
use crate::settings::Settings;

/// Share by which a value read may differ from the one written: a drive may keep digits.
const READ_BACK_SHARE: f32 = 0.01;

impl PowerCubes {
    /// True if the drive has acknowledged what the settings say.
    pub(super) fn holds_settings(&self, settings: &Settings, joint: JointIndex) -> bool {
        self.drives.at(joint).max_cur_a == Some(settings.joint.at(joint).current_max_a)
    }

    /// Write of the current limit of the settings.
    pub(super) fn current_write(settings: &Settings, joint: JointIndex) -> Request {
        Request::Set(Parameter::MaxCur, Value::F32(settings.joint.at(joint).current_max_a))
    }

    /// The `turn`-th thing to read beside position and state word: mostly the current.
    pub(super) const fn slow_look(turn: u32) -> Parameter {
        match turn % 8 {
            3 => Parameter::Config,
            7 => Parameter::MaxCur,
            _ => Parameter::Cur,
        }
    }

    /// What a drive reports to hold: something else than was written to it is from another node.
    pub(super) fn compare_held(&mut self, joint: JointIndex, parameter: Parameter, value: Value) {
        if matches!(self.mode, Mode::Finding(_)) {
            return;
        }
        let drive = self.drives.at_mut(joint);
        let as_written = match (parameter, value) {
            (Parameter::MaxCur, Value::F32(is_a)) => {
                // Written so that NaN counts as altered. A write without an answer is learned.
                let wrote_a = *drive.max_cur_a.get_or_insert(is_a);
                (is_a - wrote_a).abs() <= READ_BACK_SHARE * wrote_a
            }
            (Parameter::Config, Value::U32(bits)) => {
                drive.config.is_none_or(|config| config == Config::from_bits(bits))
            }
            _ => true,
        };
        if !as_written {
            // Unknown from now on: a clearing writes it again.
            drive.max_cur_a = None;
            self.fail(Fault::at(Cause::DriveAltered, joint));
        }
    }
}
