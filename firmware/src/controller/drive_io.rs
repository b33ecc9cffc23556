//! Requests out, replies in: sending what the schedule says, and what every answer tells about its drive,
//! whatever the state.

use core::borrow::BorrowMut;

use protocol::powercube::{
    ACCEPTED, Address, Channel, CubeState, MotionCommand, MotionPosition, Parameter, PosStateDio, Reply,
    Request, SimpleCommand, Value,
};
use protocol::{Duration, Frame, Instant, JointIndex};

use super::{Controller, Sent};
use crate::fault::{Cause, Fault};
use crate::gripper::{self, Output};
use crate::groups::powercube::drives::{Lane, Matched, PositionSample, is_foreign_request};
use crate::spline::Spline;
use crate::state::{State, StateKind, StopWay};
use crate::store::Storage;
use crate::supervisor;
use crate::trace::Event;

/// Deadline for answers while the drives are only looked at or home. With the repetitions that follow, a silent drive is
/// told after 0.3 to 0.45 s.
const SLOW_DEADLINE: Duration = Duration::from_millis(100);
/// A homing goes on until so many times the missed replies that stop a path: it needs none of them at a time.
const HOMING_PATIENCE: u32 = 2;

impl<S: Storage, M: BorrowMut<Spline>> Controller<S, M> {
    /// Sends what may be sent now.
    pub(super) fn pump(&mut self, now: Instant) {
        self.pump_gripper(now);
        let window = self.settings.in_flight_max as usize;
        let mut round = self.schedule.round(now, self.joints(), &self.drives);
        // Each turn puts one more drive in flight, so it ends after at most `joints` turns.
        while let Some(next) = self.schedule.next(&mut round, now, &self.drives, window) {
            self.ask(now, next.joint, Lane::Main, next.request);
        }
    }

    pub(super) fn ask(&mut self, now: Instant, joint: JointIndex, lane: Lane, request: Request) {
        // The one place where motion leaves: a state that must not move cannot make it.
        if matches!(request, Request::Move(_)) {
            if !self.kind().may_move() {
                return;
            }
            self.counters.motions = self.counters.motions.wrapping_add(1);
            let track = self.track.at_mut(joint);
            track.sent =
                Sent { cycle_at: self.tick_at, u_rad_s2: track.u_sent, qdd_rad_s2: track.command.qdd_rad_s2 };
        }
        let deadline = now + self.reply_deadline();
        let module = self.settings.joint.at(joint).module();
        let frame = self.drives.at_mut(joint).begin(now, lane, module, request, deadline);
        self.send(frame);
    }

    /// How long an answer may take: what the cycle allows where a drive is led by the cycle; else what a bus and a
    /// computer need that are held up for a moment, because nothing is lost by waiting.
    const fn reply_deadline(&self) -> Duration {
        match self.machine.state() {
            State::Running { .. } | State::Stopping { .. } | State::Jogging(_) => {
                Duration::from_micros(self.settings.reply_deadline_us as u64)
            }
            _ => SLOW_DEADLINE,
        }
    }

    fn pump_gripper(&mut self, now: Instant) {
        let (Some(open), Output::Module(address)) = (self.gripper_write, gripper::output(&self.settings))
        else {
            return;
        };
        let joint = self.joints().find(|&joint| self.settings.joint.at(joint).address == address);
        let Some(joint) = joint else {
            // A module that is no joint: nobody waits for its answer.
            self.gripper_write = None;
            if let Some(module) = u8::try_from(address).ok().and_then(|a| protocol::ModuleId::new(a).ok()) {
                let request = gripper::write(open, protocol::powercube::Dio(0), &self.settings);
                self.send(request.encode(module));
            }
            return;
        };
        let request = gripper::write(open, self.drives.at(joint).dio, &self.settings);
        if self.drives.at(joint).can_send(Lane::Side, &request, now) {
            self.gripper_write = None;
            self.ask(now, joint, Lane::Side, request);
        }
    }

    pub(super) fn set_gripper(&mut self, now: Instant, open: bool) {
        self.gripper.set(open, &self.settings);
        if gripper::output(&self.settings) != Output::Board {
            self.gripper_write = Some(open);
        }
        self.note(now, Event::Gripper(open));
    }

