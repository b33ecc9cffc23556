//! A throw: the motion of all joints through one release.
//!
//! Each joint runs two cubics that meet at the release with equal position, speed and acceleration; both outer ends
//! are at rest. With `s` the time since release, `h` the length of the phase and `σ = s/h` in [-1, 1]:
//!
//! ```text
//! q(σ)  = q_r + q̇_r h (σ - σ³/3) + q̈_r h² (σ²/2 - |σ|³/3)
//! q̇(σ)  = q̇_r (1 - σ²)           + q̈_r h (σ - σ|σ|)
//! q̈(σ)  = -2 σ q̇_r / h           + q̈_r (1 - 2|σ|)
//! q⃛(σ)  = -2 q̇_r / h²            - 2 sign(σ) q̈_r / h
//! ```
//!
//! The paper's spline (section IV, step 5) is the case `q̈_r = 0`. A free `q̈_r` is the additional degree of
//! freedom that release-delay nulling needs; it needs no more segments and no higher degree.

use nalgebra::Vector3;
use robot_model::{JointVec, RobotModel};

/// An arm.
pub type Arm = RobotModel;
/// One number per joint.
pub type Joints = JointVec;

/// Motion of all joints through one release.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Throw {
    /// Joint angles at the release in rad.
    pub q_rad: JointVec,
    /// Joint speeds at the release in rad/s.
    pub qd_rad_s: JointVec,
    /// Joint accelerations at the release in rad/s²; zero in the paper's form.
    pub qdd_rad_s2: JointVec,
    /// Time of flight F in s.
    pub flight_s: f64,
    /// Duration of the acceleration phase h_a in s; the release is at this time.
    pub ha_s: f64,
    /// Duration of the braking phase h_b in s.
    pub hb_s: f64,
}

/// Joint state at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointState {
    /// Angles in rad.
    pub q: JointVec,
    /// Speeds in rad/s.
    pub qd: JointVec,
    /// Accelerations in rad/s².
    pub qdd: JointVec,
}

/// How position, speed and acceleration at a phase depend on `(q̇_r, q̈_r)`: `q = q_r + pos.0 q̇_r + pos.1 q̈_r`, etc.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Basis {
    pub(crate) pos: (f64, f64),
    pub(crate) vel: (f64, f64),
    pub(crate) acc: (f64, f64),
    /// The same, differentiated by h.
    pub(crate) pos_by_h: (f64, f64),
    pub(crate) vel_by_h: (f64, f64),
    pub(crate) acc_by_h: (f64, f64),
}

impl Basis {
    /// At phase `sigma` in [-1, 1] of a phase of length `h`.
    #[inline]
    pub(crate) fn at(sigma: f64, h: f64) -> Self {
        let (s, m) = (sigma, sigma.abs());
        let (p1, p2) = (s - s * s * s / 3.0, s * s / 2.0 - m * m * m / 3.0);
        Self {
            pos: (h * p1, h * h * p2),
            vel: (1.0 - s * s, h * (s - s * m)),
            acc: (-2.0 * s / h, 1.0 - 2.0 * m),
            pos_by_h: (p1, 2.0 * h * p2),
            vel_by_h: (0.0, s - s * m),
            acc_by_h: (2.0 * s / (h * h), 0.0),
        }
    }
}

