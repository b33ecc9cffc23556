//! Points that have their times: the cubic spline through them, with the speeds that are given or those that make the acceleration
//! continuous.

use robot_model::JOINTS_MAX;

use super::{At, Limits, Row8, motion_of, padded};
use crate::motion::Motion;

/// Share above a limit that counts as rounding of the numbers in a file.
const ROUNDING: f64 = 1.001;

/// A point with its time.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// s since the start.
    pub t_s: f64,
    /// rad.
    pub q_rad: Vec<f64>,
    /// rad/s, where given.
    pub qd_rad_s: Option<Vec<f64>>,
}

/// Rows make no motion within the limits. Joints and rows count from 0 here and from 1 in the text.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GivenError {
    #[error("{rows} points make no motion; it takes 2")]
    TooFew { rows: usize },
    #[error("point {}: {found} angles, the arm has {wanted} joints", .row + 1)]
    Joints { row: usize, found: usize, wanted: usize },
    #[error("point {}: a number is not finite", .row + 1)]
    NotFinite { row: usize },
    #[error("point {}: its time {t_s} s is not after that of the point before, {before_s} s", .row + 1)]
    Order { row: usize, t_s: f64, before_s: f64 },
    #[error("joint {}: {what} {value:.4} {unit} at {t_s:.3} s exceeds the limit {limit:.4} {unit}", .joint + 1)]
    Limit { joint: usize, t_s: f64, what: &'static str, value: f64, limit: f64, unit: &'static str },
    #[error("joint {}: the motion must begin and end at rest, its speed is {value:.4} rad/s at {t_s:.3} s", .joint + 1)]
    NotAtRest { joint: usize, t_s: f64, value: f64 },
}

/// The motion through `rows`, at the times they give, counted from the first.
///
/// Speeds are as given, or those of the cubic spline that rests at both ends and has continuous accelerations. Speed,
/// acceleration and jerk of each cubic are checked against `limits`.
///
/// # Errors
/// [`GivenError`] with joint, time, value and limit.
pub fn motion_of_rows(rows: &[Row], limits: &Limits) -> Result<Motion, GivenError> {
    let n = limits.n;
    if rows.len() < 2 {
        return Err(GivenError::TooFew { rows: rows.len() });
    }
    let begin_s = rows[0].t_s;
    for (i, row) in rows.iter().enumerate() {
        for length in [Some(row.q_rad.len()), row.qd_rad_s.as_ref().map(Vec::len)].into_iter().flatten() {
            if length != n {
                return Err(GivenError::Joints { row: i, found: length, wanted: n });
            }
        }
        let speeds = row.qd_rad_s.iter().flatten();
        if !row.t_s.is_finite() || !row.q_rad.iter().chain(speeds).all(|x| x.is_finite()) {
            return Err(GivenError::NotFinite { row: i });
        }
        if i > 0 && row.t_s <= rows[i - 1].t_s {
            return Err(GivenError::Order { row: i, t_s: row.t_s, before_s: rows[i - 1].t_s });
        }
    }
    let mut knots: Vec<At> = rows
        .iter()
        .map(|row| At { t_s: row.t_s - begin_s, q: padded(&row.q_rad), qd: [0.0; JOINTS_MAX] })
        .collect();
    let speeds: Option<Vec<Row8>> = rows.iter().map(|row| row.qd_rad_s.as_deref().map(padded)).collect();
    match speeds {
        Some(speeds) => knots.iter_mut().zip(speeds).for_each(|(knot, qd)| knot.qd = qd),
        None => smooth(&mut knots, n),
    }
    require_limits(&knots, limits)?;
    Ok(motion_of(&knots, limits.n))
}

/// Speeds of the spline with continuous acceleration: `v₋/h₋ + 2 v (1/h₋ + 1/h₊) + v₊/h₊ = 3 (Δ₋/h₋² + Δ₊/h₊²)` at each inner knot.
pub(super) fn smooth(knots: &mut [At], n: usize) {
    let inner = knots.len() - 2;
    for k in 0..n {
        // Thomas algorithm; the matrix is diagonally dominant.
        let (mut upper, mut right) = (vec![0.0; inner + 1], vec![0.0; inner + 1]);
        for i in 1..=inner {
            let (before, at, after) = (&knots[i - 1], &knots[i], &knots[i + 1]);
            let (h0, h1) = (at.t_s - before.t_s, after.t_s - at.t_s);
            let wanted = 3.0 * ((at.q[k] - before.q[k]) / (h0 * h0) + (after.q[k] - at.q[k]) / (h1 * h1));
            let pivot = 2.0 * (1.0 / h0 + 1.0 / h1) - upper[i - 1] / h0;
            upper[i] = 1.0 / h1 / pivot;
            right[i] = (wanted - right[i - 1] / h0) / pivot;
        }
        let mut next = 0.0;
        for i in (1..=inner).rev() {
            next = right[i] - upper[i] * next;
            knots[i].qd[k] = next;
        }
    }
}

fn require_limits(knots: &[At], limits: &Limits) -> Result<(), GivenError> {
    for knot in [&knots[0], &knots[knots.len() - 1]] {
        if let Some(joint) = (0..limits.n).find(|k| knot.qd[*k].abs() > 1e-3) {
            return Err(GivenError::NotAtRest { joint, t_s: knot.t_s, value: knot.qd[joint] });
        }
    }
    for pair in knots.windows(2) {
        let h = pair[1].t_s - pair[0].t_s;
        for joint in 0..limits.n {
            let way = pair[1].q[joint] - pair[0].q[joint];
            let (v0, v1) = (pair[0].qd[joint], pair[1].qd[joint]);
            let a0 = (6.0 * way / h - 4.0 * v0 - 2.0 * v1) / h;
            let a1 = (-6.0 * way / h + 2.0 * v0 + 4.0 * v1) / h;
            let jerk = (a1 - a0) / h;
            let turn_s = if a0 * a1 < 0.0 { -a0 / jerk } else { 0.0 };
            let v_turn = v0 + turn_s * (a0 + 0.5 * jerk * turn_s);
            let found = [
                (0.0, "speed", v0, limits.v[joint], "rad/s"),
                (turn_s, "speed", v_turn, limits.v[joint], "rad/s"),
                (h, "speed", v1, limits.v[joint], "rad/s"),
                (0.0, "acceleration", a0, limits.a[joint], "rad/s²"),
                (h, "acceleration", a1, limits.a[joint], "rad/s²"),
                (0.0, "jerk", jerk, limits.j[joint], "rad/s³"),
            ];
            let over = found.into_iter().find(|(_, _, value, limit, _)| value.abs() > limit * ROUNDING);
            if let Some((after_s, what, value, limit, unit)) = over {
                return Err(GivenError::Limit {
                    joint,
                    t_s: pair[0].t_s + after_s,
                    what,
                    value,
                    limit,
                    unit,
                });
            }
        }
    }
    Ok(())
}
