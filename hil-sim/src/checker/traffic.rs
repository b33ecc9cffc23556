//! Number of frames and utilisation, counted again from the frames themselves.

use protocol::{Frame, Instant, bits};

use super::{Checker, Findings};

/// Checker of the amount of traffic.
#[derive(Clone, Debug)]
pub struct Traffic {
    frames_min: Option<u64>,
    utilisation_max: Option<f64>,
    frames: u64,
    bits: u64,
    bit_rate_bit_s: f64,
}

impl Traffic {
    /// Bounds on the number of good frames and on their share of the time at a bit rate.
    pub fn new(frames_min: Option<u64>, utilisation_max: Option<f64>, bit_rate_bit_s: u32) -> Self {
        Self { frames_min, utilisation_max, frames: 0, bits: 0, bit_rate_bit_s: f64::from(bit_rate_bit_s) }
    }
}

impl Checker for Traffic {
    fn on_frame(&mut self, _: Instant, frame: &Frame, _: &mut Findings) {
        self.frames += 1;
        self.bits += u64::from(bits::length(frame).with_interframe_space());
    }

    fn finish(&mut self, end: Instant, findings: &mut Findings) {
        if let Some(min) = self.frames_min
            && self.frames < min
        {
            findings.add(end, None, || format!("{} frames, at least {min} expected", self.frames));
        }
        let available = end.as_secs_f64() * self.bit_rate_bit_s;
        if let Some(max) = self.utilisation_max
            && available > 0.0
            && self.bits as f64 / available > max
        {
            let found = self.bits as f64 / available;
            findings.add(end, None, || format!("utilisation {found:.3}, at most {max:.3} expected"));
        }
    }
}
