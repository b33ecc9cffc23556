//! Searches a motion for the instants at which clearances and currents are worst.
//!
//! Distances are not computed everywhere: the joint travel and the distance of a body from each joint axis bound
//! how fast two bodies can approach, so a pair that is far apart is skipped until it could have come near.

use nalgebra::Vector3;
use robot_model::collision::Obb;
use robot_model::{Frames, JointVec};

use super::cuts::{CURRENT_EXTRA, Cut, CutKind, placed};
use super::problem::Problem;
use crate::throw::Throw;

/// Instants before the release; after it as many as make steps of the same length.
const STEPS: usize = 25;
/// Between instants a distance can dip; pairs nearer than this, or than the largest dip, are checked there.
const REFINE_BELOW_M: f64 = 4e-3;
const REFINE_HALVINGS: usize = 4;
/// The ball leaves the fingers for this long without being tested against them (robot-models 1.9).
pub(crate) const RELEASE_BLIND_S: f64 = 0.02;

/// Pairs this close to a limit get a row from the beginning when a similar throw is solved again.
const NEAR_M: f64 = 5e-3;
const NEAR_SHARE: f64 = 0.97;

/// Result of a scan.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scan {
    /// Worst instants of every violated constraint.
    pub(crate) cuts: Vec<Cut>,
    /// Worst instants of constraints that hold with little to spare.
    pub(crate) near: Vec<Cut>,
    /// Smallest clearance between tested bodies that was measured, in m (bodies known to be far are not measured).
    pub(crate) clearance_m: f64,
    /// Smallest clearance of the released ball, in m.
    pub(crate) ball_clearance_m: f64,
}

/// A pair of bodies whose distance is followed along the motion.
#[derive(Debug, Clone, Copy)]
struct Pair {
    kind: CutKind,
    /// The [`Group`] that bounds how fast they approach.
    group: usize,
    /// Boxes that must be placed: `None` for a body that does not move or is not a box.
    boxes: [Option<usize>; 2],
    held: bool,
}

/// Pairs whose distance is changed by the same joints.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Group {
    /// Joints `from..to` (from 0) change the distance.
    from: usize,
    to: usize,
    /// How far a turn of joint k by 1 rad moves the second body, at most, in m.
    swing_m: JointVec,
}

impl Group {
    /// How much nearer than at both ends a pair can be inside a step of `step_s`, in m: an eighth of the largest relative
    /// acceleration times the step squared. `speed` and `acceleration` are the largest of each joint, in rad/s and rad/s².
    fn dip_m(&self, speed: &JointVec, acceleration: &JointVec, step_s: f64) -> f64 {
        let joints = self.from..self.to;
        let pushed: f64 = joints.clone().map(|k| acceleration[k] * self.swing_m[k]).sum();
        let reach_m = joints.clone().map(|k| self.swing_m[k]).fold(0.0, f64::max);
        let turning: f64 = joints.map(|k| speed[k]).sum();
        (pushed + turning * turning * reach_m) * step_s * step_s / 8.0
    }
}

/// What is known about a pair so far.
#[derive(Debug, Clone)]
struct Track {
    /// Lower bound of the distance beyond the requested clearance, in m.
    slack_m: f64,
    worst_m: f64,
    worst_sigma: f64,
    /// Distance and phase at the last instant, and the distance at the one before.
    last: (f64, f64),
    before_m: f64,
    /// Near instants that are nearer than those beside them.
    dips: Vec<(f64, f64)>,
}

impl Default for Track {
    fn default() -> Self {
        Self {
            slack_m: 0.0,
            worst_m: f64::INFINITY,
            worst_sigma: 0.0,
            last: (f64::INFINITY, -1.0),
            before_m: f64::INFINITY,
            dips: Vec::new(),
        }
    }
}

