//! The interface between the controller and its drives: a group of drives that belong to one bus, or to one robot.
//!
//! A group knows frames, parameters, state words and counts. The controller knows positions in radians and causes.
//! The interface is the group and not the single drive, because pipelining, SYNC and one packet for all axes are
//! properties of a group.
//!
//! # One call
//!
//! ```text
//! handle_packet or handle_timeout          something came in, or a deadline has come
//! poll_event, until it returns None        the controller reacts to each event with commands and set points
//! flush                                    the group puts out what may leave now
//! poll_packet, until it returns None       the runner sends
//! poll_timeout                             the runner waits
//! ```
//!
//! An event is made when it is polled, so a command that answers one event takes effect before the next one is made.
//!
//! # Which clock
//!
//! The group makes [`GroupEvent::Cycle`]. A group that has the clock makes it at a deadline of its own. A group
//! whose robot has the clock makes it when the packet of the robot has come, or at a deadline if the packet does
//! not come. The controller makes one control step per event in both cases.
//!
//! # Set points
//!
//! [`DriveGroup::set_point`] is called joint by joint, and returns what became of the set point. A group with one
//! packet for all axes collects them and sends at [`DriveGroup::flush`].

use protocol::cyphal::cubecell::group_state::DriveDifference;
use protocol::{Duration, Instant, JointIndex};

use crate::fault::{Cause, Fault, Refusal};
use crate::registers::{FamilyRegisters, family};
use crate::settings::Settings;

/// A position and when it was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionSample {
    /// Joint side, rad.
    pub q_rad: f32,
    /// Time of the measurement.
    pub at: Instant,
}

/// What a joint does in the next period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetPoint {
    /// When the set point is expected to act, as [`DriveGroup::acts_at`] returned.
    pub acts_at: Instant,
    /// Time for which it acts, s.
    pub period_s: f32,
    /// Mean acceleration over the period, rad/s².
    pub qdd_rad_s2: f32,
    /// The reference's part of it, rad/s².
    pub qdd_reference_rad_s2: f32,
    /// Position at `acts_at`, rad: where the joint is expected with [`Law::Feedback`], the reference with [`Law::Reference`].
    pub q_rad: f32,
    /// Velocity at `acts_at`, rad/s, expected or reference as for `q_rad`.
    pub qd_rad_s: f32,
}

/// What became of a set point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Taken {
    /// The nearness of a soft limit turned the command into braking.
    pub position_limited: bool,
}

/// Who closes the loop on the path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// The controller: saturated state feedback with the gains of the settings ([`crate::feedback`]).
    Feedback,
    /// The drives: set points are the reference, no gains are needed.
    Reference,
}

/// Properties of a group that the controller needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile {
    /// Who closes the loop.
    pub law: Law,
    /// Time between two set points of a joint, and between two [`GroupEvent::Cycle`] while tracking.
    pub period: Duration,
    /// How far the measured position is behind the set points. References are taken later by this time.
    pub lag: Duration,
    /// From the order to run to the start of the plan. At least the lag with [`Law::Reference`], otherwise the first set points
    /// leap.
    pub lead: Duration,
}

