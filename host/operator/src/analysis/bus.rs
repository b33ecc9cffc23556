//! Bus time taken, with the exact length of every frame ([`protocol::bits`]), interframe space included.

use std::collections::BTreeMap;

use protocol::bits;
use protocol::powercube::{Address, Channel};
use protocol::{Frame, Id};
use serde::Serialize;

use super::collect::Reading;
use super::{AFTER_S, BEFORE_S, PlanClock};
use crate::log::candump::Line;
use crate::samples::BitTimes;

/// Width of a step of the curve, s.
pub const STEP_S: f64 = 0.01;

/// Purpose of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Traffic {
    /// To a drive.
    Request,
    /// From a drive.
    Answer,
    /// To all drives.
    Broadcast,
    HostLink,
    /// No id of this cell.
    Foreign,
}

impl Traffic {
    /// Purpose of `frame`.
    #[must_use]
    pub fn of(frame: &Frame) -> Self {
        match (Address::of(frame.id()), frame.id()) {
            (Some(Address::Module(Channel::Get | Channel::Put, _)), _) => Self::Request,
            (Some(Address::Module(Channel::Ack | Channel::State, _)), _) => Self::Answer,
            (Some(Address::Broadcast), _) => Self::Broadcast,
            (None, Id::Extended(_)) => Self::HostLink,
            (None, Id::Standard(_)) => Self::Foreign,
        }
    }
}

/// Frames of one identifier while the plan ran.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IdUse {
    /// The identifier in hexadecimal, three digits for 11-bit and eight for 29-bit ones.
    pub id: String,
    /// Purpose of the frames.
    pub traffic: Traffic,
    pub frames: u64,
    /// Bus time as a share of the plan's.
    pub share: f64,
}

/// A frame on the time axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slot {
    /// Begin in time of the plan, s.
    pub from_t_s: f64,
    /// End in time of the plan, s.
    pub to_t_s: f64,
    pub frame: Frame,
}

/// Bus time taken.
#[derive(Clone, Debug, Serialize)]
pub struct BusUse {
    /// Bit rate that the shares are for, bit/s.
    pub bit_rate_bit_s: f64,
    /// Frames while the plan ran.
    pub frames: u64,
    /// Bus time taken as a share of the plan's.
    pub utilisation: f64,
    /// The largest share within one step of [`STEP_S`] during the plan.
    pub utilisation_peak: f64,
    /// By identifier, largest share first.
    pub ids: Vec<IdUse>,
    /// Share of bus time in steps of [`STEP_S`], with the begin of each.
    #[serde(skip)]
    pub over_time: Vec<Reading>,
    /// Every frame from [`BEFORE_S`] before the plan to [`AFTER_S`] after it.
    #[serde(skip)]
    pub slots: Vec<Slot>,
}

#[must_use]
pub fn usage(frames: &[Line], clock: PlanClock, end_t_s: f64, times: BitTimes) -> BusUse {
    let steps = ((end_t_s + AFTER_S + BEFORE_S) / STEP_S).ceil() as usize;
    let mut taken_s = vec![0.0; steps];
    let mut ids: BTreeMap<(Traffic, u32), (String, u64, f64)> = BTreeMap::new();
    let (mut count, mut busy_s, mut slots) = (0, 0.0, Vec::new());
    for line in frames {
        let to_t_s = clock.t_s(line.at);
        let length = bits::length(&line.frame);
        let from_t_s = to_t_s - times.frame_s(length);
        if from_t_s < -BEFORE_S || to_t_s > end_t_s + AFTER_S {
            continue;
        }
        let took_s = times.frame_s(length) + f64::from(bits::INTERFRAME_SPACE) * times.nominal_s;
        slots.push(Slot { from_t_s, to_t_s, frame: line.frame });
        spread(&mut taken_s, from_t_s, took_s);
        if (0.0..=end_t_s).contains(&to_t_s) {
            count += 1;
            busy_s += took_s;
            let id = line.frame.id();
            let name = match id {
                Id::Standard(id) => format!("{:03X}", id.get()),
                Id::Extended(_) => format!("{:08X}", id.raw()),
            };
            let entry = ids.entry((Traffic::of(&line.frame), id.raw())).or_insert((name, 0, 0.0));
            entry.1 += 1;
            entry.2 += took_s;
        }
    }
    let over_time: Vec<Reading> = taken_s
        .iter()
        .enumerate()
        .map(|(i, s)| Reading { t_s: -BEFORE_S + STEP_S * i as f64, value: s / STEP_S })
        .collect();
    let mut ids: Vec<IdUse> = ids
        .into_iter()
        .map(|((traffic, _), (id, frames, s))| IdUse { id, traffic, frames, share: s / end_t_s })
        .collect();
    ids.sort_by(|a, b| b.share.total_cmp(&a.share));
    let inside = over_time.iter().filter(|r| r.t_s >= -1e-9 && r.t_s + STEP_S <= end_t_s);
    BusUse {
        bit_rate_bit_s: 1.0 / times.nominal_s,
        frames: count,
        utilisation: busy_s / end_t_s,
        utilisation_peak: inside.map(|r| r.value).fold(0.0, f64::max),
        ids,
        over_time,
        slots,
    }
}

