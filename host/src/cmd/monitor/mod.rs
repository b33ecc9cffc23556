//! `cubectl monitor`
//!
//! | module | holds |
//! |---|---|
//! | `lines` | one line per module and period, for other programs |
//! | `screen` | the picture on a terminal, without IO |
//! | `terminal` | size, keys, and a screen of its own |

mod lines;
mod screen;
mod terminal;

use std::collections::BTreeSet;
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use protocol::powercube::{Parameter, Request};
use protocol::{Duration, Instant, ModuleId};

use self::screen::{Screen, Stranger, View};
use self::terminal::{HINTS, Key, Terminal, has_colours, show, size};
use super::modules::{Modules, modules_on};
use super::report::BIT_RATE;
use super::stop::{TIMES as HALTS, halt};
use super::web::WebArgs;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::BusArgs;
use operator::bus::session::Ended;
use operator::live::state::{Snapshot, in_words};
use operator::live::{LiveState, LiveTap};
use operator::machine::Machine;
use operator::node::host_node::HostNode;

/// Time between two rounds of questions while a page looks.
const PAGE_ROUND: Duration = Duration::from_millis(20);
/// Periods that keys choose.
const PERIOD_MIN: Duration = Duration::from_millis(50);
const PERIOD_MAX: Duration = Duration::from_secs(3);

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl monitor --bus can0\n  cubectl monitor --bus can0 --listen --plain > log.txt\n  cubectl monitor --bus can0 --json | jq .joints[2].q_rad\n  cubectl monitor --bus can0 --web              # a live page with the arm, charts and a stop button\n\nOn a terminal a table that renews itself, with trends where it is wide enough, and keys; elsewhere one line per module and\nperiod. --json prints one object per period: the joints, the controller, the bus, and the events since the last one."
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
    /// One JSON object per line and period.
    #[arg(long, conflicts_with = "plain")]
    pub json: bool,
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
    let machine = Machine::of(&cell.robot);
    let known: BTreeSet<u8> = machine.addresses.iter().copied().collect();
    let live = Arc::new(Mutex::new(LiveState::new(machine, session.zero_unix(), BIT_RATE)));
    session.add_tap(Box::new(LiveTap(Arc::clone(&live))));
    let mut output = Output::new(args, &stop);
    let span = args.time.or(session.is_simulated().then_some(1.0));
    let end = span.map_or(Instant::FAR_FUTURE, |s| session.now() + Duration::from_secs_f64(s));
    let mut period = Duration::from_secs_f64(1e-3 * args.period_ms);
    let mut before = session.host_node().tally();
    let mut ended = Ended::Done;
    let mut last_event = 0;
    while session.now() < end && ended != Ended::Interrupted && !output.quit.load(Ordering::Relaxed) {
        let begun = session.now();
        let shown_at = (begun + period).min(end);
        // A page is shown more often than a terminal.
        let round = if page.is_some() { period.min(PAGE_ROUND) } else { period };
        let waits = |output: &Output| {
            !output.quit.load(Ordering::Relaxed) && !output.pressed.swap(false, Ordering::Relaxed)
        };
        while session.now() < shown_at && ended != Ended::Interrupted && waits(&output) {
            ask(session.host_node(), &modules);
            let until = (session.now() + round).min(shown_at);
            let (quit, pressed) = (&output.quit, &output.pressed);
            ended = session.run(until, &mut |host_node| {
                while host_node.poll_outcome().is_some() {}
                [&*stop, quit, pressed].iter().any(|told| told.load(Ordering::Relaxed))
            })?;
            if stop.swap(false, Ordering::Relaxed) {
                halt(&mut session)?;
                output.halted();
            }
        }
        let span = session.now().saturating_since(begun);
        let snapshot = live.lock().unwrap_or_else(PoisonError::into_inner).snapshot(last_event);
        last_event = snapshot.events.last().map_or(last_event, |event| event.number);
        let written = match &mut output.form {
            Form::Lines => write(&lines::lines(&mut session, before, span)),
            Form::Json => write(&(serde_json::to_string(&snapshot).unwrap_or_default() + "\n")),
            Form::Screen(screen) => {
                let strangers = strangers(session.host_node(), &known);
                for key in screen.terminal.keys() {
                    screen.obey(key, &mut period, &snapshot, &strangers);
                }
                let name = session.name().to_owned();
                screen.show(&name, &snapshot, &strangers)
            }
        };
        before = session.host_node().tally();
        if let Err(error) = written {
            // The reader of a pipe has gone: that is how people end it.
            if error.kind() == std::io::ErrorKind::BrokenPipe {
                break;
            }
            return Err(ExpectedError::new(exit::OUTPUT, format!("cannot write: {error}")));
        }
    }
    output.finish();
    Ok(session.finish()?)
}

