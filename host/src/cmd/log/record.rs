//! `cubectl log record`

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use can_link::BusSpec;
use protocol::Duration;

use crate::error::ExpectedError;
use operator::bus::BusArgs;
use operator::bus::BusFailure;
use operator::bus::period::settings_with_gains;
use operator::bus::session::Ended;
use operator::log::candump::Line;
use operator::log::files_of;
use operator::log::keep::Keeper;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl log record throw1 --bus can0            # until Ctrl-C\n  cubectl log record boot --controller --for-s 2    # a soft controller starting up in the simulated cell\n\nNothing is sent: recording does not disturb the bus. Files that exist are not overwritten."
)]
pub struct Args {
    #[command(flatten)]
    pub bus: BusArgs,
    /// Where to: PATH.log and PATH.mcap; with --bus rsi:... the folder PATH.
    pub path: PathBuf,
    /// End after this many seconds. On the bus `sim` the default is one second.
    #[arg(long = "for-s", alias = "for", value_name = "SECONDS", value_parser = crate::cmd::values::positive)]
    pub time: Option<f64>,
    /// With the bus `sim`: let the soft controller run in the cell.
    #[arg(long)]
    pub controller: bool,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if args.bus.record.is_some() {
        return Err(ExpectedError::bad_input(&"`record` takes its path without --record"));
    }
    if let Some((spec, described, arm)) = crate::cmd::rsi::robot_on(&args.bus)? {
        return crate::cmd::rsi::record(&args.path, args.time, &spec, &described, &arm);
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

/// The frames that `cubectl log record` would write; nothing is written or printed. `stop`, once set, ends it.
///
/// # Errors
/// The time is not above zero, the bus cannot be reached or is lost, or it was stopped.
pub fn for_programs(
    bus: &BusArgs,
    for_s: f64,
    controller: bool,
    stop: &Arc<AtomicBool>,
) -> Result<Vec<Line>, ExpectedError> {
    if !(for_s > 0.0 && for_s.is_finite()) {
        return Err(ExpectedError::bad_input(&format!("{for_s} s: the time of a recording is above 0")));
    }
    let cell = bus.cell.load()?;
    let with_controller = controller && bus.bus == BusSpec::Sim;
    let settings = with_controller.then(|| settings_with_gains(&cell.robot, &cell.setup)).transpose();
    let settings = settings.map_err(BusFailure::from)?;
    let mut session = bus.open_cell_until(&cell, settings.as_ref(), Arc::clone(stop))?;
    let keeper = Keeper::default();
    session.add_tap(Box::new(keeper.clone()));
    keeper.start();
    let until = session.now() + Duration::from_secs_f64(for_s);
    let ended = session.run(until, &mut |_| false)?;
    session.finish()?;
    match ended {
        Ended::Interrupted => Err(ExpectedError::new(crate::exit::INTERRUPTED, "interrupted")),
        _ => Ok(keeper.stop()),
    }
}
