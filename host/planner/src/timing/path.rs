//! Straight lines through points in joint space, with rounded corners, parameterised by length.
//!
//! A corner is rounded by turning the direction smoothly: on the piece from δ before the corner to δ after it,
//!
//! ```text
//! r'(σ) = u₁ (1 - h(σ)) + u₂ h(σ),   h(σ) = 3σ² - 2σ³,   σ from 0 to 1
//! ```
//!
//! so r is continuous up to its second derivative, ends on both lines, and is farthest from the corner in its middle, by
//! `3/16 δ |u₂ - u₁|`.

use robot_model::collision::Travel;
use robot_model::{JOINTS_MAX, JointVec};

use super::{Row8, padded};

/// Points nearer than this to the one before are one with it, rad.
const SAME_RAD: f64 = 1e-6;
/// Corners that turn less than this are no corners.
const STRAIGHT: f64 = 1e-9;

/// A path through points.
#[derive(Debug, Clone)]
pub struct Path {
    n: usize,
    pieces: Vec<Piece>,
    /// Lengths and places at which the path is at rest: both ends, and corners that are not rounded.
    rests: Vec<(f64, Row8)>,
    points: Vec<Row8>,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    pub(super) s0: f64,
    pub(super) s1: f64,
    shape: Shape,
}

#[derive(Debug, Clone, Copy)]
enum Shape {
    Line {
        from: Row8,
        u: Row8,
    },
    /// `corner`: which of the points it rounds.
    Corner {
        at: Row8,
        u1: Row8,
        u2: Row8,
        delta: f64,
        corner: usize,
    },
}

/// A place on a path, with the derivatives by its length.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    pub(super) q: Row8,
    pub(super) d1: Row8,
    pub(super) d2: Row8,
    pub(super) d3: Row8,
}

/// There is no path.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PathError {
    #[error("point {} has {found} angles, the first has {wanted}", .point + 1)]
    Length { point: usize, found: usize, wanted: usize },
    #[error("point {}: the angle of joint {} is not a number", .point + 1, .joint + 1)]
    NotFinite { point: usize, joint: usize },
    #[error("all {points} points are the same place")]
    NoWay { points: usize },
    #[error("an arm of {joints} joints is not supported; 1 to {JOINTS_MAX} are")]
    Joints { joints: usize },
}

impl Path {
    /// Path through `points` (angles in rad), which leaves a corner by at most `blend_rad` (Euclidean norm over the joints) to round
    /// it; with 0 it stops at each corner. The first and the last point are met exactly.
    ///
    /// # Errors
    /// [`PathError`].
    pub fn through<P: AsRef<[f64]>>(points: &[P], blend_rad: f64) -> Result<Self, PathError> {
        Self::rounding(points, &vec![blend_rad; points.len()])
    }

    /// As [`Path::through`], with a blend of its own for each point; those of the first and the last do not count.
    ///
    /// # Errors
    /// [`PathError`].
    pub fn rounding<P: AsRef<[f64]>>(points: &[P], blends_rad: &[f64]) -> Result<Self, PathError> {
        let n = points.first().map_or(0, |point| point.as_ref().len());
        if !(1..=JOINTS_MAX).contains(&n) {
            return Err(PathError::Joints { joints: n });
        }
        let mut kept: Vec<Row8> = Vec::with_capacity(points.len());
        let mut blends = Vec::with_capacity(points.len());
        for (i, point) in points.iter().enumerate() {
            let point = point.as_ref();
            if point.len() != n {
                return Err(PathError::Length { point: i, found: point.len(), wanted: n });
            }
            if let Some(joint) = point.iter().position(|q| !q.is_finite()) {
                return Err(PathError::NotFinite { point: i, joint });
            }
            let row = padded(point);
            match kept.last_mut() {
                // The last point counts, not the one beside it.
                Some(before) if distance(before, &row) < SAME_RAD && i + 1 == points.len() && i > 0 => {
                    *before = row;
                }
                Some(before) if distance(before, &row) < SAME_RAD => {}
                _ => {
                    kept.push(row);
                    blends.push((i, blends_rad.get(i).copied().unwrap_or(0.0).max(0.0)));
                }
            }
        }
        if kept.len() < 2 {
            return Err(PathError::NoWay { points: points.len() });
        }
        Ok(Self::of_corners(n, &kept, &blends))
    }

