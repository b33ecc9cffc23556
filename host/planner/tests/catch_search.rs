//! The search for a catch against an exhaustive one, and its limits.

use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use planner::catch::Joints;
use planner::catch::arm::{CatchArm, Cup, Shares};
use planner::catch::draw::{Window, draw};
use planner::catch::forecast::{Forecast, Foreseen, Watch, across};
use planner::catch::law::{State, least_peak, stopping_angle};
use planner::catch::motion::used;
use planner::catch::online::{Catcher, Decision};
use planner::catch::search::{Allowed, Decline, Mode, Settings, Start, joint_rates, search};
use planner::flight::FlightModel;
use planner::plan::rng::SplitMix64;
use robot_model::{AnyRobot, Pose, RobotModel};

const WAIT_DEG: [f64; 6] = [-4.0, -40.0, -173.0, -3.0, -88.0, 0.0];

fn model() -> RobotModel<6> {
    match AnyRobot::load("powercube6").unwrap() {
        AnyRobot::Six(model) => *model,
        other => panic!("{} joints", other.joints()),
    }
}

fn base() -> Pose {
    Pose::from_rpy([0.0, 0.0, std::f64::consts::PI], Vector3::new(2.5, 0.0, 0.0))
}

fn arm(jerk: bool) -> CatchArm {
    let cup = Cup {
        mouth_m: 0.05,
        outer_radius_m: 0.076,
        length_m: 0.106,
        miss_max_m: 0.04,
        replaces: vec!["fingers".to_owned()],
    };
    CatchArm::new(model(), base(), cup, Shares::default(), jerk).unwrap()
}

fn flight() -> FlightModel {
    FlightModel::vacuum(9.81).unwrap().with_drag(0.0284).unwrap()
}

/// A ball that is known exactly, from `p`, `v` at time zero.
fn forecast(p: Vector3<f64>, v: Vector3<f64>) -> Forecast {
    let points = (0..240).map(|k| {
        let t_s = 0.005 * f64::from(k);
        let (p_m, v_m_s) = flight().coast(&p, &v, t_s);
        Foreseen { t_s, p_m, v_m_s, covariance_m2: Matrix3::identity() * 1e-8 }
    });
    let watch = Watch { sigma_m: 0.002, period_s: 1.0 / 120.0, latency_s: 0.015, first_s: 0.0 };
    Forecast { points: points.collect(), watch }
}

fn throws(count: usize, seed: u64) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let mut rng = SplitMix64::new(seed);
    // A wider window than the arm reaches, so that some balls cannot be caught.
    let window = Window { y_m: 0.6, z_m: (-0.3, 0.9), ..Window::default() };
    let mut one =
        || draw(&model(), &Pose::identity(), &base(), &flight(), &window, &mut rng, 1_000_000).unwrap();
    (0..count).map(|_| one()).map(|aimed| (aimed.p_m, aimed.v_m_s)).collect()
}

/// Every 5 ms, 400 directions, all postures: whether a posture with a motion inside speed, acceleration and ranges exists; contacts and currents
/// are not looked at. `bound` only asks for the least peak acceleration, which no motion can beat.
fn exhaustive(
    arm: &CatchArm,
    settings: &Settings,
    mode: Mode,
    from_s: f64,
    forecast: &Forecast,
    bound: bool,
) -> bool {
    let wait = Joints::from(WAIT_DEG.map(f64::to_radians));
    let limits = arm.limits(false);
    let x_bw = arm.x_wb().inverse();
    let mut rng = SplitMix64::new(9);
    forecast.points.iter().filter(|ball| ball.t_s > from_s + settings.freeze_s).any(|ball| {
        let u = ball.v_m_s.normalize();
        let (a, _) = across(&u);
        (0..400).any(|_| {
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
                let hand = u * (ball.v_m_s.norm() - settings.relative_m_s).max(0.0);
                let qd = match mode {
                    Mode::Hold => Some(Joints::zeros()),
                    Mode::Matched => joint_rates(arm, limits, &q, &hand),
                };
                qd.is_some_and(|qd| {
                    (0..6).all(|i| {
                        let (limit, from) = (&limits[i], State::rest(wait[i]));
                        let stop = q[i] + stopping_angle(limit, arm.law().limits_jerk(), qd[i]);
                        let inside = |q: f64| q >= limit.q_rad.0 && q <= limit.q_rad.1;
                        let in_time = if bound {
                            least_peak(&from, q[i], qd[i], left_s) <= limit.a_rad_s2
                        } else {
                            arm.law().fit(limit, &from, q[i], qd[i], left_s).is_some()
                        };
                        inside(q[i]) && inside(stop) && in_time
                    })
                })
            })
        })
    })
}

fn found(arm: &CatchArm, settings: &Settings, from_s: f64, forecast: &Forecast) -> Result<Mode, Decline> {
    let state = WAIT_DEG.map(|q| State::rest(q.to_radians()));
    let start = Start { at_s: from_s, state: &state, under_way: None };
    search(arm, settings, &start, forecast).0.map(|choice| choice.mode)
}

