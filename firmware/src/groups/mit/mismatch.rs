//! A register that differs between a motor and the settings, and its numbers in the messages of a controller.

use core::fmt;

use protocol::cyphal::cubecell::group_state::DriveDifference;
use protocol::mit::{Register, RegisterValue};

/// A register that is not as the settings say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mismatch {
    /// Which one.
    pub register: Register,
    /// What the motor holds.
    pub found: RegisterValue,
    /// What it should hold.
    pub expected: RegisterValue,
}

/// First byte of the number of a register.
const REGISTER: u8 = 3;

impl From<Mismatch> for DriveDifference {
    fn from(Mismatch { register, found, expected }: Mismatch) -> Self {
        let [found, expected] = [found, expected].map(|value| match value {
            RegisterValue::Whole(value) => value,
            RegisterValue::Float(value) => value.to_bits(),
        });
        Self { what: u32::from_be_bytes([REGISTER, 0, 0, register.number()]), found, expected }
    }
}

impl Mismatch {
    /// The mismatch that a controller reports; `None`: it is one of another family.
    #[must_use]
    pub fn reported(DriveDifference { what, found, expected }: DriveDifference) -> Option<Self> {
        let [REGISTER, 0, 0, number] = what.to_be_bytes() else { return None };
        let register = Register::of(number)?;
        let [found, expected] = [found, expected].map(|bits| match register.is_whole() {
            true => RegisterValue::Whole(bits),
            false => RegisterValue::Float(f32::from_bits(bits)),
        });
        Some(Self { register, found, expected })
    }
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "register {} of the motor holds ", self.register.number())?;
        show(f, self.found)?;
        f.write_str(", the settings need ")?;
        show(f, self.expected)
    }
}

fn show(f: &mut fmt::Formatter<'_>, value: RegisterValue) -> fmt::Result {
    match value {
        RegisterValue::Whole(value) => write!(f, "{value}"),
        RegisterValue::Float(value) => write!(f, "{value}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_controller_reports_is_read_as_what_it_found() {
        for (register, [found, expected]) in [
            (Register::TimeOut, [30, 10].map(RegisterValue::Whole)),
            (Register::VelocityMax, [30.0, 10.0].map(RegisterValue::Float)),
        ] {
            let mismatch = Mismatch { register, found, expected };
            assert_eq!(Mismatch::reported(mismatch.into()), Some(mismatch));
        }
        for what in [0, 0xFF00_0000] {
            assert_eq!(Mismatch::reported(DriveDifference { what, found: 1, expected: 2 }), None);
        }
    }
}
