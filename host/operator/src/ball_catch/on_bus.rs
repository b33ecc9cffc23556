//! A catch by an arm behind its controller, with the eyes of a tracker: over a bus, in real time or in lock step.
//!
//! ```text
//! tracker ──► datagrams ──► MarkerStream ──► BallWatch ──► forecast ──► Catcher ──► end state ──► controller
//! ```
//!
//! What is reported comes from tracker and controller alone. Time zero is that of the catcher's run, on the clock of its session.

use std::time::Instant as WallTime;

use nalgebra::Vector3;
use planner::catch::Joints;
use planner::catch::online::Logged;
use planner::catch::search::Choice;
use planner::way::{Travel, way};
use protocol::{Duration, Instant};

use super::controller_arm::ControllerArm;
use super::executor::{Executor, Refused};
use super::limits::Executed;
use super::reported::{CatchOutcome, InCup, in_cup, place_in_cup, report};
use super::trial::{Moment, Outcome, Pair, Run, TrialOptions};
use super::wire::{ArmOnBus, Eyes, WireError, meanwhile};
use crate::dialogue::operator::OperatorError;
use crate::flight_estimator::MarkerStream;

/// The tracker's clock is related to ours for this long, s, by at least this many frames.
const SETTLE_S: f64 = 1.0;
const SETTLED_FRAMES: usize = 10;
/// The catcher watches for this long after the last motion and the end of the flight, s.
const AFTER_S: f64 = 1.2;
/// And for this much longer as long as the ball still moves in the cup, s.
const LONGER_S: f64 = 0.2;
/// A forecast reaches this far, s.
const FLIGHT_MAX_S: f64 = 1.1;
/// Longest turn between two looks at the tracker.
const TURN_S: f64 = 0.5e-3;
/// Longest trial after the throw begins, s; shorter than the run that takes end states.
const TRIAL_MAX_S: f64 = 12.0;
/// A message on a bus that the drives share, a decision, and the lag of the drives, s; two control periods come on top.
const ACTUATION_S: f64 = 0.016;
/// A report shows so much before the release, s.
const SHOWN_BEFORE_S: f64 = 0.3;
/// Refusals that are kept.
const REFUSALS_MAX: usize = 20;

/// From a decision to the first motion because of it, s, with a control period in µs.
#[must_use]
pub fn actuation_s(period_us: u32) -> f64 {
    ACTUATION_S + 2e-6 * f64::from(period_us)
}

/// What the catcher waits for; times of the trial, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Expected {
    Throw {
        start_s: f64,

        /// When the ball is to pass the catcher.
        passes_s: f64,
        /// When the catcher plans by the announced throw, before it sees a ball; `None` if nothing is announced.
        plans_s: Option<f64>,
    },
    Ball {
        /// None is waited for any longer.
        until_s: f64,
    },
}

/// The tracker as it was during a catch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerClock {
    /// Clock of the catcher's trial minus the tracker's, s; by the least late of so many datagrams.
    pub offset_s: f64,
    pub datagrams: usize,
    /// From an exposure to its reading here, s: median and largest.
    pub age_s: (f64, f64),
}

/// What the catcher knows of a catch; times of its trial, s.
#[derive(Clone, Debug)]
pub struct Caught {
    pub reported: CatchOutcome,
    /// Where the ball lies in the cup by its markers, in the end-effector frame, m.
    pub lies_e_m: Option<Vector3<f64>>,
    pub tracker: TrackerClock,
    /// By how much the controller's clock was known, s.
    pub clock_off_s: f64,
    /// The controller's clock had not jumped when it was read again at the end; `None`: it was not readable.
    pub clock_held: Option<bool>,
    /// End states that the controller took and refused.
    pub answered: (usize, usize),
    pub refusals: Vec<Refused>,
    pub log: Vec<Logged>,
    /// The catch that was tried.
    pub choice: Option<Choice>,
    /// The decision that took this machine longest, s.
    pub longest_decision_s: f64,
    /// When the ball was seen to fly first.
    pub first_seen_s: Option<f64>,
    /// Time zero of the trial on the session's clock, and Unix time at that clock's zero, which is zero in virtual time.
    pub zero: (Instant, Duration),
    /// Joints as the drives measured them, rad.
    pub joints: Vec<(f64, Joints)>,
    /// Markers, m.
    pub ball: Vec<(f64, Vector3<f64>)>,
}

