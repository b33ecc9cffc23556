//! Throws with faults in the simulated cell, judged from the plant itself.
//!
//! ```text
//!   scenario ──▶ bench::throw ──▶ evidence ──▶ judge ──▶ verdict
//!                 real host job    what was reported (job, group state)
//!                 real controller  what was seen (trace of the plant)
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`mod@bench`] | one throw of a scenario: plan, host job and controller are the real ones |
//! | [`evidence`] | what a run leaves: what was reported, what was seen |
//! | [`judge`] | the rules, with their bounds |
//! | [`phases`] | instants of a nominal run, from its own events |
//! | [`matrix`] | every kind of fault, in every phase, at every joint |
//! | [`swarm`] | random combinations of faults, arms and strangers |
//! | [`mod@shrink`] | the smallest scenario that still breaks a rule |

pub mod bench;
pub mod evidence;
pub mod judge;
pub mod matrix;
pub mod phases;
pub mod shrink;
pub mod swarm;

pub use bench::{Bench, Family};
pub use evidence::{Evidence, ReportedOutcome, Seen};
pub use judge::{Finding, Rule, Verdict};
pub use swarm::Swarm;
