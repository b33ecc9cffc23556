//! HTML report of an identification: scatter plots with the fits through them, and residuals.

use super::chart::{Chart, Curve, Pen};
use super::page::{Answer, Page, Tone, cell, number};
use tuner::identify::current::CurrentConstant;
use tuner::identify::findings::{Findings, Holds};
use tuner::identify::lag::answer;
use tuner::model::DriveLag;

/// Samples with the fit through them.
struct Scatter<'a> {
    title: &'a str,
    x: &'a str,
    y: &'a str,
    points: Vec<(f64, f64)>,
    fit: Vec<(f64, f64)>,
    residuals: Vec<(f64, f64)>,
}

impl Scatter<'_> {
    fn charts(self) -> [Chart; 2] {
        let measured = Curve::line("measured", 0, self.points).drawn(Pen::Marks);
        let left = Curve::line("", 0, self.residuals).drawn(Pen::Marks);
        let fit = Curve::line("fit", 1, self.fit);
        [
            Chart::new(self.title, self.x, self.y, vec![measured, fit]),
            Chart::new(format!("{}: residuals", self.title), self.x, self.y, vec![left]),
        ]
    }
}

/// Scatter of currents over what causes them; the fit's other columns are taken off the points, so that they
/// lie about one straight line.
fn current_scatter<'a>(
    (title, x): (&'a str, &'a str),
    constant: &CurrentConstant,
    samples: &[(f64, f64)],
) -> Scatter<'a> {
    let residuals: Vec<(f64, f64)> =
        samples.iter().zip(&constant.fit.residuals).map(|((x, _), r)| (*x, *r)).collect();
    let end = samples.iter().map(|s| s.0.abs()).fold(0.0, f64::max);
    let fit = [-end, end].map(|x| (x, constant.k.value * x)).to_vec();
    let points = residuals.iter().map(|(x, r)| (*x, constant.k.value * x + r)).collect();
    Scatter { title, x, y: "current in A", points, fit, residuals }
}

fn scatters(findings: &Findings) -> Vec<Scatter<'static>> {
    let mut found = Vec::new();
    let measured = &findings.measured;
    if let Ok(k_b) = &findings.k_b {
        let samples: Vec<_> = measured.speeds.samples.iter().map(|s| (s.speed_rad_s, s.current_a)).collect();
        found.push(current_scatter(("Steady speed, less friction", "joint speed in rad/s"), k_b, &samples));
    }
    if let (Some(Ok(k_m)), Holds::Measured { samples, .. }) = (&findings.k_m, &measured.holds) {
        let samples: Vec<_> = samples.iter().map(|s| (s.torque_nm, s.current_a)).collect();
        found.push(current_scatter(
            ("Holding against gravity, less friction", "computed load in N m"),
            k_m,
            &samples,
        ));
    }
    if let Ok(lag) = &findings.answer {
        let drive = DriveLag { wn_rad_s: lag.wn_rad_s.value, zeta: lag.zeta.value };
        let a = measured.steps.acceleration_rad_s2;
        let model = |t_s: f64| answer(&drive, a, t_s - lag.delay_s.value);
        let samples = || measured.steps.samples.iter();
        let last = samples().map(|s| s.t_s).fold(0.0, f64::max);
        let times = (0..=120).map(|i| last * f64::from(i) / 120.0);
        found.push(Scatter {
            title: "Answer to a step of acceleration",
            x: "time since the command in ms",
            y: "position in mrad",
            points: samples().map(|s| (1e3 * s.t_s, 1e3 * s.position_rad)).collect(),
            fit: times.map(|t_s| (1e3 * t_s, 1e3 * model(t_s))).collect(),
            residuals: samples().map(|s| (1e3 * s.t_s, 1e3 * (s.position_rad - model(s.t_s)))).collect(),
        });
    }
    found
}

/// One self-contained HTML file.
#[must_use]
pub fn html(findings: &Findings) -> String {
    let s = &findings.subject;
    let refusals = findings.refusals();
    let answer = if refusals.is_empty() {
        let next = "take the keys at the end of this page into the robot file";
        Answer::new("identified", Tone::Good, "every constant has an interval", next)
    } else {
        let next = "mend what is named here and measure again";
        Answer::new("not all is identified", Tone::Warn, refusals.join("; "), next)
    };
    let title = format!("Joint {} of {}", s.joint, s.robot);
    let mut page = Page::new(&title, &format!("{} on {}", s.module, s.bus), &answer);
    page.section(
        "Constants",
        "Motor current: K_B times the speed plus K_M times the torque. K_B: mean current at steady speeds, both directions, \
         over one stretch. K_M: holding currents against loads computed from the robot model, each pose approached from \
         both sides.",
    );
    page.pre(&findings.text());
    page.part("Fits", "Samples, the fits through them, and what is left.");
    page.charts(scatters(findings).into_iter().flat_map(Scatter::charts));
    let k_m = findings.k_m.as_ref().and_then(|k| k.as_ref().ok());
    let constants = [("K_B", findings.k_b.as_ref().ok()), ("K_M", k_m)];
    let rows = constants.into_iter().filter_map(|(name, constant)| {
        let fit = &constant?.fit;
        let freedom = cell(fit.degrees_of_freedom);
        Some(vec![cell(name), number(fit.r_squared, 5), number(fit.residual_std, 4), freedom])
    });
    let head = ["constant", "R²", "residuals A (standard deviation)", "degrees of freedom"];
    page.table(&head, rows.collect());
    page.part("Patch of the robot file", "");
    page.pre(&findings.patch());
    page.finish()
}
