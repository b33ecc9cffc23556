//! What the robot's program must hold for a throw, and the station that fits to it.

use firmware::groups::rsi::Options;
use firmware::joints::PerJoint;
use firmware::settings::Settings;
use hil_sim::krc::{KrcOptions, KrcScenario, Space};
use planner::follow::limits::{AXES, Arm, Axes};
use planner::follow::plan::FollowPlan;
use planner::follow::setting::CommandRange;
use planner::motion::Motion;
use planner::store::fingerprint_of;
use protocol::Duration;
use robot_model::collision::{CollisionChecker, Scene, StraightMove};

use super::plan::{Timing, motion_of, settings_of};
use super::station::Station;
use super::wire::{ConfigUnfit, Names, Wire};
use crate::trajectory::{Encoded, TrajectoryError, encode_any, robot_crc32};
use planner::way::Travel;

/// Distance of correction limits from the range of an axis, degrees: a program whose limits reach the range is refused.
const INSIDE_DEG: f64 = 0.01;

/// Distance of the corners of the way to the start from all ranges, rad: commands lead the axes by the lag.
const CORNER_INSIDE_RAD: f64 = 0.03;

/// Bodies nearer than this count as together, m.
const CLEAR_M: f64 = 1e-3;
/// While the lag is measured: largest distance from the path, rad, and largest delay of it.
const EXPLORING_RAD: f32 = 0.4;
const EXPLORING: Duration = Duration::from_millis(400);

/// There is no station for a throw.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoStation {
    /// The configuration file.
    #[error(transparent)]
    Config(#[from] ConfigUnfit),
    #[error(transparent)]
    Plan(#[from] TrajectoryError),
    /// Another period.
    #[error("the plan has a set point every {plan_ms} ms, the robot sends a telegram every {robot_ms} ms")]
    Period { plan_ms: f64, robot_ms: f64 },
    /// More than the robot's program lets pass.
    #[error(
        "the plan needs a correction of {offset_deg:.1} deg on A{axis}; the robot's program passes {low} to {high} deg from its start pose"
    )]
    Correction {
        /// Axis, from 1.
        axis: usize,
        /// Offset from the start pose.
        offset_deg: f64,
        /// Lower limit.
        low: f64,
        /// Upper limit.
        high: f64,
    },
    /// The robot's program adds each correction to the one before.
    #[error(
        "the description says relative = true: the robot adds a correction in every cycle, and offsets from the start pose would \
         make it run away"
    )]
    Relative,
    /// The robot's program corrects the pose of the tool.
    #[error(
        "the description says space = \"{space}\": the robot corrects the pose of its tool, and offsets of axes in degrees are sent"
    )]
    NotAxes {
        /// Value in the description.
        space: &'static str,
    },
    /// The motion leads an axis out of its range, or bodies together.
    #[error("the motion from the start pose {what}")]
    Unfree {
        /// What is in the way.
        what: String,
    },
    #[error("the robot has no output that opens the gripper")]
    NoGripper,
}

impl NoStation {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Period { robot_ms, .. } => format!("plan for this robot controller (`cubectl plan throw --period-ms {robot_ms}`)"),
            Self::Correction { .. } => "widen the limits in the robot's program and in its description, or choose a start pose nearer to the plan".to_owned(),
            Self::Relative => "let the robot's program take absolute corrections (KR C2: ST_AXISCORR parameter 1 = 0; KR C4: \
         RSI_ON (#ABSOLUTE, ...)), then set relative = false in [correction] of the description".to_owned(),
            Self::NotAxes { .. } => "let the robot's program take axis corrections (KR C2: ST_AXISCORR; KR C4: AXISCORR), then set space = \"axes\" in \
         [correction] of the description".to_owned(),
            Self::Unfree { .. } => "let the robot's program begin elsewhere (start_deg of the description), or swing less (--wiggle-deg)".to_owned(),
            Self::NoGripper => "set output_bit in [gripper] of the scenario".to_owned(),
            Self::Config(error) => return error.next(),
            Self::Plan(error) => return error.next(),
        })
    }
}

/// What is known of the lag between a set point and the axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lag {
    /// Pure delay.
    pub dead_time: Duration,
    /// Time constant of the first order behind it.
    pub time_constant: Duration,
}

