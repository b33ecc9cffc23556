//! What waits to be reported, in the order in which it is reported: faults, measurements, missed telegrams, ends of modes, the cycle.

use protocol::{Duration, JointIndex};

use crate::fault::Fault;
use crate::group::{GroupEvent, InForce, Measured, PositionSample};
use crate::joints::PerJoint;
use crate::settings::Settings;
use crate::span;

/// Events of one call.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pending {
    trouble: Option<Fault>,
    /// Joints whose measurement is still to be reported.
    measured: u8,
    missed: u8,
    missed_in_row: u32,
    other: Option<GroupEvent>,
    cycle: Option<(Duration, bool)>,
}

fn all(settings: &Settings) -> u8 {
    settings.joints().fold(0, |mask, joint| mask | joint.bit())
}

fn take_first(mask: &mut u8) -> Option<JointIndex> {
    let joint = JointIndex::new(mask.trailing_zeros() as usize).ok()?;
    *mask &= !joint.bit();
    Some(joint)
}

impl Pending {
    /// The first fault stays until it is reported.
    pub(super) fn trouble(&mut self, fault: Fault) {
        self.trouble = self.trouble.or(Some(fault));
    }

    pub(super) fn measured(&mut self, settings: &Settings) {
        self.measured = all(settings);
    }

    pub(super) fn missed(&mut self, settings: &Settings, in_row: u32) {
        (self.missed, self.missed_in_row) = (all(settings), in_row);
    }

    pub(super) const fn push(&mut self, event: GroupEvent) {
        self.other = Some(event);
    }

    pub(super) const fn cycle(&mut self, late: Duration, overrun: bool) {
        self.cycle = Some((late, overrun));
    }

    /// The next event. `tracking`: the axes follow a path, later than expected by this many seconds. Their positions are reported
    /// as those of the time of the path at which they belong: a delay that all axes share is no following error, and the
    /// group bounds it by itself.
    pub(super) fn poll(
        &mut self,
        sample: &PerJoint<Option<PositionSample>>,
        tracking: Option<f32>,
    ) -> Option<GroupEvent> {
        if let Some(fault) = self.trouble.take() {
            return Some(GroupEvent::Trouble(fault));
        }
        while let Some(joint) = take_first(&mut self.measured) {
            let Some(mut sample) = sample.get(joint) else { continue };
            if let Some(late_s) = tracking {
                let shift = span::of_seconds(late_s.abs());
                sample.at = if late_s > 0.0 { sample.at.saturating_sub(shift) } else { sample.at + shift };
            }
            let in_force = tracking.map(|_| InForce { u_rad_s2: 0.0, in_time: true });
            return Some(GroupEvent::Measured(Measured { joint, sample, in_force, trouble: None }));
        }
        if let Some(joint) = take_first(&mut self.missed) {
            return Some(GroupEvent::Missed(joint, self.missed_in_row));
        }
        if let Some(event) = self.other.take() {
            return Some(event);
        }
        let (late, overrun) = self.cycle.take()?;
        Some(GroupEvent::Cycle { late, overrun })
    }
}
