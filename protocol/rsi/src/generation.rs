//! What differs between the two generations of the interface.

/// Generation of controller and RSI.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Generation {
    /// Ethernet RSI XML 1.x on a KR C2: TCP or UDP, 12 ms.
    KrC2,
    /// RSI 3.x and 4.x on a KR C4: UDP, 4 or 12 ms.
    KrC4,
}

impl Generation {
    /// How much `IPOC` rises per cycle of `cycle_ms`: one on a KR C2, the milliseconds on a KR C4.
    #[must_use]
    pub const fn ipoc_step(self, cycle_ms: u64) -> u64 {
        match self {
            Self::KrC2 => 1,
            Self::KrC4 => cycle_ms,
        }
    }

    /// Whether the exchange begins with a telegram that holds only `IPOC`.
    #[must_use]
    pub const fn begins_with_empty_telegram(self) -> bool {
        matches!(self, Self::KrC2)
    }

    /// Usual number of decimals in robot telegrams.
    #[must_use]
    pub const fn usual_decimals(self) -> u8 {
        match self {
            Self::KrC2 => 4,
            Self::KrC4 => 1,
        }
    }
}
