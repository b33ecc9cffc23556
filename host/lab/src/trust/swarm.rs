//! Random throws: combinations of faults, arms that are not the model, strangers on the bus.
//!
//! A seed gives a scenario. What is drawn goes through the text of a scenario file first, so that the file repeats the run
//! bit for bit.

use hil_sim::fault::{Fault, FaultKind, PhysicalFault, WireFault};
use hil_sim::rng::Rng;
use hil_sim::scenario::{Action, Scenario, write};
use hil_sim::swarm;
use protocol::cyphal::bits::Encode;
use protocol::cyphal::cubecell::command::{self, ArmConfirm, ArmPrepare, ClearFault, Gripper, Trajectory};
use protocol::cyphal::id::{NodeId, Priority, Route, TransferId};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::cyphal::uavcan::command::{CommandRequest, SERVICE};
use protocol::powercube::Broadcast;
use protocol::{Duration, Frame, Instant, ModuleId, StandardId};

use super::bench::Bench;
use super::evidence::Evidence;
use super::judge::{Judge, Verdict};

const FAULTS_MAX: u64 = 4;
/// Most actions of strangers.
const ACTIONS_MAX: u64 = 3;
/// Share of the cells that have to find their zeros first: such a run takes five times as long.
const UNHOMED_SHARE: f64 = 0.05;
/// Share of the runs with strangers on the bus.
const STRANGERS_SHARE: f64 = 0.25;
/// Longest fault with an end.
const LENGTH_MAX_S: f64 = 2.0;
/// Node number of the other host.
const STRANGER: NodeId = NodeId::from_low_bits(99);

/// Draws, runs and judges.
pub struct Swarm {
    bench: Bench,
    modules: Vec<ModuleId>,
    homed: Evidence,
    unhomed: Evidence,
}

impl Swarm {
    /// Plans the throw and runs it once from each kind of start.
    pub fn new() -> Result<Self, String> {
        let bench = Bench::new()?;
        let drives = bench.arm.drives().into_iter().flatten();
        let modules = drives.filter_map(|drive| ModuleId::new(drive.address).ok()).collect();
        let (homed, unhomed) =
            (bench.throw(&bench.scenario(1)), bench.throw(&bench.scenario_without_zeros(1)));
        Ok(Self { bench, modules, homed, unhomed })
    }

    fn nominal(&self, scenario: &Scenario) -> &Evidence {
        if scenario.cell.drive.starts_homed { &self.homed } else { &self.unhomed }
    }

    pub fn draw(&self, seed: u64) -> Result<Scenario, String> {
        let rng = &mut Rng::stream(seed, "trust");
        let mut scenario = if rng.chance(UNHOMED_SHARE) {
            self.bench.scenario_without_zeros(seed)
        } else {
            self.bench.scenario(seed)
        };
        scenario.name = format!("swarm {seed}");
        perturb(&mut scenario, rng);
        let end_us = self.nominal(&scenario).job_end.as_micros();
        for index in 0..rng.within(1, FAULTS_MAX) {
            let kind = rng.below(swarm::FAULT_KINDS);
            let mut fault = swarm::fault(rng, index, kind, end_us, &self.modules);
            tame(&mut fault, rng);
            scenario.faults.push(fault);
        }
        if rng.chance(STRANGERS_SHARE) {
            let controller = self.bench.controller();
            scenario.actions = (0..rng.within(1, ACTIONS_MAX))
                .map(|number| stranger(rng, end_us, number as u8, controller, &self.modules))
                .collect();
        }
        canonical(&scenario)
    }

    pub fn run(&self, scenario: &Scenario) -> Verdict {
        let judge = Judge { arm: &self.bench.arm, nominal: self.nominal(scenario) };
        judge.judge(scenario, &self.bench.throw(scenario))
    }
}

/// The scenario as its file says it.
pub fn canonical(scenario: &Scenario) -> Result<Scenario, String> {
    let text = write::scenario(scenario, &[]);
    Scenario::from_toml(&scenario.file, &text).map_err(|error| format!("{error}\n{text}"))
}

