//! What the picture in space shows: the arm over time, the path of the ball in the hand, the flight, the target.

use nalgebra::{Matrix2, Vector2, Vector3};
use robot_model::{JointVec, Pose, RobotModel};
use serde::Serialize;

use planner::flight::landing;
use planner::plan::file::PlanFile;

/// Steps of the animation, and of a long one per second and in all.
const STEPS: u32 = 90;
const STEPS_PER_S: f64 = 12.0;
const STEPS_MAX: u32 = 400;
/// Points of a flight.
const FLIGHT_STEPS: u32 = 40;

/// Place, m.
pub type Point = [f32; 3];

/// What `assets/scene.js` draws.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Space {
    /// Heights of the floor and of what is to be seen at least, m.
    pub floor: f64,
    pub top: f64,
    /// Of the ball, m.
    pub radius: f64,
    /// Number of the link that is the hand.
    pub last: usize,
    /// Time when the ball leaves, s.
    pub release: Option<f64>,
    /// Time that is shown first, s.
    pub first: Option<f64>,
    /// Names of the target and of the begin of the flight.
    pub names: Option<[&'static str; 2]>,
    pub target: Option<Point>,
    /// Path of what the hand holds, and where the plan has it.
    pub hand: Vec<Point>,
    pub planned: Option<Vec<Point>>,
    pub flight: Vec<Point>,
    /// Spread of the landing.
    pub ellipse: Option<Vec<Point>>,
    /// Of the opening that is to be passed.
    pub rim: Option<Vec<Point>>,
    /// What the picture shows besides.
    pub bounds: Vec<Point>,
    pub boxes: Vec<Body>,
    pub steps: Vec<Step>,
}

/// Corners of a box, in the frame of its link.
#[derive(Clone, Debug, Serialize)]
pub struct Body {
    link: usize,
    corners: Vec<Point>,
}

/// A moment of the animation.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Step {
    /// s.
    pub t: f64,
    pub ball: Option<Point>,
    /// Axis of a disc.
    pub normal: Option<Point>,
    pub links: Vec<[f32; 12]>,
}

/// How the arm moves and where the ball flies.
pub struct SceneMotion<'a> {
    /// Joint angles at a time of the plan, rad.
    pub q_at: &'a dyn Fn(f64) -> JointVec,
    /// When the arm stands, s.
    pub to_s: f64,
    /// Flight of the ball; `None`: it stays in the hand.
    pub flight: Option<Flight<'a>>,
    /// Path that the hand should take, to compare.
    pub planned: Option<Vec<Vector3<f64>>>,
}

/// The ball after it left the hand.
#[derive(Clone, Copy)]
pub struct Flight<'a> {
    /// When it leaves, s.
    pub release_s: f64,
    /// Its position a time after that, m.
    pub ball_after: &'a dyn Fn(f64) -> Vector3<f64>,
    /// Time until it lands, s.
    pub flight_s: f64,
}

impl Flight<'_> {
    fn landing_s(&self) -> f64 {
        self.release_s + self.flight_s
    }

    /// Where the ball is at `t_s`, once it left; it stays where it landed.
    fn ball_at(&self, t_s: f64) -> Option<Vector3<f64>> {
        (t_s > self.release_s).then(|| (self.ball_after)((t_s - self.release_s).min(self.flight_s)))
    }
}

/// Where the ball is to come down.
pub struct Goal {
    pub target_m: Vector3<f64>,
    /// Where it may come down about the target.
    pub spread: Vec<Vector3<f64>>,
    /// Of the opening that it is to pass.
    pub rim: Option<Vec<Vector3<f64>>>,
    /// Bodies of the world besides the base.
    pub bodies: Vec<Body>,
}

impl From<&PlanFile> for Goal {
    fn from(plan: &PlanFile) -> Self {
        let obstacles = plan.obstacles.iter().map(|o| body(0, &o.pose(), &Vector3::from(o.half_m)));
        Self {
            target_m: Vector3::from(plan.meeting_m()),
            spread: ellipse_in_space(plan),
            rim: rim(plan),
            bodies: obstacles.collect(),
        }
    }
}

