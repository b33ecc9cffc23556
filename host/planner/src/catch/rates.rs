//! Joint rates that move the hand with the ball.

use nalgebra::{Matrix3, Vector3};

use super::Joints;
use super::arm::CatchArm;
use crate::motion_law::Limits;

/// Joints that are set to a bound at most: of the five that move the middle of the mouth three others give it its velocity.
const AT_BOUND_MAX: usize = 2;
/// Near a singularity the rates miss the velocity asked for by more than this, m/s.
const MISSED_M_S: f64 = 1e-9;
/// Rates stay this share below the bound that a stop inside the range sets.
const STOP_SHARE: f64 = 0.999;

/// Rates that a joint may have at `q`, rad/s: inside its speed limit, and so that it can stop inside its range.
fn bounds(limits: &Limits, jerk: bool, q: f64) -> (f64, f64) {
    let bound = |room: f64| (STOP_SHARE * fastest_with_stop(limits, jerk, room.max(0.0))).min(limits.v_rad_s);
    (-bound(q - limits.q_rad.0), bound(limits.q_rad.1 - q))
}

/// Largest speed from which a joint stops within `room_rad`: v²/2a = room. With a limit of jerk the way v²/2a + va/2j is taken; it is
/// exact where the acceleration limit is reached, and longer than the real one below.
fn fastest_with_stop(limits: &Limits, jerk: bool, room_rad: f64) -> f64 {
    let a = limits.a_rad_s2;
    let lost = if jerk { 0.5 * a * a / limits.j_rad_s3 } else { 0.0 };
    (lost * lost + 2.0 * a * room_rad).sqrt() - lost
}

/// The hand at one posture, and what its joints may do there.
pub struct Hand<'a> {
    limits: &'a [Limits; 6],
    /// Rotation from the base to the world.
    r_wb: Matrix3<f64>,
    /// Velocity of the middle of the mouth per rate of each joint, in the base frame, m.
    columns: [Vector3<f64>; 6],
    bounds: [(f64, f64); 6],
}

impl<'a> Hand<'a> {
    /// The hand at `q` (rad).
    #[must_use]
    pub fn at(arm: &CatchArm, limits: &'a [Limits; 6], q: &Joints) -> Self {
        let frames = arm.model.fk(q);
        let x_be = arm.model.ee(&frames);
        let p = x_be.pos + x_be.rot.column(2) * arm.cup.mouth_m;
        let jerk = arm.law.limits_jerk();
        Self {
            limits,
            r_wb: arm.x_wb.rot,
            columns: std::array::from_fn(|i| frames.axis(i).cross(&(p - frames.origin(i)))),
            bounds: std::array::from_fn(|i| bounds(&limits[i], jerk, q[i])),
        }
    }

    /// Acceleration of the middle of the mouth while joints with these rates stop, mean over `over_s`, in the world, m/s².
    pub(super) fn stop_m_s2(&self, qd: &Joints, over_s: f64) -> Vector3<f64> {
        let slower = |i: usize| -qd[i].signum() * qd[i].abs().min(self.limits[i].a_rad_s2 * over_s);
        let change: Vector3<f64> = (0..6).map(|i| self.columns[i] * slower(i)).sum();
        self.r_wb * change / over_s
    }

    /// Joint rates that move the middle of the mouth with `v_m_s` (world) and use the speed limits least: min sum (qd_j / v_j)². All of
    /// them keep the speed limits and leave room to stop inside the ranges: a joint that would pass a bound is set to it, the worst one
    /// first, and the others take over what it leaves. `None` if no rates are found this way, or near a singularity.
    #[must_use]
    pub fn rates(&self, v_m_s: &Vector3<f64>) -> Option<Joints> {
        let mut left = self.r_wb.tr_mul(v_m_s);
        let mut rates = Joints::zeros(6);
        let mut free = [true; 6];
        for _ in 0..=AT_BOUND_MAX {
            let mut m = Matrix3::zeros();
            for i in (0..6).filter(|i| free[*i]) {
                let column = self.columns[i] * self.limits[i].v_rad_s;
                m += column * column.transpose();
            }
            let lambda = m.cholesky()?.solve(&left);
            let mut missed = left;
            let mut worst: Option<(f64, usize)> = None;
            for i in (0..6).filter(|i| free[*i]) {
                let v_rad_s = self.limits[i].v_rad_s;
                rates[i] = self.columns[i].dot(&lambda) * v_rad_s * v_rad_s;
                missed -= self.columns[i] * rates[i];
                let (low, high) = self.bounds[i];
                let over = (rates[i] - high).max(low - rates[i]) / v_rad_s;
                if over > 0.0 && worst.is_none_or(|(most, _)| over > most) {
                    worst = Some((over, i));
                }
            }
            if missed.norm() > MISSED_M_S {
                return None;
            }
            let Some((_, i)) = worst else { return Some(rates) };
            rates[i] = rates[i].clamp(self.bounds[i].0, self.bounds[i].1);
            left -= self.columns[i] * rates[i];
            free[i] = false;
        }
        None
    }
}
