//! Ctrl-C, SIGTERM and SIGHUP: the first one asks the program to end in order, a later one ends it at once.

use std::io::Read;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::{flag, low_level};

/// Signals that follow the first one within this time are part of it. `timeout`, service managers and shells send one to
/// the process and one to its group: ending at once would lose a result, or leave drives without a halt.
const ONE_REQUEST: Duration = Duration::from_millis(500);

/// The flag that Ctrl-C, SIGTERM and SIGHUP set. A later signal ends the process with `exit_code`. The handlers are installed
/// once per process, with the exit code of the first call. A SIGHUP that the parent has chosen to ignore (`nohup`) stays
/// ignored.
pub fn interrupt(exit_code: u8) -> Arc<AtomicBool> {
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    Arc::clone(FLAG.get_or_init(|| {
        let flag = Arc::new(AtomicBool::new(false));
        let signals: Vec<i32> = [SIGINT, SIGTERM, SIGHUP]
            .into_iter()
            .filter(|signal| *signal != SIGHUP || !is_ignored(SIGHUP))
            .collect();
        // Without the thread that waits, any signal after the first one ends the program.
        let insists = insists_after_first(&signals).unwrap_or_else(|_| Arc::clone(&flag));
        for signal in signals {
            // Handlers run in the order of registration. The first signal must find the condition unset, even if it is the flag.
            let _ = flag::register_conditional_shutdown(signal, i32::from(exit_code), Arc::clone(&insists));
            let _ = flag::register(signal, Arc::clone(&flag));
        }
        flag
    }))
}

/// A flag that becomes true [`ONE_REQUEST`] after the first of these signals.
fn insists_after_first(signals: &[i32]) -> std::io::Result<Arc<AtomicBool>> {
    let (mut wakes, signalled) = UnixStream::pair()?;
    for signal in signals {
        low_level::pipe::register(*signal, signalled.try_clone()?)?;
    }
    let insists = Arc::new(AtomicBool::new(false));
    let set = Arc::clone(&insists);
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
        if wakes.read_exact(&mut [0]).is_ok() {
            std::thread::sleep(ONE_REQUEST);
            set.store(true, Ordering::SeqCst);
        }
    })?;
    Ok(insists)
}

/// The process was started with this signal ignored, as far as the system says.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
        .is_some_and(|mask| mask >> (signal - 1) & 1 != 0)
}
