//! Orders of a host, and the states in which each is legal. Independent of the protocol of the host.
//!
//! Every order may come twice without harm: an answer can get lost, and the host then asks again.

use protocol::cyphal::cubecell::command;
use protocol::cyphal::cubecell::group_state::State as StateKind;
use protocol::{Duration, Instant, JointIndex};

use crate::credentials::{Code, Digest, Nonce};
use crate::events::Action;
use crate::joints::PerJoint;
use crate::retarget::EndState;
use crate::trajectory_format::FileName;

/// Longest time an offer or an arming may hold.
pub const ARMING_VALID_MAX: Duration = Duration::from_millis(command::ARMING_VALID_MS_MAX as u64);
/// Longest time that limits may be unlocked.
pub const UNLOCK_VALID_MAX: Duration = Duration::from_secs(command::UNLOCK_VALID_S_MAX as u64);
/// Longest time a jog goes on without repetition.
pub const JOG_HOLD_MAX: Duration = Duration::from_millis(command::JOG_HOLD_MS_MAX as u64);

/// Longest time from the order to the start of a run.
pub const START_AHEAD_MAX: Duration = Duration::from_secs(30);
/// Most events of a new end state.
pub const TARGET_EVENTS_MAX: usize = 2;

/// A new end state of the group, to be reached at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Target {
    /// Time at which the end state is reached.
    pub at: Instant,
    /// Joints that the state is for; must be all joints of the group.
    pub joints: u8,
    /// Position and velocity per joint.
    pub state: PerJoint<EndState>,
    /// Events with their times; they replace all events that are still to come.
    pub events: [Option<(Instant, Action)>; TARGET_EVENTS_MAX],
}

/// Order of a host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// First step of arming: asks for a token.
    ArmPrepare {
        /// CRC-64 of the trajectory to run: the committed one.
        crc64: u64,
        /// How long the offer is valid, at most [`ARMING_VALID_MAX`].
        valid: Duration,
    },
    /// Second step: returns the token; the group is armed.
    ArmConfirm {
        /// Token of the last offer.
        token: u32,
        /// How long the group stays armed without a run, at most [`ARMING_VALID_MAX`].
        valid: Duration,
    },
    /// Back to Ready.
    Disarm,
    /// Starts the armed trajectory at once.
    Run(FileName),
    /// Starts the armed trajectory at a time of the controller's clock, at most [`START_AHEAD_MAX`] from now. Until then the
    /// group is Armed.
    RunAt {
        /// The armed trajectory.
        name: FileName,
        /// When the plan begins.
        start: Instant,
    },
    /// While a trajectory with an envelope runs: goes to a new end state in flight, then brakes to rest. The
    /// present motion continues until the first time at which it can still change; it continues unchanged if the
    /// end state is refused.
    Retarget(Target),
    /// Ramps down along the path.
    Stop,
    /// Forgets the latched fault and looks at the drives again.
    ClearFault {
        /// Number of the fault the host has seen.
        code: u16,
    },
    /// Lets joints look for their zeros, one after the other, from the hand to the base.
    Home {
        /// Bit n: joint n, counted from 0.
        mask: u8,
    },
    /// Moves one joint at reduced speed while it is repeated.
    Jog {
        /// The joint.
        joint: JointIndex,
        /// Wanted velocity, rad/s; capped at the joint's jog speed.
        qd_rad_s: f32,
        /// The joint stops unless the order comes again within this time, at most [`JOG_HOLD_MAX`].
        hold: Duration,
    },
    /// Checks the uploaded file and makes it the one that may run.
    Commit(FileName),
    /// Sets the gripper output.
    Gripper {
        /// Open or closed.
        open: bool,
    },
    /// Writes the settings into permanent storage.
    SaveSettings,
    /// Requests a challenge, from which an authentication code is made.
    Challenge,
    /// Gives the authentication code of the next order of this node.
    Authorize {
        /// Nonce of the challenge.
        nonce: Nonce,
        /// Code for the next order.
        code: Code,
    },
    /// Lets this node set limits beyond those of the robot.
    Unlock {
        /// CRC-32 of the robot whose limits are to be exceeded.
        robot_crc32: u32,
        /// For how long, at most [`UNLOCK_VALID_MAX`]; zero puts the limits of the robot back at once.
        valid: Duration,
    },
}

/// Answer to an order that was not refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Done {
    /// Done, or begun.
    Taken,
    /// The offer to arm.
    Offer {
        /// Token for the confirmation.
        token: u32,
        /// Time left.
        valid: Duration,
        /// [`run_digest`](crate::registers::run_digest) of what would be armed.
        digest: Digest,
    },
    /// A challenge; it holds for [`CHALLENGE_VALID`](crate::authority::CHALLENGE_VALID).
    Challenge(Nonce),
}

/// An order without its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OrderKind {
    /// [`Order::ArmPrepare`].
    ArmPrepare,
    /// [`Order::ArmConfirm`].
    ArmConfirm,
    /// [`Order::Disarm`].
    Disarm,
    /// [`Order::Run`] and [`Order::RunAt`].
    Run,
    /// [`Order::Stop`].
    Stop,
    /// [`Order::ClearFault`].
    ClearFault,
    /// [`Order::Home`].
    Home,
    /// [`Order::Jog`].
    Jog,
    /// [`Order::Commit`].
    Commit,
    /// [`Order::Gripper`].
    Gripper,
    /// [`Order::SaveSettings`].
    SaveSettings,
    /// [`Order::Challenge`].
    Challenge,
    /// [`Order::Authorize`].
    Authorize,
    /// [`Order::Unlock`].
    Unlock,
    /// [`Order::Retarget`].
    Retarget,
}

