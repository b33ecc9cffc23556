//! Where to measure: how far a joint may turn, and poses in which gravity loads it.
//!
//! Every way is a straight line of one joint, proven free of collisions by the checker of the robot model.

use robot_model::collision::{CollisionChecker, Scene, StraightMove};
use robot_model::{JointVec, RobotModel};

/// Distance kept from the soft limits, rad.
const LIMIT_MARGIN_RAD: f64 = 0.1;
/// Way kept from where a collision begins, rad.
const CONTACT_MARGIN_RAD: f64 = 0.1;
/// Tolerance of the collision check, m.
const TOLERANCE_M: f64 = 1e-4;
/// Poses of the other joints that are looked at.
const CANDIDATES: usize = 600;
/// Of these, the best whose way is checked.
const CHECKED: usize = 40;
/// If a pose loads the joint at least with this share of the best one, a change of pose is not needed.
const ENOUGH: f64 = 0.6;
/// Points of a joint's range at which its load is computed.
const GRID: usize = 25;
/// Points over which a load is averaged.
const MEAN_POINTS: usize = 200;
/// Poses in which a holding current is measured.
pub const HOLDS: usize = 6;
/// Way from which a pose is approached, rad.
pub const APPROACH_RAD: f64 = 0.06;
/// Loads below this share of the largest are left out: a reading without sign does not show their direction.
const LOAD_SHARE_MIN: f64 = 0.15;
/// Loads below this count as zero, N m.
const NO_LOAD_NM: f64 = 1e-3;

/// An interval of one joint, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sweep {
    /// Lower end.
    pub low_rad: f64,
    /// Upper end.
    pub high_rad: f64,
}

impl Sweep {
    pub fn length_rad(&self) -> f64 {
        self.high_rad - self.low_rad
    }

    pub fn centre_rad(&self) -> f64 {
        0.5 * (self.low_rad + self.high_rad)
    }
}

/// Where the holding currents of a joint are measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Loading {
    /// Pose of all joints from which the measured one is turned.
    pub pose: JointVec,
    /// Joints to be brought there, one after the other.
    pub order: Vec<usize>,
    /// Positions of the measured joint, rad.
    pub holds_rad: Vec<f64>,
}

/// Free ways of a robot.
pub struct Ways<'m> {
    model: &'m RobotModel,
    checker: CollisionChecker<'m>,
}

impl<'m> Ways<'m> {
    /// For a robot in a scene without anything but its floor.
    pub fn new(model: &'m RobotModel, scene: &'m Scene) -> Self {
        Self { model, checker: CollisionChecker::new(model, scene) }
    }

    /// Whether turning `joint` from its place in `from` to `to_rad` is proven free.
    fn is_free(&mut self, from: &JointVec, joint: usize, to_rad: f64) -> bool {
        let mut to = *from;
        to[joint] = to_rad;
        self.checker.check_motion(&StraightMove { from: *from, to }, 0.0, 1.0, TOLERANCE_M).is_free()
    }

    /// How far `joint` may turn while the others stand: within the soft limits and free of collisions, with margins
    /// to both. Only its present position if that is outside already.
    pub fn sweep(&mut self, q: &JointVec, joint: usize) -> Sweep {
        let limits = &self.model.joints()[joint].limits;
        let here = q[joint];
        let mut end = |limit: f64| {
            let margin = CONTACT_MARGIN_RAD.copysign(limit - here);
            if self.is_free(q, joint, limit) {
                return limit;
            }
            let (mut free, mut contact) = (0.0, 1.0);
            for _ in 0..12 {
                let middle = 0.5 * (free + contact);
                let to = here + middle * (limit - here);
                if self.is_free(q, joint, to) { free = middle } else { contact = middle }
            }
            let reached = here + free * (limit - here) - margin;
            // The margin may be on the other side of the present position.
            if (reached - here) * (limit - here) > 0.0 { reached } else { here }
        };
        let low_rad = end((limits.q_min_rad + LIMIT_MARGIN_RAD).min(here));
        let high_rad = end((limits.q_max_rad - LIMIT_MARGIN_RAD).max(here));
        Sweep { low_rad, high_rad }
    }

