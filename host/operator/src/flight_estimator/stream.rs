//! Tracker datagrams to markers with times on the local clock.

use nalgebra::Vector3;
use protocol::Instant;
use tracker_protocol::dtrack::{DataError, DataFrame, DayClock};

/// Stamps of this many frames are kept to recognise a repeated datagram.
const STAMPS_MAX: usize = 64;

/// Single markers of one flash.
#[derive(Debug, Clone, PartialEq)]
pub struct MarkerFrame {
    /// Time of the exposure on the local clock, s.
    pub t_s: f64,
    /// From the exposure to the arrival, s.
    pub age_s: f64,
    /// Number and place (m) of each marker.
    pub markers: Vec<(u32, Vector3<f64>)>,
}

/// Reads datagrams and relates the tracker's clock to the local one.
///
/// The offset is the smallest value of arrival minus stamp minus the latency that the tracker reports: a datagram
/// can only be late. It needs some frames to settle, so the stream should run before the flight.
#[derive(Debug, Clone, Default)]
pub struct MarkerStream {
    clock: DayClock,
    offset_s: Option<f64>,
    stamps: Vec<u64>,
    /// Datagrams that were no frame, or had no stamp.
    pub refused: usize,
}

impl MarkerStream {
    /// Before the first datagram.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a datagram that arrived at `arrived_s` on the local clock; `None` for one that came before.
    ///
    /// # Errors
    /// It is not a frame; also counted in [`MarkerStream::refused`].
    pub fn push(&mut self, datagram: &[u8], arrived_s: f64) -> Result<Option<MarkerFrame>, DataError> {
        let frame = DataFrame::parse(datagram).inspect_err(|_| self.refused += 1)?;
        let Some(stamp) = frame.stamp(&mut self.clock) else {
            self.refused += 1;
            return Ok(None);
        };
        if self.stamps.contains(&stamp.as_micros()) {
            return Ok(None);
        }
        if self.stamps.len() == STAMPS_MAX {
            self.stamps.remove(0);
        }
        self.stamps.push(stamp.as_micros());
        let latency_s = frame.ts2.map_or(0.0, |ts2| ts2.latency_us as f64 * 1e-6);
        let offset = arrived_s - seconds(stamp) - latency_s;
        let offset_s = self.offset_s.map_or(offset, |before| before.min(offset));
        self.offset_s = Some(offset_s);
        let t_s = seconds(stamp) + offset_s;
        let markers = frame.markers.unwrap_or_default();
        let markers = markers.iter().map(|m| (m.id, Vector3::from(m.position_mm) * 1e-3)).collect();
        Ok(Some(MarkerFrame { t_s, age_s: arrived_s - t_s, markers }))
    }

    /// Local clock minus the tracker's clock, s.
    #[must_use]
    pub fn offset_s(&self) -> Option<f64> {
        self.offset_s
    }
}

fn seconds(at: Instant) -> f64 {
    at.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use tracker_protocol::dtrack::{Marker, UnixStamp};

    use super::*;

    fn datagram(us: u64) -> Vec<u8> {
        DataFrame {
            frame: us,
            ts_s: None,
            ts2: Some(UnixStamp { s: us / 1_000_000, us: (us % 1_000_000) as u32, latency_us: 15_000 }),
            calibrated: None,
            bodies: None,
            hybrids: None,
            markers: Some(vec![Marker { id: 4, quality: 1.0, position_mm: [1000.0, -20.0, 3.0] }]),
            skipped_lines: 0,
        }
        .write()
    }

    #[test]
    fn the_offset_of_the_clocks_is_that_of_the_least_late_datagram() {
        let mut stream = MarkerStream::new();
        for (us, late_us) in [(0, 700), (8_333, 300), (16_667, 0), (25_000, 900)] {
            let arrived_s = 100.0 + f64::from(us + 15_000 + late_us) * 1e-6;
            let frame = stream.push(&datagram(u64::from(us as u32)), arrived_s).unwrap().unwrap();
            assert_eq!(frame.markers[0].0, 4);
            assert!((frame.markers[0].1 - Vector3::new(1.0, -0.02, 0.003)).norm() < 1e-9);
        }
        assert!((stream.offset_s().unwrap() - 100.0).abs() < 1e-9);
        // The same datagram again adds nothing; other bytes are refused.
        assert_eq!(stream.push(&datagram(25_000), 101.0).unwrap(), None);
        assert!(stream.push(b"6d 1 [", 101.0).is_err() && stream.refused == 1);
    }
}
