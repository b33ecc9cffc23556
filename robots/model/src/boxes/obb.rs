//! Oriented boxes: overlap by separating axes, exact distance, distance to points.

use nalgebra::{Matrix3, Vector3};

use crate::mat3;
use crate::pose::Pose;

/// An oriented box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Obb {
    /// Centre and axes; the rotation's columns are the directions of the edges.
    pub pose: Pose,
    /// Half edge lengths in m, all positive.
    pub half_m: Vector3<f64>,
    radius_m: f64,
}

/// Nearest points of two bodies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proximity {
    /// Distance in m; for overlapping bodies minus the shortest translation that separates them.
    pub distance_m: f64,
    /// Unit direction from the first body to the second along which the distance is taken.
    pub normal: Vector3<f64>,
    /// Point of the second body that is nearest to the first (deepest in it, if they overlap).
    ///
    /// The distance changes at the rate `normal · (v_second − v_first)`, the velocities of both bodies taken here.
    pub point: Vector3<f64>,
}

/// One of the 15 axes that can separate two boxes.
#[derive(Debug, Clone, Copy)]
enum Axis {
    FaceA(usize),
    FaceB(usize),
    Edges(usize, usize),
}

/// Cross products of edges shorter than this come from parallel edges, whose axis the face normals already test.
const PARALLEL_EDGES: f64 = 1e-10;

impl Obb {
    /// Box from pose and half edge lengths in m.
    #[must_use]
    pub fn new(pose: Pose, half_m: Vector3<f64>) -> Self {
        Self { pose, half_m, radius_m: half_m.norm() }
    }

    /// Radius of the sphere about the centre that contains the box, in m.
    #[must_use]
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// Whether two boxes overlap or touch.
    ///
    /// Separating axis theorem (Gottschalk, Lin, Manocha 1996): 3 + 3 face normals and 9 cross products of edges.
    #[must_use]
    #[inline]
    pub fn overlaps(&self, other: &Self) -> bool {
        let between = other.pose.pos - self.pose.pos;
        let reach = self.radius_m + other.radius_m;
        if between.norm_squared() > reach * reach {
            return false;
        }
        // r[i][j]: axis j of the other box along axis i of this one; t: the other centre in this box.
        let r = mat3::tr_mul(&self.pose.rot, &other.pose.rot);
        let t = mat3::tr_mul_v(&self.pose.rot, &between);
        let (a, b) = (&self.half_m, &other.half_m);
        // Tolerance for parallel edges: their cross product is noise, and without the tolerance noise could "separate" boxes.
        let r_abs = r.map(|v| v.abs() + 1e-12);
        for i in 0..3 {
            if t[i].abs() > a[i] + r_abs[(i, 0)] * b.x + r_abs[(i, 1)] * b.y + r_abs[(i, 2)] * b.z {
                return false;
            }
        }
        for j in 0..3 {
            let along = t.x * r[(0, j)] + t.y * r[(1, j)] + t.z * r[(2, j)];
            if along.abs() > b[j] + r_abs[(0, j)] * a.x + r_abs[(1, j)] * a.y + r_abs[(2, j)] * a.z {
                return false;
            }
        }
        for i in 0..3 {
            let (i1, i2) = ((i + 1) % 3, (i + 2) % 3);
            for j in 0..3 {
                let (j1, j2) = ((j + 1) % 3, (j + 2) % 3);
                let along = t[i2] * r[(i1, j)] - t[i1] * r[(i2, j)];
                let reach_a = a[i1] * r_abs[(i2, j)] + a[i2] * r_abs[(i1, j)];
                let reach_b = b[j1] * r_abs[(i, j2)] + b[j2] * r_abs[(i, j1)];
                if along.abs() > reach_a + reach_b {
                    return false;
                }
            }
        }
        true
    }

    /// A lower bound of the distance of two boxes in m, exact where a face or two edges are nearest; for
    /// overlapping boxes minus the shortest translation that separates them.
    #[must_use]
    pub fn separation(&self, other: &Self) -> f64 {
        self.best_axis(other).0
    }