impl Track {
    /// The next instant; the one before it is a dip if it is nearer than `below_m` and than both beside it.
    fn see(&mut self, distance_m: f64, sigma: f64, below_m: f64) {
        if self.last.0 < below_m && self.last.0 <= self.before_m && self.last.0 < distance_m {
            self.dips.push(self.last);
        }
        if distance_m < self.worst_m {
            (self.worst_m, self.worst_sigma) = (distance_m, sigma);
        }
        self.before_m = self.last.0;
        self.last = (distance_m, sigma);
    }
}

/// Everything about the pairs of a problem that does not depend on the throw.
#[derive(Debug, Clone)]
pub(crate) struct Scanner {
    pairs: Vec<Pair>,
    groups: Vec<Group>,
    obstacles: Vec<Obb>,
}

/// The arm at one instant; boxes are placed when they are needed.
struct Placed<'a> {
    problem: &'a Problem<'a>,
    obstacles: &'a [Obb],
    boxes: Vec<Obb>,
    /// Instant at which each box was placed.
    stamps: Vec<usize>,
    now: usize,
    frames: Option<Frames>,
    ball: Option<Vector3<f64>>,
}

impl Placed<'_> {
    fn move_to(&mut self) {
        self.now += 1;
        self.frames = None;
        self.ball = None;
    }

    /// A lower bound of the distance of a pair above the clearance: spheres when far, separating axes when near.
    fn distance(&mut self, pair: &Pair, q: &JointVec) -> f64 {
        let problem = self.problem;
        let arm = problem.arm;
        let frames = self.frames.get_or_insert_with(|| arm.fk(q));
        for k in pair.boxes.into_iter().flatten() {
            let body = &arm.collision().boxes()[k];
            if self.stamps[k] != self.now
                && let Some(i) = body.link.checked_sub(1)
            {
                self.boxes[k].pose = frames.x_w[i] * body.x_lb;
                self.stamps[k] = self.now;
            }
        }
        let ball = |memory: &mut Option<Vector3<f64>>| *memory.get_or_insert_with(|| arm.ball(frames).pos);
        let radius_m = arm.gripper().ball_radius_m;
        let floor = arm.world().floor_z_m;
        let of_boxes = |a: &Obb, b: &Obb| {
            let gap = (a.pose.pos - b.pose.pos).norm() - a.radius_m() - b.radius_m();
            if gap > 0.05 { gap } else { a.separation(b) }
        };
        let distance_m = match pair.kind {
            CutKind::Boxes(a, b) => of_boxes(&self.boxes[a], &self.boxes[b]),
            CutKind::Obstacle(b, o) => of_boxes(&self.obstacles[o], &self.boxes[b]),
            CutKind::Floor(b) => self.boxes[b].proximity_to_floor(floor).distance_m,
            CutKind::HeldBall(a) => {
                self.boxes[a].proximity_to_sphere(&ball(&mut self.ball), radius_m).distance_m
            }
            CutKind::HeldBallObstacle(o) => {
                self.obstacles[o].proximity_to_sphere(&ball(&mut self.ball), radius_m).distance_m
            }
            CutKind::HeldBallFloor => ball(&mut self.ball).z - radius_m - floor,
            _ => f64::INFINITY,
        };
        distance_m - pair.kind.clearance_m(problem)
    }
}