impl Throw {
    /// Number of joints.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.q_rad.len()
    }

    /// Duration of the whole movement H_s in s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.ha_s + self.hb_s
    }

    /// Ratio d_r = h_b / H_s of the braking phase.
    #[must_use]
    pub fn braking_ratio(&self) -> f64 {
        self.hb_s / self.duration_s()
    }

    /// Length of the phase that `sigma` lies in.
    pub(crate) fn phase_s(&self, sigma: f64) -> f64 {
        if sigma < 0.0 { self.ha_s } else { self.hb_s }
    }

    /// Joint state at phase `sigma`: -1 start, 0 release, 1 stop; held outside.
    #[must_use]
    pub(crate) fn at_phase(&self, sigma: f64) -> JointState {
        let sigma = sigma.clamp(-1.0, 1.0);
        let b = Basis::at(sigma, self.phase_s(sigma));
        JointState {
            q: self.q_rad + self.qd_rad_s * b.pos.0 + self.qdd_rad_s2 * b.pos.1,
            qd: self.qd_rad_s * b.vel.0 + self.qdd_rad_s2 * b.vel.1,
            qdd: self.qd_rad_s * b.acc.0 + self.qdd_rad_s2 * b.acc.1,
        }
    }

    /// Joint state `time_s` after the start of the motion; at rest outside `[0, H_s]`.
    #[must_use]
    pub fn at_time(&self, time_s: f64) -> JointState {
        let since = time_s - self.ha_s;
        let sigma = if since < 0.0 { since / self.ha_s } else { since / self.hb_s };
        let mut state = self.at_phase(sigma);
        if !(-1.0..=1.0).contains(&sigma) {
            state.qd = JointVec::zeros(self.joints());
            state.qdd = JointVec::zeros(self.joints());
        }
        state
    }

    /// Joint angles at the start in rad.
    #[must_use]
    pub fn start(&self) -> JointVec {
        self.at_phase(-1.0).q
    }

    /// Joint angles at the stop in rad.
    #[must_use]
    pub fn stop(&self) -> JointVec {
        self.at_phase(1.0).q
    }

    /// Jerk of the two phases in rad/s³; constant within each.
    #[must_use]
    pub fn jerk(&self) -> (JointVec, JointVec) {
        let (a, b) = (self.ha_s, self.hb_s);
        (
            (self.qdd_rad_s2 * a - self.qd_rad_s) * (2.0 / (a * a)),
            (self.qdd_rad_s2 * b + self.qd_rad_s) * (-2.0 / (b * b)),
        )
    }

    /// Largest speed of each joint over the motion in rad/s: at the release, or where the acceleration passes zero.
    #[must_use]
    pub(crate) fn peak_speed(&self) -> JointVec {
        JointVec::from_fn(self.joints(), |j| {
            [-1.0, 1.0]
                .into_iter()
                .filter_map(|side| self.speed_peak_phase(j, side))
                .map(|sigma| {
                    let b = Basis::at(sigma, self.phase_s(sigma));
                    (self.qd_rad_s[j] * b.vel.0 + self.qdd_rad_s2[j] * b.vel.1).abs()
                })
                .fold(self.qd_rad_s[j].abs(), f64::max)
        })
    }

    /// Largest acceleration of each joint over the motion in rad/s²: at start, release or stop, as it is linear between.
    #[must_use]
    pub(crate) fn peak_acceleration(&self) -> JointVec {
        let start = self.qd_rad_s * (2.0 / self.ha_s) - self.qdd_rad_s2;
        let stop = self.qd_rad_s * (-2.0 / self.hb_s) - self.qdd_rad_s2;
        JointVec::from_fn(self.joints(), |j| start[j].abs().max(stop[j].abs()).max(self.qdd_rad_s2[j].abs()))
    }

    /// Phase inside (-1, 0) for `side < 0` or (0, 1) where the speed of joint `j` has its extreme, if there is one.
    pub(crate) fn speed_peak_phase(&self, j: usize, side: f64) -> Option<f64> {
        let h = self.phase_s(side);
        let push = self.qdd_rad_s2[j] * h;
        let sigma = push / (2.0 * (self.qd_rad_s[j] + side.signum() * push));
        let inside = if side < 0.0 { sigma > -1.0 && sigma < -1e-9 } else { sigma < 1.0 && sigma > 1e-9 };
        inside.then_some(sigma)
    }

    /// Phase inside (-1, 0) or (0, 1) where joint `j` turns round before it comes to rest, if it does.
    pub(crate) fn turning_phase(&self, j: usize, side: f64) -> Option<f64> {
        // (1 - |σ|) [q̇ (1 + |σ|) + q̈ h σ] = 0 away from the end.
        let h = self.phase_s(side);
        let sigma = -self.qd_rad_s[j] / (side.signum() * self.qd_rad_s[j] + self.qdd_rad_s2[j] * h);
        let inside = if side < 0.0 { sigma > -1.0 && sigma < -1e-9 } else { sigma < 1.0 && sigma > 1e-9 };
        inside.then_some(sigma)
    }

    /// Ball in the hand at the release: position (m) and velocity (m/s) in the world.
    #[must_use]
    pub fn ball_at_release(&self, arm: &RobotModel) -> (Vector3<f64>, Vector3<f64>) {
        let frames = arm.fk(&self.q_rad);
        let p = arm.ball(&frames).pos;
        let twist = frames.jacobian(&p) * self.qd_rad_s;
        (p, Vector3::new(twist[0], twist[1], twist[2]))
    }

    /// Acceleration of the ball in the hand at the release, `J̇ q̇ + J q̈`, in m/s².
    #[must_use]
    pub(crate) fn ball_acceleration_at_release(&self, arm: &RobotModel) -> Vector3<f64> {
        let frames = arm.fk(&self.q_rad);
        let jacobian = frames.jacobian(&arm.ball(&frames).pos);
        let a = frames.bias_acceleration(&jacobian, &self.qd_rad_s) + jacobian * self.qdd_rad_s2;
        Vector3::new(a[0], a[1], a[2])
    }

    /// Ball in the hand at any time: position and velocity in the world, for releases early or late.
    #[must_use]
    pub(crate) fn ball_at_time(&self, arm: &RobotModel, time_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let state = self.at_time(time_s);
        let frames = arm.fk(&state.q);
        let p = arm.ball(&frames).pos;
        let twist = frames.jacobian(&p) * state.qd;
        (p, Vector3::new(twist[0], twist[1], twist[2]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::throw::Joints;

    fn throw() -> Throw {
        Throw {
            q_rad: Joints::from_slice(&[0.1, -0.2, 0.3, -0.4, 0.5, -0.6]),
            qd_rad_s: Joints::from_slice(&[1.0, -1.5, 0.2, 0.0, 2.0, -0.1]),
            qdd_rad_s2: Joints::from_slice(&[2.0, 8.0, -5.0, 1.0, 0.0, -3.0]),
            flight_s: 0.6,
            ha_s: 0.7,
            hb_s: 0.4,
        }
    }

    #[test]
    fn motion_starts_and_stops_at_rest_and_passes_the_release_smoothly() {
        let t = throw();
        assert!(t.at_phase(-1.0).qd.amax() < 1e-15 && t.at_phase(1.0).qd.amax() < 1e-15);
        let (before, after) = (t.at_time(0.7 - 1e-9), t.at_time(0.7 + 1e-9));
        assert!((before.q - after.q).amax() < 1e-7);
        assert!((before.qd - after.qd).amax() < 1e-7);
        assert!((before.qdd - after.qdd).amax() < 1e-6);
        assert!((t.at_time(0.7).qdd - t.qdd_rad_s2).amax() < 1e-12);
    }

    #[test]
    fn speed_and_acceleration_are_derivatives_of_the_position() {
        let t = throw();
        let eps = 1e-6;
        for time_s in [0.05, 0.3, 0.69, 0.75, 1.0] {
            let (lo, at, hi) = (t.at_time(time_s - eps), t.at_time(time_s), t.at_time(time_s + eps));
            assert!(((hi.q - lo.q) / (2.0 * eps) - at.qd).amax() < 1e-8);
            assert!(((hi.qd - lo.qd) / (2.0 * eps) - at.qdd).amax() < 1e-7);
            let jerk = if time_s < 0.7 { t.jerk().0 } else { t.jerk().1 };
            assert!(((hi.qdd - lo.qdd) / (2.0 * eps) - jerk).amax() < 1e-6);
        }
    }

    #[test]
    fn peaks_bound_a_dense_sample_tightly() {
        let t = throw();
        let (mut speed, mut acceleration) = (Joints::zeros(6), Joints::zeros(6));
        for i in 0..=20_000 {
            let s = t.at_phase(f64::from(i) / 10_000.0 - 1.0);
            speed = speed.sup(&s.qd.abs());
            acceleration = acceleration.sup(&s.qdd.abs());
        }
        // At σ = 0 both phases meet, so the sampled acceleration covers start, release and stop.
        assert!((t.peak_speed() - speed).amax() < 1e-6, "{} {}", t.peak_speed(), speed);
        assert!((t.peak_acceleration() - acceleration).amax() < 1e-6);
    }

    #[test]
    fn without_release_acceleration_it_is_the_printed_spline() {
        let mut t = throw();
        t.qdd_rad_s2 = Joints::zeros(6);
        let (ha, hb) = (t.ha_s, t.hb_s);
        for i in 0..=10 {
            let x = ha * f64::from(i) / 10.0;
            let printed = t.qd_rad_s * (-x * x * x / (3.0 * ha * ha) + x * x / ha) + t.q_rad
                - t.qd_rad_s * (2.0 * ha / 3.0);
            assert!((t.at_time(x).q - printed).amax() < 1e-14);
            let y = ha + hb * f64::from(i) / 10.0;
            let printed = t.qd_rad_s
                * (-y * y * y / (3.0 * hb * hb) + y * y * ha / (hb * hb) + y * (1.0 - ha * ha / (hb * hb))
                    - ha
                    + ha * ha * ha / (3.0 * hb * hb))
                + t.q_rad;
            assert!((t.at_time(y).q - printed).amax() < 1e-13);
        }
    }
}
