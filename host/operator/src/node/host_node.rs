//! The host's one node on the bus: sends requests and orders, keeps the answers.

use std::collections::{BTreeMap, VecDeque};

use protocol::canopen::client::Failure;
use protocol::canopen::long_read::{Form, LongRead};
use protocol::canopen::{Function, Object};
use protocol::cyphal::cubecell::stop::{self, Reason, Sender};
use protocol::cyphal::cubecell::target::{self, TargetState};
use protocol::cyphal::id::{NodeId, Priority, Route, Tail, TransferId};
use protocol::cyphal::server::Publication;
use protocol::cyphal::tx::SendError;
use protocol::powercube::{
    Address, Broadcast, Channel, CubeState, MotionPosition, Parameter, PosStateDio, Reply, Request, Value,
};
use protocol::{Duration, Frame, Id, Instant, ModuleId, Node};

use super::drive_client::{DriveClient, Outcome, RequestFailed, Ticket};
use super::inbox::{CyphalLink, Inbox, NODE_ID, NODE_ID_MIN};
use super::stop_watch::{StopSeen, StopWatch};

/// Answers of one module, to requests of any node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Heard {
    /// Time of the last answer.
    pub at: Instant,
    pub frames: u64,
    pub position_rad: Option<f32>,
    pub position_at: Instant,
    pub state: Option<CubeState>,
    pub current_a: Option<f32>,
    /// The last position came with NOT_OK set.
    pub not_ok: bool,
}

impl Heard {
    const fn tell_position(&mut self, rad: f32, at: Instant) {
        (self.position_rad, self.position_at) = (Some(rad), at);
    }
}

/// Counts of what the host node saw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    pub received: u64,
    /// Of these, with 29-bit ids.
    pub extended: u64,
    /// Requests and broadcasts to drives from another node.
    pub foreign_requests: u64,
    /// Frames of the master of a CANopen network.
    pub of_master: u64,
    /// Frames of other host tools, by their node-IDs: another `cubectl`.
    pub tools: u64,
    pub sent: u64,
    /// Frames from drives that are no valid answer.
    pub malformed: u64,
}

#[derive(Clone, Debug)]
pub struct HostNode {
    /// Requests to drives.
    pub drives: DriveClient,
    now: Instant,
    node_id: NodeId,
    /// Bit k: a tool with node-ID [`NODE_ID_MIN`] + k is on the bus.
    tools: u16,
    out: VecDeque<Frame>,
    heard: BTreeMap<ModuleId, Heard>,
    tally: Tally,
    stop_transfer: TransferId,
    /// An object of a CANopen node that is read, or was.
    object: Option<(LongRead, Vec<u8>)>,
    /// The host link to a controller, once a verb needs it.
    link: Option<Box<CyphalLink>>,
    targets: Publication,
    /// Frames of the host link without hurry, and when the next may go.
    background: VecDeque<Frame>,
    background_due: Instant,
    /// The host link receives, but sends nothing.
    mute: bool,
    /// Requests and answers of each module, of any node.
    talks: BTreeMap<ModuleId, (u32, u32)>,
    pub(crate) stops: StopWatch,
}

/// Longest object that is not read in blocks, bytes.
pub(crate) const OBJECT_MAX: u32 = 256;
/// Least time between two frames of the lowest priority. A controller sends a request to a drive, waits for its
/// answer and continues with the next: waiting frames of any priority fill every gap, and five late cycles in a row
/// are a fault. One frame in each cycle of 3 ms does no harm.
pub(crate) const BACKGROUND_GAP: Duration = Duration::from_micros(2_500);
/// An end state that could not be sent by then is dropped: a newer one has come.
const TARGET_VALID: Duration = Duration::from_millis(20);
/// Answers that one module may have given beyond the visible requests: some requests came before this program listened.
const EXTRA_ANSWERS_MAX: u32 = 3;

impl Default for HostNode {
    fn default() -> Self {
        Self {
            drives: DriveClient::default(),
            now: Instant::ZERO,
            node_id: NODE_ID,
            tools: 0,
            out: VecDeque::new(),
            heard: BTreeMap::new(),
            tally: Tally::default(),
            stop_transfer: TransferId::ZERO,
            object: None,
            link: None,
            targets: Publication::new(target::SUBJECT, Priority::Fast, TARGET_VALID),
            background: VecDeque::new(),
            background_due: Instant::ZERO,
            mute: false,
            talks: BTreeMap::new(),
            stops: StopWatch::default(),
        }
    }
}

impl HostNode {
    /// Begins a request at the host node's present time.
    ///
    /// # Errors
    /// [`RequestFailed::QueueFull`].
    pub fn start(&mut self, module: ModuleId, request: Request) -> Result<Ticket, RequestFailed> {
        self.drives.start(self.now, module, request)
    }