impl Scanner {
    pub(crate) fn new(problem: &Problem<'_>) -> Self {
        let arm = problem.arm;
        let model = arm.collision();
        let boxes = model.boxes();
        let (n, obstacles) = (arm.n(), problem.options.obstacles.len());
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
            for o in 0..obstacles {
                kinds.push((CutKind::Obstacle(b, o), 0, body.link));
            }
        }
        // The ball sits in the fingers: it is tested from the fourth link down.
        for (a, body) in boxes.iter().enumerate().filter(|(_, body)| body.link + 2 <= n) {
            kinds.push((CutKind::HeldBall(a), body.link, n));
        }
        kinds.push((CutKind::HeldBallFloor, 0, n));
        for o in 0..obstacles {
            kinds.push((CutKind::HeldBallObstacle(o), 0, n));
        }
        // The held ball is a little farther out than the hand.
        let ball_beyond =
            arm.gripper().x_eb.pos.norm() + arm.gripper().ball_radius_m + arm.end_effector().pos.norm();
        let mut groups: Vec<Group> = Vec::new();
        let pairs = kinds
            .into_iter()
            .map(|(kind, from, to)| {
                let (boxes, held) = match kind {
                    CutKind::Boxes(a, b) => ([Some(a), Some(b)], false),
                    CutKind::Floor(b) | CutKind::Obstacle(b, _) => ([Some(b), None], false),
                    CutKind::HeldBall(a) => ([Some(a), None], true),
                    _ => ([None, None], true),
                };
                let beyond = if held { ball_beyond } else { 0.0 };
                let swing_m = JointVec::from_fn(n, |k| model.swing_m(k, to) + beyond);
                let wanted = Group { from, to, swing_m };
                let group = groups.iter().position(|g| *g == wanted).unwrap_or_else(|| {
                    groups.push(wanted);
                    groups.len() - 1
                });
                Pair { kind, group, boxes, held }
            })
            .collect();
        let obstacles = problem.options.obstacles.iter().map(|o| Obb::new(o.x_wo, o.half_m)).collect();
        Self { pairs, groups, obstacles }
    }

    pub(crate) fn scan(&self, problem: &Problem<'_>, throw: &Throw) -> Scan {
        let mut out = Scan { clearance_m: f64::INFINITY, ball_clearance_m: f64::INFINITY, ..Scan::default() };
        if problem.options.avoid_collisions {
            self.bodies(problem, throw, &mut out);
        }
        if problem.options.clean_release || !problem.options.obstacles.is_empty() {
            flying_ball(problem, throw, &mut out);
        }
        if problem.options.current_over_motion {
            currents(problem, throw, &mut out);
        }
        out
    }

    fn bodies(&self, problem: &Problem<'_>, throw: &Throw, out: &mut Scan) {
        let arm = problem.arm;
        let mut tracks = vec![Track::default(); self.pairs.len()];
        let mut approach = vec![0.0; self.groups.len()];
        let boxes: Vec<Obb> = arm.collision().boxes().iter().map(|b| Obb::new(b.x_lb, b.half_m)).collect();
        let stamps = vec![0; boxes.len()];
        let obstacles = &self.obstacles;
        let mut placed = Placed { problem, obstacles, boxes, stamps, now: 0, frames: None, ball: None };
        let turns = throw.qdd_rad_s2 != JointVec::zeros(arm.n());
        let peak = throw.peak_speed();
        let mut before = throw.start();
        let steps_after = (STEPS as f64 * throw.hb_s / throw.ha_s).ceil().clamp(6.0, 50.0) as usize;
        let step_s = (throw.ha_s / STEPS as f64).max(throw.hb_s / steps_after as f64);
        let push = throw.peak_acceleration();
        let dips_m: Vec<f64> =
            self.groups.iter().map(|g| g.dip_m(&peak, &push, step_s).max(REFINE_BELOW_M)).collect();
        for step in 0..=STEPS + steps_after {
            let share = if step <= STEPS { STEPS } else { steps_after } as f64;
            let sigma = (step as f64 - STEPS as f64) / share;
            let q = throw.at_phase(sigma).q;
            let mut travel = (q - before).abs();
            if turns {
                // Joints may turn round between two instants: speed times time is always enough.
                let dt = throw.phase_s(sigma - 1e-9) / share;
                travel = travel.sup(&(peak * dt));
            }
            before = q;
            placed.move_to();
            for (way, g) in approach.iter_mut().zip(&self.groups) {
                *way = (g.from..g.to).map(|k| travel[k] * g.swing_m[k]).sum();
            }
            for (pair, track) in self.pairs.iter().zip(&mut tracks) {
                track.slack_m -= approach[pair.group];
                if track.slack_m > 0.0 || pair.held && sigma > 0.0 {
                    track.see(f64::INFINITY, sigma, dips_m[pair.group]);
                    continue;
                }
                track.slack_m = placed.distance(pair, &q);
                track.see(track.slack_m, sigma, dips_m[pair.group]);
            }
        }
        for (pair, track) in self.pairs.iter().zip(&mut tracks) {
            track.see(f64::INFINITY, 1.0, dips_m[pair.group]);
            let last = if pair.held { 0.0 } else { 1.0 };
            for (least_m, middle) in std::mem::take(&mut track.dips) {
                let (mut near_m, mut near) = (least_m, middle);
                let mut step = 0.5 / STEPS as f64;
                for _ in 0..REFINE_HALVINGS {
                    for sigma in [near - step, near + step] {
                        let sigma = sigma.clamp(-1.0, last);
                        placed.move_to();
                        let distance = placed.distance(pair, &throw.at_phase(sigma).q);
                        if distance < near_m {
                            (near_m, near) = (distance, sigma);
                        }
                    }
                    step *= 0.5;
                }
                if near_m < track.worst_m {
                    (track.worst_m, track.worst_sigma) = (near_m, near);
                }
            }
            out.clearance_m = out.clearance_m.min(track.worst_m + pair.kind.clearance_m(problem));
            if track.worst_m < NEAR_M {
                let cut = Cut { kind: pair.kind, sigma: track.worst_sigma };
                if track.worst_m < 0.0 { out.cuts.push(cut) } else { out.near.push(cut) }
            }
        }
    }
}

