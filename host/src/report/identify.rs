//! Report of an identification: one HTML file with scatter plots and residuals that opens offline.

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::report::chart::escape;
use tuner::identify::current::CurrentConstant;
use tuner::identify::findings::{Findings, Holds};
use tuner::identify::lag::answer;
use tuner::model::DriveLag;

/// Size of a picture, px.
const SIZE: (u32, u32) = (640, 420);
/// Share of its height that the fit takes; below it are the residuals.
const FIT_HEIGHT: i32 = 290;
/// Samples beyond which their marks are small.
const MANY: usize = 50;
const DATA: RGBColor = RGBColor(0, 114, 178);
const LINE: RGBColor = RGBColor(213, 94, 0);

/// Samples with the fit through them.
struct Scatter<'a> {
    title: &'a str,
    x: &'a str,
    y: &'a str,
    points: Vec<(f64, f64)>,
    fit: Vec<(f64, f64)>,
    residuals: Vec<(f64, f64)>,
}

type Drawn<'a> = Result<(), DrawingAreaErrorKind<<SVGBackend<'a> as DrawingBackend>::ErrorType>>;

/// Smallest interval around the values, widened by a tenth; never empty.
fn around(values: impl Iterator<Item = f64> + Clone) -> std::ops::Range<f64> {
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(f64::NEG_INFINITY, f64::max);
    let pad = (0.1 * (high - low)).max(1e-9);
    low - pad..high + pad
}

impl Scatter<'_> {
    /// SVG text.
    fn svg(&self) -> Result<String, String> {
        let mut text = String::new();
        {
            let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
            area.fill(&WHITE).map_err(|e| e.to_string())?;
            let (above, below) = area.split_vertically(FIT_HEIGHT);
            self.draw_fit(&above).map_err(|e| e.to_string())?;
            self.draw_residuals(&below).map_err(|e| e.to_string())?;
            area.present().map_err(|e| e.to_string())?;
        }
        Ok(text)
    }

    fn draw_fit<'a>(&self, area: &DrawingArea<SVGBackend<'a>, Shift>) -> Drawn<'a> {
        let all = || self.points.iter().chain(&self.fit);
        let mut chart = ChartBuilder::on(area)
            .caption(self.title, ("sans-serif", 17))
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size(62)
            .build_cartesian_2d(around(all().map(|p| p.0)), around(all().map(|p| p.1)))?;
        chart.configure_mesh().x_desc(self.x).y_desc(self.y).light_line_style(WHITE).draw()?;
        // Many samples would hide the line below them.
        let radius = if self.points.len() > MANY { 1 } else { 3 };
        chart.draw_series(self.points.iter().map(|p| Circle::new(*p, radius, DATA.filled())))?;
        chart.draw_series(LineSeries::new(self.fit.iter().copied(), LINE.stroke_width(2)))?;
        Ok(())
    }

    fn draw_residuals<'a>(&self, area: &DrawingArea<SVGBackend<'a>, Shift>) -> Drawn<'a> {
        let largest = self.residuals.iter().map(|p| p.1.abs()).fold(1e-9, f64::max);
        let x = around(self.points.iter().chain(&self.fit).map(|p| p.0));
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(0)
            .y_label_area_size(62)
            .build_cartesian_2d(x.clone(), -1.2 * largest..1.2 * largest)?;
        chart.configure_mesh().y_desc("residual").y_labels(5).light_line_style(WHITE).draw()?;
        chart.draw_series(LineSeries::new([(x.start, 0.0), (x.end, 0.0)], LINE.stroke_width(1)))?;
        chart.draw_series(self.residuals.iter().map(|p| Circle::new(*p, 2, DATA.filled())))?;
        Ok(())
    }
}

/// Scatter of currents over what causes them; the fit's other columns are taken off the points, so that they
/// lie about one straight line.
fn current_scatter<'a>(
    labels: (&'a str, &'a str),
    constant: &CurrentConstant,
    samples: &[(f64, f64)],
) -> Scatter<'a> {
    let residuals: Vec<(f64, f64)> =
        samples.iter().zip(&constant.fit.residuals).map(|((x, _), r)| (*x, *r)).collect();
    let fit = [-1.0, 1.0].map(|end| {
        let x = end * samples.iter().map(|s| s.0.abs()).fold(0.0, f64::max);
        (x, constant.k.value * x)
    });
    let points = residuals.iter().map(|(x, r)| (*x, constant.k.value * x + r)).collect();
    Scatter { title: labels.0, x: labels.1, y: "current (A)", points, fit: fit.to_vec(), residuals }
}

