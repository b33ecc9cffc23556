//! The cubics between the knots of a plan file, by the basis functions of Hermite: not the evaluator of [`crate::motion`].

pub use crate::motion::Sample;
use crate::plan::file::{KnotInfo, PlanFile};
use robot_model::JointVec;

/// Basis functions of `(q₀, h q̇₀, q₁, h q̇₁)` at `s` in 0..=1, and their three derivatives by `s`.
fn basis(s: f64) -> [[f64; 4]; 4] {
    let (s2, s3) = (s * s, s * s * s);
    [
        [2.0 * s3 - 3.0 * s2 + 1.0, s3 - 2.0 * s2 + s, 3.0 * s2 - 2.0 * s3, s3 - s2],
        [6.0 * s2 - 6.0 * s, 3.0 * s2 - 4.0 * s + 1.0, 6.0 * s - 6.0 * s2, 3.0 * s2 - 2.0 * s],
        [12.0 * s - 6.0, 6.0 * s - 4.0, 6.0 - 12.0 * s, 6.0 * s - 2.0],
        [12.0, 6.0, -12.0, 6.0],
    ]
}

/// Value and three derivatives by time of joint `j` between two knots.
fn cubic(a: &KnotInfo, b: &KnotInfo, j: usize, t_s: f64) -> [f64; 4] {
    let h = b.t_s - a.t_s;
    let of = |list: &[f64]| list.get(j).copied().unwrap_or(f64::NAN);
    let ends = [of(&a.q_rad), h * of(&a.qd_rad_s), of(&b.q_rad), h * of(&b.qd_rad_s)];
    let mut scale = 1.0;
    basis((t_s - a.t_s) / h).map(|weights| {
        let value: f64 = weights.iter().zip(ends).map(|(w, end)| w * end).sum();
        let by_time = value / scale;
        scale *= h;
        by_time
    })
}

/// The plan at `t_s`; at the joint of two segments the earlier one; held before and after.
#[must_use]
pub fn at(plan: &PlanFile, t_s: f64) -> Sample {
    let zero = JointVec::zeros(plan.motion.joints.len());
    let mut out = Sample { q: zero, qd: zero, qdd: zero, jerk: zero };
    let outside = t_s < 0.0 || t_s > plan.end_time_s;
    let t = t_s.clamp(0.0, plan.end_time_s);
    let pieces = plan.motion.knots.windows(2);
    let Some([a, b]) = pieces.clone().find(|pair| t <= pair[1].t_s).or(pieces.last()) else { return out };
    for j in 0..zero.len() {
        let [q, qd, qdd, jerk] = cubic(a, b, j, t);
        out.q[j] = q;
        if !outside {
            (out.qd[j], out.qdd[j], out.jerk[j]) = (qd, qdd, jerk);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_found_again_from_its_ends_with_three_derivatives() {
        // 2t³ - 3t² + 5t - 7 from 1 to 3 s.
        let value = |t: f64| ((2.0 * t - 3.0) * t + 5.0) * t - 7.0;
        let rate = |t: f64| (6.0 * t - 6.0) * t + 5.0;
        let knot = |t_s| KnotInfo { t_s, q_rad: vec![value(t_s)], qd_rad_s: vec![rate(t_s)] };
        for t in [1.0, 1.7, 2.0, 3.0] {
            let got = cubic(&knot(1.0), &knot(3.0), 0, t);
            let wanted = [value(t), rate(t), 12.0 * t - 6.0, 12.0];
            assert!(got.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12), "{got:?} for {wanted:?}");
        }
    }
}
