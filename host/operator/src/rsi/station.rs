//! The station: controller, group and a throw. Telegrams in, answers out; takes time only as an argument.

use std::collections::VecDeque;

use firmware::Controller;
use firmware::authority::{Peer, Seed};
use firmware::fault::{Cause, Fault, Refusal};
use firmware::group::DriveGroup;
use firmware::groups::rsi::{AT_START_RAD, Options, Packet, Rsi, Telegram};
use firmware::host_link::{group_message, history, target_of};
use firmware::joints::PerJoint;
use firmware::orders::{Done, Order};
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::{FileName, RamStorage};
use protocol::cyphal::bits::Decode;
use protocol::cyphal::crc::Crc64;
use protocol::cyphal::cubecell::group_state::GroupState;
use protocol::cyphal::cubecell::target::TargetState;
use protocol::{Duration, Instant};
use rsi_protocol::{Ipoc, ReadError};

use super::log::{Entry, Line};
use super::wire::Wire;
use crate::dialogue::operator::{OperatorError, refused};
use crate::dialogue::registers::{Numbers, to_host};
use crate::trajectory::{Encoded, Segment};

/// Who gives the orders: this program.
const SELF: Peer = Peer::new(1);
/// How long an offer to arm and an arming hold.
const VALID: Duration = Duration::from_secs(5);
/// Longest freeze frame or trace, bytes: more than any controller has.
const HISTORY_BYTES: usize = 64 * 1024;
/// Bytes of one piece of an upload.
const PIECE: usize = 256;

/// Where the throw is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    /// Waits for the robot's program and for the arm to stand.
    Waiting,
    /// An offer to arm is open.
    Offered {
        token: u32,
        /// The trajectory.
        name: FileName,
    },
    /// The arm moves, or is about to.
    Running {
        /// When the plan begins, by the time of the path.
        starts_at: Instant,
    },
    /// The arm stands at the end of the plan.
    Finished {
        /// When the plan began.
        started_at: Instant,
    },
    /// The controller stopped the arm after the order to run.
    Stopped { fault: Fault },
    /// The throw was refused, or ended before the order to run.
    NotThrown { refusal: Refusal },
}

impl Stage {
    /// Nothing follows.
    #[must_use]
    pub const fn is_end(&self) -> bool {
        matches!(self, Self::Finished { .. } | Self::Stopped { .. } | Self::NotThrown { .. })
    }
}

/// A robot that sends telegrams for this long and is never ready is given up.
const READY_WITHIN: Duration = Duration::from_secs(10);

/// New starts of a robot's program within one exchange, above which its start pose is believed to move.
const START_MOVES: u64 = 5;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub answers: u64,
    pub with_axes: u64,
    pub without_axes: u64,
    /// Datagrams that were no telegram.
    pub unreadable: u64,
    /// Telegrams that waited behind a newer one, and were not answered.
    pub drained: u64,
}

pub struct Station {
    controller: Box<Controller<RamStorage, Spline, Rsi>>,
    wire: Wire,
    /// Trajectories that are still to run, in order.
    files: VecDeque<Encoded>,
    /// Segments of the first one that the controller has.
    extended: usize,
    leaving: bool,
    /// The last trajectory waits for [`Station::proceed_from_hold`].
    holds: bool,
    log: Vec<Line>,
    stage: Stage,
    counts: Counts,
    last_unreadable: Option<ReadError>,
    /// When the robot sent its first telegram, or was ready last.
    waits_since: Option<Instant>,
    /// The robot was ready to be led once.
    was_ready: bool,
    /// Axis that is farthest from its start pose, and by how much, deg.
    off_start: Option<(usize, f64)>,
    /// Start pose of the last telegram, and how often it was another than before.
    start_rad: Option<PerJoint<f32>>,
    start_moves: u64,
}

