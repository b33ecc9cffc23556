//! What differs between an axis and the settings, and its numbers in the messages of a controller.

use core::fmt;

use protocol::cyphal::cubecell::group_state::DriveDifference;
use protocol::odrive::Version;

use super::options::{Parameter, VELOCITY_MAX_REV_S};

/// What is not as the settings say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mismatch {
    /// Version of the firmware; `None`: it does not report one, as 0.5.
    Firmware {
        /// Major, minor, revision.
        found: Option<[u8; 3]>,
        /// What the robot file says.
        expected: Version,
    },
    /// A parameter holds something else, or does not answer.
    Parameter {
        /// Which one.
        parameter: Parameter,
        /// Its bytes.
        found: Option<[u8; 4]>,
        /// What it should hold.
        expected: [u8; 4],
    },
    /// Estimates come by themselves.
    UnaskedEstimates,
    /// The joint needs a speed that the velocity field cannot hold.
    Speed {
        /// Turns/s that the joint needs.
        needed_rev_s: f32,
    },
}

/// First byte of the number of each kind of mismatch.
const HOLDS: u8 = 4;
const SILENT: u8 = 5;
const NO_FIRMWARE: u8 = 6;
const FIRMWARE: u8 = 7;
const UNASKED: u8 = 8;
const SPEED: u8 = 9;

impl From<Mismatch> for DriveDifference {
    fn from(mismatch: Mismatch) -> Self {
        let version = |expected| u32::from(expected == Version::V06);
        let (kind, parameter, found, expected) = match mismatch {
            Mismatch::Firmware { found: None, expected } => (NO_FIRMWARE, 0, 0, version(expected)),
            Mismatch::Firmware { found: Some([a, b, c]), expected } => {
                (FIRMWARE, 0, u32::from_be_bytes([0, a, b, c]), version(expected))
            }
            Mismatch::Parameter { parameter, found, expected } => (
                if found.is_some() { HOLDS } else { SILENT },
                parameter as u8,
                found.map_or(0, u32::from_le_bytes),
                u32::from_le_bytes(expected),
            ),
            Mismatch::UnaskedEstimates => (UNASKED, 0, 0, 0),
            Mismatch::Speed { needed_rev_s } => (SPEED, 0, needed_rev_s.to_bits(), 0),
        };
        Self { what: u32::from_be_bytes([kind, 0, 0, parameter]), found, expected }
    }
}

impl Mismatch {
    /// The mismatch that a controller reports; `None`: it is one of another family.
    #[must_use]
    pub fn reported(DriveDifference { what, found, expected }: DriveDifference) -> Option<Self> {
        let [kind, _, _, number] = what.to_be_bytes();
        let version = if expected == 0 { Version::V05 } else { Version::V06 };
        Some(match kind {
            HOLDS | SILENT => Self::Parameter {
                parameter: *Parameter::ALL.get(usize::from(number))?,
                found: (kind == HOLDS).then(|| found.to_le_bytes()),
                expected: expected.to_le_bytes(),
            },
            NO_FIRMWARE => Self::Firmware { found: None, expected: version },
            FIRMWARE => {
                let [_, a, b, c] = found.to_be_bytes();
                Self::Firmware { found: Some([a, b, c]), expected: version }
            }
            UNASKED => Self::UnaskedEstimates,
            SPEED => Self::Speed { needed_rev_s: f32::from_bits(found) },
            _ => return None,
        })
    }
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Firmware { found: None, .. } => {
                f.write_str("the axis reports no firmware, as 0.5 does: the settings say 0.6")
            }
            Self::Firmware { found: Some([a, b, c]), expected } => {
                let expected = if *expected == Version::V05 { "0.5" } else { "0.6, with these endpoints if some are given" };
                write!(f, "the axis has firmware {a}.{b}.{c}, the settings say {expected}")
            }
            Self::Parameter { parameter, found: None, .. } => {
                write!(f, "{} does not answer: its endpoint belongs to another firmware", parameter.path())
            }
            Self::Parameter { parameter, found: Some(found), expected } => {
                let [found, expected] = [found, expected].map(|bytes| u32::from_le_bytes(*bytes));
                write!(f, "{} holds {found:#x}, the settings need {expected:#x}", parameter.path())
            }
            Self::UnaskedEstimates => f.write_str(
                "estimates come by themselves: set encoder_msg_rate_ms (0.5: encoder_rate_ms) of the axis to 0",
            ),
            Self::Speed { needed_rev_s } => write!(
                f,
                "the joint needs {needed_rev_s:.1} turns/s, the field for velocities ends at {VELOCITY_MAX_REV_S}"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_controller_reports_is_read_as_what_it_found() {
        let kinds = [
            Mismatch::Firmware { found: None, expected: Version::V06 },
            Mismatch::Firmware { found: Some([0, 6, 10]), expected: Version::V05 },
            Mismatch::UnaskedEstimates,
            Mismatch::Speed { needed_rev_s: 40.5 },
        ];
        let parameters = Parameter::ALL.into_iter().flat_map(|parameter| {
            [None, Some([1, 2, 3, 4])].map(|found| Mismatch::Parameter {
                parameter,
                found,
                expected: [5, 6, 7, 8],
            })
        });
        for mismatch in kinds.into_iter().chain(parameters) {
            assert_eq!(Mismatch::reported(mismatch.into()), Some(mismatch));
        }
        for what in [0, 0xFF00_0000] {
            assert_eq!(Mismatch::reported(DriveDifference { what, found: 1, expected: 2 }), None);
        }
    }
}
