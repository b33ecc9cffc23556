//! Ranges of the bit fields.
//!
//! A field of n bits holds `raw = round((x + max) / (2 max) · (2^n - 1))`. No field can hold zero exactly: 0 is in
//! the middle between two raw values, and half a step is its error.

/// Largest position gain of every Damiao motor, N·m/rad.
pub const KP_MAX_NM_RAD: f32 = 500.0;
/// Largest velocity gain of every Damiao motor, N·m·s/rad.
pub const KD_MAX_NM_S_RAD: f32 = 5.0;

/// Position, velocity and torque at the ends of their fields: registers 21, 22 and 23 of a motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ranges {
    p_max_rad: f32,
    v_max_rad_s: f32,
    t_max_nm: f32,
}

impl Ranges {
    /// `None` unless all three are finite and above zero.
    #[must_use]
    pub fn new(p_max_rad: f32, v_max_rad_s: f32, t_max_nm: f32) -> Option<Self> {
        let sound = |max: f32| max.is_finite() && max > 0.0;
        let all = sound(p_max_rad) && sound(v_max_rad_s) && sound(t_max_nm);
        all.then_some(Self { p_max_rad, v_max_rad_s, t_max_nm })
    }

    /// Largest position, rad at the shaft; the least is its negative.
    #[must_use]
    pub const fn p_max_rad(&self) -> f32 {
        self.p_max_rad
    }

    /// Largest velocity, rad/s at the shaft.
    #[must_use]
    pub const fn v_max_rad_s(&self) -> f32 {
        self.v_max_rad_s
    }

    /// Largest torque, N·m at the shaft.
    #[must_use]
    pub const fn t_max_nm(&self) -> f32 {
        self.t_max_nm
    }

    pub(crate) const fn p(&self) -> Field {
        Field { low: -self.p_max_rad, high: self.p_max_rad, bits: 16 }
    }

    pub(crate) const fn v(&self) -> Field {
        Field { low: -self.v_max_rad_s, high: self.v_max_rad_s, bits: 12 }
    }

    pub(crate) const fn t(&self) -> Field {
        Field { low: -self.t_max_nm, high: self.t_max_nm, bits: 12 }
    }
}

pub(crate) const KP: Field = Field { low: 0.0, high: KP_MAX_NM_RAD, bits: 12 };
pub(crate) const KD: Field = Field { low: 0.0, high: KD_MAX_NM_S_RAD, bits: 12 };

/// A bit field and the numbers at its ends.
#[derive(Clone, Copy)]
pub(crate) struct Field {
    low: f32,
    high: f32,
    bits: u32,
}

impl Field {
    const fn raw_max(self) -> f32 {
        ((1_u32 << self.bits) - 1) as f32
    }

    /// The nearest raw value, and whether `value` lies outside the range.
    pub(crate) fn raw(self, value: f32) -> (u16, bool) {
        let share = (value - self.low) / (self.high - self.low);
        // A cast from float to integer saturates; adding a half rounds non-negative values.
        ((share.clamp(0.0, 1.0) * self.raw_max() + 0.5) as u16, !(0.0..=1.0).contains(&share))
    }

    pub(crate) fn value(self, raw: u16) -> f32 {
        self.low + f32::from(raw) / self.raw_max() * (self.high - self.low)
    }
}

/// A motor of the makers' table, as it is shipped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorType {
    /// Name without `DM-J`.
    pub name: &'static str,
    /// Gear ratio (register 20), if the sources name it.
    pub gear: Option<f32>,
    /// Ranges as shipped.
    pub ranges: Ranges,
}

/// Motors by name. Tables of public drivers disagree and have been wrong for months (4340: 8 rad/s for 10). Use
/// these numbers for plans only; in operation the registers of the motor count.
pub const MOTORS: [MotorType; 10] = [
    motor("4310", Some(10.0), [12.5, 30.0, 10.0]),
    motor("4310P", Some(10.0), [12.5, 50.0, 10.0]),
    motor("4340", Some(40.0), [12.5, 10.0, 28.0]),
    motor("8009", Some(9.0), [12.5, 45.0, 54.0]),
    motor("3507", None, [12.5, 50.0, 5.0]),
    motor("6006", None, [12.5, 45.0, 20.0]),
    motor("8006", None, [12.5, 45.0, 40.0]),
    motor("10010L", None, [12.5, 25.0, 200.0]),
    motor("10010", None, [12.5, 20.0, 200.0]),
    motor("6248P", None, [12.566, 20.0, 120.0]),
];

const fn motor(
    name: &'static str,
    gear: Option<f32>,
    [p_max_rad, v_max_rad_s, t_max_nm]: [f32; 3],
) -> MotorType {
    MotorType { name, gear, ranges: Ranges { p_max_rad, v_max_rad_s, t_max_nm } }
}
