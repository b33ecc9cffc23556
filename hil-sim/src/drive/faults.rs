//! Faults of one module: what each does to it.

use protocol::{Instant, powercube::CubeState};

use super::state::PowerCubeDrive;
use crate::fault::PhysicalFault;

impl PowerCubeDrive {
    /// Starts a fault; false for faults that are not inside a module (the axis held from outside, supply, gripper).
    pub fn begin(&mut self, now: Instant, fault: &PhysicalFault) -> bool {
        match fault {
            PhysicalFault::Frozen => self.afflictions.frozen = Some(self.snapshot(now)),
            PhysicalFault::Slow(by) => self.afflictions.slow = *by,
            PhysicalFault::Restart => self.restart(now),
            PhysicalFault::OverCurrent => self.raise(now, CubeState::POW_SHORTCUR),
            PhysicalFault::HallError => self.raise(now, CubeState::POW_HALLERR),
            // Numbers from a scenario are finite; a hostile one does nothing.
            PhysicalFault::EncoderOffset { offset_rad } if offset_rad.is_finite() => {
                self.afflictions.encoder_offset_target_rad += offset_rad;
            }
            PhysicalFault::EncoderOffset { .. } => {}
            PhysicalFault::Blocked
            | PhysicalFault::SupplyLoss { .. }
            | PhysicalFault::StuckGripper
            | PhysicalFault::LateRelease(_) => return false,
        }
        true
    }

    /// Ends a fault. Latched errors stay until the protocol clears them; lost counts stay until homing or power-off.
    pub fn end(&mut self, fault: &PhysicalFault) {
        match fault {
            PhysicalFault::Frozen => self.afflictions.frozen = None,
            PhysicalFault::Slow(_) => self.afflictions.slow = protocol::Duration::ZERO,
            PhysicalFault::Restart
            | PhysicalFault::OverCurrent
            | PhysicalFault::HallError
            | PhysicalFault::EncoderOffset { .. }
            | PhysicalFault::Blocked
            | PhysicalFault::SupplyLoss { .. }
            | PhysicalFault::StuckGripper
            | PhysicalFault::LateRelease(_) => {}
        }
    }

    /// Latches error causes as the module's own monitoring would: for situations that no other fault causes
    /// (processor overload, set-up error).
    pub fn inject(&mut self, now: Instant, causes: CubeState) {
        let known = CubeState::from_bits(causes.bits() & CubeState::CAUSES.bits());
        if known != CubeState::EMPTY {
            self.raise(now, known);
        }
    }
}
