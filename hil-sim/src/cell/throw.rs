//! The ball: in the hand, in the air, landed; and what the arm did to it after the release.

use nalgebra::Vector3;
use protocol::{Duration, Instant};

use super::drives::Drives;
use super::finger_release::FingerRelease;
use crate::mechanics::{Flight, Gripper, HandPoint, Landing, Plant, Touch};

/// Time after the release from which the ball is tested against hand and arm, s: it starts between the fingers.
const TOUCH_FROM_S: f64 = 0.020;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BallState {
    /// Between the fingers, at this point of the hand.
    InHand(HandPoint),
    Flying(HandPoint),
    /// On the plane.
    Landed(Landing),
}

/// What happened to the ball so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThrowReport {
    /// When the ball was free.
    pub released_at: Option<Instant>,
    /// Position and velocity of the ball then.
    pub release: Option<HandPoint>,
    /// Where it met the plane, or will meet it: the arm is not in the way in this computation.
    pub landing: Option<Landing>,
    /// First contact with the arm from 20 ms after the release on: seconds after the release, and the part.
    pub touch: Option<(f64, Touch)>,
}

/// Gripper, ball and report.
#[derive(Clone, Debug)]
pub(super) struct Throw {
    gripper: Gripper,
    /// How the ball leaves the fingers; `None` for a ball that is free at one instant.
    fingers: Option<FingerRelease>,
    flight: Option<Flight>,
    stepped_to: Instant,
    report: ThrowReport,
    output_seen: bool,
    ball_radius_m: f64,
    gravity_m_s2: f64,
    plane_z_m: f64,
}

impl Throw {
    pub(super) fn new(
        gripper: Gripper,
        fingers: Option<FingerRelease>,
        ball_radius_m: f64,
        gravity_m_s2: f64,
        plane_z_m: f64,
    ) -> Self {
        Self {
            gripper,
            fingers,
            flight: None,
            stepped_to: Instant::ZERO,
            report: ThrowReport::default(),
            output_seen: false,
            ball_radius_m,
            gravity_m_s2,
            plane_z_m,
        }
    }

    pub(super) fn report(&self) -> &ThrowReport {
        &self.report
    }

    pub(super) fn order(&mut self, at: Instant, open: bool) {
        self.gripper.order(at, open);
    }

    pub(super) fn is_ordered_open(&self) -> bool {
        self.gripper.is_ordered_open()
    }

    pub(super) fn closed_at(&self, drives: &Drives) -> Option<Instant> {
        drives.gripper_closed(self.gripper.options().output)
    }

    pub(super) fn set_stuck(&mut self, now: Instant, stuck: bool) {
        self.gripper.set_stuck(now, stuck);
    }

    pub(super) fn set_late(&mut self, by: Duration) {
        self.gripper.set_late(by);
    }

    pub(super) fn reload(&mut self, at: Instant) {
        self.gripper.order(at, false);
        self.flight = None;
        self.report = ThrowReport::default();
    }

    pub(super) fn ball(&self, plant: &dyn Plant, now: Instant) -> Option<BallState> {
        let Some(mut flight) = self.flight else {
            let between = self.fingers.as_ref().and_then(FingerRelease::ball);
            return between.or_else(|| plant.hand(0.0)).map(BallState::InHand);
        };
        let t_s = self.since_release_s(now)?;
        match self.report.landing {
            Some(landing) if t_s >= landing.t_s => Some(BallState::Landed(landing)),
            _ => Some(BallState::Flying(flight.at(t_s))),
        }
    }

    fn since_release_s(&self, now: Instant) -> Option<f64> {
        self.report.released_at.map(|at| now.saturating_since(at).as_secs_f64())
    }

    /// Reads the gripper state of the drives and moves the ball to `now`, the end of a step.
    pub(super) fn step(&mut self, drives: &Drives, plant: &dyn Plant, now: Instant) {
        // Orders from outside stay in force until the output, or the motor of the fingers, changes.
        if let Some((open, changed)) = drives.gripper(self.gripper.options().output)
            && open != self.output_seen
        {
            self.output_seen = open;
            self.gripper.order(changed, open);
        }
        let freed_at = self.gripper.freed(now);
        if self.flight.is_none()
            && let Some((at, ball)) = self.left_hand(plant, freed_at, now)
        {
            self.release(at, ball);
        }
        self.stepped_to = now;
        self.watch_for_touch(plant, now);
    }

    /// When the ball left the hand in the step that ended at `now`, and its place and velocity then.
    fn left_hand(
        &mut self,
        plant: &dyn Plant,
        freed_at: Option<Instant>,
        now: Instant,
    ) -> Option<(Instant, HandPoint)> {
        let Some(fingers) = &mut self.fingers else {
            let at = freed_at?;
            return Some((at, plant.hand(-now.saturating_since(at).as_secs_f64())?));
        };
        let Some(free_at) = self.gripper.free_at() else {
            fingers.closed();
            return None;
        };
        fingers.step(plant, (self.stepped_to, now), free_at)
    }

    fn release(&mut self, at: Instant, ball: HandPoint) {
        let air = self.gripper.options();
        let flight =
            Flight::new(ball, self.gravity_m_s2, air.drag_1_m.unwrap_or(0.0)).with_magnus(air.magnus_rad_s);
        self.report = ThrowReport {
            released_at: Some(at),
            release: Some(ball),
            landing: match &air.landing_plane {
                Some(plane) => flight.passage(plane),
                None => flight.landing(self.plane_z_m),
            },
            touch: None,
        };
        self.flight = Some(flight);
        if let Some(fingers) = &mut self.fingers {
            fingers.closed();
        }
    }

    fn watch_for_touch(&mut self, plant: &dyn Plant, now: Instant) {
        let Some(flight) = &mut self.flight else { return };
        let Some(released_at) = self.report.released_at else { return };
        let t_s = now.saturating_since(released_at).as_secs_f64();
        let over = self.report.landing.is_some_and(|landing| t_s > landing.t_s);
        if self.report.touch.is_some() || t_s < TOUCH_FROM_S || over {
            return;
        }
        let center: Vector3<f64> = flight.at(t_s).p_m;
        if let Some(touch) = plant.touch(&center, self.ball_radius_m) {
            self.report.touch = Some((t_s, touch));
        }
    }
}
