//! Analysis of a run: motion against plan, currents, timing, bus, events. Pure functions of its [samples](crate::samples).
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`collect`] | the samples in time of the plan |
//! | [`start`] | when runs began, in time of the samples |
//! | [`tracking`] | measured motion against the plan's polynomials |
//! | [`release`] | where the ball leaves the hand and lands, by the measured motion |
//! | [`control`] | accelerations that result from the orders, and those of the reference |
//! | [`coverage`] | timing compared with the timing that the gains are certified for |
//! | [`currents`] | measured currents against the robot model's |
//! | [`timing`] | control cycles and answer times |
//! | [`bus`] | bus time taken, over time and per identifier; only where the link is a bus |
//! | [`events`] | events as text; the first fault with everything known at that moment |
//! | [`distribution`] | median, 99th percentile, extremes |
//!
//! # Conventions
//!
//! Times named `t_s` are in time of the plan: zero is its start, negative before it. Joints are in the order of the
//! robot file.
//! Errors are reference minus measurement, as in the controller's telemetry.

pub mod bus;
pub mod collect;
pub mod control;
pub mod coverage;
pub mod currents;
pub mod distribution;
pub mod events;
pub mod release;
pub mod start;
pub mod timing;
pub mod tracking;

use protocol::{Duration, Instant};
use serde::Serialize;

use crate::log::candump::Tear;
use crate::samples::Samples;
use crate::samples::drives::Drives;
use planner::motion::Motion;
use planner::plan::file::PlanFile;
use planner::throw::Arm;

use bus::BusUse;
use coverage::{Certified, Coverage};
use currents::SupplyCurrents;
use events::{FirstFault, RunEvent};
use release::ReleaseMotion;
use start::StartFrom;
use timing::{Answers, Cycles};
use tracking::JointTracking;

/// Before the plan begins, this much of the log is kept for pictures, s.
pub const BEFORE_S: f64 = 0.1;
/// After the plan has ended, this much of the log is kept for pictures, s.
pub const AFTER_S: f64 = 0.25;
/// The transient that the throwing paper allows before its bounds hold (figure 3), s.
pub const TRANSIENT_S: f64 = 0.1;
/// Its bound on the position error after that, rad.
pub const POSITION_BOUND_RAD: f64 = 0.05;
/// Its bound on the speed error after that, rad/s.
pub const SPEED_BOUND_RAD_S: f64 = 0.1;

/// What to analyse.
#[derive(Clone, Copy)]
pub struct Run<'a> {
    /// Measurements and reports.
    pub samples: &'a Samples,
    pub motion: &'a Motion,
    /// The plan of the throw, if the motion is one.
    pub throw: Option<&'a PlanFile>,
    /// The arm that ran it.
    pub arm: &'a Arm,
    /// When the plan began, in time of the log; `None`: of the runs that [`start::find`] finds, the one that begins
    /// most like the plan.
    pub start: Option<Instant>,
    /// From the order to open to the free ball; `None`: not known, the ball is assumed to be free when planned.
    pub gripper_opening: Option<Duration>,
    /// Timing that the gains of the run are certified for; `None` if it is not known.
    pub certified: Option<Certified>,
}

/// Why a log cannot be analysed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AnalysisError {
    /// Nothing in it.
    #[error("the log has no frames")]
    Empty,
    /// No run in it.
    #[error("no run of a plan is in the log: no controller reports that it follows one")]
    NoRun,
    /// The robot file does not assign drives to joints.
    #[error("robot \"{robot}\" has no drives in its file, so the joint of an address is not known")]
    NoDrives { robot: String },
    /// No position of a drive was received during the run.
    #[error("{}joint {joint} has no position during the run", .module.map_or(String::new(), |module| format!("drive {module}, ")))]
    Silent {
        /// Joint, by name.
        joint: String,
        /// Address of its drive, if it has one.
        module: Option<u8>,
    },
}

impl AnalysisError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Empty => {
                "record the run with `--record`, or use the folder of a `cubectl throw`".to_owned()
            }
            Self::NoRun => "record from before the run is ordered until it has ended".to_owned(),
            Self::NoDrives { .. } => "give each [[joint]] a [joint.drive] table with its address".to_owned(),
            Self::Silent { .. } => {
                "check that the log is of this robot; `cubectl log record` must hear all drives".to_owned()
            }
        })
    }
}

