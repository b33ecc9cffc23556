//! Scenario files: everything that a run depends on, in TOML.
//!
//! ```toml
//! schema_version = 1
//! name = "joint 3 stops answering"
//! robot = "powercube6"            # name of a built-in robot, or a path
//! seed = 7
//! duration_s = 2.0
//!
//! [bus]
//! bit_rate_bit_s = 1_000_000
//! queue_depth = 32                # frames that can wait in each node
//! tx_order = "fifo"               # or "priority"
//! recovery = "automatic"          # from bus-off; or "on-request"
//!
//! [drive]                         # also [cell], [mechanics], [supply], [gripper], [scatter]
//! processing_delay_s = 0.0002
//! starts_homed = true
//!
//! [[action]]                      # what a scripted host sends
//! at_s = 0.1
//! send = ["0C1#0A62", "0C2#0A62"] # frames as candump writes them
//! every_s = 0.01                  # again and again ...
//! count = 100                     # ... so often; without it until the end
//!
//! [[fault]]
//! kind = "silent"                 # `hil-sim faults` lists all kinds with their keys
//! target = "module 3"
//! start_s = 1.0                   # in a run without a throw
//! at = "release - 0.1 s"          # in a run with one; or "start + 0.2 s"
//! length_s = 0.2
//! probability = 1.0
//!
//! [expect]                        # seen from the bus; a run that breaks one ends with exit code 3
//! answers_within_s = 0.005
//! trips = ["answers"]             # these must break, all others must hold
//! ```
//!
//! Units are in the keys, unknown keys are refused, and every refusal names file, line and key.

pub mod build;
mod cell;
mod expect;
pub mod faults;
pub mod host;
pub(crate) mod values;
pub mod write;

use std::path::Path;

use protocol::{Duration, Frame, Instant};
pub use toml_reader::Problem;
use toml_reader::{DocumentError, Section, Source, Value};

use crate::bus::{BusConfig, Recovery, TxOrder};
use crate::cell::CellOptions;
pub use crate::checker::Expect;
use crate::fault::Fault;
pub use build::BuildError;
pub use host::ScriptedHost;
pub use values::parse_frame;
use values::{frames, period, seconds};

/// A scenario was refused: where, and why.
pub type ScenarioError = DocumentError;

/// Version of scenario files that this program reads.
pub const SCHEMA_VERSION: i64 = 1;

/// Longest run: eleven days.
const MAX_S: f64 = 1e6;

/// What a scripted host sends.
#[derive(Clone, Debug, PartialEq)]
pub struct Action {
    /// When, first.
    pub at: Instant,
    /// What, in this order.
    pub frames: Vec<Frame>,
    /// Period of repetition; `None`: once.
    pub every: Option<Duration>,
    /// How often in all; `None`: until the end.
    pub count: Option<u64>,
}

/// Everything that a run depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    pub file: String,
    /// What people call it.
    pub name: String,
    /// Built-in name or path of the robot file.
    pub robot: String,
    /// Feeds all random streams.
    pub seed: u64,
    /// Length of the run.
    pub duration: Duration,
    pub bus: BusConfig,
    /// Options of drives, mechanics, supplies and gripper.
    pub cell: CellOptions,
    /// What a scripted host sends.
    pub actions: Vec<Action>,
    pub faults: Vec<Fault>,
    pub expect: Expect,
}

impl Default for Scenario {
    fn default() -> Self {
        Self {
            file: "<none>".to_owned(),
            name: "unnamed".to_owned(),
            robot: "powercube6".to_owned(),
            seed: 0,
            duration: Duration::from_secs(1),
            bus: BusConfig::default(),
            cell: CellOptions::default(),
            actions: Vec::new(),
            faults: Vec::new(),
            expect: Expect::default(),
        }
    }
}