impl Lag {
    /// The lag in a description. A mean over set points delays them by half its length.
    #[must_use]
    pub fn of(scenario: &KrcScenario) -> Self {
        let (lag, cycle) = (&scenario.options.lag, scenario.options.cycle);
        let smoothing_us = cycle.as_micros() * (lag.smoothing_cycles.max(1) as u64 - 1) / 2;
        Self {
            dead_time: lag.dead_time + Duration::from_micros(smoothing_us),
            time_constant: lag.time_constant,
        }
    }

    /// The lag in the form that a plan can use: its commands lead by the first-order part that it was made for, and
    /// the rest is a shift in time.
    #[must_use]
    pub fn for_plan(&self, plan: &FollowPlan) -> Self {
        let time_constant = Duration::from_secs_f64(plan.lag_s);
        let total = self.dead_time + self.time_constant;
        Self { dead_time: total.saturating_sub(time_constant), time_constant }
    }
}

/// How the robot moves to the start of a plan, with `share` of the speeds and accelerations of the robot file:
/// inside the ranges of the axes and of the corrections that the robot's program accepts.
#[must_use]
pub fn travel(scenario: &KrcScenario, arm: &Arm, share: f64, seed: u64) -> Travel {
    let (passed, inside) = (command_range(scenario), Axes::repeat(AXES, CORNER_INSIDE_RAD));
    let range = (arm.q_min().sup(&passed.min_rad) + inside, arm.q_max().inf(&passed.max_rad) - inside);
    Travel { share, seed, range: Some(range) }
}

/// Where the robot's program begins.
#[must_use]
pub fn start_of(scenario: &KrcScenario) -> Axes {
    Axes::from(scenario.options.start_deg.map(f64::to_radians))
}

/// Makes the program of a scenario begin at the start of a plan, as its first motion command does, with corrections
/// up to the ranges of the axes; landings are reported at the height of the target.
pub fn prepare(scenario: &mut KrcScenario, arm: &Arm, plan: &FollowPlan) {
    let Some(start) = plan.steps.first() else { return };
    let options = &mut scenario.options;
    let mut widest = options.correction.overall_axis_deg;
    for (axis, joint) in arm.joints().iter().enumerate().take(options.start_deg.len()) {
        let start_deg = start.q_rad[axis].to_degrees();
        let lower = joint.limits.q_min_rad.to_degrees() - start_deg + INSIDE_DEG;
        let upper = joint.limits.q_max_rad.to_degrees() - start_deg - INSIDE_DEG;
        options.start_deg[axis] = start_deg;
        (options.correction.lower[axis], options.correction.upper[axis]) = (lower, upper);
        widest = widest.max(-lower).max(upper);
    }
    options.correction.overall_axis_deg = widest;
    options.hand.gripper.landing_z_m = Some(plan.target_m[2]);
}

/// Whether the robot's program can be led at all: absolute corrections of the axes, and what [`Wire`] needs.
pub fn can_be_led(scenario: &KrcScenario) -> Result<(), NoStation> {
    wire(scenario).map(drop)
}

/// The station that throws a plan with the robot that `scenario` describes, from the start pose of the robot's program on:
/// first along `ways` (from rest to rest, the last one to the start of the plan), then along the plan.
pub fn station(
    scenario: &KrcScenario,
    arm: &Arm,
    plan: &FollowPlan,
    lag: Lag,
    ways: &[Motion],
) -> Result<Station, NoStation> {
    let mut motions = ways.to_vec();
    motions.push(motion_of(plan));
    for way in ways {
        poses_within_corrections(scenario, way)?;
    }
    station_for(scenario, arm, plan, lag, &motions)
}

/// As [`station`], with all its `motions`: empty for a station that gets them one after the other.
pub fn station_for(
    scenario: &KrcScenario,
    arm: &Arm,
    plan: &FollowPlan,
    lag: Lag,
    motions: &[Motion],
) -> Result<Station, NoStation> {
    let krc = &scenario.options;
    let (plan_s, robot_s) = (plan.period_s, krc.cycle.as_secs_f64());
    // Differences of the commands are limited at the period of the plan; at another one they may be larger.
    if (plan_s - robot_s).abs() > 1e-6 {
        return Err(NoStation::Period { plan_ms: 1e3 * plan_s, robot_ms: 1e3 * robot_s });
    }
    within_corrections(scenario, plan)?;
    built(scenario, arm, lag, plan.release_time_s, motions)
}