/// A refusal for want of a posture or of time is right where the exhaustive search finds nothing either. What the search
/// misses between its grid points is counted.
#[test]
fn refusals_agree_with_an_exhaustive_search() {
    let arm = arm(false);
    let (mut refused, mut wrong, mut taken, mut beyond) = (0, 0, 0, 0);
    for (k, (p, v)) in throws(40, 3).into_iter().enumerate() {
        let forecast = forecast(p, v);
        let from_s = [0.0, 0.07, 0.15][k % 3];
        for (mode, allowed) in [(Mode::Hold, Allowed::Hold), (Mode::Matched, Allowed::Matched)] {
            let settings = Settings { allowed, ..Settings::default() };
            match found(&arm, &settings, from_s, &forecast) {
                Ok(_) => {
                    taken += 1;
                    beyond += usize::from(!exhaustive(&arm, &settings, mode, from_s, &forecast, true));
                }
                Err(Decline::Contact | Decline::BallFirst | Decline::Current | Decline::TooUncertain) => {}
                Err(_) => {
                    refused += 1;
                    wrong += usize::from(exhaustive(&arm, &settings, mode, from_s, &forecast, false));
                }
            }
        }
    }
    assert!(refused > 10 && taken > 20, "{refused} refused, {taken} taken");
    // A catch that the least peak acceleration forbids would be wrong by physics.
    assert_eq!(beyond, 0, "of {taken} catches taken");
    assert!(wrong * 20 <= refused, "{wrong} of {refused} refusals are wrong");
}

#[test]
fn the_motion_found_meets_the_ball_and_keeps_every_limit() {
    for jerk in [false, true] {
        let arm = arm(jerk);
        let (mut taken, mut judged) = (0, 0);
        for (p, v) in throws(30, 4) {
            let forecast = forecast(p, v);
            let state = WAIT_DEG.map(|q| State::rest(q.to_radians()));
            let start = Start { at_s: 0.05, state: &state, under_way: None };
            let (found, count) = search(&arm, &Settings::default(), &start, &forecast);
            judged = judged.max(count.judged);
            let Ok(choice) = found else { continue };
            taken += 1;
            let (q, qd) = choice.motion.joints_at(choice.t_s);
            let (mouth, axis, hand) = arm.mouth(&q, &qd);
            let ball = forecast.at(choice.t_s).unwrap();
            assert!((mouth - ball.p_m).norm() < 1e-6, "{mouth} {}", ball.p_m);
            let relative = ball.v_m_s - hand;
            assert!((relative.norm() - choice.relative_m_s).abs() < 1e-6);
            assert!((-relative.dot(&axis) / relative.norm()).acos() < 30.0_f64.to_radians());
            let [speed, acceleration, share_of_jerk] = used(&arm, &choice.motion);
            assert!(speed <= 0.95 + 1e-9 && acceleration <= 0.8 + 1e-9, "{speed} {acceleration}");
            assert!(!jerk || share_of_jerk <= 0.95 + 1e-6, "{share_of_jerk}");
            let (_, end) = choice.motion.joints_at(choice.motion.end_s());
            assert!(end.amax() < 1e-9, "{end}");
            assert_eq!(choice.motion.at(0.05).map(|s| s.q), state.map(|s| s.q));
        }
        assert!(taken >= 10, "{taken} of 30 taken");
        assert!(judged >= 5000, "{judged} candidates judged");
    }
}

#[test]
fn a_ball_far_away_or_too_uncertain_is_declined_with_the_reason() {
    let arm = arm(false);
    let away = forecast(Vector3::new(0.0, 3.0, 0.5), Vector3::new(0.0, 2.0, 3.0));
    assert_eq!(found(&arm, &Settings::default(), 0.0, &away), Err(Decline::OutOfReach));
    let (p, v) = throws(8, 5)
        .into_iter()
        .find(|(p, v)| found(&arm, &Settings::default(), 0.0, &forecast(*p, *v)).is_ok())
        .unwrap();
    let mut vague = forecast(p, v);
    for point in &mut vague.points {
        point.covariance_m2 = Matrix3::identity() * 4.0;
    }
    assert_eq!(found(&arm, &Settings::default(), 0.0, &vague), Err(Decline::TooUncertain));
    assert!(found(&arm, &Settings::default(), 0.9, &forecast(p, v)).is_err());
}

/// The forecast moves by 10 mm while the catch is under way: the motion follows without a jump, and meets the new place.
#[test]
fn a_forecast_that_moves_is_followed_without_a_jump() {
    let arm = arm(true);
    let wait = Joints::from(WAIT_DEG.map(f64::to_radians));
    let mut followed = 0;
    for (p, v) in throws(30, 6) {
        let mut catcher = Catcher::new(&arm, Settings::default(), &wait);
        if catcher.observe(&forecast(p, v), 0.0).is_none() {
            continue;
        }
        let before = catcher.motion().clone();
        let moved = forecast(p + Vector3::new(0.0, 0.01, 0.0), v);
        let Some(after) = catcher.observe(&moved, 0.1).cloned() else { continue };
        followed += 1;
        for (a, b) in before.at(after.start_s).iter().zip(&after.at(after.start_s)) {
            assert!((a.q - b.q).abs() < 1e-9 && (a.v - b.v).abs() < 1e-9 && (a.a - b.a).abs() < 1e-6);
        }
        let choice = catcher.choice().unwrap();
        let (q, qd) = after.joints_at(choice.t_s);
        assert!((arm.mouth(&q, &qd).0 - moved.at(choice.t_s).unwrap().p_m).norm() < 1e-6);
        assert_eq!(catcher.log().last().unwrap().decision, Decision::Corrected);
    }
    assert!(followed >= 5, "{followed}");
}
