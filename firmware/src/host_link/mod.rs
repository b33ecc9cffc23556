//! The controller with its host link: Cyphal/CAN beside the drives.
//!
//! This module only translates. `app` answers requests to the node, `messages` turns commands into [`Order`]s,
//! register values into numbers and samples into messages, `history` turns freeze frame and trace into files,
//! `can_node` makes controllers nodes of a CAN bus. This file decides when each frame leaves. The numbers,
//! parameters and messages are those of [`protocol::cyphal::cubecell`].
//!
//! # Two ports
//!
//! Drives and host link are two [`Port`]s. A board chooses:
//!
//! | wiring | how |
//! |---|---|
//! | one CAN bus for both (the default) | the node is a [`protocol::Node`]; 11-bit ids are the drives', 29-bit ids the host's ([`Port::on_one_bus`]) |
//! | a bus for each | [`HostBus::Own`]; the runner names the port with each call: [`ControllerNode::handle_host_frame`], [`ControllerNode::handle_packet`], [`ControllerNode::poll_host_frame`], [`ControllerNode::poll_packet`] |
//! | drives that do not speak CAN | the same; packets are those of the group |
//! | no host link | [`Controller`] itself, with orders given in the process |
//!
//! # Which node is the host
//!
//! The node that gave the last accepted order. Only its heartbeats and its commands keep a motion alive. While an
//! offer to arm is pending, and while the group is armed or moves, other nodes may only stop and disarm. A host
//! whose uptime decreases has restarted: its offer and its arming become void, and its motion stops. A host must
//! send heartbeats more often than `host.timeout_us`; the one per second of the standard is not enough. While the
//! group is armed or moves, a heartbeat later than half of that time causes a warning (`uavcan.diagnostic.Record`),
//! and one later than all of it a stop.
//!
//! # Bus load
//!
//! On one bus the drives come first. While a control cycle runs, Cyphal frames are sent after the last motion's
//! answer, or one per two cycles if no time is left. At rest they keep a distance, so that a long answer never
//! fills a transmit queue before a halt. A received stop acts at once and needs no frame of this node. A call that
//! makes a control step does nothing else: samples are taken in the next call.

mod app;
mod can_node;
pub mod history;
mod messages;

use core::borrow::BorrowMut;

use protocol::cyphal::cubecell::{joint_state, stop, target};
use protocol::cyphal::id::{NodeId, Priority, SubjectId};
use protocol::cyphal::server::{ControllerCore, Publication};
use protocol::cyphal::uavcan::diagnostic::Severity;
use protocol::cyphal::uavcan::heartbeat;
use protocol::{Duration, Frame, Instant, JOINTS_MAX};

use self::app::{App, LateHost};
pub use self::messages::{group_message, target_of};
use crate::authority::{Peer, Seed};
use crate::controller::Controller;
use crate::fault::Refusal;
use crate::group::DriveGroup;
use crate::orders::{Done, Order};
use crate::settings::Settings;
use crate::spline::Spline;
use crate::state::StateKind;
use crate::store::Storage;
use crate::telemetry::{GroupSample, JointSample};

/// Time between Cyphal frames: a little more than a frame takes at 1 Mbit/s.
const SPACING: Duration = Duration::from_micros(160);
/// Longest time that telemetry waits after a control step, if no frame comes before.
const LATER: Duration = Duration::from_millis(1);

/// Name of the program in `GetInfo`.
pub const NODE_NAME: &[u8] = b"cubecell.controller";

/// What a board knows about itself.
#[derive(Clone, Copy, Debug, Default)]
pub struct Identity {
    /// Unique identifier of this board.
    pub unique_id: [u8; 16],
    /// Board, major and minor version.
    pub hardware: (u8, u8),
}

/// Port that a frame comes from, or goes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Port {
    /// The drives.
    Drives,
    /// The host link.
    Host,
}

