//! One step of a ball between two soft pads.

use nalgebra::Vector3;

use super::{HandMotion, Released};
use crate::fingers::Fingers;

/// Moment of inertia over m r²: a solid ball.
const INERTIA: f64 = 0.4;
/// Damping ratio of the ball between the pads; rubber.
const DAMPING: f64 = 0.5;
/// The ball counts as free when both pads are farther from it than this, m.
const CLEAR_M: f64 = 5e-4;
/// Rounds over both contacts; each leaves a fifth of the error of sticking.
const ROUNDS: usize = 8;

/// Motion of a ball, in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallMotion {
    /// Centre, m.
    pub p_m: Vector3<f64>,
    /// Velocity, m/s.
    pub v_m_s: Vector3<f64>,
    /// Spin, rad/s.
    pub w_rad_s: Vector3<f64>,
}

/// A ball between two fingers.
#[derive(Debug, Clone)]
pub struct HeldBall {
    fingers: Fingers,
    radius_m: f64,
    gravity_m_s2: f64,
    ball: BallMotion,
    /// When it last touched a pad, and how it moved then.
    last: Released,
    clear: bool,
}

/// A pad that touches the ball in one step.
#[derive(Clone, Copy)]
struct Contact {
    /// From the pad to the ball.
    normal: Vector3<f64>,
    /// Velocity of the pad at the contact, m/s.
    pad_m_s: Vector3<f64>,
    /// Impulse along the normal over the mass, m/s.
    pressed_m_s: f64,
    /// Radius of the contact patch, m.
    patch_m: f64,
    /// Friction so far: m/s, and rad/s about the normal.
    rubbed_m_s: Vector3<f64>,
    turned_rad_s: f64,
}

impl HeldBall {
    /// In closed fingers of a hand, moving with it. `ball_radius_m` is positive.
    #[must_use]
    pub fn new(fingers: Fingers, ball_radius_m: f64, gravity_m_s2: f64, hand: &HandMotion) -> Self {
        let ball = BallMotion { p_m: hand.p_m, v_m_s: hand.v_m_s, w_rad_s: hand.w_rad_s };
        let last = Released { at_s: f64::NEG_INFINITY, ball };
        Self { fingers, radius_m: ball_radius_m, gravity_m_s2, ball, last, clear: false }
    }

    /// Motion of the ball.
    #[must_use]
    pub fn ball(&self) -> BallMotion {
        self.ball
    }

    /// Time of the last contact in s since the fingers started, and the motion of the ball then; `None` while a pad
    /// touches the ball or is near it.
    #[must_use]
    pub fn released(&self) -> Option<Released> {
        self.clear.then_some(self.last)
    }

    /// Moves on by `dt_s` (positive, at most [`super::STEP_S`]); `since_s` is the time after the step since the fingers
    /// started to open, negative before, and `hand` the motion of the hand then.
    pub fn step(&mut self, dt_s: f64, since_s: f64, hand: &HandMotion) {
        let axis = hand.rot_we * self.fingers.closing_axis_e;
        let [first_s, second_s] = self.fingers.starts_s();
        let (first, first_m) = self.pad(hand, &axis, since_s - first_s, dt_s);
        let (second, second_m) = self.pad(hand, &-axis, since_s - second_s, dt_s);
        self.ball.v_m_s.z -= self.gravity_m_s2 * dt_s;
        let mut contacts = [first, second];
        for contact in contacts.iter().flatten() {
            self.ball.v_m_s += contact.normal * contact.pressed_m_s;
        }
        for _ in 0..ROUNDS {
            for contact in contacts.iter_mut().flatten() {
                self.rub(contact, &hand.w_rad_s);
            }
        }
        self.ball.p_m += self.ball.v_m_s * dt_s;
        if contacts.iter().any(Option::is_some) {
            self.last = Released { at_s: since_s, ball: self.ball };
        }
        self.clear = first_m.min(second_m) > CLEAR_M;
    }

    /// The contact with the pad on the side `out` of the ball, if it presses, and the distance to it in m.
    fn pad(&self, hand: &HandMotion, out: &Vector3<f64>, since_s: f64, dt_s: f64) -> (Option<Contact>, f64) {
        let f = &self.fingers;
        let (travel_m, opening_m_s) = f.travel(since_s);
        let from_hand = self.ball.p_m - hand.p_m;
        let depth_m = out.dot(&from_hand) + f.give_m - travel_m;
        let contact = from_hand + out * (self.radius_m - depth_m.max(0.0));
        let throw = hand.rot_wr.column(2);
        let across = throw.cross(out);
        let beside =
            throw.dot(&contact).abs() > f.pad_half_m[0] || across.dot(&contact).abs() > f.pad_half_m[1];
        if beside {
            return (None, f64::INFINITY);
        }
        let pad_m_s = hand.v_m_s + hand.w_rad_s.cross(&contact) + out * opening_m_s;
        // Against the hand, not the finger: a pad recovers without loss.
        let closing_m_s = out.dot(&(self.ball.v_m_s - hand.v_m_s - hand.w_rad_s.cross(&contact)));
        let stiffness = f.stiffness_1_s2();
        // Each of the two pads damps half of the swing of the ball between both.
        let damping = DAMPING * (2.0 * stiffness).sqrt();
        let force = stiffness * depth_m + damping * closing_m_s;
        let contact = (depth_m > 0.0 && force > 0.0).then(|| Contact {
            normal: -out,
            pad_m_s,
            pressed_m_s: force * dt_s,
            patch_m: (2.0 * self.radius_m * depth_m).sqrt(),
            rubbed_m_s: Vector3::zeros(),
            turned_rad_s: 0.0,
        });
        (contact, -depth_m)
    }

    /// Brings sliding and turning of a contact to zero, as far as its friction goes.
    fn rub(&mut self, contact: &mut Contact, hand_w_rad_s: &Vector3<f64>) {
        let arm = -contact.normal * self.radius_m;
        let inertia = INERTIA * self.radius_m * self.radius_m;
        let u = self.ball.v_m_s + self.ball.w_rad_s.cross(&arm) - contact.pad_m_s;
        let sliding = u - contact.normal * u.dot(&contact.normal);
        let most_m_s = self.fingers.friction * contact.pressed_m_s;
        let wanted = contact.rubbed_m_s - sliding / (1.0 + 1.0 / INERTIA);
        let wanted = wanted * (most_m_s / wanted.norm().max(most_m_s).max(f64::MIN_POSITIVE));
        let change = wanted - contact.rubbed_m_s;
        contact.rubbed_m_s = wanted;
        self.ball.v_m_s += change;
        self.ball.w_rad_s += arm.cross(&change) / inertia;

        let turning = (self.ball.w_rad_s - hand_w_rad_s).dot(&contact.normal);
        let most_rad_s = 2.0 / 3.0 * most_m_s * contact.patch_m / inertia;
        let wanted = (contact.turned_rad_s - turning).clamp(-most_rad_s, most_rad_s);
        self.ball.w_rad_s += contact.normal * (wanted - contact.turned_rad_s);
        contact.turned_rad_s = wanted;
    }
}
