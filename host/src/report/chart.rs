//! Line charts as inline SVG: few lines, limits dashed, an event marked.
//!
//! Colours come from the page's style (classes `s0` to `s7`), so that one chart serves light and dark pages. Charts
//! over time carry their frame in `data-time`, from which the page's script draws the present time. Their curves carry names,
//! times and values of their points, which the script shows under the pointer: nothing is read back from the picture.

use std::borrow::Cow;
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
    /// Only the dots.
    Marks,
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
    /// The frame is chosen without it; what lies outside the frame is not drawn.
    pub beside: bool,
}

/// Most points of a curve that are drawn: of a run of ten minutes the pages would have hundreds of megabytes.
const POINTS_MAX: usize = 2_000;
/// A chart is longer than its data by this share, so that it shows a fault just after their end.
const FAULT_BEYOND: f64 = 0.05;
const WIDTH: f64 = 400.0;
/// Height of a row of a legend.
const LEGEND_ROW: f64 = 15.0;

impl Curve {
    /// Whether it has a point that can be drawn.
    fn is_drawn(&self) -> bool {
        self.points.iter().any(|p| p.0.is_finite() && p.1.is_finite())
    }

    /// The points that are drawn. Where there are too many, of neighbours the lowest and the highest one.
    fn shown(&self) -> Cow<'_, [(f64, f64)]> {
        if self.points.len() <= POINTS_MAX {
            return Cow::Borrowed(&self.points);
        }
        let size = (2 * self.points.len()).div_ceil(POINTS_MAX);
        let ends = |some: &[(f64, f64)]| {
            let order = |a: &(f64, f64), b: &(f64, f64)| a.1.total_cmp(&b.1);
            let mut ends: Vec<_> = some.iter().copied().min_by(order).into_iter().collect();
            ends.extend(some.iter().copied().max_by(order));
            ends.sort_by(|a, b| a.0.total_cmp(&b.0));
            ends.dedup();
            ends
        };
        Cow::Owned(self.points.chunks(size).flat_map(ends).collect())
    }

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
#[derive(Debug, Clone, Default)]
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
    /// Same scale on both axes.
    pub equal: bool,
    /// x is time of the plan.
    pub is_time: bool,
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

/// Four digits of a number, as short as they can be written.
fn short(value: f64) -> String {
    format!("{value:.3e}").parse::<f64>().map_or_else(|_| String::new(), |rounded| rounded.to_string())
}

