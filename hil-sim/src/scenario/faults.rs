//! `[[fault]]` tables: every kind, the places it can act on and the keys it takes.

use protocol::{Duration, ExtendedId, Id, Instant, ModuleId, StandardId};
use toml_reader::Value;

use super::values::{frames, period, seconds};
use super::{Problem, ScenarioError, Section};
use crate::fault::{
    Fault, FaultKind, IdFilter, Moment, PhysicalFault, Place, Target, ThrowTime, WireFault, WrongPart,
};

/// Longest time a scenario can name: eleven days.
const MAX_S: f64 = 1e6;
/// Shortest period of a babbling node, s.
const BABBLE_PERIOD_MIN_S: f64 = 20e-6;

const KINDS: [(&str, Kind); 19] = [
    ("drop", Kind::Drop),
    ("delay", Kind::Delay),
    ("duplicate", Kind::Duplicate),
    ("corrupt", Kind::Corrupt),
    ("wrong-answer", Kind::WrongAnswer),
    ("stuck", Kind::Stuck),
    ("slow", Kind::Slow),
    ("intermittent", Kind::Intermittent),
    ("babble", Kind::Babble),
    ("silent", Kind::Silent),
    ("restart", Kind::Restart),
    ("supply-loss", Kind::SupplyLoss),
    ("over-current", Kind::OverCurrent),
    ("tow-error", Kind::TowError),
    ("hall-error", Kind::HallError),
    ("encoder-error", Kind::EncoderError),
    ("bus-off", Kind::BusOff),
    ("stuck-gripper", Kind::StuckGripper),
    ("late-release", Kind::LateRelease),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Drop,
    Delay,
    Duplicate,
    Corrupt,
    WrongAnswer,
    Stuck,
    Slow,
    Intermittent,
    Babble,
    Silent,
    Restart,
    SupplyLoss,
    OverCurrent,
    TowError,
    HallError,
    EncoderError,
    BusOff,
    StuckGripper,
    LateRelease,
}

/// The kinds with their keys, for people.
pub const HELP: &str = "\
Every [[fault]] has: kind, target, label, start_s (0), length_s (to the end), every_s (once), probability (1).
at = \"release - 0.1 s\" (or \"start + 0.2 s\") counts from the throw: in a run with one it replaces start_s. `start` is the
begin of the throw's motion, `release` the planned release. Without a throw start_s counts; a fault that has none never starts.
Kinds that act on frames also take id (\"0A3\" or eight digits) and id_mask; their probability is that of each frame.

kind           target            what happens                                         own keys
drop           bus, module N     frame acknowledged, but not handed over
delay          bus, module N     frame handed over later                              by_s
duplicate      bus, module N     sender repeats a frame that was received
corrupt        bus, module N     one bit read wrongly: by all, or by that module
wrong-answer   bus, module N     answer with valid checksum, wrong content            part = value, parameter, command, length
silent         bus, module N     frames of the module never leave it
stuck          bus               line held dominant
stuck          module N          measured values in answers stop changing
slow           module N          answers come later                                   by_s
intermittent   module N          plug loses and finds contact                         on_mean_s, off_mean_s
babble         bus               one more node sends without end                      frame, period_s (0.0001)
bus-off        module N          CAN controller goes bus-off
restart        module N          electronics restart, in motion too
over-current   module N          power stage reports a short circuit
tow-error      module N          axis held from outside
hall-error     module N          power stage reports a hall error
encoder-error  module N          counts lost: position off                            offset_deg
supply-loss    supply N          voltage drops                                        remaining (0)
stuck-gripper  gripper           does not open
late-release   gripper           opens later                                          by_s
";

/// Reads one `[[fault]]` table; without a label, `index` makes one.
pub fn fault(table: &Section<'_>, index: usize) -> Result<Fault, ScenarioError> {
    let kind = table.required("kind", |v| v.word(&KINDS))?;
    let target = target(table, kind)?;
    let filter = filter(table, kind)?;
    let kind = fault_kind(table, kind, target)?;
    let at = table.optional("at", throw_time)?;
    // Without a throw it never comes.
    let unsaid = if at.is_some() { Instant::FAR_FUTURE } else { Instant::ZERO };
    let start = table.optional("start_s", |v| seconds(v, MAX_S))?;
    let fault = Fault {
        label: match table.optional("label", Value::text)? {
            Some("") => {
                return Err(table.error("label", Problem::Invalid("a label cannot be empty".to_owned())));
            }
            Some(label) => label.to_owned(),
            None => format!("{} {target} #{}", name_of(&kind), index + 1),
        },
        kind,
        target,
        filter,
        start: start.map_or(unsaid, |start| Instant::ZERO + start),
        at,
        length: table.optional("length_s", |v| seconds(v, MAX_S))?,
        every: table.optional("every_s", |v| period(v, MAX_S))?,
        probability: table.or("probability", 1.0, |v| v.number_in(0.0, 1.0))?,
    };
    table.finish()?;
    Ok(fault)
}

/// `"start"`, `"release - 0.1 s"`, `"start + 0.25 s"`.
fn throw_time(value: &Value<'_>) -> Result<ThrowTime, ScenarioError> {
    let text = value.text()?;
    parse_throw_time(text).ok_or_else(|| {
        let problem = format!(
            "'{text}' is no time of a throw; write \"start + 0.2 s\", \"release - 0.1 s\", \"start\" or \"release\""
        );
        value.error(Problem::Invalid(problem))
    })
}

fn parse_throw_time(text: &str) -> Option<ThrowTime> {
    let text = text.trim();
    let (moment, rest) = [("start", Moment::Start), ("release", Moment::Release)]
        .into_iter()
        .find_map(|(name, moment)| Some((moment, text.strip_prefix(name)?.trim_start())))?;
    let Some(sign) = rest.chars().next() else { return Some(ThrowTime { moment, offset_us: 0 }) };
    let sign = match sign {
        '+' => 1.0,
        '-' => -1.0,
        _ => return None,
    };
    let offset_s: f64 = rest[1..].trim().strip_suffix('s')?.trim_end().parse().ok()?;
    let sensible = (0.0..=MAX_S).contains(&offset_s);
    sensible.then(|| ThrowTime { moment, offset_us: (sign * offset_s * 1e6).round() as i64 })
}

fn name_of(kind: &FaultKind) -> &'static str {
    match kind {
        FaultKind::Wire(wire) => wire.name(),
        FaultKind::Physical(_, physical) => physical.name(),
    }
}

