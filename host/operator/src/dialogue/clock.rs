//! The controller's clock as seen from here: an offset with guaranteed bounds, not an estimate with a deviation.
//!
//! A reading u that the controller took between the request at t₀ and the answer at t₁ shows that the offset (its
//! time less ours) is within u - t₁ ..= u - t₀. Readings are intersected; between them the bounds widen by
//! [`DRIFT`], the largest difference of two crystals. If a reading does not fit into the bounds, the clock has
//! jumped: the controller was started again.

use protocol::cyphal::bits::Decode;
use protocol::cyphal::cubecell::command::{CLOCK, ClockReading};
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant};

use super::operator::OperatorError;
use crate::bus::session::Session;

/// Largest rate between the two clocks: 100 ppm each.
pub const DRIFT: f64 = 200e-6;
/// Readings of one comparison: the one with the shortest round trip is the most exact.
const READINGS: usize = 5;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControllerClock {
    bounds: Option<Bounds>,
}

/// Offset of the controller's clock, µs, at a time of ours.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Bounds {
    low_us: f64,
    high_us: f64,
    at: Instant,
}

impl Bounds {
    fn widened(self, at: Instant) -> Self {
        let since_us = at.as_micros().abs_diff(self.at.as_micros()) as f64;
        let drift_us = DRIFT * since_us;
        Self { low_us: self.low_us - drift_us, high_us: self.high_us + drift_us, at }
    }
}

impl ControllerClock {
    /// Takes a reading of the controller's clock that was made between `sent` and `received`.
    ///
    /// # Errors
    /// How far the reading is outside the bounds, µs; the bounds are those of this reading alone then.
    pub fn take(&mut self, sent: Instant, received: Instant, uptime_us: u64) -> Result<(), f64> {
        let reading = Bounds {
            low_us: uptime_us as f64 - received.as_micros() as f64,
            high_us: uptime_us as f64 - sent.as_micros() as f64,
            at: received,
        };
        let before = self.bounds.replace(reading);
        let Some(before) = before.map(|before| before.widened(received)) else { return Ok(()) };
        let (low_us, high_us) = (reading.low_us.max(before.low_us), reading.high_us.min(before.high_us));
        if low_us > high_us {
            let jump = if reading.high_us < before.low_us {
                reading.high_us - before.low_us
            } else {
                reading.low_us - before.high_us
            };
            return Err(jump);
        }
        self.bounds = Some(Bounds { low_us, high_us, at: received });
        Ok(())
    }

    /// Time of the controller at a time of ours, and its largest error either way; `None` before the first reading.
    #[must_use]
    pub fn controller_time(&self, ours: Instant) -> Option<(Instant, Duration)> {
        let bounds = self.bounds?.widened(ours);
        let (middle_us, off_us) =
            (0.5 * (bounds.low_us + bounds.high_us), 0.5 * (bounds.high_us - bounds.low_us));
        let at_us = (ours.as_micros() as f64 + middle_us).round().max(0.0);
        Some((Instant::from_micros(at_us as u64), Duration::from_micros(off_us.ceil() as u64)))
    }

    /// Our time at a time of the controller, and by how much it may be off either way.
    #[must_use]
    pub fn our_time(&self, controller: Instant) -> Option<(Instant, Duration)> {
        let bounds = self.bounds?;
        let near_us = controller.as_micros() as f64 - 0.5 * (bounds.low_us + bounds.high_us);
        let near = Instant::from_micros(near_us.round().max(0.0) as u64);
        let (_, off) = self.controller_time(near)?;
        Some((near, off))
    }
}

impl Session {
    /// Reads the clock of a controller several times into `clock`. Repeated every few seconds, it is known to some
    /// tenths of a millisecond on a quiet bus.
    ///
    /// # Errors
    /// [`OperatorError::ClockJumped`] if the readings contradict those before; or another [`OperatorError`].
    pub fn read_clock(&mut self, node: NodeId, clock: &mut ControllerClock) -> Result<(), OperatorError> {
        (0..READINGS).try_for_each(|_| self.look_at_clock(node, clock))
    }

    /// Reads the clock of a controller once into `clock`.
    pub fn look_at_clock(&mut self, node: NodeId, clock: &mut ControllerClock) -> Result<(), OperatorError> {
        let sent = self.now();
        let output = self.order(node, "the time", CLOCK, &())?;
        let reading = ClockReading::from_bytes(&output).map_err(|_| OperatorError::Unreadable { node })?;
        clock
            .take(sent, self.now(), reading.uptime_us)
            .map_err(|jump_us| OperatorError::ClockJumped { node, jump_ms: jump_us * 1e-3 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const US: fn(u64) -> Instant = Instant::from_micros;

    #[test]
    fn a_clock_that_was_never_read_gives_no_time() {
        assert_eq!(ControllerClock::default().controller_time(US(5)), None);
        assert_eq!(ControllerClock::default().our_time(US(5)), None);
    }

    #[test]
    fn a_controller_that_starts_anew_is_a_jump_and_then_the_new_clock_holds() {
        let mut clock = ControllerClock::default();
        clock.take(US(1_000_000), US(1_001_000), 500_000).unwrap();
        let jump_us = clock.take(US(2_000_000), US(2_001_000), 10_000).unwrap_err();
        assert!((-1_493_000.0..-1_488_000.0).contains(&jump_us), "{jump_us}");
        let (at, off) = clock.controller_time(US(2_001_000)).unwrap();
        assert_eq!((at, off), (US(10_500), Duration::from_micros(500)));
    }

    proptest! {
        #[test]
        fn the_true_time_is_always_within_the_stated_bounds(
            rate_ppm in -190.0f64..190.0, offset_us in 0u64..1_000_000_000,
            readings in proptest::collection::vec((1_000u64..3_000_000, 100u64..5_000, 0.0f64..1.0), 1..30),
        ) {
            let truth = |ours_us: f64| offset_us as f64 + ours_us * (1.0 + rate_ppm * 1e-6);
            let (mut clock, mut now_us) = (ControllerClock::default(), 10_000_000u64);
            for (wait_us, round_trip_us, share) in readings {
                now_us += wait_us;
                let taken_us = now_us as f64 + share * round_trip_us as f64;
                let result = clock.take(US(now_us), US(now_us + round_trip_us), truth(taken_us).round() as u64);
                prop_assert!(result.is_ok(), "{result:?}");
                now_us += round_trip_us;
                for later_us in [0, 1_000_000] {
                    let (at, off) = clock.controller_time(US(now_us + later_us)).unwrap();
                    let error_us = (at.as_micros() as f64 - truth((now_us + later_us) as f64)).abs();
                    prop_assert!(error_us <= off.as_micros() as f64 + 2.0, "{error_us} of {off}");
                    let (back, _) = clock.our_time(at).unwrap();
                    let there_and_back_us = back.as_micros().abs_diff(now_us + later_us);
                    prop_assert!(there_and_back_us <= off.as_micros() + 1);
                }
            }
        }
    }
}