/// Adds a span to the steps that it covers.
fn spread(taken_s: &mut [f64], from_t_s: f64, took_s: f64) {
    let (mut at, end) = (from_t_s + BEFORE_S, from_t_s + BEFORE_S + took_s);
    while at < end - 1e-12 {
        // A span never begins before the first step: earlier frames were left out.
        let step = (at / STEP_S + 1e-9) as usize;
        let until = (STEP_S * (step + 1) as f64).min(end);
        let Some(taken) = taken_s.get_mut(step) else { return };
        *taken += until - at;
        at = until;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{Instant, StandardId};

    #[test]
    fn a_bus_of_known_frames_is_taken_as_much_as_their_bits_say() {
        // ISO 11898-1: 47 + 8 × 6 bits with interframe space, and the stuff bits of this very frame.
        let frame = Frame::from_array(StandardId::from_low_bits(0x0E1), [0x0B, 0x0E, 0xAA, 0x55, 0xAA, 0x55]);
        let stuff = f64::from(bits::length(&frame).stuff);
        let at = |k: u64| Instant::from_micros(1_000_000 + 1_000 * k);
        let frames: Vec<Line> =
            (1..=100).map(|k| Line { number: k as usize, at: at(k), frame, sent: None }).collect();
        let clock = PlanClock::starting(Instant::from_micros(1_000_000));
        let usage = usage(&frames, clock, 0.1, BitTimes::of(1_000_000, None));
        let expected = (95.0 + stuff) * 1e-3;
        assert_eq!(usage.frames, 100);
        assert!((usage.utilisation - expected).abs() < 1e-9, "{} {expected}", usage.utilisation);
        assert!((usage.utilisation_peak - expected).abs() < 2e-2 * expected + 1e-3);
        assert_eq!((usage.ids.len(), usage.ids[0].id.as_str(), usage.ids[0].frames), (1, "0E1", 100));
        let sum: f64 = usage.over_time.iter().map(|r| r.value * STEP_S).sum();
        assert!((sum - 0.1 * expected).abs() < 1e-9, "no bit is lost at the border of two steps: {sum}");
    }

    #[test]
    fn frames_of_can_fd_take_their_bits_at_two_rates() {
        let data = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC];
        let frame = Frame::from_array(StandardId::from_low_bits(1), data).with_fd(protocol::FdFlags::BRS);
        let at = |k: u64| Instant::from_micros(1_000_000 + 1_000 * k);
        let frames: Vec<Line> =
            (1..=100).map(|k| Line { number: k as usize, at: at(k), frame, sent: None }).collect();
        let clock = PlanClock::starting(Instant::from_micros(1_000_000));
        // 17 bits and 2 stuff bits, 96 and 12 at 5 Mbit/s, 10 bits and 3 behind.
        for (data_bit_rate_bit_s, us) in [(Some(5_000_000), 19.0 + 108.0 / 5.0 + 13.0), (None, 140.0)] {
            let usage = usage(&frames, clock, 0.1, BitTimes::of(1_000_000, data_bit_rate_bit_s));
            assert!((usage.utilisation - 1e-3 * us).abs() < 1e-9, "{} {us}", usage.utilisation);
        }
    }
}
