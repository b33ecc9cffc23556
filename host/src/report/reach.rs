//! Reach map of a sweep: one cell per target, coloured by the objective; cells out of reach stay grey.

use std::fmt::Write as _;

use super::chart::escape;

/// One target of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Target in m.
    pub target: [f64; 3],
    /// Objective, if a throw was found.
    pub objective: Option<f64>,
}

/// The map as an SVG file of the targets of a grid; axes are the two coordinates that vary most.
///
/// If the third varies too, a cell shows the cheapest throw along it.
#[must_use]
pub fn svg(cells: &[Cell], robot: &str) -> String {
    let values = |axis: usize| {
        let mut v: Vec<f64> = cells.iter().map(|cell| cell.target[axis]).collect();
        v.sort_by(f64::total_cmp);
        v.dedup();
        v
    };
    let axes: [Vec<f64>; 3] = [values(0), values(1), values(2)];
    let mut order = [0, 1, 2];
    order.sort_by_key(|a| std::cmp::Reverse(axes[*a].len()));
    let (mut a, mut b, c) = (order[0], order[1], order[2]);
    if a > b {
        (a, b) = (b, a);
    }
    let step = |v: &[f64]| v.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
    let (da, db) = (step(&axes[a]), step(&axes[b]));
    let (da, db) = (if da.is_finite() { da } else { 0.1 }, if db.is_finite() { db } else { da });
    let ends = |v: &[f64]| (v.first().copied().unwrap_or(0.0), v.last().copied().unwrap_or(1.0));
    let ((a0, a1), (b0, b1), (c0, c1)) = (ends(&axes[a]), ends(&axes[b]), ends(&axes[c]));
    let name = ["x", "y", "z"];
    let third = if c1 > c0 {
        format!("the cheapest of {} = {c0} to {c1} m", name[c])
    } else {
        format!("{} = {c0} m", name[c])
    };
    // Drawn from the dearest to the cheapest, what is out of reach first.
    let price = |cell: &Cell| cell.objective.unwrap_or(f64::INFINITY);
    let mut cells: Vec<&Cell> = cells.iter().collect();
    cells.sort_by(|a, b| price(b).total_cmp(&price(a)));
    let scale = 640.0 / (a1 - a0 + da).max(0.6 * (b1 - b0 + db));
    let (w, h) = ((a1 - a0 + da) * scale, (b1 - b0 + db) * scale);
    let best = cells.iter().filter_map(|cell| cell.objective).fold(f64::INFINITY, f64::min);
    let worst = cells.iter().filter_map(|cell| cell.objective).fold(f64::NEG_INFINITY, f64::max);
    let colour = |j: f64| {
        let t = if worst > best { (j - best) / (worst - best) } else { 0.0 };
        // Dark blue through green to yellow: brightness grows with the price, so it survives grey print.
        format!("hsl({:.0} 65% {:.0}%)", 240.0 - 185.0 * t, 32.0 + 36.0 * t)
    };
    let (left, top) = (60.0, 46.0);
    let mut o = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {:.0} {:.0}\" font-family=\"sans-serif\" font-size=\"12\"><rect width=\"100%\" height=\"100%\" fill=\"white\"/><text x=\"{left}\" y=\"24\" font-size=\"15\">Reach of {}: objective of the best throw, {third}</text>",
        left + w + 120.0,
        top + h + 56.0,
        escape(robot)
    );
    for cell in &cells {
        let x = left + (cell.target[a] - a0) * scale;
        let y = top + h - (cell.target[b] - b0 + db) * scale;
        let (fill, text) = match cell.objective {
            Some(j) => (colour(j), format!("{j:.2}")),
            None => ("#dddddd".to_owned(), "no throw".to_owned()),
        };
        let [tx, ty, tz] = cell.target;
        let _ = write!(
            o,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{fill}\" stroke=\"white\" stroke-width=\"0.5\"><title>({tx}, {ty}, {tz}) m: {text}</title></rect>",
            da * scale,
            db * scale
        );
    }
    // Every this many cells has its value beside it.
    let labelled = |v: &[f64]| -> Vec<f64> { v.iter().copied().step_by(v.len().div_ceil(10)).collect() };
    for v in labelled(&axes[a]) {
        let (x, y) = (left + (v - a0 + 0.5 * da) * scale, top + h + 16.0);
        let _ = write!(o, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{v:.2}</text>");
    }
    for v in labelled(&axes[b]) {
        let (x, y) = (left - 6.0, top + h - (v - b0 + 0.5 * db) * scale + 4.0);
        let _ = write!(o, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"end\">{v:.2}</text>");
    }
    for i in 0..=5 {
        let t = f64::from(i) / 5.0;
        if worst >= best {
            let j = best + t * (worst - best);
            let y = top + 20.0 * f64::from(i);
            let _ = write!(
                o,
                "<rect x=\"{:.1}\" y=\"{y:.1}\" width=\"16\" height=\"16\" fill=\"{}\"/><text x=\"{:.1}\" y=\"{:.1}\">{j:.1}</text>",
                left + w + 16.0,
                colour(j),
                left + w + 38.0,
                y + 12.0
            );
        }
    }
    let y = top + 128.0;
    let _ = write!(
        o,
        "<rect x=\"{:.1}\" y=\"{y:.1}\" width=\"16\" height=\"16\" fill=\"#dddddd\"/><text x=\"{:.1}\" y=\"{:.1}\">no throw</text>",
        left + w + 16.0,
        left + w + 38.0,
        y + 12.0
    );
    let _ = writeln!(
        o,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{} of the target in m</text><text transform=\"translate(14 {:.1}) rotate(-90)\" text-anchor=\"middle\">{} of the target in m</text></svg>",
        left + 0.5 * w,
        top + h + 38.0,
        name[a],
        top + 0.5 * h,
        name[b]
    );
    o
}
