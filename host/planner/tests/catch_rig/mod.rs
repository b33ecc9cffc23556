//! An arm, throws at it, and a slow search that judges them by brute force.

use std::fmt;

use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use planner::catch::Joints;
use planner::catch::arm::{CatchArm, Shares};
use planner::catch::cup::{Ball, Contact, Cup};
use planner::catch::draw::{Window, draw};
use planner::catch::forecast::{Forecast, Foreseen, Watch, across};
use planner::catch::motion::{CatchMotion, check};
use planner::catch::rates::Hand;
use planner::catch::search::search;
use planner::catch::task::{Allowed, Decline, Mode, Settings, Start};
use planner::flight::FlightModel;
use planner::motion_law::{Fit, Limits, Pieces, State, least_peak, stopping_angle};
use planner::plan::rng::SplitMix64;
use robot_model::collision::{CollisionChecker, Scene};
use robot_model::{Pose, RobotModel};

pub(crate) const WAIT_DEG: [f64; 6] = [-4.0, -40.0, -173.0, -3.0, -88.0, 0.0];
/// Directions per time of the slow search.
const DIRECTIONS: usize = 400;

fn model() -> RobotModel {
    RobotModel::load("powercube6").unwrap()
}

fn base() -> Pose {
    Pose::from_rpy([0.0, 0.0, std::f64::consts::PI], Vector3::new(2.5, 0.0, 0.0))
}

pub(crate) fn arm(jerk: bool) -> CatchArm {
    let cup = Cup {
        mouth_m: 0.05,
        inner_radius_m: 0.07,
        depth_m: 0.1,
        wall_m: 0.006,
        replaces: vec!["fingers".to_owned()],
        ball: Ball { radius_m: 0.03, inertia: 0.4 },
        contact: Contact { restitution: 0.15, friction: 0.5, rolling: 0.1, rest_m_s: 0.1 },
    };
    CatchArm::new(model(), base(), cup, Shares::default(), jerk).unwrap()
}

fn flight() -> FlightModel {
    FlightModel::vacuum(9.81).unwrap().with_drag(0.0284).unwrap()
}

/// A ball that is known exactly, from `p`, `v` at time zero.
pub(crate) fn forecast(p: Vector3<f64>, v: Vector3<f64>) -> Forecast {
    let points = (0..240).map(|k| {
        let t_s = 0.005 * f64::from(k);
        let (p_m, v_m_s) = flight().coast(&p, &v, t_s);
        Foreseen { t_s, p_m, v_m_s, covariance_m2: Matrix3::identity() * 1e-8 }
    });
    let watch = Watch { sigma_m: 0.002, period_s: 1.0 / 120.0, latency_s: 0.015, first_s: 0.0 };
    Forecast { points: points.collect(), watch }
}

pub(crate) fn throws(count: usize, seed: u64) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let mut rng = SplitMix64::new(seed);
    // A wider window than the arm reaches, so that some balls cannot be caught.
    let window = Window { y_m: 0.6, z_m: (-0.3, 0.9), ..Window::default() };
    let mut one =
        || draw(&model(), &Pose::identity(), &base(), &flight(), &window, &mut rng, 1_000_000).unwrap();
    (0..count).map(|_| one()).map(|aimed| (aimed.p_m, aimed.v_m_s)).collect()
}

/// How much of a catch the slow search asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Asked {
    /// The least peak acceleration only, which no motion can beat.
    Bound,
    /// A motion inside speed, acceleration, jerk and ranges at its ends.
    Motion,
    /// The whole motion: ranges, contacts, currents, the ball against the arm.
    Whole,
}

