//! One pass over a plan file on a dense grid.

use nalgebra::Vector3;
use robot_model::{Pose, RobotModel};

use super::ball::{self, Ball, Met};
use super::boxes::{distance_m, lowest_m, point_distance_m};
use super::chain::Chain;
use super::finding::Finding;
use super::target::Plane;
use super::{forces, motion};
use crate::plan::file::PlanFile;
use crate::plan::scan::RELEASE_BLIND_S;

/// Distance of grid points in s.
const STEP_S: f64 = 1e-3;
/// Relative overshoot of a limit that counts as kept.
const SHARE_TOLERANCE: f64 = 1e-6;
/// Overshoot of a joint range that counts as kept, in rad.
const RANGE_TOLERANCE_RAD: f64 = 1e-6;
/// Delay of the central difference, and slope that counts as zero in m/s (mm per ms).
const SLOPE_DELAY_S: f64 = 1e-3;
const SLOPE_TOLERANCE_M_S: f64 = 0.01;
/// Shortfall of a clearance that counts as kept, in m; bodies that touch never pass.
const CLEARANCE_TOLERANCE_M: f64 = 2e-4;
/// The same for the released ball and the hand.
const HAND_TOLERANCE_M: f64 = 5e-6;
/// Time before and after the passage of an opening in which the rim is looked at, in s.
const RIM_WINDOW_S: f64 = 0.3;
/// Overshoot of an angle of incidence that counts as kept, in rad.
const INCIDENCE_TOLERANCE_RAD: f64 = 1e-4;
/// Miss that counts as a hit, in m.
const LANDING_TOLERANCE_M: f64 = 1e-4;
/// Difference between a stated and a computed value that counts as zero: s, m, m/s, rad, rad/s, rad/s².
const TOLD_TOLERANCE: f64 = 1e-4;

/// How findings about the clearance of the released ball begin.
pub const RELEASED_BALL: &str = "released ball ";

/// Everything that was checked.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Report {
    /// In order.
    pub findings: Vec<Finding>,
    /// Grid points.
    pub samples: usize,
}

impl Report {
    /// Whether everything the plan claims holds.
    #[must_use]
    pub fn ok(&self) -> bool {
        self.findings.iter().all(|f| f.ok || !f.enforced)
    }
}

/// The largest value seen, where and when.
#[derive(Clone)]
struct Worst {
    value: f64,
    at_s: f64,
    what: String,
}

impl Worst {
    fn new() -> Self {
        Self { value: f64::NEG_INFINITY, at_s: 0.0, what: String::new() }
    }

    fn see(&mut self, value: f64, at_s: f64, what: impl FnOnce() -> String) {
        // NaN must not pass for the best value.
        if value > self.value || value.is_nan() {
            *self = Self { value: if value.is_nan() { f64::INFINITY } else { value }, at_s, what: what() };
        }
    }

    fn finding(&self, what: &str, limit: f64, unit: &str, enforced: bool) -> Finding {
        Finding {
            what: what.to_owned(),
            ok: self.value <= limit,
            worst: if self.what.is_empty() {
                "nothing to check".to_owned()
            } else {
                format!("{:.4} {unit} ({})", self.value, self.what)
            },
            at_s: Some(self.at_s),
            enforced,
        }
    }
}

/// What is looked at over the whole motion.
struct Watched {
    range: Worst,
    speed: Worst,
    acceleration: Worst,
    jerk: Worst,
    /// Distances with the sign turned: of the arm to itself, its base and the held ball.
    near: Worst,
    /// The same to the floor.
    floor: Worst,
    /// The same to the obstacles.
    obstacle: Worst,
}

impl Watched {
    fn new() -> Self {
        Self {
            range: Worst::new(),
            speed: Worst::new(),
            acceleration: Worst::new(),
            jerk: Worst::new(),
            near: Worst::new(),
            floor: Worst::new(),
            obstacle: Worst::new(),
        }
    }

