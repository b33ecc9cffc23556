//! Charts as data: few lines, limits dashed, an event marked. `assets/chart.js` draws them.

use std::borrow::Cow;

use serde::{Serialize, Serializer};

/// How a curve is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Pen {
    /// Solid line.
    Line,
    /// Dashed line.
    Dashed,
    /// Line with a dot on each point: few measurements.
    Dots,
    /// Only the dots.
    Marks,
    Limit,
}

#[derive(Debug, Clone, Serialize)]
pub struct Curve {
    /// Name in the legend; without one it is not in it.
    pub name: String,
    /// Number of its colour, 0 to 5 for joints, 6 for ink, 7 for soft.
    pub colour: usize,
    /// Points (x, y).
    #[serde(serialize_with = "few")]
    pub points: Vec<(f64, f64)>,
    /// How it is drawn.
    pub pen: Pen,
    /// The frame is chosen without it; what lies outside the frame is not drawn.
    pub beside: bool,
}

/// Most points of a curve that are drawn: of a run of ten minutes the pages would have hundreds of megabytes.
const POINTS_MAX: usize = 2_000;

/// The points that are drawn, in single precision; one that is not finite is `null`.
fn few<S: Serializer>(points: &[(f64, f64)], to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(shown(points).iter().map(|(x, y)| (*x as f32, *y as f32)))
}

/// Where there are too many, of neighbours the lowest and the highest one.
fn shown(points: &[(f64, f64)]) -> Cow<'_, [(f64, f64)]> {
    if points.len() <= POINTS_MAX {
        return Cow::Borrowed(points);
    }
    let size = (2 * points.len()).div_ceil(POINTS_MAX);
    let ends = |some: &[(f64, f64)]| {
        let order = |a: &(f64, f64), b: &(f64, f64)| a.1.total_cmp(&b.1);
        let mut ends: Vec<_> = some.iter().copied().min_by(order).into_iter().collect();
        ends.extend(some.iter().copied().max_by(order));
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        ends.dedup();
        ends
    };
    Cow::Owned(points.chunks(size).flat_map(ends).collect())
}

impl Curve {
    /// Solid curve.
    #[must_use]
    pub fn line(name: impl Into<String>, colour: usize, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), colour, points, pen: Pen::Line, beside: false }
    }

    /// The same, drawn otherwise.
    #[must_use]
    pub fn drawn(mut self, pen: Pen) -> Self {
        self.pen = pen;
        self
    }

    /// The same, without a say in the frame.
    #[must_use]
    pub const fn beside(mut self) -> Self {
        self.beside = true;
        self
    }

    /// Horizontal limit.
    #[must_use]
    pub fn limit(x: (f64, f64), y: f64) -> Self {
        Self::line("", 7, vec![(x.0, y), (x.1, y)]).drawn(Pen::Limit)
    }
}

/// A chart with a common frame.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Chart {
    /// Heading.
    pub title: String,
    /// Name and unit of x.
    pub x_label: String,
    /// Name and unit of y.
    pub y_label: String,
    pub curves: Vec<Curve>,
    /// Position and name of a vertical mark; not drawn outside the curves.
    pub mark: Option<(f64, String)>,
    /// Position and name of a fault.
    pub fault: Option<(f64, String)>,
    /// What the y axis shows at least.
    pub y_at_least: Option<(f64, f64)>,
    /// Region that is allowed: x from, x to, y from, y to.
    pub band: Option<[f64; 4]>,
    /// Texts at points.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub labels: Vec<((f64, f64), String)>,
    /// Same scale on both axes.
    pub equal: bool,
    /// x is time of the plan.
    #[serde(rename = "time")]
    pub is_time: bool,
}

impl Chart {
    /// Chart with names and units of x and y.
    #[must_use]
    pub fn new(title: impl Into<String>, x_label: &str, y_label: &str, curves: Vec<Curve>) -> Self {
        let (x_label, y_label) = (x_label.to_owned(), y_label.to_owned());
        Self { title: title.into(), x_label, y_label, curves, ..Self::default() }
    }

    /// The same with one scale on both axes.
    #[must_use]
    pub const fn equal(mut self) -> Self {
        self.equal = true;
        self
    }

    /// The same over time of the plan, with an event at a time and its name.
    #[must_use]
    pub fn over_time(mut self, mark: Option<(f64, &str)>) -> Self {
        self.is_time = true;
        self.mark = mark.map(|(at, name)| (at, name.to_owned()));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_that_are_not_finite_are_null() {
        let bad = vec![(0.0, f64::NAN), (1.0, 2.0), (f64::INFINITY, 1.0), (2.0, 1e300)];
        let data = serde_json::to_value(Curve::line("x", 0, bad)).unwrap();
        assert_eq!(data["points"].to_string(), "[[0.0,null],[1.0,2.0],[null,1.0],[2.0,null]]");
    }

    #[test]
    fn curve_of_very_many_points_keeps_its_lowest_and_highest_ones() {
        let mut points: Vec<(f64, f64)> = (0..200_000).map(|k| (f64::from(k), f64::from(k % 7))).collect();
        (points[77_777].1, points[123_456].1) = (1_000.0, -1_000.0);
        let many = points.clone();
        let shown = shown(&many);
        assert!((1_000..=2_000).contains(&shown.len()), "{}", shown.len());
        assert!(shown.contains(&points[77_777]) && shown.contains(&points[123_456]));
        assert!(shown.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert_eq!(super::shown(&points[..2_000]).as_ref(), &points[..2_000]);
    }
}
