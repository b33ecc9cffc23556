//! Frames on the bus: one lane per drive, one for broadcasts, one for the host link.

use operator::analysis::bus::{Slot, Traffic};
use operator::log::facts::{Decoder, Fact};
use protocol::powercube::Address;
use serde::Serialize;

/// The frames of a stretch of time of the plan.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Timeline {
    from_ms: f64,
    to_ms: f64,
    lanes: Vec<String>,
    frames: Vec<Shown>,
}

#[derive(Clone, Debug, Serialize)]
struct Shown {
    lane: usize,
    kind: &'static str,
    /// Begin and end, ms.
    from: f64,
    to: f64,
    what: String,
}

impl Timeline {
    /// The frames from one time to another, s. `drives` are addresses and names of the drives.
    pub(super) fn of(slots: &[Slot], from_t_s: f64, to_t_s: f64, drives: &[(u8, String)]) -> Self {
        let frame = |slot: &Slot| {
            let lane = match Address::of(slot.frame.id()) {
                Some(Address::Module(_, module)) => {
                    drives.iter().position(|(known, _)| *known == module.get())?
                }
                Some(Address::Broadcast) => drives.len(),
                None => drives.len() + 1,
            };
            let kind = name(Traffic::of(&slot.frame));
            let what = format!("{} {}", slot.frame, in_words(slot));
            Some(Shown { lane, kind, from: 1e3 * slot.from_t_s, to: 1e3 * slot.to_t_s, what })
        };
        let within = slots.iter().filter(|slot| slot.to_t_s >= from_t_s && slot.from_t_s <= to_t_s);
        let names = drives.iter().map(|(_, name)| name.as_str()).chain(["broadcast", "host link"]);
        Self {
            from_ms: 1e3 * from_t_s,
            to_ms: 1e3 * to_t_s,
            lanes: names.map(str::to_owned).collect(),
            frames: within.filter_map(frame).collect(),
        }
    }
}

/// Name of a kind of frame.
pub(super) const fn name(traffic: Traffic) -> &'static str {
    match traffic {
        Traffic::Request => "request",
        Traffic::Answer => "answer",
        Traffic::Broadcast => "broadcast",
        Traffic::HostLink => "host link",
        Traffic::Foreign => "foreign",
    }
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
