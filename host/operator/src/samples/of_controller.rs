//! Samples that are read from a controller in this program.

use firmware::Controller;
use firmware::group::DriveGroup;
use firmware::spline::Spline;
use firmware::store::RamStorage;
use firmware::trace::TraceEvent;
use protocol::Instant;
use protocol::cyphal::cubecell::group_state::GroupState;
use protocol::cyphal::id::NodeId;

use super::{At, Freeze, GroupTold, JointFreeze, JointSamples, Samples};
use crate::log::facts::Fact;
use crate::log::watch::Watch;

/// See the [module](self).
pub(crate) struct Kept {
    pub(crate) samples: Samples,
    watch: Watch,
    /// Events of the trace that were seen.
    traced: u32,
}

impl Kept {
    pub(crate) fn new<G: DriveGroup>(controller: &Controller<RamStorage, Spline, G>) -> Self {
        let joints = vec![JointSamples::default(); controller.joints().count()];
        let samples = Samples { joints, ..Samples::default() };
        Self { samples, watch: Watch::default(), traced: controller.trace().total() }
    }

    /// Measurements and orders to the gripper since the last call; with `reported` also the controller's reports of its joints.
    pub(crate) fn collect<G: DriveGroup>(
        &mut self,
        now: Instant,
        controller: &Controller<RamStorage, Spline, G>,
        reported: bool,
    ) {
        for (kept, joint) in self.samples.joints.iter_mut().zip(controller.joints()) {
            if let Some(position) = controller.group().position(joint)
                && kept.positions.last().is_none_or(|last| last.at < position.at)
            {
                kept.positions.push(At { at: position.at, value: position.q_rad.into() });
            }
            let current_a = controller.group().readings(joint).current_a.map(f64::from);
            if let Some(value) =
                current_a.filter(|a| kept.currents.last().is_none_or(|last| last.value != *a))
            {
                kept.currents.push(At { at: now, value });
            }
            if reported {
                kept.reported.push((now, controller.joint_sample(joint)));
            }
        }
        for (number, at, event) in controller.trace().places().flatten() {
            if number > self.traced && matches!(event, TraceEvent::Gripper(_)) {
                self.samples.gripper_ordered.push(at);
            }
        }
        self.traced = controller.trace().total();
    }

    /// Report of the controller about the group.
    pub(crate) fn hear<G: DriveGroup>(
        &mut self,
        now: Instant,
        controller: &Controller<RamStorage, Spline, G>,
        state: &GroupState,
    ) {
        self.samples.group.push(GroupTold { at: now, made_by: now, state: *state });
        let fact = Fact::Group {
            from: NodeId::from_low_bits(controller.settings().node_id as u8),
            first_at: now,
            state: *state,
        };
        let notes = self.watch.take_fact(now, fact);
        self.samples.events.extend(notes.events);
        let joints = &self.samples.joints;
        let freeze = notes.freeze.map(|freeze| Freeze {
            at: freeze.at,
            group: freeze.group,
            before: freeze.before,
            joints: joints
                .iter()
                .map(|joint| JointFreeze {
                    position: joint.positions.last().copied(),
                    current_a: joint.currents.last().map(|current| current.value),
                    ..JointFreeze::default()
                })
                .collect(),
            frames: Vec::new(),
        });
        self.samples.freezes.extend(freeze);
    }
}
