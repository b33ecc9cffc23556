//! The judge of a throw whose hand follows the flight of the ball, with a robot that is led.

use hil_sim::krc::KrcScenario;
use nalgebra::{DMatrix, RowSVector, SMatrix, Vector3};
use planner::follow::limits::{AXES, Arm, Axes};
use protocol::Duration;

use super::order::{Judge, Order};
use super::record::{JobError, Landing, LandingSource, Record};
use super::verdict::Outcome;
use crate::dialogue::operator::OperatorError;
use crate::port::Operator;
use crate::rsi::cycles::{is_set, numbers};
use crate::samples::Cycle;

/// What is known of the ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ball {
    /// It never left the hand.
    InHand,
    /// The axes were so far from their path at the release, rad, that it was not given.
    Withheld(f64),
    /// The gripper was ordered to open, but the finger sensor reports that it did not.
    FingersClosed,
    /// The finger sensor reports open at a time without an order to open.
    FingersOpenBefore,
    /// Whether it left the hand, or where it went, cannot be known.
    Unknown(&'static str),
    /// It left the hand and does not come down to the height of the target.
    Lost,
    /// It was seen to land so far from the target, m.
    Landed(f64),
    /// The ball was not observed; the measured axes send it this far from the target, m.
    Predicted(f64),
    /// As before, from the time at which the finger sensor reports open: this much later than the delay of the gripper, s.
    PredictedLate(f64, f64),
}

impl Ball {
    fn words(self) -> String {
        match self {
            Self::InHand => "the ball is in the hand".to_owned(),
            Self::Withheld(off_rad) => format!(
                "the ball is in the hand: the axes were {:.1} deg off their path at the release, so the gripper was not opened",
                off_rad.to_degrees()
            ),
            Self::FingersClosed => {
                "contradiction: the gripper was ordered to open, and the finger sensor still says \
                closed; the ball may be in the hand"
                    .to_owned()
            }
            Self::FingersOpenBefore => {
                "contradiction: the finger sensor says open before the gripper was ordered to \
                open; where the ball is cannot be known"
                    .to_owned()
            }
            Self::Unknown(why) => format!("where the ball is cannot be known: {why}"),
            Self::Lost => "the ball left the hand and does not reach the height of the target".to_owned(),
            Self::Landed(error_m) => format!("the ball landed {:.1} mm from the target", 1e3 * error_m),
            Self::Predicted(error_m) => {
                format!(
                    "nobody watched the ball; the measured axes send it {:.1} mm from the target",
                    1e3 * error_m
                )
            }
            Self::PredictedLate(error_m, late_s) => format!(
                "the finger sensor says open {:.0} ms later than described; from then the measured axes send the ball \
                 {:.1} mm from the target",
                1e3 * late_s,
                1e3 * error_m
            ),
        }
    }
}

/// Distance of a landing from the target, in the plane of the target, m.
#[must_use]
pub fn error_m(landing_m: &Vector3<f64>, target_m: &[f64; 3]) -> f64 {
    (landing_m - Vector3::from(*target_m)).xy().norm()
}

/// Data of the simulated ball or of the measured axes.
pub(super) fn observe(operator: &mut dyn Operator, order: &Order<'_>, record: &mut Record) {
    let Judge::Follow { plan, gripper, .. } = &order.judge else { return };
    record.followed = match operator.ball() {
        Some(ball) => Some(match (ball.released_at, ball.landing) {
            (None, _) => Ball::InHand,
            (Some(_), None) => Ball::Lost,
            (Some(_), Some((_, position_m))) => {
                let error_m = error_m(&position_m, &plan.target_m);
                record.landing = Some(Landing {
                    source: LandingSource::Cell,
                    position_m,
                    error_m,
                    uncertainty_m: None,
                    release_late_s: None,
                    touch_after_s: None,
                });
                Ball::Landed(error_m)
            }
        }),
        None => {
            // What the robot does after the throw is part of its samples.
            operator.leave();
            operator.take_samples(order.arm, None).map(|samples| {
                let gripper = GripperKnown { last_outputs: samples.last_outputs, ..*gripper };
                measured(order.arm, &samples.cycles, plan.period_s, &gripper, &plan.target_m)
            })
        }
    };
}

/// Adds what only the link knows: why the robot stopped, why the ball was kept, and when it was free in time of the plan.
pub(super) fn conclude(order: &Order<'_>, record: &mut Record) {
    let (Judge::Follow { plan, .. }, Some(led)) = (&order.judge, &record.led) else { return };
    let fault = led.seen.as_ref().and_then(|seen| seen.fault);
    if let Some(JobError::Operator(OperatorError::RobotStopped { by_itself, .. })) = &mut record.ended {
        *by_itself = by_itself.take().or(fault.map(|fault| fault.to_string()));
    }
    if let (Some(Ball::InHand), Some(off_rad)) = (record.followed, led.release_withheld_rad) {
        record.followed = Some(Ball::Withheld(off_rad));
    }
    let released = led.seen.as_ref().and_then(|seen| seen.released).map(|(at, _)| at);
    if let (Some(landing), Some(at), Some(started_at)) = (&mut record.landing, released, led.started_at) {
        landing.release_late_s = Some(at.as_secs_f64() - started_at.as_secs_f64() - plan.release_time_s);
    }
}

