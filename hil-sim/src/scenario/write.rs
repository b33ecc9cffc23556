//! Scenarios as text, so that a run with a finding can be repeated from a file.
//!
//! Faults, actions and the varied options of the cell are written. Other options must be the default.

use std::fmt::Write as _;

use protocol::{Duration, Id, Instant};
use toml_reader::quoted;

use super::{Action, Scenario};
use crate::fault::{Fault, FaultKind, Moment, PhysicalFault, Target, WireFault, WrongPart};

/// Seconds that read back as the same microseconds.
fn seconds(span: Duration) -> String {
    let us = span.as_micros();
    format!("{}.{:06}", us / 1_000_000, us % 1_000_000)
}

fn real(value: f64) -> String {
    // `{:?}` gives the shortest text that reads back as the same number, with a point.
    format!("{value:?}")
}

/// Rounded to ten decimals, so that the angle that is read back is written as the same text.
fn degrees(angle_rad: f64) -> f64 {
    (1e10 * angle_rad.to_degrees()).round() / 1e10
}

fn id(id: Id) -> String {
    if id.is_extended() { format!("{:08X}", id.raw()) } else { format!("{:03X}", id.raw()) }
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
    ];
    if fault.start < Instant::FAR_FUTURE {
        lines.push(format!("start_s = {}", seconds(fault.start.saturating_since(Instant::ZERO))));
    }
    if let Some(at) = fault.at {
        let moment = if at.moment == Moment::Start { "start" } else { "release" };
        let sign = if at.offset_us < 0 { '-' } else { '+' };
        let span = seconds(Duration::from_micros(at.offset_us.unsigned_abs()));
        lines.push(format!("at = \"{moment} {sign} {span} s\""));
    }
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
        FaultKind::Wire(WireFault::Babble { frame, period }) => {
            key("frame", format!("\"{frame}\""));
            key("period_s", real(period.as_secs_f64()));
        }
        FaultKind::Physical(_, PhysicalFault::Slow(by) | PhysicalFault::LateRelease(by)) => {
            key("by_s", seconds(*by));
        }
        FaultKind::Physical(_, PhysicalFault::EncoderOffset { offset_rad }) => {
            key("offset_deg", real(degrees(*offset_rad)));
        }
        FaultKind::Physical(_, PhysicalFault::SupplyLoss { remaining }) => key("remaining", real(*remaining)),
        FaultKind::Wire(_) | FaultKind::Physical(..) => {}
    }
    lines
}

fn action_lines(action: &Action) -> Vec<String> {
    let frames: Vec<String> = action.frames.iter().map(|frame| format!("\"{frame}\"")).collect();
    let mut lines = vec![
        format!("at_s = {}", seconds(action.at.saturating_since(Instant::ZERO))),
        format!("send = [{}]", frames.join(", ")),
    ];
    lines.extend(action.every.map(|every| format!("every_s = {}", seconds(every))));
    lines.extend(action.count.map(|count| format!("count = {count}")));
    lines
}

/// Options of the cell that differ from the default, by table.
fn tables(scenario: &Scenario) -> Vec<(&'static str, Vec<String>)> {
    let (cell, default) = (&scenario.cell, Scenario::default().cell);
    let mut own = Vec::new();
    if let Some(q) = &cell.start_q_rad {
        let list: Vec<String> = q.iter().map(|q| real(*q)).collect();
        own.push(format!("start_q_rad = [{}]", list.join(", ")));
    }
    if !cell.mounting.is_empty() {
        let inverted: Vec<bool> = cell.mounting.iter().map(|joint| joint.inverted).collect();
        let offsets: Vec<String> = cell.mounting.iter().map(|joint| real(joint.offset_rad)).collect();
        own.push(format!("inverted = {inverted:?}\noffset_rad = [{}]", offsets.join(", ")));
    }
    let flag = |lines: &mut Vec<String>, key: &str, value: bool, default: bool| {
        if value != default {
            lines.push(format!("{key} = {value}"));
        }
    };
    let span = |lines: &mut Vec<String>, key: &str, value: Duration, default: Duration| {
        if value != default {
            lines.push(format!("{key} = {}", seconds(value)));
        }
    };
    let number = |lines: &mut Vec<String>, key: &str, value: f64, default: f64| {
        if value != default {
            lines.push(format!("{key} = {}", real(value)));
        }
    };
    flag(&mut own, "finger_release", cell.finger_release, default.finger_release);
    flag(&mut own, "cold_start", cell.cold_start, default.cold_start);
    flag(&mut own, "logic_on_motor_supply", cell.logic_on_motor_supply, default.logic_on_motor_supply);
    flag(&mut own, "servos_extrapolate", cell.servos_extrapolate, default.servos_extrapolate);
    let (mut drive, d) = (Vec::new(), &default.drive);
    flag(&mut drive, "starts_homed", cell.drive.starts_homed, d.starts_homed);
    span(&mut drive, "processing_delay_s", cell.drive.processing_delay, d.processing_delay);
    span(&mut drive, "processing_jitter_s", cell.drive.processing_jitter, d.processing_jitter);
    span(&mut drive, "watchdog_timeout_s", cell.drive.watchdog_timeout, d.watchdog_timeout);
    let (mut gripper, d) = (Vec::new(), &default.gripper);
    span(&mut gripper, "delay_s", cell.gripper.delay, d.delay);
    span(&mut gripper, "jitter_s", cell.gripper.jitter, d.jitter);
    let (mut scatter, d) = (Vec::new(), &default.scatter);
    let s = &cell.scatter;
    number(&mut scatter, "mass_share", s.mass_share, d.mass_share);
    number(&mut scatter, "com_m", s.com_m, d.com_m);
    number(&mut scatter, "friction_share", s.friction_share, d.friction_share);
    number(&mut scatter, "rotor_share", s.rotor_share, d.rotor_share);
    number(&mut scatter, "current_share", s.current_share, d.current_share);
    number(&mut scatter, "delay_share", s.delay_share, d.delay_share);
    number(&mut scatter, "home_deg", degrees(s.home_rad), degrees(d.home_rad));
    span(&mut scatter, "gripper_delay_s", s.gripper_delay, d.gripper_delay);
    vec![("cell", own), ("drive", drive), ("gripper", gripper), ("scatter", scatter)]
}

/// A whole scenario file; `comments` come first, one line each.
pub fn scenario(scenario: &Scenario, comments: &[String]) -> String {
    let mut text = String::new();
    for comment in comments {
        let _ = writeln!(text, "# {}", comment.replace(['\n', '\r'], " "));
    }
    let _ = writeln!(text, "schema_version = {}", super::SCHEMA_VERSION);
    let _ = writeln!(text, "name = {}", quoted(&scenario.name));
    let _ = writeln!(text, "robot = {}", quoted(&scenario.robot));
    let _ = writeln!(text, "seed = {}", scenario.seed);
    let _ = writeln!(text, "duration_s = {}", seconds(scenario.duration));
    let mut table = |header: &str, lines: &[String]| {
        let _ = writeln!(text, "\n{header}");
        for line in lines {
            let _ = writeln!(text, "{line}");
        }
    };
    for (name, lines) in tables(scenario) {
        if !lines.is_empty() {
            table(&format!("[{name}]"), &lines);
        }
    }
    for action in &scenario.actions {
        table("[[action]]", &action_lines(action));
    }
    for fault in &scenario.faults {
        table("[[fault]]", &fault_lines(fault));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
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
