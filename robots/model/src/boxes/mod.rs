//! Boxes around the links, and which pairs of them are tested.

mod obb;
mod swing;

use nalgebra::Vector3;

pub use obb::{Obb, Proximity, aligned_box};
use swing::swing;

use crate::per_joint::JOINTS_MAX;
use crate::pose::Pose;

/// An oriented box fixed to a link.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyBox {
    /// Name, unique in the robot.
    pub name: String,
    /// Link it belongs to: 0 is the base, `i` the link moved by joint `i` (from 1).
    pub link: usize,
    /// Centre and axes in the joint frame of the link (world frame for the base).
    pub x_lb: Pose,
    /// Half edge lengths in m, all positive.
    pub half_m: Vector3<f64>,
}

/// Which boxes are tested.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PairRule {
    /// Two boxes are tested if their links differ by at least this much.
    pub link_distance_min: usize,
    /// The floor is tested with links from this one on.
    pub floor_from_link: usize,
    /// Links whose boxes are not tested against those of a link: bit `b` at place `a`, and bit `a` at place `b`.
    pub(crate) untested: [u16; JOINTS_MAX + 1],
}

impl PairRule {
    /// Whether boxes of these two links are tested against each other.
    #[must_use]
    pub fn tests(&self, a: usize, b: usize) -> bool {
        a.abs_diff(b) >= self.link_distance_min && self.untested.get(a).is_none_or(|bits| bits >> b & 1 == 0)
    }

    /// Leaves two links out of the tests against each other.
    pub(crate) fn leave_out(&mut self, a: usize, b: usize) {
        self.untested[a] |= 1 << b;
        self.untested[b] |= 1 << a;
    }
}

/// All boxes of a robot with the pairs to test.
#[derive(Debug, Clone)]
pub struct CollisionModel {
    boxes: Vec<BodyBox>,
    pairs: Vec<(u16, u16)>,
    rule: PairRule,
    /// `swing_m[k][i]`: largest distance from the axis of joint `k` at which a box of link `i` can be, for any angles.
    swing_m: Vec<Vec<f64>>,
    /// The same for the centre of the held ball on the last link.
    ball_swing_m: Vec<f64>,
}

impl CollisionModel {
    /// Boxes in order of links, the rule that selects pairs, the joint frames, and the ball in the last joint frame.
    pub(crate) fn new(boxes: Vec<BodyBox>, rule: PairRule, x_pj: &[Pose], ball_n: &Vector3<f64>) -> Self {
        let mut pairs = Vec::new();
        for (a, box_a) in boxes.iter().enumerate() {
            for (b, box_b) in boxes.iter().enumerate().skip(a + 1) {
                if rule.tests(box_a.link, box_b.link) {
                    pairs.push((a as u16, b as u16));
                }
            }
        }
        let joints = x_pj.len();
        let swing_m = (0..joints)
            .map(|k| {
                (0..joints)
                    .map(|i| {
                        let corners = boxes
                            .iter()
                            .filter(|b| b.link == i + 1)
                            .flat_map(|b| Obb::new(b.x_lb, b.half_m).corners().collect::<Vec<_>>());
                        corners.map(|c| swing(x_pj, k, i, &c)).fold(0.0, f64::max)
                    })
                    .collect()
            })
            .collect();
        let ball_swing_m = (0..joints).map(|k| swing(x_pj, k, joints - 1, ball_n)).collect();
        Self { boxes, pairs, rule, swing_m, ball_swing_m }
    }

    /// The boxes, base first.
    #[must_use]
    pub fn boxes(&self) -> &[BodyBox] {
        &self.boxes
    }

    /// Indices into [`CollisionModel::boxes`] of the pairs to test.
    #[must_use]
    pub fn pairs(&self) -> &[(u16, u16)] {
        &self.pairs
    }

    /// The rule that selected the pairs.
    #[must_use]
    pub fn rule(&self) -> PairRule {
        self.rule
    }

    /// Largest distance in m from the axis of joint `k` (from 0) at which a box of link `i` (from 1) can be, for
    /// any angles of the joints between. A turn of `k` by `δ` moves each point of that link by at most this times
    /// `|δ|`.
    #[must_use]
    pub fn swing_m(&self, k: usize, i: usize) -> f64 {
        if i == 0 || k >= i { 0.0 } else { self.swing_m[k][i - 1] }
    }

    /// The same for the centre of the held ball.
    #[must_use]
    pub fn ball_swing_m(&self, k: usize) -> f64 {
        self.ball_swing_m[k]
    }
}
