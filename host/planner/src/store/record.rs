//! One stored throw.

use robot_model::{JointVec, RobotModel};

use crate::throw::Throw;

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

/// Numbers of a record before the joints, and after them.
const BEFORE: usize = 6;
const AFTER: usize = 2;
/// Bit of the first word beside the kind.
const TOUCHES: u32 = 1 << 31;

/// Numbers of a record of an arm of `joints` joints.
const fn numbers(joints: usize) -> usize {
    BEFORE + 3 * joints + AFTER
}

/// Bytes of a record of an arm of `joints` joints: kind, numbers, checksum.
#[must_use]
pub const fn size(joints: usize) -> usize {
    4 + numbers(joints) * 4 + 4
}

impl Record {
    /// Little-endian bytes with a checksum at the end.
    ///
    /// Numbers are rounded to 32 bits: a record is a start, and the solver brings it to full accuracy.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(size(self.throw.joints()));
        let head = self.kind | if self.touches { TOUCHES } else { 0 };
        out.extend(head.to_le_bytes());
        let t = &self.throw;
        let before = [self.range_m, self.height_m, self.objective, t.flight_s, t.ha_s, t.hb_s];
        let joints = t.q_rad.iter().chain(t.qd_rad_s.iter()).chain(t.qdd_rad_s2.iter());
        for value in before.iter().chain(joints).chain(&self.slope_per_m) {
            out.extend((*value as f32).to_le_bytes());
        }
        let sum = crc32(&out);
        out.extend(sum.to_le_bytes());
        out
    }

    /// Reads a record of an arm of `joints` joints; `None` if the checksum does not match, the length is wrong or a number is not finite.
    #[must_use]
    pub fn from_bytes(joints: usize, bytes: &[u8]) -> Option<Self> {
        if bytes.len() != size(joints) {
            return None;
        }
        let (body, sum) = bytes.split_last_chunk()?;
        if u32::from_le_bytes(*sum) != crc32(body) {
            return None;
        }
        let (head, rest) = body.split_first_chunk()?;
        let head = u32::from_le_bytes(*head);
        let mut numbers = rest.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b)));
        let mut next = || numbers.next().filter(|n| n.is_finite());
        let [range_m, height_m, objective, flight_s, ha_s, hb_s] =
            [next()?, next()?, next()?, next()?, next()?, next()?];
        let mut vector = || {
            let mut out = JointVec::zeros(joints);
            for value in out.iter_mut() {
                *value = next()?;
            }
            Some(out)
        };
        let (q_rad, qd_rad_s, qdd_rad_s2) = (vector()?, vector()?, vector()?);
        Some(Self {
            kind: head & !TOUCHES,
            range_m,
            height_m,
            objective,
            slope_per_m: [next()?, next()?],
            touches: head & TOUCHES != 0,
            throw: Throw { q_rad, qd_rad_s, qdd_rad_s2, flight_s, ha_s, hb_s },
        })
    }
}

/// [`robot_fingerprint`] as plans, gains and controllers name a robot: 16 hexadecimal digits.
#[must_use]
pub fn fingerprint_of(arm: &RobotModel) -> String {
    format!("{:016x}", robot_fingerprint(arm))
}

/// Fingerprint of everything about a robot that a throw depends on (FNV-1a over its description).
#[must_use]
pub fn robot_fingerprint(arm: &RobotModel) -> u64 {
    let mut text = format!(
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
    // Stored throws of an arm of PowerCubes keep their fingerprint.
    text += &arm.motors_text();
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
    /// A record of six joints to a target at this range and at height 0; its throw is nothing but finite.
    pub(crate) fn example(range_m: f64) -> Self {
        let throw = Throw {
            q_rad: JointVec::zeros(6),
            qd_rad_s: JointVec::zeros(6),
            qdd_rad_s2: JointVec::zeros(6),
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
    use crate::throw::Joints;

    #[test]
    fn fingerprint_covers_the_motors_too() {
        let text = include_str!("../../../../robots/openarm7.toml");
        let of = |text: &str| robot_fingerprint(&RobotModel::from_toml("arm.toml", text).unwrap());
        assert!(text.contains("kp_nm_rad = 240"));
        assert_ne!(of(text), of(&text.replacen("kp_nm_rad = 240", "kp_nm_rad = 239", 1)));
    }

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
                q_rad: Joints::repeat(6, 0.5),
                qd_rad_s: Joints::repeat(6, -1.25),
                qdd_rad_s2: Joints::repeat(6, 2.0),
                flight_s: 0.5,
                ha_s: 0.75,
                hb_s: 0.25,
            },
        };
        let mut bytes = record.to_bytes();
        assert_eq!(Record::from_bytes(6, &bytes), Some(record));
        bytes[17] ^= 4;
        assert_eq!(Record::from_bytes(6, &bytes), None);
        assert_eq!(Record::from_bytes(6, &bytes[1..]), None);
    }
}
