//! Verbs for an industrial robot behind RSI: it connects to this machine, and is held or led from here.
//!
//! | file | verb |
//! |---|---|
//! | `probe` | `doctor` and `status`: hold the robot and report what its telegrams contain |
//! | `record` | hold the robot and write the exchange |
//! | `replay` | run a station on a recorded exchange again |
//! | `link` | no verb: opens the link to a robot that is led |
//! | `identify` | measure lag and gripper of this robot |

mod identify;
pub mod link;
mod probe;
mod record;
mod replay;

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use can_link::{BusSpec, Granted, Role, RsiSpec, Urgent};
use hil_sim::krc::KrcScenario;
use operator::bus::BusArgs;
use operator::dialogue::operator::OperatorError;
use operator::interrupt::interrupt;
use operator::rsi::live::{Exchange, Host, Port, Time, serve};
use operator::rsi::log::{Entry, HEAD, Line};
use operator::rsi::station::Station;
use planner::follow::limits::Arm;
use protocol::{Duration, Instant};

use crate::error::ExpectedError;
use crate::exit;

pub use identify::RobotIdentification;
pub use probe::{doctor, status};
pub use record::{record, write_description};
pub use replay::{history, is_recording, replay};

/// Name of the log in the folder of a throw.
pub const LOG: &str = "log.rsi";
/// Name of the description of the robot in the folder of a throw.
pub const DESCRIPTION: &str = "robot.toml";
/// Name of the configuration file in the folder of a throw.
pub const CONFIG: &str = "rsi_config.xml";
/// Lines of an exchange that are kept beside the file; the oldest go first. A throw takes 6 000, a measurement 20 000.
const LINES_MAX: usize = 100_000;
/// Time between two writes of a log to the disk.
const FLUSH_EVERY: Duration = Duration::from_millis(200);

/// The description of the robot and its program.
pub fn description(source: Option<&str>) -> Result<KrcScenario, ExpectedError> {
    KrcScenario::open(source.unwrap_or("kr-c2")).map_err(|error| ExpectedError::bad_input(&error))
}

/// Description and arm for a verb with the options of a bus; `None`: the bus leads to no such robot.
pub fn robot_on(bus: &BusArgs) -> Result<Option<(RsiSpec, KrcScenario, Arm)>, ExpectedError> {
    let BusSpec::Rsi(spec) = &bus.bus else { return Ok(None) };
    let mut described = description(bus.rsi.as_deref())?;
    if let Some(robot) = &bus.cell.robot {
        described.robot.clone_from(robot);
    }
    let arm = super::six_axes(&described.robot)?;
    Ok(Some((spec.clone(), described, arm)))
}

/// A log of an exchange that is written as it goes on.
pub struct LogFile {
    file: BufWriter<File>,
    flushed: Instant,
    written: std::io::Result<()>,
}

impl LogFile {
    pub fn create(path: &Path) -> Result<Self, ExpectedError> {
        let create = || {
            let mut file = BufWriter::new(File::create_new(path)?);
            writeln!(file, "{HEAD}")?;
            Ok(file)
        };
        let file = create().map_err(|error| ExpectedError::output(path, &error))?;
        Ok(Self { file, flushed: Instant::ZERO, written: Ok(()) })
    }

    /// Writes some lines; after one that cannot be written none is.
    pub fn write(&mut self, lines: &[Line]) {
        for line in lines {
            if self.written.is_ok() {
                self.written = self.file.write_all(line.to_text().as_bytes());
            }
        }
        if let Some(last) = lines.last()
            && last.at.saturating_since(self.flushed) >= FLUSH_EVERY
            && self.written.is_ok()
        {
            self.flushed = last.at;
            self.written = self.file.flush();
        }
    }

    /// Writes what is left.
    pub fn finish(&mut self, path: &Path) -> Result<(), ExpectedError> {
        let written = std::mem::replace(&mut self.written, Ok(()));
        written.and_then(|()| self.file.flush()).map_err(|error| ExpectedError::output(path, &error))
    }
}

/// What a program does while it serves a robot.
pub struct Watch<'a> {
    stop: Arc<AtomicBool>,
    until: Option<Instant>,
    file: Option<LogFile>,
    /// The last lines, as many as [`Watch::keeping`] says.
    lines: VecDeque<Line>,
    lines_max: usize,
    /// Why the robot is not waited for any longer.
    gave_up: Option<String>,
    /// Telegrams and answers of the exchange.
    pub count: (u64, u64),
    /// The exchange goes on after the last motion.
    pub stays: bool,
    is_noted: bool,
    name: String,
    quiet: bool,
    each: &'a mut dyn FnMut(Instant, &mut Station) -> bool,
}

impl<'a> Watch<'a> {
    /// Ends after `span`, at Ctrl-C, or when `each`, called with every telegram, says no.
    pub fn new(
        name: String,
        span: Option<f64>,
        quiet: bool,
        each: &'a mut dyn FnMut(Instant, &mut Station) -> bool,
    ) -> Self {
        Self {
            stop: interrupt(),
            until: span.map(|s| Instant::ZERO + Duration::from_secs_f64(s)),
            file: None,
            lines: VecDeque::new(),
            lines_max: LINES_MAX,
            gave_up: None,
            count: (0, 0),
            stays: false,
            is_noted: false,
            name,
            quiet,
            each,
        }
    }

