//! Looks along a motion for the instants at which clearances and currents are worst.
//!
//! Distances are not taken everywhere: how fast two bodies can approach follows from the joint travel and from how far
//! a body can be from each joint axis, so a pair that is far apart is left alone until it could have come near.

use robot_model::Frames;
use robot_model::collision::Obb;

use super::cuts::{CURRENT_EXTRA, Cut, CutKind, placed};
use super::problem::Problem;
use super::throw::{JOINTS, Joints, Throw};

/// Grid of phases: this many steps before the release, and as many after it.
const STEPS: usize = 25;
/// Between instants a distance can dip by about an eighth of the relative acceleration times the step squared: 2 mm.
const REFINE_BELOW_M: f64 = 4e-3;
const REFINE_HALVINGS: usize = 4;
/// The ball leaves the fingers for this long without being tested against them (robot-models 1.9).
pub const RELEASE_BLIND_S: f64 = 0.02;

/// Result of a scan.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scan {
    /// Worst instants of every violated constraint.
    pub(crate) cuts: Vec<Cut>,
    /// Smallest clearance between tested bodies that was measured, in m (bodies known to be far are not measured).
    pub(crate) clearance_m: f64,
    /// Smallest clearance of the released ball, in m.
    pub(crate) ball_clearance_m: f64,
}

/// A pair of bodies whose distance is followed along the motion.
#[derive(Debug, Clone, Copy)]
struct Tracked {
    kind: CutKind,
    /// Joints `from..to` (from 0) change the distance.
    from: usize,
    to: usize,
    /// Lower bound of the distance above the clearance asked for, in m.
    slack_m: f64,
    worst_m: f64,
    worst_sigma: f64,
}

/// Everything about the pairs of a problem that does not depend on the throw.
#[derive(Debug, Clone)]
pub(crate) struct Scanner {
    pairs: Vec<Tracked>,
    /// `swing[p][k]`: how far a turn of joint k by 1 rad moves the second body of pair p, at most, in m.
    swing_m: Vec<[f64; JOINTS]>,
}

impl Scanner {
    pub(crate) fn new(problem: &Problem<'_>) -> Self {
        let arm = problem.arm;
        let model = arm.collision();
        let boxes = model.boxes();
        let mut kinds: Vec<(CutKind, usize, usize)> = Vec::new();
        for &(a, b) in model.pairs() {
            let (mut a, mut b) = (usize::from(a), usize::from(b));
            if boxes[a].link > boxes[b].link {
                (a, b) = (b, a);
            }
            kinds.push((CutKind::Boxes(a, b), boxes[a].link, boxes[b].link));
        }
        for (b, body) in boxes.iter().enumerate().filter(|(_, body)| body.link > 0) {
            if body.link >= model.rule().floor_from_link {
                kinds.push((CutKind::Floor(b), 0, body.link));
            }
            for o in 0..problem.options.obstacles.len() {
                kinds.push((CutKind::Obstacle(b, o), 0, body.link));
            }
        }
        // The ball sits in the fingers: it is tested from the fourth link down.
        for (a, body) in boxes.iter().enumerate().filter(|(_, body)| body.link + 2 <= JOINTS) {
            kinds.push((CutKind::HeldBall(a), body.link, JOINTS));
        }
        kinds.push((CutKind::HeldBallFloor, 0, JOINTS));
        for o in 0..problem.options.obstacles.len() {
            kinds.push((CutKind::HeldBallObstacle(o), 0, JOINTS));
        }
        let pairs = kinds
            .iter()
            .map(|&(kind, from, to)| Tracked {
                kind,
                from,
                to,
                slack_m: 0.0,
                worst_m: f64::INFINITY,
                worst_sigma: 0.0,
            })
            .collect();
        // The held ball is a little farther out than the hand.
        let ball_beyond =
            arm.gripper().x_eb.pos.norm() + arm.gripper().ball_radius_m + arm.end_effector().pos.norm();
        let swing_m = kinds
            .iter()
            .map(|(kind, _, to)| {
                std::array::from_fn(|k| {
                    let beyond = match kind {
                        CutKind::HeldBall(_) | CutKind::HeldBallObstacle(_) | CutKind::HeldBallFloor => {
                            ball_beyond
                        }
                        _ => 0.0,
                    };
                    model.swing_m(k, *to) + beyond
                })
            })
            .collect();
        Self { pairs, swing_m }
    }