/// An arm that is not the model, drives that answer sooner or later.
fn perturb(scenario: &mut Scenario, rng: &mut Rng) {
    let cell = &mut scenario.cell;
    if rng.chance(0.5) {
        return;
    }
    cell.scatter.mass_share = 0.1 * rng.unit();
    cell.scatter.com_m = 0.01 * rng.unit();
    cell.scatter.friction_share = 0.5 * rng.unit();
    cell.scatter.rotor_share = 0.2 * rng.unit();
    cell.scatter.current_share = 0.1 * rng.unit();
    cell.scatter.delay_share = 0.3 * rng.unit();
    cell.scatter.home_rad = 0.002 * rng.unit();
    cell.scatter.gripper_delay = Duration::from_micros(rng.within(0, 2_000));
    cell.gripper.jitter = Duration::from_micros(rng.within(0, 2_000));
    cell.drive.processing_delay = Duration::from_micros(rng.within(50, 350));
    cell.drive.processing_jitter = Duration::from_micros(rng.within(0, 100));
    cell.logic_on_motor_supply = rng.chance(0.3);
}

/// Makes a drawn fault one that a file can hold and a judge can bound.
fn tame(fault: &mut Fault, rng: &mut Rng) {
    let per_frame = matches!(&fault.kind, FaultKind::Wire(wire) if wire.is_per_frame());
    if !per_frame {
        fault.filter = None;
    }
    if let FaultKind::Wire(WireFault::Babble { period, .. }) = &mut fault.kind {
        *period = (*period).max(Duration::from_micros(20));
    }
    if matches!(fault.kind, FaultKind::Physical(_, PhysicalFault::EncoderOffset { .. })) {
        // Counts that are lost again and again have no bound.
        fault.every = None;
    }
    // From 1 ms on, every order of magnitude alike.
    if fault.length.is_some() {
        let length_s = 1e-3 * (LENGTH_MAX_S * 1e3).powf(rng.unit());
        fault.length = Some(Duration::from_secs_f64(length_s));
    }
    if rng.chance(0.7) {
        fault.every = None;
    }
}

/// Something that another host sends: orders, readings, halts. Nothing that moves a drive.
fn stranger(rng: &mut Rng, end_us: u64, number: u8, controller: NodeId, modules: &[ModuleId]) -> Action {
    let module = modules.get(rng.below(modules.len() as u64) as usize).copied().unwrap_or(ModuleId::MIN);
    let standard = |id: u16, data: [u8; 2]| Frame::from_array(StandardId::from_low_bits(id), data);
    let order = |command: u16, parameter: &dyn Encode| {
        order_frames(controller, TransferId::from_low_bits(number), command, parameter)
    };
    let frames = match rng.below(12) {
        0 => order(command::STOP, &()),
        1 => order(command::DISARM, &()),
        2 => order(command::CLEAR_FAULT, &ClearFault { fault_cause: rng.below(800) as u16 }),
        3 => order(command::GRIPPER, &Gripper { open: rng.chance(0.5) }),
        4 => order(command::ARM_CONFIRM, &ArmConfirm { token: rng.next_u64() as u32, valid_ms: 5_000 }),
        5 => order(command::ARM_PREPARE, &ArmPrepare { trajectory_crc64: rng.next_u64(), valid_ms: 5_000 }),
        6 => order(command::RUN, &Trajectory { trajectory_crc64: rng.next_u64(), length_bytes: 1_000 }),
        7 => order(
            command::COMMIT_TRAJECTORY,
            &Trajectory { trajectory_crc64: rng.next_u64(), length_bytes: 1_000 },
        ),
        8 => vec![Broadcast::Halt.encode()],
        9 => vec![Broadcast::Reset.encode()],
        _ => vec![standard(0x0C0 + u16::from(module.get()), [0x0A, 0x62])],
    };
    let every = rng.chance(0.5).then(|| Duration::from_micros(rng.within(500, 50_000)));
    let count = every.is_some().then(|| rng.within(1, 100));
    Action { at: Instant::from_micros(rng.below(end_us)), frames, every, count }
}

fn order_frames(to: NodeId, transfer_id: TransferId, number: u16, parameter: &dyn Encode) -> Vec<Frame> {
    let mut bytes = [0; 32];
    let len = protocol::cyphal::bits::to_bytes(parameter, &mut bytes).unwrap_or(0);
    let request = CommandRequest { command: number, parameter: bytes.get(..len).unwrap_or_default() };
    let mut tx = TxQueue::<16, 300>::default();
    let meta = TxMeta {
        route: Route::Request { service: SERVICE, source: STRANGER, destination: to },
        priority: Priority::Nominal,
        transfer_id,
        deadline: Instant::FAR_FUTURE,
    };
    if tx.push(&meta, &request).is_err() {
        return Vec::new();
    }
    std::iter::from_fn(|| tx.pop()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawn_scenarios_are_what_their_files_say() {
        let swarm = Swarm::new().unwrap();
        for seed in 0..300 {
            let scenario = swarm.draw(seed).unwrap();
            assert_eq!(canonical(&scenario), Ok(scenario), "seed {seed}");
        }
    }
}
