//! Faults behind the wire, and the contract of a cell that can have them.

use std::fmt;

use protocol::{Duration, Instant, ModuleId};

/// Where a physical fault happens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Place {
    /// One drive, by wire address.
    Module(ModuleId),
    /// One power supply, counted from 0 in the order of the robot file.
    Supply(u8),
    /// The gripper with its ball.
    Gripper,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Module(id) => write!(f, "module {id}"),
            Self::Supply(index) => write!(f, "supply {index}"),
            Self::Gripper => f.write_str("gripper"),
        }
    }
}

/// Kind of fault. Each variant describes what a client on the bus can observe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PhysicalFault {
    /// Module: measured values stop changing. Position, velocity, current and state in every answer stay as at the
    /// start, while the motion itself continues. (A hung measurement task.)
    Frozen,
    /// Module: every answer comes later by this much, on top of the usual processing delay.
    Slow(Duration),
    /// Module: the electronics restart once, at the start: parameters not saved are lost, home is
    /// lost on modules with incremental encoder, no frame is answered until the module is up again.
    Restart,
    /// Module: the power stage measures too much current: POWERFAULT with SHORTCUR (state bits 3 and 21), motor off.
    OverCurrent,
    /// Module: the axis is held from outside, so the following error grows as soon as a motion is commanded; the
    /// drive detects it by its own rule (TOW_ERROR, bit 4).
    Blocked,
    /// Module: POWERFAULT with HALLERR (state bits 3 and 22), motor off.
    HallError,
    /// Module: lost encoder counts: from the start on, the measured position is wrong by this angle; no status bit
    /// shows it.
    EncoderOffset {
        /// Measured minus true position, rad.
        offset_rad: f64,
    },
    /// Supply: only this share of the nominal voltage is left, 0 (cut off) to 1.
    SupplyLoss {
        /// Remaining voltage over nominal voltage.
        remaining: f64,
    },
    /// Gripper: does not open while the fault lasts; opens at its end if still commanded.
    StuckGripper,
    /// Gripper: opens later than commanded by this much.
    LateRelease(Duration),
}

/// The fault is not possible at that place: no such module, no such supply, or a module fault on a supply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what} does not apply to {place}: {why}")]
pub struct NotApplicable {
    /// Name of the fault.
    pub what: &'static str,
    /// Where it was sent.
    pub place: Place,
    /// Why the fault is not possible there, for a message.
    pub why: &'static str,
}

impl PhysicalFault {
    /// Name as in scenario files.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Frozen => "stuck",
            Self::Slow(_) => "slow",
            Self::Restart => "restart",
            Self::OverCurrent => "over-current",
            Self::Blocked => "tow-error",
            Self::HallError => "hall-error",
            Self::EncoderOffset { .. } => "encoder-error",
            Self::SupplyLoss { .. } => "supply-loss",
            Self::StuckGripper => "stuck-gripper",
            Self::LateRelease(_) => "late-release",
        }
    }
}

/// A cell that can have physical faults.
///
/// # Contract
///
/// * Calls come at times that never decrease, after [`crate::Participants::advance`] to that time.
/// * For one place and one variant, `begin_fault` and `end_fault` alternate: overlapping entries of a
///   plan are merged before they get here, the latest begun one giving the parameters.
/// * [`PhysicalFault::Restart`] is an instant: it gets `begin_fault` only.
/// * Ending a fault removes its cause. What the drive latched because of it stays until the
///   protocol clears it (RESET, or a power cycle where the reference says so).
pub trait FaultTarget {
    /// Why the place does not exist at any time; `None` if it exists.
    fn lacks(&self, place: Place) -> Option<&'static str> {
        let _ = place;
        None
    }

    /// Starts a fault; an error changes nothing.
    fn begin_fault(&mut self, now: Instant, place: Place, fault: &PhysicalFault)
    -> Result<(), NotApplicable>;

    /// Ends a fault that was begun with the same place and variant.
    fn end_fault(&mut self, now: Instant, place: Place, fault: &PhysicalFault);
}
