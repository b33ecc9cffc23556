//! Commands of the controller: numbers, parameters and outputs for `uavcan.node.ExecuteCommand`.
//!
//! Host and firmware share this file, so both use the same numbers. Parameters and outputs are serialised DSDL
//! types (`protocol/dsdl/cubecell/command`), so `yakut` can send them too.
//!
//! | number | command | parameter | output on success | allowed in |
//! |---|---|---|---|---|
//! | 1 | [`ARM_PREPARE`] | [`ArmPrepare`] | [`ArmOffer`] | Ready, Stopped |
//! | 2 | [`ARM_CONFIRM`] | [`ArmConfirm`] | none | while the offer holds |
//! | 3 | [`DISARM`] | none | none | Armed, or while an offer holds |
//! | 4 | [`RUN`] | [`Run`] | none | Armed with this trajectory |
//! | 5 | [`STOP`] | none | none | always |
//! | 6 | [`CLEAR_FAULT`] | [`ClearFault`] | none | Fault |
//! | 7 | [`HOME`] | [`Home`] | none | Idle, Ready, Stopped |
//! | 8 | [`JOG`] | [`Jog`] | none | Idle, Ready, Stopped, Jogging |
//! | 9 | [`COMMIT_TRAJECTORY`] | [`Trajectory`] | none | not Armed, Running, Stopping |
//! | 10 | [`GRIPPER`] | [`Gripper`] | none | not Running |
//! | 11 | [`CHALLENGE`] | none | [`Challenge`] | nothing moves, not Boot |
//! | 12 | [`AUTHORIZE`] | [`Authorization`] | none | while the challenge holds |
//! | 13 | [`UNLOCK`] | [`Unlock`] | none | nothing is armed or moves |
//! | 14 | [`CLOCK`] | none | [`ClockReading`] | always |
//! | 15 | [`EXTEND`] | the next segment of the plan | [`Room`] | Running |
//!
//! A command that is refused answers `BAD_STATE`, `BAD_PARAMETER`, `NOT_AUTHORIZED` or `FAILURE` with a [`Refusal`] as
//! output. The standard `EMERGENCY_STOP` acts as the [stop message](super::stop): the halt goes out at once, where [`STOP`]
//! follows the path to rest. [`STOP`], [`DISARM`] and `EMERGENCY_STOP` are carried out even if there is no room for their
//! answer.
//!
//! # Repetition
//!
//! The answer to a command can be lost, and the client then sends it again as a new transfer. So each
//! command is defined to be harmless when it comes twice: a repeated `ARM_PREPARE` makes a new offer
//! and voids the old one; `ARM_CONFIRM` with the token that armed the group, `RUN` of the trajectory
//! that is running, `HOME` of joints that are homing, `COMMIT_TRAJECTORY` of the committed file,
//! `EXTEND` with the segment that came last, `DISARM` when not armed and `CLEAR_FAULT` when there is no fault all succeed and do nothing.
//!
//! # Arming
//!
//! Two steps, so that no single frame, stray or repeated, sets the arm in motion. The offer belongs to the node
//! that sent `ARM_PREPARE`: the controller accepts `ARM_CONFIRM` and `RUN` from that node only, and both steps
//! expire. `STOP` and `DISARM` are accepted from any node at any time.
//!
//! # What this does not protect against
//!
//! The bus is open: every node reads every frame, tokens included, and a node can send frames with the node-ID of
//! another node. Node-IDs and tokens protect against mistakes, not against an intruder. Against an intruder set a
//! key: the controller then requires an authentication code ([`authorization`](super::authorization)) for each of
//! [`COMMIT_TRAJECTORY`], [`ARM_CONFIRM`], [`RUN`], [`HOME`], [`GRIPPER`], [`UNLOCK`], the first [`JOG`] of a jog,
//! and each write of a register that shapes motion. `SECURITY.md` lists the remaining risks.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};

/// Bytes of a challenge.
pub const NONCE_LEN: usize = 8;
/// Bytes of a digest.
pub const DIGEST_LEN: usize = 32;
/// Bytes of an authentication code.
pub const CODE_LEN: usize = 16;

/// Requests an offer to arm.
pub const ARM_PREPARE: u16 = 1;
/// Accepts the offer: the group is armed.
pub const ARM_CONFIRM: u16 = 2;
/// Back to Ready.
pub const DISARM: u16 = 3;
/// Starts the armed trajectory.
pub const RUN: u16 = 4;
/// Ramps down; the same as the message [`Stop`](super::stop::Stop), with an answer.
pub const STOP: u16 = 5;
/// Forgets the latched fault if its cause is gone.
pub const CLEAR_FAULT: u16 = 6;
/// Lets joints look for their zeros.
pub const HOME: u16 = 7;
/// Moves one joint while it is repeated.
pub const JOG: u16 = 8;
/// Checks the uploaded file and makes it the trajectory that may run.
pub const COMMIT_TRAJECTORY: u16 = 9;
/// Sets the gripper output.
pub const GRIPPER: u16 = 10;

/// Requests a challenge, from which an authentication code is made.
pub const CHALLENGE: u16 = 11;
/// Gives the authentication code of the next order of this node.
pub const AUTHORIZE: u16 = 12;
/// Lets this node set limits beyond those of the robot for a while.
pub const UNLOCK: u16 = 13;

