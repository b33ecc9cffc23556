//! Number of frames and utilisation, counted again from the frames themselves.

use protocol::{Frame, Instant, bits};

use super::{Checker, Findings};
use crate::bus::BusConfig;

/// Checker of the amount of traffic.
#[derive(Clone, Debug)]
pub struct Traffic {
    frames_min: Option<u64>,
    utilisation_max: Option<f64>,
    frames: u64,
    busy_ns: u64,
    bit_ns: [u64; 2],
}

impl Traffic {
    /// Bounds on the number of good frames and on their share of the time on `bus`.
    pub fn new(frames_min: Option<u64>, utilisation_max: Option<f64>, bus: &BusConfig) -> Self {
        let bit_ns = [bus.bit_rate_bit_s, bus.data_bit_rate_bit_s.unwrap_or(bus.bit_rate_bit_s)]
            .map(|rate| u64::from(1_000_000_000 / rate));
        Self { frames_min, utilisation_max, frames: 0, busy_ns: 0, bit_ns }
    }
}

impl Checker for Traffic {
    fn on_frame(&mut self, _: Instant, frame: &Frame, _: &mut Findings) {
        self.frames += 1;
        let [bit_ns, fast_bit_ns] = self.bit_ns;
        self.busy_ns += bits::length(frame).time_ns(bit_ns, fast_bit_ns);
    }

    fn finish(&mut self, end: Instant, findings: &mut Findings) {
        if let Some(min) = self.frames_min
            && self.frames < min
        {
            findings.add(end, None, || format!("{} frames, at least {min} expected", self.frames));
        }
        let available = end.as_secs_f64() * 1e9;
        if let Some(max) = self.utilisation_max
            && available > 0.0
            && self.busy_ns as f64 / available > max
        {
            let found = self.busy_ns as f64 / available;
            findings.add(end, None, || format!("utilisation {found:.3}, at most {max:.3} expected"));
        }
    }
}
