//! Motors that speak MIT frames (Damiao) on one CAN bus: the group is the clock, each motor gets one command per period and gives one answer.
//!
//! The motor gives `kp (p - q) + kd (v - q̇) + t` and holds it until the next command. The group leads a set point (q_c, v_c) of each
//! joint from the accelerations of the law, and sends p = q_c, v = v_c with the gains of [`Motor`], and as t the torque that the set points
//! need by the [`ArmModel`](super::dynamics::ArmModel). Without a model t is 0, and the load costs a distance of load / kp between set point and joint, which the law
//! closes while tracking.
//!
//! # Stops
//!
//! These arms have no brakes: a motor without torque lets its joint fall. So [`Command::Halt`](crate::group::Command::Halt) leads each joint to rest along a ramp of its
//! own, beginning with the next period, and then holds it. Only a motor that reports a fault or does not answer is
//! switched off. [`Command::Abandon`](crate::group::Command::Abandon) stops feeding those. A motor that answers has taken its halt, and goes on being held;
//! if the controller dies, its time-out takes the torque.
//!
//! # Answers
//!
//! An answer holds no number of its command. It counts if it comes on the master id of the motor, with its id in the first byte, after the
//! command can have been on the bus, once per command and before the next period. The first one after a missed one may be late: it shows that
//! the motor lives and is no measurement. An answer is stale if it stays the same bit by bit while the
//! set point moves, torn if the joint cannot have got there. It shows the joint when the command came: at the joint's place in the burst.
//!
//! # CAN FD
//!
//! With [`Options::with_fd`] all commands go as CAN FD frames with bit rate switch. A motor that is set to classical CAN obeys them, and
//! answers classically: the last register shows it, and it is refused. A motor that is set to CAN FD does not answer classical commands.
//!
//! # Gripper
//!
//! The motor of the fingers has the place after the last joint. It stands where it is until the first order, then holds the fingers
//! open or closed with its gains, also in a halt. One that does not answer or has a fault stops the group along its plan
//! ([`Cause::GripperUnanswered`]).
//!
//! # Map
//!
//! | file | is |
//! |---|---|
//! | [`options`] | motors, gains, ids |
//! | `finding` | from silence to torque: registers compared, time-out proven |
//! | `mismatch` | what is not as the settings say |
//! | `drive` | a motor as the group knows it |
//! | `motion` | the commands of a period |

mod drive;
mod finding;
mod mismatch;
mod motion;
pub mod options;

use protocol::mit::{RegisterAnswer, RegisterRequest, State};
use protocol::{Duration, Frame, Id, Instant, JointIndex};

use self::drive::Drive;
use self::finding::{STEP_PERIODS, Step};
pub use self::mismatch::Mismatch;
pub use self::options::{GripperMotor, Motor, Options, OptionsError};
use super::answers::Worth;
use super::position::{Drive as _, Family, Fingers, PositionDrives};
use crate::fault::Cause;
use crate::group::{GroupEvent, Measured};
use crate::settings::Settings;

/// See the [module](self).
pub type Mit = PositionDrives<Motors>;

/// What the family adds.
#[derive(Debug, Default)]
pub struct Motors;

impl Mit {
    /// The motor at one of the [`Self::places`].
    fn motor(&self, settings: &Settings, place: JointIndex) -> Option<Motor> {
        self.places(settings).find(|own| *own == place).and_then(|own| self.options.motor(own)).copied()
    }

    /// When the command of a joint is on the bus at the earliest, if `more` frames follow it.
    fn after_command(&self, joint: JointIndex, more: u64) -> Instant {
        self.at + self.options.frame * (self.drives.at(joint).place + more)
    }
}

impl Family for Motors {
    type Options = Options;
    type Drive = Drive;
    type Mismatch = Mismatch;

    const LEAD_PERIODS: u64 = 2;
    const BRAKE_PERIODS: u64 = 2;
    /// A joint at 25 rad/s behind its gains leaves 2 % of its distance by then.
    const SETTLING: Duration = Duration::from_millis(160);
    /// A joint with soft gains swings, and is slow for a moment where it turns back.
    const SWING: Duration = Duration::from_millis(200);

    fn drives(options: &Options) -> usize {
        options.all().count()
    }

    fn fingers(options: &Options) -> Option<Fingers> {
        let (place, GripperMotor { motor, open_rad, closed_rad }) = options.gripper()?;
        let v_max_rad_s = motor.ranges.v_max_rad_s();
        Some(Fingers { place, open_rad: *open_rad, closed_rad: *closed_rad, v_max_rad_s })
    }

