//! `cubectl monitor`

use std::io::{IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use firmware::fault::Cause;
use protocol::powercube::{CubeState, Parameter, Request};
use protocol::{Duration, Instant, ModuleId};

use super::modules::{Modules, modules_on};
use super::stop::{TIMES as HALTS, halt};
use super::web::WebArgs;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::session::Ended;
use operator::bus::{BusArgs, Session};
use operator::node::host_node::{HostNode, utilisation};
use operator::node::inbox::Said;

/// Time between two rounds of questions while a page looks.
const PAGE_ROUND: Duration = Duration::from_millis(20);
/// Rate that the bus load is computed with, bit/s.
const BIT_RATE_BIT_S: u32 = 1_000_000;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl monitor --bus can0\n  cubectl monitor --bus can0 --listen --plain > log.txt\n  cubectl monitor --bus can0 --web              # a live page with the arm, charts and a stop button\n\nOn a terminal a table that renews itself; elsewhere one line per module and period."
)]
pub struct Args {
    /// Bus options.
    #[command(flatten)]
    pub bus: BusArgs,
    /// These modules. Default: all that are there.
    #[arg(long)]
    pub modules: Option<Modules>,
    /// Only listen to what others ask; send nothing. So it is beside a controller or another host anyway.
    #[arg(long)]
    pub listen: bool,
    /// Time between two pictures, ms.
    #[arg(long = "period", default_value_t = 200.0, value_name = "MS", value_parser = super::home::positive)]
    pub period_ms: f64,
    /// End after this many seconds. On the bus `sim` the default is one second.
    #[arg(long = "for", value_name = "SECONDS", value_parser = super::home::positive)]
    pub time: Option<f64>,
    /// Lines instead of a table, also on a terminal.
    #[arg(long)]
    pub plain: bool,
    /// Live view in a browser.
    #[command(flatten)]
    pub web: WebArgs,
}

/// Runs the verb.
///
/// # Errors
/// The bus cannot be reached or is lost, or nobody answers.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let cell = args.bus.cell.load()?;
    let mut session = args.bus.open_cell(&cell, None)?;
    let stop = Arc::new(AtomicBool::new(false));
    let page = args.web.serve(&mut session, &cell.robot, None, Arc::clone(&stop))?;
    let listens = args.listen || (!args.bus.beside && session.hears_other_host()?);
    if listens && !args.listen {
        console::note!("a controller or another host speaks to the modules: nothing is sent");
    }
    let modules: Vec<ModuleId> = if listens {
        Vec::new()
    } else {
        let found =
            modules_on(&mut session, args.modules.as_ref().map(|modules| modules.0.as_slice()), true)?;
        found.iter().map(|report| report.module).collect()
    };
    session.host_node().listen_only();
    let table = !args.plain && std::io::stdout().is_terminal();
    let span = args.time.or(session.is_simulated().then_some(1.0));
    let end = span.map_or(Instant::FAR_FUTURE, |s| session.now() + Duration::from_secs_f64(s));
    let period = Duration::from_secs_f64(1e-3 * args.period_ms);
    let mut before = session.host_node().tally();
    let mut ended = Ended::Done;
    // A page is shown more often than a terminal.
    let round = if page.is_some() { period.min(PAGE_ROUND) } else { period };
    while session.now() < end && ended != Ended::Interrupted {
        let begun = session.now();
        let shown_at = (begun + period).min(end);
        while session.now() < shown_at && ended != Ended::Interrupted {
            ask(session.host_node(), &modules);
            let until = (session.now() + round).min(shown_at);
            ended = session.run(until, &mut |host_node| {
                while host_node.poll_outcome().is_some() {}
                stop.load(Ordering::Relaxed)
            })?;
            if stop.swap(false, Ordering::Relaxed) {
                halt(&mut session)?;
                console::note!("stopped from the page: halt and stop message sent {HALTS} times");
            }
        }
        let span = session.now().saturating_since(begun);
        let text = picture(&mut session, before, span, table);
        before = session.host_node().tally();
        let mut out = std::io::stdout().lock();
        let written = out.write_all(text.as_bytes()).and_then(|()| out.flush());
        if let Err(error) = written {
            // The reader of a pipe has gone: that is how people end it.
            if error.kind() == std::io::ErrorKind::BrokenPipe {
                break;
            }
            return Err(ExpectedError::new(exit::OUTPUT, format!("cannot write: {error}")));
        }
    }
    Ok(session.finish()?)
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

