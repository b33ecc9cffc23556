//! The polynomials of a plan file.

use crate::plan::file::PlanFile;
use crate::throw::JOINTS;
use robot_model::JointVec;

/// Position, speed, acceleration and jerk of all joints at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample<const N: usize = JOINTS> {
    /// rad.
    pub q: JointVec<N>,
    /// rad/s.
    pub qd: JointVec<N>,
    /// rad/s².
    pub qdd: JointVec<N>,
    /// rad/s³.
    pub jerk: JointVec<N>,
}

/// Value and derivatives of a polynomial, highest power first, by Horner's rule.
fn horner(coefficients: &[f64], t: f64) -> [f64; 4] {
    let mut d = [0.0; 4];
    for c in coefficients {
        d[3] = d[3] * t + d[2];
        d[2] = d[2] * t + d[1];
        d[1] = d[1] * t + d[0];
        d[0] = d[0] * t + c;
    }
    [d[0], d[1], 2.0 * d[2], 6.0 * d[3]]
}

/// The plan of an arm of six joints at `t_s`; see [`sample`].
#[must_use]
pub fn at(plan: &PlanFile, t_s: f64) -> Sample {
    sample(plan, t_s)
}

/// The plan at `t_s`; at the joint of two segments the earlier one; held before and after.
#[must_use]
pub fn sample<const N: usize>(plan: &PlanFile, t_s: f64) -> Sample<N> {
    let mut out = Sample {
        q: JointVec::zeros(),
        qd: JointVec::zeros(),
        qdd: JointVec::zeros(),
        jerk: JointVec::zeros(),
    };
    let outside = t_s < 0.0 || t_s > plan.end_time_s;
    let t = t_s.clamp(0.0, plan.end_time_s);
    for (j, joint) in plan.joints.iter().enumerate().take(N) {
        let segment = joint.segments.iter().find(|s| t <= s.t_end_s).or(joint.segments.last());
        if let Some(segment) = segment {
            let [q, qd, qdd, jerk] = horner(&segment.coefficients_rad, t);
            out.q[j] = q;
            if !outside {
                (out.qd[j], out.qdd[j], out.jerk[j]) = (qd, qdd, jerk);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn horner_gives_value_and_three_derivatives() {
        // 2t³ - 3t² + 5t - 7 at t = 2.
        assert_eq!(horner(&[2.0, -3.0, 5.0, -7.0], 2.0), [7.0, 17.0, 18.0, 12.0]);
        assert_eq!(horner(&[4.0], 2.0), [4.0, 0.0, 0.0, 0.0]);
    }
}