/// `target = "bus"`, `"module 3"`, `"supply 0"`, `"gripper"`; each kind allows some of them.
fn target(table: &Section<'_>, kind: Kind) -> Result<Target, ScenarioError> {
    let target = match table.optional("target", Value::text)? {
        None => default_target(kind).ok_or_else(|| table.error("target", Problem::Missing))?,
        Some(text) => parse_target(text).ok_or_else(|| {
            let problem =
                format!("'{text}' is no target; write \"bus\", \"module 3\", \"supply 0\" or \"gripper\"");
            table.error("target", Problem::Invalid(problem))
        })?,
    };
    let fits = match (kind, target) {
        (
            Kind::Drop
            | Kind::Delay
            | Kind::Duplicate
            | Kind::Corrupt
            | Kind::WrongAnswer
            | Kind::Stuck
            | Kind::Silent,
            Target::Bus | Target::Module(_),
        )
        | (Kind::Babble, Target::Bus)
        | (Kind::SupplyLoss, Target::Supply(_))
        | (Kind::StuckGripper | Kind::LateRelease, Target::Gripper) => true,
        (Kind::Babble | Kind::SupplyLoss | Kind::StuckGripper | Kind::LateRelease, _) => false,
        (_, Target::Module(_)) => true,
        _ => false,
    };
    if fits {
        return Ok(target);
    }
    Err(table.error("target", Problem::Invalid(format!("this kind of fault cannot act on {target}"))))
}

fn default_target(kind: Kind) -> Option<Target> {
    match kind {
        Kind::Drop | Kind::Delay | Kind::Duplicate | Kind::Corrupt | Kind::Babble => Some(Target::Bus),
        Kind::StuckGripper | Kind::LateRelease => Some(Target::Gripper),
        _ => None,
    }
}

fn parse_target(text: &str) -> Option<Target> {
    match text.split_once(' ') {
        None if text == "bus" => Some(Target::Bus),
        None if text == "gripper" => Some(Target::Gripper),
        Some(("module", number)) => {
            number.parse::<u8>().ok().and_then(|n| ModuleId::new(n).ok()).map(Target::Module)
        }
        Some(("supply", number)) => number.parse().ok().map(Target::Supply),
        _ => None,
    }
}

/// `id = "0A3"` with `id_mask = 0x7FF`, for kinds that act on frames.
fn filter(table: &Section<'_>, kind: Kind) -> Result<Option<IdFilter>, ScenarioError> {
    let acts_on_frames = matches!(
        kind,
        Kind::Drop | Kind::Delay | Kind::Duplicate | Kind::Corrupt | Kind::WrongAnswer | Kind::Silent
    );
    if !acts_on_frames {
        return Ok(None);
    }
    let id = table.optional("id", |value| {
        let text = value.text()?;
        parse_id(text).ok_or_else(|| {
            let problem = format!(
                "'{text}' is no id; write three hexadecimal digits (11 bit) or eight (29 bit), as 0A3"
            );
            value.error(Problem::Invalid(problem))
        })
    })?;
    let mask = table.optional("id_mask", |v| Ok(v.integer(0..=0x1FFF_FFFF)? as u32))?;
    match (id, mask) {
        (None, Some(_)) => Err(table.error("id_mask", Problem::Invalid("needs id".to_owned()))),
        (id, mask) => Ok(id.map(|id| IdFilter { id, mask: mask.unwrap_or(0x1FFF_FFFF) })),
    }
}