    /// Joints at a time of the plan.
    fn see_joints(&mut self, arm: &RobotModel, plan: &PlanFile, t: f64) {
        let s = motion::at(plan, t);
        for (j, joint) in arm.joints().iter().enumerate() {
            let l = &joint.limits;
            let name = || joint.name.clone();
            self.range.see((l.q_min_rad - s.q[j]).max(s.q[j] - l.q_max_rad), t, name);
            self.speed.see(s.qd[j].abs() / l.v_max_rad_s, t, name);
            self.acceleration.see(s.qdd[j].abs() / l.a_max_rad_s2, t, name);
            self.jerk.see(s.jerk[j].abs() / l.j_max_rad_s3, t, name);
        }
    }

    /// Boxes of the arm, where they are `placed`.
    fn see_boxes(&mut self, arm: &RobotModel, obstacles: &Obstacles<'_>, placed: &[Pose], t: f64) {
        let boxes = arm.collision().boxes();
        for &(a, b) in arm.collision().pairs() {
            let (a, b) = (usize::from(a), usize::from(b));
            let gap =
                (placed[a].pos - placed[b].pos).norm() - boxes[a].half_m.norm() - boxes[b].half_m.norm();
            let distance = if gap > 0.1 {
                gap
            } else {
                distance_m(&placed[a], &boxes[a].half_m, &placed[b], &boxes[b].half_m)
            };
            self.near.see(-distance, t, || format!("\"{}\" and \"{}\"", boxes[a].name, boxes[b].name));
        }
        let from_link = arm.collision().rule().floor_from_link;
        for (k, body) in boxes.iter().enumerate() {
            if body.link >= from_link {
                let below_m = arm.world().floor_z_m - lowest_m(&placed[k], &body.half_m);
                self.floor.see(below_m, t, || body.name.clone());
            }
            if body.link > 0 {
                obstacles.see_box(&placed[k], &body.half_m, &body.name, t, &mut self.obstacle);
            }
        }
    }

    /// The ball in the hand, at `p`.
    fn see_held_ball(
        &mut self,
        arm: &RobotModel,
        obstacles: &Obstacles<'_>,
        placed: &[Pose],
        p: &Vector3<f64>,
        t: f64,
    ) {
        let radius_m = arm.gripper().ball_radius_m;
        obstacles.see_ball(p, radius_m, "held ball", t, &mut self.obstacle);
        for (k, body) in arm.collision().boxes().iter().enumerate().filter(|(_, b)| b.link + 2 <= arm.n()) {
            let distance = point_distance_m(&placed[k], &body.half_m, p) - radius_m;
            self.near.see(-distance, t, || format!("held ball and \"{}\"", body.name));
        }
        self.floor.see(arm.world().floor_z_m - p.z + radius_m, t, || "held ball".to_owned());
    }
}

/// Checks a plan for an arm.
#[must_use]
pub fn check(arm: &RobotModel, plan: &PlanFile) -> Report {
    let chain = Chain::new(arm);
    let steps = (plan.end_time_s / STEP_S).ceil().max(1.0) as usize;
    let obstacles = Obstacles::new(plan);
    let boxes = arm.collision().boxes();
    let place = |t: f64| -> (Vec<Pose>, Pose) {
        let d = chain.displacements(&motion::at(plan, t).q);
        let placed = boxes
            .iter()
            .map(|b| b.link.checked_sub(1).map_or(b.x_lb, |i| chain.link(&d, i) * b.x_lb))
            .collect();
        (placed, chain.link(&d, arm.n() - 1) * *arm.end_effector() * arm.gripper().x_eb)
    };
    let mut watched = Watched::new();
    for step in 0..=steps {
        let t = (step as f64 * plan.end_time_s / steps as f64).min(plan.end_time_s);
        watched.see_joints(arm, plan, t);
        let (placed, ball) = place(t);
        watched.see_boxes(arm, &obstacles, &placed, t);
        if t <= plan.release_time_s {
            watched.see_held_ball(arm, &obstacles, &placed, &ball.pos, t);
        }
    }

    // The release: position of the ball by the chain, its velocity by differences in time.
    let release = |t: f64| {
        let ball = |t: f64| place(t).1.pos;
        let dt = 1e-5;
        (ball(t), (ball(t + dt) - ball(t - dt)) / (2.0 * dt))
    };
    let (p, v) = release(plan.release_time_s);
    let flown = flight(arm, plan, &place, &obstacles, &p, &v);

    let mut findings = motion_findings(arm, &chain, plan, &watched);
    findings.extend(flight_findings(plan, &watched, &flown));
    findings.extend(opening(arm.gripper().ball_radius_m, plan, &flown));
    findings.extend(delays(plan, &release));
    let reported = reported(plan, [p, v], flown.landed.as_ref());
    // The rest is computed from the release: where that is false, nothing more is learned.
    let lie = if reported.ok { plan.false_claim(arm) } else { None };
    findings.push(reported);
    let text = lie.clone().unwrap_or_else(|| "all of them".to_owned());
    findings.push(Finding::claimed("numbers of the file are those of its motion", lie.is_none(), text));
    Report { findings, samples: steps + 1 }
}

