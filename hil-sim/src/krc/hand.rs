//! Gripper and ball at the actual tool.

use protocol::Instant;
use robot_model::RobotModel;

use super::correction::radians;
use super::drives::{AxisState, Drives};
use super::options::HandOptions;
use crate::mechanics::{Flight, Gripper, HandPoint, Landing};

/// Gripper, and the ball in it or in flight.
#[derive(Clone, Debug)]
pub struct Hand {
    options: HandOptions,
    gripper: Gripper,
    outputs: i32,
    released: Option<(Instant, HandPoint)>,
}

impl Hand {
    /// Closed, with the ball.
    pub fn new(options: HandOptions, seed: u64) -> Self {
        Self { options, gripper: Gripper::new(options.gripper, seed), outputs: 0, released: None }
    }

    pub fn is_open(&self) -> bool {
        self.gripper.is_open()
    }

    /// Outputs as they are set.
    pub fn outputs(&self) -> i32 {
        self.outputs
    }

    pub fn set_outputs(&mut self, at: Instant, outputs: i32) {
        self.outputs = outputs;
        if let Some(bit) = self.options.output_bit {
            self.gripper.order(at, (outputs >> bit.min(31)) & 1 != 0);
        }
    }

    /// Checks whether the ball left the hand up to `now`; `drives` must not have advanced beyond the last check.
    pub fn check(
        &mut self,
        now: Instant,
        drives: &Drives,
        model: &RobotModel,
    ) -> Option<(Instant, HandPoint)> {
        let free_at = self.gripper.freed(now)?;
        if self.released.is_some() {
            return None;
        }
        self.released = Some((free_at, point(model, &drives.state_at(free_at))));
        self.released
    }

    /// When and how the ball left the hand.
    pub fn released(&self) -> Option<(Instant, HandPoint)> {
        self.released
    }

    /// Where the ball meets the landing plane (the floor unless the options set another).
    pub fn landing(&self, model: &RobotModel) -> Option<Landing> {
        let (_, from) = self.released?;
        let gripper = &self.options.gripper;
        let flight = Flight::new(from, model.world().gravity_m_s2, gripper.drag_1_m.unwrap_or(0.0));
        match &gripper.landing_plane {
            Some(plane) => flight.passage(plane),
            None => flight.landing(gripper.landing_z_m.unwrap_or(model.world().floor_z_m)),
        }
    }
}

/// The ball's centre in the hand, and its velocity.
pub fn point(model: &RobotModel, state: &AxisState) -> HandPoint {
    let frames = model.fk(&radians(&state.q_deg));
    let p_m = model.ball(&frames).pos;
    let twist = frames.jacobian(&p_m) * radians(&state.qd_deg_s);
    HandPoint { p_m, v_m_s: twist.fixed_rows::<3>(0).into_owned() }
}
