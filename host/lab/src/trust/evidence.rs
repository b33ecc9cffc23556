//! What a run leaves behind: what was reported to the user, what the plant did, what was on the bus.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io;
use std::rc::Rc;

use hil_sim::cell::ThrowReport;
use hil_sim::witness::Trace;
use nalgebra::Vector3;
use operator::job::BallOutcome;
use operator::job::Step;
use operator::log::facts::{Decoder, Fact};
use operator::tap::{Tap, Way};
use planner::plan::Arm;
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::powercube::{Broadcast, Parameter, Request, Value};
use protocol::{Frame, Instant};

/// Rounding of limits to single precision.
const ROUNDING: f64 = 1.0 + 1e-5;
/// Commands beyond limits that are kept as text.
const BEYOND_MAX: usize = 8;

/// The outcome as the program reports it.
#[derive(Clone, Debug, PartialEq)]
pub enum ReportedOutcome {
    Landed,
    /// The ball landed too far from the target, or touched the arm.
    Missed,
    /// The ball did not leave the hand.
    NotReleased,
    /// The controller stopped or refused, and named the cause.
    Cause {
        cause: u16,
        /// Joint from 1; 0 for the group.
        joint: u8,
    },
    /// The job ended with another error.
    Failed(String),
    Panicked(String),
}

/// What became of the ball, as the plant shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Seen {
    /// It left the hand and landed within the tolerance.
    Landed {
        error_m: f64,
    },
    /// It left the hand and landed too far away.
    Missed {
        error_m: f64,
    },
    /// It left the hand and touched the arm.
    Touched,
    /// It left the hand and does not come down on the plane of the target.
    Away,
    NotReleased,
}

impl Seen {
    /// From the report of the cell, and the target.
    pub fn of(ball: &ThrowReport, target_m: &Vector3<f64>, tolerance_m: f64) -> Self {
        if ball.released_at.is_none() {
            return Self::NotReleased;
        }
        if ball.touch.is_some() {
            return Self::Touched;
        }
        match ball.landing {
            None => Self::Away,
            Some(landing) => match (landing.p_m - target_m).norm() {
                error_m if error_m <= tolerance_m => Self::Landed { error_m },
                error_m => Self::Missed { error_m },
            },
        }
    }
}

#[derive(Clone, Debug)]
pub struct Evidence {
    pub reported: ReportedOutcome,
    /// What it reports of the ball, also after a stop.
    pub reported_ball: BallOutcome,
    /// Truth of the ball.
    pub seen: Seen,
    pub ball: ThrowReport,
    /// Truth of the joints.
    pub trace: Trace,
    pub bus: BusLog,
    /// Steps of the job that ended, and the one at work when it failed.
    pub steps: Vec<(Step, Instant, Instant)>,
    /// When the job ended; the trace goes on after it.
    pub job_end: Instant,
    pub end: Instant,
    /// The simulated world broke down, as text.
    pub broken: Option<String>,
}

impl Evidence {
    pub fn step(&self, wanted: Step) -> Option<(Instant, Instant)> {
        self.steps.iter().find(|(step, ..)| *step == wanted).map(|(_, begin, end)| (*begin, *end))
    }
}

#[derive(Clone, Debug, Default)]
pub struct BusLog {
    /// Every message of the controller's state.
    pub states: Vec<(Instant, GroupState)>,
    pub halts: Vec<Instant>,
    /// Commands beyond the limits of the robot file, as text.
    pub beyond: Vec<String>,
}

impl BusLog {
    /// First message that reports `wanted`, at or after `from`.
    pub fn first(&self, from: Instant, wanted: impl Fn(State) -> bool) -> Option<Instant> {
        self.states.iter().find(|(at, group)| *at >= from && wanted(group.state)).map(|(at, _)| *at)
    }
}

/// Writes the [`BusLog`]; clones share it.
#[derive(Clone)]
pub struct BusTap {
    decoder: Decoder,
    limits: Rc<BTreeMap<u8, [f64; 2]>>,
    log: Rc<RefCell<BusLog>>,
}

impl BusTap {
    /// For the drives of an arm.
    pub fn new(arm: &Arm) -> Self {
        let drives = arm.drives().into_iter().flatten();
        let limits = arm.joints().iter().zip(drives).map(|(joint, drive)| {
            (drive.address, [joint.limits.v_max_rad_s, joint.limits.a_control_max_rad_s2])
        });
        Self { decoder: Decoder::default(), limits: Rc::new(limits.collect()), log: Rc::default() }
    }

    pub fn take(&self) -> BusLog {
        self.log.take()
    }
}

impl Tap for BusTap {
    fn frame(&mut self, at: Instant, _: Way, frame: &Frame) -> io::Result<()> {
        let Some(fact) = self.decoder.take(at, frame) else { return Ok(()) };
        let mut log = self.log.borrow_mut();
        match fact {
            Fact::Group { state, .. } => log.states.push((at, state)),
            Fact::Broadcast(Broadcast::Halt) => log.halts.push(at),
            Fact::Request { module, request: Request::Set(parameter, Value::F32(value)) } => {
                let Some([v_max_rad_s, a_max_rad_s2]) = self.limits.get(&module.get()) else { return Ok(()) };
                let max = match parameter {
                    Parameter::TargetVel => v_max_rad_s,
                    Parameter::TargetAcc => a_max_rad_s2,
                    _ => return Ok(()),
                };
                let within = f64::from(value).abs() <= max * ROUNDING;
                if !within && log.beyond.len() < BEYOND_MAX {
                    log.beyond.push(format!("{at}: module {module}: {} = {value}", parameter.name()));
                }
            }
            _ => {}
        }
        Ok(())
    }
}