impl Station {
    /// A station that runs trajectory files one after the other, as soon as the robot is there and stands at the start of the
    /// first. Without files it holds the robot where it stands.
    #[must_use]
    pub fn new(wire: Wire, settings: &Settings, options: Options, files: Vec<Encoded>) -> Self {
        // Orders come only from inside the program, so tokens may be predictable.
        let seed = Seed::FORESEEABLE;
        let controller =
            Controller::with_group(RamStorage::new(), Spline::empty(), Rsi::new(options), settings, seed);
        let mut station = Self {
            controller: Box::new(controller),
            wire,
            files: VecDeque::new(),
            extended: 0,
            leaving: false,
            holds: false,
            log: Vec::new(),
            stage: Stage::Waiting,
            counts: Counts::default(),
            last_unreadable: None,
            waits_since: None,
            was_ready: false,
            off_start: None,
            start_rad: None,
            start_moves: 0,
        };
        files.into_iter().for_each(|file| station.push(Instant::ZERO, file));
        station
    }

    /// One more trajectory to run, after those that are still to run.
    pub fn push(&mut self, now: Instant, Encoded { file, segments }: Encoded) {
        self.note(now, Entry::File(file.clone()));
        self.files.push_back(file.into());
        segments.into_iter().for_each(|segment| self.push_segment(now, segment));
        if matches!(self.stage, Stage::Finished { .. }) {
            self.stage = Stage::Waiting;
        }
    }

    /// One more segment of the last trajectory.
    pub(super) fn push_segment(&mut self, now: Instant, segment: Segment) {
        self.note(now, Entry::Segment(segment.bytes.clone()));
        if let Some(last) = self.files.back_mut() {
            last.segments.push(segment);
        }
    }

    pub(super) const fn controller(&self) -> &Controller<RamStorage, Spline, Rsi> {
        &self.controller
    }

    /// A new end state for the motion that runs, as a `cubecell.TargetState` on the wire.
    ///
    /// # Errors
    /// The controller's reason; the motion before continues.
    pub(super) fn retarget(&mut self, now: Instant, message: &[u8]) -> Result<(), Refusal> {
        self.note(now, Entry::Target(message.to_vec()));
        let message = TargetState::from_bytes(message).map_err(|_| Refusal::of(Cause::BadValue))?;
        self.controller.order(now, SELF, Order::Retarget(target_of(&message)?)).map(drop)
    }

    /// Where the throw is.
    #[must_use]
    pub const fn stage(&self) -> &Stage {
        &self.stage
    }

    #[must_use]
    pub fn state(&self) -> StateKind {
        self.controller.state().kind()
    }

    #[must_use]
    pub const fn counts(&self) -> &Counts {
        &self.counts
    }

    /// State of the robot so far, for people who wait for it.
    #[must_use]
    pub fn heard(&self) -> String {
        let Counts { with_axes, without_axes, unreadable, .. } = self.counts;
        let mut text = format!("heard: {with_axes} telegrams with axes, {without_axes} without");
        if let Some(error) = &self.last_unreadable {
            text += &format!(", {unreadable} that cannot be read ({error})");
        }
        if let Some((axis, deg)) = self.off_start {
            text += &format!("; A{axis} is {deg:.2} deg from the start pose that the telegrams name");
        }
        if self.start_pose_moves() {
            text += &format!("; the start pose (ASPos) moved {} times", self.start_moves);
        }
        text
    }

    /// The start pose in the telegrams moves as the axes do, so it is not a start pose.
    #[must_use]
    pub const fn start_pose_moves(&self) -> bool {
        self.start_moves > START_MOVES
    }

    /// The robot has sent telegrams for ten seconds and was never ready: its state.
    #[must_use]
    pub fn waits_in_vain(&self, now: Instant) -> Option<String> {
        let since =
            self.waits_since.filter(|_| matches!(self.stage, Stage::Waiting | Stage::Offered { .. }))?;
        (!self.is_held() && now.saturating_since(since) >= READY_WITHIN).then(|| self.heard())
    }

    /// How far the axes were from their path at a release that was not given for that, rad.
    #[must_use]
    pub fn release_withheld_rad(&self) -> Option<f64> {
        self.controller.group().release_withheld_rad().map(f64::from)
    }

