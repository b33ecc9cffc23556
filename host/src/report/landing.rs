//! Landing about the target: predicted spread, and points that are known.

use super::chart::{Chart, Curve, Pen};
use super::scene::ellipse;
use planner::plan::file::PlanFile;

/// A point on the plane of the target.
#[derive(Clone, Debug)]
pub struct Mark {
    /// Name in the legend.
    pub name: String,
    pub colour: usize,
    /// Coordinates on the plane of the target, m.
    pub xy_m: [f64; 2],
}

/// Chart in mm about the target; the spread is that of the plan's noise.
#[must_use]
pub fn chart(plan: &PlanFile, marks: &[Mark]) -> Chart {
    let aim = plan.target.aim().centre();
    let (x_label, y_label) = match plan.target.opening {
        Some(_) => ("across the opening, horizontal, in mm", "across the opening, upwards, in mm"),
        None => ("x from the target in mm", "y from the target in mm"),
    };
    let about = |(x, y): (f64, f64)| ((x - aim[0]) * 1e3, (y - aim[1]) * 1e3);
    let ring = |sigmas: f64| -> Vec<(f64, f64)> {
        let mut points: Vec<(f64, f64)> = ellipse(plan, sigmas).into_iter().map(about).collect();
        points.extend(points.first().copied());
        points
    };
    let outer = ring(2.0);
    let size = outer.iter().map(|p| p.0.abs().max(p.1.abs())).fold(1.0, f64::max);
    let cross =
        |(x, y): (f64, f64), arm: f64| vec![(x - arm, y), (x + arm, y), (x, y), (x, y + arm), (x, y - arm)];
    let mut curves = vec![
        Curve::line("1σ", 2, ring(1.0)),
        Curve::line("2σ", 2, outer).drawn(Pen::Dashed),
        Curve::line("target", 6, cross((0.0, 0.0), 0.12 * size)),
    ];
    for mark in marks {
        let at = about((mark.xy_m[0], mark.xy_m[1]));
        // A saltire, so that it stays apart from the target's cross.
        let arm = 0.06 * size;
        let points = vec![
            (at.0 - arm, at.1 - arm),
            (at.0 + arm, at.1 + arm),
            at,
            (at.0 - arm, at.1 + arm),
            (at.0 + arm, at.1 - arm),
        ];
        curves.push(Curve::line(mark.name.clone(), mark.colour, points));
    }
    Chart::new("Landing about the target", x_label, y_label, curves).equal()
}
