//! `cubectl arm monitor`

use std::fmt::Write as _;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use protocol::powercube::{Parameter, Request};
use protocol::{Duration, Instant, ModuleId};

use crate::cmd::arm::stop::halt;
use crate::cmd::fixed;
use crate::cmd::survey::{Modules, modules_on, require_powercubes};
use crate::cmd::web::WebArgs;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::BusArgs;
use operator::bus::session::{Ended, Session};
use operator::live::state::Snapshot;
use operator::live::{LiveState, LiveTap};
use operator::machine::Machine;
use operator::node::host_node::HostNode;

/// Longest time between two rounds of questions: while a page looks, and else. What is asked more seldom would be old.
const PAGE_ROUND: Duration = Duration::from_millis(20);
const ROUND: Duration = Duration::from_millis(200);

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl arm monitor --bus can0\n  cubectl arm monitor --bus can0 --listen > log.txt\n  cubectl arm monitor --bus can0 --json | jq .joints[2].q_rad\n  cubectl arm monitor --bus can0 --web              # a live page with the arm, charts and a stop button\n\nA line for the controller, one for each joint and module that was heard, and one for each event since the last period.\n--json prints the same as one object per period. What was not heard for a second is shown as old."
)]
pub struct Args {
    #[command(flatten)]
    pub bus: BusArgs,
    /// These modules. Default: all that are there.
    #[arg(long)]
    pub modules: Option<Modules>,
    /// Only listen to what others ask; send nothing. So it is beside a controller or another host anyway.
    #[arg(long)]
    pub listen: bool,
    /// Time between two prints, ms.
    #[arg(long = "period-ms", alias = "period", default_value_t = 200.0, value_name = "MS", value_parser = crate::cmd::values::positive)]
    pub period_ms: f64,
    /// End after this many seconds. On the bus `sim` the default is one second.
    #[arg(long = "for-s", alias = "for", value_name = "SECONDS", value_parser = crate::cmd::values::positive)]
    pub time: Option<f64>,
    /// One JSON object per line and period.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub web: WebArgs,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let cell = args.bus.cell.load()?;
    let mut session = args.bus.open_cell(&cell, None)?;
    let stop = Arc::new(AtomicBool::new(false));
    let page = args.web.serve(&mut session, &cell.robot, None, Arc::clone(&stop))?;
    let listens = args.listen || (!args.bus.beside && session.hears_other_host()?);
    if listens && !args.listen {
        console::note!("a controller or another host speaks to the modules: nothing is sent");
    }
    let mut modules: Vec<ModuleId> = if listens {
        Vec::new()
    } else {
        require_powercubes(&mut session, &args.bus, &cell.robot)?;
        let found =
            modules_on(&mut session, args.modules.as_ref().map(|modules| modules.0.as_slice()), true)?;
        found.iter().map(|report| report.module).collect()
    };
    session.host_node().listen_only();
    let others = |session: &mut Session| {
        let tally = session.host_node().tally();
        tally.foreign_requests + tally.tools
    };
    let others_before = others(&mut session);
    let live = LiveState::new(Machine::of(&cell.robot), session.zero_unix(), session.bit_rate_bit_s());
    let live = Arc::new(Mutex::new(live));
    session.add_tap(Box::new(LiveTap(Arc::clone(&live))));
    let span = args.time.or((session.is_simulated() && page.is_none()).then_some(1.0));
    let end = span.map_or(Instant::FAR_FUTURE, |s| session.now() + Duration::from_secs_f64(s));
    let period = Duration::from_secs_f64(1e-3 * args.period_ms);
    // A page is shown more often than lines are printed.
    let round = period.min(if page.is_some() { PAGE_ROUND } else { ROUND });
    let mut ended = Ended::Done;
    let (mut last_event, mut reported) = (0, true);
    while session.now() < end && ended != Ended::Interrupted {
        let printed_at = (session.now() + period).min(end);
        while session.now() < printed_at && ended != Ended::Interrupted {
            if !modules.is_empty() && !args.bus.beside && others(&mut session) > others_before {
                session.host_node().drives.cancel_all();
                modules.clear();
                console::note!(
                    "another host or a controller speaks: the monitor gives way, and from now on only listens"
                );
            }
            ask(session.host_node(), &modules);
            let until = (session.now() + round).min(printed_at);
            ended = session.run(until, &mut |host_node| {
                while host_node.poll_outcome().is_some() {}
                stop.load(Ordering::Relaxed)
            })?;
            if stop.swap(false, Ordering::Relaxed) {
                halt(&mut session)?;
                console::note!("stopped from the page: halt and stop message sent");
                reported = false;
            }
        }
        let snapshot = live.lock().unwrap_or_else(PoisonError::into_inner).snapshot(last_event);
        if let Some(stop) = snapshot.stop.as_ref().filter(|stop| stop.settled && !reported) {
            console::note!("{}", stop.text);
            reported = true;
        }
        last_event = snapshot.events.last().map_or(last_event, |event| event.number);
        let text = if args.json {
            serde_json::to_string(&snapshot).unwrap_or_default() + "\n"
        } else {
            lines(&snapshot)
        };
        if let Err(error) = write(&text) {
            // The reader of a pipe has gone: that is how people end it.
            if error.kind() == std::io::ErrorKind::BrokenPipe {
                break;
            }
            return Err(ExpectedError::new(exit::OUTPUT, format!("cannot write: {error}")));
        }
    }
    Ok(session.finish()?)
}