fn picture(
    session: &mut Session,
    before: operator::node::host_node::Tally,
    span: Duration,
    table: bool,
) -> String {
    use std::fmt::Write as _;
    let (now, errors, name) = (session.now(), session.bus_errors().len(), session.name().to_owned());
    let group = controller(session.host_node(), table);
    let said = said(session);
    let host_node = session.host_node();
    let mut tally = host_node.tally();
    let frames = tally.received + tally.sent - before.received - before.sent;
    tally.bits -= before.bits;
    let load = 100.0 * utilisation(tally, span, BIT_RATE_BIT_S);
    let mut text = String::new();
    if table {
        let _ = writeln!(text, "\x1b[2J\x1b[H{name}  {:.1} s", now.as_secs_f64());
        let _ = writeln!(text, "{frames} frames, load about {load:.1} % of 1 Mbit/s, {errors} bus errors\n");
        let _ = writeln!(text, "id  position_rad  current_a  heard_ms_ago  state");
    } else if !group.is_empty() {
        let _ = write!(text, "t_s={:.3} {group}", now.as_secs_f64());
    }
    for (module, heard) in host_node.heard() {
        let number =
            |value: Option<f32>, digits: usize| value.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
        let age_ms = now.saturating_since(heard.at).as_micros() / 1_000;
        let (position, current) = (number(heard.position_rad, 4), number(heard.current_a, 2));
        let state = heard.state.map_or("?".to_owned(), |state: CubeState| state.to_string());
        if table {
            let _ = writeln!(text, "{module:>2}  {position:>12}  {current:>9}  {age_ms:>12}  {state}");
        } else {
            let _ = writeln!(
                text,
                "t_s={:.3} module={module} position_rad={position} current_a={current} age_ms={age_ms} state={state} \
                 load_percent={load:.1} bus_errors={errors}",
                now.as_secs_f64()
            );
        }
    }
    if table {
        text.push_str(&group);
    }
    text + &said
}

/// What controllers said since the last picture, a line each.
fn said(session: &mut Session) -> String {
    let line = |(at, said): (Instant, Said)| {
        format!(
            "t_s={:.3} controller={} severity={:?} says=\"{}\"\n",
            at.as_secs_f64(),
            said.from.get(),
            said.severity,
            said.text
        )
    };
    session.take_said().into_iter().map(line).collect()
}

/// What a controller told last: the group, then its joints; empty if none is heard.
fn controller(host_node: &mut HostNode, table: bool) -> String {
    use std::fmt::Write as _;
    let Some(inbox) = host_node.inbox() else { return String::new() };
    let Some((_, node, group)) = inbox.group else { return String::new() };
    let cause = Cause::from_code(group.fault_cause).map_or("none", Cause::name);
    let mut text = String::new();
    let gap = if table { "\n" } else { "" };
    let _ = writeln!(
        text,
        "{gap}controller={} state={:?} fault={cause} fault_joint={} plan_s={:.3} period_us={} jitter_us={} late={} \
         missed={} saturated={} load_percent={:.1} host={}",
        node.get(),
        group.state,
        group.fault_joint,
        f64::from(group.trajectory_time_us) * 1e-6,
        group.cycle_us,
        group.cycle_jitter_us,
        group.cycles_late,
        group.replies_missed,
        group.cycles_saturated,
        f64::from(group.bus_load_permille) / 10.0,
        if group.host_alive { "alive" } else { "silent" },
    );
    let Some((_, source, state)) = &inbox.joints else { return text };
    if table {
        let _ = writeln!(text, "\njoint     q_rad  qd_rad_s  error_mrad  current_a");
    }
    for (index, joint) in state.joints().iter().enumerate() {
        let number = index + 1;
        let error_mrad = 1e3 * joint.error_q_rad;
        if table {
            let _ = writeln!(
                text,
                "{number:>5}  {:>8.4}  {:>8.4}  {error_mrad:>10.2}  {:>9.2}",
                joint.q_rad, joint.qd_rad_s, joint.current_a
            );
        } else {
            let _ = writeln!(
                text,
                "controller={} joint={number} q_rad={:.4} qd_rad_s={:.4} error_mrad={error_mrad:.2} current_a={:.2}",
                source.get(),
                joint.q_rad,
                joint.qd_rad_s,
                joint.current_a
            );
        }
    }
    text
}
