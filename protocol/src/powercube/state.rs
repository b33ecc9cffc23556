//! State word (parameter 0x27 and the STATE frame), short state, digital lines.

use core::fmt;

/// One named bit of a word, for codec, documentation and DBC alike.
#[derive(Clone, Copy, Debug)]
pub struct BitInfo {
    /// Bit number, 0 is the least significant.
    pub bit: u8,
    /// Name as the sources write it.
    pub name: &'static str,
    /// What it means.
    pub meaning: &'static str,
}

/// Declares a word of named bits: constants, table, set operations, display.
macro_rules! bit_word {
    ($(#[$doc:meta])* $name:ident($repr:ty) { $($bit:literal $konst:ident $meaning:literal;)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
        pub struct $name($repr);

        impl $name {
            $(
                #[doc = concat!("Bit ", $bit, ": ", $meaning, ".")]
                pub const $konst: Self = Self(1 << $bit);
            )*

            /// The named bits in ascending order.
            pub const BITS: &[$crate::powercube::state::BitInfo] = &[
                $($crate::powercube::state::BitInfo { bit: $bit, name: stringify!($konst), meaning: $meaning },)*
            ];

            /// No bit set.
            pub const EMPTY: Self = Self(0);

            /// Every bit pattern is a value; bits without a name are kept.
            pub const fn from_bits(bits: $repr) -> Self {
                Self(bits)
            }

            /// The word.
            pub const fn bits(self) -> $repr {
                self.0
            }

            /// True if all bits of `other` are set.
            pub const fn contains(self, other: Self) -> bool {
                self.0 & other.0 == other.0
            }

            /// True if any bit of `other` is set.
            pub const fn intersects(self, other: Self) -> bool {
                self.0 & other.0 != 0
            }

            /// The bits of both.
            #[must_use]
            pub const fn union(self, other: Self) -> Self {
                Self(self.0 | other.0)
            }

            /// The bits of `self` that `other` does not have.
            #[must_use]
            pub const fn difference(self, other: Self) -> Self {
                Self(self.0 & !other.0)
            }

            /// Sets or clears the bits of `other`.
            #[must_use]
            pub const fn with(self, other: Self, on: bool) -> Self {
                if on { self.union(other) } else { self.difference(other) }
            }
        }

        impl core::ops::BitOr for $name {
            type Output = Self;
            fn bitor(self, other: Self) -> Self {
                self.union(other)
            }
        }

        /// Names of the set bits joined by `|`, then a number for bits without a name; `-` if no bit is set.
        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                let mut rest = self.0;
                let mut separator = "";
                for info in Self::BITS {
                    let mask: $repr = 1 << info.bit;
                    if self.0 & mask != 0 {
                        write!(f, "{separator}{}", info.name)?;
                        rest &= !mask;
                        separator = "|";
                    }
                }
                if rest != 0 {
                    write!(f, "{separator}{rest:#X}")?;
                    separator = "|";
                }
                if separator.is_empty() { f.write_str("-") } else { Ok(()) }
            }
        }
    };
}
pub(crate) use bit_word;

