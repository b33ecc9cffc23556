//! The arm as viewers show it: joint angles, frames and bodies, in the public schemas `foxglove.JointStates`,
//! `foxglove.FrameTransforms` and `foxglove.SceneUpdate`.
//!
//! Drives answer one after the other within a control cycle. [`ArmView`] collects their answers. When each drive
//! has reported its angle, or one reports it again, the cycle ends and the angles are shown together. So there is
//! one message per control cycle, and the angles in it are at most one cycle apart.

use std::f64::consts::PI;

use nalgebra::{Rotation3, Vector3};
use robot_model::Pose;

use super::schema::Message;
use crate::machine::{Machine, frame_of, link_pose, quaternion};
use protocol::Instant;

/// Frame at the place where the hand holds the ball; its axes are those of the world.
const HAND_FRAME: &str = "hand";
/// Frame of what a tracker sees.
const ROOM_FRAME: &str = "room";
/// Colours: red, green, blue, opacity.
const BODY_COLOUR: [f64; 4] = [0.56, 0.63, 0.71, 1.0];
const BALL_COLOUR: [f64; 4] = [0.90, 0.45, 0.13, 1.0];
/// Identity of the ball among the bodies.
const BALL: &str = "ball";

/// Collects reports of drives until a control cycle is complete.
pub struct ArmView {
    machine: Machine,
    /// Last reported angle of each joint, rad.
    q_rad: Vec<Option<f64>>,
    /// Joints that were heard in this cycle.
    fresh: Vec<bool>,
    bodies_shown: bool,
    ball_shown: bool,
}

/// Angles of one control cycle, in the order of the joints; `None` for a drive that was never heard.
pub type Angles = Vec<Option<f64>>;

impl ArmView {
    /// No data yet.
    #[must_use]
    pub fn new(machine: Machine) -> Self {
        let joints = machine.joints.len();
        Self {
            machine,
            q_rad: vec![None; joints],
            fresh: vec![false; joints],
            bodies_shown: false,
            ball_shown: false,
        }
    }

    /// Takes the angle in rad that a drive reported; returns the angles of a cycle that it completes or ends.
    pub fn take(&mut self, address: u8, q_rad: f64) -> Option<Angles> {
        let joint = self.machine.addresses.iter().position(|known| *known == address)?;
        let (slot, fresh) = (self.q_rad.get_mut(joint)?, self.fresh.get_mut(joint)?);
        if *fresh {
            // A drive did not answer in the last cycle.
            let complete = self.q_rad.clone();
            self.q_rad[joint] = Some(q_rad);
            self.fresh.fill(false);
            self.fresh[joint] = true;
            return Some(complete);
        }
        (*slot, *fresh) = (Some(q_rad), true);
        if self.fresh.iter().all(|fresh| *fresh) {
            self.fresh.fill(false);
            return Some(self.q_rad.clone());
        }
        None
    }

    /// `foxglove.JointStates`: the joints that were heard.
    #[must_use]
    pub fn joint_states(&self, angles: &Angles, unix: Instant) -> Message {
        let mut all = Message::default().bytes(1, &timestamp(unix));
        for (name, q_rad) in self.machine.joints.iter().zip(angles) {
            if let Some(q_rad) = q_rad {
                let joint = Message::default().bytes(1, name.as_bytes()).double(2, *q_rad);
                all = all.bytes(2, &joint.into_bytes());
            }
        }
        all
    }

    /// `foxglove.FrameTransforms`: links and hand in the world; `None` until every joint was heard.
    #[must_use]
    pub fn transforms(&self, angles: &Angles, unix: Instant) -> Option<Message> {
        let q_rad: Vec<f64> = angles.iter().copied().collect::<Option<_>>()?;
        let placed = self.machine.place(&q_rad);
        let mut all = Message::default();
        for (i, link) in placed.links.iter().enumerate() {
            let (p, turn) = link_pose(link);
            let child = frame_of(i + 1);
            all = all.bytes(1, &transform(unix, &child, p, [turn.i, turn.j, turn.k, turn.w]).into_bytes());
        }
        Some(all.bytes(1, &transform(unix, HAND_FRAME, placed.hand_m, [0.0, 0.0, 0.0, 1.0]).into_bytes()))
    }