    fn of_corners(n: usize, points: &[Row8], blends: &[(usize, f64)]) -> Self {
        let lengths: Vec<f64> = points.windows(2).map(|pair| distance(&pair[0], &pair[1])).collect();
        let direction = |leg: usize| -> Row8 {
            std::array::from_fn(|k| (points[leg + 1][k] - points[leg][k]) / lengths[leg])
        };
        let (mut pieces, mut rests) = (Vec::new(), vec![(0.0, points[0])]);
        let (mut s, mut cut) = (0.0, 0.0);
        for leg in 0..lengths.len() {
            let (u, length) = (direction(leg), lengths[leg]);
            let next = (leg + 1 < lengths.len()).then(|| direction(leg + 1));
            let (corner, blend_rad) = blends.get(leg + 1).copied().unwrap_or_default();
            let delta = next.map_or(0.0, |u2| {
                let turn = distance(&u, &u2);
                if turn < STRAIGHT {
                    0.0
                } else {
                    (16.0 / 3.0 * blend_rad / turn).min(0.5 * length).min(0.5 * lengths[leg + 1])
                }
            });
            let from: Row8 = std::array::from_fn(|k| points[leg][k] + u[k] * cut);
            let line = length - cut - delta;
            if line > SAME_RAD * 1e-3 {
                pieces.push(Piece { s0: s, s1: s + line, shape: Shape::Line { from, u } });
                s += line;
            }
            let Some(u2) = next else { continue };
            if delta > 0.0 {
                let shape = Shape::Corner { at: points[leg + 1], u1: u, u2, delta, corner };
                pieces.push(Piece { s0: s, s1: s + 2.0 * delta, shape });
                s += 2.0 * delta;
            } else if distance(&u, &u2) >= STRAIGHT {
                rests.push((s, points[leg + 1]));
            }
            cut = delta;
        }
        rests.push((s, points[points.len() - 1]));
        Self { n, pieces, rests, points: points.to_vec() }
    }

    /// Length in rad.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.pieces.last().map_or(0.0, |piece| piece.s1)
    }

    /// Number of joints.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.n
    }

    /// The same points with a rest at each corner; `None` if it is that already.
    pub(super) fn resting(&self) -> Option<Self> {
        let is_rounded = self.pieces.iter().any(|piece| !piece.is_line());
        is_rounded.then(|| Self::of_corners(self.n, &self.points, &[]))
    }

    pub(super) fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    pub(super) fn rests(&self) -> &[(f64, Row8)] {
        &self.rests
    }

    /// The place after the length `s`, from 0 to [`Self::length`]. Where two pieces meet it is on the first, or on the second with
    /// `after`.
    pub(super) fn at(&self, s: f64, after: bool) -> Point {
        let index = if after {
            self.pieces.partition_point(|piece| piece.s1 <= s)
        } else {
            self.pieces.partition_point(|piece| piece.s1 < s)
        };
        let piece = &self.pieces[index.min(self.pieces.len() - 1)];
        piece.at(s.clamp(piece.s0, piece.s1) - piece.s0)
    }

    /// The rounded corners: lengths at their beginning and end, and which of the points they round.
    pub fn corners(&self) -> impl Iterator<Item = (f64, f64, usize)> + '_ {
        self.pieces.iter().filter_map(|piece| match piece.shape {
            Shape::Corner { corner, .. } => Some((piece.s0, piece.s1, corner)),
            Shape::Line { .. } => None,
        })
    }

    /// Angles after the length `s`, rad.
    #[must_use]
    pub fn angles(&self, s: f64) -> Vec<f64> {
        self.at(s, false).q[..self.n].to_vec()
    }
}

impl Travel for Path {
    fn at(&self, s: f64) -> JointVec {
        let q = self.at(s, false).q;
        JointVec::from_slice(&q[..self.n])
    }

