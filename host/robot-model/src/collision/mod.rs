//! Boxes around the arm and which of them are tested against each other.

use nalgebra::Vector3;

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
}

/// All boxes of a robot with the pairs to test.
#[derive(Debug, Clone)]
pub struct CollisionModel {
    pub(crate) boxes: Vec<BodyBox>,
    pub(crate) pairs: Vec<(u16, u16)>,
    pub(crate) rule: PairRule,
}

impl CollisionModel {
    /// Boxes in order of links, and the rule that selects the pairs.
    #[must_use]
    pub fn new(boxes: Vec<BodyBox>, rule: PairRule) -> Self {
        let mut pairs = Vec::new();
        for (a, box_a) in boxes.iter().enumerate() {
            for (b, box_b) in boxes.iter().enumerate().skip(a + 1) {
                if box_a.link.abs_diff(box_b.link) >= rule.link_distance_min {
                    pairs.push((a as u16, b as u16));
                }
            }
        }
        Self { boxes, pairs, rule }
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
}