    /// Scans a throw.
    pub(crate) fn scan(&self, problem: &Problem<'_>, throw: &Throw) -> Scan {
        let mut out = Scan { cuts: Vec::new(), clearance_m: f64::INFINITY, ball_clearance_m: f64::INFINITY };
        if problem.options.avoid_collisions {
            self.bodies(problem, throw, &mut out);
        }
        if problem.options.clean_release {
            flying_ball(problem, throw, &mut out);
        }
        if problem.options.current_over_motion {
            currents(problem, throw, &mut out);
        }
        out
    }

    fn bodies(&self, problem: &Problem<'_>, throw: &Throw, out: &mut Scan) {
        let arm = problem.arm;
        let clearance_m = problem.options.clearance_m;
        let mut pairs = self.pairs.clone();
        let turns = throw.qdd_rad_s2 != Joints::zeros();
        let peak = throw.peak_speed();
        let mut before = throw.start();
        let base: Vec<Obb> = arm.collision().boxes().iter().map(|b| Obb::new(b.x_lb, b.half_m)).collect();
        let mut boxes = base;
        for step in 0..=2 * STEPS {
            let sigma = (step as f64 - STEPS as f64) / STEPS as f64;
            let q = throw.at_phase(sigma).q;
            let mut travel = (q - before).abs();
            if turns {
                // Joints may turn round between two instants: speed times time is always enough.
                let dt = throw.phase_s(sigma - 1e-9) / STEPS as f64;
                travel = travel.sup(&(peak * dt));
            }
            before = q;
            let mut frames: Option<Frames<JOINTS>> = None;
            for (pair, swing) in pairs.iter_mut().zip(&self.swing_m) {
                let held = matches!(
                    pair.kind,
                    CutKind::HeldBall(_) | CutKind::HeldBallObstacle(_) | CutKind::HeldBallFloor
                );
                if held && sigma > 0.0 {
                    continue;
                }
                let approach: f64 = (pair.from..pair.to).map(|k| travel[k] * swing[k]).sum();
                pair.slack_m -= approach;
                if pair.slack_m > 0.0 && step > 0 {
                    continue;
                }
                let frames = frames.get_or_insert_with(|| {
                    let frames = arm.fk(&q);
                    for (placed, body) in boxes.iter_mut().zip(arm.collision().boxes()) {
                        if let Some(i) = body.link.checked_sub(1) {
                            placed.pose = frames.x_w[i] * body.x_lb;
                        }
                    }
                    frames
                });
                let distance = distance(problem, pair.kind, &boxes, frames) - clearance_m;
                pair.slack_m = distance;
                if distance < pair.worst_m {
                    pair.worst_m = distance;
                    pair.worst_sigma = sigma;
                }
            }
        }
        // Between two instants a near pair can be nearer still: look there.
        for pair in pairs.iter_mut().filter(|p| p.worst_m < REFINE_BELOW_M) {
            let mut step = 0.5 / STEPS as f64;
            for _ in 0..REFINE_HALVINGS {
                for sigma in [pair.worst_sigma - step, pair.worst_sigma + step] {
                    let held = matches!(
                        pair.kind,
                        CutKind::HeldBall(_) | CutKind::HeldBallObstacle(_) | CutKind::HeldBallFloor
                    );
                    let sigma = sigma.clamp(-1.0, if held { 0.0 } else { 1.0 });
                    let frames = arm.fk(&throw.at_phase(sigma).q);
                    for (placed, body) in boxes.iter_mut().zip(arm.collision().boxes()) {
                        if let Some(i) = body.link.checked_sub(1) {
                            placed.pose = frames.x_w[i] * body.x_lb;
                        }
                    }
                    let distance = distance(problem, pair.kind, &boxes, &frames) - clearance_m;
                    if distance < pair.worst_m {
                        pair.worst_m = distance;
                        pair.worst_sigma = sigma;
                    }
                }
                step *= 0.5;
            }
        }
        for pair in &pairs {
            out.clearance_m = out.clearance_m.min(pair.worst_m + clearance_m);
            if pair.worst_m < 0.0 {
                out.cuts.push(Cut { kind: pair.kind, sigma: pair.worst_sigma });
            }
        }
    }
}

