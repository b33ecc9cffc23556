//! Seeds to situations: a thousand cells that differ in everything, to find unforeseen defects.
//!
//! A seed determines options of the drives, deviations of the arm, faults of all kinds and a host that sends
//! sensible and senseless frames. The result is an ordinary [`Scenario`], printed before its run, so that any
//! failure can be repeated with `hil-sim swarm --first SEED --seeds 1`.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

use protocol::powercube::{Parameter, Reply, Value};
use protocol::{Duration, Frame, Instant, ModuleId, StandardId};

use crate::cell::CellOptions;
use crate::drive::options::{
    BeyondMaximum, BeyondSoftLimit, HomeWhenHalted, InternalCommand, Persistence, RefusedReply, SignOfLife,
    StateFrames, StepPath, UnknownRequest,
};
use crate::fault::{Fault, FaultKind, IdFilter, PhysicalFault, Place, Target, WireFault, WrongPart};
use crate::report::{DriveRow, ThrowRow};
use crate::rng::Rng;
use crate::scenario::{Action, Scenario};
use crate::world::Observer;

/// The scenario of a seed: robot, duration and bus of `base`, everything else drawn.
pub fn scenario(base: &Scenario, seed: u64, modules: &[ModuleId]) -> Scenario {
    let rng = &mut Rng::stream(seed, "swarm");
    let end_us = base.duration.as_micros();
    Scenario {
        name: format!("swarm {seed}"),
        seed,
        cell: cell_options(&base.cell, rng),
        actions: (0..rng.within(5, 40)).map(|_| action(rng, end_us, modules)).collect(),
        faults: faults(rng, end_us, modules),
        ..base.clone()
    }
}

fn pick<T: Copy>(rng: &mut Rng, choices: &[T]) -> T {
    choices[rng.below(choices.len() as u64) as usize]
}

fn micros(rng: &mut Rng, low: u64, high: u64) -> Duration {
    Duration::from_micros(rng.within(low, high))
}

fn cell_options(base: &CellOptions, rng: &mut Rng) -> CellOptions {
    let mut o = base.clone();
    let d = &mut o.drive;
    d.beyond_maximum = pick(rng, &[BeyondMaximum::Clip, BeyondMaximum::Refuse]);
    d.beyond_soft_limit = pick(rng, &[BeyondSoftLimit::Clip, BeyondSoftLimit::Refuse, BeyondSoftLimit::Run]);
    d.refusal = pick(rng, &[RefusedReply::Silence, RefusedReply::Code(0), RefusedReply::Code(0x65)]);
    d.unknown = pick(rng, &[UnknownRequest::Silence, UnknownRequest::Echo]);
    d.persistence = pick(rng, &[Persistence::OnSave, Persistence::AtOnce]);
    d.internal = pick(rng, &[InternalCommand::Echo, InternalCommand::Silence]);
    d.home_when_halted = pick(rng, &[HomeWhenHalted::Accept, HomeWhenHalted::Refuse]);
    d.sign_of_life = pick(rng, &[SignOfLife::Refresh, SignOfLife::AnyFrame]);
    d.step_path = pick(rng, &[StepPath::Linear, StepPath::Cubic]);
    d.state_frames = match rng.below(3) {
        0 => StateFrames::OnChange { every: micros(rng, 100, 20_000) },
        1 => StateFrames::SyncTransmit { every: micros(rng, 100, 20_000) },
        _ => StateFrames::Never,
    };
    d.watchdog_timeout = micros(rng, 5_000, 100_000);
    d.processing_delay = micros(rng, 0, 2_000);
    d.processing_jitter = micros(rng, 0, 1_000);
    d.queue_depth = rng.within(1, 16) as usize;
    d.boot_time = micros(rng, 0, 100_000);
    d.position_resolution_rad = pick(rng, &[None, Some(0.0), Some(0.02_f64.to_radians())]);
    d.home_switch_noise_rad = 0.01 * rng.unit();
    d.starts_homed = rng.chance(0.5);
    d.absolute_encoder = rng.chance(0.2);
    d.brake = rng.chance(0.7);
    o.cold_start = rng.chance(0.3);
    o.logic_on_motor_supply = rng.chance(0.3);
    o.scatter.mass_share = 0.3 * rng.unit();
    o.scatter.com_m = 0.02 * rng.unit();
    o.scatter.friction_share = 0.5 * rng.unit();
    o.scatter.delay_share = 0.5 * rng.unit();
    o.scatter.home_rad = 0.02 * rng.unit();
    o.scatter.gripper_delay = micros(rng, 0, 10_000);
    o.gripper.delay = micros(rng, 0, 50_000);
    o.gripper.jitter = micros(rng, 0, 5_000);
    o.gripper.drag_1_m = Some(0.1 * rng.unit());
    o
}

/// Floats as hosts and gremlins send them.
fn number(rng: &mut Rng) -> f32 {
    match rng.below(12) {
        0 => f32::NAN,
        1 => f32::INFINITY,
        2 => -f32::INFINITY,
        3 => f32::MAX,
        4 => f32::MIN_POSITIVE / 2.0,
        5 => 0.0,
        _ => (8.0 * rng.unit() - 4.0) as f32,
    }
}

