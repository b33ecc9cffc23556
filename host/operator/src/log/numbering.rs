//! A joint keeps its number of the robot, also if a controller was made for a part of its joints (`cubectl jog 3`)
//! and counts only these.

use std::collections::BTreeMap;

use protocol::{Duration, Instant};

use super::facts::Fact;

/// A drive without a request for this long is not a drive of the controller.
const ASKED_WITHIN: Duration = Duration::from_secs(1);

/// The joints of a robot, and which of them the controller on the bus has: those whose drives get requests.
#[derive(Clone, Debug, Default)]
pub(super) struct Numbering {
    /// Address of the drive and name of each joint, base first.
    joints: Vec<(u8, String)>,
    /// When the drive at an address last got a request or an order.
    asked: BTreeMap<u8, Instant>,
    /// Number in the robot of each joint of the controller, as long as that was plain.
    kept: Vec<u8>,
}

impl Numbering {
    pub(super) fn new(joints: Vec<(u8, String)>) -> Self {
        Self { joints, ..Self::default() }
    }

    /// Name of the joint with the drive at this address.
    pub(super) fn name(&self, address: u8) -> Option<&str> {
        self.joints.iter().find(|(known, _)| *known == address).map(|(_, name)| name.as_str())
    }

    /// Replaces the controller's numbers by the robot's. Data that cannot be assigned to a joint are left out, or belong to the
    /// group.
    pub(super) fn renumber(&mut self, at: Instant, fact: &mut Fact) {
        match fact {
            Fact::Request { module, .. } => {
                self.asked.insert(module.get(), at);
            }
            Fact::Joints { joints, .. } => {
                self.learn(at, joints.len());
                joints.retain_mut(|(joint, _)| {
                    *joint = self.number(*joint);
                    *joint != 0
                });
            }
            Fact::Group { state, .. } => {
                if self.kept.is_empty() && state.fault_joint > 0 {
                    // A fault before the first report of joints: the controller's drives are those that got requests.
                    self.kept = self.own(at);
                }
                state.fault_joint = self.number(state.fault_joint);
            }
            Fact::Answer { refusal: Some(refusal), .. } => refusal.joint = self.number(refusal.joint),
            _ => {}
        }
    }

    /// The controller has so many joints.
    fn learn(&mut self, now: Instant, count: usize) {
        // Without a robot it counts as the controller does.
        let own =
            if (1..self.joints.len()).contains(&count) { self.own(now) } else { (1..).take(count).collect() };
        if own.len() == count {
            self.kept = own;
        } else if self.kept.len() != count {
            // Another node sends requests to other drives.
            self.kept = vec![0; count];
        }
    }

    /// Numbers of the joints whose drives get requests.
    fn own(&self, now: Instant) -> Vec<u8> {
        let is_asked =
            |address: &u8| self.asked.get(address).is_some_and(|at| now.saturating_since(*at) < ASKED_WITHIN);
        (1..)
            .zip(&self.joints)
            .filter(|(_, (address, _))| is_asked(address))
            .map(|(number, _)| number)
            .collect()
    }

    /// The robot's number of a joint of the controller; zero is the group, or not known.
    fn number(&self, joint: u8) -> u8 {
        let known = usize::from(joint).checked_sub(1).and_then(|j| self.kept.get(j));
        known.copied().unwrap_or(joint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::ModuleId;
    use protocol::cyphal::cubecell::group_state::GroupState;
    use protocol::cyphal::cubecell::joint_state::JointSample;
    use protocol::cyphal::id::NodeId;
    use protocol::powercube::{Parameter, Request};

    fn numbers(joints: &mut Numbering, at_ms: u64, count: u8) -> (Vec<u8>, u8) {
        let (at, from) = (Instant::from_micros(1_000 * at_ms), NodeId::from_low_bits(10));
        let mut reported =
            Fact::Joints { from, joints: (1..=count).map(|j| (j, JointSample::default())).collect() };
        joints.renumber(at, &mut reported);
        let state = GroupState { fault_joint: count, ..GroupState::default() };
        let mut group = Fact::Group { from, first_at: at, state };
        joints.renumber(at, &mut group);
        match (reported, group) {
            (Fact::Joints { joints, .. }, Fact::Group { state, .. }) => {
                (joints.iter().map(|(number, _)| *number).collect(), state.fault_joint)
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_controller_for_some_joints_does_not_make_them_the_first_ones() {
        let robot = || (1..=6).map(|k| (10 + k, format!("joint{k}"))).collect();
        let ask = |joints: &mut Numbering, at_ms: u64, address: u8| {
            let module = ModuleId::new(address).unwrap();
            let mut fact = Fact::Request { module, request: Request::Get(Parameter::ActPos) };
            joints.renumber(Instant::from_micros(1_000 * at_ms), &mut fact);
        };
        let mut joints = Numbering::new(robot());
        assert_eq!(
            numbers(&mut joints, 0, 6),
            (vec![1, 2, 3, 4, 5, 6], 6),
            "a whole arm needs no drives to be heard"
        );
        assert_eq!(numbers(&mut joints, 0, 1), (vec![], 0), "the joint is not known");
        ask(&mut joints, 10, 13);
        assert_eq!(numbers(&mut joints, 20, 1), (vec![3], 3));
        ask(&mut joints, 30, 11);
        assert_eq!(numbers(&mut joints, 40, 1), (vec![3], 3), "another host asks another drive");
        assert_eq!(numbers(&mut joints, 50, 2), (vec![1, 3], 3));
        assert_eq!(numbers(&mut joints, 5_000, 2), (vec![1, 3], 3), "as it was before the silence");
        assert_eq!(numbers(&mut Numbering::default(), 0, 2), (vec![1, 2], 2), "no robot is known");
    }
}