fn write(text: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes()).and_then(|()| out.flush())
}

/// One round of questions, unless the last one is still open.
fn ask(host_node: &mut HostNode, modules: &[ModuleId]) {
    if !host_node.drives.is_idle() {
        return;
    }
    for module in modules {
        for parameter in [Parameter::ActPos, Parameter::CubeState, Parameter::Cur] {
            // The queue of an idle client is empty.
            let _ = host_node.start(*module, Request::Get(parameter));
        }
    }
}

/// A snapshot as lines of `key=value` that other programs read. A joint that was never heard has none.
fn lines(seen: &Snapshot) -> String {
    let number = |value: Option<f64>, digits| value.map_or_else(|| "-".to_owned(), |v| fixed(v, digits));
    let ms = |age_s: Option<f64>| number(age_s.map(|s| 1e3 * s), 0);
    let begin = format!("t_s={:.3}", seen.t_s);
    let mut text = String::new();
    if let Some(c) = &seen.controller {
        let (code, joint) = c.fault.as_ref().map_or((0, 0), |fault| (fault.code, fault.joint));
        let _ = writeln!(
            text,
            "{begin} controller={} state=\"{}\" age_ms={:.0} fault={code} fault_joint={joint} plan_s={:.3} period_us={} late={} missed={} \
             saturated={} host={} load_percent={:.1} bus_errors={}",
            c.node_id,
            c.state,
            1e3 * c.age_s,
            c.plan_s,
            c.period_us,
            c.cycles_late,
            c.replies_missed,
            c.cycles_saturated,
            if c.host_alive { "alive" } else { "silent" },
            seen.load_percent,
            seen.bus_errors,
        );
    }
    if let Some(stop) = &seen.stop {
        let _ = writeln!(text, "{begin} stop=\"{}\"", stop.text);
    }
    for (joint, number_of) in seen.joints.iter().zip(1..).filter(|(joint, _)| joint.q_rad.is_some()) {
        let _ = writeln!(
            text,
            "{begin} joint={number_of} module={} q_rad={} qd_rad_s={} error_mrad={} current_a={} age_ms={} state=\"{}\"",
            joint.module.map_or_else(|| "-".to_owned(), |module| module.to_string()),
            number(joint.q_rad, 4),
            number(joint.qd_rad_s, 4),
            number(joint.error_rad.map(|rad| 1e3 * rad), 2),
            number(joint.current_a, 2),
            ms(joint.age_s),
            joint.state,
        );
    }
    for stranger in &seen.strangers {
        let _ = writeln!(
            text,
            "{begin} module={} q_rad={} current_a={} age_ms={} state=\"{}\"",
            stranger.module,
            number(stranger.q_rad, 4),
            number(stranger.current_a, 2),
            ms(Some(stranger.age_s)),
            stranger.state,
        );
    }
    for event in &seen.events {
        let _ = writeln!(
            text,
            "t_s={:.3} event={} source=\"{}\" text=\"{}\"",
            event.t_s,
            format!("{:?}", event.severity).to_ascii_lowercase(),
            event.source,
            event.text
        );
    }
    text
}
