//! Invariants seen from the bus: checkers know frames and limits, but no node.
//!
//! | file | requires |
//! |---|---|
//! | [`mod@expect`] | names of the checkers; which of them a run uses |
//! | [`answers`] | every request is answered in time, every answer belongs to a request |
//! | [`limits`] | targets, velocities, accelerations and currents stay within the robot's limits |
//! | [`homing`] | no motion before the module has reported its reference |
//! | [`stop`] | after a halt the reported position comes to rest in time |
//! | [`traffic`] | number of frames, utilisation |
//!
//! A checker is an independent reading of the rules: it shares the codec with the drives, but no state.

pub mod answers;
pub mod expect;
pub mod homing;
pub mod limits;
pub mod stop;
pub mod traffic;

use std::fmt;

use protocol::{Frame, Instant, ModuleId};
use serde::Serialize;

use crate::bus::BusConfig;
use crate::world::Observer;
pub use expect::{Check, Expect};
pub use limits::ModuleLimits;

/// Violations kept per checker; later ones are only counted.
const KEPT_MAX: usize = 100;

/// An invariant that did not hold.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Violation {
    pub check: Check,
    /// When, microseconds.
    pub at_us: u64,
    /// Which module, if it is about one.
    pub module: Option<u8>,
    pub what: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} s {}: ", Instant::from_micros(self.at_us), self.check.name())?;
        if let Some(module) = self.module {
            write!(f, "module {module}: ")?;
        }
        f.write_str(&self.what)
    }
}

/// Where a checker puts what it found.
#[derive(Clone, Debug)]
pub struct Findings {
    check: Check,
    kept: Vec<Violation>,
    count: u64,
}

impl Findings {
    fn new(check: Check) -> Self {
        Self { check, kept: Vec::new(), count: 0 }
    }

    pub fn add(&mut self, at: Instant, module: Option<ModuleId>, what: impl FnOnce() -> String) {
        self.count += 1;
        if self.kept.len() < KEPT_MAX {
            let module = module.map(ModuleId::get);
            self.kept.push(Violation { check: self.check, at_us: at.as_micros(), module, what: what() });
        }
    }
}

pub trait Checker: fmt::Debug + Send {
    /// Takes a frame of the bus.
    fn on_frame(&mut self, at: Instant, frame: &Frame, findings: &mut Findings);

    /// The run is over.
    fn finish(&mut self, end: Instant, findings: &mut Findings) {
        let _ = (end, findings);
    }
}

#[derive(Debug, Default)]
pub struct Checkers {
    entries: Vec<(Box<dyn Checker>, Findings)>,
    finished: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckResult {
    pub check: Check,
    pub violations: u64,
    /// True if the scenario expects a violation.
    pub expected_to_trip: bool,
    pub first: Vec<Violation>,
}

impl CheckResult {
    /// True if the result is the one that the scenario expects.
    pub fn as_expected(&self) -> bool {
        (self.violations > 0) == self.expected_to_trip
    }
}

impl Checkers {
    /// The checkers that a scenario lists. `limits` names the modules of the robot.
    pub fn new(expect: &Expect, limits: &[ModuleLimits], bus: &BusConfig) -> Self {
        let mut checkers = Self::default();
        if let Some(within) = expect.answers_within {
            let modules = limits.iter().map(|limit| limit.module);
            checkers.add(Check::Answers, answers::Answers::new(within, modules));
        }
        if expect.limits {
            checkers.add(Check::Limits, limits::Limits::new(limits));
        }
        if expect.homing {
            checkers.add(Check::Homing, homing::Homing::default());
        }
        if let Some(within) = expect.stop_within {
            checkers.add(Check::Stop, stop::Stop::new(within));
        }
        if expect.frames_min.is_some() || expect.utilisation_max.is_some() {
            let traffic = traffic::Traffic::new(expect.frames_min, expect.utilisation_max, bus);
            checkers.add(Check::Traffic, traffic);
        }
        checkers
    }

    fn add(&mut self, check: Check, checker: impl Checker + 'static) {
        self.entries.push((Box::new(checker), Findings::new(check)));
    }

    /// Ends the run and returns the results; `expect` lists the checkers that must find a violation.
    pub fn finish(&mut self, end: Instant, expect: &Expect) -> Vec<CheckResult> {
        if !self.finished {
            self.finished = true;
            for (checker, findings) in &mut self.entries {
                checker.finish(end, findings);
            }
        }
        self.entries
            .iter()
            .map(|(_, findings)| CheckResult {
                check: findings.check,
                violations: findings.count,
                expected_to_trip: expect.trips.contains(&findings.check),
                first: findings.kept.clone(),
            })
            .collect()
    }
}

impl Observer for Checkers {
    fn on_frame(&mut self, at: Instant, _from: Option<usize>, frame: &Frame) {
        for (checker, findings) in &mut self.entries {
            checker.on_frame(at, frame, findings);
        }
    }
}