impl OrderKind {
    /// Every kind of order.
    pub const ALL: [Self; 15] = [
        Self::ArmPrepare,
        Self::ArmConfirm,
        Self::Disarm,
        Self::Run,
        Self::Stop,
        Self::ClearFault,
        Self::Home,
        Self::Jog,
        Self::Commit,
        Self::Gripper,
        Self::SaveSettings,
        Self::Challenge,
        Self::Authorize,
        Self::Unlock,
        Self::Retarget,
    ];

    /// States in which the order is accepted; in all others it is refused.
    pub const fn legal_in(self) -> &'static [StateKind] {
        use StateKind::{Armed, Boot, Fault, Homing, Idle, Jogging, Ready, Running, Stopped, Stopping};
        match self {
            Self::ArmPrepare => &[Ready, Stopped],
            // Armed: the confirmation again, if its answer got lost.
            Self::ArmConfirm => &[Ready, Stopped, Armed],
            Self::Disarm => &[Idle, Ready, Armed, Stopped],
            // Running: the same run again.
            Self::Run => &[Armed, Running],
            Self::Stop => &[Boot, Idle, Homing, Jogging, Ready, Armed, Running, Stopping, Stopped, Fault],
            // Without a fault there is nothing to forget.
            Self::ClearFault => &[Boot, Idle, Ready, Stopped, Fault],
            Self::Home => &[Idle, Ready, Stopped, Homing],
            Self::Jog => &[Idle, Ready, Stopped, Jogging],
            Self::Commit => &[Idle, Ready, Stopped, Fault],
            Self::Gripper => &[Idle, Ready, Stopped, Armed, Jogging, Homing],
            Self::SaveSettings => &[Idle, Ready, Stopped, Fault],
            // Computing a code takes longer than a control step may: never during a motion.
            Self::Challenge | Self::Authorize => &[Idle, Ready, Armed, Stopped, Fault],
            Self::Unlock => &[Idle, Ready, Stopped, Fault],
            Self::Retarget => &[Running],
        }
    }

    /// True if any node may give the order in its legal states, even while another node holds the session: it moves
    /// nothing, or it ends a motion.
    pub const fn is_free(self) -> bool {
        matches!(self, Self::Stop | Self::Disarm | Self::Challenge | Self::Authorize)
    }

    /// True if a controller with a key requires a code for the order. A new end state needs no code: to compute one
    /// takes longer than a control step may. The code of the commit covers the file and so the envelope that end
    /// states must stay in; a file without an envelope accepts no end states.
    pub const fn needs_code(self) -> bool {
        match self {
            Self::ArmConfirm
            | Self::Run
            | Self::Home
            | Self::Jog
            | Self::Commit
            | Self::Gripper
            | Self::SaveSettings
            | Self::Unlock => true,
            Self::ArmPrepare
            | Self::Disarm
            | Self::Stop
            | Self::ClearFault
            | Self::Challenge
            | Self::Authorize
            | Self::Retarget => false,
        }
    }

    /// True if the order is accepted in this state.
    pub fn is_legal_in(self, state: StateKind) -> bool {
        self.legal_in().contains(&state)
    }
}

impl Order {
    /// The order without its values.
    pub const fn kind(&self) -> OrderKind {
        match self {
            Self::ArmPrepare { .. } => OrderKind::ArmPrepare,
            Self::ArmConfirm { .. } => OrderKind::ArmConfirm,
            Self::Disarm => OrderKind::Disarm,
            Self::Run(_) | Self::RunAt { .. } => OrderKind::Run,
            Self::Stop => OrderKind::Stop,
            Self::ClearFault { .. } => OrderKind::ClearFault,
            Self::Home { .. } => OrderKind::Home,
            Self::Jog { .. } => OrderKind::Jog,
            Self::Commit(_) => OrderKind::Commit,
            Self::Gripper { .. } => OrderKind::Gripper,
            Self::SaveSettings => OrderKind::SaveSettings,
            Self::Challenge => OrderKind::Challenge,
            Self::Authorize { .. } => OrderKind::Authorize,
            Self::Unlock { .. } => OrderKind::Unlock,
            Self::Retarget(_) => OrderKind::Retarget,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_is_legal_in_every_state() {
        assert!(StateKind::ALL.iter().all(|&state| OrderKind::Stop.is_legal_in(state)));
    }

    #[test]
    fn nothing_starts_a_motion_from_fault_or_while_stopping() {
        for state in [StateKind::Fault, StateKind::Stopping, StateKind::Boot] {
            for order in [
                OrderKind::Run,
                OrderKind::ArmConfirm,
                OrderKind::ArmPrepare,
                OrderKind::Home,
                OrderKind::Jog,
            ] {
                assert!(!order.is_legal_in(state), "{order:?} in {state:?}");
            }
        }
    }

    #[test]
    fn whatever_can_start_a_motion_needs_a_code() {
        let free: Vec<OrderKind> = OrderKind::ALL.into_iter().filter(|kind| !kind.needs_code()).collect();
        use OrderKind::{ArmPrepare, Authorize, Challenge, ClearFault, Disarm, Retarget, Stop};
        assert_eq!(free, [ArmPrepare, Disarm, Stop, ClearFault, Challenge, Authorize, Retarget]);
        assert_eq!(Retarget.legal_in(), [StateKind::Running], "it starts none");
    }

    #[test]
    fn the_trajectory_cannot_change_once_armed() {
        for state in [StateKind::Armed, StateKind::Running, StateKind::Stopping] {
            assert!(!OrderKind::Commit.is_legal_in(state));
        }
    }
}
