//! The DBC file of the drives, written from the same tables as the codec.
//!
//! Five kinds of messages: the broadcast, and GET, PUT, ACK and STATE of each module. Requests and
//! answers are multiplexed twice (command, then parameter or motion), which DBC expresses with
//! extended multiplexing (`SG_MUL_VAL_`). Each message is described once as a list of signals;
//! the sections of the file are passes over these lists.

use core::fmt::{self, Write};

use super::address::{BROADCAST_ID, Channel};
use super::baud::BaudRate;
use super::command::Command;
use super::motion::{MotionAck, MotionKind};
use super::parameter::{Parameter, ParameterInfo, Unit};
use super::state::{BitInfo, CubeState, ShortState};
use super::value::ValueKind;
use crate::module::ModuleId;

/// Writes the DBC file of `modules` to `out`, ASCII, lines ending in `\n`.
///
/// Fails only when writing to `out` fails.
pub fn write_dbc<W: Write>(out: &mut W, modules: impl Iterator<Item = ModuleId> + Clone) -> fmt::Result {
    out.write_str("VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_: Host")?;
    modules.clone().try_for_each(|module| write!(out, " Cube{module}"))?;
    out.write_str("\n\n")?;
    each_message(modules.clone(), |message| message.write_definition(out))?;
    out.write_str("CM_ \"PowerCube M5, generated from the parameter table of the protocol crate.\";\n")?;
    each_message(modules.clone(), |message| message.write_comments(out))?;
    each_message(modules.clone(), |message| message.write_choices(out))?;
    each_message(modules.clone(), |message| message.write_float_types(out))?;
    each_message(modules, |message| message.write_multiplexing(out))
}

fn each_message(
    modules: impl Iterator<Item = ModuleId>,
    mut visit: impl FnMut(Message) -> fmt::Result,
) -> fmt::Result {
    visit(Message::Broadcast)?;
    for module in modules {
        for channel in [Channel::Get, Channel::Put, Channel::Ack, Channel::State] {
            visit(Message::Module(channel, module))?;
        }
    }
    Ok(())
}

/// Numbers or enumerated names behind a signal.
#[derive(Clone, Copy, PartialEq)]
enum Coding {
    Unsigned,
    Signed,
    Float,
    Command,
    Parameter,
    Motion,
    BaudRate,
}

/// What decides whether a signal is in a frame.
#[derive(Clone, Copy, PartialEq)]
enum Multiplex {
    /// Always there.
    Plain,
    /// Always there and selects others.
    Root,
    /// There when `Command` has this value, and selects others itself.
    Selector(u8),
    /// There when the named multiplexer has this value.
    When(&'static str, u8),
}

#[derive(Clone, Copy)]
struct Signal {
    /// Name is `group_name`, or `name` alone.
    group: &'static str,
    name: &'static str,
    multiplex: Multiplex,
    start: u8,
    bits: u8,
    coding: Coding,
    unit: Unit,
    comment: &'static str,
}

impl Signal {
    const fn new(group: &'static str, name: &'static str, multiplex: Multiplex, start: u8, bits: u8) -> Self {
        Self { group, name, multiplex, start, bits, coding: Coding::Unsigned, unit: Unit::None, comment: "" }
    }

    const fn coded(self, coding: Coding, unit: Unit) -> Self {
        Self { coding, unit, ..self }
    }

    fn of_bit(group: &'static str, bit: &BitInfo, multiplex: Multiplex, offset: u8) -> Self {
        let signal = Self::new(group, bit.name, multiplex, offset + bit.bit, 1);
        Self { comment: bit.meaning, ..signal }
    }
}

impl fmt::Display for Signal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let separator = if self.group.is_empty() { "" } else { "_" };
        write!(f, "{}{separator}{}", self.group, self.name)
    }
}

#[derive(Clone, Copy)]
enum Message {
    Broadcast,
    Module(Channel, ModuleId),
}