    /// Halt of one drive, beside whatever it is asked.
    pub(super) fn halt_drive(&mut self, now: Instant, joint: JointIndex) {
        let request = Request::Simple(SimpleCommand::Halt);
        if self.drives.at(joint).can_send(Lane::Side, &request, now) {
            self.ask(now, joint, Lane::Side, request);
        } else {
            // Better unmatched than not sent.
            let module = self.settings.joint.at(joint).module();
            self.send(request.encode(module));
        }
    }

    /// Requests whose replies did not come in time.
    pub(super) fn give_up_due(&mut self, now: Instant) {
        for joint in self.joints() {
            // Two lanes.
            for _ in 0..2 {
                let Some((lane, request)) = self.drives.at_mut(joint).give_up_due(now) else { break };
                if lane == Lane::Main {
                    self.schedule.clear(joint);
                }
                self.counters.replies_missed = self.counters.replies_missed.saturating_add(1);
                self.pace.abandon();
                self.track.at_mut(joint).missed = true;
                if matches!(request, Request::Move(_)) {
                    let a_rad_s2 = self.drives.at(joint).loaded.a_rad_s2;
                    let a_max_rad_s2 = self.settings.joint.at(joint).a_max_rad_s2;
                    self.track.at_mut(joint).model.doubt(a_rad_s2.unwrap_or(a_max_rad_s2));
                }
                self.note(now, Event::Missed(joint));
                self.on_missed(now, joint, request);
            }
        }
    }

    fn on_missed(&mut self, now: Instant, joint: JointIndex, request: Request) {
        let row = self.drives.at(joint).missed_in_row;
        match *self.machine.state() {
            State::Boot(stage) => self.boot_on_missed(stage, joint),
            State::Running { .. } | State::Stopping { .. } | State::Jogging(_)
                if row >= self.settings.reply_missed_max =>
            {
                self.fail(now, Fault::at(Cause::DriveSilent, joint));
            }
            State::Homing(_) if row >= HOMING_PATIENCE * self.settings.reply_missed_max => {
                self.fail(now, Fault::at(Cause::DriveSilent, joint));
            }
            State::Running { parking: Some(_), .. } => self.park_joint(joint),
            // A step of homing or of a jog that got no answer is asked again.
            State::Homing(homing) if homing.joint == joint => self.homing_on_missed(joint, homing, request),
            State::Jogging(jog) if jog.joint == joint => self.jogging_on_missed(joint, jog, request),
            // While nothing moves, `judge_standing` counts.
            State::Running { .. }
            | State::Stopping { .. }
            | State::Homing(_)
            | State::Jogging(_)
            | State::Idle
            | State::Ready
            | State::Armed { .. }
            | State::Stopped { .. }
            | State::Fault { .. } => {}
        }
    }

    /// Frame of the bus: of a drive, or to one from somebody else.
    pub(super) fn take_drive_frame(&mut self, now: Instant, frame: &Frame) {
        let Some(Address::Module(channel, _)) = Address::of(frame.id()) else { return };
        if is_foreign_request(channel) {
            self.counters.foreign_requests = self.counters.foreign_requests.saturating_add(1);
            return;
        }
        let Ok((module, reply)) = Reply::decode(frame) else { return };
        let Some(joint) = self.settings.joint_of(module) else { return };
        if let (Channel::State, Reply::State(state)) = (channel, reply) {
            self.take_state(now, joint, state);
            return;
        }
        if let Matched::Answer(lane, request) = self.drives.at_mut(joint).match_reply(now, &reply) {
            self.on_answer(now, joint, lane, request, &reply);
        }
    }

