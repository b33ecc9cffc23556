//! How far a point of a link can be from the axis of a joint before it.

use nalgebra::Vector3;

use crate::pose::Pose;

/// Largest distance from the axis of joint `k` at which a point fixed to link `i` (both from 0) can be, for any
/// angles of the joints between; zero for `k > i`.
///
/// The point moves on circles about the axes from `i` down to `k + 1`; each joint adds at most the way to the next
/// origin. About its own axis the distance is exact.
pub(super) fn swing(x_pj: &[Pose], k: usize, i: usize, point: &Vector3<f64>) -> f64 {
    if k > i {
        return 0.0;
    }
    // Cylinder coordinates of the point about the axis of the current joint: the radius and the height along the
    // axis do not change; only the place on the circle does.
    let mut radius = point.x.hypot(point.y);
    let mut height = (point.z, point.z);
    for joint in (k + 1..=i).rev() {
        (radius, height) = carried(&x_pj[joint], radius, height);
    }
    radius
}

/// Bounds of radius and height in the parent's frame for all discs of a child: centre on the child's axis between the
/// given heights, across it with the given radius.
fn carried(x_pj: &Pose, radius: f64, (low, high): (f64, f64)) -> (f64, (f64, f64)) {
    let z: Vector3<f64> = x_pj.rot.column(2).into();
    let tilt = z.x.hypot(z.y);
    let mut out_radius = 0.0_f64;
    let mut out = (f64::INFINITY, f64::NEG_INFINITY);
    // Distance from the parent's axis is convex along the child's axis: the ends are enough.
    for h in [low, high] {
        let centre = x_pj.pos + z * h;
        let reach = if tilt > 1e-9 {
            // Seen along the parent's axis the disc is an ellipse: `radius` across the tilt, shortened along it.
            let along = (centre.x * z.x + centre.y * z.y) / tilt;
            let across = (centre.y * z.x - centre.x * z.y) / tilt;
            (along.abs() + radius * z.z.abs()).hypot(across.abs() + radius)
        } else {
            centre.x.hypot(centre.y) + radius
        };
        out_radius = out_radius.max(reach);
        out = (out.0.min(centre.z - tilt * radius), out.1.max(centre.z + tilt * radius));
    }
    (out_radius, out)
}
