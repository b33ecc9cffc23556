//! Options of every verb that touches a bus.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use can_link::BusSpec;
use hil_sim::CellOptions;
use protocol::ModuleId;
use robot_model::AnyRobot;

use super::live::LiveBus;
use super::session::{BusFailure, Medium, Session};
use super::sim::{Guests, SimBus, no_guests, soft_controller_guest};
use crate::log::Recorder;

/// Which bus, and what to keep of it.
#[derive(Clone, Debug, clap::Args)]
pub struct BusArgs {
    /// Bus: sim (the cell inside this program, in virtual time), can0, socketcand://host:port/bus,
    /// slcan:/dev/ttyACM0 or slcan://host:port.
    #[arg(long, default_value = "sim", value_name = "SPEC")]
    pub bus: BusSpec,
    /// Robot of the simulated cell: a built-in name or a file.
    #[arg(long, default_value = "powercube6", value_name = "ROBOT")]
    pub robot: String,
    /// Seed of the simulated cell.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Record every frame to PATH.candump and PATH.mcap.
    #[arg(long, value_name = "PATH")]
    pub record: Option<PathBuf>,
    /// Ask modules although another host or a controller speaks to them. Two that use one id at the same time destroy
    /// each other's frames: a running motion may be stopped by it.
    #[arg(long)]
    pub beside: bool,
}

impl Default for BusArgs {
    fn default() -> Self {
        Self { bus: BusSpec::Sim, robot: "powercube6".to_owned(), seed: 1, record: None, beside: false }
    }
}

impl BusArgs {
    /// Opens the session, with its recorders.
    ///
    /// # Errors
    /// The bus cannot be reached, the cell not be built, or the recording not be created.
    pub fn open(&self) -> Result<Session, BusFailure> {
        self.open_with(&CellOptions::default(), no_guests())
    }

    /// As [`BusArgs::open`]; on the bus `sim` with the soft controller in the cell.
    ///
    /// # Errors
    /// As [`BusArgs::open`].
    pub fn open_with_controller(&self) -> Result<Session, BusFailure> {
        self.open_with(&CellOptions::default(), soft_controller_guest())
    }

    /// As [`BusArgs::open`], with options of the cell and other nodes on its bus; both matter to `sim` only.
    ///
    /// # Errors
    /// As [`BusArgs::open`].
    pub fn open_with(&self, options: &CellOptions, guests: Guests) -> Result<Session, BusFailure> {
        let recorder = match &self.record {
            Some(path) => Some(
                Recorder::create(path, &self.bus)
                    .map_err(|source| BusFailure::Recording { source, halted: false })?,
            ),
            None => None,
        };
        let medium = match &self.bus {
            BusSpec::Sim => {
                let robot = AnyRobot::load(&self.robot)?;
                Medium::Sim(Box::new(SimBus::new(&robot, options, self.seed, guests)?))
            }
            spec => Medium::Live(Box::new(LiveBus::open(spec)?)),
        };
        let name = match &self.bus {
            BusSpec::Sim => format!("sim (robot {}, seed {})", self.robot, self.seed),
            spec => spec.to_string(),
        };
        let mut session = Session::new(medium, name, interrupt());
        if let Some(recorder) = recorder {
            session.add_tap(Box::new(recorder));
        }
        Ok(session)
    }
}

/// The flag that Ctrl-C sets. The handler is installed once per process; a second Ctrl-C ends it at once.
pub fn interrupt() -> Arc<AtomicBool> {
    static FLAG: std::sync::OnceLock<Arc<AtomicBool>> = std::sync::OnceLock::new();
    Arc::clone(FLAG.get_or_init(|| {
        let flag = Arc::new(AtomicBool::new(false));
        let shared = Arc::clone(&flag);
        // Another handler can only be there inside a foreign program, which then decides itself.
        let _ = ctrlc::set_handler(move || {
            if shared.swap(true, Ordering::Relaxed) {
                std::process::exit(i32::from(crate::exit::INTERRUPTED));
            }
        });
        flag
    }))
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
}
