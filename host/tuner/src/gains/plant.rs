//! One joint for the control comparison: ramp generator, position loop, friction, encoder.
//!
//! Integrated in steps of 50 us, unlike the exact discretisation of the design, and with parts that the design
//! leaves out: Coulomb friction, position resolution, velocity clip.

use crate::model::{DriveLag, Estimator};
use firmware::feedback::{ErrorEstimator, ErrorState, Gains, Weights, clip_to_remaining};
use robot_model::cubic::Cubic;

/// Integration step, s: a sixtieth of the drive's time constant 1/wn at 320 rad/s.
const STEP_S: f64 = 5e-5;

/// A joint to control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plant {
    /// Position loop.
    pub drive: DriveLag,
    /// Coulomb friction over inertia, rad/s2.
    pub friction_rad_s2: f64,
    /// Position resolution, rad (0: none).
    pub resolution_rad: f64,
    /// Velocity limit of the ramp generator, rad/s.
    pub velocity_max_rad_s: f64,
    /// Acceleration for control, rad/s2.
    pub acceleration_max_rad_s2: f64,
}

/// Position and velocity of a reference from time 0 to `duration_s`, at rest before and after.
pub trait Reference {
    fn position_rad(&self, t_s: f64) -> f64;
    fn velocity_rad_s(&self, t_s: f64) -> f64;
    fn duration_s(&self) -> f64;
}

/// The two cubics of a throw (paper section IV): rest, release velocity at `ha`, rest at `ha + hb`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Throw {
    /// Velocity at the release, rad/s.
    pub release_rad_s: f64,
    /// Acceleration time, s.
    pub ha_s: f64,
    /// Deceleration time, s.
    pub hb_s: f64,
}

impl Throw {
    /// Largest |acceleration| before and after the release: 2 |qd_r| / ha, 2 |qd_r| / hb.
    pub fn acceleration_max_rad_s2(&self) -> (f64, f64) {
        let twice = 2.0 * self.release_rad_s.abs();
        (twice / self.ha_s, twice / self.hb_s)
    }

    /// The cubic in force at t, and the time since its start. The position is 0 at the release.
    fn cubic_at(&self, t_s: f64) -> (Cubic<f64>, f64) {
        let (t_s, release) = (t_s.clamp(0.0, self.ha_s + self.hb_s), (0.0, self.release_rad_s));
        // A cubic from rest whose acceleration ends at zero goes two thirds of velocity times duration.
        let way = |h_s: f64| self.release_rad_s * h_s * (2.0 / 3.0);
        if t_s < self.ha_s {
            (Cubic::between(self.ha_s, (-way(self.ha_s), 0.0), release), t_s)
        } else {
            (Cubic::between(self.hb_s, release, (way(self.hb_s), 0.0)), t_s - self.ha_s)
        }
    }
}

impl Reference for Throw {
    fn position_rad(&self, t_s: f64) -> f64 {
        let (cubic, t_s) = self.cubic_at(t_s);
        cubic.position(t_s)
    }

    fn velocity_rad_s(&self, t_s: f64) -> f64 {
        let (cubic, t_s) = self.cubic_at(t_s);
        cubic.velocity(t_s)
    }

    fn duration_s(&self) -> f64 {
        self.ha_s + self.hb_s
    }
}

/// How the controller computes its feed-forward and its velocity error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeedForwardLaw {
    /// Mean reference acceleration over the interval in which the command acts, shifted by the drive
    /// lag; the firmware's own estimator, feedback and clip.
    Aligned,
    /// Reference acceleration and velocity at the sample: the paper's error system taken literally.
    Naive,
}

/// Timing, law and start of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Command period, s.
    pub period_s: f64,
    /// Sample to action, s.
    pub delay_s: f64,
    pub law: FeedForwardLaw,
    /// Weights of the estimator ([`FeedForwardLaw::Aligned`]).
    pub estimator: Estimator,
    /// Initial position error, rad.
    pub start_error_rad: f64,
}

