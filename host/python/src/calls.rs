//! Long calls: they do not hold the lock of the interpreter, and Ctrl-C ends them.
//!
//! The work runs in a thread of its own; the calling thread waits for it and asks every 50 ms whether Python has had a signal.
//! If a handler raises, as that of Ctrl-C does, the call ends at once. The work then gets the order to stop. It owns all that it uses,
//! so it may end later; its result is dropped.

use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

/// Time between two looks at signals.
const LOOK: Duration = Duration::from_millis(50);
/// Stack of the thread, bytes: that of the program's first thread on Linux.
const STACK_BYTES: usize = 8 << 20;

/// Does the work; `stop` is set when nobody waits for it any more.
///
/// # Errors
/// The exception of a signal handler, or a thread that cannot be started. A panic of the work is raised again in the caller.
pub(crate) fn interruptible<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Arc<AtomicBool>) -> T + Send + 'static,
) -> PyResult<T> {
    let stop = Arc::new(AtomicBool::new(false));
    let (done, mut answer) = sync_channel(1);
    let reported = Arc::clone(&stop);
    let thread = thread::Builder::new().name("cubecell".to_owned()).stack_size(STACK_BYTES);
    let thread = thread.spawn(move || {
        // If nobody waits any more, nobody wants the result.
        let _ = done.send(work(&reported));
    });
    let thread = thread.map_err(|error| PyOSError::new_err(error.to_string()))?;
    loop {
        let waiting = &mut answer;
        match py.detach(move || waiting.recv_timeout(LOOK)) {
            Ok(result) => return Ok(result),
            Err(RecvTimeoutError::Timeout) => {
                py.check_signals().inspect_err(|_| stop.store(true, Ordering::Relaxed))?;
            }
            Err(RecvTimeoutError::Disconnected) => match thread.join() {
                Err(panic) => resume_unwind(panic),
                Ok(()) => unreachable!("the thread sends a result before it ends"),
            },
        }
    }
}