    /// Loads of `joint` over `sweep`: (position rad, torque N m).
    fn loads(&self, q: &JointVec, joint: usize, sweep: &Sweep) -> Vec<(f64, f64)> {
        let mut q = *q;
        (0..GRID)
            .map(|i| {
                q[joint] = sweep.low_rad + sweep.length_rad() * i as f64 / (GRID - 1) as f64;
                (q[joint], self.model.gravity_torques(&q)[joint])
            })
            .collect()
    }

    /// Mean |load| of `joint` over `sweep`, N m.
    pub fn mean_load_nm(&self, q: &JointVec, joint: usize, sweep: &Sweep) -> f64 {
        // Midpoint rule: the ends count as little as they do for a joint that passes at a steady speed.
        let mut q = *q;
        let torques = (0..MEAN_POINTS).map(|i| {
            q[joint] = sweep.low_rad + sweep.length_rad() * (i as f64 + 0.5) / MEAN_POINTS as f64;
            self.model.gravity_torques(&q)[joint].abs()
        });
        torques.sum::<f64>() / MEAN_POINTS as f64
    }

    /// Poses that load `joint` differently, reached from `q` one joint at a time; with the largest load that was
    /// found, N m. No pose if gravity does not load the joint.
    pub fn loading(&mut self, q: &JointVec, joint: usize) -> (Option<Loading>, f64) {
        let here = self.sweep(q, joint);
        let span = |loads: &[(f64, f64)]| {
            let (low, high) = ends(loads);
            high - low
        };
        let own = span(&self.loads(q, joint, &here));
        let limits: Vec<(f64, f64)> =
            self.model.joints().iter().map(|j| (j.limits.q_min_rad, j.limits.q_max_rad)).collect();
        let mut samples = crate::noise::Noise::new(joint as u64 + 1);
        let whole = Sweep {
            low_rad: limits[joint].0 + LIMIT_MARGIN_RAD,
            high_rad: limits[joint].1 - LIMIT_MARGIN_RAD,
        };
        let mut candidates: Vec<(f64, JointVec)> = Vec::new();
        let (mut largest_nm, mut most) = (0.0f64, own);
        for _ in 0..CANDIDATES {
            let pose = JointVec::from_fn(q.len(), |i| {
                let (low, high) = limits[i];
                if i == joint { q[i] } else { low + 0.3 + (high - low - 0.6) * samples.unit() }
            });
            let loads = self.loads(&pose, joint, &whole);
            let (low, high) = ends(&loads);
            largest_nm = largest_nm.max(high.abs()).max(low.abs());
            candidates.push((high - low, pose));
        }
        if largest_nm < NO_LOAD_NM {
            return (None, largest_nm);
        }
        candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
        most = most.max(candidates[0].0);
        let mut best = Loading { pose: *q, order: Vec::new(), holds_rad: Vec::new() };
        let mut best_span = own;
        if own < ENOUGH * most {
            for (_, pose) in candidates.iter().take(CHECKED) {
                let Some(order) = self.order(q, pose, joint) else { continue };
                let sweep = self.sweep(pose, joint);
                let found = span(&self.loads(pose, joint, &sweep));
                if found > best_span {
                    (best.pose, best.order, best_span) = (*pose, order, found);
                }
                if found > ENOUGH * most {
                    break;
                }
            }
        }
        let sweep = self.sweep(&best.pose, joint);
        best.holds_rad = self.holds(&best.pose, joint, &sweep);
        (Some(best), largest_nm)
    }