fn parse_id(text: &str) -> Option<Id> {
    let value = u32::from_str_radix(text, 16).ok()?;
    match text.len() {
        3 => u16::try_from(value).ok().and_then(|v| StandardId::new(v).ok()).map(Id::Standard),
        8 => ExtendedId::new(value).ok().map(Id::Extended),
        _ => None,
    }
}

fn fault_kind(table: &Section<'_>, kind: Kind, target: Target) -> Result<FaultKind, ScenarioError> {
    let span = |key| table.required(key, |v| seconds(v, MAX_S));
    let wire = match kind {
        Kind::Drop => WireFault::Drop,
        Kind::Delay => WireFault::Delay(span("by_s")?),
        Kind::Duplicate => WireFault::Duplicate,
        Kind::Corrupt => WireFault::Corrupt,
        Kind::Silent => WireFault::Silent,
        Kind::BusOff => WireFault::BusOff,
        Kind::WrongAnswer => {
            let parts = [
                ("value", WrongPart::Value),
                ("parameter", WrongPart::Parameter),
                ("command", WrongPart::Command),
                ("length", WrongPart::Length),
            ];
            WireFault::WrongAnswer(table.or("part", WrongPart::default(), |v| v.word(&parts))?)
        }
        Kind::Intermittent => {
            WireFault::Intermittent { on_mean: span("on_mean_s")?, off_mean: span("off_mean_s")? }
        }
        Kind::Babble => {
            let frame = table.required("frame", |value| match frames(value)?[..] {
                [frame] => Ok(frame),
                _ => Err(value.error(Problem::Invalid("one frame, not a list".to_owned()))),
            })?;
            let period_s = table.or("period_s", 1e-4, |v| v.number_in(BABBLE_PERIOD_MIN_S, MAX_S))?;
            WireFault::Babble { frame, period: Duration::from_secs_f64(period_s) }
        }
        Kind::Stuck if target == Target::Bus => WireFault::StuckDominant,
        _ => return physical(table, kind, target),
    };
    Ok(FaultKind::Wire(wire))
}

fn physical(table: &Section<'_>, kind: Kind, target: Target) -> Result<FaultKind, ScenarioError> {
    let place = match target {
        Target::Module(module) => Place::Module(module),
        Target::Supply(index) => Place::Supply(index),
        Target::Gripper => Place::Gripper,
        Target::Bus => {
            return Err(table.error("target", Problem::Invalid("this kind needs a module".to_owned())));
        }
    };
    let by = || table.required("by_s", |v| seconds(v, MAX_S));
    let fault = match kind {
        Kind::Slow => PhysicalFault::Slow(by()?),
        Kind::LateRelease => PhysicalFault::LateRelease(by()?),
        Kind::Restart => PhysicalFault::Restart,
        Kind::SupplyLoss => {
            PhysicalFault::SupplyLoss { remaining: table.or("remaining", 0.0, |v| v.number_in(0.0, 1.0))? }
        }
        Kind::OverCurrent => PhysicalFault::OverCurrent,
        Kind::TowError => PhysicalFault::Blocked,
        Kind::HallError => PhysicalFault::HallError,
        Kind::EncoderError => {
            let offset_deg = table.required("offset_deg", |v| v.number_in(-360.0, 360.0))?;
            PhysicalFault::EncoderOffset { offset_rad: offset_deg.to_radians() }
        }
        Kind::StuckGripper => PhysicalFault::StuckGripper,
        // "stuck" at a module: what it reports no longer changes.
        _ => PhysicalFault::Frozen,
    };
    Ok(FaultKind::Physical(place, fault))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_a_throw_are_read_or_refused() {
        let read = |text| parse_throw_time(text).map(|at| (at.moment, at.offset_us));
        assert_eq!(read("release - 0.1 s"), Some((Moment::Release, -100_000)));
        assert_eq!(read("start+0.25s"), Some((Moment::Start, 250_000)));
        assert_eq!(read("start"), Some((Moment::Start, 0)));
        for text in
            ["", "landing", "release 0.1 s", "release - 0.1", "start + -1 s", "start + nan s", "release -"]
        {
            assert_eq!(read(text), None, "{text}");
        }
        let at =
            |text| parse_throw_time(text).unwrap().at(Instant::from_micros(500), Instant::from_micros(900));
        assert_eq!(at("release - 0.0001 s"), Instant::from_micros(800));
        assert_eq!(at("start - 1 s"), Instant::ZERO);
    }
}
