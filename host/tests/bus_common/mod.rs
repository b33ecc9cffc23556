//! A simulated cell behind a port of this process, in virtual time that its clients share, and the program that is tested.
//!
//! Programs and cell are in lock step: a busy machine makes a test slower and changes nothing else.

use std::process::Output;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use can_link::BusSpec;
use hil_sim::bus::BusConfig;
use hil_sim::fault::Fault;
use hil_sim::participants::Participants;
use hil_sim::realtime::{Endpoint, Realtime, shared_time};
use hil_sim::{Cell, CellOptions};
use protocol::Instant;
use robot_model::RobotModel;

pub(crate) use crate::program::cubectl;

/// A served cell; ends when dropped.
pub(crate) struct Served {
    pub(crate) spec: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    /// Serves what `make` builds; it is built in the serving thread. Time passes while at least one client takes part.
    pub(crate) fn new<C: Participants + 'static>(make: impl FnOnce() -> C + Send + 'static) -> Self {
        Self::with_faults(make, Vec::new())
    }

    /// As [`Self::new`], with what goes wrong.
    pub(crate) fn with_faults<C: Participants + 'static>(
        make: impl FnOnce() -> C + Send + 'static,
        faults: Vec<Fault>,
    ) -> Self {
        let spec: BusSpec = "lockstep://127.0.0.1:0/can0".parse().unwrap();
        let (clock, clients_min) = shared_time(std::slice::from_ref(&spec)).unwrap();
        let endpoint = Endpoint::open(&spec, clock).unwrap();
        let spec = endpoint.name().to_owned();
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let world =
                Realtime::new(make(), BusConfig::default(), 1, faults, vec![endpoint], clock).unwrap();
            let mut world = world.in_lock_step(clients_min.unwrap());
            while !flag.load(Ordering::Relaxed) {
                world.turn(Instant::FAR_FUTURE, &mut ()).unwrap();
            }
        });
        Self { spec, stop, thread: Some(thread) }
    }

    /// The arm of six.
    pub(crate) fn arm(options: CellOptions) -> Self {
        Self::new(move || Cell::new(&RobotModel::load("powercube6").unwrap(), &options, 1).unwrap())
    }
}

impl Served {
    /// A homed arm with its controller on the bus.
    pub(crate) fn with_controller() -> Self {
        Self::with_controller_and_faults(Vec::new())
    }

    /// As [`Self::with_controller`], with what goes wrong.
    pub(crate) fn with_controller_and_faults(faults: Vec<Fault>) -> Self {
        let make = || {
            let mut options = CellOptions::default();
            options.drive.starts_homed = true;
            let cell = Cell::new(&RobotModel::load("powercube6").unwrap(), &options, 1).unwrap();
            (cell, operator::bus::sim::soft_controller_node())
        };
        Self::with_faults(make, faults)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

pub(crate) fn out(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub(crate) fn err(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

pub(crate) fn code(output: &Output) -> i32 {
    output.status.code().unwrap()
}

/// A fresh folder that is removed when dropped.
pub(crate) struct Folder(pub(crate) std::path::PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("cubectl-{name}-{}", std::process::id()));
        // What a try before left.
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(crate) fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }
}

/// A test that fails keeps its folder, and with it the log.
impl Drop for Folder {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }
}
