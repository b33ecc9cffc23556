//! `--web`: the live view of a session.

use std::net::SocketAddr;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use operator::bus::session::Session;
use operator::live::serve::address;
use operator::live::{LiveServer, LiveState, LiveTap};
use operator::machine::Machine;
use planner::plan::file::PlanFile;
use robot_model::RobotModel;

use super::report::BIT_RATE;
use crate::error::ExpectedError;
use crate::exit;
use crate::report::live;

/// Options of the live view.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct WebArgs {
    /// Serve a live page to browsers and robotics viewers of this machine: a port, or 127.0.0.1:PORT; 0 is any that is free. It
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
    /// Let pages of this origin read it too, such as `https://viewer.example`; may be given several times.
    #[arg(long, value_name = "ORIGIN", requires = "web", help_heading = "Live view")]
    pub web_origin: Vec<String>,
}

impl WebArgs {
    /// Serves what passes in `session` until the answer is dropped; a page that stops sets `stop`.
    ///
    /// # Errors
    /// The session is in virtual time, or the port cannot be had.
    pub(super) fn serve(
        &self,
        session: &mut Session,
        robot: &RobotModel,
        plan: Option<&PlanFile>,
        stop: Arc<AtomicBool>,
    ) -> Result<Option<LiveServer>, ExpectedError> {
        let Some(address) = self.web else { return Ok(None) };
        if session.is_simulated() {
            return Err(ExpectedError::bad_input(
                &"--web shows real time, the bus `sim` runs in virtual time\n  next: `cubectl sim` in another terminal, then --bus \
                  socketcand://127.0.0.1:29536/can0",
            ));
        }
        let state = LiveState::new(Machine::of(robot), session.zero_unix(), BIT_RATE);
        let state = Arc::new(Mutex::new(state));
        session.add_tap(Box::new(LiveTap(Arc::clone(&state))));
        let page = live::page(robot, session.name(), plan);
        let server = LiveServer::start(address, state, page, self.web_origin.clone(), stop)
            .map_err(|error| ExpectedError::new(exit::OUTPUT, error.to_string()))?;
        console::note!("live view at {}", server.url());
        Ok(Some(server))
    }
}