    /// Writes the exchange to a file as it goes on.
    pub fn recording(mut self, file: LogFile) -> Self {
        self.file = Some(file);
        self
    }

    /// Keeps so many lines beside the file. Without any, a file that cannot be written ends the exchange.
    pub const fn keeping(mut self, lines: usize) -> Self {
        self.lines_max = lines;
        self
    }

    pub fn take_lines(&mut self) -> Vec<Line> {
        std::mem::take(&mut self.lines).into()
    }

    /// Whether the robot became ready, if it was heard.
    ///
    /// # Errors
    /// What was heard of it.
    pub fn require_ready(&self) -> Result<(), ExpectedError> {
        let Some(heard) = self.gave_up.clone() else { return Ok(()) };
        Err(ExpectedError::new(
            exit::BUS,
            format!("{}: {}", self.name, OperatorError::RobotNotReady { heard }),
        ))
    }

    /// True after Ctrl-C.
    pub fn was_interrupted(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The file of [`Watch::recording`].
    pub fn take_file(&mut self) -> Option<LogFile> {
        self.file.take()
    }
}

impl Host for Watch<'_> {
    fn goes_on(&mut self, now: Instant, station: &mut Station) -> bool {
        if !self.is_noted && !self.quiet {
            console::note!("{}: waiting for the robot; start its program now", self.name);
            self.is_noted = true;
        }
        let over = self.until.is_some_and(|until| now >= until);
        let records_only = self.lines_max == 0;
        let is_written = !records_only || self.file.as_ref().is_none_or(|file| file.written.is_ok());
        if !records_only {
            self.gave_up = self.gave_up.take().or_else(|| station.waits_in_vain(now));
        }
        !over && is_written && self.gave_up.is_none() && !self.was_interrupted() && (self.each)(now, station)
    }

    fn stays(&self) -> bool {
        self.stays
    }

    fn log(&mut self, lines: Vec<Line>) {
        if let Some(file) = &mut self.file {
            file.write(&lines);
        }
        for line in &lines {
            match &line.entry {
                Entry::Telegram(_) | Entry::Waited(_) => self.count.0 += 1,
                Entry::Answer(_) => self.count.1 += 1,
                _ => {}
            }
        }
        self.lines.extend(lines);
        self.lines.drain(..self.lines.len().saturating_sub(self.lines_max));
    }
}

/// Where the robot at `spec` connects to, whose time counts, and the rights to answer it in time.
pub fn listen(
    spec: &RsiSpec,
    described: &KrcScenario,
    quiet: bool,
) -> Result<(Port, Time, Option<Urgent>), ExpectedError> {
    let address = address_of(&spec.host, spec.port).map_err(|error| {
        failed(spec, &error, "name an address of this machine, or 0.0.0.0 for all of them")
    })?;
    let port = Port::bind(spec.tcp, address).map_err(|error| {
        failed(spec, &error, "name an address of this machine and a port that no other program has")
    })?;
    if described.config.port != address.port() && address.port() != 0 && !quiet {
        console::note!(
            "the configuration file sends the robot to port {}, this program listens at {}",
            described.config.port,
            address.port()
        );
    }
    Ok(if spec.lockstep {
        (port, Time::Robot(described.options.cycle), None)
    } else {
        (port, Time::Clock, Some(Urgent::request(Role::Controller)))
    })
}

fn failed(spec: &RsiSpec, what: &dyn std::fmt::Display, next: &str) -> ExpectedError {
    ExpectedError::new(exit::BUS, format!("rsi:{spec}: {what}")).next(next)
}

/// Serves the robot at `spec` until the end.
pub fn serve_at(
    spec: &RsiSpec,
    described: &KrcScenario,
    station: &mut Station,
    watch: &mut Watch<'_>,
) -> Result<(Exchange, Option<Granted>), ExpectedError> {
    let (mut port, time, urgent) = listen(spec, described, watch.quiet)?;
    let exchange = serve(&mut port, station, time, watch)
        .map_err(|error| failed(spec, &error, "check the network interface, then run it again"))?;
    Ok((exchange, urgent.map(|urgent| urgent.granted())))
}

/// The first address of a host.
pub(super) fn address_of(host: &str, port: u16) -> std::io::Result<SocketAddr> {
    let mut found = (host, port).to_socket_addrs()?;
    found.next().ok_or_else(|| std::io::Error::new(std::io::ErrorKind::NotFound, "no address"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_beside_the_file_are_the_last_ones_and_bounded() {
        let mut on = |_, _: &mut Station| true;
        let mut watch = Watch::new("rsi".to_owned(), None, true, &mut on).keeping(1_000);
        for k in 0..50 {
            let line =
                |i: u64| Line { at: Instant::from_micros(100 * k + i), entry: Entry::Answer(vec![0; 100]) };
            watch.log((0..100).map(line).collect());
            assert!(watch.lines.len() <= 1_000);
        }
        assert_eq!(watch.count, (0, 5_000));
        let lines = watch.take_lines();
        assert_eq!((lines.len(), lines[999].at), (1_000, Instant::from_micros(4_999)));
        let mut on = |_, _: &mut Station| true;
        let mut recording = Watch::new("rsi".to_owned(), None, true, &mut on).keeping(0);
        recording.log(vec![Line { at: Instant::ZERO, entry: Entry::Telegram(Vec::new()) }]);
        assert_eq!((recording.lines.len(), recording.count), (0, (1, 0)));
    }
}