bit_word! {
    /// State word of a module: parameter 0x27 and bytes 0..4 of the STATE frame.
    CubeState(u32) {
        0 ERROR "summary of all errors; the module has stopped and refuses motion";
        1 HOME_OK "zero position found; falls when homing starts";
        2 HALTED "emergency stop state, refuses motion until RESET";
        3 POWERFAULT "servo amplifier fault, bits 18 to 23 say why";
        4 TOW_ERROR "following error above MaxDeltaPos";
        5 COMM_ERROR "communication lost: the watchdog expired";
        6 SWR "home switch active";
        7 SW1 "limit switch 1 active";
        8 SW2 "limit switch 2 active";
        9 BRAKEACTIVE "brake on, position loop open";
        10 CURLIMIT "controller output at its limit (warning)";
        11 MOTION "moving";
        12 RAMP_ACC "ramp: accelerating";
        13 RAMP_STEADY "ramp: constant velocity";
        14 RAMP_DEC "ramp: decelerating";
        15 RAMP_END "ramp finished, standing";
        16 INPROGRESS "step motion runs";
        17 FULLBUFFER "one more step motion is buffered";
        18 POW_VOLT_ERR "motor voltage out of range";
        19 POW_FET_TEMP "power stage too hot";
        20 POW_WDG_TEMP "motor too hot";
        21 POW_SHORTCUR "short circuit";
        22 POW_HALLERR "hall sensor reading (one source: communication)";
        23 POW_INTEGRALERR "overload over time";
        24 CPU_OVERLOAD "processor or current controller link overloaded";
        25 BEYOND_HARD "hard limit passed, emergency stop";
        26 BEYOND_SOFT "soft limit passed, emergency stop";
        27 SETUP_OR_LOGIC_VOLT "controller set-up error (from 3.5.14), or logic supply out of range: the sources disagree";
    }
}

impl CubeState {
    /// Every bit that names a cause of [`CubeState::ERROR`].
    pub const CAUSES: Self = Self(
        Self::POWERFAULT.0
            | Self::TOW_ERROR.0
            | Self::COMM_ERROR.0
            | Self::POW_VOLT_ERR.0
            | Self::POW_FET_TEMP.0
            | Self::POW_WDG_TEMP.0
            | Self::POW_SHORTCUR.0
            | Self::POW_HALLERR.0
            | Self::POW_INTEGRALERR.0
            | Self::CPU_OVERLOAD.0
            | Self::BEYOND_HARD.0
            | Self::BEYOND_SOFT.0
            | Self::SETUP_OR_LOGIC_VOLT.0,
    );

    /// Errors that only switching the module off clears. RESET clears the others once their cause is gone; for
    /// [`CubeState::BEYOND_HARD`] the joint must be driven away from the limit.
    pub const NEEDS_POWER_CYCLE: Self = Self(
        Self::POW_FET_TEMP.0
            | Self::POW_WDG_TEMP.0
            | Self::POW_SHORTCUR.0
            | Self::POW_HALLERR.0
            | Self::POW_INTEGRALERR.0
            | Self::CPU_OVERLOAD.0
            | Self::SETUP_OR_LOGIC_VOLT.0,
    );

    /// Phases of a ramp, of which at most one is set.
    pub const RAMP_PHASE: Self =
        Self(Self::RAMP_ACC.0 | Self::RAMP_STEADY.0 | Self::RAMP_DEC.0 | Self::RAMP_END.0);

    /// The short state a module reports with this state.
    ///
    /// NOT_OK summarises error, halt **and** a missing home position (two of the sources state this), so home and
    /// halt cannot be distinguished by it.
    pub const fn short(self) -> ShortState {
        let not_ok = self.intersects(Self(Self::ERROR.0 | Self::HALTED.0)) || !self.contains(Self::HOME_OK);
        ShortState::EMPTY
            .with(ShortState::NOT_OK, not_ok)
            .with(ShortState::SWR, self.contains(Self::SWR))
            .with(ShortState::SW1, self.contains(Self::SW1))
            .with(ShortState::SW2, self.contains(Self::SW2))
            .with(ShortState::MOTION, self.contains(Self::MOTION))
            .with(ShortState::RAMP_END, self.contains(Self::RAMP_END))
            .with(ShortState::INPROGRESS, self.contains(Self::INPROGRESS))
            .with(ShortState::FULLBUFFER, self.contains(Self::FULLBUFFER))
    }
}

bit_word! {
    /// Short state: byte 6 of extended motion answers and of parameter 0x62.
    ShortState(u8) {
        0 NOT_OK "error, halted or not homed";
        1 SWR "home switch active";
        2 SW1 "limit switch 1 active";
        3 SW2 "limit switch 2 active";
        4 MOTION "moving";
        5 RAMP_END "ramp finished, standing";
        6 INPROGRESS "step motion runs";
        7 FULLBUFFER "one more step motion is buffered";
    }
}

