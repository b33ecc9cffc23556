//! Faults as the text of a scenario file, so that a run that was found can be repeated.

use std::fmt::Write as _;

use protocol::{Duration, Frame, Id};

use crate::fault::{Fault, FaultKind, PhysicalFault, Target, WireFault, WrongPart};

/// Seconds that read back as the same microseconds.
fn seconds(span: Duration) -> String {
    let us = span.as_micros();
    format!("{}.{:06}", us / 1_000_000, us % 1_000_000)
}

fn real(value: f64) -> String {
    // `{:?}` gives the shortest text that reads back as the same number, with a point.
    format!("{value:?}")
}

fn id(id: Id) -> String {
    if id.is_extended() { format!("{:08X}", id.raw()) } else { format!("{:03X}", id.raw()) }
}

/// A frame as candump writes it.
pub fn frame(frame: &Frame) -> String {
    frame.to_string()
}

fn target(target: Target) -> String {
    match target {
        Target::Bus => "bus".to_owned(),
        Target::Module(module) => format!("module {module}"),
        Target::Supply(index) => format!("supply {index}"),
        Target::Gripper => "gripper".to_owned(),
    }
}

/// The lines of a `[[fault]]` table, without its header.
pub fn fault_lines(fault: &Fault) -> Vec<String> {
    let mut lines = vec![
        format!("kind = \"{}\"", fault.kind_name()),
        format!("target = \"{}\"", target(fault.target)),
        format!("label = {}", quoted(&fault.label)),
        format!("start_s = {}", seconds(fault.start.saturating_since(protocol::Instant::ZERO))),
    ];
    let mut key = |name: &str, value: String| lines.push(format!("{name} = {value}"));
    if let Some(length) = fault.length {
        key("length_s", seconds(length));
    }
    if let Some(every) = fault.every {
        key("every_s", seconds(every));
    }
    if fault.probability < 1.0 {
        key("probability", real(fault.probability));
    }
    if let Some(filter) = fault.filter {
        key("id", format!("\"{}\"", id(filter.id)));
        key("id_mask", filter.mask.to_string());
    }
    match &fault.kind {
        FaultKind::Wire(WireFault::Delay(by)) => key("by_s", seconds(*by)),
        FaultKind::Wire(WireFault::WrongAnswer(part)) => {
            let part = match part {
                WrongPart::Value => "value",
                WrongPart::Parameter => "parameter",
                WrongPart::Command => "command",
                WrongPart::Length => "length",
            };
            key("part", format!("\"{part}\""));
        }
        FaultKind::Wire(WireFault::Intermittent { on_mean, off_mean }) => {
            key("on_mean_s", seconds(*on_mean));
            key("off_mean_s", seconds(*off_mean));
        }
        FaultKind::Wire(WireFault::Babble { frame: sent, period }) => {
            key("frame", format!("\"{}\"", frame(sent)));
            key("period_s", real(period.as_secs_f64()));
        }
        FaultKind::Physical(_, PhysicalFault::Slow(by) | PhysicalFault::LateRelease(by)) => {
            key("by_s", seconds(*by));
        }
        FaultKind::Physical(_, PhysicalFault::EncoderOffset { offset_rad }) => {
            key("offset_deg", real(offset_rad.to_degrees()));
        }
        FaultKind::Physical(_, PhysicalFault::SupplyLoss { remaining }) => key("remaining", real(*remaining)),
        FaultKind::Wire(_) | FaultKind::Physical(..) => {}
    }
    lines
}

/// A `[[fault]]` table.
pub fn fault_table(fault: &Fault) -> String {
    let mut text = "[[fault]]\n".to_owned();
    for line in fault_lines(fault) {
        let _ = writeln!(text, "{line}");
    }
    text
}

fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out.push('"');
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;
    use crate::swarm;
    use protocol::ModuleId;

    #[test]
    fn written_faults_read_back_as_they_were() {
        let modules: Vec<ModuleId> = (1..=6).filter_map(|n| ModuleId::new(n).ok()).collect();
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..60 {
            for mut fault in swarm::scenario(&Scenario::default(), seed, &modules).faults {
                // Only faults that act on frames take a filter in a file.
                if !matches!(&fault.kind, FaultKind::Wire(wire) if wire.is_per_frame()) {
                    fault.filter = None;
                }
                // Drawn anywhere; in a file only where it can act.
                let line = fault_lines(&fault).join(", ");
                let Ok(mut back) = crate::scenario::fault_from_line(&line, 0) else {
                    assert!(line.contains("bus"), "seed {seed}: {line}");
                    continue;
                };
                if let (
                    FaultKind::Physical(_, PhysicalFault::EncoderOffset { offset_rad: a }),
                    FaultKind::Physical(_, PhysicalFault::EncoderOffset { offset_rad: b }),
                ) = (&fault.kind, &mut back.kind)
                {
                    assert!((a - *b).abs() < 1e-12, "{line}");
                    *b = *a;
                }
                assert_eq!(back, fault, "seed {seed}: {line}");
                seen.insert(fault.kind_name());
            }
        }
        assert_eq!(seen.len(), 19, "{seen:?}");
    }
}