impl Message {
    fn id(self) -> u32 {
        match self {
            Self::Broadcast => BROADCAST_ID.get().into(),
            Self::Module(channel, module) => channel.id(module).raw(),
        }
    }

    fn signals(self, visit: &mut dyn FnMut(Signal) -> fmt::Result) -> fmt::Result {
        let command = Signal::new("", "Command", Multiplex::Root, 0, 8).coded(Coding::Command, Unit::None);
        match self {
            Self::Broadcast => {
                visit(command)?;
                let when = Multiplex::When("Command", Command::Recalc.code());
                visit(Signal::new("", "BaudCode", when, 8, 8).coded(Coding::BaudRate, Unit::None))
            }
            Self::Module(Channel::Get, _) => {
                visit(command)?;
                let when = Multiplex::When("Command", Command::GetParameter.code());
                visit(Signal::new("", GET, when, 8, 8).coded(Coding::Parameter, Unit::None))
            }
            Self::Module(Channel::Put, _) => {
                visit(command)?;
                put_signals(visit)
            }
            Self::Module(Channel::Ack, _) => {
                visit(command)?;
                ack_signals(visit)
            }
            Self::Module(Channel::State, _) => CubeState::BITS
                .iter()
                .try_for_each(|bit| visit(Signal::of_bit("State", bit, Multiplex::Plain, 0))),
        }
    }

    fn write_definition<W: Write>(self, out: &mut W) -> fmt::Result {
        let id = self.id();
        match self {
            Self::Broadcast => writeln!(out, "BO_ {id} Broadcast: 2 Host"),
            Self::Module(Channel::Get, module) => writeln!(out, "BO_ {id} Cube{module}_Get: 8 Host"),
            Self::Module(Channel::Put, module) => writeln!(out, "BO_ {id} Cube{module}_Put: 8 Host"),
            Self::Module(Channel::Ack, module) => writeln!(out, "BO_ {id} Cube{module}_Ack: 8 Cube{module}"),
            Self::Module(Channel::State, module) => {
                writeln!(out, "BO_ {id} Cube{module}_State: 4 Cube{module}")
            }
        }?;
        self.signals(&mut |signal| {
            write!(out, " SG_ {signal}")?;
            match signal.multiplex {
                Multiplex::Plain => Ok(()),
                Multiplex::Root => out.write_str(" M"),
                Multiplex::Selector(code) => write!(out, " m{code}M"),
                Multiplex::When(_, code) => write!(out, " m{code}"),
            }?;
            let sign = if matches!(signal.coding, Coding::Signed | Coding::Float) { '-' } else { '+' };
            let (start, bits, unit) = (signal.start, signal.bits, signal.unit.symbol());
            write!(out, " : {start}|{bits}@1{sign} (1,0) [0|0] \"{unit}\" ")?;
            match self {
                Self::Broadcast => out.write_str("Vector__XXX\n"),
                Self::Module(Channel::Get | Channel::Put, module) => writeln!(out, "Cube{module}"),
                Self::Module(Channel::Ack | Channel::State, _) => out.write_str("Host\n"),
            }
        })?;
        out.write_char('\n')
    }

    fn write_comments<W: Write>(self, out: &mut W) -> fmt::Result {
        let id = self.id();
        self.signals(&mut |signal| match signal.comment {
            "" => Ok(()),
            comment => writeln!(out, "CM_ SG_ {id} {signal} \"{comment}.\";"),
        })
    }