    /// An order in which the joints can go from `from` to `to` one by one, `joint` staying; `None` if neither
    /// outwards nor inwards is free.
    fn order(&mut self, from: &JointVec, to: &JointVec, joint: usize) -> Option<Vec<usize>> {
        let outwards: Vec<usize> = (0..from.len()).filter(|i| *i != joint).collect();
        let inwards: Vec<usize> = outwards.iter().rev().copied().collect();
        [inwards, outwards].into_iter().find(|order| {
            let mut q = *from;
            order.iter().all(|&i| {
                let free = self.is_free(&q, i, to[i]);
                q[i] = to[i];
                free
            })
        })
    }

    /// Positions whose loads are spread evenly, none of them small.
    fn holds(&self, pose: &JointVec, joint: usize, sweep: &Sweep) -> Vec<f64> {
        let inside = Sweep { low_rad: sweep.low_rad + APPROACH_RAD, high_rad: sweep.high_rad - APPROACH_RAD };
        let loads = self.loads(pose, joint, &inside);
        let (low, high) = ends(&loads);
        let small = LOAD_SHARE_MIN * low.abs().max(high.abs());
        (0..HOLDS)
            .filter_map(|k| {
                let wanted = low + (high - low) * k as f64 / (HOLDS - 1) as f64;
                let usable = loads.iter().filter(|(_, torque)| torque.abs() >= small);
                usable.min_by(|a, b| (a.1 - wanted).abs().total_cmp(&(b.1 - wanted).abs())).map(|(q, _)| *q)
            })
            .collect()
    }
}

/// Smallest and largest load.
fn ends(loads: &[(f64, f64)]) -> (f64, f64) {
    loads
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |e, (_, torque)| (e.0.min(*torque), e.1.max(*torque)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use robot_model::RobotModel;

    fn arm() -> RobotModel {
        RobotModel::load("powercube6").unwrap()
    }

    fn upright() -> JointVec {
        JointVec::from_slice(&[0.1, -1.47, -1.47, 0.1, 0.1, 0.1])
    }

    #[test]
    fn sweep_ends_before_the_limit_or_the_first_contact() {
        let (model, scene) = (arm(), Scene::default());
        let mut ways = Ways::new(&model, &scene);
        let turn = ways.sweep(&upright(), 0);
        assert!((turn.low_rad + std::f64::consts::PI - 0.1).abs() < 1e-9, "{turn:?}");
        let shoulder = ways.sweep(&upright(), 1);
        assert!(shoulder.length_rad() > 2.0 && shoulder.low_rad >= -240f64.to_radians() + 0.1 - 1e-9);
        let mut checker = CollisionChecker::new(&model, &scene);
        for i in 0..=50 {
            let mut q = upright();
            q[1] = shoulder.low_rad + shoulder.length_rad() * f64::from(i) / 50.0;
            assert!(!checker.collides(&model.fk(&q)), "{q}");
        }
    }

    #[test]
    fn loads_reach_from_one_side_to_the_other_where_gravity_can_load_the_joint() {
        let (model, scene) = (arm(), Scene::default());
        let mut ways = Ways::new(&model, &scene);
        for joint in 1..5 {
            let (loading, largest_nm) = ways.loading(&upright(), joint);
            let loading = loading.unwrap();
            let torques: Vec<f64> = loading
                .holds_rad
                .iter()
                .map(|&angle| {
                    let mut q = loading.pose;
                    q[joint] = angle;
                    model.gravity_torques(&q)[joint]
                })
                .collect();
            let (low, high) = torques.iter().fold((0.0f64, 0.0f64), |e, t| (e.0.min(*t), e.1.max(*t)));
            assert!(
                torques.len() == HOLDS && high - low > largest_nm / 3.0,
                "{joint}: {torques:?} {largest_nm}"
            );
        }
    }

    #[test]
    fn vertical_axis_and_symmetric_hand_have_no_load() {
        let (model, scene) = (arm(), Scene::default());
        let mut ways = Ways::new(&model, &scene);
        for joint in [0, 5] {
            let (loading, largest_nm) = ways.loading(&upright(), joint);
            assert!(loading.is_none() && largest_nm < 1e-3, "{joint}: {largest_nm}");
        }
    }
}