impl Port {
    /// The port of a frame where both share a bus: drives have 11-bit ids, Cyphal has 29-bit ids.
    pub const fn on_one_bus(frame: &Frame) -> Self {
        if frame.is_extended() { Self::Host } else { Self::Drives }
    }
}

/// Which bus the host link uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HostBus {
    /// The bus of the drives: host frames wait for the drives, and count to the load of the bus.
    #[default]
    Shared,
    /// A bus of its own.
    Own,
}

/// Controller and host link.
pub struct ControllerNode<S, M, G> {
    link: ControllerCore,
    app: App<S, M, G>,
    group_state: Publication,
    joint_state: Publication,
    target_answer: Publication,
    last_state: Option<StateKind>,
    was_unlocked: bool,
    sequence: u16,
    last_bits: u32,
    last_at: Instant,
    /// When the last Cyphal frame was handed out.
    last_frame: Instant,
    held: Option<Frame>,
    host_bus: HostBus,
    /// A control step was made in the last call: work that is not urgent is done in the next call, at the latest at this time.
    later: Option<Instant>,
    now: Instant,
}

#[inline(never)]
fn link(now: Instant) -> ControllerCore {
    ControllerCore::new(now, NodeId::from_low_bits(0))
}

/// Until the settings are known.
const UNSET: SubjectId = SubjectId::from_low_bits(0);

impl<S: Storage, G: DriveGroup> ControllerNode<S, Spline, G> {
    /// [`Self::with_spline`] with a spline of its own.
    pub fn new(now: Instant, storage: S, defaults: &Settings, identity: Identity, seed: Seed) -> Self {
        Self::with_spline(now, storage, Spline::empty(), defaults, identity, seed)
    }