/// What a run was like.
#[derive(Clone, Debug, Serialize)]
pub struct RunAnalysis {
    /// Where the log was cut off; who reads the log fills it in.
    pub torn: Option<Tear>,
    /// When the plan began, in time of the log, s.
    pub start_log_s: f64,
    /// How that was found.
    pub start_from: StartFrom,
    /// Release of the plan, in its time, s; `None` if nothing is thrown.
    pub release_t_s: Option<f64>,
    /// End of the plan, in its time, s.
    pub end_t_s: f64,
    /// The controller reported the end of the plan.
    pub completed: bool,
    /// One per joint, in the order of the robot file.
    pub joints: Vec<JointTracking>,
    /// The release, from the measured motion.
    pub release: Option<ReleaseMotion>,
    /// One per supply of the robot file.
    pub supplies: Vec<SupplyCurrents>,
    /// Control cycles during the plan.
    pub cycles: Cycles,
    /// Whether their timing stayed within the certificate of the gains.
    pub coverage: Option<Coverage>,
    /// Answers of the drives during the plan; `None` if the link is not a bus.
    pub answers: Option<Answers>,
    /// Bus time taken; `None` if the link is not a bus.
    pub bus: Option<BusUse>,
    /// What the controller counted between begin and end of the run.
    pub counts: Counts,
    /// What happened, in order.
    #[serde(skip)]
    pub events: Vec<RunEvent>,
    /// The first fault, if there was one.
    pub fault: Option<FirstFault>,
}

/// What the controller counted during the run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Control cycles in which a joint's acceleration was clipped.
    pub cycles_saturated: u16,
    /// Control cycles that began late.
    pub cycles_late: u16,
    /// Answers that did not come in time.
    pub replies_missed: u16,
}

/// Times of a log as times of a plan.
#[derive(Clone, Copy, Debug)]
pub struct PlanClock {
    start: Instant,
}

impl PlanClock {
    #[must_use]
    pub const fn starting(start: Instant) -> Self {
        Self { start }
    }

    /// Time of the plan at a time of the log, s.
    #[must_use]
    pub fn t_s(self, at: Instant) -> f64 {
        at.saturating_since(self.start).as_secs_f64() - self.start.saturating_since(at).as_secs_f64()
    }
}

pub fn analyse(run: &Run<'_>) -> Result<RunAnalysis, AnalysisError> {
    let Run { motion, samples, .. } = *run;
    let end_s = motion.duration_s();
    if samples.is_empty() {
        return Err(AnalysisError::Empty);
    }
    let (starts, start_from) = match run.start {
        Some(at) => (vec![at], StartFrom::Given),
        None => (start::find(&samples.group), StartFrom::Telemetry),
    };
    let (start, heard) = starts
        .into_iter()
        .map(|at| (at, collect::collect(samples, PlanClock::starting(at))))
        .min_by(|(_, a), (_, b)| tracking::unlike(motion, a).total_cmp(&tracking::unlike(motion, b)))
        .ok_or(AnalysisError::NoRun)?;
    let clock = PlanClock::starting(start);
    let bus = samples.bus.as_ref();
    let joints = tracking::joints(run, bus.map(|bus| &bus.drives), &heard)?;
    Ok(RunAnalysis {
        torn: None,
        start_log_s: start.as_secs_f64(),
        start_from,
        release_t_s: run.throw.map(|plan| plan.release_time_s),
        end_t_s: end_s,
        completed: heard.completed(end_s),
        release: release::release(run, &joints, &heard),
        joints,
        supplies: currents::supplies(run, &heard),
        cycles: timing::cycles(&heard, end_s),
        // Without recorded orders nothing can be compared.
        coverage: run
            .certified
            .filter(|_| heard.joints.iter().any(|joint| !joint.commands.is_empty()))
            .map(|certified| coverage::coverage(&heard, end_s, certified)),
        answers: bus.map(|bus| timing::answers(&bus.frames, clock, end_s)),
        bus: bus.map(|bus| bus::usage(&bus.frames, clock, end_s, bus.bit_times)),
        counts: heard.counts(end_s),
        events: events::events(samples, clock),
        fault: events::first_fault(samples, motion, clock),
    })
}

/// The drives of an arm in its robot file.
///
/// # Errors
/// [`AnalysisError::NoDrives`].
pub fn drives_of(arm: &Arm) -> Result<Drives, AnalysisError> {
    Drives::of(arm).ok_or_else(|| AnalysisError::NoDrives { robot: arm.name().to_owned() })
}