    /// The next request that has ended.
    pub fn poll_outcome(&mut self) -> Option<Outcome> {
        self.drives.poll_outcome()
    }

    pub fn send(&mut self, frame: Frame) {
        self.out.push_back(frame);
    }

    /// Orders everything on the bus to stand still: halt broadcast to the drives, stop message to a controller.
    /// Waiting frames are discarded first.
    pub fn halt(&mut self, reason: Reason) {
        self.drives.cancel_all();
        self.out.clear();
        self.out.push_back(self.stop_message(reason));
        self.stop_transfer = self.stop_transfer.next();
        self.out.push_back(Broadcast::Halt.encode());
    }

    /// The Cyphal message that stops a controller: one frame, highest priority.
    fn stop_message(&self, reason: Reason) -> Frame {
        let route = Route::Message { source: self.node_id, subject: stop::SUBJECT };
        let tail = Tail { start: true, end: true, toggle: true, transfer_id: self.stop_transfer };
        let bytes = [reason.0, Sender::CUBECTL.0, 0, 0, tail.byte()];
        Frame::from_array(route.can_id(Priority::Exceptional), bytes)
    }

    /// The host link to a controller; from the first call on the host node is a Cyphal node with a heartbeat.
    pub(crate) fn link(&mut self) -> (&mut CyphalLink, Instant) {
        let (now, node_id) = (self.now, self.node_id);
        (self.link.get_or_insert_with(|| Box::new(super::inbox::link(now, node_id))), now)
    }

    /// Cyphal node-ID of this host.
    pub const fn node_id(&self) -> NodeId {
        self.node_id
    }

    /// Takes the highest node-ID of tools that is free on the bus. Call it before the first frame of the host link.
    /// If all are taken, the node-ID stays.
    pub(crate) fn take_free_node_id(&mut self) {
        let free = (NODE_ID_MIN.get()..=NODE_ID.get()).rev().map(NodeId::from_low_bits);
        let Some(free) = free.into_iter().find(|node| self.tools & tool_bit(*node) == 0) else { return };
        self.node_id = free;
        if let Some(link) = &mut self.link {
            link.set_address(free);
        }
    }

    /// Sends a new end state to the controller.
    pub(crate) fn publish_target(&mut self, message: &TargetState) -> Result<(), SendError> {
        self.link();
        let now = self.now;
        let Some(link) = self.link.as_mut() else { return Ok(()) };
        link.publish(now, &mut self.targets, message)
    }

    /// Receives from a controller without being a node: a heartbeat would keep a motion of another host alive.
    pub fn listen_only(&mut self) {
        self.link();
        self.mute = true;
    }

    /// Is a node again after [`HostNode::listen_only`].
    pub const fn speak(&mut self) {
        self.mute = false;
    }

    /// Modules that gave more answers than there were requests: two drives have the address.
    pub fn double_answers(&self) -> Vec<ModuleId> {
        let doubled =
            self.talks.iter().filter(|(_, (asked, reported))| *reported > *asked + EXTRA_ANSWERS_MAX);
        doubled.map(|(module, _)| *module).collect()
    }

    fn asked(&mut self, frame: &Frame) {
        if !frame.is_extended()
            && let Some(Address::Module(Channel::Get | Channel::Put, module)) = Address::of(frame.id())
        {
            self.talks.entry(module).or_default().0 += 1;
        }
    }

    /// What the host link received.
    pub fn inbox(&mut self) -> Option<&mut Inbox> {
        self.link.as_mut().map(|link| &mut link.listener)
    }

    /// Time without a message of the controller, not counting the time before `since`; zero if there was never a message.
    pub fn silence(&self, since: Instant) -> Duration {
        let heard = self.link.as_ref().and_then(|link| link.listener.group);
        heard.map_or(Duration::ZERO, |(at, ..)| self.now.saturating_since(at.max(since)))
    }

    /// A stop that ends the job: see [`StopWatch::due`].
    pub(crate) fn stop_due(&self) -> Option<StopSeen> {
        let heard = self.link.as_ref().and_then(|link| link.listener.group);
        self.stops.due(self.now, heard.map(|(at, _, group)| (at, group)))
    }

    /// Answers of each module.
    pub const fn heard(&self) -> &BTreeMap<ModuleId, Heard> {
        &self.heard
    }

    /// Present time.
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Reads an object of a CANopen node of at most `size_max` bytes, a long one in blocks; an object that is still being read is given up.
    pub(crate) fn read_object(
        &mut self,
        node: protocol::canopen::NodeId,
        object: Object,
        patience: Duration,
        size_max: u32,
    ) {
        let form = if size_max > OBJECT_MAX { Form::Blocks } else { Form::Segments };
        let (read, frame) = LongRead::new(self.now, patience, node, object, size_max, form);
        self.object = Some((read, Vec::new()));
        self.out.push_back(frame);
    }

