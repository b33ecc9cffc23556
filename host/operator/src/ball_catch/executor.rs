//! The port behind which the catcher's arm moves.

use firmware::fault::Refusal;
use hil_sim::two_arms::JointsNow;
use planner::catch::Joints;
use planner::catch::arm::CatchArm;
use planner::catch::motion::{CatchMotion, used};
use planner::catch::search::Choice;
use planner::motion_law::Pieces;

/// Why a motion is not taken over; the one under way goes on.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Refused {
    #[error("it begins at {start_s:.3} s, but it is {now_s:.3} s already")]
    TooLate { start_s: f64, now_s: f64 },
    #[error("joint {joint} would jump by {by_rad:.5} rad or {by_rad_s:.4} rad/s")]
    Jump {
        /// From 1.
        joint: usize,
        by_rad: f64,
        by_rad_s: f64,
    },
    #[error("it uses {share:.3} times a limit of the joints")]
    Limit { share: f64 },
    #[error("joint {joint} leaves its range")]
    Range {
        /// From 1.
        joint: usize,
    },
    #[error("the arm has stopped because of a fault")]
    Halted,
    #[error("the controller refuses the end state: {0:?}")]
    Controller(Refusal),
    #[error("the end state could not be sent to the controller")]
    NotSent,
}

/// What an arm is to do.
#[derive(Debug, Clone, Copy)]
pub struct Order<'a> {
    pub motion: &'a CatchMotion,
    /// A state on it that matters: time, s.
    pub t_s: f64,
    /// Angles then, rad.
    pub q: Joints,
    /// Speeds then, rad/s.
    pub qd: Joints,
}

impl<'a> Order<'a> {
    /// A catch: what matters is the state in which the hand meets the ball.
    #[must_use]
    pub fn catch(choice: &'a Choice) -> Self {
        Self { motion: &choice.motion, t_s: choice.t_s, q: choice.q, qd: choice.qd }
    }

    /// A motion to a place of rest.
    #[must_use]
    pub fn rest(motion: &'a CatchMotion) -> Self {
        let t_s = motion.end_s();
        let (q, qd) = motion.joints_at(t_s);
        Self { motion, t_s, q, qd }
    }
}

/// An arm that follows motions. Times are seconds on one clock.
pub trait Executor {
    /// Takes over the motion of an order from its start on, or at least its state at its time; or leaves everything as it is.
    fn take(&mut self, order: &Order<'_>, now_s: f64) -> Result<(), Refused>;

    /// A refusal that came later than the order.
    fn refused(&mut self) -> Option<Refused> {
        None
    }

    /// Moves on to `to_s`; where the joints are then.
    fn advance(&mut self, to_s: f64) -> JointsNow;

    /// The arm has stopped because of a fault and takes no motion any more.
    fn halted(&self) -> bool;
}

/// A motion may begin this far from where the one under way will be, rad and rad/s.
const JUMP_MAX: (f64, f64) = (1e-6, 1e-5);
/// Step of the drives' position loop, s.
const STEP_S: f64 = 2.5e-4;

/// An arm whose drives follow their set-points with the lag, damping and resolution of the robot file's `[drive_loop]`; the set-point is
/// led by that lag, as a controller does that knows it.
#[derive(Debug)]
pub struct LaggingArm<'a> {
    arm: &'a CatchArm,
    motion: CatchMotion,
    next: Option<CatchMotion>,
    now_s: f64,
    q: Joints,
    qd: Joints,
    wn: f64,
    zeta: f64,
    resolution_rad: f64,
    lost_from_s: Option<f64>,
    halted: bool,
}

impl<'a> LaggingArm<'a> {
    /// At rest at `q` at time zero.
    #[must_use]
    pub fn new(arm: &'a CatchArm, q: &Joints) -> Self {
        let drives = arm.model().drive_loop();
        Self {
            arm,
            motion: CatchMotion::rest(q),
            next: None,
            now_s: 0.0,
            q: *q,
            qd: Joints::zeros(6),
            wn: drives.map_or(320.0, |d| d.natural_frequency_rad_s),
            zeta: drives.map_or(0.8, |d| d.damping_ratio),
            resolution_rad: drives.map_or(0.0, |d| d.position_resolution_rad),
            lost_from_s: None,
            halted: false,
        }
    }

