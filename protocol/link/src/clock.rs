//! Time as [`Instant`]s: the monotonic clock of the operating system, or one that the program moves.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use protocol::Instant;

/// Time since the clock was made, and where that origin lies in Unix time.
///
/// Copies share the origin; links and runners that work together get copies of one clock.
///
/// A [manual](Self::manual) clock moves only when it is [set](Self::set). [`wait`](crate::wait) then does not
/// sleep: it moves the clock to the earliest deadline, or requests this from the far side of a lock-step link. The
/// same code therefore runs in real time and in virtual time.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    source: Source,
    unix_origin_us: u64,
}

#[derive(Clone, Copy, Debug)]
enum Source {
    Monotonic(std::time::Instant),
    Manual(&'static AtomicU64),
}

impl Clock {
    /// Starts at [`Instant::ZERO`] now.
    pub fn start() -> Self {
        let unix = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or(Duration::ZERO);
        Self { source: Source::Monotonic(std::time::Instant::now()), unix_origin_us: micros(unix) }
    }

    /// Stands at [`Instant::ZERO`]; its Unix time begins in 1970.
    ///
    /// Eight bytes stay in use until the program ends, so that the clock can be copied.
    pub fn manual() -> Self {
        Self { source: Source::Manual(Box::leak(Box::default())), unix_origin_us: 0 }
    }

    /// True for a clock that the program moves.
    pub const fn is_manual(&self) -> bool {
        matches!(self.source, Source::Manual(_))
    }

    /// Moves a manual clock forward to `to`. Does nothing if `to` has passed, and nothing to a monotonic clock.
    pub fn set(&self, to: Instant) {
        if let Source::Manual(now) = self.source {
            now.fetch_max(to.as_micros(), Ordering::SeqCst);
        }
    }

    /// Time since the origin.
    pub fn now(&self) -> Instant {
        Instant::from_micros(match self.source {
            Source::Monotonic(origin) => micros(origin.elapsed()),
            Source::Manual(now) => now.load(Ordering::SeqCst),
        })
    }

    /// Unix time of `at`, in microseconds since 1970.
    ///
    /// Counted from the start along the clock: later adjustments of the system's clock have no effect, so that time
    /// stamps of one run never jump.
    pub fn to_unix(&self, at: Instant) -> Instant {
        Instant::from_micros(self.unix_origin_us.saturating_add(at.as_micros()))
    }

    /// Inverse of [`Self::to_unix`]: the time by this clock of `unix`, microseconds since 1970; zero for times
    /// before the origin.
    pub const fn from_unix(&self, unix: Instant) -> Instant {
        Instant::from_micros(unix.as_micros().saturating_sub(self.unix_origin_us))
    }

    /// A reading of the system's clock as microseconds since 1970.
    pub(crate) fn unix_of(&self, time: SystemTime) -> Instant {
        Instant::from_micros(micros(time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or(Duration::ZERO)))
    }

    /// How long from now until `until`; zero if it has passed.
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
    fn copies_share_the_origin_and_unix_time_is_the_system_time() {
        let before = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_micros();
        let clock = Clock::start();
        let copy = clock;
        let (first, second) = (clock.now(), copy.now());
        assert!(second >= first);
        let after = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_micros();
        let ours = u128::from(clock.to_unix(Instant::ZERO).as_micros());
        assert!((before..=after).contains(&ours), "{before} {ours} {after}");
        assert_eq!(clock.from_unix(clock.to_unix(second)), second);
    }

    #[test]
    fn a_deadline_in_the_past_leaves_no_time() {
        let clock = Clock::start();
        assert_eq!(clock.remaining(Instant::ZERO), Duration::ZERO);
        assert!(clock.remaining(Instant::FAR_FUTURE) > Duration::from_secs(3600));
    }

    #[test]
    fn a_manual_clock_moves_only_when_set_and_only_forward() {
        let clock = Clock::manual();
        let copy = clock;
        let at = Instant::from_micros(1_500);
        copy.set(at);
        copy.set(Instant::ZERO);
        assert_eq!((clock.now(), clock.to_unix(at)), (at, at));
        assert_eq!(clock.remaining(Instant::from_micros(2_000)), Duration::from_micros(500));
        let real = Clock::start();
        real.set(Instant::FAR_FUTURE);
        assert!(real.now() < Instant::FAR_FUTURE);
    }
}