/// The released ball against obstacles, and for a clean release against the arm, until it lands.
fn flying_ball(problem: &Problem<'_>, throw: &Throw, out: &mut Scan) {
    let arm = problem.arm;
    let (p0, v0) = throw.ball_at_release(arm);
    let radius_m = arm.gripper().ball_radius_m;
    let bodies = if problem.options.clean_release { arm.collision().boxes().len() } else { 0 };
    let obstacles: Vec<Obb> = problem.options.obstacles.iter().map(|o| Obb::new(o.x_wo, o.half_m)).collect();
    // Distance of body k at a time; far bodies are not measured exactly.
    let distance = |k: usize, s: f64, frames: &Frames, p: &Vector3<f64>| -> f64 {
        let Some(o) = k.checked_sub(bodies) else {
            let body = &arm.collision().boxes()[k];
            let centre = match body.link.checked_sub(1) {
                Some(i) => frames.x_w[i].transform_point(&body.x_lb.pos),
                None => body.x_lb.pos,
            };
            let gap = (centre - p).norm() - body.half_m.norm() - radius_m;
            return if gap > FAR_FROM_BALL_M {
                gap
            } else {
                placed(problem, frames, k).proximity_to_sphere(p, radius_m).distance_m
            };
        };
        // An obstacle that holds the target (a table, a bin) is met at the end of the flight.
        if s >= throw.flight_s - RELEASE_BLIND_S {
            return f64::INFINITY;
        }
        obstacles[o].proximity_to_sphere(p, radius_m).distance_m
    };
    let at = |s: f64| (arm.fk(&throw.at_phase(s / throw.hb_s).q), problem.flight.fly(&p0, &v0, s).p);
    // The arm stops after h_b; the ball can still fall on it afterwards.
    let step_s = (throw.flight_s - RELEASE_BLIND_S) / BALL_STEPS as f64;
    let at_step = |step: usize| RELEASE_BLIND_S + step_s * step as f64;
    let mut sampled = vec![[f64::INFINITY; BALL_STEPS + 1]; bodies + obstacles.len()];
    for step in 0..=BALL_STEPS {
        let (frames, p) = at(at_step(step));
        for (k, sampled) in sampled.iter_mut().enumerate() {
            sampled[step] = distance(k, at_step(step), &frames, &p);
        }
    }
    for (k, sampled) in sampled.iter().enumerate() {
        let (mut least_m, mut at_s) = (f64::INFINITY, RELEASE_BLIND_S);
        for (step, &sample_m) in sampled.iter().enumerate() {
            let before_m = step.checked_sub(1).map_or(f64::INFINITY, |before| sampled[before]);
            let after_m = sampled.get(step + 1).copied().unwrap_or(f64::INFINITY);
            if sample_m > before_m || sample_m > after_m {
                continue;
            }
            let (mut near_m, mut near_s) = (sample_m, at_step(step));
            // The ball flies centimetres between two instants, and a rotating hand comes near more than once: check
            // around every instant that is nearer than those beside it.
            if near_m < BALL_REFINE_BELOW_M {
                let mut half_s = 0.5 * step_s;
                for _ in 0..BALL_HALVINGS {
                    for s in [near_s - half_s, near_s + half_s] {
                        let s = s.clamp(RELEASE_BLIND_S, throw.flight_s.max(RELEASE_BLIND_S));
                        let (frames, p) = at(s);
                        let d = distance(k, s, &frames, &p);
                        if d < near_m {
                            (near_m, near_s) = (d, s);
                        }
                    }
                    half_s *= 0.5;
                }
            }
            if near_m < least_m {
                (least_m, at_s) = (near_m, near_s);
            }
        }
        out.ball_clearance_m = out.ball_clearance_m.min(least_m);
        let kind = if k < bodies { CutKind::FlyingBall(k) } else { CutKind::FlyingBallObstacle(k - bodies) };
        let clearance_m = kind.clearance_m(problem);
        if least_m < clearance_m + NEAR_M {
            let into = if least_m < clearance_m { &mut out.cuts } else { &mut out.near };
            into.push(Cut { kind, sigma: at_s / throw.hb_s });
        }
    }
}

