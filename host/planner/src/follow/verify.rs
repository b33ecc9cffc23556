//! Second opinion on a plan, from its steps alone.
//!
//! Nothing of the search is used: joints come from the steps of the plan, frames from products of exponentials, boxes
//! from alternating projections, rates from finite differences, landings from the closed form of the flight.
//!
//! A robot is led through angles and speeds of the steps, so the ball must land by both: by the differences of the
//! angles on the parabola, and by the speeds that the steps state. The speeds must be those of the angles, to the
//! accuracy that the jerk limit allows.

use std::fmt;

use nalgebra::Vector3;
use robot_model::Pose;

use super::best::HandFreedom;
use super::limits::{AXES, Arm, Axes, Limits};
use super::plan::{FollowPlan, Form, Phase};
use super::setting::CommandRange;
use crate::verify::boxes;
use crate::verify::chain::Chain;

/// Largest distance of the ball from its parabola on the followed steps, in m.
const OFF_PARABOLA_MAX_M: f64 = 1e-4;
/// Largest distance from the target of a ball released at a followed step, in m.
const LANDING_MAX_M: f64 = 2e-3;
/// Limits may be passed by this share, for rounding.
const ROUNDING: f64 = 1e-6;
/// Largest angle of the hand from being across the flight, beyond what its form allows, in rad.
const ACROSS_MAX_RAD: f64 = 1e-3;
/// Instants per period at which bodies are placed.
const PLACES: usize = 2;

/// What is wrong.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    pub check: Check,
    /// Where: time from the first step in s.
    pub t_s: f64,
    /// Axis (from 1), where one is to blame.
    pub axis: Option<usize>,
    /// What was measured.
    pub value: f64,
    /// What is allowed.
    pub limit: f64,
    /// Bodies that are too near.
    pub bodies: Option<[String; 2]>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Check {
    /// Steps are one period apart, phases in order, numbers finite, rest at both ends.
    Steps,
    /// Joint ranges in rad.
    Range,
    /// Commands inside what the robot's program passes, in rad.
    Commands,
    /// Commanded speed in rad/s.
    Speed,
    /// Commanded acceleration in rad/s².
    Acceleration,
    /// Commanded jerk in rad/s³.
    Jerk,
    /// Difference between the speed that a step states and that of the angles around it, in rad/s.
    StatedSpeed,
    /// Commands through the lag give the planned angles, in rad.
    Lag,
    /// Ball on the parabola, in m.
    Parabola,
    /// Landing at the target, in m.
    Landing,
    /// Hand across the flight, in rad.
    Across,
    /// Height of flange, elbow and ball in the fingers above the floor, in m.
    Floor,
    /// Distance of boxes, in m.
    Boxes,
    /// Distance of the ball from arm and hand, in m.
    Ball,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self.check {
            Check::Steps => "steps are not one period apart, not in order, or not at rest at the ends",
            Check::Range => "joint range (rad)",
            Check::Commands => "command beyond what the robot's program passes (rad)",
            Check::Speed => "commanded speed (rad/s)",
            Check::Acceleration => "commanded acceleration (rad/s2)",
            Check::Jerk => "commanded jerk (rad/s3)",
            Check::StatedSpeed => "stated speed away from that of the angles around (rad/s)",
            Check::Lag => "executed angle through the lag (rad)",
            Check::Parabola => "ball off its parabola (m)",
            Check::Landing => "landing away from the target (m)",
            Check::Across => "hand not across the flight (rad)",
            Check::Floor => "height above the floor (m)",
            Check::Boxes => "distance of bodies (m)",
            Check::Ball => "distance of the ball (m)",
        };
        write!(f, "at {:.3} s: {name}", self.t_s)?;
        if let Some(axis) = self.axis {
            write!(f, ", axis {axis}")?;
        }
        if let Some([a, b]) = &self.bodies {
            write!(f, ", {a} and {b}")?;
        }
        write!(f, ": {:.6}, limit {:.6}", self.value, self.limit)
    }
}