/// What is written where.
struct Output {
    form: Form,
    /// The key that ends the program was pressed.
    quit: Arc<AtomicBool>,
    /// A key was pressed: what it changes is shown at once.
    pressed: Arc<AtomicBool>,
}

enum Form {
    Lines,
    Json,
    Screen(Box<OnTerminal>),
}

/// The picture on a terminal, and what its keys have changed.
struct OnTerminal {
    terminal: Terminal,
    screen: Screen,
    view: View,
    /// What a held picture shows.
    held: Option<Box<(Screen, Snapshot, Vec<Stranger>)>>,
    /// Shown last: it stays when the program ends.
    shown: Vec<String>,
}

impl Output {
    fn new(args: &Args, stop: &Arc<AtomicBool>) -> Self {
        let (quit, pressed) = (Arc::<AtomicBool>::default(), Arc::default());
        let form = if args.json {
            Form::Json
        } else if args.plain || !std::io::stdout().is_terminal() {
            Form::Lines
        } else {
            let (size, colours, period_ms) = (size(), has_colours(), args.period_ms.round() as u64);
            let view = View { size, colours, held: false, events: true, period_ms, stopped: None };
            let terminal = Terminal::take(stop, &quit, &pressed);
            let screen = Screen::default();
            Form::Screen(Box::new(OnTerminal { terminal, screen, view, held: None, shown: Vec::new() }))
        };
        Self { form, quit, pressed }
    }

    /// All drives were halted.
    fn halted(&mut self) {
        match &mut self.form {
            Form::Screen(screen) => {
                screen.view.stopped = Some(STOPPED);
                // What the drives do now matters more than what was held.
                screen.held = None;
            }
            Form::Lines | Form::Json => console::note!("{STOPPED}"),
        }
    }

    /// Gives the terminal back; the last picture stays.
    fn finish(self) {
        if let Form::Screen(screen) = self.form {
            let OnTerminal { terminal, mut shown, .. } = *screen;
            let has_keys = terminal.has_keys();
            drop(terminal);
            // The keys have no use any more.
            if has_keys {
                shown.pop();
            }
            while shown.last().is_some_and(String::is_empty) {
                shown.pop();
            }
            console::line!("{}", shown.join("\n"));
        }
    }
}

/// Told after a stop by a key or from the page.
const STOPPED: &str = "stopped from the page or by a key: halt and stop message sent 3 times";
const _: () = assert!(HALTS == 3, "the text above counts them");

impl OnTerminal {
    fn obey(&mut self, key: Key, period: &mut Duration, snapshot: &Snapshot, strangers: &[Stranger]) {
        match key {
            Key::Pause => {
                let now = || Box::new((self.screen.clone(), snapshot.clone(), strangers.to_vec()));
                self.held = if self.held.is_some() { None } else { Some(now()) };
            }
            Key::Events => self.view.events = !self.view.events,
            Key::Slower => *period = (*period + *period).min(PERIOD_MAX),
            Key::Faster => *period = Duration::from_micros(period.as_micros() / 2).max(PERIOD_MIN),
            Key::Quit | Key::Stop => {}
        }
        self.view.period_ms = period.as_micros() / 1_000;
    }

    fn show(&mut self, name: &str, snapshot: &Snapshot, strangers: &[Stranger]) -> std::io::Result<()> {
        self.screen.take(snapshot);
        self.view.size = size();
        self.view.held = self.held.is_some();
        let hints = self.terminal.has_keys().then_some(&HINTS[..]);
        self.shown = match self.held.as_deref() {
            Some((screen, snapshot, strangers)) => {
                screen.picture(name, snapshot, strangers, self.view, hints)
            }
            None => self.screen.picture(name, snapshot, strangers, self.view, hints),
        };
        show(&self.shown)
    }
}

fn write(text: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes()).and_then(|()| out.flush())
}

/// Modules that were heard and are not in the robot file.
fn strangers(host_node: &mut HostNode, known: &BTreeSet<u8>) -> Vec<Stranger> {
    host_node
        .heard()
        .iter()
        .filter(|(module, _)| !known.contains(&module.get()))
        .map(|(module, heard)| Stranger {
            module: module.get(),
            position_rad: heard.position_rad.map(f64::from),
            current_a: heard.current_a.map(f64::from),
            state: heard.state.map_or_else(String::new, in_words),
        })
        .collect()
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
