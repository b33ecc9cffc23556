//! Record of the events on the bus.
//!
//! | file | holds |
//! |---|---|
//! | [`candump`] | text log in the form of `candump -L`, written while the run goes on |
//! | [`trace`] | the same in memory, 24 bytes an entry, bounded |

pub mod candump;
pub mod trace;

pub use candump::CandumpLog;
pub use trace::{Trace, TraceEntry};
