//! Spans of time as f32 seconds and back, without 64-bit or double arithmetic: a Cortex-M4 has those in software
//! only.

use protocol::{Duration, Instant};

/// Seconds; spans of 71 minutes and more count as 71 minutes.
pub fn seconds(span: Duration) -> f32 {
    u32::try_from(span.as_micros()).unwrap_or(u32::MAX) as f32 * 1e-6
}

/// Seconds from one time to another, negative if the second is earlier; limited to 71 minutes either way.
pub fn seconds_between(from: Instant, to: Instant) -> f32 {
    if to >= from { seconds(to.saturating_since(from)) } else { -seconds(from.saturating_since(to)) }
}

/// Seconds as a span, rounded to the nearest microsecond. NaN and negative values give zero; 71 minutes is the largest.
pub fn of_seconds(s: f32) -> Duration {
    // A float-to-integer cast saturates and maps NaN to zero.
    Duration::from_micros(u64::from((s * 1e6 + 0.5) as u32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_convert_both_ways_and_saturate() {
        assert_eq!(seconds(Duration::from_micros(3_000)), 0.003);
        let (early, late) = (Instant::from_micros(1_000), Instant::from_micros(1_044));
        assert_eq!((seconds_between(early, late), seconds_between(late, early)), (44e-6, -44e-6));
        assert_eq!(of_seconds(0.017), Duration::from_micros(17_000));
        assert_eq!(of_seconds(f32::NAN), Duration::ZERO);
        assert_eq!(of_seconds(-1.0), Duration::ZERO);
        assert_eq!(of_seconds(1e9), Duration::from_micros(u32::MAX.into()));
        assert_eq!(seconds(Duration::MAX), u32::MAX as f32 * 1e-6);
    }
}