/// The release and the landing that the file states, compared with those of its motion: programs read them without the motion.
fn reported(plan: &PlanFile, [p, v]: [Vector3<f64>; 2], landed: Option<&Met>) -> Finding {
    let (release, landing) = (&plan.release, &plan.landing);
    let moved = motion::at(plan, plan.release_time_s);
    let mut worst = Worst::new();
    let mut compare = |what: &str, at_s: f64, tolerance: f64, reported: &[f64], found: &[f64]| {
        for (k, found) in found.iter().enumerate() {
            let reported = reported.get(k).copied().unwrap_or(f64::NAN);
            worst.see((reported - found).abs() / tolerance, at_s, || {
                format!("{what} {}: {reported:.6}, not {found:.6}", k + 1)
            });
        }
    };
    let at_s = plan.release_time_s;
    compare("angle at the release, joint", at_s, TOLD_TOLERANCE, &release.q_rad, &moved.q);
    compare("speed at the release, joint", at_s, TOLD_TOLERANCE, &release.qd_rad_s, &moved.qd);
    compare("acceleration at the release, joint", at_s, TOLD_TOLERANCE, &release.qdd_rad_s2, &moved.qdd);
    compare("ball at the release, axis", at_s, TOLD_TOLERANCE, &release.position_m, p.as_slice());
    compare(
        "velocity of the ball at the release, axis",
        at_s,
        TOLD_TOLERANCE,
        &release.velocity_m_s,
        v.as_slice(),
    );
    if let Some(met) = landed {
        let at_s = at_s + met.s;
        compare("time of flight,", at_s, TOLD_TOLERANCE, &[landing.flight_s], &[met.s]);
        compare("landing, axis", at_s, TOLD_TOLERANCE, &landing.position_m, met.p.as_slice());
        compare(
            "velocity at the landing, axis",
            at_s,
            TOLD_TOLERANCE,
            &landing.velocity_m_s,
            met.v.as_slice(),
        );
    }
    worst.finding("stated release and landing are those of the motion", 1.0, "of the tolerance", true)
}

/// Limits of the joints, joins of the segments, clearances of the arm, currents.
fn motion_findings(arm: &RobotModel, chain: &Chain, plan: &PlanFile, watched: &Watched) -> Vec<Finding> {
    let (mut jump, mut motor, mut supply) = (Worst::new(), Worst::new(), Worst::new());
    segments_meet(plan, &mut jump);
    currents(arm, chain, plan, &mut motor, &mut supply);
    let (clearance_m, clear) = (plan.search.clearance_m, plan.claims("clearance of arm"));
    // The part of the limits that the plan states it uses.
    let part = |used: f64| used + SHARE_TOLERANCE;
    let over_motion = plan.claims("currents over the motion");
    vec![
        watched.range.finding("joint ranges", RANGE_TOLERANCE_RAD, "rad beyond", true),
        watched.speed.finding("joint speeds", part(plan.search.speed_use), "of the limit", true),
        watched.acceleration.finding(
            "joint accelerations",
            part(plan.search.acceleration_use),
            "of the limit",
            true,
        ),
        watched.jerk.finding("joint jerks", 1.0 + SHARE_TOLERANCE, "of the limit", true),
        jump.finding(
            "segments meet in position, speed and acceleration; rest at both ends",
            1e-6,
            "rad, rad/s or rad/s²",
            true,
        ),
        clear_finding("arm clear of itself, its base and the held ball", &watched.near, clearance_m, clear),
        clear_finding("clear of the floor", &watched.floor, clearance_m, clear),
        motor.finding("motor currents over the motion", 1.0 + 2e-3, "of the limit", over_motion),
        supply.finding("supply currents over the motion", 1.0 + 2e-3, "of the limit", over_motion),
    ]
}

