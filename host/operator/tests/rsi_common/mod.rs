//! A plan, a robot and a throw for the tests of RSI.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

use hil_sim::krc::KrcScenario;
use nalgebra::Vector3;
use operator::job::{Answer, OnProgress, Order, Record, perform};
use operator::rsi::cell::{self, Seen, SimulatedRobot};
use operator::rsi::log::Line;
use operator::rsi::operator::{LedRobot, Place};
use operator::rsi::program::{Lag, command_range, prepare, station, station_for, travel};
use operator::rsi::station::{Stage, Station};
use planner::follow::best::{self, BestOptions, HandFreedom};
use planner::follow::limits::{Arm, LimitSource, Limits};
use planner::follow::plan::{FollowPlan, Form};
use planner::follow::setting::Setting;
use planner::plan::file::RobotId;
use planner::store::fingerprint_of;
use protocol::Instant;

pub(crate) const TARGET: [f64; 3] = [2.5, 0.0, 0.6];
/// Radius of a bottle, m.
pub(crate) const HIT_M: f64 = 0.035;
const LAG_S: f64 = 0.024;

pub(crate) fn arm() -> Arm {
    Arm::load("kr16_2").expect("built in")
}

/// The best form at 2.5 m, inside what the usual program of the robot passes, planned once.
pub(crate) fn plan() -> &'static FollowPlan {
    static PLAN: OnceLock<FollowPlan> = OnceLock::new();
    PLAN.get_or_init(|| {
        let arm = arm();
        let source = LimitSource::ControllerModel;
        let commands = command_range(&KrcScenario::open("kr-c2").expect("built in"));
        let limits = Limits::of(&arm, source);
        let setting = Setting { commands, lag_s: LAG_S, ..Setting::new(&arm, Vector3::from(TARGET), limits) };
        let options = BestOptions { starts: 24, kicks: 0, ..BestOptions::default() };
        let found = best::plan(&setting, &options).expect("feasible");
        let fingerprint = fingerprint_of(&arm);
        let robot = RobotId { name: arm.name().to_owned(), source: arm.name().to_owned(), fingerprint };
        FollowPlan::new(&setting, source, robot, Form::Best(HandFreedom::TangentAndRoll), &found, 0.0)
    })
}

/// A KR C2 with noise, 120 ms of lag and 10 ms of gripper jitter, whose program stands at the start of the plan.
pub(crate) fn scenario(seed: u64) -> KrcScenario {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../hil-sim/scenarios/krc/kr_c2.toml");
    let mut scenario = KrcScenario::load(&path).expect("a scenario");
    prepare(&mut scenario, &arm(), plan());
    scenario.seed = seed;
    scenario
}

/// The order of a throw of the plan with the robot that is described.
pub(crate) fn order<'a>(arm: &'a Arm, described: &KrcScenario, share: f64) -> Order<'a> {
    Order::follow(arm, plan(), described, travel(described, arm, share, 1), HIT_M)
}

/// A throw as a job with the robot of `scenario`; and where its station is. `at` gets the time and the flag of an interruption with
/// everything that goes in or out.
pub(crate) fn performed_by(
    scenario: &KrcScenario,
    share: f64,
    at: &dyn Fn(Instant, &AtomicBool),
    answers: OnProgress<'_>,
) -> (Record, Stage) {
    let (arm, lag) = (arm(), true_lag(scenario));
    let stop = Arc::new(AtomicBool::new(false));
    let log = |lines: &[Line]| lines.iter().for_each(|line| at(line.at, &stop));
    let station = station_for(scenario, &arm, plan(), lag, &[]).expect("a station");
    let robot = SimulatedRobot::new(scenario).expect("a robot");
    let place = Place::Inside(Box::new(robot));
    let mut operator = LedRobot::new(scenario.clone(), station, place, Arc::clone(&stop), Box::new(log));
    let record = perform(&mut operator, &order(&arm, scenario, share), answers);
    let stage = *operator.station().stage();
    (record, stage)
}

pub(crate) fn performed(scenario: &KrcScenario) -> (Record, Stage) {
    performed_by(scenario, 0.8, &|_, _| {}, &mut |_| Answer::Yes)
}

pub(crate) fn thrown_with(scenario: &KrcScenario, plan: &FollowPlan, lag: Lag) -> (Seen, Station) {
    let mut station = station(scenario, &arm(), plan, lag, &[]).expect("a station");
    let seen = cell::run(scenario, &mut station).expect("a robot");
    (seen, station)
}

pub(crate) fn true_lag(scenario: &KrcScenario) -> Lag {
    let lag = &scenario.options.lag;
    Lag { dead_time: lag.dead_time, time_constant: lag.time_constant }
}

pub(crate) fn thrown(scenario: &KrcScenario) -> (Seen, Station) {
    thrown_with(scenario, plan(), true_lag(scenario))
}

/// Distance of the landing from the target in the plane of the target, m.
pub(crate) fn error_m(seen: &Seen) -> Option<f64> {
    let landing = seen.landing.as_ref()?;
    Some((landing.p_m - Vector3::from(TARGET)).xy().norm())
}