impl Caught {
    /// The catch as reports show it, from shortly before `planned_s`, the release and the end of the flight: caught is what the tracker
    /// shows, and nobody measured how the ball crossed the mouth. `ball_m`: where the ball is before its first marker; `thrower`: joints of
    /// the other arm at a time, rad.
    #[must_use]
    pub fn as_shown(
        &self,
        planned_s: (f64, f64),
        ball_m: Vector3<f64>,
        thrower: impl Fn(f64) -> Joints,
    ) -> Outcome {
        let ball_at = |t_s: f64| {
            let before = self.ball.partition_point(|(at_s, _)| *at_s <= t_s).checked_sub(1);
            before.map_or(ball_m, |k| self.ball[k].1)
        };
        let shown = self.joints.iter().filter(|(t_s, _)| *t_s >= planned_s.0 - SHOWN_BEFORE_S);
        let moment =
            |(t_s, q): &(f64, Joints)| Moment { t_s: *t_s, q: [thrower(*t_s), *q], ball_m: ball_at(*t_s) };
        Outcome {
            by_tracker: true,
            caught: self.reported == CatchOutcome::Caught,
            reported: self.reported,
            crossing: None,
            events: Vec::new(),
            choice: self.choice.clone(),
            log: self.log.clone(),
            refusals: self.refusals.clone(),
            planned_s,
            used: [0.0; 3],
            executed: [Executed::default(); 2],
            arms_touched: false,
            seen_s: 0.0,
            off_m: self.log.iter().rev().map(|logged| logged.off_m).find(|off_m| off_m.is_finite()),
            lies_e_m: self.lies_e_m.map(|lies_m| [lies_m; 2]),
            trace: shown.map(moment).collect(),
        }
    }
}

/// Relates the tracker's clock to that of the trial, which has begun.
///
/// # Errors
/// [`WireError::Silent`], and those of the bus.
pub fn settle(arm: &mut ControllerArm, eyes: &mut Eyes) -> Result<MarkerStream, WireError> {
    let (mut stream, mut frames) = (MarkerStream::new(), 0);
    // In lock step the session knows its time again after it.
    let session = arm.parts().0;
    session.pass(Duration::from_micros(500))?;
    eyes.skip(session.now())?;
    let until_s = arm.now_s() + SETTLE_S;
    while arm.now_s() < until_s {
        let session = arm.parts().0;
        if session.is_interrupted() {
            return Err(OperatorError::Interrupted.into());
        }
        session.pass(Duration::from_micros(500))?;
        session.heed_stops().map_err(OperatorError::from)?;
        let now_s = arm.now_s();
        while let Some(bytes) = eyes.next(arm.parts().0.now())? {
            frames += usize::from(matches!(stream.push(bytes, now_s), Ok(Some(_))));
        }
    }
    if frames < SETTLED_FRAMES {
        arm.parts().0.halt_if_moving()?;
        return Err(WireError::Silent { address: eyes.address().to_owned() });
    }
    Ok(stream)
}

/// Waits for a ball from anywhere and catches it, or declines: the arm is the catcher of `pair`. It goes to its waiting pose free of
/// contact, grips what it has caught, and stands. `tracker` is where the eyes are ([`Eyes::open`]).
///
/// # Errors
/// As [`catch`], and [`WireError`] for an arm that does not get ready.
pub fn catch_ball(
    on_bus: &ArmOnBus,
    pair: &Pair,
    options: &TrialOptions,
    tracker: &str,
    within_s: f64,
) -> Result<Caught, WireError> {
    let in_step = on_bus.is_in_step();
    let settings = on_bus.settings()?;
    let mut eyes = Eyes::open(tracker, in_step)?;
    let mut arm = on_bus.connect(&settings)?;
    // To a cup.
    arm.set_hand(false)?;
    let here = arm.pose()?;
    let mut options = TrialOptions { cooperative: false, ..options.clone() };
    options.settings.actuation_s = actuation_s(on_bus.period_us);
    let catcher = &pair.catcher_with(&options);
    let find = || way(catcher.model(), catcher.scene(), &Travel::default(), &here, &options.wait);
    if let Some(way) = meanwhile(arm.parts().0, in_step, find)?? {
        arm.go(&way)?;
    }
    arm.begin_for(Duration::from_secs_f64(within_s + SETTLE_S + FLIGHT_MAX_S + TRIAL_MAX_S))?;
    let mut run = pair.new_run(catcher, None, &options);
    run.stream = settle(&mut arm, &mut eyes)?;
    let expected = Expected::Ball { until_s: arm.now_s() + within_s };
    let caught = catch(&mut arm, &mut eyes, run, expected)?;
    if caught.reported == CatchOutcome::Caught {
        arm.end()?;
        arm.set_hand(false)?;
    }
    arm.finish()?;
    Ok(caught)
}