/// What became of the ball of a throw that ended early.
pub(super) fn ball_after_stop(record: &Record) -> String {
    record.followed.map_or_else(String::new, |ball| format!("; {}", ball.words()))
}

/// A throw whose ball has landed is not a success if the robot stopped by itself.
pub(super) fn verdict(record: &Record, tolerance_m: f64) -> (Outcome, String) {
    let ball = record.followed.unwrap_or(Ball::Unknown("no telegrams came"));
    if let Some(fault) = record.led.as_ref().and_then(|led| led.seen.as_ref()?.fault.as_ref()) {
        return (
            Outcome::Stopped,
            format!("stopped; the robot stopped by itself: {fault}; {}", ball.words()),
        );
    }
    of_ball(ball, tolerance_m)
}

/// The verdict on a throw that came to its end.
#[must_use]
pub fn of_ball(ball: Ball, tolerance_m: f64) -> (Outcome, String) {
    let within = |error_m: f64| error_m <= tolerance_m;
    let (outcome, word) = match ball {
        Ball::InHand | Ball::Withheld(_) | Ball::FingersClosed => (Outcome::NotReleased, "not released"),
        Ball::FingersOpenBefore | Ball::Unknown(_) => (Outcome::Missed, "unknown"),
        Ball::Landed(error_m) if within(error_m) => (Outcome::Landed, "landed"),
        Ball::Predicted(error_m) | Ball::PredictedLate(error_m, _) if within(error_m) => {
            (Outcome::NotObserved, "thrown, not observed")
        }
        _ => (Outcome::Missed, "missed"),
    };
    let has_tolerance = outcome != Outcome::NotReleased && word != "unknown";
    let tolerance =
        if has_tolerance { format!(" (tolerance {:.0} mm)", 1e3 * tolerance_m) } else { String::new() };
    (outcome, format!("{word}: {}{tolerance}", ball.words()))
}

/// Time on each side of the release through which the path of an axis is fitted, s. Changes of the set points while
/// the order to open is in flight reach the axes later.
const NEAR_S: f64 = 0.048;
/// Farthest measured axis from its fitted path, deg: at the root of its place in time, 5 mm of the landing of a throw over 2.5 m. The
/// axes of a smooth motion are 0.002 deg from it.
const PATH_OFF_MAX_DEG: f64 = 0.01;
/// Coefficients of the fitted path of an axis.
const COEFFICIENTS: usize = 4;
/// Cycles by which a finger sensor may report open later than the delay of the gripper: it is read once per cycle.
const SENSOR_CYCLES: f64 = 2.0;

/// The ball is in the hand for at least this time before its release: the arm moves.
const HELD: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperKnown {
    /// Bit of the outputs that opens it.
    pub output_bit: u8,
    /// From the output in force to the free ball, s.
    pub delay_s: f64,
    /// Half of the spread of that, s.
    pub jitter_s: f64,
    /// What the last answer sets the outputs to.
    pub last_outputs: Option<f64>,
}

impl GripperKnown {
    /// As a description has it.
    #[must_use]
    pub fn of(described: &KrcScenario) -> Self {
        let hand = &described.options.hand;
        Self {
            output_bit: hand.output_bit.unwrap_or(0),
            delay_s: hand.gripper.delay.as_secs_f64(),
            jitter_s: hand.gripper.jitter.as_secs_f64(),
            last_outputs: None,
        }
    }
}

