//! A record of the plant itself: positions and speeds of the joints, orders to the gripper.
//!
//! Nodes on the bus cannot read it. To judge a run, compare the report of the run with this record. It has one
//! sample per step of the cell's time grid.

use protocol::{Duration, Instant};

/// See the [module](self). [`crate::Cell::record_trace`] starts it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trace {
    joints: usize,
    step: Duration,
    /// Time of the first sample.
    first: Instant,
    /// Link-side angle and speed of each joint, sample by sample.
    samples: Vec<[f64; 2]>,
    gripper: Vec<(Instant, bool)>,
}

impl Trace {
    pub(crate) fn new(joints: usize, step: Duration, grid: Instant) -> Self {
        Self { joints, step, first: grid + step, ..Self::default() }
    }

    pub(crate) fn push(&mut self, joint: [f64; 2]) {
        self.samples.push(joint);
    }

    pub(crate) fn note_gripper(&mut self, at: Instant, open: bool) {
        if self.gripper.last().map_or(open, |(_, last)| *last != open) {
            self.gripper.push((at, open));
        }
    }

    pub fn joints(&self) -> usize {
        self.joints
    }

    pub fn len(&self) -> usize {
        self.samples.len().checked_div(self.joints).unwrap_or(0)
    }

    /// True before the first step.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Time of sample `index`.
    pub fn at(&self, index: usize) -> Instant {
        self.first + self.step * index as u64
    }

    /// Time between two samples.
    pub fn step(&self) -> Duration {
        self.step
    }

    /// The first sample at or after `at`; [`Trace::len`] if there is none.
    pub fn index_at(&self, at: Instant) -> usize {
        let since_us = at.saturating_since(self.first).as_micros();
        (since_us.div_ceil(self.step.as_micros().max(1)) as usize).min(self.len())
    }

    /// Angle (rad) and speed (rad/s) of every joint in sample `index`.
    pub fn sample(&self, index: usize) -> &[[f64; 2]] {
        self.samples.get(index * self.joints..(index + 1) * self.joints).unwrap_or_default()
    }

    /// Each change of the order to the gripper: time, and true for open. A cell starts with a closed one.
    pub fn gripper_orders(&self) -> &[(Instant, bool)] {
        &self.gripper
    }
}