/// What the verifier measured; one finding per check, the worst.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// What is wrong; empty for a good plan.
    pub findings: Vec<Finding>,
    /// Largest distance of the ball from its parabola on the followed steps, in m.
    pub off_parabola_m: f64,
    /// Largest distance from the target of a ball released at a followed step, in m.
    pub landing_m: f64,
    /// The same for the angles that the lag executes, in m; zero where no lag is planned for.
    pub executed_landing_m: f64,
    /// Smallest distance of bodies over the motion, in m.
    pub nearest_m: f64,
    /// Smallest distance of the free ball from arm and hand, in m.
    pub ball_m: f64,
}

impl Report {
    /// Whether nothing is wrong.
    #[must_use]
    pub fn is_good(&self) -> bool {
        self.findings.is_empty()
    }

    /// Keeps the worst of every check: the one with the largest excess in shares of its limit.
    fn require(&mut self, within: bool, finding: Finding) {
        if within {
            return;
        }
        let excess = |f: &Finding| (f.value - f.limit).abs();
        match self.findings.iter_mut().find(|f| f.check == finding.check) {
            Some(known) if excess(known) >= excess(&finding) => {}
            Some(known) => *known = finding,
            None => self.findings.push(finding),
        }
    }

    fn at_most(&mut self, check: Check, t_s: f64, axis: Option<usize>, value: f64, limit: f64) {
        // NaN fails.
        self.require(
            value <= limit * (1.0 + ROUNDING),
            Finding { check, t_s, axis, value, limit, bodies: None },
        );
    }
}

/// Checks a plan against an arm and limits, which are not taken from the plan.
#[must_use]
pub fn verify(arm: &Arm, limits: &Limits, plan: &FollowPlan) -> Report {
    verify_commands(arm, limits, &CommandRange::default(), plan)
}

/// As [`verify`], for a robot whose program passes only some commands.
#[must_use]
pub fn verify_commands(arm: &Arm, limits: &Limits, passed: &CommandRange, plan: &FollowPlan) -> Report {
    let mut report = Report { nearest_m: f64::INFINITY, ball_m: f64::INFINITY, ..Report::default() };
    steps(plan, &mut report);
    if !report.is_good() {
        // Everything else takes orderly steps for granted.
        return report;
    }
    let joints: Vec<Axes> = plan.steps.iter().map(|s| Axes::from(s.q_rad)).collect();
    let commands: Vec<Axes> = plan.steps.iter().map(|s| Axes::from(s.command_rad)).collect();
    rates(plan, limits, &joints, &commands, &mut report);
    stated_speeds(plan, &joints, &mut report);
    passed_commands(plan, passed, &mut report);
    let executed = lag(plan, &joints, &commands, &mut report);
    let chain = Chain::new(arm);
    report.executed_landing_m = executed_landing_m(arm, plan, &chain, &executed);
    let poses: Vec<Links> = joints.iter().map(|q| Links::at(arm, &chain, q)).collect();
    on_the_flight(arm, plan, &chain, &poses, &mut report);
    bodies(arm, plan, &chain, &joints, &mut report);
    report
}

fn steps(plan: &FollowPlan, report: &mut Report) {
    let [first, last] = plan.window;
    let orderly = plan.steps.iter().enumerate().all(|(k, step)| {
        let phase = match k {
            k if k < first => Phase::Accelerate,
            k if k <= last => Phase::Follow,
            _ => Phase::Decelerate,
        };
        (step.t_s - k as f64 * plan.period_s).abs() < 1e-9
            && step.phase == phase
            && step.q_rad.iter().chain(&step.command_rad).all(|v| v.is_finite())
    });
    let window =
        first > 0 && first <= last && last + 1 < plan.steps.len() && plan.followed_points == last - first + 1;
    let at_rest = plan.steps.first().zip(plan.steps.last()).is_some_and(|(a, b)| {
        [a, b].into_iter().all(|s| s.q_rad.iter().zip(&s.command_rad).all(|(q, u)| (q - u).abs() < 1e-9))
    });
    let finding =
        Finding { check: Check::Steps, t_s: 0.0, axis: None, value: f64::NAN, limit: 0.0, bodies: None };
    report.require(orderly && window && at_rest && plan.period_s > 0.0, finding);
}

