//! How a ball leaves two fingers that open while the hand moves.
//!
//! Without this model a ball is free at one instant with the velocity of the hand. In this model the pads are
//! elastic, one finger may be late, and the ball slides and rolls on the pad that it still touches:
//!
//! ```text
//! v'   = -g e_z + Σ (N_i n_i + F_i)              v velocity of the ball, N_i n_i and F_i force of pad i over the mass
//! w'   = Σ (-r n_i × F_i) / (k r²) + M_i n_i     w its spin; k = 2/5, a solid ball
//! N_i  = max(0, K d_i + D s_i')                  soft pad, pressed in by d_i; s_i' the ball's speed in the hand; it does not pull
//! |F_i| <= mu N_i,  |M_i| <= (2/3) mu N_i sqrt(2 r d_i) / (k r²)     sticking or sliding; turning on the contact patch
//! ```
//!
//! Sticking is exact: friction is an impulse that brings the sliding of this step to zero, within its bounds, for both
//! contacts at once (projected Gauss-Seidel). A rolling ball keeps contact without sliding. Left out: the resistance of
//! rolling, the edges of the pads (a ball whose contact leaves a pad is free of it), drag while a pad touches.
//!
//! | file | holds |
//! |---|---|
//! | `held_ball` | one step of a ball between two pads |
//! | this one | a whole release along a motion of the hand |

mod held_ball;

use nalgebra::{Matrix3, Vector3};

pub use held_ball::{BallMotion, HeldBall};

use crate::fingers::Fingers;
use crate::model::RobotModel;
use crate::per_joint::JointVec;

/// Motion of the hand at one instant, in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandMotion {
    /// Axes of the end effector.
    pub rot_we: Matrix3<f64>,
    /// Axes of the release frame; z is the direction of the throw.
    pub rot_wr: Matrix3<f64>,
    /// Place of the held ball's centre, m.
    pub p_m: Vector3<f64>,
    /// Velocity of that point of the hand, m/s.
    pub v_m_s: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub w_rad_s: Vector3<f64>,
}

impl RobotModel {
    /// Motion of the hand at joint angles (rad) and speeds (rad/s).
    #[must_use]
    pub fn hand_motion(&self, q_rad: &JointVec, qd_rad_s: &JointVec) -> HandMotion {
        let frames = self.fk(q_rad);
        let x_wr = self.ball(&frames);
        let (mut v_m_s, mut w_rad_s) = (Vector3::zeros(), Vector3::zeros());
        for i in 0..self.n() {
            w_rad_s += frames.axis(i) * qd_rad_s[i];
            v_m_s += frames.axis(i).cross(&(x_wr.pos - frames.origin(i))) * qd_rad_s[i];
        }
        HandMotion { rot_we: self.ee(&frames).rot, rot_wr: x_wr.rot, p_m: x_wr.pos, v_m_s, w_rad_s }
    }
}

/// A ball that has left the fingers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Released {
    /// When it last touched a pad, in s, on the clock of the caller.
    pub at_s: f64,
    /// Its motion then.
    pub ball: BallMotion,
}

/// The fingers kept the ball.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("the ball still touches a finger {after_s:.3} s after the fingers began to open")]
pub struct NotReleased {
    /// How long was looked.
    pub after_s: f64,
}

/// Step of the integration in s. The stiffest pads that a robot file may have swing with 4500 rad/s.
pub const STEP_S: f64 = 2e-5;
/// Time before the start of the fingers at which the ball is put between the closed pads, in s: the pads settle in it.
pub const SETTLING_S: f64 = 0.010;
/// A ball that touches a finger for longer than this was not released, in s.
pub const WINDOW_S: f64 = 0.25;

