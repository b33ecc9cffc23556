//! Two kinds of small numbers that must not be mixed up: the drive's address on the wire and the
//! joint's place in the arm.

use core::fmt;

/// Most joints of one group. Six PowerCubes need six; seven-axis arms of the same modules exist.
pub const JOINTS_MAX: usize = 8;

/// Number outside its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RangeError {
    /// The rejected value.
    pub value: u32,
    /// Smallest allowed value.
    pub min: u32,
    /// Largest allowed value.
    pub max: u32,
}

impl fmt::Display for RangeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} is outside {}..={}", self.value, self.min, self.max)
    }
}

impl core::error::Error for RangeError {}

/// Wire address of a PowerCube, 1..=31 (`powercube-protocol` section 1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ModuleId(u8);

impl ModuleId {
    /// Smallest address.
    pub const MIN: Self = Self(1);
    /// Largest address.
    pub const MAX: Self = Self(31);

    /// Checks the range 1..=31.
    pub const fn new(value: u8) -> Result<Self, RangeError> {
        if value >= 1 && value <= 31 {
            Ok(Self(value))
        } else {
            Err(RangeError { value: value as u32, min: 1, max: 31 })
        }
    }

    /// The address as a number, 1..=31.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// All addresses in ascending order, as hosts scan them.
    pub fn all() -> impl DoubleEndedIterator<Item = Self> + Clone {
        (1..=31).map(Self)
    }
}

impl fmt::Display for ModuleId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl TryFrom<u8> for ModuleId {
    type Error = RangeError;
    fn try_from(value: u8) -> Result<Self, RangeError> {
        Self::new(value)
    }
}

/// Place of a joint in the arm, counted from the base: 0..[`JOINTS_MAX`].
///
/// Printed from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct JointIndex(u8);

impl JointIndex {
    /// Checks the range 0..[`JOINTS_MAX`].
    pub const fn new(value: usize) -> Result<Self, RangeError> {
        if value < JOINTS_MAX {
            Ok(Self(value as u8))
        } else {
            Err(RangeError { value: value as u32, min: 0, max: JOINTS_MAX as u32 - 1 })
        }
    }

    /// The index, 0..[`JOINTS_MAX`].
    pub const fn get(self) -> usize {
        self.0 as usize
    }

    /// A bit of its own: bit n for joint n.
    pub const fn bit(self) -> u8 {
        1 << self.0
    }

    /// The first `count` joints, base first; at most [`JOINTS_MAX`].
    pub fn first(count: usize) -> impl DoubleEndedIterator<Item = Self> + Clone {
        (0..count.min(JOINTS_MAX) as u8).map(Self)
    }
}

impl fmt::Display for JointIndex {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (self.0 + 1).fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn module_id_zero_and_thirty_two_are_refused() {
        assert_eq!(ModuleId::new(0), Err(RangeError { value: 0, min: 1, max: 31 }));
        assert_eq!(ModuleId::new(32), Err(RangeError { value: 32, min: 1, max: 31 }));
        assert_eq!(ModuleId::all().count(), 31);
    }

    #[test]
    fn joint_index_counts_from_zero_and_prints_from_one() {
        assert_eq!(JointIndex::new(JOINTS_MAX).unwrap_err().max, 7);
        assert_eq!(JointIndex::new(0).unwrap().to_string(), "1");
        assert_eq!(JointIndex::first(6).map(JointIndex::get).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5]);
    }
}