/// Bodies whose bounding sphere is farther than this from the ball are not measured exactly.
const FAR_FROM_BALL_M: f64 = 0.3;
/// Instants of the flight, the distance below which instants between them are checked, and how often a step is halved there.
const BALL_STEPS: usize = 40;
const BALL_REFINE_BELOW_M: f64 = 0.1;
const BALL_HALVINGS: usize = 8;

/// Currents of motors and supplies over the motion.
fn currents(problem: &Problem<'_>, throw: &Throw, out: &mut Scan) {
    let arm = problem.arm;
    let Some(drives) = arm.drives() else { return };
    let (n, supplies) = (arm.n(), arm.supplies());
    let mut worst = vec![(0.0, 0.0); n + supplies.len()];
    // The release belongs to both phases, where acceleration is continuous; starts and stops are jumps, so inside.
    for step in 0..=2 * CURRENT_STEPS {
        let sigma = (step as f64 - CURRENT_STEPS as f64) / CURRENT_STEPS as f64;
        let s = throw.at_phase(sigma);
        let tau = problem.arm_at(sigma).inverse_dynamics(&s.q, &s.qd, &s.qdd);
        let Some(motor) = arm.motor_currents(&s.qd, &tau) else { return };
        for j in 0..n {
            let share = motor[j] / drives[j].current_max_a;
            if share > worst[j].0 {
                worst[j] = (share, sigma);
            }
        }
        for (k, a) in arm.supply_currents(&motor).enumerate() {
            let share = a / supplies[k].current_max_a;
            if share > worst[n + k].0 {
                worst[n + k] = (share, sigma);
            }
        }
    }
    for (k, (share, sigma)) in worst.into_iter().enumerate() {
        if share > NEAR_SHARE {
            let kind = if k < n { CutKind::Motor(k) } else { CutKind::Supply(k - n) };
            let into = if share > 1.0 - 0.2 * CURRENT_EXTRA { &mut out.cuts } else { &mut out.near };
            into.push(Cut { kind, sigma });
        }
    }
}

const CURRENT_STEPS: usize = 24;
