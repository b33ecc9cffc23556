//! Where the ball lands when it leaves between fingers that open, instead of at one instant.
//!
//! The release itself is [`robot_model::release`], along the planned motion of the hand. Mean and covariance come from the
//! nodes of `spread`, each source alone, the others at their means; the fingers are one more source with three parts: lag of
//! the second finger, friction, acceleration of the opening. The planner does not move its aim by the mean.

use nalgebra::{Matrix2, Vector2};
use robot_model::release::{Released, release};
use robot_model::{Deviation, FingerScatter, Fingers, JointVec};

use super::disturbed::{Disturbed, drawn_flight};
use super::options::Noise;
use super::problem::Problem;
use super::rng::SplitMix64;
use super::spread::{DragFlights, SEVEN, THREE, release_delays};
use super::statistics::LandingPrediction;
use crate::flight::FlightModel;
use crate::throw::Throw;

/// Landing of a throw whose ball leaves between fingers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FingerLanding {
    /// Time from the planned release to the last touch of a finger, in s, if nothing is off.
    pub late_s: f64,
    /// Landing then against that of a ball that is free at the planned release, in m in the plane of the target.
    pub shift_m: Vector2<f64>,
    /// Mean and covariance with all noise.
    pub mean_m: Vector2<f64>,
    pub covariance_m2: Matrix2<f64>,
}

impl FingerLanding {
    /// As a prediction, for the probability of a hit.
    #[must_use]
    pub fn prediction(&self, without: &LandingPrediction) -> LandingPrediction {
        LandingPrediction { mean_m: self.mean_m, covariance_m2: self.covariance_m2, ..*without }
    }
}

fn leave(
    problem: &Problem<'_>,
    throw: &Throw,
    usual: &Fingers,
    (off, deviation): (&Disturbed, &Deviation),
) -> Option<Released> {
    let arm = problem.arm;
    let fingers = usual.deviated(deviation);
    let free_s = throw.ha_s + off.delay_s;
    let opens_s = free_s - usual.freeing_s();
    let hand = |t_s: f64| {
        let state = throw.at_time(t_s);
        // A speed that is off moves the joint too: the angles are off by `q_rad` when the ball should be free.
        let q_rad = state.q + off.q_rad + off.qd_rad_s * (t_s - free_s);
        arm.hand_motion(&q_rad, &(state.qd + off.qd_rad_s))
    };
    release(&fingers, arm.gripper().ball_radius_m, problem.flight.gravity_m_s2(), opens_s, hand).ok()
}

fn landing(
    problem: &Problem<'_>,
    throw: &Throw,
    flight: &FlightModel,
    left: &Released,
) -> Option<Vector2<f64>> {
    let late_s = left.at_s - throw.ha_s;
    let landed = flight.meet(&left.ball.p_m, &left.ball.v_m_s, &problem.aim, late_s)?;
    Some(problem.aim.coordinates(&landed.p, late_s + landed.time_s))
}