    /// The object that was read, or why not; `None` while it is read.
    pub(crate) fn object(&self) -> Option<Result<Vec<u8>, Failure>> {
        let (read, bytes) = self.object.as_ref()?;
        Some(read.outcome()?.map(|()| bytes.clone()))
    }

    pub const fn tally(&self) -> Tally {
        self.tally
    }

    /// Brings the host node's time up to `now` before a verb talks to it.
    pub(crate) fn advance_to(&mut self, now: Instant) {
        self.now = self.now.max(now);
    }

    /// The next frame of the host link: at once, or, at the lowest priority, one per [`BACKGROUND_GAP`].
    fn frame_of_the_link(&mut self) -> Option<Frame> {
        while let Some(frame) = self.link.as_mut()?.poll_frame() {
            match (self.mute, is_background(&frame)) {
                (true, _) => {}
                (false, true) => self.background.push_back(frame),
                (false, false) => return Some(frame),
            }
        }
        self.release_background();
        self.out.pop_front()
    }

    /// Sends a frame of the lowest priority if it is time. Nothing is due afterwards, whether or not the bus accepts it.
    fn release_background(&mut self) {
        if self.mute {
            self.background.clear();
        }
        if self.now >= self.background_due
            && let Some(frame) = self.background.pop_front()
        {
            self.out.push_back(frame);
            self.background_due = self.now + BACKGROUND_GAP;
        }
    }

    fn note(&mut self, module: ModuleId, reply: &Reply) {
        let heard = self.heard.entry(module).or_default();
        heard.at = self.now;
        heard.frames += 1;
        match *reply {
            Reply::Value(Parameter::ActPos, Value::F32(rad)) => heard.tell_position(rad, self.now),
            Reply::Value(Parameter::Cur, Value::F32(a)) => heard.current_a = Some(a),
            Reply::Value(Parameter::CubeState, Value::U32(bits)) => {
                heard.state = Some(CubeState::from_bits(bits));
            }
            Reply::Value(_, Value::PosStateDio(PosStateDio { position_rad, short_state, .. })) => {
                heard.tell_position(position_rad, self.now);
                heard.not_ok = short_state.intersects(protocol::powercube::ShortState::NOT_OK);
            }
            Reply::MotionExtended { position: MotionPosition::Radians(rad), short_state, .. } => {
                heard.tell_position(rad.get(), self.now);
                heard.not_ok = short_state.intersects(protocol::powercube::ShortState::NOT_OK);
            }
            Reply::State(state) => heard.state = Some(state),
            _ => {}
        }
    }
}

impl Node for HostNode {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.advance_to(now);
        self.tally.received += 1;
        self.tally.extended += u64::from(frame.is_extended());
        self.stops.take_frame(self.now, frame);
        if frame.is_extended() {
            let tool = source(frame).map_or(0, tool_bit);
            self.tally.tools += u64::from(tool != 0);
            self.tools |= tool;
            if let Some(link) = &mut self.link {
                link.handle_frame(self.now, frame);
                if let Some((at, _, group)) = &link.listener.group {
                    self.stops.take_state(*at, group);
                }
            }
            return;
        }
        if matches!(Function::of_frame(frame), Some(Function::Nmt | Function::Sync | Function::SdoToNode(_)))
        {
            self.tally.of_master += 1;
        }
        if let Some((read, bytes)) = &mut self.object {
            let next = read.handle_frame(self.now, frame, &mut |part| bytes.extend(part));
            self.out.extend(next);
        }
        match Address::of(frame.id()) {
            Some(Address::Module(Channel::Ack | Channel::State, _)) => {}
            Some(Address::Module(Channel::Get | Channel::Put, _) | Address::Broadcast) => {
                self.tally.foreign_requests += 1;
                self.asked(frame);
                return;
            }
            None => return,
        }
        match Reply::decode(frame) {
            Ok((module, reply)) => {
                self.note(module, &reply);
                if !matches!(reply, Reply::State(_)) {
                    self.talks.entry(module).or_default().1 += 1;
                    self.drives.take_reply(self.now, module, &reply);
                }
            }
            Err(_) => self.tally.malformed += 1,
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.advance_to(now);
        self.drives.handle_timeout(self.now);
        let ended = self.object.as_mut().and_then(|(read, _)| read.handle_timeout(self.now));
        self.out.extend(ended);
        if let Some(link) = &mut self.link {
            link.handle_timeout(self.now);
        }
        self.release_background();
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        let frame = match self.out.pop_front().or_else(|| self.drives.poll_frame()) {
            Some(frame) => frame,
            None => self.frame_of_the_link()?,
        };
        self.asked(&frame);
        self.tally.sent += 1;
        Some(frame)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let link = self.link.as_ref().and_then(|link| link.poll_timeout());
        let background = (!self.background.is_empty()).then_some(self.background_due);
        let object = self.object.as_ref().and_then(|(read, _)| read.poll_timeout());
        [self.drives.poll_timeout(), link, background, object].into_iter().flatten().min()
    }
}

