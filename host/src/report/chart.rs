//! Line charts as inline SVG: few lines, limits dashed, an event marked.

use std::fmt::Write as _;

/// Colours that stay apart for colour-blind readers (Okabe and Ito).
pub const COLOURS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

/// One curve.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Colour.
    pub colour: &'static str,
    /// Points (x, y).
    pub points: Vec<(f64, f64)>,
    /// Whether it is drawn dashed: a limit.
    pub dashed: bool,
}

/// A chart with a common frame.
#[derive(Debug, Clone)]
pub struct Chart {
    /// Heading.
    pub title: String,
    /// Name and unit of x.
    pub x_label: String,
    /// Name and unit of y.
    pub y_label: String,
    /// Curves.
    pub curves: Vec<Curve>,
    /// Position and name of a vertical mark.
    pub mark: Option<(f64, String)>,
    /// Same scale on both axes.
    pub equal: bool,
}

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 300.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 110.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 42.0;

/// Text for XML.
#[must_use]
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A step of 1, 2 or 5 times a power of ten that divides `span` into about five.
fn tick_step(span: f64) -> f64 {
    let raw = (span / 5.0).max(1e-12);
    let power = 10_f64.powf(raw.log10().floor());
    let digit = [1.0, 2.0, 5.0, 10.0].into_iter().find(|d| d * power >= raw).unwrap_or(10.0);
    digit * power
}

impl Chart {
    /// As an SVG element.
    #[must_use]
    pub fn svg(&self) -> String {
        let all = || self.curves.iter().flat_map(|c| &c.points);
        let (mut x0, mut x1, mut y0, mut y1) =
            (f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY);
        for (x, y) in all().filter(|p| p.0.is_finite() && p.1.is_finite()) {
            (x0, x1, y0, y1) = (x0.min(*x), x1.max(*x), y0.min(*y), y1.max(*y));
        }
        if x0 > x1 {
            (x0, x1, y0, y1) = (0.0, 1.0, 0.0, 1.0);
        }
        let pad = |a: f64, b: f64| if b - a < 1e-9 { 0.5 } else { 0.05 * (b - a) };
        let (px, py) = (if self.equal { pad(x0, x1) } else { 0.0 }, pad(y0, y1));
        (x0, x1, y0, y1) = (x0 - px, x1 + px, y0 - py, y1 + py);
        let (w, h) = (WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM);
        if self.equal {
            let scale = ((x1 - x0) / w).max((y1 - y0) / h);
            let (cx, cy) = (0.5 * (x0 + x1), 0.5 * (y0 + y1));
            (x0, x1) = (cx - 0.5 * scale * w, cx + 0.5 * scale * w);
            (y0, y1) = (cy - 0.5 * scale * h, cy + 0.5 * scale * h);
        }
        let sx = |x: f64| LEFT + (x - x0) / (x1 - x0) * w;
        let sy = |y: f64| TOP + (y1 - y) / (y1 - y0) * h;
        let mut o = format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{0}\"><text x=\"{LEFT}\" y=\"18\" class=\"t\">{0}</text>",
            escape(&self.title)
        );
        for (horizontal, lo, hi) in [(true, x0, x1), (false, y0, y1)] {
            let step = tick_step(hi - lo);
            let mut tick = (lo / step).ceil() * step;
            while tick <= hi + 1e-9 * step {
                let digits = (-step.log10().floor()).max(0.0) as usize;
                // Minus zero would be printed with its sign.
                let label = format!("{:.digits$}", if tick.abs() < 1e-9 * step { 0.0 } else { tick });
                let _ = if horizontal {
                    let x = sx(tick);
                    write!(
                        o,
                        "<path class=\"g\" d=\"M{x:.1} {TOP}V{:.1}\"/><text class=\"k\" x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>",
                        TOP + h,
                        TOP + h + 14.0
                    )
                } else {
                    let y = sy(tick);
                    write!(
                        o,
                        "<path class=\"g\" d=\"M{LEFT} {y:.1}H{:.1}\"/><text class=\"k\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
                        LEFT + w,
                        LEFT - 5.0,
                        y + 4.0
                    )
                };
                tick += step;
            }
        }
        let _ = write!(
            o,
            "<text class=\"k\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text><text class=\"k\" transform=\"translate(14 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            LEFT + 0.5 * w,
            HEIGHT - 8.0,
            escape(&self.x_label),
            TOP + 0.5 * h,
            escape(&self.y_label)
        );
        if let Some((x, name)) = &self.mark {
            let x = sx(*x);
            let _ = write!(
                o,
                "<path class=\"m\" d=\"M{x:.1} {TOP}V{:.1}\"/><text class=\"k\" x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                TOP + h,
                TOP - 2.0,
                escape(name)
            );
        }
        let mut legend = TOP + 8.0;
        for curve in &self.curves {
            let mut d = String::new();
            for (i, (x, y)) in curve.points.iter().enumerate() {
                let _ = write!(d, "{}{:.1} {:.1}", if i == 0 { 'M' } else { 'L' }, sx(*x), sy(*y));
            }
            let dash = if curve.dashed { " stroke-dasharray=\"5 4\"" } else { "" };
            let _ = write!(o, "<path class=\"c\" stroke=\"{}\"{dash} d=\"{d}\"/>", curve.colour);
            if !curve.name.is_empty() {
                let x = LEFT + w + 8.0;
                let _ = write!(
                    o,
                    "<path class=\"c\" stroke=\"{}\"{dash} d=\"M{x:.1} {legend:.1}h16\"/><text class=\"k\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                    curve.colour,
                    x + 20.0,
                    legend + 4.0,
                    escape(&curve.name)
                );
                legend += 16.0;
            }
        }
        o + "</svg>"
    }
}
