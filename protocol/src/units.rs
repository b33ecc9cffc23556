//! Physical quantities at the interfaces between modules: one newtype per unit, single precision as on the wire.
//!
//! Inside a computation the unit is a suffix of the name (`q_rad`, `v_max_rad_s`); between modules a value is
//! passed as one of these types. Rotary units are meant; a linear module carries metres in the same wire fields
//! (`powercube-protocol` section 1) and is not distinguished here.

use core::fmt;
use core::ops::{Add, Neg, Sub};

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident, $unit:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
        pub struct $name(f32);

        impl $name {
            /// Zero of the quantity.
            pub const ZERO: Self = Self(0.0);
            /// Unit symbol as printed.
            pub const UNIT: &'static str = $unit;

            /// Wraps a number that is in this unit. NaN and infinities are allowed here and are refused where they
            /// would act ([`Self::is_finite`]).
            pub const fn new(value: f32) -> Self {
                Self(value)
            }

            /// The number in this unit.
            pub const fn get(self) -> f32 {
                self.0
            }

            /// False for NaN and infinities.
            pub const fn is_finite(self) -> bool {
                self.0.is_finite()
            }

            /// Magnitude.
            #[must_use]
            pub const fn abs(self) -> Self {
                Self(self.0.abs())
            }

            /// Nearest value within `low..=high`; NaN becomes `low`, so that a lost number never
            /// acts as a large one. Reversed bounds give the second argument.
            #[must_use]
            pub fn clamp(self, low: Self, high: Self) -> Self {
                // `max` drops NaN in favour of the other operand, and neither call can panic.
                Self(self.0.max(low.0).min(high.0))
            }
        }

        impl Add for $name {
            type Output = Self;
            fn add(self, other: Self) -> Self {
                Self(self.0 + other.0)
            }
        }

        impl Sub for $name {
            type Output = Self;
            fn sub(self, other: Self) -> Self {
                Self(self.0 - other.0)
            }
        }

        impl Neg for $name {
            type Output = Self;
            fn neg(self) -> Self {
                Self(-self.0)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(&self.0, f)?;
                f.write_str(concat!(" ", $unit))
            }
        }
    };
}

quantity!(
    /// Angle.
    Radians, "rad"
);
quantity!(
    /// Angular velocity.
    RadPerSec, "rad/s"
);
quantity!(
    /// Angular acceleration.
    RadPerSec2, "rad/s2"
);
quantity!(
    /// Electric current.
    Amperes, "A"
);
quantity!(
    /// Electric potential.
    Volts, "V"
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clamp_maps_a_lost_number_to_the_lower_bound() {
        let (low, high) = (RadPerSec::new(-1.0), RadPerSec::new(2.0));
        assert_eq!(RadPerSec::new(f32::NAN).clamp(low, high), low);
        assert_eq!(RadPerSec::new(f32::INFINITY).clamp(low, high), high);
        assert_eq!(RadPerSec::new(0.5).clamp(low, high), RadPerSec::new(0.5));
        assert_eq!(RadPerSec::new(0.5).clamp(high, low), low);
    }

    #[test]
    fn display_carries_the_unit_and_honours_precision() {
        assert_eq!(format!("{:.2}", Radians::new(1.0)), "1.00 rad");
        assert_eq!(format!("{}", Amperes::new(-1.5)), "-1.5 A");
    }
}
