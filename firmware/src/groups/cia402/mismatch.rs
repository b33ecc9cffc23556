//! An object that differs between a servo and the settings, and its numbers in the messages of a controller.

use core::fmt;

use protocol::canopen::Object;
use protocol::canopen::sdo::AbortCode;
use protocol::cyphal::cubecell::group_state::DriveDifference;

/// What a servo answered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Found {
    /// A value.
    Value(u32),
    /// It refused.
    Refused(AbortCode),
    /// Counts in a turn of the joint, from objects 608F and 6091.
    CountsPerTurn(u32),
}

/// An object that is not as the settings say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mismatch {
    /// Which one.
    pub object: Object,
    /// What the servo holds.
    pub found: Found,
    /// What it should hold.
    pub expected: u32,
}

/// First byte of the number of an object, for each kind of [`Found`].
const VALUE: u8 = 1;
const REFUSED: u8 = 2;
const COUNTS_PER_TURN: u8 = 10;

impl From<Mismatch> for DriveDifference {
    fn from(Mismatch { object, found, expected }: Mismatch) -> Self {
        let [high, low] = object.index.to_be_bytes();
        let (kind, found) = match found {
            Found::Value(value) => (VALUE, value),
            Found::Refused(AbortCode(code)) => (REFUSED, code),
            Found::CountsPerTurn(counts) => (COUNTS_PER_TURN, counts),
        };
        Self { what: u32::from_be_bytes([kind, high, low, object.sub]), found, expected }
    }
}

impl Mismatch {
    /// The mismatch that a controller reports; `None`: it is one of another family.
    #[must_use]
    pub const fn reported(DriveDifference { what, found, expected }: DriveDifference) -> Option<Self> {
        let [kind, high, low, sub] = what.to_be_bytes();
        let found = match kind {
            VALUE => Found::Value(found),
            REFUSED => Found::Refused(AbortCode(found)),
            COUNTS_PER_TURN => Found::CountsPerTurn(found),
            _ => return None,
        };
        Some(Self { object: Object::new(u16::from_be_bytes([high, low]), sub), found, expected })
    }
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { object, expected, .. } = self;
        match self.found {
            Found::Value(found) => {
                write!(f, "object {object} of the servo holds {found:#x}, the settings need {expected:#x}")
            }
            Found::Refused(code) => {
                write!(f, "object {object} of the servo cannot hold {expected:#x}: {code}")
            }
            Found::CountsPerTurn(found) => {
                write!(
                    f,
                    "by objects 608F and 6091 the servo counts {found} in a turn, the settings need {expected}"
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_controller_reports_is_read_as_what_it_found() {
        let object = Object::new(0x608F, 1);
        for found in [Found::Value(u32::MAX), Found::Refused(AbortCode::NO_OBJECT), Found::CountsPerTurn(1)] {
            let mismatch = Mismatch { object, found, expected: 655_360 };
            assert_eq!(Mismatch::reported(mismatch.into()), Some(mismatch));
        }
        for what in [0, 0xFF00_0000] {
            assert_eq!(Mismatch::reported(DriveDifference { what, found: 1, expected: 2 }), None);
        }
    }
}