    /// The axis with the largest gap: gap in m, and which axis it is.
    #[inline]
    fn best_axis(&self, other: &Self) -> (f64, Axis) {
        let r = mat3::tr_mul(&self.pose.rot, &other.pose.rot);
        let t = mat3::tr_mul_v(&self.pose.rot, &(other.pose.pos - self.pose.pos));
        let (a, b) = (&self.half_m, &other.half_m);
        let r_abs = r.abs();
        let mut best = (f64::NEG_INFINITY, Axis::FaceA(0));
        let mut consider = |gap: f64, axis: Axis| {
            if gap > best.0 {
                best = (gap, axis);
            }
        };
        for i in 0..3 {
            let reach = a[i] + r_abs[(i, 0)] * b.x + r_abs[(i, 1)] * b.y + r_abs[(i, 2)] * b.z;
            consider(t[i].abs() - reach, Axis::FaceA(i));
        }
        for j in 0..3 {
            let along = t.x * r[(0, j)] + t.y * r[(1, j)] + t.z * r[(2, j)];
            let reach = b[j] + r_abs[(0, j)] * a.x + r_abs[(1, j)] * a.y + r_abs[(2, j)] * a.z;
            consider(along.abs() - reach, Axis::FaceB(j));
        }
        for i in 0..3 {
            let (i1, i2) = ((i + 1) % 3, (i + 2) % 3);
            for j in 0..3 {
                let (j1, j2) = ((j + 1) % 3, (j + 2) % 3);
                let length2 = r[(i1, j)] * r[(i1, j)] + r[(i2, j)] * r[(i2, j)];
                if length2 < PARALLEL_EDGES * PARALLEL_EDGES {
                    continue;
                }
                let along = t[i2] * r[(i1, j)] - t[i1] * r[(i2, j)];
                let reach_a = a[i1] * r_abs[(i2, j)] + a[i2] * r_abs[(i1, j)];
                let reach_b = b[j1] * r_abs[(i, j2)] + b[j2] * r_abs[(i, j1)];
                let gap = along.abs() - reach_a - reach_b;
                consider(gap / length2.sqrt(), Axis::Edges(i, j));
            }
        }
        best
    }

    /// Unit direction of a separating axis, from this box to the other.
    fn direction(&self, other: &Self, axis: Axis) -> Vector3<f64> {
        let direction = match axis {
            Axis::FaceA(i) => self.pose.rot.column(i).into_owned(),
            Axis::FaceB(j) => other.pose.rot.column(j).into_owned(),
            Axis::Edges(i, j) => self.pose.rot.column(i).cross(&other.pose.rot.column(j)).normalize(),
        };
        if direction.dot(&(other.pose.pos - self.pose.pos)) < 0.0 { -direction } else { direction }
    }

    /// The point of the box farthest along a direction.
    fn farthest(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        let d = mat3::tr_mul_v(&self.pose.rot, direction);
        self.pose.transform_point(&d.zip_map(&self.half_m, |d, h| if d < 0.0 { -h } else { h }))
    }

    /// Exact distance of two boxes.
    ///
    /// The nearest points of two convex polyhedra are either a corner of one and a point of the other, or inner
    /// points of two edges. The second case fixes the direction (the cross product of the edges) and with it
    /// the edges, so 16 corners and 9 pairs of edges cover all cases; no iteration, no tolerance to tune.
    #[must_use]
    pub fn proximity(&self, other: &Self) -> Proximity {
        let (gap, axis) = self.best_axis(other);
        let direction = self.direction(other, axis);
        if gap <= 0.0 {
            return Proximity { distance_m: gap, normal: direction, point: other.farthest(&-direction) };
        }
        let mut best = Nearest { squared: f64::INFINITY, on_a: Vector3::zeros(), on_b: Vector3::zeros() };
        for corner in other.corners() {
            if self.squared_distance(&corner) < best.squared {
                best.consider(self.nearest_point(&corner), corner);
            }
        }
        for corner in self.corners() {
            if other.squared_distance(&corner) < best.squared {
                best.consider(corner, other.nearest_point(&corner));
            }
        }
        for i in 0..3 {
            for j in 0..3 {
                if let Some((on_a, on_b)) = self.nearest_on_edges(i, other, j) {
                    best.consider(on_a, on_b);
                }
            }
        }
        let distance_m = best.squared.sqrt();
        // At distances of a few ulp the difference of the points is noise.
        let normal = (best.on_b - best.on_a).try_normalize(1e-12).unwrap_or(direction);
        Proximity { distance_m: distance_m.max(gap), normal, point: best.on_b }
    }