/// Landing computed from the measured axes: where the ball comes down at the height of the target.
///
/// The ball is free a delay after the first cycle in which the output is in force, or when the finger sensor
/// reports open, if that is later. A cubic through the measured axes of the cycles around gives position and speed
/// of the hand there. Cycles have the times of their numbers, so a lost telegram shifts nothing.
#[must_use]
pub fn measured(
    arm: &Arm,
    cycles: &[Cycle],
    period_s: f64,
    gripper: &GripperKnown,
    target_m: &[f64; 3],
) -> Ball {
    let is_open = |cycle: &Cycle| is_set(cycle.outputs, gripper.output_bit);
    let Some(opened) = cycles.iter().position(is_open) else {
        return match gripper.last_outputs {
            Some(outputs) if is_set(outputs, gripper.output_bit) => Ball::Unknown(
                "the telegrams end after the answer that opens the gripper, and nothing says whether the robot took it",
            ),
            _ => Ball::InHand,
        };
    };
    let numbers = numbers(cycles, period_s);
    let since = |k: usize| numbers[k] as f64 - numbers[opened] as f64;
    let delay = gripper.delay_s / period_s;
    let latest = delay + gripper.jitter_s / period_s + SENSOR_CYCLES;
    let is_held = |cycle: &&Cycle| cycles[opened].at.saturating_since(cycle.at) <= HELD;
    if cycles[..=opened].iter().filter(is_held).any(|cycle| cycle.fingers_open == Some(true)) {
        return Ball::FingersOpenBefore;
    }
    let sensed = (opened..cycles.len()).find(|k| cycles[*k].fingers_open == Some(true));
    let last = cycles.len() - 1;
    if sensed.is_none() && cycles[last].fingers_open == Some(false) {
        return if since(last) > latest {
            Ball::FingersClosed
        } else {
            Ball::Unknown("the telegrams end before the finger sensor can say open")
        };
    }
    // Open some time within the cycle before the reading.
    let late = sensed.map(|k| since(k) - 0.5).filter(|at| *at > latest).map(|at| at - delay);
    let at = delay + late.unwrap_or(0.0);
    let since_s = |k: usize| (since(k) - at) * period_s;
    let near = |before_s: f64, after_s: f64| {
        let is_near = move |k: &usize| (-before_s - 1e-9..=after_s + 1e-9).contains(&since_s(*k));
        (0..cycles.len()).filter(is_near).map(|k| (since_s(k), &cycles[k].actual_deg))
    };
    let next = near(0.0, NEAR_S).find(|(since_s, _)| *since_s > 0.0);
    // To the latest opening.
    let Some(next) = next.filter(|_| since_s(last) >= gripper.jitter_s) else {
        return Ball::Unknown("too few telegrams came around the release");
    };
    // If the axes leap after the release, only the time before it shows the path of the ball. The next telegram
    // shows that they did not leap in the cycle of the release.
    let around = Path::through(near(NEAR_S, NEAR_S)).filter(|path| path.off_deg <= PATH_OFF_MAX_DEG);
    let path = around.or_else(|| {
        Path::through(near(2.0 * NEAR_S, 0.0))
            .filter(|path| path.off_deg.max(path.off_at_deg(next)) <= PATH_OFF_MAX_DEG)
    });
    let Some(path) = path else {
        return Ball::Unknown("the axes leap, or too few telegrams came, around the release");
    };
    let [q, qd] =
        [0, 1].map(|power| Axes::from(path.coefficients.row(power).transpose().map(f64::to_radians)));
    let frames = arm.fk(&q);
    let p = arm.ball(&frames).pos;
    let v: Vector3<f64> = (frames.jacobian(&p) * qd).fixed_rows::<3>(0).into();
    let g = arm.world().gravity_m_s2;
    let root = v.z * v.z + 2.0 * g * (p.z - target_m[2]);
    if root < 0.0 {
        return Ball::Lost;
    }
    let fall_s = (v.z + root.sqrt()) / g;
    let error_m = (p + v * fall_s - Vector3::from(*target_m)).xy().norm();
    match late {
        Some(late) => Ball::PredictedLate(error_m, late * period_s),
        None => Ball::Predicted(error_m),
    }
}

/// A cubic through the measured axes near a time, deg and s.
struct Path {
    coefficients: SMatrix<f64, COEFFICIENTS, AXES>,
    /// Farthest measured axis from the cubic, deg.
    off_deg: f64,
}

impl Path {
    /// Through these places, each with its time after the requested one, s; `None` for too few places.
    fn through<'a>(places: impl Iterator<Item = Place<'a>>) -> Option<Self> {
        let places: Vec<Place<'a>> = places.collect();
        if places.len() < 2 * COEFFICIENTS - 1 {
            return None;
        }
        let rows =
            DMatrix::from_fn(places.len(), COEFFICIENTS, |row, power| places[row].0.powi(power as i32));
        let deg = DMatrix::from_fn(places.len(), AXES, |row, axis| places[row].1[axis]);
        let fitted: DMatrix<f64> = rows.pseudo_inverse(1e-12).ok()? * deg;
        let mut path =
            Self { coefficients: fitted.fixed_view::<COEFFICIENTS, AXES>(0, 0).into_owned(), off_deg: 0.0 };
        path.off_deg = places.iter().map(|place| path.off_at_deg(*place)).fold(0.0, f64::max);
        Some(path)
    }

    fn off_at_deg(&self, (since_s, deg): Place<'_>) -> f64 {
        let powers = RowSVector::<f64, COEFFICIENTS>::from_fn(|_, power| since_s.powi(power as i32));
        (powers * self.coefficients - RowSVector::from(*deg)).amax()
    }
}

/// Measured axes, deg, and their time after the release, s.
type Place<'a> = (f64, &'a [f64; AXES]);