/// Every 5 ms, 400 directions, all postures: whether a catch exists.
pub(crate) fn exhaustive(
    arm: &CatchArm,
    settings: &Settings,
    mode: Mode,
    from_s: f64,
    forecast: &Forecast,
    asked: Asked,
) -> bool {
    let wait = Joints::from(WAIT_DEG.map(f64::to_radians));
    let limits = arm.limits(false);
    let x_bw = arm.x_wb().inverse();
    let scene = Scene::default();
    let mut checker = CollisionChecker::new(arm.model(), &scene);
    let mut rng = SplitMix64::new(9);
    forecast.points.iter().filter(|ball| ball.t_s > from_s + settings.freeze_s).any(|ball| {
        let u = ball.v_m_s.normalize();
        let (a, _) = across(&u);
        (0..DIRECTIONS).any(|_| {
            let tilt = settings.cone_rad * rng.unit().sqrt();
            let lean = Rotation3::from_axis_angle(&Unit::new_normalize(a), tilt) * -u;
            let axis =
                Rotation3::from_axis_angle(&Unit::new_normalize(u), std::f64::consts::TAU * rng.unit())
                    * lean;
            let (x, y) = across(&axis);
            let rot = x_bw.rot * Matrix3::from_columns(&[x, y, axis]);
            let mouth = x_bw.transform_point(&ball.p_m);
            let ee = Pose::new(rot, mouth - rot.column(2) * arm.cup().mouth_m);
            let left_s = ball.t_s - from_s;
            arm.model().ik(&ee).unwrap().iter().any(|solution| {
                let mut q = solution.q;
                q[5] = wait[5];
                let with_ball = u * (ball.v_m_s.norm() - settings.relative_m_s).max(0.0);
                let into_cup = ball.v_m_s + axis * settings.relative_m_s;
                let hand = Hand::at(arm, limits, &q);
                let rates = match mode {
                    Mode::Hold => [Some(Joints::zeros(6)), None],
                    Mode::Matched => [hand.rates(&with_ball), hand.rates(&into_cup)],
                };
                rates.into_iter().flatten().any(|qd| {
                    if !stops_inside(arm, limits, &q, &qd) {
                        return false;
                    }
                    if asked == Asked::Bound {
                        let peak = |i: usize| least_peak(&State::rest(wait[i]), q[i], qd[i], left_s);
                        return (0..6).all(|i| peak(i) <= limits[i].a_rad_s2);
                    }
                    let fits: Option<Vec<Fit>> = (0..6)
                        .map(|i| arm.law().fit(&limits[i], &State::rest(wait[i]), q[i], qd[i], left_s))
                        .collect();
                    let Some(fits) = fits else { return false };
                    if asked == Asked::Motion {
                        return true;
                    }
                    let joints = std::array::from_fn(|i| {
                        let mut pieces = Pieces::starting(State::rest(wait[i]));
                        arm.law().append(&fits[i], left_s, &mut pieces);
                        arm.law().append_stop(&limits[i], &mut pieces);
                        pieces
                    });
                    let motion = CatchMotion { start_s: from_s, joints };
                    check(arm, &mut checker, &motion, Some((forecast, ball.t_s))).is_ok()
                })
            })
        })
    })
}

fn stops_inside(arm: &CatchArm, limits: &[Limits; 6], q: &Joints, qd: &Joints) -> bool {
    (0..6).all(|i| {
        let limit = &limits[i];
        let inside = |q: f64| q >= limit.q_rad.0 && q <= limit.q_rad.1;
        inside(q[i]) && inside(q[i] + stopping_angle(limit, arm.law().limits_jerk(), qd[i]))
    })
}

pub(crate) fn found(
    arm: &CatchArm,
    settings: &Settings,
    from_s: f64,
    forecast: &Forecast,
) -> Result<Mode, Decline> {
    let state = WAIT_DEG.map(|q| State::rest(q.to_radians()));
    let start = Start { at_s: from_s, state: &state, under_way: None };
    search(arm, settings, &start, forecast).0.map(|choice| choice.mode)
}

/// One refusal of the search, and whether the slow search finds a catch.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Refusal {
    pub throw: usize,
    pub from_s: f64,
    pub mode: Mode,
    pub why: Decline,
    pub wrong: bool,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "throw {}, {:?}, from {} s: {}", self.throw, self.mode, self.from_s, self.why)
    }
}

/// The first `refusals` refusals among drawn throws, each judged with its whole motion; and how many throws were taken.
pub(crate) fn refusals(arm: &CatchArm, refusals: usize, seed: u64) -> (Vec<Refusal>, usize) {
    let (mut all, mut taken) = (Vec::new(), 0);
    for (throw, (p, v)) in throws(refusals, seed).into_iter().enumerate() {
        let forecast = forecast(p, v);
        let from_s = [0.0, 0.07, 0.15][throw % 3];
        for (mode, allowed) in [(Mode::Hold, Allowed::Hold), (Mode::Matched, Allowed::Matched)] {
            if all.len() == refusals {
                break;
            }
            let settings = Settings { allowed, ..Settings::default() };
            match found(arm, &settings, from_s, &forecast) {
                Ok(_) => taken += 1,
                Err(why) => {
                    let wrong = exhaustive(arm, &settings, mode, from_s, &forecast, Asked::Whole);
                    all.push(Refusal { throw, from_s, mode, why, wrong });
                }
            }
        }
    }
    (all, taken)
}
