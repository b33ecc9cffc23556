//! What leads to the arm of a verb: a session with a controller on a CAN bus, or an industrial robot that is led over RSI.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use can_link::BusSpec;
use operator::bus::Session;
use operator::interrupt::interrupt;
use operator::job::Record;
use operator::live::LiveServer;
use operator::port::{Interactive, OnBus, Operator as _};
use operator::rsi::program::{Lag, leading, travel};
use planner::follow::limits::AXES;
use planner::plan::Arm;
use planner::way::Travel;
use protocol::cyphal::id::NodeId;

use super::controlled::tell_warnings;
use super::ended::Seen;
use super::folder::Folder;
use super::log::report::MOTION;
use super::plan::follow_options::is_industrial;
use super::rsi::link::{Believed, Opening, RobotLink, motion_csv};
use super::rsi::{LOG, write_description};
use super::target::Target;
use super::web::{WebArgs, show_end};
use crate::error::ExpectedError;

/// The arm of a verb.
pub struct Machine {
    /// Its name or file.
    pub source: String,
    pub arm: Arm,
    /// Of an industrial robot.
    led: Option<Believed>,
}

impl Machine {
    /// The arm that `on` names.
    ///
    /// # Errors
    /// A file is refused, or the bus does not lead to this arm.
    pub fn of(on: &Target) -> Result<Self, ExpectedError> {
        let bus = &on.bus;
        let is_rsi = matches!(bus.bus, BusSpec::Rsi(_));
        let believed = |robot: Option<&str>| {
            Believed::of(&bus.bus, bus.rsi.as_deref(), bus.cell.scenario.as_deref(), robot)
        };
        let named = bus.cell.robot.as_deref();
        let described = if is_rsi { Some(believed(named)?) } else { None };
        let source = match (&described, named) {
            (Some(led), _) => led.described.robot.clone(),
            (None, Some(named)) => named.to_owned(),
            // A scenario may name it.
            (None, None) => bus.cell.load()?.robot_source,
        };
        let arm = super::robot(&source)?;
        let is_led = arm.n() == AXES && is_industrial(&arm);
        match (is_led, &bus.bus) {
            (false, BusSpec::Rsi(_)) => Err(ExpectedError::bad_input(&format!(
                "{source} has no controller of its own, and --bus {} leads to one that has",
                bus.bus
            ))
            .next("name the CAN bus of its drives")),
            (false, _) => Ok(Self { source, arm, led: None }),
            (true, BusSpec::Sim) if bus.record.is_some() => {
                Err(ExpectedError::bad_input(&"--record keeps the frames of a CAN bus; this robot has none")
                    .next("--out DIR keeps the exchange with the robot"))
            }
            (true, BusSpec::Sim | BusSpec::Rsi(_)) => {
                let led = match described {
                    Some(led) => led,
                    None => believed(Some(&source))?,
                };
                Ok(Self { source, arm, led: Some(led) })
            }
            (true, _) => Err(not_on_can(&bus.bus, &source)),
        }
    }

    /// A way of this arm with `share` of its limits; of an industrial robot inside what its program passes.
    #[must_use]
    pub fn travel(&self, share: f64, seed: u64) -> Travel {
        match &self.led {
            Some(led) => travel(&led.described, &self.arm, share, seed),
            None => Travel { share, seed, range: None },
        }
    }

    pub(super) const fn is_led(&self) -> bool {
        self.led.is_some()
    }
}

/// The error of a CAN bus for an industrial robot.
pub(super) fn not_on_can(bus: &BusSpec, robot: &str) -> ExpectedError {
    ExpectedError::bad_input(&format!(
        "--bus {bus} is a CAN bus; {robot} has a controller of its own and is led over RSI"
    ))
    .next("--bus rsi:udp://0.0.0.0:49152, or leave --bus out for the robot inside this program")
}

/// See the [module](self).
pub enum Link {
    /// The session, the controller that was asked for, and the live view.
    Bus(Box<Session>, Option<NodeId>, Option<LiveServer>),
    Led(Box<RobotLink>),
}

