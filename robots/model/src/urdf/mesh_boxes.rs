//! Boxes around the surface of a mesh: one, or two or three in a row where these are clearly smaller.

use nalgebra::{Matrix3, Vector3};

use super::mesh::Triangle;
use crate::pose::Pose;

/// Several boxes are used if their volume is below this share of the volume of fewer boxes.
const WORTH: f64 = 0.8;
/// Most boxes of a mesh.
const PARTS_MAX: usize = 3;
/// Step of centres and half sizes, m; half sizes are rounded up.
const STEP_M: f64 = 1e-4;
/// Step of angles in degrees.
const STEP_DEG: f64 = 0.1;

/// Pose and half sizes of a box, m.
type Around = (Pose, Vector3<f64>);

/// Pose and half sizes of boxes that hold every point of the surface; `None` without a surface.
pub(super) fn boxes_around(triangles: &[Triangle]) -> Option<Vec<Around>> {
    let rotations = [Matrix3::identity(), principal_axes(triangles)?];
    let mut best: Option<(f64, Vec<Around>)> = None;
    for rot in rotations {
        let turned: Vec<Triangle> = triangles.iter().map(|t| t.map(|corner| rot.tr_mul(&corner))).collect();
        for parts in 1..=PARTS_MAX {
            let found = in_a_row(&turned, &rot, parts)?;
            let volume = found.iter().map(|(_, half)| half.product()).sum::<f64>();
            let worth =
                |(least, of): &(f64, Vec<_>)| volume < if parts > of.len() { WORTH * least } else { *least };
            if best.as_ref().is_none_or(worth) {
                best = Some((volume, found));
            }
        }
    }
    best.map(|(_, boxes)| boxes)
}

/// `parts` boxes along the longest side, axes along those of `rot`; the triangles are given in it.
fn in_a_row(turned: &[Triangle], rot: &Matrix3<f64>, parts: usize) -> Option<Vec<Around>> {
    let (low, high) = extent(turned.iter().flatten().copied())?;
    let along = (high - low).imax();
    let length = (high - low)[along] / parts as f64;
    let mut out = Vec::new();
    for k in 0..parts {
        let from = low[along] + length * k as f64;
        let inside = turned.iter().flat_map(|t| clipped(t, along, from, from + length));
        let Some((low, high)) = extent(inside) else { continue };
        let centre = (rot * ((low + high) * 0.5)).map(|v| (v / STEP_M).round() * STEP_M);
        // The centre has moved by half a step at most; the sides move outwards by that much and one step more.
        let half = (high - low).map(|v| ((0.5 * v / STEP_M).ceil() + 1.0) * STEP_M);
        out.push((Pose::new(*rot, centre), half));
    }
    (!out.is_empty()).then_some(out)
}

/// Corners of the part of a triangle between two planes across an axis.
fn clipped(triangle: &Triangle, along: usize, from: f64, to: f64) -> Vec<Vector3<f64>> {
    let mut polygon = triangle.to_vec();
    for (sign, bound) in [(1.0, from), (-1.0, -to)] {
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for (k, a) in polygon.iter().enumerate() {
            let b = &polygon[(k + 1) % polygon.len()];
            let (beyond_a, beyond_b) = (sign * a[along] - bound, sign * b[along] - bound);
            if beyond_a >= 0.0 {
                kept.push(*a);
            }
            if (beyond_a >= 0.0) != (beyond_b >= 0.0) {
                kept.push(a + (b - a) * (beyond_a / (beyond_a - beyond_b)));
            }
        }
        polygon = kept;
    }
    polygon
}

fn extent(corners: impl Iterator<Item = Vector3<f64>>) -> Option<(Vector3<f64>, Vector3<f64>)> {
    corners.fold(None, |seen, c| {
        Some(seen.map_or((c, c), |(low, high): (Vector3<f64>, _)| (low.inf(&c), high.sup(&c))))
    })
}