/// Command of the controller to the group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Search the drives, set them up and prove that they stop by themselves; ends with [`GroupEvent::Found`] or
    /// [`GroupEvent::Failed`]. Nothing moves.
    Find {
        /// Clear errors and halts first.
        reset: bool,
    },
    /// Clear errors and halts of drives that stand. What was read before is void. Nothing moves.
    Reset,
    /// The joints stand. The group reads the drives in turn and never commands motion.
    Stand {
        /// A run may follow soon.
        armed: bool,
    },
    /// A drive that may have missed the halt gets no sign of life until the next [`Self::Find`], and so stops by
    /// itself. A group that does not know which drives have missed it sends no drive a sign of life. Otherwise as
    /// [`Self::Stand`].
    Abandon,
    /// Find the zero of a joint; ends with [`GroupEvent::Homed`] or [`GroupEvent::Failed`].
    Home(JointIndex),
    /// Move a joint at reduced acceleration and current until `until`, or with a speed of zero until it rests. Ends with
    /// [`GroupEvent::JogReleased`], then [`GroupEvent::JogEnded`].
    Jog {
        /// The joint.
        joint: JointIndex,
        /// Velocity, rad/s, within the speed of a jog.
        qd_rad_s: f32,
        /// The joint stops by itself at this time.
        until: Instant,
    },
    /// Set points follow, one per joint after each [`GroupEvent::Cycle`].
    Track,
    /// Ramp to a position at the speed of a jog.
    MoveTo {
        /// The joint.
        joint: JointIndex,
        /// Where to, rad, within the soft limits.
        q_rad: f32,
    },
    /// All drives brake by themselves at once, and refuse motion until [`Self::Reset`] or [`Self::Find`]. Packets
    /// that wait are not sent.
    Halt,
    /// As [`Self::Halt`], for one drive that does not answer.
    HaltJoint(JointIndex),
}

/// What the group reports to the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GroupEvent {
    /// Finding has reached its next stage.
    Progress,
    /// All drives are there, fit, supervised and at rest.
    Found,
    /// A period begins.
    Cycle {
        /// How late the call came.
        late: Duration,
        /// The call came too late, or answers of the last period are missing.
        overrun: bool,
    },
    /// A position was measured.
    Measured(Measured),
    /// A drive did not answer in time; answers missed in a row.
    Missed(JointIndex, u32),
    /// A drive reported a position that it cannot have reached; true for the second one in a row.
    Implausible(JointIndex, bool),
    /// The joint has found its zero.
    Homed(JointIndex),
    /// The jog ends: its time is over, or its speed zero. The joint ramps to rest.
    JogReleased,
    /// The joint of the jog rests.
    JogEnded,
    /// Something is wrong with a drive or with the group.
    Failed(Fault),
}

/// A measured position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// The joint.
    pub joint: JointIndex,
    /// Position and time.
    pub sample: PositionSample,
    /// The set point in force since then, if the measurement answers a set point.
    pub in_force: Option<InForce>,
    /// Error that the drive reports with the position.
    pub cause: Option<Cause>,
}

/// A set point that acts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InForce {
    /// Input of the error system (acceleration minus that of the reference) as far as the drive took it, rad/s².
    pub u_rad_s2: f32,
    /// It is the set point of the running period.
    pub in_time: bool,
}

/// What a drive reports while its joint should stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Standing {
    /// Error that it reports.
    pub cause: Option<Cause>,
    /// It is halted, by the controller or by another node.
    pub halted: bool,
    /// It has reported motion several times in a row.
    pub reports_motion: bool,
    /// Its position loop is open: people may move the joint by hand.
    pub yields: bool,
}

/// Latest data of a drive, for display and for the freeze frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Readings {
    /// Last current, A.
    pub current_a: Option<f32>,
    /// Acceleration last commanded, rad/s².
    pub qdd_command_rad_s2: f32,
    /// The speed limit reduced the acceleration.
    pub speed_limited: bool,
    /// The nearness of a soft limit turned the acceleration into braking.
    pub position_limited: bool,
    /// The drive reports an error.
    pub error: bool,
    /// The drive is halted.
    pub halted: bool,
    /// Answers missed in a row.
    pub missed_in_row: u32,
    /// State in the encoding of the family, last read.
    pub state: Option<u32>,
    /// State that comes with each position, in the encoding of the family.
    pub short_state: u8,
}

/// Counts since start-up; they stay at their largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GroupCounters {
    /// Set points and other motion commands sent.
    pub motions: u32,
    /// Packets to the drives that other nodes sent.
    pub foreign: u16,
    /// Nominal bits of all packets, modulo 2^32.
    pub bits: u32,
}

