//! Picture of a tuned joint: certified region with trajectories, and errors over time.

use super::design::{Proof, Tuned};
use super::saturated::row;
use crate::model::{StateVector, steady_state};
use plotters::coord::Shift;
use plotters::prelude::*;

/// Size of the picture, px.
const SIZE: (u32, u32) = (1100, 480);
/// Trajectories drawn.
const STARTS: usize = 12;
const REGION: RGBColor = RGBColor(31, 119, 180);
const CLIPPED: RGBColor = RGBColor(214, 39, 40);
const INITIAL: RGBColor = RGBColor(127, 127, 127);
const FREE: RGBColor = RGBColor(44, 160, 44);

/// A number on an axis; zero without a sign.
fn label(x: &f64) -> String {
    let text = format!("{x:.3}");
    if text == "-0.000" { "0.000".to_owned() } else { text }
}

/// A trajectory of the saturated loop: (time s, position rad, velocity rad/s, clipped).
type Points = Vec<(f64, f64, f64, bool)>;

/// SVG text; `Err` carries the drawing library's message.
///
/// # Errors
/// If the drawing library refuses (it has no reason to).
pub fn svg(tuned: &Tuned) -> Result<String, String> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        area.fill(&WHITE).map_err(|e| e.to_string())?;
        let (left, right) = area.split_horizontally(SIZE.0 as i32 / 2);
        let runs: Vec<Points> = (0..STARTS).map(|i| run(tuned, i)).collect();
        phase_plane(&left, tuned, &runs).map_err(|e| e.to_string())?;
        over_time(&right, tuned, &runs).map_err(|e| e.to_string())?;
        area.present().map_err(|e| e.to_string())?;
    }
    Ok(text)
}

/// From the `i`-th start on the boundary of the initial set, at the certified bound.
fn run(tuned: &Tuned, i: usize) -> Points {
    let problem = &tuned.problem;
    let (e0, v0) = problem.error_set();
    let (period, delay) = problem.grid(1)[0];
    let model = problem.sampled(period, delay);
    let k = row(tuned.gains);
    let u_max = problem.phases()[0].u_max_rad_s2;
    let angle = std::f64::consts::TAU * i as f64 / STARTS as f64;
    let mut x: StateVector = steady_state(e0 * angle.cos(), v0 * angle.sin());
    let steps = (horizon(tuned) / period).ceil() as usize;
    (0..=steps)
        .map(|n| {
            let wanted = (k * x)[0];
            let point = (n as f64 * period, x[0], x[1] + x[4], wanted.abs() >= u_max);
            x = model.a * x + model.b * wanted.clamp(-u_max, u_max);
            point
        })
        .collect()
}

/// Time shown, s: until the slowest start has settled.
fn horizon(tuned: &Tuned) -> f64 {
    tuned.evidence.map_or(4.0 / tuned.figures.decay_1_s.max(0.5), |e| 1.2 * e.settling_s).clamp(0.2, 4.0)
}

type Area<'a, 'b> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn<'a> = Result<(), DrawingAreaErrorKind<<SVGBackend<'a> as DrawingBackend>::ErrorType>>;

/// Boundary of the projection of a region on (position, velocity), or of the paper's ellipsoid.
fn boundary(tuned: &Tuned) -> Vec<(f64, f64)> {
    let c = match &tuned.proof {
        Proof::Saturated(certificate, _) => {
            let Some(region) = certificate.regions.first() else { return Vec::new() };
            let Some(inverse) = region.p.cholesky().map(|l| l.inverse()) else { return Vec::new() };
            // Velocity is w + p in the model's states.
            let s = region.scales;
            let rows = [(0, 1.0), (1, 1.0), (4, 1.0)];
            let at = |a: usize, b: usize| inverse[(rows[a].0, rows[b].0)] * s[rows[a].0] * s[rows[b].0];
            (at(0, 0), at(0, 1) + at(0, 2), at(1, 1) + 2.0 * at(1, 2) + at(2, 2))
        }
        Proof::Paper(certificate, _) => {
            let (e, v) = tuned.problem.error_set();
            let q = &certificate.q;
            (q[(0, 0)] * e * e, q[(0, 1)] * e * v, q[(1, 1)] * v * v)
        }
    };
    // Points of {z' C^-1 z = 1}: C = L L'.
    let l11 = c.0.max(0.0).sqrt();
    let l21 = c.1 / l11;
    let l22 = (c.2 - l21 * l21).max(0.0).sqrt();
    (0..=180)
        .map(|i| {
            let (s, k) = (std::f64::consts::TAU * f64::from(i) / 180.0).sin_cos();
            (l11 * k, l21 * k + l22 * s)
        })
        .collect()
}