    fn squared_distance(&self, p: &Vector3<f64>) -> f64 {
        let local = self.pose.inverse_transform_point(p);
        let beyond = |v: f64, h: f64| (v.abs() - h).max(0.0);
        let (x, y, z) =
            (beyond(local.x, self.half_m.x), beyond(local.y, self.half_m.y), beyond(local.z, self.half_m.z));
        x * x + y * y + z * z
    }

    /// Nearest inner points of the facing edges with directions `i` here and `j` there, if they face each other.
    fn nearest_on_edges(&self, i: usize, other: &Self, j: usize) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let (u, v): (Vector3<f64>, Vector3<f64>) =
            (self.pose.rot.column(i).into(), other.pose.rot.column(j).into());
        let mut n = mat3::cross(&u, &v);
        let sine2 = n.norm_squared();
        if sine2 < PARALLEL_EDGES * PARALLEL_EDGES {
            return None;
        }
        if n.dot(&(other.pose.pos - self.pose.pos)) < 0.0 {
            n = -n;
        }
        let a = self.edge_middle(i, &n);
        let b = other.edge_middle(j, &-n);
        // Parameters of the nearest points of the lines a + s u and b + t v.
        let w = b - a;
        let (wu, wv, uv) = (w.dot(&u), w.dot(&v), u.dot(&v));
        let s = (wu - uv * wv) / sine2;
        let t = (uv * wu - wv) / sine2;
        (s.abs() <= self.half_m[i] && t.abs() <= other.half_m[j]).then(|| (a + u * s, b + v * t))
    }

    /// Middle of the edge with direction `i` that is farthest along `n`.
    fn edge_middle(&self, i: usize, n: &Vector3<f64>) -> Vector3<f64> {
        let d = mat3::tr_mul_v(&self.pose.rot, n);
        let mut local = d.zip_map(&self.half_m, |d, h| if d < 0.0 { -h } else { h });
        local[i] = 0.0;
        self.pose.transform_point(&local)
    }

    /// The eight corners.
    pub fn corners(&self) -> impl Iterator<Item = Vector3<f64>> + '_ {
        let edge = |k: usize| self.pose.rot.column(k) * self.half_m[k];
        let (x, y, z) = (edge(0), edge(1), edge(2));
        (0..8_u8).map(move |k| {
            let sign = |bit: u8| if k & bit == 0 { -1.0 } else { 1.0 };
            self.pose.pos + x * sign(1) + y * sign(2) + z * sign(4)
        })
    }

    /// The point of the box nearest to `p`; `p` itself if inside.
    #[must_use]
    pub fn nearest_point(&self, p: &Vector3<f64>) -> Vector3<f64> {
        let local = self.pose.inverse_transform_point(p);
        self.pose.transform_point(&local.zip_map(&self.half_m, |v, h| v.clamp(-h, h)))
    }

    /// Distance of a sphere, with its nearest point; overlapping is measured to the nearest face.
    #[must_use]
    pub fn proximity_to_sphere(&self, center: &Vector3<f64>, radius_m: f64) -> Proximity {
        let local = self.pose.inverse_transform_point(center);
        let beyond = local.abs() - self.half_m;
        let outside = beyond.map(|v| v.max(0.0));
        let mut away = outside;
        let mut distance_m = outside.norm();
        if distance_m == 0.0 {
            let face = beyond.imax();
            distance_m = beyond[face];
            away[face] = 1.0;
        }
        let normal = self.pose.rot * away.zip_map(&local, f64::copysign).normalize();
        Proximity { distance_m: distance_m - radius_m, normal, point: center - normal * radius_m }
    }

    /// Distance of the box from the half space below `floor_z_m`; the floor is the first body.
    #[must_use]
    pub fn proximity_to_floor(&self, floor_z_m: f64) -> Proximity {
        let point = self.farthest(&-Vector3::z());
        Proximity { distance_m: point.z - floor_z_m, normal: Vector3::z(), point }
    }
}

struct Nearest {
    squared: f64,
    on_a: Vector3<f64>,
    on_b: Vector3<f64>,
}

