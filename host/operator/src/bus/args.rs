//! Options of every verb that touches a bus.

use std::path::PathBuf;
use std::rc::Rc;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use can_link::BusSpec;
use firmware::settings::Settings;
use hil_sim::scenario::Scenario;
use protocol::ModuleId;
use protocol::cyphal::id::NodeId;
use robot_model::RobotModel;

use super::failure::BusFailure;
use super::live::LiveBus;
use super::session::{Medium, Session};
use super::sim::{OtherNodes, SimBus, SimSetup, controller_node, no_other_nodes};
use crate::bus::period::settings_with_gains;
use crate::drives::CanDrives;
use crate::interrupt::interrupt;
use crate::log::Recorder;
use crate::machine::Machine;

/// Which bus, and what to keep of it.
#[derive(Clone, Debug, clap::Args)]
pub struct BusArgs {
    #[arg(long, help = format!("Bus: sim (the cell inside this program, in virtual time), {}", can_link::LIVE_BUSES), value_parser = can_link::bus_of_option, default_value = "sim", value_name = "SPEC", help_heading = "Bus")]
    pub bus: BusSpec,
    #[command(flatten)]
    pub cell: CellArgs,
    /// Record every frame to PATH.log and PATH.mcap.
    #[arg(long, value_name = "PATH", help_heading = "Bus")]
    pub record: Option<PathBuf>,
    /// Ask modules although another host or a controller speaks to them. Two that use one id at the same time destroy
    /// each other's frames: a running motion may be stopped by it.
    #[arg(long, help_heading = "Bus")]
    pub beside: bool,
    /// Description of an industrial robot and its program, for --bus rsi:udp://HOST:PORT or rsi:tcp://HOST:PORT: kr-c2,
    /// kr-c2-tcp, kr-c4, kr-c4-12ms, or a file as in robots/kr16_2 [default: kr-c2].
    #[arg(long, value_name = "DESCRIPTION", help_heading = "Bus")]
    pub rsi: Option<String>,
}

/// The cell behind the bus `sim`; the robot matters to other buses too where a controller runs in this program.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct CellArgs {
    /// Robot: a built-in name or a file [default: the scenario's, or powercube6].
    #[arg(long, value_name = "ROBOT")]
    pub robot: Option<String>,
    /// Seed of the simulated cell [default: the scenario's, or 1].
    #[arg(long, help_heading = "Simulated cell")]
    pub seed: Option<u64>,
    /// Scenario of the simulated cell: its options, and what goes wrong (`cubectl explain faults` lists the kinds).
    #[arg(long, value_name = "FILE", help_heading = "Simulated cell")]
    pub scenario: Option<PathBuf>,
}

/// A robot with its simulated cell, read and checked.
pub struct Cell {
    pub robot_source: String,
    pub robot: RobotModel,
    pub seed: u64,
    pub setup: SimSetup,
}

impl CellArgs {
    /// Reads robot and scenario.
    pub fn load(&self) -> Result<Cell, BusFailure> {
        let scenario = self.scenario.as_deref().map(Scenario::load).transpose();
        let scenario = scenario.map_err(|error| BusFailure::Scenario(Box::new(error)))?;
        let named = self.robot.clone().or(scenario.as_ref().map(|scenario| scenario.robot.clone()));
        let robot_source = named.unwrap_or_else(|| "powercube6".to_owned());
        let robot = RobotModel::load(&robot_source)?;
        let seed = self.seed.or(scenario.as_ref().map(|scenario| scenario.seed)).unwrap_or(1);
        let setup = scenario.map_or_else(SimSetup::default, SimSetup::from);
        Ok(Cell { robot_source, robot, seed, setup })
    }
}

/// Who controls the group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Controller {
    /// A controller in this program, in the simulated cell or in a thread on the bus.
    Soft,
    /// A controller that is already on the bus.
    Node(NodeId),
}

impl FromStr for Controller {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "soft" {
            return Ok(Self::Soft);
        }
        let node = text.parse::<u8>().ok().and_then(|id| NodeId::new(id).ok());
        node.map(Self::Node).ok_or_else(|| "must be `soft` or a Cyphal node-ID from 0 to 127".to_owned())
    }
}

impl Default for BusArgs {
    fn default() -> Self {
        Self { bus: BusSpec::Sim, cell: CellArgs::default(), record: None, beside: false, rsi: None }
    }
}

impl BusArgs {
    /// Opens the session, with its recorders.
    ///
    /// # Errors
    /// The bus cannot be reached, the cell not be built, or the recording not be created.
    pub fn open(&self) -> Result<Session, BusFailure> {
        self.open_cell(&self.cell.load()?, None)
    }

    /// As [`BusArgs::open`]; on the bus `sim` with the soft controller in the cell.
    pub fn open_with_controller(&self) -> Result<Session, BusFailure> {
        self.open_with_controller_until(interrupt())
    }

    /// As [`BusArgs::open_with_controller`]; the session ends once `stop` is set.
    pub fn open_with_controller_until(&self, stop: Arc<AtomicBool>) -> Result<Session, BusFailure> {
        let cell = self.cell.load()?;
        let settings =
            (self.bus == BusSpec::Sim).then(|| settings_with_gains(&cell.robot, &cell.setup)).transpose()?;
        self.open_cell_until(&cell, settings.as_ref(), stop)
    }