/// The data; a motion without a goal has no ball.
#[must_use]
pub fn data(arm: &RobotModel, goal: Option<&Goal>, motion: &SceneMotion<'_>) -> Space {
    let last_s = motion.flight.map_or(motion.to_s, |flight| motion.to_s.max(flight.landing_s())) + 0.05;
    let count = ((STEPS_PER_S * last_s) as u32).clamp(STEPS, STEPS_MAX);
    let time = |i: u32| last_s * f64::from(i) / f64::from(count);
    // The release and the landing are points of the animation, whatever its steps.
    let mut times: Vec<f64> = (0..=count).map(time).collect();
    times.extend(motion.flight.iter().flat_map(|flight| [flight.release_s, flight.landing_s()]));
    times.sort_by(f64::total_cmp);
    let mut steps = Vec::new();
    let mut hand = Vec::new();
    for t_s in times {
        let frames = arm.fk(&(motion.q_at)(t_s));
        let held = arm.ball(&frames).pos;
        if t_s <= motion.to_s {
            hand.push(held);
        }
        let ball = goal.map(|_| motion.flight.and_then(|flight| flight.ball_at(t_s)).unwrap_or(held));
        let links = frames.x_w.iter().map(link).collect();
        steps.push(Step { t: t_s, ball: ball.as_ref().map(point), normal: None, links });
    }
    let flown: Vec<_> = motion.flight.map_or_else(Vec::new, |flight| {
        let time = |i: u32| flight.flight_s * f64::from(i) / f64::from(FLIGHT_STEPS);
        (0..=FLIGHT_STEPS).map(|i| (flight.ball_after)(time(i))).collect()
    });
    let joints = steps_top(arm, motion);
    Space {
        floor: arm.world().floor_z_m,
        top: hand.iter().map(|p| p.z).fold(joints, f64::max),
        radius: arm.gripper().ball_radius_m,
        last: arm.joints().len(),
        release: motion.flight.map(|flight| flight.release_s),
        target: goal.map(|goal| point(&goal.target_m)),
        hand: list(&hand),
        planned: motion.planned.as_ref().map(|points| list(points)),
        flight: list(&flown),
        ellipse: goal.map(|goal| list(&goal.spread)),
        rim: goal.and_then(|goal| goal.rim.as_ref()).map(|points| list(points)),
        boxes: bodies(arm).chain(goal.iter().flat_map(|goal| goal.bodies.clone())).collect(),
        steps,
        ..Space::default()
    }
}

/// Number to a tenth of a millimetre: few digits in the file.
fn short(value: &f64) -> f32 {
    ((value * 1e4).round() / 1e4) as f32
}

/// Pose of a link: rotation by rows, then place.
pub(super) fn link(x: &Pose) -> [f32; 12] {
    let mut numbers = [0.0; 12];
    for (to, from) in numbers.iter_mut().zip(x.rot.transpose().iter().chain(x.pos.iter())) {
        *to = short(from);
    }
    numbers
}

pub(super) fn bodies(arm: &RobotModel) -> impl Iterator<Item = Body> {
    arm.collision().boxes().iter().map(|b| body(b.link, &b.x_lb, &b.half_m))
}

/// A box with its corners in the frame of its link.
pub(super) fn body(link: usize, x_lb: &Pose, half_m: &Vector3<f64>) -> Body {
    let corner = |k: u8| {
        let sign = |bit: u8| if k & bit == 0 { -1.0 } else { 1.0 };
        point(&x_lb.transform_point(&Vector3::new(sign(1), sign(2), sign(4)).component_mul(half_m)))
    };
    Body { link, corners: (0..8).map(corner).collect() }
}

/// Height of the highest joint over the motion, m.
fn steps_top(arm: &RobotModel, motion: &SceneMotion<'_>) -> f64 {
    let heights = (0..=20).flat_map(|i| {
        let frames = arm.fk(&(motion.q_at)(motion.to_s * f64::from(i) / 20.0));
        frames.x_w.iter().map(|x| x.pos.z).collect::<Vec<_>>()
    });
    heights.fold(0.0, f64::max) + 0.06
}

/// 2σ ellipse of the predicted landing, in the plane of the target.
fn ellipse_in_space(plan: &PlanFile) -> Vec<Vector3<f64>> {
    let aim = plan.target.aim();
    let moved = Vector3::from(plan.meeting_m()) - Vector3::from(plan.target.position_m);
    ellipse(plan, 2.0).into_iter().map(|(x, y)| aim.place(&Vector2::new(x, y)) + moved).collect()
}

/// Rim of the opening, where the ball meets it; `None` for a target without one.
fn rim(plan: &PlanFile) -> Option<Vec<Vector3<f64>>> {
    let opening = plan.target.opening?;
    let [across, up] = opening.axes.map(Vector3::from);
    let centre = Vector3::from(plan.meeting_m());
    let point = |i: u32| {
        let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 72.0).sin_cos();
        centre + (across * cos + up * sin) * opening.radius_m
    };
    Some((0..72).map(point).collect())
}

/// Ellipse of `sigmas` about the predicted mean, in coordinates on the plane of the target, in m.
#[must_use]
pub fn ellipse(plan: &PlanFile, sigmas: f64) -> Vec<(f64, f64)> {
    let l = &plan.landing;
    let c = &l.covariance_m2;
    let (a, b, angle) = landing::ellipse(&Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]));
    let (sin, cos) = angle.sin_cos();
    (0..72)
        .map(|i| {
            let (s, co) = (f64::from(i) * std::f64::consts::TAU / 72.0).sin_cos();
            let (u, v) = (sigmas * a * co, sigmas * b * s);
            (l.mean_m[0] + u * cos - v * sin, l.mean_m[1] + u * sin + v * cos)
        })
        .collect()
}

pub(super) fn point(p: &Vector3<f64>) -> Point {
    [p.x, p.y, p.z].map(|v| short(&v))
}

pub(super) fn list(points: &[Vector3<f64>]) -> Vec<Point> {
    points.iter().map(point).collect()
}
