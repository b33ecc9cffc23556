//! The controller with its host link, two drives and two other nodes on one bus. Nothing here judges.

use std::borrow::Cow;
use std::collections::{BTreeMap, VecDeque};

use firmware::ControllerNode;
use firmware::authority::Seed;
use firmware::events::{Action, PlanEvent, PlanEvents};
use firmware::groups::powercube::settings::{GRIPPER_ADDRESS, HOME_V_RAD_S};
use firmware::joints::PerJoint;
use firmware::settings::Settings;
use firmware::spline::{Knot, Spline};
use firmware::store::RamStorage;
use firmware::trajectory_format::{self, FILE_LEN_MAX, Header};
use hil_sim::bus::BusConfig;
use hil_sim::fault::{Fault, FaultKind, Target, WireFault};
use hil_sim::participants::Participants;
use hil_sim::world::{Observer, RunError, World};
use protocol::cyphal::bits::Encode;
use protocol::cyphal::id::{NodeId, Priority, Route, TransferId};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::cyphal::uavcan::heartbeat::{self, Health, Heartbeat, Mode};
use protocol::{Duration, Frame, Instant, JointIndex, ModuleId, Node};

use crate::families::Family;
use crate::steps::Hand;

/// Joints and drives.
pub(crate) const JOINTS: usize = 2;
/// Port of the controller on the bus; the drives come before it, the clients after it.
pub(crate) const CONTROLLER: usize = JOINTS;
/// Node-ID of the controller.
pub(crate) const SERVER: NodeId = NodeId::from_low_bits(10);
/// Node-IDs of host and other node.
pub(crate) const CLIENTS: [NodeId; 2] = [NodeId::from_low_bits(42), NodeId::from_low_bits(43)];
/// Time from switching the gripper's output to the ball being free, ms.
pub(crate) const OPENING_MS: u16 = 20;
const BEAT: Duration = Duration::from_millis(30);

/// Two joints of the throwing arm with short ranges.
pub(crate) fn settings<F: Family>() -> Settings {
    let mut settings = Settings::powercube6();
    settings.joints = JOINTS as u32;
    GRIPPER_ADDRESS.set(&mut settings, 2);
    // The widest that is allowed without an unlock: either value may be written, and a change begins a search for the drives.
    settings.watchdog_prove = false;
    settings.gripper_opening_us = u32::from(OPENING_MS) * 1_000;
    for joint in JointIndex::first(JOINTS) {
        let limits = settings.joint.at_mut(joint);
        (limits.q_min_rad, limits.q_max_rad) = (-0.6, 1.0);
        HOME_V_RAD_S.set_at(&mut settings, joint, -0.5);
    }
    F::adapt(&mut settings);
    settings.gains_certificate_crc32 = firmware::registers::certificate_crc32(&settings);
    settings
}

/// The controller on a processor that is busy with something else now and then.
pub(crate) struct Late<F: Family> {
    node: Box<ControllerNode<RamStorage, Spline, F::Group>>,
    now: Instant,
    held_until: Instant,
    waiting: VecDeque<Frame>,
    out: VecDeque<Frame>,
    /// A deadline that was at or before the time at which all that was due had been served, and that time.
    pub(crate) stuck: Option<(Instant, Instant)>,
}

impl<F: Family> Late<F> {
    fn is_held(&self) -> bool {
        self.now < self.held_until
    }

    fn collect(&mut self) {
        while let Some(frame) = self.node.poll_frame() {
            self.out.push_back(frame);
        }
    }

    fn catch_up(&mut self) {
        while let Some(frame) = self.waiting.pop_front() {
            self.node.handle_frame(self.now, &frame);
            self.collect();
        }
    }
}