    /// `foxglove.SceneUpdate`: the bodies of the links, once the frames are known; a viewer moves them with their frames. `None` after
    /// the first time.
    pub fn bodies(&mut self, unix: Instant) -> Option<Message> {
        if std::mem::replace(&mut self.bodies_shown, true) || self.machine.boxes.is_empty() {
            return None;
        }
        Some(self.scene(unix, false))
    }

    /// `foxglove.SceneUpdate`: a ball is in the hand while the gripper is closed, and leaves the scene when it
    /// opens: no frame of the bus shows whether the hand holds a ball, nor where it flies. `None` if nothing
    /// changes.
    pub fn ball(&mut self, gripper_open: bool, unix: Instant) -> Option<Message> {
        if std::mem::replace(&mut self.ball_shown, !gripper_open) != gripper_open {
            return None;
        }
        Some(self.scene(unix, gripper_open))
    }

    /// Everything that is shown now, and the removal of the ball. A viewer that jumps in time gets only the last
    /// update before: each one has the whole scene.
    fn scene(&self, unix: Instant, ball_gone: bool) -> Message {
        let mut all = Message::default();
        if ball_gone {
            // Deletion of one entity: type 0 is "the one with this id".
            let gone = Message::default().bytes(1, &timestamp(unix)).uint(2, 0).bytes(3, BALL.as_bytes());
            all = all.bytes(1, &gone.into_bytes());
        }
        let bodies = if self.bodies_shown { &self.machine.boxes[..] } else { &[] };
        for (i, (link, x_lb, half_m)) in bodies.iter().enumerate() {
            let edges = half_m.map(|half| 2.0 * half);
            let cube = Message::default()
                .bytes(1, &pose(x_lb))
                .bytes(2, &numbers(&edges))
                .bytes(3, &numbers(&BODY_COLOUR));
            let body = entity(unix, &frame_of(*link), &format!("body {i}")).bytes(8, &cube.into_bytes());
            all = all.bytes(2, &body.into_bytes());
        }
        if self.ball_shown {
            let sphere = Message::default()
                .bytes(1, &pose(&Pose::translation(0.0, 0.0, 0.0)))
                .bytes(2, &numbers(&[2.0 * self.machine.ball_radius_m; 3]))
                .bytes(3, &numbers(&BALL_COLOUR));
            let ball = entity(unix, HAND_FRAME, BALL).bytes(9, &sphere.into_bytes());
            all = all.bytes(2, &ball.into_bytes());
        }
        all
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Thrown {
    Ball {
        radius_m: f64,
    },
    Disc {
        radius_m: f64,
        thickness_m: f64,
        /// Unit vector, in the frame of the room.
        normal: [f64; 3],
    },
}

impl Thrown {
    pub(super) const fn topic(&self) -> &'static str {
        match self {
            Self::Ball { .. } => "/ball",
            Self::Disc { .. } => "/disc",
        }
    }
}

/// `foxglove.SceneUpdate`: a ball or disc that flies or lies somewhere, m, in the frame of the room.
pub(super) fn thrown_at(unix: Instant, p_m: [f64; 3], shape: &Thrown) -> Message {
    let [x, y, z] = p_m;
    let mut place = Pose::translation(x, y, z);
    let (field, size_m) = match *shape {
        Thrown::Ball { radius_m } => (9, [2.0 * radius_m; 3]),
        Thrown::Disc { radius_m, thickness_m, normal } => {
            let turn = Rotation3::rotation_between(&Vector3::z(), &normal.into());
            // Against z: half a turn about x.
            let turn = turn.unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), PI));
            place.rot = turn.into_inner();
            (10, [2.0 * radius_m, 2.0 * radius_m, thickness_m])
        }
    };
    let mut body = Message::default().bytes(1, &pose(&place)).bytes(2, &numbers(&size_m));
    body = match shape {
        Thrown::Ball { .. } => body.bytes(3, &numbers(&BALL_COLOUR)),
        // A cylinder as wide at the bottom as at the top.
        Thrown::Disc { .. } => body.double(3, 1.0).double(4, 1.0).bytes(5, &numbers(&BALL_COLOUR)),
    };
    let entity = entity(unix, ROOM_FRAME, BALL).bytes(field, &body.into_bytes());
    Message::default().bytes(2, &entity.into_bytes())
}