    fn path_length(&self, s0: f64, s1: f64) -> JointVec {
        let mut way = [0.0; JOINTS_MAX];
        let first = self.pieces.partition_point(|piece| piece.s1 <= s0);
        for piece in self.pieces[first..].iter().take_while(|piece| piece.s0 < s1) {
            let length = piece.s1.min(s1) - piece.s0.max(s0);
            for (k, way) in way.iter_mut().enumerate() {
                // The direction lies between those of the two lines.
                *way += length
                    * match &piece.shape {
                        Shape::Line { u, .. } => u[k].abs(),
                        Shape::Corner { u1, u2, .. } => u1[k].abs().max(u2[k].abs()),
                    };
            }
        }
        JointVec::from_slice(&way[..self.n])
    }
}

impl Piece {
    fn at(&self, s: f64) -> Point {
        match &self.shape {
            Shape::Line { from, u } => Point {
                q: std::array::from_fn(|k| from[k] + u[k] * s),
                d1: *u,
                d2: [0.0; JOINTS_MAX],
                d3: [0.0; JOINTS_MAX],
            },
            Shape::Corner { at, u1, u2, delta, .. } => {
                let width = 2.0 * delta;
                let x = s / width;
                // Integral of h over σ: σ³ - σ⁴/2.
                let (h, h1, h2) = (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x), 6.0 - 12.0 * x);
                let turned = x * x * x * (1.0 - 0.5 * x);
                Point {
                    q: std::array::from_fn(|k| {
                        at[k] - delta * u1[k] + width * (u1[k] * (x - turned) + u2[k] * turned)
                    }),
                    d1: std::array::from_fn(|k| u1[k] + (u2[k] - u1[k]) * h),
                    d2: std::array::from_fn(|k| (u2[k] - u1[k]) * h1 / width),
                    d3: std::array::from_fn(|k| (u2[k] - u1[k]) * h2 / (width * width)),
                }
            }
        }
    }

    pub(super) fn is_line(&self) -> bool {
        matches!(self.shape, Shape::Line { .. })
    }
}

fn distance(a: &Row8, b: &Row8) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corner_is_left_by_the_blend_and_derivatives_are_those_of_the_path() {
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.5]];
        let path = Path::through(&points, 0.05).unwrap();
        let steps = 20_000;
        let mut nearest = f64::INFINITY;
        for i in 0..=steps {
            let q = path.angles(path.length() * f64::from(i) / f64::from(steps));
            nearest = nearest.min(distance(&padded(&q), &padded(&points[1])));
        }
        assert!((nearest - 0.05).abs() < 1e-6, "{nearest}");
        let eps = 1e-5;
        for s in [0.3, 0.85, 0.97, 1.05, 1.2, 2.0] {
            let (lo, at, hi) = (path.at(s - eps, false), path.at(s, false), path.at(s + eps, false));
            for k in 0..3 {
                assert!(((hi.q[k] - lo.q[k]) / (2.0 * eps) - at.d1[k]).abs() < 1e-8);
                assert!(((hi.d1[k] - lo.d1[k]) / (2.0 * eps) - at.d2[k]).abs() < 1e-6);
                assert!(((hi.d2[k] - lo.d2[k]) / (2.0 * eps) - at.d3[k]).abs() < 1e-3);
            }
        }
        assert_eq!(path.angles(path.length()), points[2]);
        assert_eq!(path.rests().len(), 2);
    }

    #[test]
    fn without_a_blend_it_rests_at_corners_but_not_at_points_on_a_line() {
        let path = Path::through(&[[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 1.0]], 0.0).unwrap();
        assert_eq!(path.rests().iter().map(|rest| rest.0).collect::<Vec<_>>(), [0.0, 1.0, 2.0]);
    }

    #[test]
    fn points_that_make_no_path_are_refused() {
        assert_eq!(Path::through(&[[1.0], [1.0]], 0.1).unwrap_err(), PathError::NoWay { points: 2 });
        assert_eq!(
            Path::through(&[vec![0.0, 1.0], vec![0.0]], 0.1).unwrap_err(),
            PathError::Length { point: 1, found: 1, wanted: 2 }
        );
        assert_eq!(
            Path::through(&[[0.0, 1.0], [0.0, f64::NAN]], 0.1).unwrap_err(),
            PathError::NotFinite { point: 1, joint: 1 }
        );
        let none: [[f64; 2]; 0] = [];
        assert_eq!(Path::through(&none, 0.1).unwrap_err(), PathError::Joints { joints: 0 });
    }
}