    fn write_choices<W: Write>(self, out: &mut W) -> fmt::Result {
        let id = self.id();
        self.signals(&mut |signal| {
            if matches!(signal.coding, Coding::Unsigned | Coding::Signed | Coding::Float) {
                return Ok(());
            }
            write!(out, "VAL_ {id} {signal}")?;
            match signal.coding {
                Coding::Command => Command::ALL.iter().try_for_each(|command| {
                    let name = match (command, self) {
                        (Command::Recalc, Self::Broadcast) => "BAUD",
                        (Command::Recalc, Self::Module(..)) => "RECALC",
                        _ => command.name(),
                    };
                    write!(out, " {} \"{name}\"", command.code())
                }),
                Coding::Parameter => Parameter::TABLE
                    .iter()
                    .try_for_each(|info| write!(out, " {} \"{}\"", info.parameter.code(), info.name)),
                Coding::Motion => {
                    motion_forms().try_for_each(|form| write!(out, " {} \"{}\"", form.code, form.name))
                }
                Coding::BaudRate => BaudRate::ALL
                    .iter()
                    .try_for_each(|rate| write!(out, " {} \"{} bit/s\"", rate.code(), rate.bit_per_s())),
                Coding::Unsigned | Coding::Signed | Coding::Float => Ok(()),
            }?;
            out.write_str(" ;\n")
        })
    }

    fn write_float_types<W: Write>(self, out: &mut W) -> fmt::Result {
        let id = self.id();
        self.signals(&mut |signal| match signal.coding {
            // 1 is IEEE-754 binary32.
            Coding::Float => writeln!(out, "SIG_VALTYPE_ {id} {signal} : 1;"),
            _ => Ok(()),
        })
    }

    fn write_multiplexing<W: Write>(self, out: &mut W) -> fmt::Result {
        let id = self.id();
        self.signals(&mut |signal| match signal.multiplex {
            Multiplex::Plain | Multiplex::Root => Ok(()),
            Multiplex::Selector(code) => writeln!(out, "SG_MUL_VAL_ {id} {signal} Command {code}-{code};"),
            Multiplex::When(selector, code) => {
                writeln!(out, "SG_MUL_VAL_ {id} {signal} {selector} {code}-{code};")
            }
        })
    }
}

const GET: &str = "GetParameter";
const SET: &str = "SetParameter";
const MOTION: &str = "Motion";

fn put_signals(visit: &mut dyn FnMut(Signal) -> fmt::Result) -> fmt::Result {
    visit(selector(SET, Command::SetParameter, Coding::Parameter))?;
    visit(selector(MOTION, Command::SetMotion, Coding::Motion))?;
    for info in Parameter::TABLE.iter().filter(|info| info.write.is_some()) {
        visit(parameter_value("Set", SET, info))?;
    }
    for form in motion_forms() {
        let when = Multiplex::When(MOTION, form.code);
        let (coding, unit) = match form.kind {
            MotionKind::Ramp | MotionKind::Step => (Coding::Float, Unit::Rad),
            MotionKind::CosLoop | MotionKind::RampLoop => (Coding::Float, Unit::Rad),
            MotionKind::Velocity => (Coding::Float, Unit::RadPerSec),
            MotionKind::Current => (Coding::Float, Unit::Ampere),
            MotionKind::RampInc | MotionKind::StepInc => (Coding::Signed, Unit::Ticks),
            MotionKind::VelocityInc => (Coding::Signed, Unit::TicksPerSec),
            MotionKind::CurrentInc => (Coding::Signed, Unit::Digits),
        };
        visit(Signal::new(form.name, "Target", when, 16, 32).coded(coding, unit))?;
        if matches!(
            form.kind,
            MotionKind::Step | MotionKind::StepInc | MotionKind::CosLoop | MotionKind::RampLoop
        ) {
            visit(Signal::new(form.name, "Time", when, 48, 16).coded(Coding::Unsigned, Unit::Millis))?;
        }
    }
    Ok(())
}

