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
//! start_s = 1.0
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
pub mod expect;
pub mod faults;
pub mod host;
pub mod reader;

use std::path::Path;

use protocol::{Duration, Frame, Instant};

use crate::bus::{BusConfig, Recovery, TxOrder};
use crate::cell::CellOptions;
use crate::fault::Fault;
pub use build::BuildError;
pub use expect::Expect;
pub use host::ScriptedHost;
pub use reader::{Problem, ScenarioError, Table};

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
    /// File it came from.
    pub file: String,
    /// What people call it.
    pub name: String,
    /// Built-in name or path of the robot file.
    pub robot: String,
    /// Feeds all random streams.
    pub seed: u64,
    /// Length of the run.
    pub duration: Duration,
    /// Options of the bus.
    pub bus: BusConfig,
    /// Options of drives, mechanics, supplies and gripper.
    pub cell: CellOptions,
    /// What a scripted host sends.
    pub actions: Vec<Action>,
    /// What goes wrong.
    pub faults: Vec<Fault>,
    /// What must hold.
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
        match std::fs::read_to_string(path) {
            Ok(text) => Self::from_toml(&file, &text),
            Err(error) => {
                let problem = Problem::Unreadable(error.to_string());
                Err(ScenarioError { file, line: None, key: String::new(), problem })
            }
        }
    }

    /// Reads a text; `file` is what errors call it.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, ScenarioError> {
        let document = reader::parse(file, text)?;
        let root = Table::root(file, text, &document);
        let version = root
            .integer("schema_version", 0, i64::MAX)?
            .ok_or_else(|| root.error("schema_version", Problem::Missing))?;
        if version != SCHEMA_VERSION {
            let problem = Problem::Schema { found: version, supported: SCHEMA_VERSION };
            return Err(root.error("schema_version", problem));
        }
        let default = Self::default();
        let duration_s = root.required_number("duration_s", 1e-6, MAX_S)?;
        let bus = root.table("bus")?.map_or(Ok(default.bus), |table| bus(&table))?;
        let scenario = Self {
            file: file.to_owned(),
            name: root.text("name")?.unwrap_or(&default.name).to_owned(),
            robot: root.text("robot")?.unwrap_or(&default.robot).to_owned(),
            seed: root.integer("seed", 0, i64::MAX)?.unwrap_or(0) as u64,
            duration: Duration::from_secs_f64(duration_s),
            bus,
            cell: cell::cell(&root, bus.bit_rate_bit_s)?,
            actions: root.tables("action")?.iter().map(action).collect::<Result<_, _>>()?,
            faults: faults_of(&root)?,
            expect: root.table("expect")?.map_or(Ok(Expect::default()), |table| expect::expect(&table))?,
        };
        root.finish()?;
        Ok(scenario)
    }
}

fn bus(table: &Table<'_>) -> Result<BusConfig, ScenarioError> {
    let default = BusConfig::default();
    let rate = table.integer("bit_rate_bit_s", 10_000, 1_000_000)?.unwrap_or(1_000_000);
    if 1_000_000_000 % rate != 0 {
        let problem = format!("{rate} bit/s: a bit must last a whole number of nanoseconds");
        return Err(table.error("bit_rate_bit_s", Problem::Invalid(problem)));
    }
    let config = BusConfig {
        bit_rate_bit_s: rate as u32,
        queue_depth: table
            .integer("queue_depth", 1, 65_536)?
            .map_or(default.queue_depth, |depth| depth as usize),
        tx_order: table
            .word("tx_order", &[("fifo", TxOrder::Fifo), ("priority", TxOrder::Priority)])?
            .unwrap_or_default(),
        recovery: table
            .word("recovery", &[("automatic", Recovery::Automatic), ("on-request", Recovery::OnRequest)])?
            .unwrap_or_default(),
        bit_by_bit: table.boolean("bit_by_bit")?.unwrap_or(false),
    };
    table.finish()?;
    Ok(config)
}

fn action(table: &Table<'_>) -> Result<Action, ScenarioError> {
    let frames = table.frames("send")?.ok_or_else(|| table.error("send", Problem::Missing))?;
    if frames.is_empty() {
        return Err(table.error("send", Problem::Invalid("at least one frame".to_owned())));
    }
    let action = Action {
        at: Instant::ZERO + table.seconds("at_s", MAX_S)?.unwrap_or(Duration::ZERO),
        frames,
        every: table.seconds("every_s", MAX_S)?,
        count: table.integer("count", 1, i64::MAX)?.map(|count| count as u64),
    };
    if action.every.is_some_and(Duration::is_zero) {
        return Err(table.error("every_s", Problem::Invalid("a period is above zero".to_owned())));
    }
    if action.count.is_some() && action.every.is_none() {
        return Err(table.error("count", Problem::Invalid("needs every_s".to_owned())));
    }
    table.finish()?;
    Ok(action)
}

/// All `[[fault]]` tables; labels must differ, because they name the random streams.
fn faults_of(root: &Table<'_>) -> Result<Vec<Fault>, ScenarioError> {
    let mut faults: Vec<Fault> = Vec::new();
    for (index, table) in root.tables("fault")?.iter().enumerate() {
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
    let document = reader::parse("<command>", &text)?;
    let root = Table::root("<command>", &text, &document);
    match root.table("fault")? {
        Some(table) => faults::fault(&table, index),
        None => Err(root.error("fault", Problem::Missing)),
    }
}