    fn on_answer(&mut self, now: Instant, joint: JointIndex, lane: Lane, request: Request, reply: &Reply) {
        self.learn(now, joint, request, reply);
        if lane == Lane::Side {
            return;
        }
        match *self.machine.state() {
            State::Boot(stage) => self.boot_on_answer(stage, joint, request, reply),
            State::Homing(homing) => self.homing_on_answer(now, homing, joint, request),
            State::Jogging(jog) => self.jogging_on_answer(now, jog, joint),
            // Measurements were handed on by `learn`.
            State::Running { .. } | State::Stopping { .. } => {}
            State::Idle
            | State::Ready
            | State::Armed { .. }
            | State::Stopped { .. }
            | State::Fault { .. } => {
                if self.pace.is_rehearsing() && self.is_cycle_done() {
                    self.pace.end_rehearsal(now);
                }
            }
        }
    }

    /// What an answer says about its drive.
    fn learn(&mut self, now: Instant, joint: JointIndex, request: Request, reply: &Reply) {
        match *reply {
            Reply::Value(
                Parameter::PosStateDio,
                Value::PosStateDio(PosStateDio { position_rad, short_state, dio }),
            ) => {
                let drive = self.drives.at_mut(joint);
                (drive.short_state, drive.dio) = (short_state, dio);
                self.take_position(now, joint, position_rad, None);
            }
            Reply::Value(Parameter::ActPos, Value::F32(position_rad)) => {
                self.take_position(now, joint, position_rad, None);
            }
            Reply::Value(Parameter::CubeState, Value::U32(bits)) => {
                self.take_state(now, joint, CubeState::from_bits(bits));
            }
            Reply::Value(Parameter::Cur, Value::F32(current_a)) => self.take_current(now, joint, current_a),
            Reply::Value(Parameter::DefVersion, Value::U16(version)) => {
                self.drives.at_mut(joint).version = Some(protocol::powercube::FirmwareVersion(version));
            }
            Reply::SetAck { parameter, code } => self.take_ack(now, joint, request, parameter, code),
            Reply::MotionExtended {
                position: MotionPosition::Radians(position), short_state, dio, ..
            } => {
                let drive = self.drives.at_mut(joint);
                (drive.short_state, drive.dio) = (short_state, dio);
                self.take_position(now, joint, position.get(), ramp_target(&request));
            }
            _ => {}
        }
    }

    /// A position, answered to a ramp to `target_rad` (drive side) or to a read.
    fn take_position(&mut self, now: Instant, joint: JointIndex, q_drive_rad: f32, target_rad: Option<f32>) {
        let limits = *self.settings.joint.at(joint);
        let at = now.saturating_sub(Duration::from_micros(self.settings.reply_age_us.into()));
        let q_rad = limits.to_joint_rad(q_drive_rad);
        let last = self.drives.at(joint).position;
        let moving = self.kind().may_move() && self.kind() != StateKind::Homing;
        let usable = if moving {
            supervisor::is_plausible(q_rad, at, last, limits.v_max_rad_s)
        } else {
            // Homing and people move joints as they like; only a number that is none is refused.
            q_rad.is_finite()
        };
        if !usable {
            let drive = self.drives.at_mut(joint);
            drive.counters.implausible = drive.counters.implausible.saturating_add(1);
            drive.missed_in_row = drive.missed_in_row.saturating_add(1);
            let track = self.track.at_mut(joint);
            let row = track.implausible;
            (track.missed, track.implausible) = (true, true);
            self.note(now, Event::Implausible(joint));
            // One may be a mix-up on the bus; the next one must be right.
            if row {
                self.fail(now, Fault::at(Cause::ReplyImplausible, joint));
            }
            return;
        }
        self.track.at_mut(joint).implausible = false;
        let drive = self.drives.at_mut(joint);
        drive.position = Some(PositionSample { q_rad, at });
        drive.rest.take(PositionSample { q_rad, at });
        let cause = self.compare_with_model(joint, PositionSample { q_rad, at });
        if let Some(target_rad) = target_rad {
            self.model_command(joint, target_rad);
        }
        if let Some(cause) = cause {
            self.fail(now, Fault::at(cause, joint));
        }
        if matches!(self.machine.state(), State::Running { .. } | State::Stopping { .. }) {
            self.take_measurement(now, joint, PositionSample { q_rad, at }, target_rad.is_some());
        } else {
            self.track.at_mut(joint).missed = false;
        }
    }