/// The station that holds the robot where its program starts, or leads it along motions from rest to rest.
pub fn leading(
    scenario: &KrcScenario,
    arm: &Arm,
    lag: Lag,
    motions: &[Motion],
) -> Result<Station, NoStation> {
    built(scenario, arm, lag, 0.0, motions)
}

fn built(
    scenario: &KrcScenario,
    arm: &Arm,
    lag: Lag,
    release_s: f64,
    motions: &[Motion],
) -> Result<Station, NoStation> {
    let fingerprint = fingerprint_of(arm);
    let settings = settings_of(arm, &fingerprint, &timing(scenario, lag), release_s);
    let files = encoded(motions, &settings, &fingerprint)?;
    Ok(Station::new(wire(scenario)?, &settings, options(scenario, lag), files))
}

/// As [`leading`], for a robot whose lag is not known yet: axes much later than described do not end the run.
pub fn exploring(scenario: &KrcScenario, arm: &Arm, motions: &[Motion]) -> Result<Station, NoStation> {
    for motion in motions {
        free_from_start(arm, motion)?;
        poses_within_corrections(scenario, motion)?;
    }
    let fingerprint = fingerprint_of(arm);
    let described = Lag::of(scenario);
    // Set points are commanded as they are.
    let lag = Lag { dead_time: described.dead_time + described.time_constant, time_constant: Duration::ZERO };
    let mut settings = settings_of(arm, &fingerprint, &timing(scenario, lag), 0.0);
    for joint in &mut settings.joint.0 {
        joint.error_max_rad = EXPLORING_RAD;
    }
    let files = encoded(motions, &settings, &fingerprint)?;
    let options = Options { lag_max_rad: EXPLORING_RAD, delay_max: EXPLORING, ..options(scenario, lag) };
    Ok(Station::new(wire(scenario)?, &settings, options, files))
}

/// All axes stay in their ranges, and no bodies touch: with the empty hand, between two knots along a straight line.
fn free_from_start(arm: &Arm, motion: &Motion) -> Result<(), NoStation> {
    let unfree = |what: &str| NoStation::Unfree { what: what.to_owned() };
    let scene = Scene::default();
    let mut checker = CollisionChecker::new(arm, &scene);
    if motion.knots.iter().any(|knot| !arm.in_range(&knot.q_rad, 0.0)) {
        return Err(unfree("leaves the range of an axis"));
    }
    let is_free = motion.knots.windows(2).all(|pair| {
        let straight = StraightMove { from: pair[0].q_rad, to: pair[1].q_rad };
        checker.check_motion(&straight, 0.0, 1.0, CLEAR_M).is_free()
    });
    if is_free { Ok(()) } else { Err(unfree("brings bodies of the arm or the floor together")) }
}

/// A station for a recorded exchange, and the plan that was run, if one was. The log has its trajectories.
pub fn replay_station(
    scenario: &KrcScenario,
    arm: &Arm,
    plan: Option<&FollowPlan>,
) -> Result<Station, NoStation> {
    let release_s = plan.map_or(0.0, |plan| plan.release_time_s);
    let lag = Lag::of(scenario);
    built(scenario, arm, plan.map_or(lag, |plan| lag.for_plan(plan)), release_s, &[])
}

fn encoded(
    motions: &[Motion],
    settings: &Settings,
    fingerprint: &str,
) -> Result<Vec<Encoded>, TrajectoryError> {
    let (period_us, crc32) = (settings.cycle_period_us, robot_crc32(fingerprint));
    motions.iter().map(|motion| encode_any(motion, period_us, crc32, Some(settings))).collect()
}

fn timing(scenario: &KrcScenario, lag: Lag) -> Timing {
    let microseconds = |span: Duration| u32::try_from(span.as_micros()).unwrap_or(u32::MAX);
    let krc = &scenario.options;
    Timing {
        period_us: microseconds(krc.cycle),
        dead_time_us: microseconds(lag.dead_time),
        gripper_delay_us: microseconds(krc.hand.gripper.delay),
    }
}

/// Every station is made with it, so a robot that takes another kind of corrections is never led.
fn wire(scenario: &KrcScenario) -> Result<Wire, NoStation> {
    let krc = &scenario.options;
    if krc.correction.relative {
        return Err(NoStation::Relative);
    }
    match krc.correction.space {
        Space::Axes => {}
        space => return Err(NoStation::NotAxes { space: space.word() }),
    }
    let output_bit = krc.hand.output_bit.ok_or(NoStation::NoGripper)?;
    let names = Names { outputs: &krc.outputs_name, output_bit, stop: &krc.stop_name };
    Ok(Wire::new(&scenario.config, &names)?)
}

