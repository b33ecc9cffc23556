//! HTML report of a gain design: answer, loop and certificate of each joint, and what the gains do on the simulated cell.

use tuner::gains::design::Tuned;
use tuner::gains::picture::{Curves, curves};
use tuner::gains::problem::JointInput;

use super::chart::{Chart, Curve, Pen};
use super::page::{Answer, Page, Tile, Tone, cell};

/// Largest sensitivity that counts as robust: a modulus margin of a half.
const SENSITIVITY_GOOD: f64 = 2.0;
/// Colours: nominal timing, the corners, what is proven or allowed, what is clipped.
const NOMINAL: usize = 0;
const CORNER: usize = 7;
const PROVEN: usize = 2;
const CLIPPED: usize = 1;

/// What is to be seen in the pictures of a joint.
const ABOUT: &str = "Blue: nominal period and delay. Grey: the corners of the certified periods and delays. Green: what is proven.";

/// A table of the page: heading of each column, rows of cells, and a line for each column.
pub struct Table<'a> {
    /// Headings.
    pub head: Vec<&'a str>,
    pub rows: Vec<Vec<String>>,
    /// Column and meaning.
    pub columns: &'a [(&'a str, &'a str)],
}

/// The report; `under` says what was asked for, `short` what could not be certified and what to do.
#[must_use]
pub fn html(
    robot: &str,
    under: &str,
    short: Option<(&str, &str)>,
    tuned: &[Tuned],
    tables: &[(&str, Table<'_>)],
) -> String {
    let decay_1_s = tuned.iter().map(Tuned::decay_1_s).fold(f64::INFINITY, f64::min);
    let answer = match short {
        Some((why, next)) => Answer::new("certified, for smaller errors", Tone::Warn, why, next),
        None => Answer::new(
            "certified",
            Tone::Good,
            format!(
                "every error falls by at least {decay_1_s:.2} 1/s, clipped or not, at every period and delay above"
            ),
            "throw with them: `cubectl throw --gains FILE`, or give them to a controller: `cubectl tune --apply`",
        ),
    };
    let mut page = Page::new(&format!("Gains of {robot}"), under, &answer);
    // Joints with the same data have the same gains.
    let data = |joint: &Tuned| JointInput { joint: 0, ..joint.input.clone() };
    let mut groups: Vec<Vec<&Tuned>> = Vec::new();
    for joint in tuned {
        match groups.iter_mut().find(|group| data(group[0]) == data(joint)) {
            Some(group) => group.push(joint),
            None => groups.push(vec![joint]),
        }
    }
    let mut drawn: Vec<(Vec<&Tuned>, Curves)> = groups
        .into_iter()
        .map(|group| (curves(group[0]), group))
        .map(|(curves, group)| (group, curves))
        .collect();
    tiles(&mut page, tuned, &drawn);
    // The slowest joint is shown; the others are a click away.
    let settles_s = |group: &[&Tuned]| group[0].evidence.map_or(0.0, |seen| seen.settling_s);
    drawn.sort_by(|(a, _), (b, _)| settles_s(b).total_cmp(&settles_s(a)));
    for (i, (group, curves)) in drawn.iter().enumerate() {
        let numbers: Vec<String> = group.iter().map(|joint| joint.input.joint.to_string()).collect();
        let heading = format!("Joint{} {}", if numbers.len() == 1 { "" } else { "s" }, numbers.join(", "));
        if i == 0 {
            page.section(&format!("{heading}, the slowest"), ABOUT);
        } else {
            page.detail(&heading, ABOUT);
        }
        page.charts(charts(group[0], curves));
    }
    for (heading, table) in tables {
        page.section(heading, "");
        let rows: Vec<_> = table.rows.iter().map(|row| row.iter().map(cell).collect()).collect();
        page.table(&table.head, rows);
        for (column, meaning) in table.columns {
            page.note(&format!("{column}: {meaning}"));
        }
    }
    page.finish()
}

fn tiles(page: &mut Page, tuned: &[Tuned], drawn: &[(Vec<&Tuned>, Curves)]) {
    let worst = |of: &dyn Fn(&Tuned) -> f64| tuned.iter().map(of).fold(0.0, f64::max);
    let least = |of: &dyn Fn(&Tuned) -> f64| tuned.iter().map(of).fold(f64::INFINITY, f64::min);
    let settles_s = worst(&|joint| joint.evidence.map_or(0.0, |seen| seen.settling_s));
    let sensitivity = drawn.iter().map(|(_, curves)| curves.sensitivity_max).fold(0.0, f64::max);
    let robust = if sensitivity <= SENSITIVITY_GOOD { Tone::Good } else { Tone::Warn };
    let decay = least(&Tuned::decay_1_s);
    let delay_ms = 1e3 * least(&|joint| joint.figures.delay_margin_s);
    let mut tiles = vec![
        Tile::new(format!("{decay:.2}"), "1/s", "decay that is proven"),
        Tile::new(format!("{sensitivity:.2}"), "", "largest sensitivity, at any timing").toned(robust),
        Tile::new(format!("{delay_ms:.1}"), "ms", "more delay until it is unstable"),
    ];
    if settles_s > 0.0 {
        tiles.insert(0, Tile::new(format!("{settles_s:.3}"), "s", "settles, slowest joint"));
    }
    page.tiles(tiles);
}

/// Curves at the corners behind that of the nominal timing.
fn of_timings(all: Vec<Vec<(f64, f64)>>) -> Vec<Curve> {
    let mut curves: Vec<Curve> = all
        .into_iter()
        .enumerate()
        .map(|(i, points)| {
            let (name, colour) = match i {
                0 => ("nominal timing", NOMINAL),
                1 => ("corners of the timing", CORNER),
                _ => ("", CORNER),
            };
            Curve::line(name, colour, points)
        })
        .collect();
    curves.rotate_left(1);
    curves
}

fn charts(joint: &Tuned, curves: &Curves) -> Vec<Chart> {
    let mrad = |points: &[(f64, f64)]| points.iter().map(|(t, x)| (*t, 1e3 * x)).collect::<Vec<_>>();
    let end = |points: &[(f64, f64)]| points.last().map_or(0.0, |p| p.0);
    let answers: Vec<_> = curves.answers.iter().map(|points| mrad(points)).collect();
    let (e0, _) = joint.problem.error_set();
    let (horizon, top_hz) = (end(&answers[0]), end(&curves.loops[0][0]));
    let mut answer = of_timings(answers);
    answer.extend([0.02, -0.02].map(|share| Curve::limit((0.0, horizon), 1e3 * share * e0)));
    let mut all = of_timings(curves.loops.iter().map(|[s, _]| s.clone()).collect());
    all.push(Curve::line("from reference, nominal", 3, curves.loops[0][1].clone()).drawn(Pen::Dashed));
    all.push(Curve::limit((0.0, top_hz), SENSITIVITY_GOOD));
    let both = |points: &[(f64, f64)]| points.iter().map(|(e, v)| (1e3 * e, 1e3 * v)).collect::<Vec<_>>();
    let mut plane = vec![
        Curve::line("certified region", PROVEN, both(&curves.region)),
        Curve::line("initial errors", 6, both(&curves.initial)).drawn(Pen::Dashed),
    ];
    let mut named = [false; 2];
    for (clipped, points) in &curves.stretches {
        let (name, colour) = if *clipped { ("clipped", CLIPPED) } else { ("not clipped", NOMINAL) };
        let name = if std::mem::replace(&mut named[usize::from(*clipped)], true) { "" } else { name };
        plane.push(Curve::line(name, colour, both(points)));
    }
    let mut charts = vec![
        Chart::new(
            "Answer to an initial error (dashed: 2 % of it)",
            "time (s)",
            "position error (mrad)",
            answer,
        ),
        Chart::new("Sensitivity |S| of the loop (dashed: 2)", "frequency (Hz)", "magnitude", all),
        Chart::new("Certified region", "position error (mrad)", "velocity error (mrad/s)", plane),
    ];
    if !curves.falls.is_empty() {
        let mut falls: Vec<Curve> = curves.falls.iter().map(|p| Curve::line("", CORNER, p.clone())).collect();
        if let Some(first) = falls.first_mut() {
            "corners of the timing".clone_into(&mut first.name);
        }
        falls.push(Curve::line("proven", PROVEN, curves.proven.clone()));
        charts.push(Chart::new(
            "Fall of the Lyapunov function, worst initial error",
            "time (s)",
            "√V, 1 on the certified region",
            falls,
        ));
    }
    charts
}
