//! CAN identifiers: 11-bit and 29-bit ids as distinct, checked types.
//!
//! Source: ISO 11898-1 (identifier fields of the classical base and extended frame formats).

use core::cmp::Ordering;
use core::fmt;

/// Value that does not fit the identifier it was meant for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IdError {
    /// The rejected value.
    pub value: u32,
    /// Largest value the id type can hold.
    pub max: u32,
}

impl fmt::Display for IdError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "CAN id {:#X} is above {:#X}", self.value, self.max)
    }
}

impl core::error::Error for IdError {}

/// 11-bit identifier, 0..=0x7FF.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct StandardId(u16);

impl StandardId {
    /// Smallest id: wins every arbitration.
    pub const ZERO: Self = Self(0);
    /// Largest id.
    pub const MAX: Self = Self(0x7FF);

    /// Checks the range 0..=0x7FF.
    pub const fn new(value: u16) -> Result<Self, IdError> {
        if value <= Self::MAX.0 {
            Ok(Self(value))
        } else {
            Err(IdError { value: value as u32, max: Self::MAX.0 as u32 })
        }
    }

    /// Takes the low 11 bits, for ids that are built from parts already in range.
    pub const fn from_low_bits(value: u16) -> Self {
        Self(value & Self::MAX.0)
    }

    /// The id as a number, 0..=0x7FF.
    pub const fn get(self) -> u16 {
        self.0
    }
}

/// 29-bit identifier, 0..=0x1FFF_FFFF.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ExtendedId(u32);

impl ExtendedId {
    /// Smallest id.
    pub const ZERO: Self = Self(0);
    /// Largest id.
    pub const MAX: Self = Self(0x1FFF_FFFF);

    /// Checks the range 0..=0x1FFF_FFFF.
    pub const fn new(value: u32) -> Result<Self, IdError> {
        if value <= Self::MAX.0 { Ok(Self(value)) } else { Err(IdError { value, max: Self::MAX.0 }) }
    }

    /// Takes the low 29 bits, for ids that are built from parts already in range.
    pub const fn from_low_bits(value: u32) -> Self {
        Self(value & Self::MAX.0)
    }

    /// The id as a number, 0..=0x1FFF_FFFF.
    pub const fn get(self) -> u32 {
        self.0
    }
}

/// Identifier of a frame in either format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Id {
    /// 11-bit identifier (base frame format).
    Standard(StandardId),
    /// 29-bit identifier (extended frame format).
    Extended(ExtendedId),
}

impl Id {
    /// The bits of the arbitration field of a *data* frame, left aligned in 32 bits: the smaller
    /// key wins the bus.
    ///
    /// Base format sends 11 id bits, RTR, IDE (dominant); extended format sends 11 id bits, SRR
    /// (recessive), IDE (recessive), 18 id bits, RTR. So with equal leading 11 bits the base data
    /// frame wins at the RTR/SRR bit. Remote frames lose to data frames of the same id:
    /// [`crate::Frame::arbitration_key`].
    pub const fn arbitration_key(self, remote: bool) -> u32 {
        let rtr = remote as u32;
        match self {
            // id(11) RTR IDE=0
            Self::Standard(id) => (id.0 as u32) << 21 | rtr << 20,
            // id(11) SRR=1 IDE=1 id(18) RTR
            Self::Extended(id) => (id.0 >> 18) << 21 | 1 << 20 | 1 << 19 | (id.0 & 0x3_FFFF) << 1 | rtr,
        }
    }

    /// The id as a number, without its format.
    pub const fn raw(self) -> u32 {
        match self {
            Self::Standard(id) => id.0 as u32,
            Self::Extended(id) => id.0,
        }
    }

    /// True for a 29-bit id.
    pub const fn is_extended(self) -> bool {
        matches!(self, Self::Extended(_))
    }
}

/// Orders by bus priority of data frames: the id that wins arbitration comes first.
impl Ord for Id {
    fn cmp(&self, other: &Self) -> Ordering {
        self.arbitration_key(false).cmp(&other.arbitration_key(false))
    }
}

impl PartialOrd for Id {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Three hexadecimal digits for an 11-bit id, eight for a 29-bit id (the candump form).
impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Standard(id) => write!(f, "{:03X}", id.0),
            Self::Extended(id) => write!(f, "{:08X}", id.0),
        }
    }
}

impl From<StandardId> for Id {
    fn from(id: StandardId) -> Self {
        Self::Standard(id)
    }
}

impl From<ExtendedId> for Id {
    fn from(id: ExtendedId) -> Self {
        Self::Extended(id)
    }
}

impl From<embedded_can::Id> for Id {
    fn from(id: embedded_can::Id) -> Self {
        // embedded-can's ids hold the same ranges, so masking never changes a value.
        match id {
            embedded_can::Id::Standard(id) => Self::Standard(StandardId::from_low_bits(id.as_raw())),
            embedded_can::Id::Extended(id) => Self::Extended(ExtendedId::from_low_bits(id.as_raw())),
        }
    }
}

impl From<Id> for embedded_can::Id {
    fn from(id: Id) -> Self {
        match id {
            // The fallbacks are never taken: both crates allow exactly the same ranges.
            Id::Standard(id) => {
                Self::Standard(embedded_can::StandardId::new(id.0).unwrap_or(embedded_can::StandardId::MAX))
            }
            Id::Extended(id) => {
                Self::Extended(embedded_can::ExtendedId::new(id.0).unwrap_or(embedded_can::ExtendedId::MAX))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_out_of_range_are_refused_with_value_and_limit() {
        assert_eq!(StandardId::new(0x800), Err(IdError { value: 0x800, max: 0x7FF }));
        assert_eq!(ExtendedId::new(0x2000_0000), Err(IdError { value: 0x2000_0000, max: 0x1FFF_FFFF }));
        assert_eq!(StandardId::new(0x7FF).map(StandardId::get), Ok(0x7FF));
        assert_eq!(ExtendedId::new(0x1FFF_FFFF).map(ExtendedId::get), Ok(0x1FFF_FFFF));
    }

    #[test]
    fn standard_frame_wins_over_extended_frame_with_the_same_leading_bits() {
        let standard = Id::Standard(StandardId::from_low_bits(0x123));
        let extended = Id::Extended(ExtendedId::from_low_bits(0x123 << 18));
        assert!(standard < extended);
        // A remote base frame and an extended frame tie at RTR/SRR; the dominant IDE bit decides.
        assert!(standard.arbitration_key(true) < extended.arbitration_key(false));
    }

    #[test]
    fn extended_frame_wins_when_its_leading_bits_are_lower() {
        let standard = Id::Standard(StandardId::from_low_bits(0x124));
        let extended = Id::Extended(ExtendedId::from_low_bits(0x123 << 18 | 0x3_FFFF));
        assert!(extended < standard);
    }

    #[test]
    fn data_frame_wins_over_remote_frame_of_the_same_id() {
        for id in [Id::Standard(StandardId::MAX), Id::Extended(ExtendedId::MAX)] {
            assert!(id.arbitration_key(false) < id.arbitration_key(true));
        }
    }

    #[test]
    fn embedded_can_ids_convert_both_ways_without_change() {
        for id in [
            Id::Standard(StandardId::ZERO),
            Id::Standard(StandardId::MAX),
            Id::Extended(ExtendedId::ZERO),
            Id::Extended(ExtendedId::MAX),
        ] {
            assert_eq!(Id::from(embedded_can::Id::from(id)), id);
        }
    }
}