/// The release of a ball whose fingers start to open at `opens_s`.
///
/// `hand` gives the hand's motion at a time in s, from 10 ms and half the lag before `opens_s` to 0.25 s after it.
/// `ball_radius_m` is positive.
///
/// # Errors
/// [`NotReleased`]: the ball still touches a pad 0.25 s later.
pub fn release(
    fingers: &Fingers,
    ball_radius_m: f64,
    gravity_m_s2: f64,
    opens_s: f64,
    hand: impl Fn(f64) -> HandMotion,
) -> Result<Released, NotReleased> {
    let starts_s = opens_s - SETTLING_S - 0.5 * fingers.lag_s.abs();
    let mut held = HeldBall::new(*fingers, ball_radius_m, gravity_m_s2, &hand(starts_s));
    let steps = ((opens_s + WINDOW_S - starts_s) / STEP_S) as u32;
    for k in 1..=steps {
        let t_s = starts_s + f64::from(k) * STEP_S;
        held.step(STEP_S, t_s - opens_s, &hand(t_s));
        if let Some(released) = held.released() {
            return Ok(Released { at_s: opens_s + released.at_s, ..released });
        }
    }
    Err(NotReleased { after_s: WINDOW_S })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fingers::tests::fingers;

    const G: f64 = 9.81;
    const RADIUS_M: f64 = 0.03;

    /// A hand that moves with constant acceleration (world frame) and does not turn; pads close along y, throw along x.
    fn straight(a_m_s2: Vector3<f64>, v_m_s: Vector3<f64>) -> impl Fn(f64) -> HandMotion {
        move |t| HandMotion {
            rot_we: Matrix3::identity(),
            rot_wr: Matrix3::new(0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0),
            p_m: v_m_s * t + a_m_s2 * (0.5 * t * t),
            v_m_s: v_m_s + a_m_s2 * t,
            w_rad_s: Vector3::zeros(),
        }
    }

    fn released(fingers: &Fingers, hand: impl Fn(f64) -> HandMotion) -> Released {
        release(fingers, RADIUS_M, G, 0.0, hand).unwrap()
    }

    /// The hand falls with the ball: both pads leave at the freeing time, and the ball has the hand's velocity.
    #[test]
    fn a_ball_that_nothing_pushes_is_free_when_the_pads_have_recovered() {
        let v = Vector3::new(2.0, 0.1, 1.0);
        let out = released(&fingers(), straight(Vector3::new(0.0, 0.0, -G), v));
        assert!((out.at_s - fingers().freeing_s()).abs() < 2.0 * STEP_S, "{out:?}");
        assert!((out.ball.v_m_s - (v - Vector3::z() * G * out.at_s)).norm() < 1e-3, "{out:?}");
        assert!(out.ball.w_rad_s.norm() < 1e-6);
    }

    /// The ball is held at rest against gravity by friction: it slides from the instant at which 2 mu N < g.
    #[test]
    fn a_ball_at_rest_falls_from_the_instant_at_which_friction_no_longer_carries_it() {
        let fingers = Fingers { friction: 0.05, ..fingers() };
        let out = released(&fingers, straight(Vector3::zeros(), Vector3::zeros()));
        // While it slides the pads still rub with 2 mu N, N falls with the travel x: K (d - x).
        let k = fingers.stiffness_1_s2();
        let (mut v, h) = (0.0_f64, 1e-7);
        let mut t = 0.0;
        while t < fingers.freeing_s() {
            let holds = 2.0 * fingers.friction * k * (fingers.give_m - fingers.travel(t).0);
            v = (v + h * (G - holds)).max(0.0);
            t += h;
        }
        assert!((out.ball.v_m_s.z + v).abs() < 0.01 * v, "{} and {v}", out.ball.v_m_s.z);
        assert!(v > 5e-3, "the case must show something: {v}");
    }

    /// The second finger is late: the first one leaves the ball and the second one pushes it; energy of its pad becomes speed.
    #[test]
    fn a_late_finger_pushes_the_ball_towards_the_first() {
        let fall = Vector3::new(0.0, 0.0, -G);
        let sideways = |lag_s| {
            let fingers = Fingers { lag_s, opening_m_s2: 200.0, ..fingers() };
            released(&fingers, straight(fall, Vector3::zeros())).ball.v_m_s.y
        };
        // Never more than all that both pads had stored: v² = 2 · K d² (forces are over the mass).
        let most = (2.0 * fingers().stiffness_1_s2()).sqrt() * fingers().give_m;
        let pushed = sideways(4e-3);
        assert!(pushed > 0.2 * most && pushed < most, "{pushed} of {most}");
        assert!((sideways(-4e-3) + pushed).abs() < 1e-9, "mirrored");
        assert!(sideways(0.0).abs() < 1e-9);
    }

    /// The hand accelerates against the first finger: the ball moves with it until that finger moves away from the ball.
    #[test]
    fn a_ball_that_is_pushed_along_a_slower_finger_stays_on_it_for_longer() {
        let slow = Fingers { opening_m_s2: 5.0, ..fingers() };
        let still = released(&slow, straight(Vector3::new(0.0, 0.0, -G), Vector3::zeros()));
        let pushed = released(&slow, straight(Vector3::new(0.0, 8.0, -G), Vector3::zeros()));
        assert!(pushed.at_s > 1.5 * still.at_s, "{} and {}", pushed.at_s, still.at_s);
    }

    /// A ball that does not slide on the one pad left, which is pulled away along the throw, rolls: it takes 2/7 of the pad's
    /// speed.
    #[test]
    fn a_ball_on_a_pad_that_moves_along_itself_rolls() {
        // The second finger is pressed against the ball by 30 m/s², the first is far away; then the pad speeds up along x.
        let fingers = Fingers { lag_s: 0.5, opening_m_s2: 1e3, opening_m_s: 3.0, ..fingers() };
        let hand = |t: f64| {
            let along = 4.0;
            let s = (t + 0.1).max(0.0);
            HandMotion {
                p_m: Vector3::new(0.5 * along * s * s, 0.5 * 30.0 * t * t, -0.5 * G * t * t),
                v_m_s: Vector3::new(along * s, 30.0 * t, -G * t),
                ..straight(Vector3::zeros(), Vector3::zeros())(t)
            }
        };
        let mut held = HeldBall::new(fingers, RADIUS_M, G, &hand(-0.2));
        let mut t = -0.2;
        while t < -0.08 {
            t += STEP_S;
            held.step(STEP_S, t, &hand(t));
        }
        let ball = held.ball();
        let pad = hand(t).v_m_s.x;
        assert!((ball.v_m_s.x / pad - 2.0 / 7.0).abs() < 0.02, "{} of {pad}", ball.v_m_s.x);
        // Rolling: the surface of the ball at the contact moves with the pad.
        let surface = ball.v_m_s + ball.w_rad_s.cross(&Vector3::new(0.0, -RADIUS_M, 0.0));
        assert!((surface.x - pad).abs() < 1e-4, "{} and {pad}", surface.x);
    }

    #[test]
    fn half_the_step_gives_the_same_release() {
        let fingers = Fingers { lag_s: 1e-3, ..fingers() };
        let hand = straight(Vector3::new(6.0, 5.0, -2.0), Vector3::new(2.0, 0.0, 2.0));
        let coarse = released(&fingers, &hand);
        let mut held = HeldBall::new(fingers, RADIUS_M, G, &hand(-SETTLING_S));
        let mut k = 0;
        let fine = loop {
            k += 1;
            let t = -SETTLING_S + 0.25 * STEP_S * f64::from(k);
            held.step(0.25 * STEP_S, t, &hand(t));
            if let Some(released) = held.released() {
                break released;
            }
        };
        let apart = (coarse.ball.v_m_s - fine.ball.v_m_s).norm();
        assert!(apart < 2e-3 && (coarse.at_s - fine.at_s).abs() < 5e-5, "{apart} m/s");
    }

    #[test]
    fn fingers_that_hardly_open_keep_the_ball_and_say_so() {
        let fingers = Fingers { travel_m: 1e-4, ..fingers() };
        let hand = straight(Vector3::zeros(), Vector3::zeros());
        assert_eq!(release(&fingers, RADIUS_M, G, 0.0, hand), Err(NotReleased { after_s: WINDOW_S }));
    }

    #[test]
    fn the_motion_of_the_hand_is_the_difference_of_its_places() {
        let arm = RobotModel::load("powercube6").unwrap();
        let q = JointVec::from([0.3, -1.0, 0.8, 0.2, 0.9, -0.4]);
        let qd = JointVec::from([0.5, -0.7, 1.1, 0.3, -0.9, 2.0]);
        let h = 1e-6;
        let (before, now, after) = (
            arm.hand_motion(&(q - qd * h), &qd),
            arm.hand_motion(&q, &qd),
            arm.hand_motion(&(q + qd * h), &qd),
        );
        assert!(((after.p_m - before.p_m) / (2.0 * h) - now.v_m_s).norm() < 1e-8);
        let spin = (after.rot_we - before.rot_we) / (2.0 * h) * now.rot_we.transpose();
        assert!((spin - now.w_rad_s.cross_matrix()).amax() < 1e-8);
    }
}