    /// Opens the session; on the bus `sim` with `cell` behind it. With `settings` a soft controller is on the bus: in
    /// the cell, or in a thread of this program.
    pub fn open_cell(&self, cell: &Cell, settings: Option<&Settings>) -> Result<Session, BusFailure> {
        self.open_cell_until(cell, settings, interrupt())
    }

    /// As [`BusArgs::open_cell`]; the session ends once `stop` is set. For programs that have handlers of signals of their own.
    pub fn open_cell_until(
        &self,
        cell: &Cell,
        settings: Option<&Settings>,
        stop: Arc<AtomicBool>,
    ) -> Result<Session, BusFailure> {
        let off = Rc::default();
        let medium = match &self.bus {
            BusSpec::Sim => {
                let others = match settings {
                    Some(settings) => {
                        let drives = CanDrives::of(&cell.robot)?;
                        controller_node(settings, drives, Rc::clone(&off))
                    }
                    None => no_other_nodes(),
                };
                Medium::Sim(Box::new(SimBus::new(&cell.robot, &cell.setup, cell.seed, others)?))
            }
            spec => {
                let real = match spec {
                    BusSpec::SocketCan { interface } => !interface.starts_with("vcan"),
                    other => matches!(other, BusSpec::Slcan { .. }),
                };
                if real && settings.is_some() && cell.robot.drives_are_assumed() {
                    let robot = cell.robot.name().to_owned();
                    return Err(BusFailure::AssumedDrives { robot, bus: spec.clone() });
                }
                let live = LiveBus::open(spec)?;
                Medium::Live(Box::new(match settings {
                    Some(settings) => live.start_controller(*settings, CanDrives::of(&cell.robot)?)?,
                    None => live,
                }))
            }
        };
        self.session_on(medium, cell, stop, off)
    }

    /// Opens a session in virtual time with `cell` and the nodes `others` on its bus, independent of the bus of these options.
    pub fn open_with_nodes(&self, cell: &Cell, others: OtherNodes) -> Result<Session, BusFailure> {
        let bus = SimBus::new(&cell.robot, &cell.setup, cell.seed, others)?;
        let medium = Medium::Sim(Box::new(bus));
        Self { bus: BusSpec::Sim, ..self.clone() }.session_on(medium, cell, interrupt(), Rc::default())
    }

    fn session_on(
        &self,
        medium: Medium,
        cell: &Cell,
        stop: Arc<AtomicBool>,
        off: Rc<std::cell::Cell<bool>>,
    ) -> Result<Session, BusFailure> {
        let name = match &self.bus {
            BusSpec::Sim => format!("sim (robot {}, seed {})", cell.robot_source, cell.seed),
            spec => spec.to_string(),
        };
        let mut session = Session::new(medium, name, stop, off);
        if let Some(path) = &self.record {
            let recorder =
                Recorder::create(path, &self.bus, session.zero_unix(), Some(Machine::of(&cell.robot)))
                    .map_err(|source| BusFailure::Recording { source, halted: false })?;
            session.add_tap(Box::new(recorder));
        }
        Ok(session)
    }
}

/// `3`, `1-6` or `1,2,5-7` as addresses.
///
/// # Errors
/// In words, for the command line.
pub fn parse_modules(text: &str) -> Result<Vec<ModuleId>, String> {
    let number = |part: &str| -> Result<u8, String> {
        part.trim().parse().map_err(|_| format!("'{part}' is no address; write 3, 1-6 or 1,2,5-7"))
    };
    let mut modules = Vec::new();
    for part in text.split(',') {
        let (first, last) = match part.split_once('-') {
            Some((first, last)) => (number(first)?, number(last)?),
            None => (number(part)?, number(part)?),
        };
        if first > last {
            return Err(format!("'{part}' runs backwards"));
        }
        for address in first..=last {
            let module = ModuleId::new(address).map_err(|error| format!("address {error}"))?;
            if !modules.contains(&module) {
                modules.push(module);
            }
        }
    }
    Ok(modules)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_addresses_are_read_or_refused_with_the_reason() {
        let ids = |text| parse_modules(text).map(|m| m.iter().map(|m| m.get()).collect::<Vec<_>>());
        assert_eq!(ids("3"), Ok(vec![3]));
        assert_eq!(ids("1-3,3,7"), Ok(vec![1, 2, 3, 7]));
        assert_eq!(ids("0"), Err("address 0 is outside 1..=31".to_owned()));
        assert_eq!(ids("4-2"), Err("'4-2' runs backwards".to_owned()));
        assert!(ids("arm").is_err());
    }

    #[test]
    fn a_controller_for_assumed_drives_is_refused_on_a_bus_with_real_ones() {
        let robot = format!("{}/../../docs/robots/arm.toml", env!("CARGO_MANIFEST_DIR"));
        let cell = CellArgs { robot: Some(robot), ..CellArgs::default() }.load().unwrap();
        let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
        let open = |bus: &str, settings: Option<&Settings>| {
            let bus = BusArgs { bus: bus.parse().unwrap(), ..BusArgs::default() };
            bus.open_cell(&cell, settings).map(drop).unwrap_err()
        };
        for real in ["can77", "slcan:/dev/nowhere"] {
            let error = open(real, Some(&settings));
            assert!(matches!(error, BusFailure::AssumedDrives { .. }), "{real}: {error}");
            // Without a controller nothing is commanded by those numbers: a stop goes out.
            assert!(matches!(open(real, None), BusFailure::Open(_)));
        }
        assert!(matches!(open("vcan77", Some(&settings)), BusFailure::Open(_)));
    }
}
