//! The embedded cell in virtual time: the bus behind `--bus sim`.

use std::cell::Cell;
use std::rc::Rc;
use std::time::Instant as WallTime;

use can_link::LinkError;
use firmware::ControllerNode;
use firmware::authority::Seed;
use firmware::host_link::Identity;
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::store::RamStorage;
use hil_sim::bus::{BusConfig, ErrorKind};
use hil_sim::fault::Fault;
use hil_sim::participants::{Participants, Solo};
use hil_sim::scenario::{Action, Scenario, ScriptedHost};
use hil_sim::{Cell as SimCell, CellOptions, Observer, World};
use protocol::{Duration, Frame, Instant, Node};
use robot_model::RobotModel;

use super::failure::BusFailure;
use super::period::CYCLE_BITS;
use super::seen::Seen;
use crate::drives::CanDrives;
use crate::node::host_node::HostNode;
use crate::tap::Way;

/// A cell in real time waits if it is ahead of the clock by this much; if it is later by more, it does not catch up.
const AHEAD: std::time::Duration = std::time::Duration::from_millis(2);
const BEHIND_MAX: std::time::Duration = std::time::Duration::from_millis(50);
/// Virtual time between two checks whether the verb has its result.
const SLICE: Duration = Duration::from_micros(100);
/// Error classes of Linux `can/error.h`.
const CLASS_PROTOCOL: u32 = 0x08;
const CLASS_ACK: u32 = 0x20;
const CLASS_BUS_OFF: u32 = 0x40;

/// Anything that sits on the bus beside cell and host node: a soft controller, a second cell.
pub type OtherNodes = Box<dyn Participants>;

/// A further node on the bus that can be switched off from outside.
pub struct SwitchedNode {
    node: Box<dyn Node>,
    off: Rc<Cell<bool>>,
}

impl SwitchedNode {
    /// A node that takes part until `off` is set.
    pub fn new(node: Box<dyn Node>, off: Rc<Cell<bool>>) -> Self {
        Self { node, off }
    }
}

impl Node for SwitchedNode {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        if !self.off.get() {
            self.node.handle_frame(now, frame);
        }
    }
    fn handle_timeout(&mut self, now: Instant) {
        if !self.off.get() {
            self.node.handle_timeout(now);
        }
    }
    fn poll_frame(&mut self) -> Option<Frame> {
        if self.off.get() { None } else { self.node.poll_frame() }
    }
    fn poll_timeout(&self) -> Option<Instant> {
        if self.off.get() { None } else { self.node.poll_timeout() }
    }
}

/// No nodes except cell and host node.
pub fn no_other_nodes() -> OtherNodes {
    Box::new(Vec::<Solo<SwitchedNode>>::new())
}

/// The controller of the firmware, as a program on this machine: starts at time 0, without permanent storage.
pub fn soft_controller(
    settings: &Settings,
    drives: CanDrives,
) -> ControllerNode<RamStorage, Spline, CanDrives> {
    // Equal runs give equal logs, tokens included.
    let seed = Seed::FORESEEABLE;
    ControllerNode::with_group(Instant::ZERO, RamStorage::new(), drives, settings, Identity::default(), seed)
}

/// The soft controller with its built-in settings as a further node.
pub fn soft_controller_node() -> OtherNodes {
    controller_node(&Settings::powercube6(), CanDrives::default(), Rc::default())
}

/// The soft controller with `settings` for `drives` as a further node, on the bus until `off` is set.
pub fn controller_node(settings: &Settings, drives: CanDrives, off: Rc<Cell<bool>>) -> OtherNodes {
    Box::new(vec![Solo::new(
        "controller",
        SwitchedNode::new(Box::new(soft_controller(settings, drives)), off),
    )])
}

/// Options of a simulated cell except robot and seed; by default the nominal cell on a good bus.
#[derive(Clone, Debug, Default)]
pub struct SimSetup {
    /// Drives, mechanics, supplies, gripper.
    pub cell: CellOptions,
    pub bus: BusConfig,
    pub faults: Vec<Fault>,
    /// What a scripted host sends.
    pub actions: Vec<Action>,
}

/// Bits of an answer, stuff bits included.
const ANSWER_BITS: f64 = 130.0;
/// A scripted host that takes more of the bus than this leaves no time for control.
const SCRIPTED_SHARE_MAX: f64 = 0.9;

impl From<Scenario> for SimSetup {
    fn from(scenario: Scenario) -> Self {
        Self { cell: scenario.cell, bus: scenario.bus, faults: scenario.faults, actions: scenario.actions }
    }
}

impl SimSetup {
    /// Duration of a control cycle of `joints` drives: its bits and the longest processing time of a drive, on the
    /// part of the bus that the scripted host leaves. In virtual time nothing is measured before the throw.
    #[must_use]
    pub fn cycle(&self, joints: usize) -> Duration {
        let bit_s = 1.0 / f64::from(self.cell.bit_rate.bit_per_s());
        let scripted_bits_s = |action: &Action| {
            let bits: f64 =
                action.frames.iter().map(|frame| 1.2 * f64::from(frame.nominal_bits()) + ANSWER_BITS).sum();
            action.every.map_or(0.0, |every| bits / every.as_secs_f64().max(1e-6))
        };
        let scripted: f64 = self.actions.iter().map(scripted_bits_s).sum::<f64>() * bit_s;
        let drive = &self.cell.drive;
        let thinks_s = (drive.processing_delay + drive.processing_jitter).as_secs_f64();
        let cycle_s = f64::from(CYCLE_BITS * joints as u32) * bit_s + thinks_s;
        Duration::from_secs_f64(cycle_s / (1.0 - scripted.min(SCRIPTED_SHARE_MAX)))
    }
}