/// A time in s as milliseconds, to 10 µs, as short as they can be written.
fn milliseconds(time_s: f64) -> f64 {
    // Zero without a sign.
    (time_s * 1e5).round() / 1e2 + 0.0
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
        let points = self.curves.iter().filter(|c| !c.beside).flat_map(|c| &c.points).copied();
        let band = self.band.map(|[x0, x1, y0, y1]| [(x0, y0), (x1, y1)]);
        let (mut x, mut y) = ((f64::INFINITY, f64::NEG_INFINITY), (f64::INFINITY, f64::NEG_INFINITY));
        for p in points.chain(band.into_iter().flatten()).filter(|p| p.0.is_finite() && p.1.is_finite()) {
            (x, y) = ((x.0.min(p.0), x.1.max(p.0)), (y.0.min(p.1), y.1.max(p.1)));
        }
        if x.0 > x.1 {
            (x, y) = ((0.0, 1.0), (0.0, 1.0));
        }
        if let Some((low, high)) = self.y_at_least {
            y = (y.0.min(low), y.1.max(high));
        }
        // What is recorded may end just before the fault that ended it.
        let near = FAULT_BEYOND * (x.1 - x.0);
        if let Some((at, _)) = &self.fault
            && (x.1..=x.1 + near).contains(at)
        {
            x.1 += near;
        }
        let pad = |(a, b): (f64, f64)| if b - a < 1e-9 { 0.5 } else { 0.06 * (b - a) };
        let (px, py) = (if self.equal || x.1 - x.0 < 1e-9 { pad(x) } else { 0.0 }, pad(y));
        (x, y) = ((x.0 - px, x.1 + px), (y.0 - py, y.1 + py));
        let (width, height) = self.size();
        // Numbers of the vertical axis stand beside its name.
        let longest = ticks(y.0, y.1).iter().map(|(_, label)| label.chars().count()).max().unwrap_or(0);
        let left = 27.0 + 6.2 * longest.max(5) as f64;
        let top = 46.0 + self.legend_more();
        let (w, h) = (width - left - 14.0, height - top - 38.0);
        if self.equal {
            let scale = ((x.1 - x.0) / w).max((y.1 - y.0) / h);
            let (cx, cy) = (0.5 * (x.0 + x.1), 0.5 * (y.0 + y.1));
            x = (cx - 0.5 * scale * w, cx + 0.5 * scale * w);
            y = (cy - 0.5 * scale * h, cy + 0.5 * scale * h);
        }
        Frame { left, top, w, h, x, y }
    }

    /// One width for all, so that letters of all charts have one size.
    fn size(&self) -> (f64, f64) {
        (WIDTH, if self.equal { 400.0 } else { 236.0 } + self.legend_more())
    }

    /// Left end and row of each curve's name in the legend; a row that is full is followed by another.
    fn legend(&self) -> Vec<(f64, u32)> {
        let (mut x, mut row) = (0.0, 0);
        let mut places = Vec::with_capacity(self.curves.len());
        for curve in &self.curves {
            let is_named = !curve.name.is_empty() && curve.is_drawn();
            // A character is about 6.2 wide.
            let length = if is_named { 30.0 + 6.2 * curve.name.chars().count() as f64 } else { 0.0 };
            if x > 0.0 && x + length - 10.0 > WIDTH {
                (x, row) = (0.0, row + 1);
            }
            places.push((x, row));
            x += length;
        }
        places
    }

    /// Height of the rows of the legend after the first.
    fn legend_more(&self) -> f64 {
        LEGEND_ROW * f64::from(self.legend().last().map_or(0, |place| place.1))
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
        self.draw_curves(&f, &mut o);
        for (mark, class, below) in [(&self.mark, "m", 11.0), (&self.fault, "m fault", 24.0)] {
            if let Some((at, name)) = mark.as_ref().filter(|(at, _)| (x.0..=x.1).contains(at)) {
                let sx = f.sx(*at);
                // Beside the line where there is room.
                let (tx, anchor) = if sx > left + 0.8 * w { (sx - 4.0, "end") } else { (sx + 4.0, "start") };
                let _ = write!(
                    o,
                    "<path class=\"{class}\" d=\"M{sx:.1} {top}V{:.1}\"/><text x=\"{tx:.1}\" y=\"{:.1}\" class=\"e\" text-anchor=\"{anchor}\">{}</text>",
                    top + h,
                    top + below,
                    escape(name)
                );
            }
        }
        o + "</svg>"
    }

    fn draw_curves(&self, f: &Frame, o: &mut String) {
        let mut times_before = String::new();
        for (curve, (legend_x, row)) in self.curves.iter().zip(self.legend()) {
            let below = LEGEND_ROW * f64::from(row);
            let (mut d, mut dots, mut times, mut values) =
                (String::new(), String::new(), String::new(), String::new());
            let mut pen_is_up = true;
            for (x, y) in curve.shown().iter().filter(|p| p.0.is_finite() && p.1.is_finite()) {
                if !(f.x.0..=f.x.1).contains(x) || !(f.y.0..=f.y.1).contains(y) {
                    pen_is_up = true;
                    continue;
                }
                let (sx, sy) = (f.sx(*x), f.sy(*y));
                let _ = write!(d, "{}{sx:.1} {sy:.1}", if pen_is_up { 'M' } else { 'L' });
                let space = if values.is_empty() { "" } else { " " };
                let _ = write!(times, "{space}{}", milliseconds(*x));
                let _ = write!(values, "{space}{}", short(*y));
                pen_is_up = false;
                if matches!(curve.pen, Pen::Dots | Pen::Marks) {
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
                Pen::Marks => "c".to_owned(),
                Pen::Limit => "limit".to_owned(),
            };
            // The curve of a chart that has one is named by its heading.
            let name = if curve.name.is_empty() { &self.title } else { &curve.name };
            let told = if self.is_time && curve.pen != Pen::Limit && !d.is_empty() {
                // Most curves of a chart share their times, which are written once.
                let own = if times == times_before { String::new() } else { format!(" data-ms=\"{times}\"") };
                times_before = times;
                format!(" data-name=\"{}\"{own} data-values=\"{values}\"", escape(name))
            } else {
                String::new()
            };
            let _ = write!(o, "<path class=\"{class}\"{told} d=\"{d}\"/>{dots}");
            if !curve.name.is_empty() {
                let _ = write!(
                    o,
                    "<path class=\"{class}\" d=\"M{legend_x:.1} {:.1}h16\"/><text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                    29.0 + below,
                    legend_x + 20.0,
                    33.0 + below,
                    escape(&curve.name)
                );
                if matches!(curve.pen, Pen::Dots | Pen::Marks) {
                    let _ = write!(
                        o,
                        "<circle class=\"f{}\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"1.8\"/>",
                        curve.colour,
                        legend_x + 8.0,
                        29.0 + below
                    );
                }
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
    fn a_legend_that_is_too_long_goes_on_in_a_row_below() {
        let curve = |name: &str| Curve::line(name, 0, vec![(0.0, 0.0), (1.0, 1.0)]);
        let names = ["actual", "flight", "accelerate", "follow the parabola", "decelerate"];
        let long = Chart { curves: names.map(curve).to_vec(), equal: true, ..Chart::default() };
        let legend = long.legend();
        assert!(legend.iter().zip(names).all(|((x, _), name)| x + 20.0 + 6.2 * name.len() as f64 <= 400.0));
        assert_eq!(legend.iter().map(|place| place.1).collect::<Vec<_>>(), [0, 0, 0, 0, 1]);
        let short =
            Chart { curves: vec![curve("actual"), Curve::limit((0.0, 1.0), 1.0)], ..Chart::default() };
        assert_eq!((short.legend_more(), long.legend_more()), (0.0, LEGEND_ROW));
        assert_eq!((short.size().1, long.size().1), (236.0, 400.0 + LEGEND_ROW));
    }

    #[test]
    fn a_fault_just_after_the_last_sample_is_marked_and_a_distant_one_is_not() {
        let chart = |fault_s: f64| Chart {
            curves: vec![Curve::line("", 0, vec![(0.0, 0.0), (1.0, 1.0)])],
            fault: Some((fault_s, "fault 104".to_owned())),
            ..Chart::default()
        };
        assert!(chart(0.5).svg().contains("fault 104") && chart(1.01).svg().contains("fault 104"));
        assert_eq!((chart(1.01).frame().x, chart(3.0).frame().x), ((0.0, 1.05), (0.0, 1.0)));
        assert!(!chart(3.0).svg().contains("fault 104"));
    }

    #[test]
    fn long_numbers_of_the_vertical_axis_leave_room_for_its_name() {
        let left = |y: f64| {
            let points = vec![(0.0, 3.1211), (1.0, 3.1211 + y)];
            Chart { curves: vec![Curve::line("", 0, points)], ..Chart::default() }.frame().left
        };
        assert_eq!((left(1.0), left(0.000_4)), (58.0, 27.0 + 6.2 * 6.0));
    }

    #[test]
    fn a_chart_without_points_and_one_with_nan_can_be_drawn() {
        let empty = Chart { title: "a < b".to_owned(), ..Chart::default() }.svg();
        assert!(empty.contains("a &lt; b") && empty.ends_with("</svg>"));
        let bad = vec![(0.0, f64::NAN), (1.0, 2.0), (f64::INFINITY, 1.0), (2.0, 3.0)];
        let svg = Chart { curves: vec![Curve::line("x", 0, bad)], ..Chart::default() }.svg();
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }

    #[test]
    fn curve_of_very_many_points_keeps_its_lowest_and_highest_ones() {
        let mut points: Vec<(f64, f64)> = (0..200_000).map(|k| (f64::from(k), f64::from(k % 7))).collect();
        (points[77_777].1, points[123_456].1) = (1_000.0, -1_000.0);
        let curve = Curve::line("", 0, points.clone());
        let shown = curve.shown();
        assert!((1_000..=2_000).contains(&shown.len()), "{}", shown.len());
        assert!(shown.contains(&points[77_777]) && shown.contains(&points[123_456]));
        assert!(shown.windows(2).all(|pair| pair[0].0 < pair[1].0));
        let few = Curve::line("", 0, points[..2_000].to_vec());
        assert_eq!(few.shown().as_ref(), &points[..2_000]);
    }

    #[test]
    fn a_curve_over_time_carries_the_values_that_its_points_have() {
        let points = vec![(0.0, 0.001_234_56), (0.5, -2.0), (1.0, 12_345.6)];
        let chart = |name: &str| Chart {
            title: "heading".to_owned(),
            curves: vec![Curve::line(name, 0, points.clone()), Curve::limit((0.0, 1.0), 3.0)],
            is_time: true,
            ..Chart::default()
        };
        let svg = chart("speed").svg();
        assert!(
            svg.contains("data-name=\"speed\" data-ms=\"0 500 1000\" data-values=\"0.001235 -2 12350\""),
            "{svg}"
        );
        assert!(chart("").svg().contains("data-name=\"heading\""));
        assert_eq!(svg.matches("data-values").count(), 1, "a limit is no value");
    }

    #[test]
    fn times_are_written_once_for_curves_that_share_them() {
        let curve = |name: &str, times: [f64; 2]| Curve::line(name, 0, times.map(|t_s| (t_s, t_s)).to_vec());
        let curves =
            vec![curve("a", [-0.0, 0.012_344]), curve("b", [0.0, 0.012_344]), curve("c", [0.1, 0.2])];
        let svg = Chart { curves, is_time: true, ..Chart::default() }.svg();
        assert!(svg.contains("data-name=\"a\" data-ms=\"0 12.34\" data-values"), "{svg}");
        assert!(svg.contains("data-name=\"b\" data-values") && svg.contains("data-ms=\"100 200\""), "{svg}");
    }

    #[test]
    fn a_curve_beside_does_not_set_the_frame_and_is_not_drawn_outside_it() {
        let near = Curve::line("near", 0, vec![(0.0, 0.0), (1.0, 1.0), (2.0, 0.5)]);
        let far =
            Curve::line("far", 7, vec![(0.0, 3.0), (0.5, 0.2), (1.0, 0.4), (1.5, -3.0), (2.0, 0.3)]).beside();
        let alone = Chart { curves: vec![near.clone()], is_time: true, ..Chart::default() }.svg();
        let both = Chart { curves: vec![near, far], is_time: true, ..Chart::default() }.svg();
        let frame =
            |svg: &str| svg.split("data-time=\"").nth(1).unwrap().split('"').next().unwrap().to_owned();
        assert_eq!(frame(&alone), frame(&both));
        let drawn = both.split("data-name=\"far\"").nth(1).unwrap().split("d=\"").nth(1).unwrap();
        let d = drawn.split('"').next().unwrap();
        assert_eq!((d.matches('M').count(), d.matches('L').count()), (2, 1), "{d}");
        assert!(both.contains("data-values=\"0.2 0.4 0.3\""), "{both}");
    }

    #[test]
    fn a_fault_is_marked_beside_the_release() {
        let chart = Chart {
            curves: vec![Curve::line("", 0, vec![(0.0, 1.0), (1.0, 2.0)])],
            mark: Some((0.4, "release".to_owned())),
            fault: Some((0.95, "fault".to_owned())),
            ..Chart::default()
        };
        let svg = chart.svg();
        assert!(svg.contains("class=\"m fault\"") && svg.contains(">release<"), "{svg}");
        assert!(svg.contains("text-anchor=\"end\">fault<"), "it stays inside the frame");
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
