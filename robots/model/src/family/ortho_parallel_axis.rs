//! Ortho-parallel arms: inverse kinematics of a point and a direction, the roll about the direction left free.
//!
//! This fixes five joints; the last one only rolls. A window of angles per joint ends a branch as early as
//! possible, so that many poses can be tried in little time.

use nalgebra::Vector3;

use super::ortho_parallel::OrthoParallel;
use super::planar::{Complex, ON_AXIS, TwoLinks};
use crate::ik_solution::Branch;
use crate::mat3;

/// A wrist with a smaller sine of its middle angle is straight: joint 4 is not determined.
const STRAIGHT_WRIST: f64 = 1e-9;

/// The angle moved by whole turns into `[low, high]`, the lowest of them; `None` if there is no such angle.
#[inline]
fn turned_into(q: f64, low: f64, high: f64) -> Option<f64> {
    use std::f64::consts::TAU;
    let moved = q + TAU * ((low - q) / TAU).ceil();
    (moved <= high).then_some(moved)
}

impl OrthoParallel {
    /// Calls `found` with joints 1 to 5 of each posture whose wrist centre is `centre` and whose last axis is `axis`, with each
    /// angle in `[low, high]`.
    pub(crate) fn solve_axis(
        &self,
        centre: &Vector3<f64>,
        axis: &Vector3<f64>,
        low: &[f64],
        high: &[f64],
        found: &mut impl FnMut(Branch, [f64; 5]),
    ) {
        let reach = self.c2_m + self.k_m;
        let across = Complex::new(centre.x, centre.y);
        let across2 = across.re * across.re + across.im * across.im;
        let radial2 = across2 - self.b_m * self.b_m;
        // False for NaN, too.
        let usable = radial2 >= 0.0 && across2.sqrt() > ON_AXIS * reach;
        if !usable {
            return;
        }
        let radial = radial2.sqrt();
        let links = TwoLinks { upper_m: self.c2_m, fore_m: self.k_m };
        for (back, radial) in [(false, radial), (true, -radial)] {
            let target = Complex::new(centre.z - self.c1_m, radial - self.a1_m);
            if links.margin_m(target) < 0.0 {
                continue;
            }
            let turn1 = across.times(Complex::new(radial, -self.b_m)).unit(across2);
            let Some(q1) = turned_into(turn1.angle(), low[0], high[0]) else { continue };
            let Some(bends) = links.bends(target, 0.0) else { continue };
            let side1 = Vector3::new(
                axis.x * turn1.re + axis.y * turn1.im,
                axis.y * turn1.re - axis.x * turn1.im,
                axis.z,
            );
            for (bend, negative) in bends.into_iter().zip([false, true]) {
                let q2 = self.sign2 * (bend.upper.angle() - self.upper_arm_zero_rad);
                let Some(q2) = turned_into(q2, low[1], high[1]) else { continue };
                let q3 = self.sign3 * (bend.elbow_rad - self.forearm_zero_rad + self.upper_arm_zero_rad);
                let Some(q3) = turned_into(q3, low[2], high[2]) else { continue };
                let pitch = bend.upper.times(bend.elbow).times(self.forearm_zero.conj());
                let turned = Vector3::new(
                    side1.x * pitch.re - side1.z * pitch.im,
                    side1.y,
                    side1.x * pitch.im + side1.z * pitch.re,
                );
                let m = mat3::tr_mul_v(&self.r_f4_zero, &turned);
                let sin_v = m.x.hypot(m.y);
                if sin_v <= STRAIGHT_WRIST {
                    continue;
                }
                let (u, v) = (m.y.atan2(m.x), sin_v.atan2(m.z));
                for (flipped, u, v) in [(false, u, v), (true, u + std::f64::consts::PI, -v)] {
                    let q4 = turned_into(u - self.wrist_zero4_rad, low[3], high[3]);
                    let q5 = turned_into(-v - self.wrist_zero5_rad, low[4], high[4]);
                    if let (Some(q4), Some(q5)) = (q4, q5) {
                        found(Branch::new(back, negative, flipped), [q1, q2, q3, q4, q5]);
                    }
                }
            }
        }
    }
}