/// `foxglove.FrameTransforms`: the room, seen from the base of the arm.
pub(super) fn room_at(unix: Instant, x_br: &Pose) -> Message {
    let turn = quaternion(x_br.rot);
    let p = [x_br.pos.x, x_br.pos.y, x_br.pos.z];
    let room = transform(unix, ROOM_FRAME, p, [turn.i, turn.j, turn.k, turn.w]);
    Message::default().bytes(1, &room.into_bytes())
}

/// `google.protobuf.Timestamp`.
#[must_use]
pub fn timestamp(unix: Instant) -> Vec<u8> {
    let us = unix.as_micros();
    Message::default().uint(1, us / 1_000_000).uint(2, us % 1_000_000 * 1_000).into_bytes()
}

/// Vectors, quaternions and colours: doubles in fields from 1.
fn numbers(values: &[f64]) -> Vec<u8> {
    (1..)
        .zip(values)
        .fold(Message::default(), |message, (field, value)| message.double(field, *value))
        .into_bytes()
}

fn pose(x: &Pose) -> Vec<u8> {
    let turn = quaternion(x.rot);
    Message::default()
        .bytes(1, &numbers(&[x.pos.x, x.pos.y, x.pos.z]))
        .bytes(2, &numbers(&[turn.i, turn.j, turn.k, turn.w]))
        .into_bytes()
}

fn transform(unix: Instant, child: &str, p: [f64; 3], turn: [f64; 4]) -> Message {
    Message::default()
        .bytes(1, &timestamp(unix))
        .bytes(2, frame_of(0).as_bytes())
        .bytes(3, child.as_bytes())
        .bytes(4, &numbers(&p))
        .bytes(5, &numbers(&turn))
}

/// Head of an entity that stays (no lifetime) and moves with its frame.
fn entity(unix: Instant, frame: &str, id: &str) -> Message {
    Message::default()
        .bytes(1, &timestamp(unix))
        .bytes(2, frame.as_bytes())
        .bytes(3, id.as_bytes())
        .bytes(4, &[])
        .uint(5, 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> ArmView {
        ArmView::new(Machine::of(&robot_model::RobotModel::load("powercube6").unwrap()))
    }

    #[test]
    fn a_cycle_is_shown_when_each_drive_was_heard_or_one_is_heard_again() {
        let mut view = view();
        let addresses = view.machine.addresses.clone();
        for round in 0..2 {
            for (i, address) in addresses.iter().enumerate() {
                let q_rad = f64::from(round) + 0.1 * i as f64;
                let shown = view.take(*address, q_rad);
                assert_eq!(shown.is_some(), i + 1 == addresses.len(), "round {round}, drive {address}");
            }
        }
        // Drive 2 of the next cycle does not answer.
        assert_eq!(view.take(addresses[0], 2.0), None);
        for address in &addresses[2..] {
            assert_eq!(view.take(*address, 2.5), None);
        }
        let shown = view.take(addresses[0], 3.0).expect("the cycle is over");
        assert_eq!(shown, [2.0, 1.1, 2.5, 2.5, 2.5, 2.5].map(Some));
        assert_eq!(view.take(31, 9.0), None, "a drive that is not in the robot file");
    }

    #[test]
    fn frames_are_not_shown_before_every_joint_was_heard_and_bodies_are_shown_once() {
        let mut view = view();
        let mut angles = vec![Some(0.1); 6];
        assert!(view.transforms(&angles, Instant::ZERO).is_some());
        angles[3] = None;
        assert!(view.transforms(&angles, Instant::ZERO).is_none());
        assert!(view.bodies(Instant::ZERO).is_some() && view.bodies(Instant::ZERO).is_none());
    }

    #[test]
    fn the_ball_is_in_the_hand_until_the_gripper_opens() {
        let mut view = view();
        let mut changes = |open| view.ball(open, Instant::ZERO).is_some();
        assert_eq!([true, false, false, true, true].map(&mut changes), [false, true, false, true, false]);
    }
}