    /// How much later than expected the axes passed the path, s.
    #[must_use]
    pub fn path_delay_s(&self) -> f64 {
        f64::from(self.controller.group().path_delay_s())
    }

    /// Why the motion ended, or cannot begin. `by_itself`: why the robot stopped by itself, if that is known.
    #[must_use]
    pub fn failure(&self, by_itself: Option<String>) -> Option<OperatorError> {
        let group = self.controller.state();
        let fault = match (&self.stage, group.fault()) {
            (Stage::Stopped { fault }, _) => *fault,
            (_, Some(fault)) if matches!(group.kind(), StateKind::Stopped | StateKind::Fault) => fault,
            (Stage::NotThrown { refusal }, _) => return Some(refused("the motion", *refusal)),
            _ => return None,
        };
        let (cause, joint) = (fault.cause.code(), fault.joint.map_or(0, |joint| joint.get() as u8 + 1));
        let (start_moves, was_ready) = (self.start_pose_moves(), self.was_ready);
        Some(OperatorError::RobotStopped { cause, joint, by_itself, start_moves, was_ready })
    }

    /// Report of the controller, if it is due or its state differs from `last`.
    pub(super) fn report(&mut self, now: Instant, last: &GroupState) -> Option<GroupState> {
        let due = self.controller.take_telemetry_due(now);
        (due || self.state() != last.state)
            .then(|| group_message(&self.controller.take_sample(now), last.sequence.wrapping_add(1), false))
    }

    /// Measured axes, rad; `None` before the first telegram.
    pub(super) fn measured_rad(&self) -> Option<Vec<f64>> {
        let group = self.controller.group();
        self.controller.joints().map(|joint| group.position(joint).map(|at| f64::from(at.q_rad))).collect()
    }

    pub(super) fn register(&self, name: &str) -> Option<Numbers> {
        Some(to_host(self.controller.register_named(name)?.as_slice()))
    }

    /// Freeze frame and trace of the controller, in the form of the files of a controller on a bus; the first is empty without
    /// a fault.
    #[must_use]
    pub fn history(&self) -> [Vec<u8>; 2] {
        let mut files = [vec![0; HISTORY_BYTES], vec![0; HISTORY_BYTES]];
        let lengths = [
            history::read_freeze(&self.controller, 0, &mut files[0]),
            history::read_trace(&self.controller, 0, &mut files[1]),
        ];
        for (file, length) in files.iter_mut().zip(lengths) {
            file.truncate(length);
        }
        files
    }

