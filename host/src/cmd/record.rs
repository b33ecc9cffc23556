//! `cubectl record`

use std::path::PathBuf;

use protocol::Duration;

use crate::error::ExpectedError;
use operator::bus::BusArgs;
use operator::bus::BusFailure;
use operator::bus::session::Ended;
use operator::log::files_of;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl record throw1 --bus can0            # until Ctrl-C\n  cubectl record boot --controller --for 2    # a soft controller starting up in the simulated cell\n\nNothing is sent: recording does not disturb the bus. Files that exist are not overwritten."
)]
pub struct Args {
    /// Bus options.
    #[command(flatten)]
    pub bus: BusArgs,
    /// Where to: PATH.log and PATH.mcap; with --bus rsi:... the folder PATH.
    pub path: PathBuf,
    /// End after this many seconds. On the bus `sim` the default is one second.
    #[arg(long = "for", value_name = "SECONDS", value_parser = super::home::positive)]
    pub time: Option<f64>,
    /// With the bus `sim`: let the soft controller run in the cell.
    #[arg(long)]
    pub controller: bool,
}

/// Runs the verb.
///
/// # Errors
/// The bus cannot be reached or is lost, or the recording not be written.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if args.bus.record.is_some() {
        return Err(ExpectedError::bad_input(&"`record` takes its path without --record"));
    }
    if let Some((spec, described, arm)) = super::rsi::robot_on(&args.bus)? {
        return super::rsi::record(&args.path, args.time, &spec, &described, &arm);
    }
    let bus = BusArgs { record: Some(args.path.clone()), ..args.bus.clone() };
    let mut session = if args.controller { bus.open_with_controller()? } else { bus.open()? };
    let span = args.time.or(session.is_simulated().then_some(1.0));
    let [text, viewer] = files_of(&args.path);
    console::note!(
        "recording {} to {} and {}; Ctrl-C ends",
        session.name(),
        text.display(),
        viewer.display()
    );
    let until = span.map_or(protocol::Instant::FAR_FUTURE, |s| session.now() + Duration::from_secs_f64(s));
    let ended = session.run(until, &mut |_| false)?;
    let frames = session.host_node().tally().received;
    let errors = session.bus_errors().len();
    let took = session.now().as_secs_f64();
    session.finish().map_err(|failure: BusFailure| ExpectedError::from(failure))?;
    let why = if ended == Ended::Interrupted { " (ended by a signal)" } else { "" };
    console::line!("{frames} frames and {errors} bus errors in {took:.3} s{why}");
    Ok(())
}
