//! The gripper: from the order to open to the instant at which the ball is free.

use nalgebra::Vector3;
use protocol::{Duration, Instant};

use super::ball::Plane;
use crate::rng::Rng;

/// Timing of the gripper and what drives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperOptions {
    /// Digital output that opens it while high: axis (from 0; the last one if no axis is named) and line (0..3);
    /// `None`: only orders from outside.
    pub output: Option<(Option<usize>, u8)>,
    /// From the order to the free ball.
    pub delay: Duration,
    /// The delay varies evenly by up to this much to both sides, drawn again for each opening.
    pub jitter: Duration,
    /// Drag of the ball κ = ρ c_d A / (2 m), 1/m; zero flies the parabola of the papers. `None`: not given, zero is used.
    pub drag_1_m: Option<f64>,
    /// Spin of the ball times its lift constant, 1/s: the acceleration is its cross product with the velocity.
    pub magnus_rad_s: Vector3<f64>,
    /// Height of the plane on which landings are reported, m; `None` takes the floor.
    pub landing_z_m: Option<f64>,
    /// A plane that need not be horizontal, on which they are reported instead.
    pub landing_plane: Option<Plane>,
}

impl Default for GripperOptions {
    /// Output 0 of the last drive, 20 ms ± 1 ms, no drag, the floor. The papers give no delay; 20 ms is typical for
    /// small pneumatic grippers.
    fn default() -> Self {
        Self {
            output: Some((None, 0)),
            delay: Duration::from_millis(20),
            jitter: Duration::from_millis(1),
            drag_1_m: None,
            magnus_rad_s: Vector3::zeros(),
            landing_z_m: None,
            landing_plane: None,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fingers {
    Closed,
    Opening { free_at: Instant },
    Open { free_at: Instant },
}

/// Fingers with a delay, and what can go wrong with them.
#[derive(Clone, Debug)]
pub struct Gripper {
    options: GripperOptions,
    rng: Rng,
    fingers: Fingers,
    ordered_open: bool,
    stuck: bool,
    late: Duration,
}

impl Gripper {
    /// Closed; the jitter comes from `seed`.
    pub fn new(options: GripperOptions, seed: u64) -> Self {
        Self {
            options,
            rng: Rng::stream(seed, "gripper"),
            fingers: Fingers::Closed,
            ordered_open: false,
            stuck: false,
            late: Duration::ZERO,
        }
    }

    /// Order to open or close, given at `at`. The same order again changes nothing; an order to close before the ball is free
    /// keeps it.
    pub fn order(&mut self, at: Instant, open: bool) {
        if open == self.ordered_open {
            return;
        }
        self.ordered_open = open;
        if !open {
            self.fingers = Fingers::Closed;
        } else if !self.stuck {
            self.begin_opening(at);
        }
    }

    fn begin_opening(&mut self, at: Instant) {
        let (mean, jitter) = (self.options.delay.as_micros(), self.options.jitter.as_micros());
        let drawn = self.rng.within(mean.saturating_sub(jitter), mean.saturating_add(jitter));
        self.fingers = Fingers::Opening { free_at: at + Duration::from_micros(drawn) + self.late };
    }

    /// The instant at which the ball became free, once, at the first call at or after it.
    pub fn freed(&mut self, now: Instant) -> Option<Instant> {
        match self.fingers {
            Fingers::Opening { free_at } if free_at <= now => {
                self.fingers = Fingers::Open { free_at };
                Some(free_at)
            }
            _ => None,
        }
    }

    /// When a ball on which no other force acts is or was free: known from the order to open on, `None` while closed.
    pub fn free_at(&self) -> Option<Instant> {
        match self.fingers {
            Fingers::Closed => None,
            Fingers::Opening { free_at } | Fingers::Open { free_at } => Some(free_at),
        }
    }

    pub fn is_open(&self) -> bool {
        matches!(self.fingers, Fingers::Open { .. })
    }

    pub fn is_ordered_open(&self) -> bool {
        self.ordered_open
    }

    /// Does not open while stuck; opens when freed if the order still stands, after its usual delay.
    pub fn set_stuck(&mut self, now: Instant, stuck: bool) {
        self.stuck = stuck;
        match self.fingers {
            Fingers::Opening { .. } if stuck => self.fingers = Fingers::Closed,
            Fingers::Closed if !stuck && self.ordered_open => self.begin_opening(now),
            _ => {}
        }
    }

    /// Openings ordered from now on take this much longer.
    pub fn set_late(&mut self, by: Duration) {
        self.late = by;
    }

    pub fn options(&self) -> &GripperOptions {
        &self.options
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: fn(u64) -> Instant = |ms| Instant::from_micros(ms * 1000);

    fn gripper(seed: u64) -> Gripper {
        Gripper::new(GripperOptions::default(), seed)
    }

    #[test]
    fn ball_is_free_after_delay_and_jitter_exactly_once() {
        for seed in 0..200 {
            let mut gripper = gripper(seed);
            gripper.order(MS(100), true);
            assert_eq!(gripper.freed(MS(118)), None);
            let free_at = gripper.freed(MS(130)).unwrap();
            assert!((119_000..=121_000).contains(&free_at.as_micros()), "seed {seed}: {free_at}");
            assert!(gripper.is_open() && gripper.freed(MS(131)).is_none());
        }
    }

    #[test]
    fn closing_in_time_keeps_the_ball() {
        let mut gripper = gripper(1);
        gripper.order(MS(0), true);
        gripper.order(MS(10), false);
        assert_eq!(gripper.freed(MS(100)), None);
    }

    #[test]
    fn stuck_fingers_open_when_they_come_free_if_still_ordered() {
        let mut gripper = gripper(1);
        gripper.set_stuck(MS(0), true);
        gripper.order(MS(10), true);
        assert_eq!(gripper.freed(MS(500)), None);
        gripper.set_stuck(MS(500), false);
        let free_at = gripper.freed(MS(600)).unwrap();
        assert!((519_000..=521_000).contains(&free_at.as_micros()));
    }

    #[test]
    fn late_release_adds_to_the_delay() {
        let mut gripper = gripper(1);
        gripper.set_late(Duration::from_millis(7));
        gripper.order(MS(0), true);
        let free_at = gripper.freed(MS(100)).unwrap();
        assert!((26_000..=28_000).contains(&free_at.as_micros()));
    }
}
