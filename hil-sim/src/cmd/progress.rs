//! Progress of long runs, and Ctrl-C.

use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// A bar on a terminal, nothing elsewhere: a log file full of bars helps nobody.
pub(super) fn bar(length: u64, quiet: bool) -> ProgressBar {
    let bar = ProgressBar::new(length);
    if quiet || !std::io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    let template = "{bar:30} {percent:>3} % {msg} (ends in {eta})";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

/// Exit code of a process that a later signal ends. Shells report the same code for a command that Ctrl-C ended.
const INTERRUPTED: u8 = 130;

/// Becomes true with Ctrl-C, SIGTERM or SIGHUP; one that comes half a second later or more ends the program at once.
#[derive(Clone, Debug)]
pub(super) struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Listens from now on. Where that is not possible the signal ends the program as usual.
    pub(super) fn listen() -> Self {
        Self(console::interrupt::interrupt(INTERRUPTED))
    }

    pub(super) fn came(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// An event, as a JSON line or as text.
pub(super) fn say(json: bool, what: &str, text: &str) {
    if json {
        console::line!("{}", serde_json::json!({ "event": what, "text": text }));
    } else {
        console::note!("{what}: {text}");
    }
}