/// Landing and clearances of the released ball; and the obstacles, if there are any.
fn flight_findings(plan: &PlanFile, watched: &Watched, flown: &Flown) -> Vec<Finding> {
    let clearance_m = plan.search.clearance_m;
    let clear = plan.claims("clearance of the released ball");
    let mut findings = vec![
        Finding::claimed(
            "landing on the target",
            flown.miss_m.is_some_and(|m| m <= LANDING_TOLERANCE_M),
            flown.miss_m.map_or_else(
                || "the ball does not come down there".to_owned(),
                |m| format!("{m:.2e} m beside it"),
            ),
        ),
        hand_finding(&flown.hand, plan.search.hand_clearance_m, clear),
        clear_finding(&format!("{RELEASED_BALL}clear of the arm"), &flown.others, clearance_m, clear),
    ];
    if !plan.obstacles.is_empty() {
        let arm_clear = plan.claims("clearance of arm");
        findings.extend([
            clear_finding(
                "arm and held ball clear of the obstacles",
                &watched.obstacle,
                clearance_m,
                arm_clear,
            ),
            clear_finding(
                &format!("{RELEASED_BALL}clear of the obstacles"),
                &flown.obstacles,
                clearance_m,
                clear,
            ),
        ]);
    }
    findings
}

/// Whether bodies keep a clearance; `near` has seen their distances with the sign turned.
fn clear_finding(what: &str, near: &Worst, wanted_m: f64, enforced: bool) -> Finding {
    let of = if wanted_m > 0.0 { format!(" of {:.1} mm", wanted_m * 1e3) } else { String::new() };
    let least_m = (wanted_m - CLEARANCE_TOLERANCE_M).max(0.0);
    near_finding(what, near, &format!("{:.1} mm{of}", -near.value * 1e3), least_m, enforced)
}

/// The ball leaves the hand slowly: its clearance from it is small, and so is the tolerance.
fn hand_finding(near: &Worst, wanted_m: f64, enforced: bool) -> Finding {
    let of = if wanted_m > 0.0 { format!(" of {:.2} mm", wanted_m * 1e3) } else { String::new() };
    let least_m = (wanted_m - HAND_TOLERANCE_M).max(0.0);
    let reported = format!("{:.2} mm{of}", -near.value * 1e3);
    near_finding(&format!("{RELEASED_BALL}free of the hand"), near, &reported, least_m, enforced)
}

fn near_finding(what: &str, near: &Worst, reported: &str, least_m: f64, enforced: bool) -> Finding {
    let worst = if near.what.is_empty() {
        "nothing to check".to_owned()
    } else {
        format!("{reported} ({})", near.what)
    };
    Finding { what: what.to_owned(), ok: -near.value > least_m, worst, at_s: Some(near.at_s), enforced }
}

fn segments_meet(plan: &PlanFile, jump: &mut Worst) {
    let eps = 1e-9;
    let last = plan.motion.knots.len().saturating_sub(1);
    for (j, name) in plan.motion.joints.iter().enumerate() {
        for knot in plan.motion.knots.get(1..last).unwrap_or_default() {
            let t = knot.t_s;
            let (a, b) = (motion::at(plan, t), motion::at(plan, t + eps));
            let what = || name.clone();
            jump.see((a.q[j] - b.q[j]).abs() - 10.0 * eps, t, what);
            jump.see((a.qd[j] - b.qd[j]).abs() - 100.0 * eps, t, what);
            jump.see((a.qdd[j] - b.qdd[j]).abs() - 1e3 * eps, t, what);
        }
        for t in [0.0, plan.end_time_s] {
            jump.see(motion::at(plan, t).qd[j].abs(), t, || format!("{name} at rest"));
        }
    }
}