/// A lower bound of the distance: spheres when far, separating axes when near.
fn distance(problem: &Problem<'_>, kind: CutKind, boxes: &[Obb], frames: &Frames<JOINTS>) -> f64 {
    let arm = problem.arm;
    let radius_m = arm.gripper().ball_radius_m;
    let floor = arm.world().floor_z_m;
    let obstacle = |o: usize| {
        let o = &problem.options.obstacles[o];
        Obb::new(o.x_wo, o.half_m)
    };
    let of_boxes = |a: &Obb, b: &Obb| {
        let gap = (a.pose.pos - b.pose.pos).norm() - a.radius_m() - b.radius_m();
        if gap > 0.05 { gap } else { a.separation(b) }
    };
    match kind {
        CutKind::Boxes(a, b) => of_boxes(&boxes[a], &boxes[b]),
        CutKind::Obstacle(b, o) => of_boxes(&obstacle(o), &boxes[b]),
        CutKind::Floor(b) => boxes[b].proximity_to_floor(floor).distance_m,
        CutKind::HeldBall(a) => boxes[a].proximity_to_sphere(&arm.ball(frames).pos, radius_m).distance_m,
        CutKind::HeldBallObstacle(o) => {
            obstacle(o).proximity_to_sphere(&arm.ball(frames).pos, radius_m).distance_m
        }
        CutKind::HeldBallFloor => arm.ball(frames).pos.z - radius_m - floor,
        _ => f64::INFINITY,
    }
}

/// The released ball against arm and obstacles until it lands.
fn flying_ball(problem: &Problem<'_>, throw: &Throw, out: &mut Scan) {
    let arm = problem.arm;
    let (p0, v0) = throw.ball_at_release(arm);
    let radius_m = arm.gripper().ball_radius_m;
    let clearance_m = problem.options.clearance_m;
    let bodies = arm.collision().boxes().len();
    let obstacles = problem.options.obstacles.len();
    let mut worst = vec![(f64::INFINITY, 0.0); bodies + obstacles];
    // The arm stops after h_b; the ball can still fall on it afterwards.
    let steps = 40_usize;
    let last_s = throw.flight_s;
    for step in 0..=steps {
        let s = RELEASE_BLIND_S + (last_s - RELEASE_BLIND_S) * step as f64 / steps as f64;
        let sigma = s / throw.hb_s;
        let p = problem.flight.fly(&p0, &v0, s).p;
        let frames = arm.fk(&throw.at_phase(sigma).q);
        for k in 0..bodies {
            let obb = placed(problem, &frames, k);
            let gap = (obb.pose.pos - p).norm() - obb.radius_m() - radius_m;
            if gap > worst[k].0 || gap > 0.3 {
                continue;
            }
            let distance = obb.proximity_to_sphere(&p, radius_m).distance_m;
            if distance < worst[k].0 {
                worst[k] = (distance, sigma);
            }
        }
        for (o, obstacle) in problem.options.obstacles.iter().enumerate() {
            let distance =
                Obb::new(obstacle.x_wo, obstacle.half_m).proximity_to_sphere(&p, radius_m).distance_m;
            // An obstacle that holds the target (a table, a bin) is met at the end of the flight.
            if distance < worst[bodies + o].0 && s < last_s - RELEASE_BLIND_S {
                worst[bodies + o] = (distance, sigma);
            }
        }
    }
    for (k, (distance, sigma)) in worst.into_iter().enumerate() {
        out.ball_clearance_m = out.ball_clearance_m.min(distance);
        if distance < clearance_m {
            let kind =
                if k < bodies { CutKind::FlyingBall(k) } else { CutKind::FlyingBallObstacle(k - bodies) };
            out.cuts.push(Cut { kind, sigma });
        }
    }
}

/// Currents of motors and supplies over the motion.
fn currents(problem: &Problem<'_>, throw: &Throw, out: &mut Scan) {
    let arm = problem.arm;
    let Some(drives) = arm.drives() else { return };
    let supplies = arm.supplies();
    let mut worst = vec![(0.0, 0.0); JOINTS + supplies.len()];
    // The release belongs to both phases, where acceleration is continuous; starts and stops are jumps, so inside.
    for step in 0..=2 * CURRENT_STEPS {
        let sigma = (step as f64 - CURRENT_STEPS as f64) / CURRENT_STEPS as f64;
        let s = throw.at_phase(sigma);
        let tau = arm.inverse_dynamics(&s.q, &s.qd, &s.qdd);
        let Some(motor) = arm.motor_currents(&s.qd, &tau) else { return };
        for j in 0..JOINTS {
            let share = motor[j] / drives[j].current_max_a;
            if share > worst[j].0 {
                worst[j] = (share, sigma);
            }
        }
        for (k, a) in arm.supply_currents(&motor).enumerate() {
            let share = a / supplies[k].current_max_a;
            if share > worst[JOINTS + k].0 {
                worst[JOINTS + k] = (share, sigma);
            }
        }
    }
    for (k, (share, sigma)) in worst.into_iter().enumerate() {
        if share > 1.0 - 0.2 * CURRENT_EXTRA {
            let kind = if k < JOINTS { CutKind::Motor(k) } else { CutKind::Supply(k - JOINTS) };
            out.cuts.push(Cut { kind, sigma });
        }
    }
}

const CURRENT_STEPS: usize = 24;
