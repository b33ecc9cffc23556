//! One servo as the group knows it: its step, its service data, its answers.

use canopen_protocol::cia402::{State, Status};
use canopen_protocol::client::Transfer;
use canopen_protocol::pdo::Map;
use protocol::{Frame, Instant};

use super::finding::{Step, cause_of};
use super::options::Servo;
use crate::fault::Cause;
use crate::group::PositionSample;
use crate::rest::Rest;
use crate::settings::JointSettings;
use crate::supervisor::is_plausible;

/// An answer is stale if it does not change in any bit while the set points move by this, rad.
const STALE_RAD: f32 = 3e-3;

/// What an answer is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Worth {
    Measured,
    /// Not process data of this servo.
    Nothing,
    /// Torn, or the first stale one; true for the second torn one in a row.
    Implausible(bool),
    /// Stale again.
    Frozen,
}

/// See the [module](self).
#[derive(Clone, Debug, Default)]
pub(super) struct Drive {
    pub(super) step: Step,
    /// Since when it is in this step.
    pub(super) since: Instant,
    /// The transfer that runs.
    pub(super) transfer: Option<Transfer<4>>,
    /// The object of the step was written, and is read back.
    pub(super) is_written: bool,
    /// Objects 608F and 6091.
    pub(super) units: [u32; 4],
    /// Object 603F.
    pub(super) error: u16,
    /// Last emergency; 0: none, or it is over.
    pub(super) emergency: u16,
    /// It was reported already.
    pub(super) is_reported: bool,
    /// Last heartbeat.
    pub(super) heard_at: Instant,
    /// Process data are due.
    pub(super) awaited: bool,
    /// The answer before was missed: the next one may be that one, late.
    pub(super) is_doubtful: bool,
    /// The answer that came may be that of the SYNC before; then the right one still comes.
    pub(super) may_follow: bool,
    pub(super) missed_in_row: u32,
    implausible_in_row: u32,
    pub(super) status: Option<Status>,
    /// Last answer, and how far the set point has moved since it first came.
    answer: Option<[u8; 6]>,
    pub(super) moved_rad: f32,
    /// Set point sent last, rad.
    pub(super) sent_rad: f32,
    pub(super) sent_v_rad_s: f32,
    pub(super) torque_nm: f32,
    pub(super) sample: Option<PositionSample>,
    pub(super) rest: Rest,
    pub(super) is_proven: bool,
    pub(super) is_homed: bool,
    /// This group gave it torque.
    pub(super) is_ours: bool,
}

impl Drive {
    pub(super) fn is_held(&self) -> bool {
        matches!(self.step, Step::Held | Step::Homing(_) | Step::Zero)
    }

    /// It takes and gives process data.
    pub(super) fn has_process_data(&self) -> bool {
        self.is_held()
            || matches!(
                self.step,
                Step::Enabling | Step::Enabled | Step::Silence | Step::Clearing | Step::Off
            )
    }

    pub(super) fn state(&self) -> Option<State> {
        self.status.and_then(Status::state)
    }

    pub(super) fn go_to(&mut self, now: Instant, step: Step) {
        if self.step != step {
            (self.step, self.since) = (step, now);
        }
        self.is_written = false;
    }

    /// From the beginning.
    pub(super) fn forget(&mut self, now: Instant) {
        let (is_proven, is_ours) = (self.is_proven, self.is_ours);
        *self = Self { is_proven, is_ours, since: now, heard_at: now, ..Self::default() };
    }

    /// It is held and answers, and nothing is wrong with it.
    pub(super) fn is_sound(&self, missed_max: u32) -> bool {
        self.is_held() && self.missed_in_row <= missed_max && self.trouble().is_none()
    }

    /// What it reports about itself.
    pub(super) fn trouble(&self) -> Option<Cause> {
        if self.emergency != 0 {
            return Some(cause_of(self.emergency));
        }
        let has_torque = self.state() == Some(State::OperationEnabled);
        (self.status.is_some() && self.is_held() && !has_torque).then_some(Cause::DriveError)
    }

    /// Takes process data of the SYNC at `at`.
    pub(super) fn take(
        &mut self,
        frame: &Frame,
        map: &Map,
        at: Instant,
        servo: Servo,
        limits: &JointSettings,
    ) -> Worth {
        let Some([status, counts, ..]) = map.unpack(frame.data()) else { return Worth::Nothing };
        let data = frame.data().first_chunk::<6>().copied();
        if data != self.answer {
            (self.answer, self.moved_rad) = (data, 0.0);
        }
        let status = Status(status as u16);
        let q_rad = limits.to_joint_rad(servo.to_rad(counts));
        let is_stale = self.step == Step::Held
            && status.state() == Some(State::OperationEnabled)
            && self.moved_rad >= STALE_RAD;
        if is_stale || !is_plausible(q_rad, at, self.sample, limits.v_max_rad_s) {
            self.implausible_in_row = self.implausible_in_row.saturating_add(1);
            let again = self.implausible_in_row > 1;
            return if again && is_stale { Worth::Frozen } else { Worth::Implausible(again) };
        }
        let sample = PositionSample { q_rad, at };
        self.implausible_in_row = 0;
        (self.status, self.sample) = (Some(status), Some(sample));
        self.rest.take(sample);
        Worth::Measured
    }

    /// The encoder is absolute, or its zero was found: the joint is at home if it is within its limits.
    pub(super) fn home(&mut self, limits: &JointSettings) -> bool {
        let is_inside = |q_rad: f32| q_rad >= limits.q_min_rad && q_rad <= limits.q_max_rad;
        self.is_homed = self.is_held() && self.sample.is_some_and(|sample| is_inside(sample.q_rad));
        self.is_homed
    }
}