/// Requests the time of the controller.
pub const CLOCK: u16 = 14;

/// Continues the plan that runs: the parameter is its next segment.
pub const EXTEND: u16 = 15;

/// Longest time that limits may be unlocked for, s.
pub const UNLOCK_VALID_S_MAX: u16 = 3_600;
/// Longest validity of an offer or an arming, ms.
pub const ARMING_VALID_MS_MAX: u16 = 30_000;
/// Longest time of a jog without repetition, ms.
pub const JOG_HOLD_MS_MAX: u16 = 500;

macro_rules! parameters {
    ($($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty as $wire:ident,)* })*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)*
        }

        impl Encode for $name {
            fn encode(&self, out: &mut Writer<'_>) {
                $(out.$wire(self.$field);)*
            }
        }

        impl Decode<'_> for $name {
            fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
                Ok(Self { $($field: input.$wire(),)* })
            }
        }
    )*};
}

parameters! {
    /// Parameter of [`ARM_PREPARE`].
    ArmPrepare {
        /// CRC-64/WE of the committed trajectory to run.
        trajectory_crc64: u64 as u64,
        /// How long the offer holds, ms, 1..=[`ARMING_VALID_MS_MAX`].
        valid_ms: u16 as u16,
    }

    /// Output of [`ARM_PREPARE`].
    ArmOffer {
        /// Must be returned in the confirmation; different for each offer.
        token: u32 as u32,
        /// Time left to confirm, ms.
        valid_ms: u16 as u16,
        /// SHA-256 of what would be armed: of the SHA-256 of the file and of the settings
        /// ([`authorization`](super::authorization)).
        digest: [u8; DIGEST_LEN] as array,
    }

    /// Parameter of [`ARM_CONFIRM`].
    ArmConfirm {
        /// From the last offer.
        token: u32 as u32,
        /// How long the group stays armed without a run, ms, 1..=[`ARMING_VALID_MS_MAX`].
        valid_ms: u16 as u16,
    }

    /// Parameter of [`COMMIT_TRAJECTORY`].
    Trajectory {
        /// CRC-64/WE of the whole file.
        trajectory_crc64: u64 as u64,
        /// Size of the file, bytes.
        length_bytes: u32 as u32,
    }

    /// Parameter of [`RUN`]. The bytes of a [`Trajectory`] are also valid: a run that starts at once.
    Run {
        /// CRC-64/WE of the whole file.
        trajectory_crc64: u64 as u64,
        /// Size of the file, bytes.
        length_bytes: u32 as u32,
        /// When the plan begins, in the time of the controller, µs, 56 bits; 0 = at once.
        start_us: u64 as u56,
    }

    /// Output of [`CLOCK`].
    ClockReading {
        /// Time of the controller while it answered, µs, 56 bits.
        uptime_us: u64 as u56,
    }

    /// Output of [`EXTEND`].
    Room {
        /// Knots for which there is room now.
        knots: u16 as u16,
    }

    /// Parameter of [`CLEAR_FAULT`].
    ClearFault {
        /// The latched cause that the sender has seen; the command does not clear another cause.
        fault_cause: u16 as u16,
    }

    /// Parameter of [`HOME`].
    Home {
        /// Bit n: joint n, counted from 0.
        joint_mask: u8 as u8,
    }

    /// Parameter of [`JOG`].
    Jog {
        /// Counted from 0.
        joint: u8 as u8,
        /// Wanted velocity; the controller caps it at its jog speed.
        qd_rad_s: f32 as f32,
        /// The joint ramps down unless the command comes again within this time, ms,
        /// 1..=[`JOG_HOLD_MS_MAX`].
        hold_ms: u16 as u16,
    }

    /// Parameter of [`GRIPPER`].
    Gripper {
        /// Open or closed.
        open: bool as bool,
    }

    /// Output of [`CHALLENGE`].
    Challenge {
        /// The code covers it; valid for one order.
        nonce: [u8; NONCE_LEN] as array,
        /// Time left, ms.
        valid_ms: u16 as u16,
    }

    /// Parameter of [`AUTHORIZE`].
    Authorization {
        /// Of the challenge.
        nonce: [u8; NONCE_LEN] as array,
        /// [`authorization`](super::authorization) says what it covers.
        code: [u8; CODE_LEN] as array,
    }

    /// Parameter of [`UNLOCK`].
    Unlock {
        /// Register `limits.robot_crc32`: the robot whose limits are to be exceeded.
        robot_crc32: u32 as u32,
        /// For how long, s, at most [`UNLOCK_VALID_S_MAX`]; 0 puts the limits of the robot back at once.
        valid_s: u16 as u16,
    }

    /// Output of any command that did not succeed.
    Refusal {
        /// Number as in [`GroupState::fault_cause`](super::group_state::GroupState::fault_cause), or
        /// of the check that failed.
        cause: u16 as u16,
        /// Joint concerned, counted from 1; 0 = none.
        joint: u8 as u8,
        /// Segment, cycle or other place, depending on the cause.
        index: u16 as u16,
    }
}