/// Nodes on the simulated bus: the cell, a scripted host, further nodes, and the host node last.
pub type SimParticipants = (((SimCell, Solo<ScriptedHost>), OtherNodes), Solo<HostNode>);

pub struct SimBus {
    world: World<SimParticipants>,
    host_port: usize,
    /// A verb has used the host node: it may have frames to send.
    host_was_used: bool,
    /// In real time: an instant of the clock, and the virtual time then.
    paced: Option<(WallTime, Instant)>,
}

struct Tapped<'a, 'b> {
    seen: &'a mut Seen<'b>,
    host_port: usize,
}

impl Observer for Tapped<'_, '_> {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        // Further nodes run in this program too, as a soft controller does on a real bus.
        let way = if from == Some(self.host_port) { Way::Sent } else { Way::Received };
        self.seen.frame(at, way, frame);
    }

    fn on_error(&mut self, at: Instant, _: usize, kind: ErrorKind) {
        let class = if kind == ErrorKind::Ack { CLASS_ACK } else { CLASS_PROTOCOL };
        self.seen.bus_error(at, &can_link::BusError::from_class(class));
    }

    fn on_bus_off(&mut self, at: Instant, _: usize, off: bool) {
        if off {
            self.seen.bus_error(at, &can_link::BusError::from_class(CLASS_BUS_OFF));
        }
    }
}

impl SimBus {
    /// The cell of `robot` with the options `setup`, random numbers from `seed` and `others` on its bus.
    ///
    /// # Errors
    /// The robot has no drives, or there are more nodes than a bus has ports.
    pub fn new(
        robot: &RobotModel,
        setup: &SimSetup,
        seed: u64,
        others: OtherNodes,
    ) -> Result<Self, BusFailure> {
        let cell = SimCell::new(robot, &setup.cell, seed)?;
        let script = Solo::new("script", ScriptedHost::new(&setup.actions));
        let host_port = cell.len() + script.len() + others.len();
        let participants = (((cell, script), others), Solo::new("cubectl", HostNode::default()));
        let mut world = World::new(participants, setup.bus, seed, setup.faults.clone())?;
        // A piece of a file is 40 frames: frames without a place in the queue of the adapter wait in the host node.
        world.keep_queue_short(host_port, setup.bus.queue_depth);
        Ok(Self { world, host_port, host_was_used: false, paced: None })
    }

    /// Virtual time.
    pub fn now(&self) -> Instant {
        self.world.now()
    }

    /// From now on virtual time passes no faster than the clock, so that people can watch.
    pub fn pace(&mut self) {
        self.paced = Some((WallTime::now(), self.world.now()));
    }

    fn wait_for_clock(&mut self) {
        let Some((wall, at)) = &mut self.paced else { return };
        let due =
            *wall + std::time::Duration::from_micros(self.world.now().saturating_since(*at).as_micros());
        let now = WallTime::now();
        let ahead = due.saturating_duration_since(now);
        if ahead > AHEAD {
            std::thread::sleep(ahead);
        } else if now.saturating_duration_since(due) > BEHIND_MAX {
            (*wall, *at) = (now, self.world.now());
        }
    }

    /// The world, to read it and to add faults.
    pub fn world(&mut self) -> &mut World<SimParticipants> {
        &mut self.world
    }

    pub(super) fn bit_rate_bit_s(&self) -> u32 {
        self.world.bus().bit_rate_bit_s()
    }

    /// See [`super::Session::takes_fd`].
    pub(super) fn takes_fd(&self) -> Result<(), LinkError> {
        let advice = || "name a robot file with `[bus] data_bit_rate_bit_s`".to_owned();
        let error = || LinkError::ClassicalOnly { link: "sim".to_owned(), advice: advice() };
        self.world.bus().data_bit_rate_bit_s().map(|_| ()).ok_or_else(error)
    }

    pub fn cell(&self) -> &SimCell {
        &self.world.participants().0.0.0
    }

    pub(super) fn host_node(&mut self) -> &mut HostNode {
        let now = self.world.now();
        self.host_was_used = true;
        let node = &mut self.world.participants_mut().1.node;
        node.advance_to(now);
        node
    }

    pub(super) fn step(&mut self, until: Instant, seen: &mut Seen<'_>) -> Result<(), BusFailure> {
        if std::mem::take(&mut self.host_was_used) {
            self.world.take_from(self.host_port)?;
        }
        let to = (self.world.now() + SLICE).min(until);
        let host_port = self.host_port;
        self.world.run_until(to, &mut Tapped { seen, host_port })?;
        self.wait_for_clock();
        Ok(())
    }
}
