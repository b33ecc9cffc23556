//! One servo as the group knows it: its step, its service data, its answers.

use protocol::canopen::cia402::{State, Status};
use protocol::canopen::client::Transfer;
use protocol::canopen::pdo::Map;
use protocol::{Frame, Instant};

use super::finding::{Step, cause_of};
use super::options::{Follow, Servo};
use crate::fault::Cause;
use crate::groups::answers::{Answers, Worth};
use crate::groups::position::{self, Drive as _};
use crate::rest::BAND_RAD;
use crate::settings::JointSettings;

/// See the [module](self).
#[derive(Clone, Debug, Default)]
pub struct Drive {
    pub(super) step: Step,
    /// Since when it is in this step.
    pub(super) since: Instant,
    /// The transfer that runs.
    pub(super) transfer: Option<Transfer<4>>,
    /// The object of the step was written, and is read back.
    pub(super) is_written: bool,
    /// Objects 608F and 6091.
    pub(super) units: [u32; 4],
    /// Object 603F; the newest entry of object 1003 if it is absent.
    pub(super) error: Option<u16>,
    /// Last emergency; 0: none, or it is over.
    pub(super) emergency: u16,
    /// It was reported already.
    pub(super) is_reported: bool,
    /// Last heartbeat.
    pub(super) heard_at: Instant,
    pub(super) answers: Answers,
    pub(super) status: Option<Status>,
    /// With torque: it takes positions. An interpolation begins and ends by itself.
    pub(super) follows: bool,
    pub(super) torque_nm: f32,
    pub(super) is_proven: bool,
    pub(super) is_homed: bool,
    /// This group gave it torque.
    pub(super) is_ours: bool,
}

impl position::Drive for Drive {
    fn answers(&self) -> &Answers {
        &self.answers
    }

    fn answers_mut(&mut self) -> &mut Answers {
        &mut self.answers
    }

    fn is_held(&self) -> bool {
        matches!(self.step, Step::Held | Step::Homing(_) | Step::Zero)
    }

    fn is_ready(&self) -> bool {
        self.step == Step::Held
    }

    fn is_homed(&self) -> bool {
        self.is_homed
    }

    fn switch_off(&mut self, now: Instant) {
        self.go_to(now, Step::Off);
    }
}

impl Drive {
    /// It takes and gives process data.
    pub(super) fn has_process_data(&self) -> bool {
        self.is_held()
            || matches!(
                self.step,
                Step::Enabling | Step::Enabled | Step::Silence | Step::Judged | Step::Clearing | Step::Off
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
        self.is_held() && self.answers.missed_in_row <= missed_max && self.cause().is_none()
    }

    /// What it reports about itself.
    pub(super) fn cause(&self) -> Option<Cause> {
        if self.emergency != 0 {
            return Some(cause_of(self.emergency));
        }
        let has_torque = self.state() == Some(State::OperationEnabled);
        let is_lost = !has_torque || !self.follows;
        (self.status.is_some() && self.is_held() && is_lost).then_some(Cause::DriveError)
    }

    /// Takes process data of the SYNC at `at`; `None`: they are none of this servo.
    pub(super) fn take(
        &mut self,
        frame: &Frame,
        map: &Map,
        at: Instant,
        servo: Servo,
        limits: &JointSettings,
    ) -> Option<Worth> {
        let [status, counts, ..] = map.unpack(frame.data())?;
        let status = Status(status as u16);
        let q_rad = limits.to_joint_rad(servo.to_rad(counts));
        let follows = self.step == Step::Held && status.state() == Some(State::OperationEnabled);
        let worth = self.answers.take(frame, q_rad, at, limits, follows, BAND_RAD);
        if worth == Worth::Measured {
            self.status = Some(status);
            self.follows = servo.follow == Follow::Cyclic || status.mode_works();
        }
        Some(worth)
    }

    /// The encoder is absolute, or its zero was found: the joint is at home if it is within its limits.
    pub(super) fn home(&mut self, limits: &JointSettings) -> bool {
        self.is_homed =
            self.is_held() && self.answers.sample.is_some_and(|sample| limits.holds(sample.q_rad));
        self.is_homed
    }
}