impl<F: Family> Node for Late<F> {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.now = now;
        self.waiting.push_back(*frame);
        if !self.is_held() {
            self.catch_up();
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
        if self.is_held() {
            return;
        }
        self.catch_up();
        if self.node.poll_timeout().is_none_or(|deadline| deadline > now) {
            return;
        }
        self.node.handle_timeout(now);
        self.collect();
        if let Some(deadline) = self.node.poll_timeout().filter(|deadline| *deadline <= now) {
            self.stuck = self.stuck.or(Some((deadline, now)));
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.collect();
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        if self.is_held() { Some(self.held_until) } else { self.node.poll_timeout() }
    }
}

/// A node that sends what it is given, and heartbeats.
pub(crate) struct Client {
    address: NodeId,
    tx: TxQueue<16, 600>,
    out: VecDeque<Frame>,
    /// Last number of each session.
    transfers: BTreeMap<u32, TransferId>,
    beat_due: Instant,
}

impl Client {
    fn new(address: NodeId) -> Self {
        Self {
            address,
            tx: TxQueue::new(),
            out: VecDeque::new(),
            transfers: BTreeMap::new(),
            beat_due: Instant::from_micros(1),
        }
    }

    /// Sends a transfer and returns its number.
    fn send(&mut self, now: Instant, route: Route, priority: Priority, message: &dyn Encode) -> TransferId {
        let last = self.transfers.entry(route.can_id(priority).get()).or_insert(TransferId::ZERO);
        *last = last.next();
        let transfer_id = *last;
        let meta = TxMeta { route, priority, transfer_id, deadline: now + Duration::from_secs(1) };
        self.tx.push(&meta, message).expect("the queue is emptied after each transfer");
        while let Some(frame) = self.tx.pop() {
            self.out.push_back(frame);
        }
        transfer_id
    }
}

impl Node for Client {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}

    fn handle_timeout(&mut self, now: Instant) {
        if self.beat_due > now {
            return;
        }
        self.beat_due = now + BEAT;
        let beat = Heartbeat {
            uptime_s: (now.as_micros() / 1_000_000) as u32,
            health: Health::Nominal,
            mode: Mode::OPERATIONAL,
            vendor_status: 0,
        };
        let route = Route::Message { subject: heartbeat::SUBJECT, source: self.address };
        self.send(now, route, Priority::Nominal, &beat);
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.beat_due)
    }
}

/// Controller and clients.
pub(crate) struct Crew<F: Family> {
    pub(crate) controller: Late<F>,
    pub(crate) clients: [Client; 2],
}

impl<F: Family> Participants for Crew<F> {
    fn len(&self) -> usize {
        3
    }

    fn node(&mut self, index: usize) -> &mut dyn Node {
        let Self { controller, clients: [host, other] } = self;
        match index {
            0 => controller,
            1 => host,
            _ => other,
        }
    }

    fn name(&self, index: usize) -> Cow<'_, str> {
        ["controller", "host", "other node"][index].into()
    }

    fn accepts(&self, index: usize, _: &Frame) -> bool {
        index == 0
    }
}

/// Frames of one piece of time: end on the bus, port of the sender, frame.
#[derive(Default)]
pub(crate) struct Tap(pub Vec<(Instant, Option<usize>, Frame)>);

impl Observer for Tap {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        self.0.push((at, from, *frame));
    }
}

/// The bus with everything on it.
pub(crate) struct Lab<F: Family> {
    pub(crate) world: World<(F::Drives, Crew<F>)>,
    faults: u32,
}

impl<F: Family> Lab<F> {
    /// All switched on and homed, joints at `start_mrad`.
    pub(crate) fn new(start_mrad: [i16; JOINTS], seed: u64) -> Self {
        let drives = F::drives(start_mrad.map(|q| f64::from(q) * 1e-3), seed);
        let settings = settings::<F>();
        let node = ControllerNode::with_group(
            Instant::ZERO,
            RamStorage::new(),
            F::group(),
            &settings,
            Default::default(),
            Seed::FORESEEABLE,
        );
        let controller = Late {
            node: Box::new(node),
            now: Instant::ZERO,
            held_until: Instant::ZERO,
            waiting: VecDeque::new(),
            out: VecDeque::new(),
            stuck: None,
        };
        let crew = Crew { controller, clients: CLIENTS.map(Client::new) };
        let mut world =
            World::new((drives, crew), BusConfig::default(), seed, Vec::new()).expect("five nodes on a bus");
        for port in CONTROLLER..CONTROLLER + 3 {
            world.set_queue_depth(port, 512);
        }
        Self { world, faults: 0 }
    }