    /// One drive is lost at `at_s`: the controller stops all joints from what they do then, as fast as the limits allow.
    pub fn lose_drive(&mut self, at_s: f64) {
        self.lost_from_s = Some(at_s);
    }

    fn check(&self, motion: &CatchMotion, now_s: f64) -> Result<(), Refused> {
        if self.halted {
            return Err(Refused::Halted);
        }
        if motion.start_s.is_nan() || motion.start_s < now_s {
            return Err(Refused::TooLate { start_s: motion.start_s, now_s });
        }
        let (before, after) = (self.reference_at(motion.start_s), motion.at(motion.start_s));
        for (i, (a, b)) in before.iter().zip(&after).enumerate() {
            let (by_rad, by_rad_s) = ((a.q - b.q).abs(), (a.v - b.v).abs());
            let smooth = by_rad <= JUMP_MAX.0 && by_rad_s <= JUMP_MAX.1;
            if !smooth {
                return Err(Refused::Jump { joint: i + 1, by_rad, by_rad_s });
            }
        }
        let [speed, acceleration, jerk] = used(self.arm, motion);
        let jerk = if self.arm.law().limits_jerk() { jerk } else { 0.0 };
        let share = speed.max(acceleration).max(jerk);
        if share.is_nan() || share > 1.0 {
            return Err(Refused::Limit { share });
        }
        for (i, (pieces, joint)) in motion.joints.iter().zip(self.arm.model().joints()).enumerate() {
            let (low, high) = pieces.extremes();
            let inside = low >= joint.limits.q_min_rad && high <= joint.limits.q_max_rad;
            if !inside {
                return Err(Refused::Range { joint: i + 1 });
            }
        }
        Ok(())
    }

    fn reference_at(&self, t_s: f64) -> [planner::motion_law::State; 6] {
        match &self.next {
            Some(next) if t_s >= next.start_s => next.at(t_s),
            _ => self.motion.at(t_s),
        }
    }
}

impl Executor for LaggingArm<'_> {
    fn take(&mut self, order: &Order<'_>, now_s: f64) -> Result<(), Refused> {
        let motion = order.motion;
        self.check(motion, now_s)?;
        if let Some(next) = self.next.take_if(|next| next.start_s <= now_s) {
            self.motion = next;
        }
        self.next = Some(motion.clone());
        Ok(())
    }

    fn advance(&mut self, to_s: f64) -> JointsNow {
        if let Some(at_s) = self.lost_from_s.take_if(|at_s| *at_s <= to_s) {
            let limits = self.arm.limits(true);
            let state = self.reference_at(at_s);
            let joints = std::array::from_fn(|i| {
                let mut pieces = Pieces::starting(state[i]);
                self.arm.law().append_stop(&limits[i], &mut pieces);
                pieces
            });
            self.motion = CatchMotion { start_s: at_s, joints };
            (self.next, self.halted) = (None, true);
        }
        let steps = ((to_s - self.now_s) / STEP_S).round().max(0.0) as usize;
        for _ in 0..steps {
            self.now_s += STEP_S;
            if let Some(next) = self.next.take_if(|next| next.start_s <= self.now_s) {
                self.motion = next;
            }
            let at = self.motion.at(self.now_s);
            for (i, state) in at.iter().enumerate() {
                let led = state.q + 2.0 * self.zeta / self.wn * state.v + state.a / (self.wn * self.wn);
                let r = if self.resolution_rad > 0.0 {
                    (led / self.resolution_rad).round() * self.resolution_rad
                } else {
                    led
                };
                // Implicit in the speed: stable at any natural frequency.
                let a = (self.wn * self.wn * (r - self.q[i] - STEP_S * self.qd[i])
                    - 2.0 * self.zeta * self.wn * self.qd[i])
                    / (1.0 + 2.0 * self.zeta * self.wn * STEP_S + self.wn * self.wn * STEP_S * STEP_S);
                self.qd[i] += STEP_S * a;
                self.q[i] += STEP_S * self.qd[i];
            }
        }
        self.now_s = to_s;
        JointsNow { q: self.q, qd: self.qd }
    }

    fn halted(&self) -> bool {
        self.halted
    }
}
