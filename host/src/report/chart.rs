//! Line charts as inline SVG: few lines, limits dashed, an event marked.
//!
//! Colours come from the page's style (classes `s0` to `s7`), so that one chart serves light and dark pages. Charts
//! over time carry their frame in `data-time`, from which the page's script draws the present time.

use std::fmt::Write as _;

/// How a curve is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pen {
    /// Solid line.
    Line,
    /// Dashed line.
    Dashed,
    /// Line with a dot on each point: few measurements.
    Dots,
    /// A limit.
    Limit,
}

/// One curve.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Name in the legend; without one it is not in it.
    pub name: String,
    /// Number of its colour, 0 to 5 for joints, 6 for ink, 7 for soft.
    pub colour: usize,
    /// Points (x, y).
    pub points: Vec<(f64, f64)>,
    /// How it is drawn.
    pub pen: Pen,
}

impl Curve {
    /// Solid curve.
    #[must_use]
    pub fn line(name: impl Into<String>, colour: usize, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), colour, points, pen: Pen::Line }
    }

    /// The same, drawn otherwise.
    #[must_use]
    pub fn drawn(mut self, pen: Pen) -> Self {
        self.pen = pen;
        self
    }

    /// Horizontal limit.
    #[must_use]
    pub fn limit(x: (f64, f64), y: f64) -> Self {
        Self::line("", 7, vec![(x.0, y), (x.1, y)]).drawn(Pen::Limit)
    }
}

/// A chart with a common frame.
#[derive(Debug, Clone, Default)]
pub struct Chart {
    /// Heading.
    pub title: String,
    /// Name and unit of x.
    pub x_label: String,
    /// Name and unit of y.
    pub y_label: String,
    /// Curves.
    pub curves: Vec<Curve>,
    /// Position and name of a vertical mark; not drawn outside the curves.
    pub mark: Option<(f64, String)>,
    /// Region that is allowed: x from, x to, y from, y to.
    pub band: Option<[f64; 4]>,
    /// Same scale on both axes.
    pub equal: bool,
    /// x is time of the plan.
    pub is_time: bool,
    /// Narrow and low, for small multiples.
    pub small: bool,
}

struct Frame {
    left: f64,
    top: f64,
    w: f64,
    h: f64,
    x: (f64, f64),
    y: (f64, f64),
}

impl Frame {
    fn sx(&self, x: f64) -> f64 {
        self.left + (x - self.x.0) / (self.x.1 - self.x.0) * self.w
    }

    fn sy(&self, y: f64) -> f64 {
        self.top + (self.y.1 - y) / (self.y.1 - self.y.0) * self.h
    }
}

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

/// Round numbers from `lo` to `hi` with their labels.
fn ticks(lo: f64, hi: f64) -> Vec<(f64, String)> {
    let step = tick_step(hi - lo);
    let digits = (-step.log10().floor()).max(0.0) as usize;
    let first = (lo / step).ceil();
    (0..40)
        .map(|i| (first + f64::from(i)) * step)
        .take_while(|tick| *tick <= hi + 1e-9 * step)
        // Minus zero would be printed with its sign.
        .map(|tick| if tick.abs() < 1e-9 * step { 0.0 } else { tick })
        .map(|tick| (tick, format!("{tick:.digits$}").replace('-', "−")))
        .collect()
}

impl Chart {
    fn frame(&self) -> Frame {
        let points = self.curves.iter().flat_map(|c| &c.points).copied();
        let band = self.band.map(|[x0, x1, y0, y1]| [(x0, y0), (x1, y1)]);
        let (mut x, mut y) = ((f64::INFINITY, f64::NEG_INFINITY), (f64::INFINITY, f64::NEG_INFINITY));
        for p in points.chain(band.into_iter().flatten()).filter(|p| p.0.is_finite() && p.1.is_finite()) {
            (x, y) = ((x.0.min(p.0), x.1.max(p.0)), (y.0.min(p.1), y.1.max(p.1)));
        }
        if x.0 > x.1 {
            (x, y) = ((0.0, 1.0), (0.0, 1.0));
        }
        let pad = |(a, b): (f64, f64)| if b - a < 1e-9 { 0.5 } else { 0.06 * (b - a) };
        let (px, py) = (if self.equal || x.1 - x.0 < 1e-9 { pad(x) } else { 0.0 }, pad(y));
        (x, y) = ((x.0 - px, x.1 + px), (y.0 - py, y.1 + py));
        let (width, height) = self.size();
        let (left, top) = (58.0, 46.0);
        let (w, h) = (width - left - 14.0, height - top - 38.0);
        if self.equal {
            let scale = ((x.1 - x.0) / w).max((y.1 - y.0) / h);
            let (cx, cy) = (0.5 * (x.0 + x.1), 0.5 * (y.0 + y.1));
            x = (cx - 0.5 * scale * w, cx + 0.5 * scale * w);
            y = (cy - 0.5 * scale * h, cy + 0.5 * scale * h);
        }
        Frame { left, top, w, h, x, y }
    }

    fn size(&self) -> (f64, f64) {
        match (self.small, self.equal) {
            (true, _) => (400.0, 236.0),
            (false, true) => (400.0, 420.0),
            (false, false) => (600.0, 300.0),
        }
    }