fn phase_plane<'a>(area: &Area<'a, '_>, tuned: &Tuned, runs: &[Points]) -> Drawn<'a> {
    let ellipse = boundary(tuned);
    let all = ellipse.iter().copied().chain(runs.iter().flatten().map(|p| (p.1, p.2)));
    let (x, y) = all.fold((1e-9f64, 1e-9f64), |m, p| (m.0.max(p.0.abs()), m.1.max(p.1.abs())));
    let mut chart = ChartBuilder::on(area)
        .caption(
            format!("joint {}: certified region and trajectories", tuned.input.joint),
            ("sans-serif", 18),
        )
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(55)
        .build_cartesian_2d(-1.1 * x..1.1 * x, -1.1 * y..1.1 * y)?;
    chart
        .configure_mesh()
        .x_desc("position error (rad)")
        .y_desc("velocity error (rad/s)")
        .light_line_style(WHITE)
        .x_label_formatter(&label)
        .y_label_formatter(&label)
        .draw()?;
    chart
        .draw_series(LineSeries::new(ellipse, REGION.stroke_width(2)))?
        .label("certified region")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], REGION.stroke_width(2)));
    let (e0, v0) = tuned.problem.error_set();
    let initial = (0..=90).map(|i| {
        let (s, k) = (std::f64::consts::TAU * f64::from(i) / 90.0).sin_cos();
        (e0 * k, v0 * s)
    });
    chart
        .draw_series(LineSeries::new(initial, INITIAL.stroke_width(2)))?
        .label("initial errors")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], INITIAL.stroke_width(2)));
    for (clipped, colour, label) in
        [(false, FREE, "command within bound"), (true, CLIPPED, "command clipped")]
    {
        let pieces = runs.iter().flat_map(|run| {
            run.windows(2)
                .filter(|w| w[0].3 == clipped)
                .map(|w| PathElement::new([(w[0].1, w[0].2), (w[1].1, w[1].2)], colour.stroke_width(1)))
                .collect::<Vec<_>>()
        });
        chart
            .draw_series(pieces)?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .draw()
}

fn over_time<'a>(area: &Area<'a, '_>, tuned: &Tuned, runs: &[Points]) -> Drawn<'a> {
    let (e0, _) = tuned.problem.error_set();
    let top = runs.iter().flatten().map(|p| p.1.abs()).fold(e0, f64::max) * 1.1;
    let mut chart = ChartBuilder::on(area)
        .caption(
            format!(
                "error over time (grey: half of it), K = [{:.1} 1/s², {:.2} 1/s, {:.3}]",
                tuned.gains[0], tuned.gains[1], tuned.gains[2]
            ),
            ("sans-serif", 16),
        )
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..horizon(tuned), -top..top)?;
    chart
        .configure_mesh()
        .x_desc("time (s)")
        .y_desc("position error (rad)")
        .light_line_style(WHITE)
        .x_label_formatter(&label)
        .y_label_formatter(&label)
        .draw()?;
    for half in [-0.5 * e0, 0.5 * e0] {
        let line = PathElement::new([(0.0, half), (horizon(tuned), half)], INITIAL.stroke_width(1));
        chart.draw_series([line])?;
    }
    for run in runs {
        chart.draw_series(LineSeries::new(run.iter().map(|p| (p.0, p.1)), FREE.mix(0.8)))?;
        let clipped = run.windows(2).filter(|w| w[0].3);
        chart.draw_series(
            clipped.map(|w| PathElement::new([(w[0].0, w[0].1), (w[1].0, w[1].1)], CLIPPED.stroke_width(1))),
        )?;
    }
    Ok(())
}
