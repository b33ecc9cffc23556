//! Slots: when in the control cycle each drive gets its motion command.
//!
//! # Why slots
//!
//! The certificate of the gains holds for a range of the time between two commands to a drive. Without slots a command goes
//! out as soon as the writes before it are acknowledged: one write less or more moves it by 0.3 to 0.8 ms. With slots the
//! writes are early, and the command waits for its time.
//!
//! # The cycle
//!
//! ```text
//! |<----------- first ------------>|<- spacing ->|      ...      |<----- reply ------>|
//! tick  writes and acknowledges    motion 1      motion 2  ...   motion n   answer    next tick
//! ```
//!
//! * `first`: two writes and their acknowledges of one drive, or one write of every drive.
//! * `spacing`: motion and answer of a drive, 206 bits and stuff bits; more where drives are slow or the period is long.
//! * `reply`: from handing out a request to its answer, at the load of the cycle.
//!
//! `reply` follows from the measured duration C of a cycle ([`crate::groups::powercube::cycle_timing`]) of n drives, W in flight. If the bus is the
//! bottleneck, the bus carries n - 1 other drives and the read for monitoring in the same time: C less their bits. If the drives
//! are the bottleneck, 2n requests take C in W lanes: C·W/2n. Each is an upper bound; the smaller one counts.
//!
//! # What is left
//!
//! A command waits for the frame that occupies the bus at its slot, and for answers of other drives that are ready at the same
//! time (their identifiers win). Each is at most 133 bits. The suite `intervals` measures it.

use protocol::{Duration, JointIndex};

use super::settings::{IN_FLIGHT_MAX, MONITORING};
use crate::groups::powercube::order::Order;
use crate::joints::PerJoint;
use crate::settings::Settings;

/// Bits of write, acknowledge, motion and answer of one drive, without stuff bits; µs at 1 Mbit/s.
const DRIVE_US: u32 = 372;
/// Write and acknowledge, without stuff bits; µs at 1 Mbit/s.
const WRITE_US: u32 = 166;
/// Motion and answer with the usual stuff bits and a tenth more; µs at 1 Mbit/s.
const MOTION_US: u32 = 240;
/// Longest frame of a drive with all stuff bits: what may occupy the bus.
const FRAME_US: u32 = 133;
/// The last motion and its answer may each wait for a frame; µs at 1 Mbit/s.
const SPARE_US: u32 = 250;

/// Offsets from the start of a cycle, µs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Slots {
    first_us: u32,
    spacing_us: u32,
    reply_us: u32,
    joints: u32,
    offset_us: PerJoint<u32>,
}

impl Slots {
    /// Slots in this order for drives and bus with which a cycle, read for monitoring included, takes `cycle_us`.
    pub fn plan(settings: &Settings, cycle_us: u32, order: &Order) -> Self {
        let n = settings.joints.max(1);
        let lanes = IN_FLIGHT_MAX.get(settings).clamp(1, n);
        let others_us = (n - 1) * DRIVE_US
            + if MONITORING.get(settings) {
                crate::groups::powercube::cycle_timing::MONITORING_US
            } else {
                0
            };
        let by_bus_us = cycle_us.saturating_sub(others_us).max(DRIVE_US);
        let by_drives_us = cycle_us.saturating_mul(lanes).checked_div(2 * n).unwrap_or(0);
        let reply_us = by_bus_us.min(by_drives_us.max(DRIVE_US));

        // A short period leaves the drives closer together and the first one less time.
        let room_us = settings.cycle_period_us.saturating_sub(reply_us + SPARE_US);
        let closest_us =
            MOTION_US.max(reply_us.checked_div(lanes).unwrap_or(0)).min(room_us.checked_div(n).unwrap_or(0));
        // Up to the first slot the bus is busy with the writes: one frame less at the end is better than a slot among them.
        let usual_us = room_us - (n - 1) * closest_us;
        let latest_us = usual_us + (SPARE_US - FRAME_US).min(settings.cycle_period_us - room_us);
        let first_us = (2 * (reply_us + FRAME_US)).min(usual_us.max(latest_us.min(n * WRITE_US)));
        // A long period lets each motion have its answer before the next one, as long as a quarter of it stays free.
        let end_us = settings.cycle_period_us - settings.cycle_period_us / 4;
        let spread_us = end_us.saturating_sub(first_us + reply_us).checked_div(n - 1).unwrap_or(0);
        let spacing_us = spread_us.min(reply_us).max(closest_us);
        let mut offset_us = PerJoint::splat(first_us);
        for place in JointIndex::first(n as usize) {
            offset_us.set(order.joint_at(place), first_us + place.get() as u32 * spacing_us);
        }
        Self { first_us, spacing_us, reply_us, joints: n, offset_us }
    }