/// Drives of one family behind the controller: sans-IO, joint side units, no heap. The [module](self) describes the
/// order of calls.
pub trait DriveGroup: Default {
    /// What goes over the wire: a CAN frame, a datagram.
    type Packet;

    /// Registers that only its family has.
    fn registers(&self) -> &'static FamilyRegisters {
        &family::NONE
    }

    /// Takes a packet.
    fn handle_packet(&mut self, now: Instant, settings: &Settings, packet: &Self::Packet);

    /// Serves the deadlines that have come.
    fn handle_timeout(&mut self, now: Instant, settings: &Settings);

    /// Next event of this call.
    fn poll_event(&mut self, now: Instant, settings: &Settings) -> Option<GroupEvent>;

    /// Sends what may be sent now. Comes after the events of a call and after commands outside of one.
    fn flush(&mut self, now: Instant, settings: &Settings);

    /// Next packet to send.
    fn poll_packet(&mut self) -> Option<Self::Packet>;

    /// Next deadline.
    fn poll_timeout(&self, now: Instant, settings: &Settings) -> Option<Instant>;

    /// Begins a command; progress comes as events.
    fn command(&mut self, now: Instant, settings: &Settings, command: Command);

    /// Each joint ramps to rest on its own, as hard as its settings allow; a jog with the acceleration of jogs.
    /// Returns the time at which all of them rest, computed from the commands.
    fn brake(&mut self, now: Instant, settings: &Settings) -> Instant;

    /// Set point of a joint for the next period. Comes only after [`GroupEvent::Cycle`] and [`Command::Track`].
    fn set_point(&mut self, settings: &Settings, joint: JointIndex, set_point: &SetPoint) -> Taken;

    /// When a set point that is given in this period acts.
    fn acts_at(&self, joint: JointIndex) -> Instant;

    /// The controller's estimate of a joint's speed at its last measurement, `dt_s` after the one before, for groups that
    /// model what their drives do.
    fn observe(&mut self, joint: JointIndex, qd_rad_s: f32, dt_s: f32) {
        let _ = (joint, qd_rad_s, dt_s);
    }

    /// Sets the gripper output if a drive has it; false if the board has it.
    fn set_gripper(&mut self, settings: &Settings, open: bool) -> bool {
        let _ = (settings, open);
        false
    }

    /// Forgets a gripper output that was set and is not sent yet.
    fn cancel_gripper(&mut self) {}

    /// See [`Profile`].
    fn profile(&self, settings: &Settings) -> Profile;

    /// Checks that the group, apart from the single drives, is ready for a run.
    ///
    /// # Errors
    ///
    /// Why it is not ready.
    fn check_group(&self, now: Instant, settings: &Settings) -> Result<(), Refusal>;

    /// Checks that a drive is ready for a run.
    ///
    /// # Errors
    ///
    /// Why it is not ready.
    fn check_drive(&self, now: Instant, settings: &Settings, joint: JointIndex) -> Result<(), Refusal>;

    /// Last position; `None` before the first.
    fn position(&self, joint: JointIndex) -> Option<PositionSample>;

    /// The joint has found its zero.
    fn is_homed(&self, joint: JointIndex) -> bool;

    /// The joint is measured at rest.
    fn is_at_rest(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool;

    /// The joint is known to move. A drive that reports nothing may move or stand.
    fn is_moving(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool;

    /// See [`Standing`].
    fn standing(&self, joint: JointIndex) -> Standing;

    /// See [`Readings`].
    fn readings(&self, joint: JointIndex) -> Readings;

    /// What the last search for drives was refused for with [`Cause::DriveSettingsDiffer`], and the joint.
    fn difference(&self) -> Option<(JointIndex, DriveDifference)> {
        None
    }

    /// See [`GroupCounters`].
    fn counters(&self) -> GroupCounters;

    /// An answer of a drive is missing in this period. Other senders must wait then.
    fn needs_wire(&self, settings: &Settings) -> bool {
        let _ = settings;
        false
    }
}