    /// [`Self::new`] with a group that was made with options of its own.
    pub fn with_group(
        now: Instant,
        storage: S,
        group: G,
        defaults: &Settings,
        identity: Identity,
        seed: Seed,
    ) -> Self {
        let mut node = Self::blank(now, storage, Spline::empty(), identity, seed);
        node.app.controller.set_group(group);
        node.restore(defaults);
        node
    }
}

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> ControllerNode<S, M, G> {
    /// Node that starts at `now`; see [`Controller::with_spline`]. Node-ID and subjects are those of the settings.
    pub fn with_spline(
        now: Instant,
        storage: S,
        spline: M,
        defaults: &Settings,
        identity: Identity,
        seed: Seed,
    ) -> Self {
        let mut node = Self::blank(now, storage, spline, identity, seed);
        node.restore(defaults);
        node
    }

    /// First half of [`Self::with_spline`], for a board: the value is built in the place in which it is kept, and
    /// [`Self::restore`] must follow before anything else. In one call the node would be built and then moved,
    /// which needs stack for two of them.
    // The large parts come last, each from a call; otherwise the compiler builds them elsewhere (see `Controller::blank`).
    #[inline(never)]
    pub fn blank(now: Instant, storage: S, spline: M, identity: Identity, seed: Seed) -> Self {
        let valid = Duration::from_millis(200);
        Self {
            group_state: Publication::new(UNSET, Priority::Nominal, valid),
            joint_state: Publication::new(UNSET, Priority::Low, valid),
            target_answer: Publication::new(UNSET, Priority::Fast, valid),
            last_state: None,
            was_unlocked: false,
            sequence: 0,
            last_bits: 0,
            last_at: now,
            last_frame: now,
            held: None,
            host_bus: HostBus::Shared,
            later: None,
            now,
            link: link(now),
            app: App::blank(storage, spline, identity, seed),
        }
    }

    /// Second half of [`Self::with_spline`]: loads the stored settings and trajectory; the rest is as in `defaults`.
    #[inline(never)]
    pub fn restore(&mut self, defaults: &Settings) {
        self.app.controller.restore(defaults);
        let settings = self.app.controller.settings();
        let subject = |number: u32| SubjectId::from_low_bits(number as u16);
        let subjects = [
            subject(settings.group_state_subject),
            subject(settings.joint_state_subject),
            subject(settings.target_answer_subject),
        ];
        self.app.ports = [
            stop::port(subject(settings.stop_subject)),
            heartbeat::PORT,
            target::port(subject(settings.target_subject)),
        ];
        self.link.set_address(NodeId::from_low_bits(settings.node_id as u8));
        self.app.subjects = subjects;
        [self.group_state.subject, self.joint_state.subject, self.target_answer.subject] = subjects;
    }

    /// Sets which bus the host link uses.
    pub const fn set_host_bus(&mut self, host_bus: HostBus) {
        self.host_bus = host_bus;
    }

    /// The controller behind the link.
    pub const fn controller(&self) -> &Controller<S, M, G> {
        &self.app.controller
    }

    /// An order of the program that runs this node, such as a stop before it is switched off. It does not come
    /// through the host link, so the host stays the same.
    ///
    /// # Errors
    ///
    /// As [`Controller::order`].
    pub fn order(&mut self, now: Instant, order: Order) -> Result<Done, Refusal> {
        self.now = now;
        self.app.controller.order(now, Peer::LOCAL, order)
    }

    /// Same effect as a stop message on the bus: the halt broadcast is the next frame out.
    pub fn stop_now(&mut self, now: Instant) {
        self.now = now;
        self.app.controller.stop_now(now);
    }

    /// Level to put on the board's gripper output, once per change.
    pub const fn take_gripper_level(&mut self) -> Option<bool> {
        self.app.controller.take_gripper_level()
    }

    /// Warns of a late host before its motion is stopped.
    fn warn_of_late_host(&mut self, now: Instant) {
        match self.app.late_host {
            LateHost::No => {}
            LateHost::Seen => {
                self.app.late_host = LateHost::Warned;
                self.link.log(now, Severity::Warning, "host late: over half of host.timeout_us");
            }
            LateHost::Warned => {
                let state = self.app.controller.state().kind();
                if !state.may_move() && state != StateKind::Armed {
                    self.app.late_host = LateHost::No;
                }
            }
        }
    }

    /// Sends messages that are due: answers at once, the state when it changes, all of them once per telemetry period.
    fn publish(&mut self, now: Instant) {
        if let Some(answer) = self.app.answer.take() {
            let _ = self.link.publish(now, &mut self.target_answer, &answer);
        }
        let state = self.app.controller.state().kind();
        let changed = self.last_state != Some(state);
        let due = self.app.controller.take_telemetry_due(now);
        let unlocked = self.app.controller.is_unlocked();
        if self.was_unlocked != unlocked {
            self.was_unlocked = unlocked;
            let text = if unlocked { "limits unlocked" } else { "limits of the robot hold again" };
            self.link.log(now, Severity::Warning, text);
        } else if !changed && !due {
            return;
        }
        let sample = self.app.controller.take_sample(now);
        if changed {
            self.last_state = Some(state);
            self.log_change(now, &sample);
        }
        let elapsed_us = now.saturating_since(self.last_at).as_micros().max(1);
        let bits = sample.bus_bits.wrapping_sub(self.last_bits);
        (self.last_bits, self.last_at) = (sample.bus_bits, now);
        // At 1 Mbit/s a bit is a microsecond. 32-bit arithmetic: 64 bits would bring in a long division.
        let elapsed_us = u32::try_from(elapsed_us).unwrap_or(u32::MAX);
        let load = u32::min(bits, 4_000_000).saturating_mul(1_000).checked_div(elapsed_us).unwrap_or(0);
        self.sequence = self.sequence.wrapping_add(1);
        let mut message = group_message(&sample, self.sequence, self.app.complete);
        message.bus_load_permille = load.min(1_000) as u16;
        let _ = self.link.publish(now, &mut self.group_state, &message);
        if due {
            let controller = &self.app.controller;
            let mut joints = [JointSample::default(); JOINTS_MAX];
            for (to, joint) in joints.iter_mut().zip(controller.joints()) {
                *to = controller.joint_sample(joint);
            }
            let count = controller.settings().joints as usize;
            let joints = joints.get(..count).unwrap_or(&joints);
            let cycle = sample.counters.cycles as u16;
            let message = joint_state::JointState::new(now.as_micros(), cycle, joints);
            let _ = self.link.publish(now, &mut self.joint_state, &message);
        }
    }

    /// Work of a call after the drives are served.
    fn after_the_drives(&mut self, now: Instant) {
        self.later = None;
        self.warn_of_late_host(now);
        self.publish(now);
        if self.link.poll_timeout() <= now {
            self.link.handle_timeout(now, &self.app);
        }
        self.refill();
    }

    fn log_change(&mut self, now: Instant, sample: &GroupSample) {
        let Some(fault) = sample.fault else { return };
        if matches!(sample.state, StateKind::Fault | StateKind::Stopped) {
            let severity = if fault.cause.is_plain_stop() { Severity::Notice } else { Severity::Error };
            self.link.log(now, severity, fault.cause.latched_name());
        }
    }

    /// When a Cyphal frame may be handed out.
    fn may_send_at(&self) -> Instant {
        let controller = &self.app.controller;
        let waits = self.host_bus == HostBus::Shared && controller.needs_wire();
        self.last_frame + if waits { controller.settings().cycle_period() * 2 } else { SPACING }
    }

    fn count(&mut self, frame: &Frame) {
        if self.host_bus == HostBus::Shared {
            self.app.controller.count_foreign(frame.nominal_bits());
        }
    }

    fn refill(&mut self) {
        if self.held.is_none() {
            self.held = self.link.poll_frame();
        }
    }

    /// A frame of the host's port.
    pub fn handle_host_frame(&mut self, now: Instant, frame: &Frame) {
        self.now = now;
        self.count(frame);
        self.link.handle_frame(now, frame, &mut self.app);
        self.after_the_drives(now);
    }

    /// A packet of the drives' port. If it makes a control step, the call does nothing else.
    pub fn handle_packet(&mut self, now: Instant, packet: &G::Packet) {
        self.now = now;
        let cycles = self.app.controller.cycles();
        self.app.controller.handle_packet(now, packet);
        self.after_a_call(now, cycles);
    }

    /// A deadline of [`Self::poll_deadline`] has come. If it makes a control step, the call does nothing else.
    pub fn handle_deadline(&mut self, now: Instant) {
        self.now = now;
        let cycles = self.app.controller.cycles();
        // Harmless if nothing is due, and cheaper than to check.
        self.app.controller.handle_deadline(now);
        self.after_a_call(now, cycles);
    }

    fn after_a_call(&mut self, now: Instant, cycles: u32) {
        if self.app.controller.cycles() == cycles {
            self.after_the_drives(now);
        } else {
            self.later = Some(now + LATER);
        }
    }

    /// Next packet for the drives' port.
    pub fn poll_packet(&mut self) -> Option<G::Packet> {
        self.app.controller.poll_packet()
    }

    /// Next frame for the host's port. On a shared bus it comes after [`Self::poll_packet`] has returned `None`.
    pub fn poll_host_frame(&mut self) -> Option<Frame> {
        self.refill();
        if self.may_send_at() > self.now {
            return None;
        }
        let frame = self.held.take()?;
        self.last_frame = self.now;
        self.count(&frame);
        self.refill();
        Some(frame)
    }

    /// Next deadline of both ports.
    pub fn poll_deadline(&self) -> Option<Instant> {
        let paced = self.held.is_some().then(|| self.may_send_at()).filter(|at| *at > self.now);
        let link = self.later.unwrap_or_else(|| self.link.poll_timeout());
        self.app.controller.poll_deadline().into_iter().chain([link]).chain(paced).min()
    }
}
