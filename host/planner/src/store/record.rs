//! One stored throw.

use robot_model::RobotModel;

use crate::throw::{JOINTS, Joints, Throw};

/// A throw in the frame in which the target is at azimuth 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// Which constraints it satisfies; see [`crate::plan::search::kind_of`].
    pub kind: u32,
    /// Horizontal distance of the target from the base axis in m.
    pub range_m: f64,
    /// Height of the target in m.
    pub height_m: f64,
    /// Objective (1).
    pub objective: f64,
    /// Change of the objective with range and height of the target, in 1/m.
    pub slope_per_m: [f64; 2],
    /// Whether a clearance or a current over the motion is at its limit.
    pub touches: bool,
    /// The throw; joint 1 counted from the direction of the target.
    pub throw: Throw,
}

/// Numbers of a record.
const NUMBERS: usize = 26;
/// Bytes of a record without its checksum: kind and numbers.
pub(super) const BODY: usize = 4 + NUMBERS * 4;
/// Bit of the first word beside the kind.
const TOUCHES: u32 = 1 << 31;
/// Bytes of a record.
pub(super) const SIZE: usize = BODY + 4;

impl Record {
    /// Little-endian bytes with a checksum at the end.
    ///
    /// Numbers are rounded to 32 bits: a record is a start, and the solver brings it to full accuracy.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; SIZE] {
        let mut out = [0; SIZE];
        let head = self.kind | if self.touches { TOUCHES } else { 0 };
        out[..4].copy_from_slice(&head.to_le_bytes());
        for (i, value) in self.numbers().into_iter().enumerate() {
            out[4 + 4 * i..8 + 4 * i].copy_from_slice(&(value as f32).to_le_bytes());
        }
        let sum = crc32(&out[..BODY]);
        out[BODY..].copy_from_slice(&sum.to_le_bytes());
        out
    }

    /// Reads a record; `None` if the checksum does not match, the length is wrong or a number is not finite.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        if bytes.len() != SIZE {
            return None;
        }
        let word = |i: usize| bytes.get(4 * i..4 * i + 4).and_then(|b| <[u8; 4]>::try_from(b).ok());
        if u32::from_le_bytes(word(BODY / 4)?) != crc32(&bytes[..BODY]) {
            return None;
        }
        let head = u32::from_le_bytes(word(0)?);
        let mut n = [0.0; NUMBERS];
        for (i, value) in n.iter_mut().enumerate() {
            *value = f64::from(f32::from_le_bytes(word(1 + i)?));
            if !value.is_finite() {
                return None;
            }
        }
        let joints = |at: usize| Joints::from_column_slice(&n[at..at + JOINTS]);
        Some(Self {
            kind: head & !TOUCHES,
            range_m: n[0],
            height_m: n[1],
            objective: n[2],
            slope_per_m: [n[24], n[25]],
            touches: head & TOUCHES != 0,
            throw: Throw {
                flight_s: n[3],
                ha_s: n[4],
                hb_s: n[5],
                q_rad: joints(6),
                qd_rad_s: joints(12),
                qdd_rad_s2: joints(18),
            },
        })
    }

    fn numbers(&self) -> [f64; NUMBERS] {
        let t = &self.throw;
        let mut n = [0.0; NUMBERS];
        n[..6].copy_from_slice(&[self.range_m, self.height_m, self.objective, t.flight_s, t.ha_s, t.hb_s]);
        n[6..12].copy_from_slice(t.q_rad.as_slice());
        n[12..18].copy_from_slice(t.qd_rad_s.as_slice());
        n[18..24].copy_from_slice(t.qdd_rad_s2.as_slice());
        n[24..].copy_from_slice(&self.slope_per_m);
        n
    }
}

/// Fingerprint of everything about a robot that a throw depends on (FNV-1a over its description).
#[must_use]
pub fn robot_fingerprint<const N: usize>(arm: &RobotModel<N>) -> u64 {
    let text = format!(
        "{:?}{:?}{:?}{:?}{:?}{:?}{:?}{:?}",
        arm.joints(),
        arm.links(),
        arm.end_effector(),
        arm.gripper(),
        arm.drives(),
        arm.supplies(),
        arm.world(),
        arm.collision().boxes(),
    );
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// CRC-32 (IEEE 802.3, reflected), bit by bit: a record has a hundred bytes.
#[must_use]
pub fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |mut crc, byte| {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg());
        }
        crc
    })
}

#[cfg(test)]
impl Record {
    /// A record to a target at this range and at height 0; its throw is nothing but finite.
    pub(crate) fn example(range_m: f64) -> Self {
        let throw = Throw {
            q_rad: Joints::zeros(),
            qd_rad_s: Joints::zeros(),
            qdd_rad_s2: Joints::zeros(),
            flight_s: 0.5,
            ha_s: 0.5,
            hb_s: 0.25,
        };
        Self { kind: 0, range_m, height_m: 0.0, objective: 1.0, slope_per_m: [0.0; 2], touches: false, throw }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crc_matches_the_check_value_of_the_standard() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn a_record_survives_its_bytes_and_a_flipped_bit_does_not() {
        let record = Record {
            kind: 3,
            range_m: 1.5,
            height_m: -0.25,
            objective: 31.25,
            slope_per_m: [12.5, -3.0],
            touches: true,
            throw: Throw {
                q_rad: Joints::from_element(0.5),
                qd_rad_s: Joints::from_element(-1.25),
                qdd_rad_s2: Joints::from_element(2.0),
                flight_s: 0.5,
                ha_s: 0.75,
                hb_s: 0.25,
            },
        };
        let mut bytes = record.to_bytes();
        assert_eq!(Record::from_bytes(&bytes), Some(record));
        bytes[17] ^= 4;
        assert_eq!(Record::from_bytes(&bytes), None);
        assert_eq!(Record::from_bytes(&bytes[1..]), None);
    }
}
