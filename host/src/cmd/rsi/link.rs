//! The link to a robot that is led: one that connects to this machine, or one inside this program in virtual time.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use can_link::{BusSpec, Urgent};
use hil_sim::krc::KrcScenario;
use operator::port::Operator as _;
use operator::rsi::cell::SimulatedRobot;
use operator::rsi::cycles::cycles;
use operator::rsi::live::Live;
use operator::rsi::log::Line;
use operator::rsi::operator::{Led, LedRobot, Place};
use operator::rsi::program::can_be_led;
use operator::rsi::station::Station;

use super::{LogFile, description, listen};
use crate::error::ExpectedError;
use crate::report::motion;

/// What is believed of a robot and its program, and what is true of a simulated one where a scenario says it.
pub(crate) struct Believed {
    pub(crate) truth: Option<KrcScenario>,
    pub(crate) described: KrcScenario,
}

impl Believed {
    /// The description `rsi`; else that of the scenario with the usual lag and gripper, which the client cannot know; else the usual
    /// one. `robot`, if it is given, is the arm of all of them.
    ///
    /// # Errors
    /// A file is refused, or such a program cannot be led.
    pub(crate) fn of(
        bus: &BusSpec,
        rsi: Option<&str>,
        scenario: Option<&Path>,
        robot: Option<&str>,
    ) -> Result<Self, ExpectedError> {
        let truth = scenario.map(KrcScenario::load).transpose();
        let mut truth = truth.map_err(|error| ExpectedError::bad_input(&error))?;
        let tcp = matches!(bus, BusSpec::Rsi(spec) if spec.tcp);
        let usual = if tcp { "kr-c2-tcp" } else { "kr-c2" };
        let mut described = description(Some(rsi.unwrap_or(usual)))?;
        if let (None, Some(truth)) = (rsi, &truth) {
            let usual = described;
            described = truth.clone();
            described.options.lag = usual.options.lag;
            described.options.hand.gripper = usual.options.hand.gripper;
        }
        if let Some(robot) = robot {
            for known in std::iter::once(&mut described).chain(&mut truth) {
                robot.clone_into(&mut known.robot);
            }
        }
        can_be_led(&described).map_err(|error| ExpectedError::bad_input(&error))?;
        Ok(Self { truth, described })
    }

    /// The robot inside this program.
    pub(crate) fn simulated(&self, seed: Option<u64>) -> KrcScenario {
        let mut scenario = self.truth.clone().unwrap_or_else(|| self.described.clone());
        scenario.seed = seed.unwrap_or(scenario.seed);
        scenario
    }
}

/// See the [module](self).
pub struct RobotLink {
    pub(crate) operator: LedRobot<'static>,
    log: Option<(PathBuf, Rc<RefCell<LogFile>>)>,
    urgent: Option<Urgent>,
    /// The link, and whose time counts, as people read it.
    pub(crate) name: String,
    pub(crate) time: &'static str,
}

pub(crate) struct Opening<'a> {
    pub(crate) bus: &'a BusSpec,
    /// The robot if the bus is `sim`.
    pub(crate) simulated: KrcScenario,
    /// File of the exchange.
    pub(crate) log: Option<&'a Path>,
    pub(crate) quiet: bool,
    pub(crate) stop: Arc<AtomicBool>,
}

impl RobotLink {
    /// Leads the robot of `opening`, which `described` describes, with a station that has no motions yet.
    ///
    /// # Errors
    /// The address or the file of the exchange cannot be had, or the scenario makes no robot.
    pub(crate) fn open(
        opening: Opening<'_>,
        described: &KrcScenario,
        station: Station,
    ) -> Result<Self, ExpectedError> {
        let Opening { bus, simulated, log, quiet, stop } = opening;
        let (place, urgent, time) = match bus {
            BusSpec::Rsi(spec) => {
                let (port, time, urgent) = listen(spec, described, quiet)?;
                if !quiet {
                    console::note!("{bus}: waiting for the robot; start its program now");
                }
                let whose = if spec.lockstep { "time of the robot" } else { "real time" };
                (Place::Outside(Box::new(Live::new(port, time))), urgent, whose)
            }
            _ => {
                let robot =
                    SimulatedRobot::new(&simulated).map_err(|error| ExpectedError::bad_input(&error))?;
                (Place::Inside(Box::new(robot)), None, "virtual time")
            }
        };
        let log = match log {
            Some(path) => Some((path.to_owned(), Rc::new(RefCell::new(LogFile::create(path)?)))),
            None => None,
        };
        let file = log.as_ref().map(|(_, file)| Rc::clone(file));
        let write = Box::new(move |lines: &[Line]| {
            if let Some(file) = &file {
                file.borrow_mut().write(lines);
            }
        });
        let operator = LedRobot::new(described.clone(), station, place, stop, write);
        Ok(Self { operator, log, urgent, name: bus.to_string(), time })
    }

    /// Lets the robot go, and writes what is left of the exchange.
    ///
    /// # Errors
    /// The exchange is not whole on the disk.
    pub(crate) fn finish(&mut self) -> Result<(), ExpectedError> {
        self.operator.leave();
        self.log.as_ref().map_or(Ok(()), |(path, file)| file.borrow_mut().finish(path))
    }

    /// Rights of the thread that answered the robot.
    pub(crate) fn answering(&self) -> Option<String> {
        self.urgent.as_ref().map(|urgent| urgent.granted().to_string())
    }
}

/// Set and actual axes by cycle, from the begin of the last motion: true ones of a simulated robot, else those of the telegrams.
pub(crate) fn motion_csv(described: &KrcScenario, led: Option<&Led>, lines: &[Line]) -> String {
    let krc = &described.options;
    let table = match led.and_then(|led| led.seen.as_ref()) {
        Some(seen) => motion::of_robot(seen),
        None => motion::of_telegrams(&cycles(
            lines,
            &described.config,
            &krc.outputs_name,
            krc.sensor_name.as_deref(),
        )),
    };
    motion::csv(&table, led.and_then(|led| led.started_at))
}