fn ack_signals(visit: &mut dyn FnMut(Signal) -> fmt::Result) -> fmt::Result {
    visit(selector(SET, Command::SetParameter, Coding::Parameter))?;
    visit(selector(GET, Command::GetParameter, Coding::Parameter))?;
    visit(selector(MOTION, Command::SetMotion, Coding::Motion))?;
    let when_set = Multiplex::When("Command", Command::SetParameter.code());
    visit(Signal::new("", "SetAccepted", when_set, 16, 8))?;
    for info in Parameter::TABLE {
        let when = Multiplex::When(GET, info.parameter.code());
        match info.parameter {
            Parameter::CubeState => {
                for bit in CubeState::BITS {
                    visit(Signal::of_bit("Get_CubeState", bit, when, 16))?;
                }
            }
            Parameter::PosStateDio => position_state_dio(visit, "Get_PosStateDio", when, false)?,
            _ => visit(parameter_value("Get", GET, info))?,
        }
    }
    for form in motion_forms() {
        let when = Multiplex::When(MOTION, form.code);
        match form.ack {
            MotionAck::Simple => visit(Signal::new(form.name, "Accepted", when, 16, 8))?,
            MotionAck::Extended => position_state_dio(visit, form.name, when, form.kind.in_ticks())?,
        }
    }
    Ok(())
}

fn selector(name: &'static str, command: Command, coding: Coding) -> Signal {
    Signal::new("", name, Multiplex::Selector(command.code()), 8, 8).coded(coding, Unit::None)
}

fn parameter_value(group: &'static str, multiplexer: &'static str, info: &ParameterInfo) -> Signal {
    let coding = match info.kind {
        ValueKind::F32 => Coding::Float,
        ValueKind::I32 | ValueKind::I16 => Coding::Signed,
        ValueKind::U32 | ValueKind::U16 | ValueKind::U8 | ValueKind::PosStateDio => Coding::Unsigned,
    };
    let when = Multiplex::When(multiplexer, info.parameter.code());
    let bits = (info.kind.wire_len() * 8) as u8;
    Signal { comment: info.meaning, ..Signal::new(group, info.name, when, 16, bits).coded(coding, info.unit) }
}

/// Position in bytes 2 to 5, short state in byte 6, digital lines in byte 7.
fn position_state_dio(
    visit: &mut dyn FnMut(Signal) -> fmt::Result,
    group: &'static str,
    when: Multiplex,
    in_ticks: bool,
) -> fmt::Result {
    let (coding, unit) = if in_ticks { (Coding::Signed, Unit::Ticks) } else { (Coding::Float, Unit::Rad) };
    visit(Signal::new(group, "Position", when, 16, 32).coded(coding, unit))?;
    for bit in ShortState::BITS {
        visit(Signal { comment: "", ..Signal::of_bit(group, bit, when, 48) })?;
    }
    visit(Signal::new(group, "Inputs", when, 56, 4))?;
    visit(Signal::new(group, "Outputs", when, 60, 4))
}

struct MotionForm {
    kind: MotionKind,
    ack: MotionAck,
    code: u8,
    name: &'static str,
}

/// Every motion byte with a name of its own (`X` marks the extended form).
fn motion_forms() -> impl Iterator<Item = MotionForm> {
    let forms = |&kind: &MotionKind| {
        [MotionAck::Simple, MotionAck::Extended].into_iter().filter_map(move |ack| {
            let name = match (ack, kind) {
                (MotionAck::Simple, _) => kind.name(),
                (MotionAck::Extended, MotionKind::Ramp) => "FRAMPX",
                (MotionAck::Extended, MotionKind::Step) => "FSTEPX",
                (MotionAck::Extended, MotionKind::Velocity) => "FVELX",
                (MotionAck::Extended, MotionKind::Current) => "FCURX",
                (MotionAck::Extended, MotionKind::RampInc) => "IRAMPX",
                (MotionAck::Extended, MotionKind::StepInc) => "ISTEPX",
                (MotionAck::Extended, MotionKind::VelocityInc) => "IVELX",
                (MotionAck::Extended, MotionKind::CurrentInc) => "ICURX",
                (MotionAck::Extended, MotionKind::CosLoop | MotionKind::RampLoop) => return None,
            };
            Some(MotionForm { kind, ack, code: kind.code(ack)?, name })
        })
    };
    MotionKind::ALL.iter().flat_map(forms)
}
