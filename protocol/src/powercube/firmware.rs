//! Firmware versions and what they allow.
//!
//! A version word is four BCD digits: 0x3518 is 3.5.18. The gates are those of the manufacturer's
//! host library, which refuses a call by itself when the module is too old.

use core::fmt;

/// Version word of a module (parameter 0x1D).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FirmwareVersion(pub u16);

impl fmt::Display for FirmwareVersion {
    /// As the sources write it: four hexadecimal digits.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}", self.0)
    }
}

/// Firmware range in which a parameter or an access exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Gate {
    /// Every version.
    Always,
    /// Up to 34xx (the default digital outputs went away with 35xx).
    Until34xx,
    /// 2518 to 34xx, and again from 3518 on.
    From2518Or3518,
    /// 3500 on.
    From3500,
    /// 351A on.
    From351A,
    /// 3602 on.
    From3602,
    /// 4601 on.
    From4601,
}

impl Gate {
    /// True if `version` is inside the gate.
    pub const fn allows(self, version: FirmwareVersion) -> bool {
        let v = version.0;
        match self {
            Self::Always => true,
            Self::Until34xx => v < 0x3500,
            Self::From2518Or3518 => (v >= 0x2518 && v < 0x3500) || v >= 0x3518,
            Self::From3500 => v >= 0x3500,
            Self::From351A => v >= 0x351A,
            Self::From3602 => v >= 0x3602,
            Self::From4601 => v >= 0x4601,
        }
    }

    /// The range as text, empty for [`Gate::Always`].
    pub const fn describe(self) -> &'static str {
        match self {
            Self::Always => "",
            Self::Until34xx => "up to firmware 34xx",
            Self::From2518Or3518 => "firmware 2518..34xx and 3518 on",
            Self::From3500 => "firmware 3500 on",
            Self::From351A => "firmware 351A on",
            Self::From3602 => "firmware 3602 on",
            Self::From4601 => "firmware 4601 on",
        }
    }
}