fn pictures(findings: &Findings) -> Result<Vec<String>, String> {
    let mut svgs = Vec::new();
    let measured = &findings.measured;
    if let Ok(k_b) = &findings.k_b {
        let samples: Vec<_> = measured.speeds.samples.iter().map(|s| (s.speed_rad_s, s.current_a)).collect();
        let labels = ("Steady speed, friction taken off", "joint speed (rad/s)");
        svgs.push(current_scatter(labels, k_b, &samples).svg()?);
    }
    if let (Some(Ok(k_m)), Holds::Measured { samples, .. }) = (&findings.k_m, &measured.holds) {
        let samples: Vec<_> = samples.iter().map(|s| (s.torque_nm, s.current_a)).collect();
        let labels = ("Holding against gravity, friction taken off", "computed load (N m)");
        svgs.push(current_scatter(labels, k_m, &samples).svg()?);
    }
    if let Ok(found) = &findings.answer {
        let drive = DriveLag { wn_rad_s: found.wn_rad_s.value, zeta: found.zeta.value };
        let a = measured.steps.acceleration_rad_s2;
        let model = |t_s: f64| answer(&drive, a, t_s - found.delay_s.value);
        let samples = &measured.steps.samples;
        let last = samples.iter().map(|s| s.t_s).fold(0.0, f64::max);
        let mrad = |rad: f64| 1e3 * rad;
        let scatter = Scatter {
            title: "Answer to a step of acceleration",
            x: "time since the command (ms)",
            y: "position (mrad)",
            points: samples.iter().map(|s| (1e3 * s.t_s, mrad(s.position_rad))).collect(),
            fit: (0..=120).map(|i| last * f64::from(i) / 120.0).map(|t| (1e3 * t, mrad(model(t)))).collect(),
            residuals: samples.iter().map(|s| (1e3 * s.t_s, mrad(s.position_rad - model(s.t_s)))).collect(),
        };
        svgs.push(scatter.svg()?);
    }
    Ok(svgs)
}

/// The report.
///
/// # Errors
/// If the drawing library refuses (it has no reason to).
pub fn html(findings: &Findings) -> Result<String, String> {
    let s = &findings.subject;
    let figures: String =
        pictures(findings)?.into_iter().map(|svg| format!("<figure>{svg}</figure>\n")).collect();
    let fits: String = [("K_B", findings.k_b.as_ref().ok()), ("K_M", findings.k_m.as_ref().and_then(|k| k.as_ref().ok()))]
        .into_iter()
        .filter_map(|(name, constant)| {
            let fit = &constant?.fit;
            Some(format!(
                "<li>{name}: R<sup>2</sup> = {:.5}, residuals {:.4} A (standard deviation), {} degrees of freedom</li>\n",
                fit.r_squared, fit.residual_std, fit.degrees_of_freedom
            ))
        })
        .collect();
    let heading =
        format!("Joint {} of {}: {} on {}", s.joint, escape(&s.robot), escape(&s.module), escape(&s.bus));
    Ok(format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{heading}</title>\n<style>body{{font:15px \
         sans-serif;max-width:1320px;margin:2em auto;padding:0 1em}}pre{{background:#f4f4f4;padding:1em;overflow:auto}}\
         figure{{display:inline-block;margin:.5em}}</style></head><body>\n<h1>{heading}</h1>\n<p>Motor current \
         I = K<sub>B</sub> |q&#775;| + K<sub>M</sub> |&tau;|. K<sub>B</sub>: mean current at steady speeds, both directions, \
         over one stretch. K<sub>M</sub>: holding currents against loads computed from the robot model, each pose \
         approached from both sides.</p>\n<pre>{}</pre>\n{figures}<ul>\n{fits}</ul>\n<h2>Patch of the robot file</h2>\n\
         <pre>{}</pre>\n</body></html>\n",
        escape(&findings.text()),
        escape(&findings.patch())
    ))
}