/// Catches, or declines. The arm stands at the waiting pose of `run`, has begun ([`ControllerArm::begin`]), and its stream has
/// settled. Afterwards it stands, and its run may still take end states.
///
/// # Errors
/// The bus or the tracker is gone, or somebody else has stopped the arm. A fault of the arm is an outcome.
pub fn catch(
    arm: &mut ControllerArm,
    eyes: &mut Eyes,
    mut run: Run<'_>,
    expected: Expected,
) -> Result<Caught, WireError> {
    let mut longest_s = 0.0_f64;
    let mut timed = |decide: &mut dyn FnMut()| {
        let begun = WallTime::now();
        decide();
        longest_s = longest_s.max(begun.elapsed().as_secs_f64());
    };
    let (mut until_s, last_s, mut plans_s) = match expected {
        Expected::Throw { start_s, passes_s, plans_s, .. } => {
            (passes_s + AFTER_S, start_s + TRIAL_MAX_S, plans_s)
        }
        Expected::Ball { until_s } => (until_s, until_s + FLIGHT_MAX_S + TRIAL_MAX_S, None),
    };
    let (mut ages_s, mut first_seen_s) = (Vec::new(), None);
    arm.keep();
    let mut joints = arm.advance(arm.now_s());
    while arm.now_s() < until_s.min(last_s) {
        let now_s = arm.now_s();
        joints = arm.advance(now_s + TURN_S);
        // A fault of the catcher is an outcome; a stop by somebody else ends both arms.
        if let Err(why) = arm.parts().0.heed_stops().map_err(OperatorError::from)
            && why.is_stop_by_other()
        {
            arm.parts().0.halt_if_moving()?;
            return Err(why.into());
        }
        if arm.parts().0.is_interrupted() {
            arm.parts().0.halt_if_moving()?;
            return Err(OperatorError::Interrupted.into());
        }
        while let Some(why) = arm.refused() {
            run.refusals.push(why);
            run.catcher.refused();
        }
        if plans_s.take_if(|plans_s| now_s > *plans_s).is_some() {
            run.decide(arm, now_s, &mut timed);
        }
        while let Some(bytes) = eyes.next(arm.parts().0.now())? {
            let now_s = arm.now_s();
            let Ok(Some(frame)) = run.stream.push(bytes, now_s) else { continue };
            ages_s.push(frame.age_s);
            run.seen.extend(frame.markers.iter().map(|(_, p)| (frame.t_s, *p)));
            if run.watch.observe(&frame) {
                if first_seen_s.is_none() {
                    first_seen_s = Some(frame.t_s);
                    if let Expected::Ball { .. } = expected {
                        until_s = now_s + FLIGHT_MAX_S + AFTER_S;
                    }
                }
                run.decide(arm, now_s, &mut timed);
            }
        }
        until_s = until_s.max(run.catcher.motion().end_s() + AFTER_S);
        if arm.now_s() >= until_s && in_cup(&run.catcher, &run.seen, &joints, arm.now_s()) == InCup::Moving {
            until_s += LONGER_S;
        }
    }
    let now_s = arm.now_s();
    let reported = report(&run.catcher, &run.watch, &run.seen, arm.halted(), &joints, now_s);
    let of_catcher = run.catcher.arm();
    let x_we = *of_catcher.x_wb() * of_catcher.model().ee_at(&joints.q);
    let lies_m = place_in_cup(&run.catcher, &run.seen, &joints, now_s);
    let answered = arm.answered;
    let zero = arm.zero();
    let joints = arm.kept_joints(of_catcher.model());
    let (session, node, clock) = arm.parts();
    let clock_off_s = clock.controller_time(session.now()).map_or(f64::NAN, |(_, off)| off.as_secs_f64());
    let clock_held = match session.read_clock(node, clock) {
        Ok(()) => Some(true),
        Err(OperatorError::ClockJumped { .. }) => Some(false),
        Err(_) => None,
    };
    ages_s.sort_by(f64::total_cmp);
    let age_s = |share: f64| {
        ages_s.get((share * (ages_s.len().max(1) - 1) as f64) as usize).copied().unwrap_or(f64::NAN)
    };
    run.refusals.truncate(REFUSALS_MAX);
    Ok(Caught {
        reported,
        lies_e_m: lies_m.map(|lies_m| x_we.inverse_transform_point(&lies_m)),
        tracker: TrackerClock {
            offset_s: run.stream.offset_s().unwrap_or(f64::NAN),
            datagrams: ages_s.len(),
            age_s: (age_s(0.5), age_s(1.0)),
        },
        clock_off_s,
        clock_held,
        answered,
        refusals: run.refusals,
        log: run.catcher.log().to_vec(),
        choice: run.catcher.choice().cloned(),
        longest_decision_s: longest_s,
        first_seen_s,
        zero,
        joints,
        ball: run.seen,
    })
}
