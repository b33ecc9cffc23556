//! Frames on the bus: one lane per drive, one for broadcasts, one for the host link.

use std::fmt::Write as _;

use protocol::powercube::Address;

use super::chart::escape;
use operator::analysis::bus::{Slot, Traffic};
use operator::log::facts::{Decoder, Fact};

const WIDTH: f64 = 1200.0;
const LEFT: f64 = 120.0;
const LANE: f64 = 24.0;
const TOP: f64 = 26.0;
/// More numbers would touch each other.
const TICKS_MAX: i64 = 25;

/// The frames from `from_t_s` to `to_t_s` as an SVG element. `lanes` are addresses and names of the drives.
#[must_use]
pub fn svg(slots: &[Slot], from_t_s: f64, to_t_s: f64, lanes: &[(u8, String)]) -> String {
    let rows = lanes.len() + 2;
    let height = TOP + LANE * rows as f64 + 34.0;
    let w = WIDTH - LEFT - 8.0;
    let sx = |t_s: f64| LEFT + (t_s - from_t_s) / (to_t_s - from_t_s) * w;
    let mut o =
        format!("<svg viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" aria-label=\"frames on the bus\">");
    let key = [("request", 0), ("answer", 2), ("broadcast", 1), ("host link", 3)];
    for (i, (name, colour)) in key.iter().enumerate() {
        let x = LEFT + 110.0 * i as f64;
        let _ = write!(
            o,
            "<rect class=\"f{colour}\" x=\"{x:.1}\" y=\"4\" width=\"12\" height=\"11\" rx=\"2\"/><text x=\"{:.1}\" y=\"14\">{name}</text>",
            x + 17.0
        );
    }
    let names = lanes.iter().map(|(_, name)| name.as_str()).chain(["broadcast", "host link"]);
    for (row, name) in names.enumerate() {
        let y = TOP + LANE * row as f64;
        let _ = write!(
            o,
            "<path class=\"g\" d=\"M{LEFT} {:.1}H{:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            y + LANE,
            LEFT + w,
            LEFT - 8.0,
            y + 16.0,
            escape(name)
        );
    }
    let floor = TOP + LANE * rows as f64;
    for ms in ticks_ms(from_t_s, to_t_s) {
        let x = sx(ms as f64 * 1e-3);
        let _ = write!(
            o,
            "<path class=\"g\" d=\"M{x:.1} {TOP}V{floor:.1}\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{ms}</text>",
            floor + 14.0
        );
    }
    let _ = write!(
        o,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">time of the plan in ms</text>",
        LEFT + 0.5 * w,
        floor + 30.0
    );
    for slot in slots.iter().filter(|s| s.to_t_s >= from_t_s && s.from_t_s <= to_t_s) {
        let traffic = Traffic::of(&slot.frame);
        let lane = match Address::of(slot.frame.id()) {
            Some(Address::Module(_, module)) => lanes.iter().position(|(known, _)| *known == module.get()),
            Some(Address::Broadcast) => Some(lanes.len()),
            None => Some(lanes.len() + 1),
        };
        let Some(lane) = lane else { continue };
        let (a, b) = (sx(slot.from_t_s.max(from_t_s)), sx(slot.to_t_s.min(to_t_s)));
        let colour = match traffic {
            Traffic::Request => 0,
            Traffic::Answer => 2,
            Traffic::Broadcast => 1,
            Traffic::HostLink => 3,
            Traffic::Foreign => 7,
        };
        let _ = write!(
            o,
            "<rect class=\"f{colour}\" x=\"{a:.2}\" y=\"{:.1}\" width=\"{:.2}\" height=\"{:.1}\" rx=\"1.5\"><title>{:.3} ms to {:.3} ms: {} {}</title></rect>",
            TOP + LANE * lane as f64 + 4.0,
            (b - a - 0.6).max(0.8),
            LANE - 7.0,
            slot.from_t_s * 1e3,
            slot.to_t_s * 1e3,
            slot.frame,
            escape(&in_words(slot))
        );
    }
    o + "</svg>"
}

/// Whole milliseconds with a number below them, at most [`TICKS_MAX`]: the fewest steps of 1, 2 or 5 times a power of ten.
fn ticks_ms(from_t_s: f64, to_t_s: f64) -> impl Iterator<Item = i64> {
    let steps = (0..).flat_map(|power| [1, 2, 5].map(|digit| digit * 10_i64.pow(power)));
    let span_ms = (to_t_s - from_t_s) * 1e3;
    let step = steps.into_iter().find(|step| span_ms <= (TICKS_MAX * step) as f64).unwrap_or(1);
    let first = (from_t_s * 1e3 / step as f64).ceil() as i64;
    let last = (to_t_s * 1e3 / step as f64).floor() as i64;
    (first..=last).map(move |tick| tick * step)
}

/// What a frame of a drive says.
fn in_words(slot: &Slot) -> String {
    // Frames of drives need nothing from before them.
    match Decoder::default().take(protocol::Instant::ZERO, &slot.frame) {
        Some(Fact::Request { request, .. }) => format!("{request:?}"),
        Some(Fact::Reply { reply, .. }) => format!("{reply:?}"),
        Some(Fact::Broadcast(broadcast)) => format!("{broadcast:?}"),
        _ => "part of a message".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_the_time_axis_keep_apart_for_short_and_long_cycles() {
        assert_eq!(ticks_ms(0.4971, 0.5029).collect::<Vec<_>>(), [498, 499, 500, 501, 502]);
        let long: Vec<i64> = ticks_ms(0.452, 0.542).collect();
        assert_eq!((long.first(), long.last(), long.len()), (Some(&455), Some(&540), 18));
        for period_ms in [3.0, 5.0, 10.0, 17.0, 30.0, 40.0, 400.0] {
            assert!(ticks_ms(-0.0015 * period_ms, 0.0015 * period_ms).count() <= 26, "{period_ms}");
        }
    }
}