pub struct Ended {
    pub(super) seen: Seen,
    /// Whether what was recorded is whole.
    pub(super) finished: Result<(), ExpectedError>,
    robot: Option<Box<RobotLink>>,
    page: Option<LiveServer>,
}

impl Link {
    /// Opens the link to `machine`; its exchange is kept in `folder`, if there is one.
    pub(super) fn open(
        on: &Target,
        machine: &Machine,
        folder: Option<&Folder>,
        quiet: bool,
    ) -> Result<Self, ExpectedError> {
        let log = folder.map(|folder| folder.file(LOG));
        Self::open_until(on, machine, log.as_deref(), quiet, interrupt())
    }

    /// As `open`, with the file of the exchange; what is under way ends once `stop` is set. For programs that have handlers of signals of their own.
    pub fn open_until(
        on: &Target,
        machine: &Machine,
        log: Option<&Path>,
        quiet: bool,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, ExpectedError> {
        let Some(led) = &machine.led else {
            return Ok(Self::Bus(Box::new(on.session_until(stop)?), on.controller, None));
        };
        let described = &led.described;
        let station = leading(described, &machine.arm, Lag::of(described), &[])
            .map_err(|error| ExpectedError::bad_input(&error))?;
        let opening =
            Opening { bus: &on.bus.bus, simulated: led.simulated(on.bus.cell.seed), log, quiet, stop };
        Ok(Self::Led(Box::new(RobotLink::open(opening, described, station)?)))
    }

    /// The same with the live view that `web` asks for.
    ///
    /// # Errors
    /// The port cannot be had, or the link is no bus to look at.
    pub(super) fn watched(mut self, web: &WebArgs, machine: &Machine) -> Result<Self, ExpectedError> {
        match &mut self {
            Self::Bus(session, _, page) => *page = web.serve(session, &machine.arm, None, interrupt())?,
            Self::Led(_) if web.web.is_some() => {
                return Err(ExpectedError::bad_input(
                    "--web shows what passes on a CAN bus; this robot has none",
                )
                .next("leave --web out; --out DIR keeps a report"));
            }
            Self::Led(_) => {}
        }
        Ok(self)
    }

    /// Does `work` with the operator of the arm.
    pub fn with<R>(&mut self, work: impl FnOnce(&mut dyn Interactive) -> R) -> R {
        match self {
            Self::Bus(session, node, _) => work(&mut OnBus::new(session, *node)),
            Self::Led(link) => work(&mut link.operator),
        }
    }

    /// Ends in order; people read what the controller warned of.
    #[must_use]
    pub fn end(self) -> Ended {
        match self {
            Self::Bus(mut session, _, page) => {
                tell_warnings(&mut session);
                // What fails now has no say in what was done.
                let _ = session.halt_if_moving();
                let seen = Seen::of(&session);
                Ended { seen, finished: session.finish().map_err(ExpectedError::from), robot: None, page }
            }
            Self::Led(mut link) => {
                let finished = link.finish();
                let seen = Seen::of_robot(link.name.clone(), link.time, link.answering());
                Ended { seen, finished, robot: Some(link), page: None }
            }
        }
    }
}

impl Ended {
    /// Shows on the live view what it has come to, with the report in `folder`.
    pub(super) fn show(&self, outcome: &str, folder: Option<&Folder>) {
        let Some(page) = &self.page else { return };
        let report = folder.map_or_else(PathBuf::new, |folder| folder.file("report.html"));
        show_end(page, format!("ended: {outcome}"), &report);
    }

    /// Enters what is known of a robot that was led only now, and puts its motion into `folder`.
    pub(super) fn keep(
        &mut self,
        machine: &Machine,
        folder: Option<&Folder>,
        record: Option<&mut Record>,
    ) -> Result<(), ExpectedError> {
        let (Some(link), Some(led)) = (&mut self.robot, &machine.led) else { return Ok(()) };
        let known = link.operator.led();
        if let Some(folder) = folder {
            write_description(&folder.path, &led.described)?;
            folder.write(MOTION, &motion_csv(&led.described, known.as_ref(), link.operator.lines()))?;
        }
        if let Some(record) = record {
            record.led = known;
        }
        Ok(())
    }
}