    /// Settings in force.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        self.controller.settings()
    }

    /// What went in and came out since the last call.
    pub fn take_log(&mut self) -> Vec<Line> {
        std::mem::take(&mut self.log)
    }

    fn note(&mut self, at: Instant, entry: Entry) {
        self.log.push(Line { at, entry });
    }

    /// Ends the robot's program: answers say `Stop` from now on, if the configuration has such a value.
    pub fn leave(&mut self, now: Instant) {
        self.note(now, Entry::Leave);
        self.leaving = true;
    }

    /// Does not run the last trajectory before [`Station::proceed_from_hold`], so that its target can be checked once more.
    pub fn hold(&mut self, now: Instant) {
        self.note(now, Entry::Hold);
        self.holds = true;
    }

    /// The arm stands at the start of the last trajectory, which is held.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.holds
            && self.files.len() == 1
            && matches!(self.stage, Stage::Waiting)
            && self.state() == StateKind::Ready
    }

    /// The last trajectory is run as soon as the arm stands at its start.
    pub fn proceed_from_hold(&mut self, now: Instant) {
        self.note(now, Entry::Proceed);
        self.holds = false;
    }

    /// Opens or closes the gripper while the arm stands.
    ///
    /// # Errors
    /// The controller's reason.
    pub fn set_gripper(&mut self, now: Instant, open: bool) -> Result<(), Refusal> {
        self.note(now, Entry::Gripper(open));
        self.controller.order(now, SELF, Order::Gripper { open }).map(|_| ())
    }

    /// Stops the arm along its path; motions that have not begun are cancelled.
    pub fn stop(&mut self, now: Instant) {
        self.note(now, Entry::Stop);
        if !matches!(self.stage, Stage::Running { .. }) {
            self.files.clear();
            if !self.stage.is_end() {
                self.stage = Stage::Waiting;
            }
        }
        let _ = self.controller.order(now, SELF, Order::Stop);
        self.watch();
    }

    /// Next deadline.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.controller.poll_deadline()
    }

    /// A deadline has come. Nothing is sent: the robot sends first.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.note(now, Entry::Timeout);
        self.controller.host_heartbeat(now, SELF);
        self.controller.handle_deadline(now);
        self.watch();
    }

    /// All datagrams that wait, oldest first; `new_connection`: they come from another socket than the ones before. Returns
    /// the answer to the newest.
    pub fn handle(&mut self, now: Instant, datagrams: &[Vec<u8>], new_connection: bool) -> Option<Vec<u8>> {
        let (last, before) = datagrams.split_last()?;
        if new_connection {
            self.note(now, Entry::NewConnection);
        }
        for bytes in before {
            self.note(now, Entry::Waited(bytes.clone()));
        }
        self.note(now, Entry::Telegram(last.clone()));
        if self.waits_since.is_none() || self.state() == StateKind::Ready {
            self.waits_since = Some(now);
        }
        let (telegram, ipoc) = self.newest(datagrams, new_connection)?;
        self.look_at(&telegram);
        self.controller.host_heartbeat(now, SELF);
        self.controller.handle_packet(now, &Packet::Robot(telegram));
        let mut answer = None;
        while let Some(packet) = self.controller.poll_packet() {
            if let Packet::Pc(mut packet) = packet {
                packet.stop |= self.leaving || self.is_disobeyed();
                // Names and types were checked with the configuration; a number beyond all bounds is not sent.
                answer = self.wire.write(ipoc, &packet).ok();
            }
        }
        self.counts.answers += u64::from(answer.is_some());
        if let Some(bytes) = &answer {
            self.note(now, Entry::Answer(bytes.clone()));
        }
        self.proceed(now);
        answer
    }

    fn look_at(&mut self, telegram: &Telegram) {
        let Some(PerJoint(q_rad)) = telegram.q_rad else {
            self.counts.without_axes += 1;
            return;
        };
        self.counts.with_axes += 1;
        let is_other =
            telegram.start_rad.is_some() && self.start_rad.is_some() && self.start_rad != telegram.start_rad;
        self.start_moves += u64::from(is_other);
        self.start_rad = telegram.start_rad;
        let PerJoint(start_rad) = telegram.start_rad.unwrap_or(PerJoint(q_rad));
        let away = q_rad.iter().zip(start_rad).map(|(q, start)| (q - start).abs());
        self.off_start = away
            .zip(1..)
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .filter(|(away, _)| *away > AT_START_RAD)
            .map(|(away, axis)| (axis, f64::from(away).to_degrees()));
    }

    /// The axes move away from their set points. Other set points may not stop them: a program that adds
    /// corrections moves on while one is held. The robot is ordered to leave the sensor motion: it brakes by
    /// itself.
    fn is_disobeyed(&self) -> bool {
        matches!(self.stage, Stage::Stopped { fault } if fault.cause == Cause::RobotLags)
    }

    /// The newest of the telegrams that wait. After one without positions a new run begins, and older ones do not count.
    fn newest(&mut self, datagrams: &[Vec<u8>], new_connection: bool) -> Option<(Telegram, Ipoc)> {
        let mut newest: Option<(Telegram, Ipoc)> = None;
        let mut begins_new = new_connection;
        for bytes in datagrams {
            match self.wire.read(bytes, new_connection) {
                Ok((telegram, ipoc)) => {
                    self.counts.drained += u64::from(newest.is_some());
                    let is_newer = newest.as_ref().is_none_or(|(other, _)| {
                        telegram.q_rad.is_none() || other.q_rad.is_none() || telegram.ipoc >= other.ipoc
                    });
                    begins_new |= telegram.q_rad.is_none();
                    if is_newer {
                        newest = Some((telegram, ipoc));
                    }
                }
                Err(error) => {
                    self.counts.unreadable += 1;
                    self.last_unreadable = Some(error);
                }
            }
        }
        newest.map(|(telegram, ipoc)| {
            // A first telegram that was drained still says that a new run began.
            let new_connection = new_connection || (begins_new && telegram.q_rad.is_some());
            (Telegram { new_connection, ..telegram }, ipoc)
        })
    }

    /// The next order of the throw, if its time has come. Called with a telegram, so that the plan begins with a cycle.
    fn proceed(&mut self, now: Instant) {
        self.watch();
        if self.is_held() {
            return;
        }
        let next = match self.stage {
            Stage::Waiting if self.state() == StateKind::Ready && !self.files.is_empty() => self.offer(now),
            Stage::Offered { token, name } => self.begin(now, token, name),
            Stage::Running { .. } => return self.extend(now),
            _ => return,
        };
        self.stage = next.unwrap_or_else(|refusal| Stage::NotThrown { refusal });
    }

    /// State of the throw from the state of the controller.
    fn watch(&mut self) {
        let kind = self.state();
        self.was_ready |= kind == StateKind::Ready;
        let fault = self.controller.state().fault();
        self.stage = match self.stage {
            Stage::Waiting | Stage::Offered { .. } => match fault {
                Some(fault) => Stage::NotThrown { refusal: refusal_of(fault) },
                None => self.stage,
            },
            Stage::Running { starts_at } => match (kind, fault) {
                (StateKind::Ready | StateKind::Idle, _) => {
                    self.files.pop_front();
                    if self.files.is_empty() {
                        Stage::Finished { started_at: starts_at }
                    } else {
                        Stage::Waiting
                    }
                }
                (StateKind::Stopped | StateKind::Fault, Some(fault)) => Stage::Stopped { fault },
                _ => Stage::Running { starts_at },
            },
            end => end,
        };
    }

    fn offer(&mut self, now: Instant) -> Result<Stage, Refusal> {
        let Some(Encoded { file, .. }) = self.files.front() else { return Ok(Stage::Waiting) };
        self.extended = 0;
        for (k, piece) in file.chunks(PIECE).enumerate() {
            self.controller.upload(now, SELF, PIECE * k, piece)?;
        }
        let name = FileName { crc64: Crc64::of(file), len: file.len() as u32 };
        self.controller.order(now, SELF, Order::Commit(name))?;
        match self.controller.order(now, SELF, Order::ArmPrepare { crc64: name.crc64, valid: VALID })? {
            Done::Offer { token, .. } => Ok(Stage::Offered { token, name }),
            _ => Ok(Stage::Waiting),
        }
    }

    /// Gives the controller the segments for which it has room. Without room, or while it stops, they wait.
    fn extend(&mut self, now: Instant) {
        let segments = self.files.front().map_or(&[][..], |plan| &plan.segments[self.extended..]);
        let taken =
            segments.iter().take_while(|segment| self.controller.extend(now, SELF, &segment.bytes).is_ok());
        self.extended += taken.count();
    }

    /// Arms and runs.
    fn begin(&mut self, now: Instant, token: u32, name: FileName) -> Result<Stage, Refusal> {
        self.controller.order(now, SELF, Order::ArmConfirm { token, valid: VALID })?;
        self.controller.order(now, SELF, Order::Run(name))?;
        let lead = self.controller.group().profile(self.controller.settings()).lead;
        Ok(Stage::Running { starts_at: now + lead })
    }
}

fn refusal_of(fault: Fault) -> Refusal {
    match fault.joint {
        Some(joint) => Refusal::at(fault.cause, joint),
        None => Refusal::of(fault.cause),
    }
}