/// Source address in a Cyphal frame.
fn source(frame: &Frame) -> Option<NodeId> {
    let Id::Extended(id) = frame.id() else { return None };
    Route::parse(id).ok().and_then(|(_, route)| route.source())
}

/// True for a Cyphal frame of the lowest priority.
fn is_background(frame: &Frame) -> bool {
    let Id::Extended(id) = frame.id() else { return false };
    Route::parse(id).is_ok_and(|(priority, _)| priority == Priority::Optional)
}

/// Bit of the node-ID of a host tool; 0 for another one.
const fn tool_bit(node: NodeId) -> u16 {
    if node.get() < NODE_ID_MIN.get() || node.get() > NODE_ID.get() {
        0
    } else {
        1 << (node.get() - NODE_ID_MIN.get())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of a host that is linked to a controller for a tenth of a second.
    fn frames_of(host: &mut HostNode) -> Vec<Frame> {
        host.link();
        let mut frames = Vec::new();
        for ms in 0..100 {
            host.handle_timeout(Instant::from_micros(1000 * ms));
            frames.extend(std::iter::from_fn(|| host.poll_frame()));
        }
        frames
    }

    #[test]
    fn each_further_tool_on_a_bus_takes_a_node_id_that_it_does_not_hear() {
        let mut heard: Vec<Frame> = Vec::new();
        for expected in (NODE_ID_MIN.get()..=NODE_ID.get()).rev().map(NodeId::from_low_bits) {
            let mut host = HostNode::default();
            host.listen_only();
            for frame in &heard {
                host.handle_frame(Instant::ZERO, frame);
            }
            host.speak();
            host.take_free_node_id();
            assert_eq!(host.node_id(), expected);
            let mut frames = frames_of(&mut host);
            host.halt(Reason::OPERATOR);
            frames.extend(std::iter::from_fn(|| host.poll_frame()).filter(Frame::is_extended));
            assert!(frames.len() > 3, "heartbeats and a stop message");
            assert!(frames.iter().all(|frame| source(frame) == Some(expected)));
            heard.extend(frames);
        }
        assert_eq!(source(&heard[0]), Some(NODE_ID));
    }

    /// A strict world ends a run in which a node requests to be called again at the time of the call.
    #[test]
    fn nothing_is_due_twice_while_the_bus_takes_no_frame() {
        let mut host = HostNode::default();
        host.link();
        let mut now = Instant::ZERO;
        for turn in 0..2_000 {
            host.handle_timeout(now);
            // Every third time the bus has room.
            if turn % 3 == 0 {
                while host.poll_frame().is_some() {}
            }
            let next = host.poll_timeout().expect("a heartbeat is due");
            assert!(next > now, "served at {now:?}, due at {next:?}");
            now = next;
        }
        assert!(now > Instant::from_micros(6_000_000), "past the list of ports: {now:?}");
    }

    /// Twenty-five frames one after the other fill the gaps of five cycles of 3 ms: a controller reported late cycles (401).
    #[test]
    fn long_message_without_hurry_goes_out_frame_by_frame_and_leaves_the_cycles_their_gaps() {
        let mut host = HostNode::default();
        host.link();
        let (mut sent_at, mut others) = (Vec::new(), 0);
        let mut now = Instant::ZERO;
        let end = Instant::from_micros(7_000_000);
        while now < end {
            host.handle_timeout(now);
            while let Some(frame) = host.poll_frame() {
                if is_background(&frame) {
                    sent_at.push(now);
                } else {
                    others += 1;
                }
            }
            let next = host.poll_timeout().expect("a heartbeat is due");
            assert!(next > now, "asks to be called again at once");
            now = next;
        }
        assert!(sent_at.len() >= 20, "the list of ports was sent: {} frames", sent_at.len());
        assert!(others > 200, "heartbeats: {others}");
        assert!(sent_at.windows(2).all(|two| two[1].saturating_since(two[0]) >= BACKGROUND_GAP));
        let first = sent_at.iter().find(|at| **at > Instant::from_micros(4_000_000)).copied();
        let last = sent_at.last().copied().unwrap_or_default();
        let took = first.map(|first| last.saturating_since(first)).unwrap_or_default();
        assert!(took < Duration::from_millis(500), "within the time-out of a transfer: {took:?}");
    }
}
