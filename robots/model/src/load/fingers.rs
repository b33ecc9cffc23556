//! `[fingers]`: how the gripper lets go.

use nalgebra::Vector3;
use toml_reader::Value;

use super::Section;
use crate::error::{LoadError, Problem};
use crate::fingers::{FingerScatter, Fingers};
use crate::model::Gripper;

/// Largest stiffness of a pad over the mass of the ball, 1/s²: the release is integrated with steps of 20 us.
const PAD_STIFFNESS_MAX_1_S2: f64 = 1e7;
/// Least angle between closing axis and throw.
const ACROSS_MIN_DEG: f64 = 45.0;

pub(super) fn read(section: &Section<'_>, gripper: &Gripper) -> Result<Fingers, LoadError> {
    let axis: Vector3<f64> = section.required("closing_axis", Value::numbers::<3>)?.into();
    let closing_axis_e =
        axis.try_normalize(1e-9).ok_or_else(|| section.error("closing_axis", Problem::ZeroAxis))?;
    let throw = gripper.x_eb.rot.column(2);
    let off_deg = closing_axis_e.dot(&throw).abs().min(1.0).acos().to_degrees();
    if off_deg < ACROSS_MIN_DEG {
        return Err(section.error("closing_axis", Problem::FingersAcrossThrow { off_deg }));
    }
    let number = |key, min: f64, max: f64| section.required(key, |v| v.number_in(min, max));
    let or_zero = |key, min: f64, max: f64| section.or(key, 0.0, |v| v.number_in(min, max));
    let size = |v: &Value<'_, Problem>| v.number_in(1e-3, 0.5);
    let fingers = Fingers {
        closing_axis_e,
        pad_half_m: [
            section.required("pad_half_length_m", size)?,
            section.required("pad_half_width_m", size)?,
        ],
        grip_m_s2: number("grip_m_s2", 1.0, 1e5)?,
        give_m: number("give_m", 1e-5, 0.02)?,
        friction: number("friction", 0.01, 5.0)?,
        opening_m_s2: number("opening_m_s2", 0.1, 1e5)?,
        opening_m_s: number("opening_m_s", 1e-3, 100.0)?,
        travel_m: number("travel_m", 1e-4, 0.5)?,
        lag_s: or_zero("lag_s", -0.05, 0.05)?,
        scatter: FingerScatter {
            lag_s: or_zero("lag_sigma_s", 0.0, 0.02)?,
            friction_share: or_zero("friction_sigma", 0.0, 0.5)?,
            opening_share: or_zero("opening_sigma", 0.0, 0.5)?,
        },
    };
    let (travel_m, give_m) = (fingers.travel_m, fingers.give_m);
    if travel_m < 2.0 * give_m {
        return Err(section.error("travel_m", Problem::FingersTooShort { travel_m, give_m }));
    }
    let (stiffness_1_s2, max_1_s2) = (fingers.stiffness_1_s2(), PAD_STIFFNESS_MAX_1_S2);
    if stiffness_1_s2 > max_1_s2 {
        return Err(section.error("grip_m_s2", Problem::PadsTooStiff { stiffness_1_s2, max_1_s2 }));
    }
    section.finish()?;
    Ok(fingers)
}