fn options(scenario: &KrcScenario, lag: Lag) -> Options {
    let passed = |end: fn((f64, f64)) -> f64| {
        radians(&std::array::from_fn(|axis| end(passed_deg(&scenario.options, axis))))
    };
    Options {
        dead_time: lag.dead_time,
        time_constant: lag.time_constant,
        lower_rad: passed(|(low, _)| low),
        upper_rad: passed(|(_, high)| high),
        ..Options::default()
    }
}

/// Commands that the robot's program passes, from its start pose.
#[must_use]
pub fn command_range(scenario: &KrcScenario) -> CommandRange {
    let krc = &scenario.options;
    let reach: [_; 6] = std::array::from_fn(|axis| passed_deg(krc, axis));
    let at = |end: fn((f64, f64)) -> f64| {
        Axes::from_fn(AXES, |axis| (krc.start_deg[axis] + end(reach[axis])).to_radians())
    };
    CommandRange { min_rad: at(|(low, _)| low), max_rad: at(|(_, high)| high) }
}

/// Least and largest correction of an axis that the program passes, deg.
fn passed_deg(krc: &KrcOptions, axis: usize) -> (f64, f64) {
    let correction = &krc.correction;
    let most = correction.overall_axis_deg;
    (correction.lower[axis].max(-most), correction.upper[axis].min(most))
}

/// The robot clamps corrections silently, so a plan that needs more is refused before anything moves.
fn within_corrections(scenario: &KrcScenario, plan: &FollowPlan) -> Result<(), NoStation> {
    plan.steps.iter().try_for_each(|step| within_correction(scenario, &Axes::from(step.command_rad)))
}

/// The set points of a motion, which lead it by the lag, stay within the corrections that the robot's program accepts.
///
/// # Errors
/// [`NoStation::Correction`].
pub fn passes(scenario: &KrcScenario, motion: &Motion) -> Result<(), NoStation> {
    let (cycle_s, lag_s) =
        (scenario.options.cycle.as_secs_f64(), Lag::of(scenario).time_constant.as_secs_f64());
    let cycles = (motion.duration_s() / cycle_s).ceil() as u64;
    (0..=cycles).try_for_each(|cycle| {
        let along = motion.at((cycle as f64 * cycle_s).min(motion.duration_s()));
        within_correction(scenario, &(along.q + along.qd * lag_s))
    })
}

/// A way from rest to rest moves each axis one way only between two knots, and at rest commands lead by nothing.
fn poses_within_corrections(scenario: &KrcScenario, way: &Motion) -> Result<(), NoStation> {
    way.knots.iter().try_for_each(|knot| within_correction(scenario, &knot.q_rad))
}

fn within_correction(scenario: &KrcScenario, command_rad: &Axes) -> Result<(), NoStation> {
    let krc = &scenario.options;
    for axis in 0..krc.start_deg.len() {
        let offset_deg = command_rad[axis].to_degrees() - krc.start_deg[axis];
        let (low, high) = passed_deg(krc, axis);
        // Written so that NaN is refused.
        let within = offset_deg >= low && offset_deg <= high;
        if !within {
            return Err(NoStation::Correction { axis: axis + 1, offset_deg, low, high });
        }
    }
    Ok(())
}

fn radians(deg: &[f64; 6]) -> PerJoint<f32> {
    let mut all = PerJoint::splat(0.0);
    for (to, from) in all.0.iter_mut().zip(deg) {
        *to = from.to_radians() as f32;
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::JointIndex;

    #[test]
    fn overall_limit_of_a_correction_bounds_the_set_points_as_the_limits_of_each_axis_do() {
        let mut scenario = KrcScenario::open("kr-c2").expect("built in");
        scenario.options.correction.lower = [-50.0; 6];
        scenario.options.correction.upper = [20.0; 6];
        scenario.options.correction.overall_axis_deg = 30.0;
        let options = options(&scenario, Lag::of(&scenario));
        let first = JointIndex::new(0).expect("a joint");
        let passed = [options.lower_rad, options.upper_rad].map(|end| end.get(first).to_degrees().round());
        assert_eq!(passed, [-30.0, 20.0]);
    }
}