fn currents(arm: &RobotModel, chain: &Chain, plan: &PlanFile, motor: &mut Worst, supply: &mut Worst) {
    let Some(drives) = arm.drives() else { return };
    let keep_off = 3e-4;
    let samples = 200;
    for i in 0..=samples {
        let t = plan.end_time_s * f64::from(i) / f64::from(samples);
        let mut t = t.clamp(keep_off, plan.end_time_s - keep_off);
        if (t - plan.release_time_s).abs() < keep_off {
            t = plan.release_time_s - keep_off;
        }
        let s = motion::at(plan, t);
        let tau = forces::torques(arm, chain, plan, t);
        let Some(amps) = forces::motor_currents(arm, &s.qd, &tau) else { return };
        for j in 0..arm.n() {
            motor.see(amps[j] / drives[j].current_max_a, t, || arm.joints()[j].name.clone());
        }
        for s in arm.supplies() {
            let sum: f64 = (0..arm.n()).filter(|j| s.feeds[*j]).map(|j| amps[j]).sum();
            supply.see(sum / s.current_max_a, t, || s.name.clone());
        }
    }
}

/// The obstacles of a plan.
struct Obstacles<'p>(Vec<(&'p str, Pose, Vector3<f64>)>);

impl<'p> Obstacles<'p> {
    fn new(plan: &'p PlanFile) -> Self {
        Self(plan.obstacles.iter().map(|o| (o.name.as_str(), o.pose(), Vector3::from(o.half_m))).collect())
    }

    fn see_box(&self, x: &Pose, half_m: &Vector3<f64>, what: &str, t: f64, worst: &mut Worst) {
        for (name, pose, half_o_m) in &self.0 {
            let distance = distance_m(x, half_m, pose, half_o_m);
            worst.see(-distance, t, || format!("\"{what}\" and obstacle \"{name}\""));
        }
    }

    fn see_ball(&self, p: &Vector3<f64>, radius_m: f64, what: &str, t: f64, worst: &mut Worst) {
        for (name, pose, half_m) in &self.0 {
            let distance = point_distance_m(pose, half_m, p) - radius_m;
            worst.see(-distance, t, || format!("{what} and obstacle \"{name}\""));
        }
    }
}

/// The flight as it was seen.
struct Flown {
    /// Distance of the landing from the target; `None` if the ball does not come down there.
    miss_m: Option<f64>,
    /// Where and how it meets the plane of the target.
    landed: Option<Met>,
    /// Nearest box of the hand.
    hand: Worst,
    /// Nearest box of the other links.
    others: Worst,
    /// Nearest obstacle.
    obstacles: Worst,
}

/// Flies the ball.
fn flight(
    arm: &RobotModel,
    plan: &PlanFile,
    place: &dyn Fn(f64) -> (Vec<Pose>, Pose),
    obstacles: &Obstacles<'_>,
    p: &Vector3<f64>,
    v: &Vector3<f64>,
) -> Flown {
    let plane = Plane::new(&plan.target);
    let boxes = arm.collision().boxes();
    let radius_m = arm.gripper().ball_radius_m;
    let (mut hand, mut others, mut obstacle) = (Worst::new(), Worst::new(), Worst::new());
    let landed = Ball::new(&plan.landing).land(p, v, &plane, 0.0, |s, p| {
        let due = ((s / ball::STEP_S).round() as u64).is_multiple_of(10);
        // Steps add up with rounding; the ball is nearest to the hand at the first instant.
        if s > RELEASE_BLIND_S - 0.5 * ball::STEP_S && s <= plan.landing.flight_s && due {
            let t = plan.release_time_s + s;
            let (placed, _) = place(t);
            for (k, body) in boxes.iter().enumerate() {
                let distance = point_distance_m(&placed[k], &body.half_m, p) - radius_m;
                let near = if body.link == arm.n() { &mut hand } else { &mut others };
                near.see(-distance, t, || format!("\"{}\"", body.name));
            }
            // An obstacle that holds the target (a table, a bin) is met at the end of the flight.
            if s < plan.landing.flight_s - RELEASE_BLIND_S {
                obstacles.see_ball(p, radius_m, "ball", t, &mut obstacle);
            }
        }
    });
    let miss_m = landed.map(|at| (at.p - plane.point_m(at.s)).norm());
    Flown { miss_m, landed, hand, others, obstacles: obstacle }
}