/// Errors over a run, one row per integration step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    pub t_s: Vec<f64>,
    pub position_rad: Vec<f64>,
    pub velocity_rad_s: Vec<f64>,
    /// Acceleration in force, rad/s2.
    pub command_rad_s2: Vec<f64>,
}

impl Track {
    /// Time after which |position error| stays below `bound`, s; `None` if it does not.
    pub fn below_after_s(&self, bound_rad: f64) -> Option<f64> {
        match self.position_rad.iter().rposition(|e| e.abs() >= bound_rad) {
            None => Some(0.0),
            Some(i) => self.t_s.get(i + 1).copied(),
        }
    }

    /// Largest |position error| from `from_s` on, rad.
    pub fn position_max_rad(&self, from_s: f64) -> f64 {
        let late = self.t_s.iter().zip(&self.position_rad).filter(|(t, _)| **t >= from_s);
        late.map(|(_, e)| e.abs()).fold(0.0, f64::max)
    }

    /// Position and velocity error at `t`, rad and rad/s.
    pub fn at(&self, t_s: f64) -> (f64, f64) {
        let i = self.t_s.partition_point(|t| *t < t_s).min(self.t_s.len().saturating_sub(1));
        (self.position_rad[i], self.velocity_rad_s[i])
    }
}

/// Tracks `reference` with u = clip(k_pos e + k_vel w + k_last u_last) in the firmware's own arithmetic.
///
/// The clip leaves the total, feed-forward included, within the acceleration for control.
pub fn track(plant: &Plant, reference: &impl Reference, gains: [f32; 3], setup: &Setup) -> Track {
    let [k_error_1_s2, k_rate_1_s, k_last] = gains;
    let gains = Gains { k_error_1_s2, k_rate_1_s, k_last };
    let weights = Weights { alpha: setup.estimator.alpha as f32, beta: setup.estimator.beta as f32 };
    let (wn, zeta) = (plant.drive.wn_rad_s, plant.drive.zeta);
    let round = |q: f64| {
        if plant.resolution_rad > 0.0 { (q / plant.resolution_rad).round() * plant.resolution_rad } else { q }
    };
    let (period, lag) = ((setup.period_s / STEP_S).round() as usize, plant.drive.lag_s());
    let delay = (setup.delay_s / STEP_S).round() as usize;
    let steps = (reference.duration_s() / STEP_S).ceil() as usize;
    let (mut r, mut dr) = (reference.position_rad(0.0) + setup.start_error_rad, 0.0f64);
    let (mut y, mut dy) = (r, 0.0f64);
    let mut estimator = ErrorEstimator::default();
    // The command in force since the last sample, and the one that follows it from this sample on.
    let (mut acceleration, mut u_before, mut u_last) = (0.0, 0.0f32, 0.0f32);
    let mut pending: Option<(usize, f64)> = None;
    let mut out = Track::default();
    for i in 0..steps {
        let t = i as f64 * STEP_S;
        // The command of the sample before acts first where both fall on the same instant.
        if let Some((_, a)) = pending.filter(|(due, _)| *due == i) {
            (acceleration, pending) = (a, None);
        }
        if i % period == 0 {
            let e = round(y) - reference.position_rad(t);
            estimator.update(e as f32, setup.period_s as f32, u_before, setup.period_s as f32, weights);
            let (e_rad, de_rad_s) = match setup.law {
                FeedForwardLaw::Aligned => (estimator.e_rad(), estimator.de_rad_s()),
                FeedForwardLaw::Naive => (e as f32, (dy - reference.velocity_rad_s(t)) as f32),
            };
            let feed_forward = match setup.law {
                FeedForwardLaw::Aligned => {
                    let from = t + setup.delay_s + lag;
                    let gained =
                        reference.velocity_rad_s(from + setup.period_s) - reference.velocity_rad_s(from);
                    gained / setup.period_s
                }
                FeedForwardLaw::Naive => {
                    (reference.velocity_rad_s(t + 1e-4) - reference.velocity_rad_s(t)) / 1e-4
                }
            };
            let wanted = gains.apply(&ErrorState { e_rad, de_rad_s, u_last_rad_s2: u_last });
            let action = clip_to_remaining(wanted, feed_forward as f32, plant.acceleration_max_rad_s2 as f32);
            (u_before, u_last) = (u_last, action.u_rad_s2);
            let command = f64::from(action.qdd_rad_s2);
            if delay == 0 {
                acceleration = command;
            } else {
                pending = Some((i + delay, command));
            }
        }
        let next = (dr + acceleration * STEP_S).clamp(-plant.velocity_max_rad_s, plant.velocity_max_rad_s);
        r += 0.5 * (dr + next) * STEP_S;
        dr = next;
        let drive = wn * wn * (r - y) - 2.0 * zeta * wn * dy;
        let friction = plant.friction_rad_s2;
        // At rest friction holds up to its limit; moving, it opposes and cannot reverse the motion.
        let moved = if dy == 0.0 {
            drive.signum() * (drive.abs() - friction).max(0.0) * STEP_S
        } else {
            let free = dy + drive * STEP_S;
            let slowed = free - dy.signum() * friction * STEP_S;
            if slowed * dy < 0.0 && drive.abs() <= friction { 0.0 } else { slowed }
        };
        dy = moved;
        y += dy * STEP_S;
        let t = t + STEP_S;
        out.t_s.push(t);
        out.position_rad.push(y - reference.position_rad(t));
        out.velocity_rad_s.push(dy - reference.velocity_rad_s(t));
        out.command_rad_s2.push(acceleration);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLANT: Plant = Plant {
        drive: DriveLag::POWERCUBE,
        friction_rad_s2: 5.0,
        resolution_rad: 3.4907e-4,
        velocity_max_rad_s: 2.6,
        acceleration_max_rad_s2: 10.4,
    };
    const THROW: Throw = Throw { release_rad_s: 1.7016, ha_s: 0.71094, hb_s: 0.47396 };

    #[test]
    fn throw_meets_its_boundary_conditions() {
        assert!((THROW.position_rad(0.0) + 2.0 / 3.0 * 1.7016 * 0.71094).abs() < 1e-12);
        assert!((THROW.position_rad(9.0) - 2.0 / 3.0 * 1.7016 * 0.47396).abs() < 1e-12);
        assert!(THROW.velocity_rad_s(0.0).abs() < 1e-12 && THROW.velocity_rad_s(9.0).abs() < 1e-12);
        assert_eq!(THROW.velocity_rad_s(0.71094), 1.7016);
        let (before, after) = THROW.acceleration_max_rad_s2();
        assert!((before - 4.787).abs() < 1e-3 && (after - 7.180).abs() < 1e-3);
    }

    #[test]
    fn naive_feed_forward_tracks_several_times_worse() {
        let run = |law| {
            let setup = Setup {
                period_s: 0.017,
                delay_s: 0.017,
                law,
                estimator: Estimator::PLAIN,
                start_error_rad: 0.0,
            };
            track(&PLANT, &THROW, [-417.0, -38.8, -0.6], &setup).position_max_rad(0.35)
        };
        let (aligned, naive) = (run(FeedForwardLaw::Aligned), run(FeedForwardLaw::Naive));
        assert!(aligned < 1.5e-3 && aligned > 1e-5, "{aligned}");
        assert!(naive > 3.0 * aligned && naive < 30e-3, "{naive}");
    }

    #[test]
    fn stuck_joint_stays_put_and_a_free_one_follows() {
        let rest = Throw { release_rad_s: 0.0, ..THROW };
        let setup = Setup {
            period_s: 0.01,
            delay_s: 0.005,
            law: FeedForwardLaw::Aligned,
            estimator: Estimator::PLAIN,
            start_error_rad: 1e-5,
        };
        let held = track(&PLANT, &rest, [-100.0, -15.0, -0.1], &setup);
        // Below the encoder's resolution nothing is seen and nothing moves.
        assert!(held.position_rad.iter().all(|e| (e - 1e-5).abs() < 1e-12));
        let moved = track(&PLANT, &rest, [-100.0, -15.0, -0.1], &Setup { start_error_rad: 0.05, ..setup });
        assert!(moved.position_max_rad(1.0) < 1e-3);
    }
}