    /// Slot of the first motion after the start of the cycle.
    pub fn first(&self) -> Duration {
        Duration::from_micros(self.first_us.into())
    }

    /// [`Self::of`], µs.
    pub const fn of_us(&self, joint: JointIndex) -> u32 {
        *self.offset_us.at(joint)
    }

    /// Slot of a joint's motion after the start of the cycle.
    pub fn of(&self, joint: JointIndex) -> Duration {
        Duration::from_micros(self.offset_us.get(joint).into())
    }

    /// Until then the bus is for the writes.
    pub fn writes(&self) -> Duration {
        Duration::from_micros(self.first_us.saturating_sub(FRAME_US).into())
    }

    /// From when on what is no command may be asked: the last motion is on the bus.
    pub fn monitoring(&self) -> Duration {
        let last_us = self.first_us + self.joints.saturating_sub(1) * self.spacing_us;
        Duration::from_micros((last_us + FRAME_US).into())
    }

    /// From the start of a cycle to the last answer, if nothing comes in between.
    pub fn cycle_us(&self) -> u32 {
        self.first_us + self.joints.saturating_sub(1) * self.spacing_us + self.reply_us
    }

    /// From handing out a motion to the drive's measurement, as expected before the first one.
    pub fn expected_phase_us(&self, joint: JointIndex) -> u32 {
        self.of(joint).as_micros() as u32 + self.reply_us / 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(period_us: u32, cycle_us: u32) -> Slots {
        let settings = Settings { cycle_period_us: period_us, ..Settings::powercube6() };
        Slots::plan(&settings, cycle_us, &Order::BASE_FIRST)
    }

    fn offsets_us(slots: &Slots) -> Vec<u64> {
        JointIndex::first(6).map(|joint| slots.of(joint).as_micros()).collect()
    }

    #[test]
    fn default_period_leaves_two_writes_before_the_first_motion_and_an_answer_after_the_last() {
        // Drives that answer after 0.2 ms, give or take 0.1 ms.
        let slots = at(3_000, 2_570);
        let us = offsets_us(&slots);
        assert!((950..1_050).contains(&us[0]), "{us:?}");
        assert!((2_150..2_250).contains(&us[5]), "{us:?}");
        assert!(us.windows(2).all(|pair| pair[1] - pair[0] == 240), "{us:?}");
    }

    #[test]
    fn long_period_spreads_the_motions_until_each_has_its_answer_before_the_next() {
        let slots = at(17_000, 2_570);
        let us = offsets_us(&slots);
        assert_eq!(us[0], 2 * (u64::from(slots.reply_us) + u64::from(FRAME_US)));
        assert!(us.windows(2).all(|pair| pair[1] - pair[0] == u64::from(slots.reply_us)), "{us:?}");
    }

    #[test]
    fn slots_stay_in_order_within_the_cycle_for_all_settings() {
        for joints in 1..=8 {
            for in_flight_max in 1..=8 {
                for cycle_period_us in [1_000, 2_000, 3_000, 5_000, 10_000, 40_000] {
                    for cycle_us in [0, 500, 2_000, 2_600, 3_000, 9_000, 39_000, u32::MAX / 8] {
                        let mut settings = Settings { joints, cycle_period_us, ..Settings::powercube6() };
                        IN_FLIGHT_MAX.set(&mut settings, in_flight_max);
                        let slots = Slots::plan(&settings, cycle_us, &Order::BASE_FIRST);
                        let us: Vec<u64> =
                            settings.joints().map(|joint| slots.of(joint).as_micros()).collect();
                        assert!(us.is_sorted(), "{settings:?}");
                        assert!(us.iter().all(|us| *us <= u64::from(cycle_period_us)), "{cycle_us}: {us:?}");
                    }
                }
            }
        }
    }
}