fn standard(id: u16, data: &[u8]) -> Frame {
    let id = StandardId::from_low_bits(id);
    Frame::new(id, data).unwrap_or_else(|_| Frame::from_array(id, []))
}

/// A frame that a host might send; one in ten makes no sense at all.
fn request(rng: &mut Rng, modules: &[ModuleId]) -> Frame {
    let module = if rng.chance(0.95) && !modules.is_empty() {
        u16::from(pick(rng, modules).get())
    } else {
        rng.below(32) as u16
    };
    let (get, put) = (0x0C0 + module, 0x0E0 + module);
    let parameter = rng.below(0x90) as u8;
    let [a, b, c, d] = number(rng).to_le_bytes();
    let [t, u, ..] = rng.next_u64().to_le_bytes();
    match rng.below(20) {
        0..=2 => standard(get, &[0x0A, 0x62]),
        3 => standard(get, &[0x0A, parameter]),
        4 => standard(put, &[pick(rng, &[0x00, 0x01, 0x02, 0x07, 0x09, 0x10])]),
        5 => standard(put, &[0x00]),
        6 => standard(put, &[0x01]),
        7 => standard(put, &[0x08, 0x4F, a, b, c, d]),
        8 => standard(put, &[0x08, 0x50, a, b, c, d]),
        9 => standard(put, &[0x08, parameter, a, b, c, d]),
        10 | 11 => standard(put, &[0x0B, pick(rng, &[0x04, 0x0E]), a, b, c, d]),
        12 => standard(put, &[0x0B, pick(rng, &[0x07, 0x08, 0x11, 0x12]), a, b, c, d]),
        13 => standard(put, &[0x0B, pick(rng, &[0x06, 0x10]), a, b, c, d, t, u & 3]),
        14 => standard(put, &[0x0B, pick(rng, &[0x09, 0x0C, 0x0D, 0x13, 0x16, 0x17]), a, b, c, d]),
        15 => standard(put, &[0x0B, pick(rng, &[0x0B, 0x15]), a, b, c, d, t, u & 3]),
        16 => standard(0x100, &[pick(rng, &[0x00, 0x01, 0x02, 0x07, 0x0E, 0x0F]), 0][..1 + (t as usize & 1)]),
        17 => standard(put, &[0x08, 0x26, a & 0xF0, 0, 0, 0]),
        _ => {
            let data = rng.next_u64().to_le_bytes();
            standard(rng.below(0x800) as u16, &data[..rng.within(0, 8) as usize])
        }
    }
}

fn action(rng: &mut Rng, end_us: u64, modules: &[ModuleId]) -> Action {
    let frames = (0..rng.within(1, 12)).map(|_| request(rng, modules)).collect();
    let every = rng.chance(0.5).then(|| micros(rng, 500, 20_000));
    let count = every.is_some().then(|| rng.within(1, 200));
    Action { at: Instant::from_micros(rng.below(end_us)), frames, every, count }
}

/// One seed in four gets every kind of fault there is, the others a few of any.
fn faults(rng: &mut Rng, end_us: u64, modules: &[ModuleId]) -> Vec<Fault> {
    if rng.chance(0.25) {
        return (0..FAULT_KINDS).map(|kind| fault(rng, kind, kind, end_us, modules)).collect();
    }
    (0..rng.within(0, 6))
        .map(|index| {
            let kind = rng.below(FAULT_KINDS);
            fault(rng, index, kind, end_us, modules)
        })
        .collect()
}

/// Kinds that [`fault`] knows, by number.
pub const FAULT_KINDS: u64 = 20;

