//! A user's own task for the local solver: the posture that holds the ball at a point with the least torque.
//! `cargo run -p planner --example own_task`.
//!
//! Variables are the six joint angles. Objective: the sum of the squared torques against gravity. Constraints: the ball is at
//! the point (three equalities), and each joint stays in its range (two inequalities each).

use std::ops::Range;

use nalgebra::Vector3;
use planner::solve::sqp::{Ended, Settings, solve};
use planner::solve::{Row, Sink, Task, WIDTH, When};
use robot_model::{JointVec, RobotModel};

struct Hold<'a> {
    arm: &'a RobotModel,
    point_m: Vector3<f64>,
}

/// Torques of about 100 Nm weigh like rows of about 1.
const TORQUE_SCALE_1_NM2: f64 = 1e-4;

impl Task for Hold<'_> {
    type Part = ();

    fn variables(&self) -> usize {
        6
    }
    fn numbers(&self) -> (usize, usize) {
        (3, 12)
    }
    fn angles(&self) -> Range<usize> {
        0..6
    }
    fn is_motion(&self, _: &Row) -> bool {
        true
    }
    fn rows<S: Sink>(&self, x: &Row, sink: &mut S) {
        let (q, rest) = (JointVec::from_slice(&x[..6]), JointVec::zeros(6));
        let gravity = self.arm.inverse_dynamics_gradient(&q, &rest, &rest);
        let by_q = (0..6).fold(rest, |sum, i| sum + gravity.by_q.row(i) * gravity.tau[i])
            * (2.0 * TORQUE_SCALE_1_NM2);
        sink.objective(TORQUE_SCALE_1_NM2 * gravity.tau.norm_squared(), |g| {
            (0..6).for_each(|k| g.add(k, by_q[k]));
        });
        let frames = self.arm.fk(&q);
        let ball_m = self.arm.ball(&frames).pos;
        let jacobian = frames.jacobian(&ball_m);
        for i in 0..3 {
            sink.eq(i, ball_m[i] - self.point_m[i], |g| (0..6).for_each(|k| g.add(k, jacobian[(i, k)])));
        }
        for (j, joint) in self.arm.joints().iter().enumerate() {
            sink.ineq(2 * j, q[j] - joint.limits.q_min_rad, |g| g.add(j, 1.0));
            sink.ineq(2 * j + 1, joint.limits.q_max_rad - q[j], |g| g.add(j, -1.0));
        }
    }
    fn parts(&self) -> impl Iterator<Item = ((), When)> {
        std::iter::once(((), When::Always))
    }
    fn part_rows<S: Sink>(&self, (): (), x: &Row, sink: &mut S) {
        self.rows(x, sink);
    }
    fn bends(&self, (): (), _: usize) -> bool {
        true
    }
    fn twice(&self, (): (), _: usize) -> bool {
        true
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arm = RobotModel::load("powercube6")?;
    let start = [0.3, -1.2, -1.2, 0.2, 0.5, 0.1];
    let point_m = arm.ball(&arm.fk(&JointVec::from(start))).pos;
    let mut x = [0.0; WIDTH];
    x[..6].copy_from_slice(&start);
    let found = solve(&Hold { arm: &arm, point_m }, &x, &Settings::default(), None);

    // The same by the robot model alone: position of the ball, and torques of gravity.
    let q = JointVec::from_slice(&found.x[..6]);
    let off_m = (arm.ball(&arm.fk(&q)).pos - point_m).norm();
    let torque = |q: &JointVec| arm.gravity_torques(q).norm();
    let (before_nm, after_nm) = (torque(&JointVec::from(start)), torque(&q));
    println!(
        "{:?} after {} steps: {before_nm:.1} Nm before, {after_nm:.1} Nm now, {off_m:.1e} m off",
        found.ended, found.iterations
    );
    let in_range = arm
        .joints()
        .iter()
        .zip(q.iter())
        .all(|(joint, q)| *q >= joint.limits.q_min_rad - 1e-6 && *q <= joint.limits.q_max_rad + 1e-6);
    if found.ended == Ended::Converged && off_m < 1e-6 && in_range && after_nm < 0.9 * before_nm {
        return Ok(());
    }
    Err("the posture does not hold the point with less torque".into())
}