/// The passage through the opening: from its side, within its angle, clear of its rim.
fn opening(ball_radius_m: f64, plan: &PlanFile, flown: &Flown) -> Vec<Finding> {
    let Some(opening) = &plan.target.opening else { return Vec::new() };
    let plane = Plane::new(&plan.target);
    let Some(met) = flown.landed.filter(|_| plane.is_sound()) else {
        let why = "the ball does not pass the plane of the opening, or its normal is no unit vector";
        return vec![Finding::claimed("passage through the opening", false, why.to_owned())];
    };
    let approach = met.v - plane.velocity_m_s(met.s);
    let angle = (-plane.normal().dot(&approach) / approach.norm()).clamp(-1.0, 1.0).acos();
    // Steps forwards from the passage, and backwards by flying the ball from where it would have been.
    let ball = Ball::new(&plan.landing);
    let mut least_m = f64::INFINITY;
    let steps = (RIM_WINDOW_S / ball::STEP_S) as usize;
    for direction in [1.0, -1.0] {
        let (mut p, mut v, mut s) = (met.p, met.v, met.s);
        for _ in 0..steps {
            least_m = least_m.min(plane.rim_distance_m(opening.radius_m, &p, s) - ball_radius_m);
            (p, v) = ball.step_by(&p, &v, direction * ball::STEP_S);
            s += direction * ball::STEP_S;
            if s < 0.0 {
                break;
            }
        }
    }
    let wanted_m = plan.search.clearance_m;
    vec![
        Finding::claimed(
            "angle of incidence at the opening",
            angle <= opening.incidence_max_rad + INCIDENCE_TOLERANCE_RAD,
            format!("{:.2} of {:.2} deg", angle.to_degrees(), opening.incidence_max_rad.to_degrees()),
        ),
        Finding::claimed(
            "ball clear of the rim of the opening",
            least_m > (wanted_m - CLEARANCE_TOLERANCE_M).max(0.0),
            format!("{:.1} mm of {:.1} mm", least_m * 1e3, wanted_m * 1e3),
        ),
    ]
}

/// Landings of late and early releases: to first order, and at the delays the plan states.
fn delays(plan: &PlanFile, release: &dyn Fn(f64) -> (Vector3<f64>, Vector3<f64>)) -> Vec<Finding> {
    let plane = Plane::new(&plan.target);
    let ball = Ball::new(&plan.landing);
    let landing = |delay_s: f64| {
        let (p, v) = release(plan.release_time_s + delay_s);
        let at = ball.land(&p, &v, &plane, delay_s, |_, _| {})?;
        // Against the target, wherever it is by then.
        Some(at.p - plane.point_m(delay_s + at.s))
    };
    let slope = landing(SLOPE_DELAY_S)
        .zip(landing(-SLOPE_DELAY_S))
        .map(|(late, early)| (late - early).norm() / (2.0 * SLOPE_DELAY_S));
    let mut findings = vec![Finding {
        what: "landing unmoved by a late release, to first order".to_owned(),
        ok: slope.is_some_and(|s| s <= SLOPE_TOLERANCE_M_S),
        worst: slope
            .map_or_else(|| "the ball does not come down".to_owned(), |s| format!("{s:.4} mm per ms")),
        at_s: None,
        enforced: plan.claims("unmoved by a late release"),
    }];
    let on_time = landing(0.0);
    for shift in &plan.landing.delay_shifts {
        let worst = landing(shift.delay_s)
            .zip(landing(-shift.delay_s))
            .zip(on_time)
            .map(|((late, early), on_time)| (late - on_time).norm().max((early - on_time).norm()));
        findings.push(Finding {
            what: format!("shift of the landing over ±{:.0} ms of release time", shift.delay_s * 1e3),
            ok: worst.is_some_and(|w| w <= shift.limit_m.unwrap_or(f64::INFINITY)),
            worst: worst.map_or_else(
                || "the ball does not come down".to_owned(),
                |w| {
                    let limit = shift.limit_m.map_or_else(String::new, |l| format!(" of {:.1} mm", l * 1e3));
                    format!("{:.2} mm{limit}", w * 1e3)
                },
            ),
            at_s: None,
            enforced: shift.limit_m.is_some(),
        });
    }
    findings
}
