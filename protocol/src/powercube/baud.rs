//! Bit rate codes of parameter 0x22 and of the baud broadcast.

/// CAN bit rate a module can be set to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum BaudRate {
    /// Code 0, 125 kbit/s (named by the manufacturer's library only).
    Kbit125,
    /// Code 1, 250 kbit/s.
    Kbit250,
    /// Code 2, 500 kbit/s.
    Kbit500,
    /// Code 3, 1 Mbit/s.
    Kbit1000,
}

impl BaudRate {
    /// All rates in ascending order.
    pub const ALL: &[Self] = &[Self::Kbit125, Self::Kbit250, Self::Kbit500, Self::Kbit1000];

    /// From the code on the wire, 0..=3.
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Kbit125),
            1 => Some(Self::Kbit250),
            2 => Some(Self::Kbit500),
            3 => Some(Self::Kbit1000),
            _ => None,
        }
    }

    /// The code on the wire, 0..=3.
    pub const fn code(self) -> u8 {
        match self {
            Self::Kbit125 => 0,
            Self::Kbit250 => 1,
            Self::Kbit500 => 2,
            Self::Kbit1000 => 3,
        }
    }

    /// Bits per second.
    pub const fn bit_per_s(self) -> u32 {
        match self {
            Self::Kbit125 => 125_000,
            Self::Kbit250 => 250_000,
            Self::Kbit500 => 500_000,
            Self::Kbit1000 => 1_000_000,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_the_reference_and_code_four_is_refused() {
        let rates: Vec<_> = (0..4).map(|code| BaudRate::from_code(code).unwrap().bit_per_s()).collect();
        assert_eq!(rates, [125_000, 250_000, 500_000, 1_000_000]);
        assert_eq!(BaudRate::from_code(4), None);
        assert!((0..4).all(|code| BaudRate::from_code(code).unwrap().code() == code));
    }
}