/// A fault of a kind somewhere before `end_us`; `index` makes its label.
pub fn fault(rng: &mut Rng, index: u64, kind: u64, end_us: u64, modules: &[ModuleId]) -> Fault {
    let module = if modules.is_empty() { ModuleId::MIN } else { pick(rng, modules) };
    let place = Place::Module(module);
    let by = micros(rng, 1, 20_000);
    let physical = |fault| (FaultKind::Physical(place, fault), Target::Module(module));
    let wire = |fault, target| (FaultKind::Wire(fault), target);
    let line = if rng.chance(0.5) { Target::Bus } else { Target::Module(module) };
    let (kind, target) = match kind {
        0 => wire(WireFault::Drop, line),
        1 => wire(WireFault::Delay(by), line),
        2 => wire(WireFault::Duplicate, line),
        3 => wire(WireFault::Corrupt, line),
        4 => {
            let parts = [WrongPart::Value, WrongPart::Parameter, WrongPart::Command, WrongPart::Length];
            wire(WireFault::WrongAnswer(pick(rng, &parts)), line)
        }
        5 => wire(WireFault::Silent, line),
        6 => wire(WireFault::StuckDominant, Target::Bus),
        7 => {
            let (on_mean, off_mean) = (micros(rng, 100, 50_000), micros(rng, 100, 50_000));
            wire(WireFault::Intermittent { on_mean, off_mean }, Target::Module(module))
        }
        8 => {
            let data = rng.next_u64().to_le_bytes();
            let frame = standard(rng.below(0x800) as u16, &data[..rng.within(0, 8) as usize]);
            wire(WireFault::Babble { frame, period: micros(rng, 20, 2_000) }, Target::Bus)
        }
        9 => wire(WireFault::BusOff, Target::Module(module)),
        10 => physical(PhysicalFault::Frozen),
        11 => physical(PhysicalFault::Slow(by)),
        12 => physical(PhysicalFault::Restart),
        13 => physical(PhysicalFault::OverCurrent),
        14 => physical(PhysicalFault::Blocked),
        15 => physical(PhysicalFault::HallError),
        16 => physical(PhysicalFault::EncoderOffset { offset_rad: 6.0 * rng.unit() - 3.0 }),
        17 => {
            let supply = rng.below(2) as u8;
            let fault = PhysicalFault::SupplyLoss { remaining: rng.unit() };
            (FaultKind::Physical(Place::Supply(supply), fault), Target::Supply(supply))
        }
        18 => (FaultKind::Physical(Place::Gripper, PhysicalFault::StuckGripper), Target::Gripper),
        _ => (FaultKind::Physical(Place::Gripper, PhysicalFault::LateRelease(by)), Target::Gripper),
    };
    let filter = rng.chance(0.2).then(|| IdFilter {
        id: StandardId::from_low_bits(rng.below(0x800) as u16).into(),
        mask: rng.below(0x800) as u32,
    });
    Fault {
        label: format!("swarm #{index}"),
        kind,
        target,
        filter,
        start: Instant::from_micros(rng.below(end_us)),
        at: None,
        length: rng.chance(0.8).then(|| micros(rng, 1, end_us)),
        every: rng.chance(0.3).then(|| micros(rng, 1_000, end_us)),
        probability: if rng.chance(0.5) { 1.0 } else { rng.unit() },
    }
}

/// Searches for NaN in the answers of modules.
#[derive(Debug, Default)]
struct NotANumber(Option<String>);

impl Observer for NotANumber {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        if self.0.is_some() || from.is_none() {
            return;
        }
        let value = match Reply::decode(frame) {
            Ok((_, Reply::Value(parameter, Value::F32(value)))) => Some((Some(parameter), value)),
            Ok((_, Reply::Value(_, Value::PosStateDio(value)))) => Some((None, value.position_rad)),
            Ok((
                _,
                Reply::MotionExtended { position: protocol::powercube::MotionPosition::Radians(q), .. },
            )) => Some((None, q.get())),
            _ => None,
        };
        if let Some((parameter, value)) = value
            && !value.is_finite()
        {
            let what = parameter.map_or("position", Parameter::name);
            self.0 = Some(format!("{frame} at {at} s: {what} is {value}"));
        }
    }
}

#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct SeedResult {
    pub seed: u64,
    pub frames: u64,
    /// Faults that started, by kind.
    pub faults: BTreeMap<&'static str, u64>,
    /// Share of the time that was lost to errors.
    pub error_share: f64,
    /// What went wrong: a panic, a broken contract, NaN.
    pub failure: Option<String>,
}

/// Runs one scenario of a swarm and judges it.
pub fn run(scenario: &Scenario) -> SeedResult {
    let mut result = SeedResult {
        seed: scenario.seed,
        frames: 0,
        faults: BTreeMap::new(),
        error_share: 0.0,
        failure: None,
    };
    let ended = catch_unwind(AssertUnwindSafe(|| run_inner(scenario, &mut result)));
    match ended {
        Ok(Ok(())) => {}
        Ok(Err(failure)) => result.failure = Some(failure),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
            result.failure = Some(format!("panic: {text}"));
        }
    }
    result
}

fn run_inner(scenario: &Scenario, result: &mut SeedResult) -> Result<(), String> {
    let mut world = scenario.world().map_err(|error| error.to_string())?;
    let mut nan = NotANumber::default();
    // Wrong answers are made wrong on purpose, so their numbers prove nothing.
    let lies = scenario.faults.iter().any(|fault| {
        matches!(fault.kind, FaultKind::Wire(WireFault::WrongAnswer(_) | WireFault::Babble { .. }))
    });
    let ended = world.run_until(Instant::ZERO + scenario.duration, &mut nan);
    result.frames = world.stats().frames;
    for (fault, count) in scenario.faults.iter().zip(world.faults().counts()) {
        *result.faults.entry(fault.kind_name()).or_default() += count.occurrences;
    }
    result.error_share = world.bus().error_ns() as f64 / world.bus().now_ns().max(1) as f64;
    ended.map_err(|error| error.to_string())?;
    if let Some(what) = nan.0.filter(|_| !lies) {
        return Err(what);
    }
    let cell = &world.participants().0;
    for row in DriveRow::of(cell) {
        if !(row.q_rad.is_finite() && row.v_rad_s.is_finite()) {
            return Err(format!("module {}: q {} rad, v {} rad/s", row.module, row.q_rad, row.v_rad_s));
        }
    }
    match ThrowRow::of(cell).landing_m {
        Some(p) if p.iter().any(|x| !x.is_finite()) => Err(format!("the ball lands at {p:?}")),
        _ => Ok(()),
    }
}