fn rates(plan: &FollowPlan, limits: &Limits, joints: &[Axes], commands: &[Axes], report: &mut Report) {
    // The robot rests before the first and after the last step.
    let (a, b) = (commands[0], commands[commands.len() - 1]);
    let padded: Vec<Axes> = [a; 3].into_iter().chain(commands.iter().copied()).chain([b; 3]).collect();
    let divide =
        |from: &[Axes]| -> Vec<Axes> { from.windows(2).map(|w| (w[1] - w[0]) / plan.period_s).collect() };
    let speed = divide(&padded);
    let acceleration = divide(&speed);
    let jerk = divide(&acceleration);
    for (check, values, most) in [
        (Check::Speed, &speed, &limits.v_max_rad_s),
        (Check::Acceleration, &acceleration, &limits.a_max_rad_s2),
        (Check::Jerk, &jerk, &limits.j_max_rad_s3),
    ] {
        for (k, value) in values.iter().enumerate() {
            for i in 0..AXES {
                report.at_most(check, (k as f64 - 3.0) * plan.period_s, Some(i + 1), value[i].abs(), most[i]);
            }
        }
    }
    // Commands may lead by the lag; the arm itself may not leave its range.
    for (k, q) in joints.iter().enumerate() {
        for i in 0..AXES {
            let middle = 0.5 * (limits.q_max_rad[i] + limits.q_min_rad[i]);
            let half = 0.5 * (limits.q_max_rad[i] - limits.q_min_rad[i]);
            let t_s = k as f64 * plan.period_s;
            report.at_most(Check::Range, t_s, Some(i + 1), (q[i] - middle).abs(), half);
        }
    }
}

/// Speeds are computed from angles of 1 rad in steps of 12 ms.
const SPEED_ROUNDING_RAD_S: f64 = 1e-9;

/// The speeds that the steps state are those of the angles.
///
/// An acceleration that leaps by `a` at a step moves the central difference by `a h / 4` from the speed at the step, and shows in
/// the third differences as a jerk of `a / (2 h)`. Any other acceleration with the same jerk moves it less. So the two speeds differ by
/// at most `j h² / 2`, with the jerk of the angles around.
fn stated_speeds(plan: &FollowPlan, joints: &[Axes], report: &mut Report) {
    let h = plan.period_s;
    // The robot rests before the first and after the last step.
    let at = |k: usize, by: isize| joints[k.saturating_add_signed(by).min(joints.len() - 1)];
    for (k, step) in plan.steps.iter().enumerate() {
        let by_angles = (at(k, 1) - at(k, -1)) / (2.0 * h);
        let apart = (Axes::from(step.qd_rad_s) - by_angles).abs();
        let third = |by: isize| (at(k, by + 1) - (at(k, by) - at(k, by - 1)) * 3.0 - at(k, by - 2)).abs() / h;
        let most = third(0).sup(&third(1)) * 0.5;
        for i in 0..AXES {
            report.at_most(
                Check::StatedSpeed,
                step.t_s,
                Some(i + 1),
                apart[i],
                most[i] + SPEED_ROUNDING_RAD_S,
            );
        }
    }
}

/// A robot clamps commands that its program does not accept, and does not report it.
fn passed_commands(plan: &FollowPlan, passed: &CommandRange, report: &mut Report) {
    for step in &plan.steps {
        for (i, value) in step.command_rad.into_iter().enumerate() {
            let (low, high) = (passed.min_rad[i], passed.max_rad[i]);
            let limit = if value < low { low } else { high };
            let (check, axis) = (Check::Commands, Some(i + 1));
            let finding = Finding { check, t_s: step.t_s, axis, value, limit, bodies: None };
            // NaN fails.
            report.require(value >= low - ROUNDING && value <= high + ROUNDING, finding);
        }
    }
}

/// What the lag makes of the commands at a step.
struct Executed {
    q: Axes,
    qd: Axes,
}

/// Largest difference of executed and planned angles that straight lines between set points explain, in rad.
const LAG_MAX_RAD: f64 = 2e-3;

