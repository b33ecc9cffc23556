//! Where, how fast and how hard a joint may move on the way to new end states ([`crate::retarget`]): part of a trajectory
//! file, checked against the settings.
//!
//! # Control reserve
//!
//! An envelope has at most [`SHARE`] of a joint's speed and acceleration: the rest is for the feedback.
//!
//! # Distance from the soft limits
//!
//! A drive family may turn a command into braking. It does so when the way left to a soft limit is less than the
//! way of braking with the full acceleration A plus one period P of travel. A course brakes with a < A, which takes
//! more way. It therefore comes that close only shortly before its turning point, and never if the turning point
//! stays P² / (2 (1/a - 1/A)) away from the limit: 0.9 mrad for a = 0.95 A, A = 10.4 rad/s² and P = 3 ms. An
//! envelope keeps this distance.

use crate::fault::{Cause, Refusal};
use crate::joints::PerJoint;
use crate::retarget::JointEnvelope;
use crate::settings::{JointSettings, Settings};

/// Largest share of a joint's highest speed and acceleration.
pub const SHARE: f32 = 0.95;
/// Factor on a limit that allows for rounding to single precision.
const ROUNDING: f32 = 1.001;

/// The envelope of each joint: a trajectory file that has one allows new end states while it runs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Envelope {
    /// Per joint.
    pub joint: PerJoint<JointEnvelope>,
}

impl Envelope {
    /// The widest envelope for these settings.
    pub fn widest(settings: &Settings) -> Self {
        let mut envelope = Self::default();
        for joint in settings.joints() {
            envelope.joint.set(joint, widest(settings.joint.at(joint), settings.cycle_period_s()));
        }
        envelope
    }

    /// Checks that the envelope is within the limits less the control reserve, for each joint in use.
    ///
    /// # Errors
    ///
    /// [`Cause::FileEnvelope`] with the joint.
    pub fn check(&self, settings: &Settings) -> Result<(), Refusal> {
        for joint in settings.joints() {
            if !is_within(self.joint.at(joint), settings.joint.at(joint), settings.cycle_period_s()) {
                return Err(Refusal::at(Cause::FileEnvelope, joint));
            }
        }
        Ok(())
    }
}

fn widest(limits: &JointSettings, period_s: f32) -> JointEnvelope {
    let a_max_rad_s2 = SHARE * limits.a_max_rad_s2;
    let margin_rad = turning_margin_rad(a_max_rad_s2, limits.a_max_rad_s2, period_s);
    JointEnvelope {
        q_min_rad: limits.q_min_rad + margin_rad,
        q_max_rad: limits.q_max_rad - margin_rad,
        v_max_rad_s: SHARE * limits.v_max_rad_s,
        a_max_rad_s2,
    }
}

fn is_within(envelope: &JointEnvelope, limits: &JointSettings, period_s: f32) -> bool {
    let margin_rad =
        turning_margin_rad(envelope.a_max_rad_s2, limits.a_max_rad_s2, period_s) / (ROUNDING * ROUNDING);
    // Written so that NaN fails.
    envelope.v_max_rad_s > 0.0
        && envelope.v_max_rad_s <= ROUNDING * SHARE * limits.v_max_rad_s
        && envelope.a_max_rad_s2 > 0.0
        && envelope.a_max_rad_s2 <= ROUNDING * SHARE * limits.a_max_rad_s2
        && envelope.q_min_rad < envelope.q_max_rad
        && envelope.q_min_rad >= limits.q_min_rad + margin_rad
        && envelope.q_max_rad <= limits.q_max_rad - margin_rad
}

/// Distance of a turning point from a soft limit.
fn turning_margin_rad(a_rad_s2: f32, a_full_rad_s2: f32, period_s: f32) -> f32 {
    0.5 * period_s * period_s / (1.0 / a_rad_s2 - 1.0 / a_full_rad_s2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::JointIndex;

    #[test]
    fn the_widest_envelope_passes_and_whatever_is_wider_or_not_a_number_names_its_joint() {
        let settings = Settings::powercube6();
        let widest = Envelope::widest(&settings);
        assert_eq!(widest.check(&settings), Ok(()));
        let joint = JointIndex::new(4).unwrap();
        let spoils: [fn(&mut JointEnvelope); 7] = [
            |e| e.q_min_rad -= 1e-3,
            |e| e.q_max_rad += 1e-3,
            |e| e.q_min_rad = e.q_max_rad,
            |e| e.v_max_rad_s *= 1.01,
            |e| e.a_max_rad_s2 *= 1.01,
            |e| e.a_max_rad_s2 = f32::NAN,
            |e| e.v_max_rad_s = 0.0,
        ];
        for (index, spoil) in spoils.into_iter().enumerate() {
            let mut wrong = widest;
            spoil(wrong.joint.at_mut(joint));
            assert_eq!(wrong.check(&settings), Err(Refusal::at(Cause::FileEnvelope, joint)), "{index}");
        }
    }
}