/// Predicts the landing; `None` if a ball stays in the fingers or does not come down on the plane of the target.
#[must_use]
pub fn predict_with_fingers(
    problem: &Problem<'_>,
    throw: &Throw,
    fingers: &Fingers,
    noise: &Noise,
) -> Option<FingerLanding> {
    let drag = DragFlights::of(&problem.flight, noise)?;
    let (nothing, usual) = (Disturbed::nothing(problem.joints()), Deviation::default());
    let at = |off: &Disturbed, deviation: &Deviation| {
        landing(problem, throw, &drag.mean, &leave(problem, throw, fingers, (off, deviation))?)
    };
    // Drag does not change how the ball leaves.
    let left = leave(problem, throw, fingers, (&nothing, &usual))?;
    let centre = landing(problem, throw, &drag.mean, &left)?;
    let (mut mean_m, mut covariance_m2) = (centre, Matrix2::zeros());
    let mut add = |nodes: &[(f64, Vector2<f64>)]| {
        let shift: Vector2<f64> = nodes.iter().map(|(weight, xy)| (xy - centre) * *weight).sum();
        let second: Matrix2<f64> =
            nodes.iter().map(|(weight, xy)| (xy - centre) * (xy - centre).transpose() * *weight).sum();
        mean_m += shift;
        covariance_m2 += second - shift * shift.transpose();
    };
    let late: Option<Vec<_>> = release_delays(noise)
        .into_iter()
        .map(|(delay_s, weight)| Some((weight, at(&Disturbed { delay_s, ..nothing }, &usual)?)))
        .collect();
    add(&late?);
    for j in 0..problem.joints() {
        let one = JointVec::from_fn(problem.joints(), |i| if i == j { 1.0 } else { 0.0 });
        let joint = |sigma: f64, off: &dyn Fn(f64) -> Disturbed| -> Option<Vec<_>> {
            let rule = THREE.iter().filter(|_| sigma > 0.0);
            rule.map(|(node, weight)| Some((*weight, at(&off(node * sigma), &usual)?))).collect()
        };
        add(&joint(noise.position_rad, &|x| Disturbed { q_rad: one * x, ..nothing })?);
        add(&joint(noise.speed_rad_s, &|x| Disturbed { qd_rad_s: one * x, ..nothing })?);
    }
    let nodes: Option<Vec<_>> = finger_nodes(&fingers.scatter)
        .into_iter()
        .map(|(weight, deviation)| Some((weight, at(&nothing, &deviation)?)))
        .collect();
    add(&nodes?);
    let nodes: Option<Vec<_>> = drag
        .nodes
        .iter()
        .map(|(weight, flight)| Some((*weight, landing(problem, throw, flight, &left)?)))
        .collect();
    add(&nodes?);
    let exact = landing(problem, throw, &problem.flight, &left)?;
    let (p, v) = throw.ball_at_release(problem.arm);
    let planned = problem.flight.meet(&p, &v, &problem.aim, 0.0)?;
    Some(FingerLanding {
        late_s: left.at_s - throw.ha_s,
        shift_m: exact - problem.aim.coordinates(&planned.p, planned.time_s),
        mean_m,
        covariance_m2,
    })
}

/// Weights and nodes for the three sources of the fingers together: the effect of a late finger depends on how fast both open.
fn finger_nodes(scatter: &FingerScatter) -> Vec<(f64, Deviation)> {
    let with_centre = |rule: &[(f64, f64)], sigma: f64| {
        let others: f64 = rule.iter().map(|(_, weight)| weight).sum();
        let mut nodes = vec![(0.0, 1.0 - others)];
        nodes.extend(rule.iter().map(|(node, weight)| (node * sigma, *weight)));
        // Without scatter one node is enough.
        if sigma > 0.0 { nodes } else { vec![(0.0, 1.0)] }
    };
    let mut out = Vec::new();
    for (lag_s, of_lag) in with_centre(&SEVEN, scatter.lag_s) {
        for (friction_share, of_friction) in with_centre(&THREE, scatter.friction_share) {
            for (opening_share, of_opening) in with_centre(&THREE, scatter.opening_share) {
                let deviation = Deviation { lag_s, friction_share, opening_share };
                out.push((of_lag * of_friction * of_opening, deviation));
            }
        }
    }
    out
}

/// Landings of `draws` disturbed throws with all deviations at once; throws whose ball stays in the fingers or does
/// not come down are left out. The reference for [`predict_with_fingers`].
#[must_use]
pub fn monte_carlo_with_fingers(
    problem: &Problem<'_>,
    throw: &Throw,
    fingers: &Fingers,
    noise: &Noise,
    draws: usize,
    seed: u64,
) -> Vec<Vector2<f64>> {
    let mut rng = SplitMix64::new(seed);
    (0..draws)
        .filter_map(|_| {
            let off = Disturbed::drawn(problem.joints(), noise, &mut rng);
            let deviation = fingers.scatter.deviation([rng.normal(), rng.normal(), rng.normal()]);
            let flight = drawn_flight(&problem.flight, noise, &mut rng)?;
            landing(problem, throw, &flight, &leave(problem, throw, fingers, (&off, &deviation))?)
        })
        .collect()
}