/// A first-order lag behind set points that are joined by straight lines, solved exactly from step to step.
fn lag(plan: &FollowPlan, joints: &[Axes], commands: &[Axes], report: &mut Report) -> Vec<Executed> {
    let mut executed = joints[0];
    let mut out = vec![Executed { q: executed, qd: Axes::zeros(AXES) }];
    let (h, lag_s) = (plan.period_s, plan.lag_s);
    for k in 1..joints.len() {
        let before = executed;
        executed = if lag_s > 0.0 {
            let slope = (commands[k] - commands[k - 1]) / h;
            // x' = (u - x) / T with u = u0 + s t: x = u - T s + c e^(-t/T).
            let rest = executed - commands[k - 1] + slope * lag_s;
            commands[k] - slope * lag_s + rest * (-h / lag_s).exp()
        } else {
            commands[k]
        };
        let qd = if lag_s > 0.0 { (commands[k] - executed) / lag_s } else { (executed - before) / h };
        out.push(Executed { q: executed, qd });
        let apart = (executed - joints[k]).abs();
        report.at_most(Check::Lag, k as f64 * h, Some(apart.imax() + 1), apart.amax(), LAG_MAX_RAD);
    }
    out
}

/// Largest distance from the target of a ball released at a followed step by the executed motion; without lag the
/// planned one.
fn executed_landing_m(arm: &Arm, plan: &FollowPlan, chain: &Chain, executed: &[Executed]) -> f64 {
    if plan.lag_s <= 0.0 {
        return 0.0;
    }
    let target = plan.aim();
    let of = |state: &Executed| {
        let [p, v] = ball_with_velocity(arm, chain, &state.q, &state.qd);
        landing_m(&p, &v, &target, arm.world().gravity_m_s2)
    };
    executed[plan.window[0]..=plan.window[1]].iter().map(of).fold(0.0, f64::max)
}

/// Position of the ball in m and its velocity in m/s, in the hand of an arm that moves.
fn ball_with_velocity(arm: &Arm, chain: &Chain, q: &Axes, qd: &Axes) -> [Vector3<f64>; 2] {
    let small_s = 1e-5;
    let [before, at, after] = [-small_s, 0.0, small_s].map(|t| Links::at(arm, chain, &(q + qd * t)).ball.pos);
    [at, (after - before) / (2.0 * small_s)]
}

/// Frames of all links for one configuration.
struct Links {
    links: [Pose; AXES],
    ball: Pose,
    flange: Vector3<f64>,
}

impl Links {
    fn at(arm: &Arm, chain: &Chain, q: &Axes) -> Self {
        let moved = chain.displacements(q);
        let links: [Pose; AXES] = std::array::from_fn(|i| chain.link(&moved, i));
        let hand = links[AXES - 1] * *arm.end_effector();
        Self { links, ball: hand * arm.gripper().x_eb, flange: hand.pos }
    }
}

fn on_the_flight(arm: &Arm, plan: &FollowPlan, chain: &Chain, poses: &[Links], report: &mut Report) {
    let [first, last] = plan.window;
    let (h, g) = (plan.period_s, arm.world().gravity_m_s2);
    let (p0, v0) = (Vector3::from(plan.flight.p0_m), Vector3::from(plan.flight.v0_m_s));
    let target = plan.aim();
    let tilt_max_rad = match plan.form {
        // A hand that does not turn with the flight is across it only at the release.
        Form::Paper | Form::Best(HandFreedom::Constant | HandFreedom::Roll) => None,
        Form::Best(HandFreedom::Tangent | HandFreedom::TangentAndRoll) => Some(0.0),
        Form::Best(HandFreedom::Tilted(most_rad)) => Some(most_rad),
    };
    let stated: Vec<Vector3<f64>> = plan.steps[first..=last]
        .iter()
        .map(|step| ball_with_velocity(arm, chain, &step.q_rad.into(), &step.qd_rad_s.into())[1])
        .collect();
    // A single point has no neighbour on the parabola: its velocity is the stated one.
    let velocity = |k: usize| if first == last { stated[0] } else { velocity(poses, k, first, h, g) };
    if tilt_max_rad.is_none() {
        across_once(poses, plan, velocity, report);
    }
    for k in first..=last {
        let (t, t_s) = ((k - first) as f64 * h, k as f64 * h);
        let on = p0 + v0 * t - Vector3::z() * (0.5 * g * t * t);
        let off_m = (poses[k].ball.pos - on).norm();
        report.off_parabola_m = report.off_parabola_m.max(off_m);
        report.at_most(Check::Parabola, t_s, None, off_m, OFF_PARABOLA_MAX_M);
        let v = velocity(k);
        for v in [v, stated[k - first]] {
            let landing_m = landing_m(&poses[k].ball.pos, &v, &target, g);
            report.landing_m = report.landing_m.max(landing_m);
            report.at_most(Check::Landing, t_s, None, landing_m, LANDING_MAX_M);
        }
        let z: Vector3<f64> = poses[k].ball.rot.column(2).into();
        if let Some(most_rad) = tilt_max_rad {
            let off_rad = z.angle(&v);
            report.at_most(Check::Across, t_s, None, off_rad, most_rad + ACROSS_MAX_RAD);
        }
        if plan.form == Form::Paper {
            let turned_rad =
                (poses[k].ball.rot * poses[first].ball.rot.transpose()).trace().mul_add(0.5, -0.5);
            report.at_most(Check::Across, t_s, None, turned_rad.clamp(-1.0, 1.0).acos(), ACROSS_MAX_RAD);
        }
    }
}

