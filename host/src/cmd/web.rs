//! `--web`: the live view of a session.

use std::io::IsTerminal;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use operator::bus::session::Session;
use operator::interrupt::interrupt;
use operator::live::serve::{PERIOD, address};
use operator::live::{LiveServer, LiveState, LiveTap};
use operator::machine::Machine;
use planner::plan::file::PlanFile;
use robot_model::RobotModel;

use crate::error::ExpectedError;
use crate::exit;
use crate::report::live;

#[derive(Clone, Debug, Default, clap::Args)]
pub struct WebArgs {
    /// Serve a live page to browsers of this machine: a port, or 127.0.0.1:PORT; 0 is any that is free. It
    /// looks and stops; it moves nothing [without a value: 8777].
    #[arg(
        long,
        value_name = "PORT",
        num_args = 0..=1,
        default_missing_value = "8777",
        value_parser = address,
        help_heading = "Live view"
    )]
    pub web: Option<SocketAddr>,
}

impl WebArgs {
    /// Serves what passes in `session` until the answer is dropped; a page that stops sets `stop`. A simulated cell inside this
    /// program then runs in real time.
    pub(super) fn serve(
        &self,
        session: &mut Session,
        robot: &RobotModel,
        plan: Option<&PlanFile>,
        stop: Arc<AtomicBool>,
    ) -> Result<Option<LiveServer>, ExpectedError> {
        let Some(address) = self.web else { return Ok(None) };
        if let Some(sim) = session.sim() {
            // A picture of virtual time would be over at once.
            sim.pace();
        }
        let state = LiveState::new(Machine::of(robot), session.zero_unix(), session.bit_rate_bit_s());
        let state = Arc::new(Mutex::new(state));
        session.add_tap(Box::new(LiveTap(Arc::clone(&state))));
        let page = live::page(robot, session.name(), plan);
        let server = LiveServer::start(address, state, page, stop)
            .map_err(|error| ExpectedError::of(exit::OUTPUT, &error))?;
        console::note!("live view at {}", server.url());
        Ok(Some(server))
    }
}

/// Shows on the page what the job has come to, with its report. On a terminal the page stays until Ctrl-C.
pub(super) fn show_end(page: &LiveServer, text: String, report: &Path) {
    page.end(text, std::fs::read_to_string(report).ok());
    if !(std::io::stdin().is_terminal() && std::io::stderr().is_terminal()) {
        // Pages that look on get the last picture.
        std::thread::sleep(10 * PERIOD);
        return;
    }
    let interrupt = interrupt();
    interrupt.store(false, Ordering::Relaxed);
    console::note!("{} shows the end and the report until Ctrl-C", page.url());
    while !interrupt.load(Ordering::Relaxed) {
        std::thread::sleep(PERIOD);
    }
}