impl Nearest {
    fn consider(&mut self, on_a: Vector3<f64>, on_b: Vector3<f64>) {
        let squared = (on_b - on_a).norm_squared();
        if squared < self.squared {
            *self = Self { squared, on_a, on_b };
        }
    }
}

/// Box from the smallest and largest corner, axes along the world.
#[must_use]
pub fn aligned_box(min_m: Vector3<f64>, max_m: Vector3<f64>) -> Obb {
    Obb::new(Pose::new(Matrix3::identity(), (min_m + max_m) * 0.5), (max_m - min_m) * 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(x: f64, y: f64, z: f64, rpy: [f64; 3]) -> Obb {
        Obb::new(Pose::from_rpy(rpy, Vector3::new(x, y, z)), Vector3::repeat(0.5))
    }

    #[test]
    fn hand_worked_distances() {
        let quarter = std::f64::consts::FRAC_PI_4;
        let unit = cube(0.0, 0.0, 0.0, [0.0; 3]);
        let half_diagonal = 0.5_f64.sqrt();
        // (other box, distance)
        let table = [
            (cube(1.5, 0.0, 0.0, [0.0; 3]), 0.5),
            (cube(1.5, 0.9, 0.0, [0.0; 3]), 0.5),
            (cube(1.3, 1.4, 0.0, [0.0; 3]), 0.5),
            (cube(1.2, 1.6, 1.3, [0.0; 3]), 0.7),
            // An edge parallel to a face.
            (cube(1.5, 0.0, 0.0, [0.0, 0.0, quarter]), 1.0 - half_diagonal),
            (cube(0.9, 0.0, 0.0, [0.0; 3]), -0.1),
            (cube(0.3, 0.45, 0.1, [0.0; 3]), -0.55),
        ];
        for (k, (other, want)) in table.iter().enumerate() {
            let got = unit.proximity(other);
            assert!((got.distance_m - want).abs() < 1e-14, "case {k}: {} instead of {want}", got.distance_m);
            assert_eq!(unit.overlaps(other), *want <= 0.0, "case {k}");
            assert!((other.proximity(&unit).distance_m - want).abs() < 1e-14, "case {k} swapped");
        }
    }

    #[test]
    fn crossed_edges_are_nearest_at_inner_points() {
        // Two cubes standing on edges that cross at a right angle, 0.25 m apart.
        let quarter = std::f64::consts::FRAC_PI_4;
        let below = cube(0.0, 0.0, 0.0, [quarter, 0.0, 0.0]);
        let above = cube(0.1, -0.2, 2.0 * 0.5_f64.sqrt() + 0.25, [0.0, quarter, 0.0]);
        let near = below.proximity(&above);
        assert!((near.distance_m - 0.25).abs() < 1e-14, "{near:?}");
        assert!((near.normal - Vector3::z()).amax() < 1e-14);
        // The edge below runs along x at y = 0, the one above along y at x = 0.1.
        assert!((near.point - Vector3::new(0.1, 0.0, 0.5_f64.sqrt() + 0.25)).amax() < 1e-14, "{near:?}");
    }

    #[test]
    fn spheres_and_floor_have_signed_distances() {
        let b = cube(1.0, 0.0, 0.0, [0.3, -0.2, 0.9]);
        let deep = b.proximity_to_sphere(&b.pose.transform_point(&Vector3::new(0.1, -0.3, 0.2)), 0.05);
        assert!((deep.distance_m + 0.25).abs() < 1e-15);
        assert!((deep.normal + b.pose.rot.column(1)).amax() < 1e-15);
        let center = b.pose.transform_point(&Vector3::new(0.8, -0.9, 0.1));
        let outside = b.proximity_to_sphere(&center, 0.05);
        assert!((outside.distance_m - 0.45).abs() < 1e-15);
        assert!((outside.normal - b.pose.rot * Vector3::new(0.6, -0.8, 0.0)).amax() < 1e-15);
        assert!((outside.point - b.nearest_point(&center)).norm() - 0.45 < 1e-15);
        let lowest = b.corners().map(|c| c.z).fold(f64::INFINITY, f64::min);
        assert!((b.proximity_to_floor(-1.0).distance_m - (lowest + 1.0)).abs() < 1e-15);
    }
}