/// A hand that does not turn with the flight is across it at one instant of the window, the release: at a step (the paper), or in
/// the middle of the window, which may lie between two steps.
fn across_once(
    poses: &[Links],
    plan: &FollowPlan,
    velocity: impl Fn(usize) -> Vector3<f64>,
    report: &mut Report,
) {
    let ([first, last], h) = (plan.window, plan.period_s);
    let z = |k: usize| -> Vector3<f64> { poses[k].ball.rot.column(2).into() };
    let at_steps = (first..=last).map(|k| (k as f64, z(k).angle(&velocity(k))));
    // Between two steps the difference of positions is the velocity in the middle; the hand turns about it at most.
    let between = (first..last).map(|k| {
        let v = (poses[k + 1].ball.pos - poses[k].ball.pos) / h;
        (k as f64 + 0.5, (z(k) + z(k + 1)).angle(&v))
    });
    let nearest = at_steps.chain(between).min_by(|a, b| a.1.total_cmp(&b.1));
    if let Some((step, off_rad)) = nearest {
        report.at_most(Check::Across, step * h, None, off_rad, ACROSS_MAX_RAD);
    }
}

/// Velocity of the ball at step `k` of a window that begins with `first` and has more than one step. Differences of positions
/// within the window are exact for a parabola.
fn velocity(poses: &[Links], k: usize, first: usize, h: f64, g: f64) -> Vector3<f64> {
    let p = |k: usize| poses[k].ball.pos;
    let fall = Vector3::z() * (0.5 * g * h);
    if k > first { (p(k) - p(k - 1)) / h - fall } else { (p(k + 1) - p(k)) / h + fall }
}

/// Horizontal distance from the target at its height, on the way down.
fn landing_m(p: &Vector3<f64>, v: &Vector3<f64>, target: &Vector3<f64>, g: f64) -> f64 {
    let root = (v.z * v.z + 2.0 * g * (p.z - target.z)).sqrt();
    // A flight that stays below the target gives NaN, which fails. A flight that meets the target while rising counts.
    let miss = |t: f64| (p + v * t - target).xy().norm();
    miss((v.z + root) / g).min(miss((v.z - root) / g))
}