impl Scenario {
    /// Reads a file.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        let file = path.display().to_string();
        match toml_reader::read_text(path, toml_reader::DESCRIPTION_MAX_BYTES) {
            Ok(text) => Self::from_toml(&file, &text),
            Err(error) => Err(DocumentError::of_file(&file, Problem::unreadable(&error))),
        }
    }

    /// Reads a text; `file` is its name in errors.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, ScenarioError> {
        let source = Source { file, text };
        let document = source.parse()?;
        let root: Section<'_> = source.root(&document);
        root.schema("schema_version", SCHEMA_VERSION)?;
        let default = Self::default();
        let duration_s = root.required("duration_s", |v| v.number_in(1e-6, MAX_S))?;
        let bus = match root.optional("bus", Value::section)? {
            Some(table) => bus(&table)?,
            None => default.bus,
        };
        let scenario = Self {
            file: file.to_owned(),
            name: root.or("name", &*default.name, Value::text)?.to_owned(),
            robot: root.or("robot", &*default.robot, Value::text)?.to_owned(),
            seed: root.or("seed", default.seed, Value::count)?,
            duration: Duration::from_secs_f64(duration_s),
            bus,
            cell: cell::cell(&root, bus.bit_rate_bit_s)?,
            actions: root.sections("action")?.iter().map(action).collect::<Result<_, _>>()?,
            faults: faults_of(&root)?,
            expect: match root.optional("expect", Value::section)? {
                Some(table) => expect::expect(&table)?,
                None => Expect::default(),
            },
        };
        root.finish()?;
        Ok(scenario)
    }
}

fn bus(table: &Section<'_>) -> Result<BusConfig, ScenarioError> {
    const ORDER: [(&str, TxOrder); 2] = [("fifo", TxOrder::Fifo), ("priority", TxOrder::Priority)];
    const RECOVERY: [(&str, Recovery); 2] =
        [("automatic", Recovery::Automatic), ("on-request", Recovery::OnRequest)];
    let d = BusConfig::default();
    let rate = |value: &Value<'_>| {
        let rate = value.integer(10_000..=1_000_000)?;
        if 1_000_000_000 % rate == 0 {
            return Ok(rate as u32);
        }
        let problem = format!("{rate} bit/s: a bit must last a whole number of nanoseconds");
        Err(value.error(Problem::Invalid(problem)))
    };
    let config = BusConfig {
        bit_rate_bit_s: table.or("bit_rate_bit_s", d.bit_rate_bit_s, rate)?,
        // The robot file says it.
        data_bit_rate_bit_s: d.data_bit_rate_bit_s,
        queue_depth: table.or("queue_depth", d.queue_depth, |v| Ok(v.integer(1..=65_536)? as usize))?,
        tx_order: table.or("tx_order", d.tx_order, |v| v.word(&ORDER))?,
        recovery: table.or("recovery", d.recovery, |v| v.word(&RECOVERY))?,
    };
    table.finish()?;
    Ok(config)
}

fn action(table: &Section<'_>) -> Result<Action, ScenarioError> {
    let frames = table.required("send", |value| match frames(value)? {
        frames if frames.is_empty() => Err(value.error(Problem::Invalid("at least one frame".to_owned()))),
        frames => Ok(frames),
    })?;
    let action = Action {
        at: Instant::ZERO + table.or("at_s", Duration::ZERO, |v| seconds(v, MAX_S))?,
        frames,
        every: table.optional("every_s", |v| period(v, MAX_S))?,
        count: table.optional("count", |v| Ok(v.integer(1..=1_000_000_000)? as u64))?,
    };
    if action.count.is_some() && action.every.is_none() {
        return Err(table.error("count", Problem::Invalid("needs every_s".to_owned())));
    }
    table.finish()?;
    Ok(action)
}

/// All `[[fault]]` tables; labels must differ, because they name the random streams.
fn faults_of(root: &Section<'_>) -> Result<Vec<Fault>, ScenarioError> {
    let mut faults: Vec<Fault> = Vec::new();
    for (index, table) in root.sections("fault")?.iter().enumerate() {
        let fault = faults::fault(table, index)?;
        if faults.iter().any(|other| other.label == fault.label) {
            let problem = format!("'{}' is taken by an earlier fault", fault.label);
            return Err(table.error("label", Problem::Invalid(problem)));
        }
        faults.push(fault);
    }
    Ok(faults)
}

/// Reads one fault from TOML on a line of its own, as typed at a running simulator:
/// `kind = "drop", target = "module 3", length_s = 2`.
pub fn fault_from_line(line: &str, index: usize) -> Result<Fault, ScenarioError> {
    let text = format!("fault = {{ {line} }}");
    let source = Source { file: "<command>", text: &text };
    let document = source.parse()?;
    faults::fault(&source.root(&document).required("fault", Value::section)?, index)
}
