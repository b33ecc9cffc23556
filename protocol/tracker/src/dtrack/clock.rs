//! Time and order of frames.

use protocol::{Duration, Instant};

const DAY_S: f64 = 86_400.0;

/// Turns `ts` (seconds since midnight) into a time that continues over midnight.
///
/// The origin is the midnight before the first stamp. A step of more than half a day counts as midnight; a stamp a
/// little older than the one before is an overtaken datagram and keeps its order.
#[derive(Clone, Copy, Debug, Default)]
pub struct DayClock {
    days: u64,
    last_s: Option<f64>,
}

impl DayClock {
    /// Before the first stamp.
    #[must_use]
    pub const fn new() -> Self {
        Self { days: 0, last_s: None }
    }

    /// The time of a stamp in seconds since midnight.
    pub fn unwrap_day(&mut self, ts_s: f64) -> Instant {
        let step = ts_s - self.last_s.unwrap_or(ts_s);
        let mut day = self.days;
        if step < -0.5 * DAY_S {
            // Midnight has passed.
            self.days += 1;
            day = self.days;
            self.last_s = Some(ts_s);
        } else if step > 0.5 * DAY_S && self.days > 0 {
            // A datagram from before midnight that arrived after one of the new day.
            day = self.days - 1;
        } else {
            self.last_s = Some(self.last_s.map_or(ts_s, |last| last.max(ts_s)));
        }
        Instant::ZERO + Duration::from_secs_f64(day as f64 * DAY_S + ts_s)
    }
}

/// Whether a frame is newer than the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    First,
    /// Newer; this many frames are missing between (a divisor looks the same).
    New {
        /// Frame numbers that were skipped.
        skipped: u64,
    },
    /// The same number, or an older one: an overtaken datagram. Not to be used.
    Old,
    /// The counter jumped far back: the tracker was started again.
    Restart,
}

/// Judges frames by their counter.
#[derive(Clone, Copy, Debug)]
pub struct FrameGate {
    last: Option<u64>,
    restart_after: u64,
}

impl FrameGate {
    /// A step back of more than `restart_after` frames is a restart, a smaller one an old frame.
    #[must_use]
    pub const fn new(restart_after: u64) -> Self {
        Self { last: None, restart_after }
    }

    pub fn judge(&mut self, frame: u64) -> Verdict {
        let Some(last) = self.last else {
            self.last = Some(frame);
            return Verdict::First;
        };
        if frame > last {
            self.last = Some(frame);
            Verdict::New { skipped: frame - last - 1 }
        } else if last - frame > self.restart_after {
            self.last = Some(frame);
            Verdict::Restart
        } else {
            Verdict::Old
        }
    }
}