    pub(crate) fn now(&self) -> Instant {
        self.world.now()
    }

    pub(crate) fn drives(&self) -> &F::Drives {
        &self.world.participants().0
    }

    /// Positions and speeds of the joints.
    pub(crate) fn plant(&self) -> [(f64, f64); JOINTS] {
        F::plant(self.drives())
    }

    /// A deadline that stood still, see [`Late::stuck`].
    pub(crate) fn stuck(&self) -> Option<(Instant, Instant)> {
        self.world.participants().1.controller.stuck
    }

    /// When the controller is called again.
    pub(crate) fn held_until(&self) -> Instant {
        self.world.participants().1.controller.held_until
    }

    pub(crate) fn run(&mut self, us: u64, tap: &mut Tap) -> Result<(), RunError> {
        let end = self.now() + Duration::from_micros(us);
        self.world.run_until(end, tap)
    }

    fn with<R>(
        &mut self,
        act: impl FnOnce(&mut F::Drives, &mut Crew<F>, Instant) -> R,
    ) -> Result<R, RunError> {
        self.world.with_participants(|(drives, crew), now| act(drives, crew, now))
    }

    /// Sends a transfer of client `client`.
    pub(crate) fn send(
        &mut self,
        client: usize,
        route: Route,
        priority: Priority,
        message: &dyn Encode,
    ) -> Result<TransferId, RunError> {
        self.with(|_, crew, now| crew.clients[client].send(now, route, priority, message))
    }

    pub(crate) fn hold_up(&mut self, ms: u16) -> Result<(), RunError> {
        self.with(|_, crew, now| {
            let until = now + Duration::from_millis(ms.into());
            (crew.controller.now, crew.controller.held_until) = (now, until);
        })
    }

    pub(crate) fn silence(&mut self, ms: u16) -> Result<(), RunError> {
        self.with(|_, crew, now| crew.clients[0].beat_due = now + Duration::from_millis(ms.into()))
    }

    pub(crate) fn restart(&mut self, drive: usize) -> Result<(), RunError> {
        self.with(|drives, _, now| F::restart(drives, drive, now))
    }

    pub(crate) fn deafen(&mut self, drive: usize, ms: u16) {
        self.faults += 1;
        let fault = Fault {
            label: format!("deaf {}", self.faults),
            kind: FaultKind::Wire(WireFault::Drop),
            target: Target::Module(ModuleId::new(drive as u8 + 1).expect("addresses from 1")),
            filter: None,
            start: self.now(),
            at: None,
            length: Some(Duration::from_millis(ms.into())),
            every: None,
            probability: 1.0,
        };
        self.world.add_fault(fault).expect("a drive of the bench");
    }
}

/// Trajectory file from `from_rad`, to `mrad`, at rest at both ends.
pub(crate) fn plan(from_rad: [f64; JOINTS], mrad: [i16; JOINTS], ms: u16, hand: Hand) -> Vec<u8> {
    let knot = |t_us: u32, share: f64| {
        let mut state = PerJoint::default();
        for (i, joint) in JointIndex::first(JOINTS).enumerate() {
            state.set(joint, ((from_rad[i] + share * (f64::from(mrad[i]) * 1e-3 - from_rad[i])) as f32, 0.0));
        }
        Knot { t_us, state }
    };
    let mut events = PlanEvents::NONE;
    let mut event = |ms: u16, action| {
        assert!(events.push(PlanEvent { t_us: u32::from(ms) * 1_000, action }));
    };
    match hand {
        Hand::Nothing => {}
        Hand::Open(at) => event(at, Action::Open),
        Hand::CloseAndOpen(at) => {
            event(at, Action::Close);
            event(at + OPENING_MS, Action::Open);
        }
    }
    let header = Header { joints: JOINTS as u8, period_us: 3_000, events, ..Header::default() };
    let mut file = vec![0; FILE_LEN_MAX];
    let knots = [knot(0, 0.0), knot(u32::from(ms) * 1_000, 1.0)];
    let len = trajectory_format::encode(&header, &knots, &mut file).expect("two knots fit");
    file.truncate(len);
    file
}
