//! Physical faults: which part of the cell has them.

use protocol::{Duration, Instant};

use super::Cell;
use crate::fault::{FaultTarget, NotApplicable, PhysicalFault, Place};

const NO_MODULE: &str = "no module has this address";
const NO_SUPPLY: &str = "the robot has no such supply";

impl FaultTarget for Cell {
    fn lacks(&self, place: Place) -> Option<&'static str> {
        match place {
            Place::Module(module) if self.index_of(module).is_none() => Some(NO_MODULE),
            Place::Supply(index) if usize::from(index) >= self.supplies.len() => Some(NO_SUPPLY),
            _ => None,
        }
    }

    fn begin_fault(
        &mut self,
        now: Instant,
        place: Place,
        fault: &PhysicalFault,
    ) -> Result<(), NotApplicable> {
        let refused = |why| Err(NotApplicable { what: fault.name(), place, why });
        match (place, fault) {
            (Place::Module(module), fault) => {
                let Some(index) = self.index_of(module) else { return refused(NO_MODULE) };
                if *fault == PhysicalFault::Blocked {
                    self.plant.set_blocked(index, true);
                } else if !self.drives.begin(index, now, fault) {
                    return refused("it is no fault of such a drive");
                }
            }
            (Place::Supply(index), PhysicalFault::SupplyLoss { remaining }) => {
                let Some(supply) = self.supplies.get_mut(usize::from(index)) else {
                    return refused(NO_SUPPLY);
                };
                supply.set_remaining(*remaining);
            }
            (Place::Gripper, PhysicalFault::StuckGripper) => self.throw.set_stuck(now, true),
            (Place::Gripper, PhysicalFault::LateRelease(by)) => self.throw.set_late(*by),
            (Place::Supply(_), _) => return refused("only supply-loss happens to a supply"),
            (Place::Gripper, _) => {
                return refused("only stuck-gripper and late-release happen to the gripper");
            }
        }
        Ok(())
    }

    fn end_fault(&mut self, now: Instant, place: Place, fault: &PhysicalFault) {
        match (place, fault) {
            (Place::Module(module), PhysicalFault::Blocked) => {
                if let Some(axis) = self.index_of(module) {
                    self.plant.set_blocked(axis, false);
                }
            }
            (Place::Module(module), fault) => {
                if let Some(index) = self.index_of(module) {
                    self.drives.end(index, fault);
                }
            }
            (Place::Supply(index), PhysicalFault::SupplyLoss { .. }) => {
                if let Some(supply) = self.supplies.get_mut(usize::from(index)) {
                    supply.set_remaining(1.0);
                }
            }
            (Place::Gripper, PhysicalFault::StuckGripper) => self.throw.set_stuck(now, false),
            (Place::Gripper, PhysicalFault::LateRelease(_)) => self.throw.set_late(Duration::ZERO),
            // `begin_fault` refused these.
            (Place::Supply(_) | Place::Gripper, _) => {}
        }
    }
}
