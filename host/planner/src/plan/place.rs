//! Stored throws turned to a target, and throws turned back to be stored.
//!
//! Turning about the base axis changes only the angle of joint 1, so a throw is stored in the frame in which its
//! target is on the x axis. It serves every azimuth at which joint 1 keeps its range.

use std::f64::consts::{PI, TAU};

use robot_model::jacobian::joint_rates;

use super::local::Found;
use super::planner::{Planner, kind_of};
use crate::store::Record;
use crate::throw::Throw;

impl Planner<'_, '_> {
    /// A stored throw turned to this target; mirrored or in another posture if joint 1 does not reach otherwise.
    pub(super) fn place(&self, stored: &Throw) -> Option<Throw> {
        let mut turned = self.turned(stored);
        if self.fits(&turned) {
            return Some(turned);
        }
        if let Some(signs) = self.mirror {
            let mut mirrored = *stored;
            for (j, sign) in signs.iter().enumerate() {
                mirrored.q_rad[j] *= sign;
                mirrored.qd_rad_s[j] *= sign;
                mirrored.qdd_rad_s2[j] *= sign;
            }
            let mirrored = self.turned(&mirrored);
            if self.fits(&mirrored) {
                return Some(mirrored);
            }
            if let Some(other) = self.other_posture(&mirrored) {
                return Some(other);
            }
        }
        if let Some(other) = self.other_posture(&turned) {
            return Some(other);
        }
        // The solver may still bend it into the range.
        turned.q_rad[0] = turned.q_rad[0].clamp(self.problem.limits.q_min[0], self.problem.limits.q_max[0]);
        Some(turned)
    }

    fn turned(&self, stored: &Throw) -> Throw {
        let mut throw = *stored;
        let l = &self.problem.limits;
        let axis_up = self.problem.arm.joints()[0].x_pj.rot[(2, 2)].signum();
        let middle = 0.5 * (l.q_min[0] + l.q_max[0]);
        let q = throw.q_rad[0] + axis_up * self.azimuth_rad;
        throw.q_rad[0] = q - TAU * ((q - middle) / TAU).round();
        throw
    }

    fn fits(&self, throw: &Throw) -> bool {
        let l = &self.problem.limits;
        let inside = |q: f64| q >= l.q_min[0] - 1e-3 && q <= l.q_max[0] + 1e-3;
        inside(throw.start()[0]) && inside(throw.stop()[0])
    }

    /// The same release in another posture of the arm that keeps the ranges.
    fn other_posture(&self, throw: &Throw) -> Option<Throw> {
        let arm = self.problem.arm;
        let frames = arm.fk(&throw.q_rad);
        let jac = frames.jacobian(&arm.ball(&frames).pos);
        let twist = jac * throw.qd_rad_s;
        let acceleration = jac * throw.qdd_rad_s2 + frames.bias_acceleration(&jac, &throw.qd_rad_s);
        let solutions = arm.ik(&arm.ee(&frames)).ok()?;
        solutions.in_range().find_map(|s| {
            let frames = arm.fk(&s.q);
            let jac = frames.jacobian(&arm.ball(&frames).pos);
            let qd = joint_rates(&jac, &twist)?;
            let mut other = Throw { q_rad: s.q, qd_rad_s: qd, ..*throw };
            if self.problem.options.null_delay {
                let bias = frames.bias_acceleration(&jac, &qd);
                other.qdd_rad_s2 = joint_rates(&jac, &(acceleration - bias))?;
            }
            let l = &self.problem.limits;
            let (start, stop) = (other.start(), other.stop());
            (0..start.len())
                .all(|j| {
                    start[j].min(stop[j]) >= l.q_min[j] - 1e-3 && start[j].max(stop[j]) <= l.q_max[j] + 1e-3
                })
                .then_some(other)
        })
    }

    /// The throw as a record of the store.
    #[must_use]
    pub fn record(&self, found: &Found) -> Record {
        let axis_up = self.problem.arm.joints()[0].x_pj.rot[(2, 2)].signum();
        let mut throw = found.throw;
        let q = throw.q_rad[0] - axis_up * self.azimuth_rad;
        throw.q_rad[0] = if q > PI {
            q - TAU
        } else if q < -PI {
            q + TAU
        } else {
            q
        };
        Record {
            kind: kind_of(&self.problem.options),
            range_m: self.range_m,
            height_m: self.problem.target.z,
            objective: found.objective,
            slope_per_m: [
                found.slope_per_m.x * self.azimuth_rad.cos() + found.slope_per_m.y * self.azimuth_rad.sin(),
                found.slope_per_m.z,
            ],
            touches: found.touches,
            throw,
        }
    }
}
