//! Old data: the one rule of page, lines, JSON and robotics viewers.
//!
//! Data that were not received again for [`OLD_AFTER`] may be wrong by now. An angle stays and is marked; a state
//! becomes `not heard for N s` and is never green; speeds, errors and currents are no longer shown.

use protocol::{Duration, Instant};
use serde::Serialize;

/// Controllers report ten times a second, and modules get requests at least five times a second.
pub const OLD_AFTER: Duration = Duration::from_secs(1);

/// Colour of something shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tone {
    /// As it should be, and received just now.
    Good,
    /// Needs attention.
    Warn,
    /// Stopped, or not received.
    Bad,
    /// Without a rating.
    Plain,
}

/// Time since data were received.
#[derive(Clone, Copy, Debug)]
pub struct Age(Duration);

impl Age {
    /// For data received at `at`.
    pub fn of(at: Instant, now: Instant) -> Self {
        Self(now.saturating_since(at))
    }

    /// It need not be so any more.
    pub fn is_old(self) -> bool {
        self.0 > OLD_AFTER
    }

    /// In seconds.
    pub fn s(self) -> f64 {
        self.0.as_secs_f64()
    }

    /// Text that replaces a state.
    pub fn words(self) -> String {
        format!("not heard for {:.0} s", self.s())
    }
}

/// A value with the time at which it was received.
#[derive(Clone, Copy, Debug)]
pub struct Heard<T> {
    pub at: Instant,
    pub value: T,
}

impl<T> Heard<T> {
    pub const fn new(at: Instant, value: T) -> Self {
        Self { at, value }
    }

    pub fn age(&self, now: Instant) -> Age {
        Age::of(self.at, now)
    }

    /// The value, unless it is old.
    pub fn fresh(self, now: Instant) -> Option<T> {
        (!self.age(now).is_old()).then_some(self.value)
    }
}