fn bodies(arm: &Arm, plan: &FollowPlan, chain: &Chain, joints: &[Axes], report: &mut Report) {
    let (h, last) = (plan.period_s, plan.window[1]);
    let floor_z_m = arm.world().floor_z_m;
    let landing_s = plan.flight.landing_time_s;
    let end = joints.len() - 1;
    let places = (end * PLACES).max((landing_s / h * PLACES as f64).ceil() as usize);
    let grip_m = ball_m(arm, &Links::at(arm, chain, &joints[0]), None).0;
    for place in 0..=places {
        let step = place as f64 / PLACES as f64;
        let t_s = step * h;
        let k = (step.floor() as usize).min(end);
        let next = (k + 1).min(end);
        let links =
            Links::at(arm, chain, &(joints[k] + (joints[next] - joints[k]) * (step - k as f64).min(1.0)));
        if step <= end as f64 {
            let height_m = links.flange.z.min(links.links[2].pos.z).min(links.ball.pos.z) - floor_z_m;
            let finding = Finding {
                check: Check::Floor,
                t_s,
                axis: None,
                value: height_m,
                limit: plan.margins.floor_m,
                bodies: None,
            };
            report.require(height_m >= plan.margins.floor_m - 1e-3, finding);
            pairs(arm, &links, step <= last as f64, t_s, report);
        }
        let flown_s = t_s - last as f64 * h;
        if flown_s > 0.0 && t_s <= landing_s {
            let t = t_s - plan.window[0] as f64 * h;
            let center = Vector3::from(plan.flight.p0_m) + Vector3::from(plan.flight.v0_m_s) * t
                - Vector3::z() * (0.5 * arm.world().gravity_m_s2 * t * t);
            let (distance_m, body) = ball_m(arm, &links, Some(center));
            report.ball_m = report.ball_m.min(distance_m);
            let limit = grip_m - plan.margins.grip_slack_m;
            let finding = Finding {
                check: Check::Ball,
                t_s,
                axis: None,
                value: distance_m,
                limit,
                bodies: Some(["ball".to_owned(), body]),
            };
            report.require(distance_m >= limit - 1e-6, finding);
        }
    }
}

fn frame(links: &Links, link: usize) -> Pose {
    link.checked_sub(1).map_or_else(Pose::identity, |i| links.links[i])
}

/// Distances of all pairs that the robot file asks for, of the floor, and of the held ball. Fingers without a ball are as near to
/// the floor as with it.
fn pairs(arm: &Arm, links: &Links, held: bool, t_s: f64, report: &mut Report) {
    let model = arm.collision();
    let (rule, floor_z_m) = (model.rule(), arm.world().floor_z_m);
    let radius_m = arm.gripper().ball_radius_m;
    let placed: Vec<Pose> = model.boxes().iter().map(|b| frame(links, b.link) * b.x_lb).collect();
    let mut test = |distance_m: f64, a: &str, b: &str| {
        report.nearest_m = report.nearest_m.min(distance_m);
        let bodies = Some([a.to_owned(), b.to_owned()]);
        let finding = Finding { check: Check::Boxes, t_s, axis: None, value: distance_m, limit: 0.0, bodies };
        report.require(distance_m > 0.0, finding);
    };
    for (i, a) in model.boxes().iter().enumerate() {
        if a.link >= rule.floor_from_link {
            test(boxes::lowest_m(&placed[i], &a.half_m) - floor_z_m, &a.name, "floor");
        }
        for (j, b) in model.boxes().iter().enumerate().skip(i + 1) {
            // Far apart by the spheres around them: no need to measure.
            let gap_m = (placed[i].pos - placed[j].pos).norm() - a.half_m.norm() - b.half_m.norm();
            if rule.tests(a.link, b.link) && gap_m <= 0.0 {
                test(boxes::distance_m(&placed[i], &a.half_m, &placed[j], &b.half_m), &a.name, &b.name);
            }
        }
        if held && a.link + 1 < AXES {
            let distance_m = boxes::point_distance_m(&placed[i], &a.half_m, &links.ball.pos) - radius_m;
            test(distance_m, &a.name, "ball");
        }
    }
    test(links.ball.pos.z - radius_m - floor_z_m, if held { "ball" } else { "fingers" }, "floor");
}

/// Distance of the ball at `center` (the grip where `None`) from the nearest box, with its name.
fn ball_m(arm: &Arm, links: &Links, center: Option<Vector3<f64>>) -> (f64, String) {
    let center = center.unwrap_or(links.ball.pos);
    let radius_m = arm.gripper().ball_radius_m;
    let near = arm.collision().boxes().iter().map(|b| {
        let x = frame(links, b.link) * b.x_lb;
        (boxes::point_distance_m(&x, &b.half_m, &center) - radius_m, &b.name)
    });
    near.min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or((f64::INFINITY, String::new()), |(d, name)| (d, name.clone()))
}