/// Digital lines: bits 0..=3 inputs 0..3, bits 4..=7 outputs 0..3.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Dio(pub u8);

impl Dio {
    /// From the four input and four output lines; higher bits of both are dropped.
    pub const fn new(inputs: u8, outputs: u8) -> Self {
        Self(inputs & 0x0F | (outputs & 0x0F) << 4)
    }

    /// Input lines 0..3 in bits 0..=3.
    pub const fn inputs(self) -> u8 {
        self.0 & 0x0F
    }

    /// Output lines 0..3 in bits 0..=3.
    pub const fn outputs(self) -> u8 {
        self.0 >> 4
    }
}

impl fmt::Display for Dio {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "in {:04b} out {:04b}", self.inputs(), self.outputs())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_of_the_state_word_are_those_of_the_reference() {
        let table = [
            (CubeState::ERROR, 0x1),
            (CubeState::HOME_OK, 0x2),
            (CubeState::HALTED, 0x4),
            (CubeState::POWERFAULT, 0x8),
            (CubeState::TOW_ERROR, 0x10),
            (CubeState::COMM_ERROR, 0x20),
            (CubeState::SWR, 0x40),
            (CubeState::SW1, 0x80),
            (CubeState::SW2, 0x100),
            (CubeState::BRAKEACTIVE, 0x200),
            (CubeState::CURLIMIT, 0x400),
            (CubeState::MOTION, 0x800),
            (CubeState::RAMP_ACC, 0x1000),
            (CubeState::RAMP_STEADY, 0x2000),
            (CubeState::RAMP_DEC, 0x4000),
            (CubeState::RAMP_END, 0x8000),
            (CubeState::INPROGRESS, 0x1_0000),
            (CubeState::FULLBUFFER, 0x2_0000),
            (CubeState::POW_VOLT_ERR, 0x4_0000),
            (CubeState::POW_FET_TEMP, 0x8_0000),
            (CubeState::POW_WDG_TEMP, 0x10_0000),
            (CubeState::POW_SHORTCUR, 0x20_0000),
            (CubeState::POW_HALLERR, 0x40_0000),
            (CubeState::POW_INTEGRALERR, 0x80_0000),
            (CubeState::CPU_OVERLOAD, 0x100_0000),
            (CubeState::BEYOND_HARD, 0x200_0000),
            (CubeState::BEYOND_SOFT, 0x400_0000),
            (CubeState::SETUP_OR_LOGIC_VOLT, 0x800_0000),
        ];
        assert_eq!(table.len(), CubeState::BITS.len());
        for (state, mask) in table {
            assert_eq!(state.bits(), mask, "{state}");
        }
    }

    #[test]
    fn short_state_hides_home_and_halt_behind_not_ok() {
        assert_eq!(CubeState::HOME_OK.short(), ShortState::EMPTY);
        assert_eq!(CubeState::EMPTY.short(), ShortState::NOT_OK);
        assert_eq!((CubeState::HOME_OK | CubeState::HALTED).short(), ShortState::NOT_OK);
        assert_eq!((CubeState::HOME_OK | CubeState::ERROR).short(), ShortState::NOT_OK);
        let moving = CubeState::HOME_OK | CubeState::MOTION | CubeState::RAMP_ACC;
        assert_eq!(moving.short(), ShortState::MOTION);
    }

    #[test]
    fn display_names_known_bits_and_keeps_unknown_ones() {
        assert_eq!(CubeState::from_bits(0x8000_0003).to_string(), "ERROR|HOME_OK|0x80000000");
        assert_eq!(CubeState::EMPTY.to_string(), "-");
    }

    #[test]
    fn power_cycle_errors_are_causes() {
        assert!(CubeState::CAUSES.contains(CubeState::NEEDS_POWER_CYCLE));
        assert!(!CubeState::CAUSES.intersects(CubeState::HALTED | CubeState::CURLIMIT));
    }
}
