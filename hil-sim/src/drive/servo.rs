//! The position loop inside a module: gains in the module's units, torque that the current allows.
//!
//! ```text
//! τ = A (k (r - q) - d q̇)          torque asked for, N·m; no velocity feed-forward, so q lags r by d/k = 2ζ/ωn
//! k = J ωn²,  d = 2 ζ ωn J          stiffness N·m/rad and damping N·m·s/rad for the nominal inertia J, kg·m²
//! |τ| <= (I_max - K_B |q̇|) / K_M    what is left of the current limit, A (eq. (9) of the throwing paper), N·m
//! ```
//!
//! All sources name C0, Damp and A0, and none explains them. Here C0 is ωn, Damp is ζ and A0 the gain A, scaled so
//! that the default is 32, 4 and 10; RECALC applies changed numbers. With the defaults the loop has 320 rad/s, ζ =
//! 0.8 and therefore the 5 ms lag of the throwing arm.

use super::options::Nameplate;

const C0_DEFAULT: i16 = 32;
const DAMP_DEFAULT: i16 = 4;
const A0_DEFAULT: i16 = 10;

/// C0, Damp, A0 as delivered; the same for all modules, the nameplate gives their scale.
pub(super) fn default_gains(_plate: &Nameplate) -> (i16, i16, i16) {
    (C0_DEFAULT, DAMP_DEFAULT, A0_DEFAULT)
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Servo {
    /// N·m/rad.
    pub(super) stiffness_nm_rad: f64,
    /// N·m·s/rad.
    pub(super) damping_nms_rad: f64,
}

impl Servo {
    /// From C0, Damp and A0.
    pub(super) fn new(plate: &Nameplate, c0: f64, damp: f64, a0: f64) -> Self {
        let wn = plate.servo_wn_rad_s * c0 / f64::from(C0_DEFAULT);
        let zeta = plate.servo_zeta * damp / f64::from(DAMP_DEFAULT);
        let gain = plate.servo_inertia_kg_m2 * a0 / f64::from(A0_DEFAULT);
        Self { stiffness_nm_rad: gain * wn * wn, damping_nms_rad: 2.0 * zeta * wn * gain }
    }
}

/// Torque that `current_max_a` allows at speed `v_rad_s`, N·m, never above the gear's limit and never negative.
///
/// `voltage_share` is the supply's voltage over its nominal one: below 1 it takes away as much torque.
pub(super) fn torque_max_nm(plate: &Nameplate, current_max_a: f64, v_rad_s: f64, voltage_share: f64) -> f64 {
    let by_current = (current_max_a - plate.k_b_a_s_rad * v_rad_s.abs()) / plate.k_m_a_nm;
    by_current.min(plate.torque_max_nm).max(0.0) * voltage_share.clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::ModuleId;

    #[test]
    fn default_gains_give_a_lag_of_five_milliseconds() {
        let plate = Nameplate::bench(ModuleId::MIN, 0x4614);
        let servo = Servo::new(&plate, 32.0, 4.0, 10.0);
        assert!((servo.damping_nms_rad / servo.stiffness_nm_rad - 0.005).abs() < 1e-12);
        assert!((servo.stiffness_nm_rad - 4.0 * 320.0 * 320.0).abs() < 1e-6);
    }

    #[test]
    fn current_limit_leaves_less_torque_the_faster_it_turns() {
        let plate = Nameplate::bench(ModuleId::MIN, 0x4614);
        // 30 A / 0.1419 A/Nm = 211 Nm is above the gear's 206 Nm; at 2.6 rad/s the losses take 7.57 A.
        assert_eq!(torque_max_nm(&plate, 30.0, 0.0, 1.0), 206.0);
        assert!((torque_max_nm(&plate, 30.0, -2.6, 1.0) - 158.0675).abs() < 1e-3);
        assert!((torque_max_nm(&plate, 30.0, 0.0, 0.5) - 103.0).abs() < 1e-12);
        assert_eq!(torque_max_nm(&plate, 1.0, 2.6, 1.0), 0.0);
    }
}
