//! Corners of a free path in joint space.
//!
//! Two trees grow towards each other through free space (Kuffner, LaValle, "RRT-Connect: an efficient approach to
//! single-query path planning", 2000). Then straight lines replace parts of the path, between corners and between
//! points on the edges.

use robot_model::collision::{CollisionChecker, Scene};
use robot_model::{JointVec, RobotModel};

use super::{MARGIN_RAD, Travel, is_free_line};
use crate::plan::rng::SplitMix64;

/// Largest step of a tree in one joint, rad.
const STEP_RAD: f64 = 0.8;
/// Points that are tried before giving up.
pub(super) const SAMPLES_MAX: usize = 20_000;
/// Paths of which the one that takes least time is kept, and points that are tried for each after the first.
const PATHS: usize = 4;
const SAMPLES_AGAIN: usize = 1_000;
/// Tries to cut a corner off.
const CUTS: usize = 120;

/// Joint space with what is free in it.
pub(super) struct Space<'a> {
    pub(super) checker: CollisionChecker<'a>,
    rng: SplitMix64,
    /// Least and largest angles of corners.
    range: (JointVec, JointVec),
    /// Largest speeds, rad/s.
    v: JointVec,
}

/// Poses with the index of the one each was reached from.
struct Tree {
    nodes: Vec<(JointVec, usize)>,
}

impl Tree {
    fn nearest(&self, q: &JointVec) -> usize {
        let distance = |node: &(JointVec, usize)| (node.0 - q).norm_squared();
        let by_distance =
            |a: &usize, b: &usize| distance(&self.nodes[*a]).total_cmp(&distance(&self.nodes[*b]));
        (0..self.nodes.len()).min_by(by_distance).unwrap_or(0)
    }

    /// From the root to `index`.
    fn branch(&self, mut index: usize) -> Vec<JointVec> {
        let mut branch = vec![self.nodes[index].0];
        while index != 0 {
            index = self.nodes[index].1;
            branch.push(self.nodes[index].0);
        }
        branch.reverse();
        branch
    }
}

impl<'a> Space<'a> {
    pub(super) fn new(arm: &'a RobotModel, scene: &'a Scene, travel: &Travel) -> Self {
        let margin = JointVec::repeat(arm.n(), MARGIN_RAD);
        let range = travel.range.unwrap_or((arm.q_min() + margin, arm.q_max() - margin));
        let v = arm.limit(|l| l.v_max_rad_s);
        Self { checker: CollisionChecker::new(arm, scene), rng: SplitMix64::new(travel.seed), range, v }
    }

    pub(super) fn is_free(&mut self, from: &JointVec, to: &JointVec) -> bool {
        is_free_line(&mut self.checker, from, to)
    }

    /// Corners of a free path from `from` to `to`, both included, shortened; `None` if none was found.
    pub(super) fn corners(&mut self, from: &JointVec, to: &JointVec) -> Option<Vec<JointVec>> {
        let path = self.connect(from, to, SAMPLES_MAX)?;
        let mut best = self.shorten(path);
        for _ in 1..PATHS {
            let Some(path) = self.connect(from, to, SAMPLES_AGAIN) else { break };
            let path = self.shorten(path);
            if self.time(&path) < self.time(&best) {
                best = path;
            }
        }
        Some(best)
    }

    /// Time along a path at the largest speeds, s.
    fn time(&self, path: &[JointVec]) -> f64 {
        path.windows(2).map(|pair| (pair[1] - pair[0]).component_div(&self.v).amax()).sum()
    }

    fn sample(&mut self) -> JointVec {
        let (low, high) = self.range;
        JointVec::from_fn(low.len(), |j| low[j] + (high[j] - low[j]) * self.rng.unit())
    }

    /// One step of `tree` towards `goal`; the index of the new node.
    fn extend(&mut self, tree: &mut Tree, goal: &JointVec) -> Option<usize> {
        let near = tree.nearest(goal);
        let from = tree.nodes[near].0;
        let way = goal - from;
        let reach = way.amax();
        let to = if reach > STEP_RAD { from + way * (STEP_RAD / reach) } else { *goal };
        if !self.is_free(&from, &to) {
            return None;
        }
        tree.nodes.push((to, near));
        Some(tree.nodes.len() - 1)
    }

    fn connect(&mut self, from: &JointVec, to: &JointVec, samples: usize) -> Option<Vec<JointVec>> {
        let mut trees = [Tree { nodes: vec![(*from, 0)] }, Tree { nodes: vec![(*to, 0)] }];
        for round in 0..samples {
            let (a, b) = (round % 2, 1 - round % 2);
            let sample = self.sample();
            let Some(new) = self.extend(&mut trees[a], &sample) else { continue };
            let meeting = trees[a].nodes[new].0;
            // The other tree comes as far as it can.
            while let Some(index) = self.extend(&mut trees[b], &meeting) {
                if trees[b].nodes[index].0 == meeting {
                    let mut path = trees[a].branch(new);
                    let mut rest = trees[b].branch(index);
                    rest.pop();
                    rest.reverse();
                    path.append(&mut rest);
                    if a == 1 {
                        path.reverse();
                    }
                    return Some(path);
                }
            }
        }
        None
    }

    /// Replaces parts of the path by straight lines.
    fn shorten(&mut self, mut path: Vec<JointVec>) -> Vec<JointVec> {
        for _ in 0..CUTS {
            if path.len() <= 2 {
                break;
            }
            let (a, b) = (self.place(&path), self.place(&path));
            let ((i, from), (k, to)) = if a.0 <= b.0 { (a, b) } else { (b, a) };
            // Points of one edge are joined already.
            if i == k || !self.is_free(&from, &to) {
                continue;
            }
            let mut shorter: Vec<JointVec> = path[..=i].to_vec();
            shorter.extend([from, to]);
            shorter.extend_from_slice(&path[k + 1..]);
            shorter.dedup_by(|b, a| (*a - *b).amax() < 1e-9);
            if self.time(&shorter) < self.time(&path) - 1e-9 {
                path = shorter;
            }
        }
        path
    }

    /// A corner or a point on an edge, with the index of the edge.
    fn place(&mut self, path: &[JointVec]) -> (usize, JointVec) {
        let edges = path.len() - 1;
        let edge = (self.rng.unit() * edges as f64) as usize % edges;
        let at = match 1.5 * self.rng.unit() - 0.25 {
            share if share <= 0.0 => path[edge],
            share if share >= 1.0 => path[edge + 1],
            share => path[edge] + (path[edge + 1] - path[edge]) * share,
        };
        (edge, at)
    }
}