    fn v_max_rad_s(options: &Options, joint: JointIndex) -> Option<f32> {
        options.motor(joint).map(|motor| motor.ranges.v_max_rad_s())
    }

    fn on_bus(options: &Options, frame: Frame) -> Frame {
        options.on_bus(frame)
    }

    fn bits(options: &Options, _: &Frame) -> u32 {
        options.frame_bits()
    }

    fn take_frame(group: &mut Mit, now: Instant, settings: &Settings, frame: &Frame) {
        let Id::Standard(id) = frame.id() else { return };
        let joint = group.options.place_on(id);
        let Some((joint, motor)) = joint.and_then(|joint| Some((joint, group.motor(settings, joint)?)))
        else {
            if group.options.ids().any(|own| own == id) {
                group.count_foreign();
            }
            return;
        };
        group.counters.bits = group.counters.bits.wrapping_add(group.options.frame_bits());
        // The command and its answer, at least.
        let is_early = now < group.after_command(joint, 1);
        let at = group.after_command(joint, 0);
        let drive = group.drives.at_mut(joint);
        if is_early || !drive.answers.admits(drive.is_held()) {
            return;
        }
        if let Some(asked @ (RegisterRequest::Read(_) | RegisterRequest::Write(..))) = drive.asked {
            if let Some(answer) = RegisterAnswer::decode(frame, motor.id, motor.master, &asked) {
                drive.answers.came();
                group.take_register(settings, joint, &motor, answer);
            }
            return;
        }
        let Some(state) = State::decode(frame, motor.id, motor.master, &motor.ranges) else { return };
        drive.answers.came();
        let is_gripper = group.gripper_place(settings) == Some(joint);
        let limits = group.limits(settings, joint);
        let drive = group.drives.at_mut(joint);
        match drive.take(state, at, &limits, frame) {
            Worth::Measured => {}
            _ if is_gripper => return,
            Worth::Frozen => return group.fail(joint, Cause::PositionFrozen),
            Worth::Implausible(again) => return group.push(GroupEvent::Implausible(joint, again)),
        }
        if !drive.is_held() {
            group.take_search_state(now, settings, joint, &state);
            return;
        }
        let cause = drive.cause(group.options.hot_c);
        if is_gripper {
            if cause.is_some() {
                group.lose_gripper(now, joint);
            }
            return;
        }
        let in_force = group.leader.in_force(joint, true);
        if finding::cause(state.status).is_some() {
            drive.go_to(Step::Off);
        }
        if let Some(sample) = drive.answers.sample {
            group.push(GroupEvent::Measured(Measured { joint, sample, in_force, cause }));
        }
        if let Some(cause) = cause {
            group.refuse(joint, cause);
        }
    }

    fn find(group: &mut Mit, _: Instant, settings: &Settings) {
        for place in group.places(settings) {
            let drive = group.drives.at_mut(place);
            drive.find(settings.reply_missed_max);
            drive.periods = 0;
        }
    }

    fn search(group: &mut Mit, _: Instant, settings: &Settings) {
        for joint in group.places(settings) {
            let drive = group.drives.at_mut(joint);
            drive.periods = drive.periods.saturating_add(1);
            let waits = matches!(drive.step, Step::Held | Step::Silence { .. });
            if !waits && drive.periods > STEP_PERIODS {
                let cause = drive.state.and_then(|state| finding::cause(state.status));
                let answers = drive.answers.missed_in_row == 0;
                return group.refuse(joint, cause.filter(|_| answers).unwrap_or(Cause::DriveMissing));
            }
        }
    }

    fn send_period(group: &mut Mit, now: Instant, settings: &Settings) {
        group.send_burst(now, settings);
    }

    fn home(group: &mut Mit, settings: &Settings, joint: JointIndex) -> bool {
        group.drives.at_mut(joint).home(settings.joint.at(joint))
    }

    fn cause(group: &Mit, _: Instant, joint: JointIndex) -> Option<Cause> {
        group.drives.at(joint).cause(group.options.hot_c)
    }

    fn state(group: &Mit, joint: JointIndex) -> (Option<u32>, bool) {
        let drive = group.drives.at(joint);
        let status = drive.state.map(|state| state.status.code().into());
        (status, drive.cause(group.options.hot_c).is_some())
    }

    fn acts_at(group: &Mit, joint: JointIndex) -> Instant {
        group.after_command(joint, 0)
    }

    fn gripper_frame(group: &mut Mit, settings: &Settings) -> Option<Frame> {
        let place = group.gripper_place(settings)?;
        let motor = group.motor(settings, place)?;
        if group.drives.at(place).is_held() { group.finger_command(place, &motor) } else { None }
    }
}