/// Principal axes of the surface, its angles rounded; the axes of the link for a surface without area.
fn principal_axes(triangles: &[Triangle]) -> Option<Matrix3<f64>> {
    let (mut area, mut first, mut second) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for [a, b, c] in triangles {
        let (weight, centre) = ((b - a).cross(&(c - a)).norm(), (a + b + c) / 3.0);
        area += weight;
        first += centre * weight;
        second +=
            (a * a.transpose() + b * b.transpose() + c * c.transpose() + centre * centre.transpose() * 9.0)
                * (weight / 12.0);
    }
    if area <= 0.0 {
        return (!triangles.is_empty()).then(Matrix3::identity);
    }
    let centre = first / area;
    let eigen = (second / area - centre * centre.transpose()).symmetric_eigen();
    let mut rot = eigen.eigenvectors;
    if rot.determinant() < 0.0 {
        rot.column_mut(2).neg_mut();
    }
    let rpy = Pose::new(rot, Vector3::zeros()).rpy_rad();
    let rounded = rpy.map(|angle| ((angle.to_degrees() / STEP_DEG).round() * STEP_DEG).to_radians());
    Some(Pose::from_rpy(rounded, Vector3::zeros()).rot)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn corner() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-0.5..0.5).prop_map(Vector3::from)
    }

    /// Whether a box holds the point, up to rounding of numbers.
    fn held(boxes: &[(Pose, Vector3<f64>)], p: &Vector3<f64>) -> bool {
        boxes.iter().any(|(x, half)| {
            let local = x.inverse_transform_point(p);
            local.zip_map(half, |v, h| v.abs() - h).max() <= 1e-12
        })
    }

    /// A tube of `n` corners around, bent in the middle.
    fn elbow(n: usize, radius: f64, bend: f64) -> Vec<Triangle> {
        let ring = |k: usize| {
            let along = [0.0, 0.4, 0.8][k];
            let centre = Vector3::new(along, if k == 2 { bend } else { 0.0 }, 0.0);
            (0..n).map(move |i| {
                let angle = std::f64::consts::TAU * i as f64 / n as f64;
                centre + Vector3::new(0.0, angle.cos(), angle.sin()) * radius
            })
        };
        let rings: Vec<Vec<_>> = (0..3).map(|k| ring(k).collect()).collect();
        let mut out = Vec::new();
        for pair in rings.windows(2) {
            for i in 0..n {
                let j = (i + 1) % n;
                out.push([pair[0][i], pair[0][j], pair[1][j]]);
                out.push([pair[0][i], pair[1][j], pair[1][i]]);
            }
        }
        out
    }

    proptest! {
        #[test]
        fn every_point_of_the_surface_lies_in_a_box_and_the_boxes_are_no_larger_than_one_around_all(
            triangles in prop::collection::vec(prop::array::uniform3(corner()), 1..30),
            weights in prop::collection::vec((0.0..1.0_f64, 0.0..1.0_f64), 1..30),
        ) {
            let boxes = boxes_around(&triangles).unwrap();
            for triangle in &triangles {
                for corner in triangle {
                    prop_assert!(held(&boxes, corner), "{corner}");
                }
                for (s, t) in &weights {
                    let t = t * (1.0 - s);
                    let inner = triangle[0] * (1.0 - s - t) + triangle[1] * *s + triangle[2] * t;
                    prop_assert!(held(&boxes, &inner), "{inner}");
                }
            }
            let (low, high) = extent(triangles.iter().flatten().copied()).unwrap();
            let around = (high - low).add_scalar(4.0 * STEP_M).product();
            let volume: f64 = boxes.iter().map(|(_, half)| 8.0 * half.product()).sum();
            prop_assert!(volume <= around, "{volume} of {around}");
        }
    }

    #[test]
    fn a_turned_block_gets_a_box_of_its_size_and_an_elbow_gets_several() {
        let turn = Pose::from_rpy([0.3, 0.5, 0.7], Vector3::new(0.1, 0.2, 0.3));
        let block: Vec<Triangle> =
            elbow(4, 0.05, 0.0).iter().map(|t| t.map(|c| turn.transform_point(&c))).collect();
        let boxes = boxes_around(&block).unwrap();
        let volume: f64 = boxes.iter().map(|(_, half)| 8.0 * half.product()).sum();
        let own = 0.8 * 0.1 * 0.1 * 0.5;
        // A square on its corner: principal axes of a square are free, so up to twice its area.
        assert!(boxes.len() == 1 && volume < 2.1 * own, "{volume} of {own}");
        let bent = elbow(16, 0.04, 0.4);
        let boxes = boxes_around(&bent).unwrap();
        let volume: f64 = boxes.iter().map(|(_, half)| 8.0 * half.product()).sum();
        assert!(boxes.len() > 1 && volume < 0.8 * 0.48 * 0.08, "{} boxes, {volume}", boxes.len());
    }
}
