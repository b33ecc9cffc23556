//! Where an assumed ball is held, and which way it leaves.

use nalgebra::{Matrix3, Vector3};

use super::parts::{Axis, BALL_RADIUS_M};
use crate::boxes::Obb;
use crate::pose::Pose;

/// Room between the ball and what is bolted to the last joint, m.
const ROOM_M: f64 = 0.01;
/// Step of the search, m.
const STEP_M: f64 = 0.005;
/// A ball this far out is held by no hand.
const FAR_M: f64 = 1.0;

/// Release frame in the end effector's frame: x along the tool, z across it along the throw.
///
/// The tool points along the last axis, away from its carrier; if the hand lies across that axis, towards the hand.
/// The ball is held on it, as near as the boxes behind the last joint allow.
pub(super) fn release_frame(axes: &[Axis], end_effector: &Pose) -> Option<Pose> {
    let (last, before) = axes.split_last()?;
    let boxes: Vec<Obb> = last.body.boxes.iter().map(|(_, x, half)| Obb::new(*x, *half)).collect();
    let middle = |boxes: &[(String, Pose, Vector3<f64>)]| {
        boxes.iter().map(|(_, x, _)| x.pos).sum::<Vector3<f64>>() / boxes.len().max(1) as f64
    };
    let carries = before.last().map_or_else(Vector3::zeros, |axis| middle(&axis.body.boxes));
    let away = middle(&last.body.boxes) - last.origin.inverse_transform_point(&carries);
    let out = if end_effector.pos.norm() > 1e-3 { end_effector.pos } else { away };
    let axis = last.turn.axis;
    let share = if out.norm() > 1e-3 { out.dot(&axis) / out.norm() } else { 1.0 };
    let tool = if share.abs() >= 0.5 { axis * share.signum() } else { nearest_axis(&end_effector.rot, &out) };
    let free = |d: f64| {
        let ball = end_effector.pos + tool * d;
        boxes.iter().all(|b| b.proximity_to_sphere(&ball, BALL_RADIUS_M).distance_m >= ROOM_M)
    };
    let steps = (FAR_M / STEP_M) as usize;
    // From far away inwards: in front of the hand, not in a gap behind it.
    let places = (0..=steps).rev().map(|k| k as f64 * STEP_M);
    let away_m = places.take_while(|d| free(*d)).last().filter(|_| !boxes.is_empty()).unwrap_or(0.0);
    let tool_e = end_effector.rot.tr_mul(&tool);
    let across = end_effector.rot.tr_mul(&axis.cross(&tool));
    let hint = Vector3::from_fn(|k, _| f64::from(u8::from(k == tool_e.iamin())));
    let z = across.try_normalize(0.1).unwrap_or_else(|| (hint - tool_e * hint.dot(&tool_e)).normalize());
    let rot = Matrix3::from_columns(&[tool_e, z.cross(&tool_e), z]);
    Some(Pose::new(rot.map(cleaned), tool_e.map(|v| cleaned(v * away_m))))
}

/// The axis of a frame, with its sign, that lies nearest to a direction.
fn nearest_axis(rot: &Matrix3<f64>, direction: &Vector3<f64>) -> Vector3<f64> {
    let local = rot.tr_mul(direction);
    let k = local.iamax();
    rot.column(k) * local[k].signum()
}

/// A component without the rounding error of a quarter turn.
fn cleaned(v: f64) -> f64 {
    let near = (v * 1e3).round() / 1e3;
    if (v - near).abs() < 1e-9 { near } else { v }
}