    /// As an SVG element.
    #[must_use]
    pub fn svg(&self) -> String {
        let f = self.frame();
        let (width, height) = self.size();
        let Frame { left, top, w, h, x, y } = f;
        let time = if self.is_time {
            format!(" data-time=\"{} {} {left} {w} {top} {h} {} {}\"", x.0, x.1, y.0, y.1)
        } else {
            String::new()
        };
        let mut o = format!(
            "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{0}\"{time}><text x=\"0\" y=\"14\" class=\"t\">{0}</text>",
            escape(&self.title)
        );
        if let Some([x0, x1, y0, y1]) = self.band {
            let (bx, by) = (f.sx(x0), f.sy(y1));
            let _ = write!(
                o,
                "<rect class=\"band\" x=\"{bx:.1}\" y=\"{by:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
                f.sx(x1) - bx,
                f.sy(y0) - by
            );
        }
        for (tick, label) in ticks(x.0, x.1) {
            let (sx, below) = (f.sx(tick), top + h);
            let _ = write!(
                o,
                "<path class=\"g\" d=\"M{sx:.1} {top}V{below:.1}\"/><text x=\"{sx:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>",
                below + 15.0
            );
        }
        for (tick, label) in ticks(y.0, y.1) {
            let sy = f.sy(tick);
            let class = if tick == 0.0 { "z" } else { "g" };
            let _ = write!(
                o,
                "<path class=\"{class}\" d=\"M{left} {sy:.1}H{:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
                left + w,
                left - 6.0,
                sy + 4.0
            );
        }
        let _ = write!(
            o,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text><text transform=\"translate(12 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            left + 0.5 * w,
            height - 4.0,
            escape(&self.x_label),
            top + 0.5 * h,
            escape(&self.y_label)
        );
        if let Some((at, name)) = self.mark.as_ref().filter(|(at, _)| (x.0..=x.1).contains(at)) {
            let sx = f.sx(*at);
            let _ = write!(
                o,
                "<path class=\"m\" d=\"M{sx:.1} {top}V{:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                top + h,
                sx + 4.0,
                top + 11.0,
                escape(name)
            );
        }
        self.draw_curves(&f, &mut o);
        o + "</svg>"
    }

    fn draw_curves(&self, f: &Frame, o: &mut String) {
        // Legend in one row under the heading; a character is about 6.2 wide.
        let mut legend_x = 0.0;
        for curve in &self.curves {
            let mut d = String::new();
            let mut dots = String::new();
            for (x, y) in curve.points.iter().filter(|p| p.0.is_finite() && p.1.is_finite()) {
                let (sx, sy) = (f.sx(*x), f.sy(*y));
                let _ = write!(d, "{}{sx:.1} {sy:.1}", if d.is_empty() { 'M' } else { 'L' });
                if curve.pen == Pen::Dots {
                    let _ = write!(
                        dots,
                        "<circle class=\"f{}\" cx=\"{sx:.1}\" cy=\"{sy:.1}\" r=\"1.8\"/>",
                        curve.colour
                    );
                }
            }
            let class = match curve.pen {
                Pen::Line => format!("c s{}", curve.colour),
                Pen::Dashed => format!("c dash s{}", curve.colour),
                Pen::Dots => format!("c dots s{}", curve.colour),
                Pen::Limit => "limit".to_owned(),
            };
            let name = if curve.name.is_empty() || d.is_empty() {
                String::new()
            } else {
                format!(" data-name=\"{}\"", escape(&curve.name))
            };
            let _ = write!(o, "<path class=\"{class}\"{name} d=\"{d}\"/>{dots}");
            if !curve.name.is_empty() {
                let _ = write!(
                    o,
                    "<path class=\"{class}\" d=\"M{legend_x:.1} 29h16\"/><text x=\"{:.1}\" y=\"33\">{}</text>",
                    legend_x + 20.0,
                    escape(&curve.name)
                );
                legend_x += 32.0 + 6.2 * curve.name.chars().count() as f64;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let labels: Vec<String> = ticks(-0.11, 0.32).into_iter().map(|t| t.1).collect();
        assert_eq!(labels, ["−0.1", "0.0", "0.1", "0.2", "0.3"]);
        assert!(ticks(0.0, 1e-15).len() < 41, "a span of nothing ends too");
    }

    #[test]
    fn a_chart_without_points_and_one_with_numbers_that_are_none_can_be_drawn() {
        let empty = Chart { title: "a < b".to_owned(), ..Chart::default() }.svg();
        assert!(empty.contains("a &lt; b") && empty.ends_with("</svg>"));
        let bad = vec![(0.0, f64::NAN), (1.0, 2.0), (f64::INFINITY, 1.0), (2.0, 3.0)];
        let svg = Chart { curves: vec![Curve::line("x", 0, bad)], ..Chart::default() }.svg();
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }

    #[test]
    fn a_mark_outside_the_curves_is_not_drawn() {
        let chart = |at| Chart {
            curves: vec![Curve::line("", 0, vec![(0.0, 1.0), (0.5, 2.0)])],
            mark: Some((at, "release".to_owned())),
            ..Chart::default()
        };
        assert!(chart(0.4).svg().contains("release"));
        assert!(!chart(0.7).svg().contains("release"));
    }
}
