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
    let first_ms = (from_t_s * 1e3).ceil() as i64;
    for ms in first_ms..=(to_t_s * 1e3).floor() as i64 {
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
