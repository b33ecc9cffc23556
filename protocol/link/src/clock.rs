//! The monotonic clock of the operating system as [`Instant`]s.

use std::time::{Duration, SystemTime};

use protocol::Instant;

/// Monotonic time since the clock was made, and where that origin lies in Unix time.
///
/// Copies share the origin; links and runners that work together get copies of one clock.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    origin: std::time::Instant,
    unix_origin_us: u64,
}

impl Clock {
    /// Starts at [`Instant::ZERO`] now.
    pub fn start() -> Self {
        let unix = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or(Duration::ZERO);
        Self { origin: std::time::Instant::now(), unix_origin_us: micros(unix) }
    }

    /// Time since the origin.
    pub fn now(&self) -> Instant {
        Instant::from_micros(micros(self.origin.elapsed()))
    }

    /// Unix time of `at`, in microseconds since 1970.
    ///
    /// Counted from the start along the monotonic clock: later adjustments of the system's clock do
    /// not show, so that time stamps of one run never jump.
    pub fn to_unix(&self, at: Instant) -> Instant {
        Instant::from_micros(self.unix_origin_us.saturating_add(at.as_micros()))
    }

    /// The other way round: the time by this clock of `unix`, microseconds since 1970; zero for what
    /// was before the origin.
    pub const fn from_unix(&self, unix: Instant) -> Instant {
        Instant::from_micros(unix.as_micros().saturating_sub(self.unix_origin_us))
    }

    /// A reading of the system's clock as microseconds since 1970.
    pub(crate) fn unix_of(&self, time: SystemTime) -> Instant {
        Instant::from_micros(micros(time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or(Duration::ZERO)))
    }

    /// How long to sleep from now until `until`; zero if it has passed.
    pub fn remaining(&self, until: Instant) -> Duration {
        Duration::from_micros(until.saturating_since(self.now()).as_micros())
    }
}

fn micros(span: Duration) -> u64 {
    u64::try_from(span.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_share_the_origin_and_unix_time_is_now() {
        let clock = Clock::start();
        let copy = clock;
        let (first, second) = (clock.now(), copy.now());
        assert!(second >= first && second < Instant::from_micros(5_000_000));
        let unix = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs();
        let ours = clock.to_unix(clock.now()).as_micros() / 1_000_000;
        assert!(ours.abs_diff(unix) <= 2, "{ours} against {unix}");
    }

    #[test]
    fn a_deadline_in_the_past_leaves_no_time() {
        let clock = Clock::start();
        assert_eq!(clock.remaining(Instant::ZERO), Duration::ZERO);
        assert!(clock.remaining(Instant::from_micros(60_000_000)) > Duration::from_secs(50));
    }
}