    /// What the drive's model says about a measured position, while the drive follows commands of this controller.
    fn compare_with_model(&mut self, joint: JointIndex, sample: PositionSample) -> Option<Cause> {
        let follows = match self.machine.state() {
            State::Running { .. } => true,
            State::Stopping { way, .. } => *way != StopWay::Halted,
            State::Jogging(jog) => jog.joint == joint,
            _ => false,
        };
        if !follows {
            return None;
        }
        let lag_s = self.settings.drive_lag_us as f32 * 1e-6;
        self.track.at_mut(joint).model.compare(sample.at, sample.q_rad, lag_s)
    }

    /// The drive has answered a ramp: it goes to `target_rad` (drive side) with the speed and acceleration that it holds.
    fn model_command(&mut self, joint: JointIndex, target_rad: f32) {
        let limits = self.settings.joint.at(joint);
        // A write without an answer is repeated before the next motion, so both are known.
        let loaded = self.drives.at(joint).loaded;
        let v_rad_s = loaded.v_rad_s.unwrap_or(limits.v_max_rad_s);
        let a_rad_s2 = loaded.a_rad_s2.unwrap_or(limits.a_max_rad_s2);
        let target_rad = limits.to_joint_rad(target_rad);
        self.track.at_mut(joint).model.command(target_rad, v_rad_s, a_rad_s2);
    }

    fn take_state(&mut self, now: Instant, joint: JointIndex, state: CubeState) {
        let homed_before = self.drive_is_homed(joint);
        let drive = self.drives.at_mut(joint);
        drive.state = Some((state, now));
        let moves = state.intersects(CubeState::MOTION);
        drive.motion_words = if moves { drive.motion_words.saturating_add(1) } else { 0 };
        let watched = match self.machine.state() {
            State::Stopping { way: StopWay::Halted, .. } => false,
            State::Running { .. } | State::Stopping { .. } | State::Jogging(_) => true,
            // The joint at work is judged by its homing: it has no zero and may report what it does.
            State::Homing(homing) => homing.joint != joint,
            _ => false,
        };
        if watched {
            let cause = supervisor::check_state_word(state, false);
            let lost = homed_before && !state.contains(CubeState::HOME_OK);
            if let Some(cause) = cause.or(lost.then_some(Cause::DriveLostHome)) {
                self.fail(now, Fault::at(cause, joint));
            }
        }
    }

    fn take_current(&mut self, now: Instant, joint: JointIndex, current_a: f32) {
        let limits = self.settings.joint.at(joint);
        let slow = matches!(self.machine.state(), State::Jogging(_) | State::Homing(_));
        let limit_a = if slow { 1.2 * limits.slow_current_a } else { limits.current_max_a };
        let drive = self.drives.at_mut(joint);
        drive.current_a = Some(current_a);
        // Written so that a number that is none counts as too much.
        let fine = current_a.abs() <= limit_a;
        drive.over_current = if fine { 0 } else { drive.over_current.saturating_add(1) };
        if drive.over_current >= supervisor::OVER_CURRENT_READINGS && self.kind().may_move() {
            self.fail(now, Fault::at(Cause::OverCurrent, joint));
        }
    }

    fn take_ack(
        &mut self,
        now: Instant,
        joint: JointIndex,
        request: Request,
        parameter: Parameter,
        code: Option<u8>,
    ) {
        let accepted = code == Some(ACCEPTED);
        let value = match request {
            Request::Set(_, Value::F32(value)) if accepted => Some(value),
            _ => None,
        };
        let loaded = &mut self.drives.at_mut(joint).loaded;
        match parameter {
            Parameter::TargetVel => loaded.v_rad_s = value,
            Parameter::TargetAcc => loaded.a_rad_s2 = value,
            _ => {}
        }
        if !accepted && self.kind().may_move() {
            self.fail(now, Fault::at(Cause::DriveRefused, joint));
        }
    }
}

/// Target of a ramp, drive side, rad; none for what is no ramp.
fn ramp_target(request: &Request) -> Option<f32> {
    match request {
        Request::Move(motion) => match motion.command() {
            MotionCommand::Ramp { target } => Some(target.get()),
            _ => None,
        },
        _ => None,
    }
}
