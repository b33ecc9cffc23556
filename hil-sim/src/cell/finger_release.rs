//! A ball between fingers that open, step by step.

use protocol::{Duration, Instant};
use robot_model::Fingers;
use robot_model::release::{BallMotion, HeldBall, Released, SETTLING_S, STEP_S};

use crate::mechanics::{HandPoint, Plant};
use crate::rng::Rng;

/// Fingers of the gripper, and the ball between them from shortly before they open.
#[derive(Clone, Debug)]
pub(super) struct FingerRelease {
    fingers: Fingers,
    ball_radius_m: f64,
    gravity_m_s2: f64,
    rng: Rng,
    opening: Option<Opening>,
}

#[derive(Clone, Debug)]
struct Opening {
    held: HeldBall,
    opens_at: Instant,
}

impl FingerRelease {
    /// Each opening differs from the usual one by what `seed` draws.
    pub(super) fn new(fingers: Fingers, ball_radius_m: f64, gravity_m_s2: f64, seed: u64) -> Self {
        Self { fingers, ball_radius_m, gravity_m_s2, rng: Rng::stream(seed, "fingers"), opening: None }
    }

    /// The fingers closed again: the ball is where the hand holds it.
    pub(super) fn closed(&mut self) {
        self.opening = None;
    }

    /// The ball, while it is between fingers that open or are about to.
    pub(super) fn ball(&self) -> Option<HandPoint> {
        self.opening.as_ref().map(|opening| point(&opening.held.ball()))
    }

    /// Moves the ball over the step of the plant from `before` to `now`. `free_at` is the time at which this
    /// opening frees a ball on which no other force acts. Returns the instant at which the ball left the fingers,
    /// and its place and velocity at that time.
    pub(super) fn step(
        &mut self,
        plant: &dyn Plant,
        (before, now): (Instant, Instant),
        free_at: Instant,
    ) -> Option<(Instant, HandPoint)> {
        if self.opening.is_none() {
            let opens_at = free_at.saturating_sub(Duration::from_secs_f64(self.fingers.freeing_s()));
            if opens_at.saturating_since(now) > Duration::from_secs_f64(SETTLING_S) {
                return None;
            }
            let normals = std::array::from_fn(|_| self.rng.normal());
            let deviation = self.fingers.scatter.deviation(normals);
            let hand = plant.hand_motion(-now.saturating_since(before).as_secs_f64())?;
            let fingers = self.fingers.deviated(&deviation);
            let held = HeldBall::new(fingers, self.ball_radius_m, self.gravity_m_s2, &hand);
            // Fingers cannot have started before they were looked at.
            self.opening = Some(Opening { held, opens_at: opens_at.max(before) });
        }
        let Opening { held, opens_at } = self.opening.as_mut()?;
        let whole_s = now.saturating_since(before).as_secs_f64();
        let begins_s = before.saturating_since(*opens_at).as_secs_f64()
            - opens_at.saturating_since(before).as_secs_f64();
        let steps = (whole_s / STEP_S).ceil().max(1.0) as u32;
        let dt_s = whole_s / f64::from(steps);
        for k in 1..=steps {
            let t_s = f64::from(k) * dt_s;
            held.step(dt_s, begins_s + t_s, &plant.hand_motion(t_s - whole_s)?);
            if let Some(Released { at_s, ball }) = held.released() {
                let at = if at_s < 0.0 {
                    opens_at.saturating_sub(Duration::from_secs_f64(-at_s))
                } else {
                    *opens_at + Duration::from_secs_f64(at_s)
                };
                return Some((at, point(&ball)));
            }
        }
        None
    }
}

fn point(ball: &BallMotion) -> HandPoint {
    HandPoint { p_m: ball.p_m, v_m_s: ball.v_m_s }
}
