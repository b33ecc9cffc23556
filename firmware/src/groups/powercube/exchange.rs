//! Sends the requests of the schedule and evaluates the replies: each reply updates the record of its drive.

use protocol::powercube::{
    ACCEPTED, Address, Broadcast, Channel, CubeState, MotionCommand, MotionPosition, Parameter, PosStateDio,
    Reply, Request, SimpleCommand, Value,
};
use protocol::{Duration, Frame, Instant, JointIndex};

use super::cycle::Sent;
use super::drives::{Lane, Matched, is_foreign_request};
use super::settings::{IN_FLIGHT_MAX, SLOW_CURRENT_A};
use super::words::{check_short_state, check_state_word};
use super::{Mode, PowerCubes, ramp};
use crate::fault::{Cause, Fault};
use crate::group::{GroupEvent, InForce, Measured, PositionSample};
use crate::settings::Settings;
use crate::span;
use crate::supervisor;

/// Deadline for answers while the drives are only read or home. With the repetitions that follow, a silent drive is
/// reported after 0.3 to 0.45 s.
const SLOW_DEADLINE: Duration = Duration::from_millis(100);

impl PowerCubes {
    /// Sends what may be sent now. After a call that comes late the period that is due decides first: what is left of the old one
    /// may not apply any more.
    pub(super) fn pump(&mut self, now: Instant, settings: &Settings) {
        self.pump_gripper(now, settings);
        if self.cycle.due <= now {
            return;
        }
        let window = IN_FLIGHT_MAX.get(settings) as usize;
        let mut round = self.schedule.round(now, settings.joints(), &self.drives);
        // Each turn puts one more drive in flight, so it ends after at most `joints` turns.
        while let Some(next) = self.schedule.next(&mut round, now, &self.drives, window) {
            self.ask(now, settings, next.joint, Lane::Main, &next.request);
        }
    }

    pub(super) fn ask(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        lane: Lane,
        request: &Request,
    ) {
        let mut request = *request;
        // The one place where motion leaves: a mode that must not move cannot make it.
        if matches!(request, Request::Move(_)) {
            if !self.mode.may_move() {
                return;
            }
            if self.mode.ramps_to_rest() {
                request = self.stop_from_here(now, settings, joint);
            }
            self.counters.motions = self.counters.motions.wrapping_add(1);
            if let Mode::Jogging(jog) = &mut self.mode {
                jog.led = true;
            }
            let axis = self.axes.at_mut(joint);
            axis.sent = Sent { cycle_at: self.cycle.at, ..axis.planned };
        }
        // A halt may overtake either of them in the drive.
        if matches!(request, Request::Move(_) | Request::Simple(SimpleCommand::Home)) {
            self.drives.at_mut(joint).rest.forget();
        }
        let deadline = now + self.reply_deadline(settings);
        self.drives.at_mut(joint).begin(now, lane, &request, deadline);
        self.send(&request.encode(settings.joint.at(joint).module()));
    }

    /// How long an answer may take. In a control cycle the setting; otherwise long enough for a bus or a computer that is held
    /// up for a moment, because nothing depends on the answer being fast.
    pub(super) const fn reply_deadline(&self, settings: &Settings) -> Duration {
        match self.mode {
            Mode::Tracking | Mode::Parking | Mode::Braking { .. } | Mode::Halted | Mode::Jogging(_) => {
                Duration::from_micros(settings.reply_deadline_us as u64)
            }
            Mode::Finding(_) | Mode::Standing { .. } | Mode::Homing(_) => SLOW_DEADLINE,
        }
    }

    /// Halt of one drive, beside whatever it is asked.
    pub(super) fn halt_drive(&mut self, now: Instant, settings: &Settings, joint: JointIndex) {
        let request = Request::Simple(SimpleCommand::Halt);
        if self.drives.at(joint).can_send(Lane::Side, &request, now) {
            self.ask(now, settings, joint, Lane::Side, &request);
        } else {
            // Better unmatched than not sent.
            self.send(&request.encode(settings.joint.at(joint).module()));
        }
    }

    /// Gives up all requests whose replies did not come in time. They are reported afterwards: what the controller does then
    /// must stay on the agendas.
    #[inline(never)]
    pub(super) fn give_up_due(&mut self, now: Instant, settings: &Settings) {
        for joint in settings.joints() {
            // Main lane and side lane.
            for _ in 0..2 {
                let Some((lane, request)) = self.drives.at_mut(joint).give_up_due(now) else { break };
                self.give_up(now, settings, joint, lane, request);
                let [first, second] = &mut self.unreported;
                *if *first & joint.bit() == 0 { first } else { second } |= joint.bit();
            }
        }
    }

    /// The next answer to be reported as missed.
    pub(super) fn next_missed(&mut self, settings: &Settings) -> Option<GroupEvent> {
        let [first, second] = &mut self.unreported;
        if (*first | *second) == 0 {
            return None;
        }
        let joint = settings.joints().find(|joint| (*first | *second) & joint.bit() != 0)?;
        let mask = if *first & joint.bit() != 0 { first } else { second };
        *mask &= !joint.bit();
        Some(GroupEvent::Missed(joint, self.drives.at(joint).missed_in_row))
    }

    #[inline(never)]
    fn give_up(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        lane: Lane,
        request: Request,
    ) {
        if lane == Lane::Main {
            self.schedule.clear(joint);
        }
        self.timing.abandon();
        self.cycle.missed |= joint.bit();
        if matches!(request, Request::Move(_)) {
            self.doubt_motion(settings, joint);
        }
        // A step of finding, homing or of a jog that got no answer is asked again, and so is a ramp to rest.
        match self.mode {
            Mode::Finding(stage) => self.finding_on_missed(stage, joint),
            Mode::Homing(homing) if homing.joint == joint => self.homing_on_missed(settings, homing, request),
            Mode::Jogging(jog) if jog.joint == joint => {
                self.jogging_on_missed(now, settings, jog, request);
            }
            // One that stays silent is halted instead.
            Mode::Braking { jogged }
                if lane == Lane::Main
                    && !matches!(request, Request::Get(_))
                    && self.drives.at(joint).missed_in_row < settings.reply_missed_max =>
            {
                self.ramp_down(now, settings, joint, jogged);
            }
            _ => {}
        }
    }

    /// Nobody knows whether the last motion is in force, or since when.
    fn doubt_motion(&mut self, settings: &Settings, joint: JointIndex) {
        let a_rad_s2 = self.drives.at(joint).loaded.a_rad_s2;
        let a_max_rad_s2 = settings.joint.at(joint).a_max_rad_s2;
        self.axes.at_mut(joint).model.doubt(a_rad_s2.unwrap_or(a_max_rad_s2));
    }

    /// Broadcast of another node. A halt stops all drives at once: the ball is kept, and no drive is asked to go on. Halted
    /// drives that stand are found by their state words, and drives that this group has halted are stopped already.
    fn take_broadcast(&mut self, frame: &Frame) {
        let moves = self.mode.may_move() && !matches!(self.mode, Mode::Halted);
        if moves && Broadcast::decode(frame) == Ok(Broadcast::Halt) {
            self.push(GroupEvent::Failed(Fault::group(Cause::HaltedByOther)));
        }
    }

    /// Frame of the bus: of a drive, or to one from another node.
    pub(super) fn take_frame(&mut self, now: Instant, settings: &Settings, frame: &Frame) {
        let channel = match Address::of(frame.id()) {
            Some(Address::Module(channel, _)) => channel,
            Some(Address::Broadcast) => {
                self.take_broadcast(frame);
                return;
            }
            None => return,
        };
        if is_foreign_request(channel) {
            self.counters.foreign = self.counters.foreign.saturating_add(1);
            return;
        }
        let Ok((module, reply)) = Reply::decode(frame) else { return };
        let Some(joint) = settings.joint_of(module) else {
            self.take_stranger(settings, module, &reply);
            return;
        };
        if let (Channel::State, Reply::State(state)) = (channel, reply) {
            self.take_state(now, joint, state);
            return;
        }
        let Matched::Answer(lane, request) = self.drives.at_mut(joint).match_reply(now, &reply) else {
            return;
        };
        self.learn(now, settings, joint, request, &reply);
        if lane == Lane::Main {
            self.go_on(now, settings, joint, request, &reply);
        }
    }

    /// What an answer means for what the group is at.
    fn go_on(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        request: Request,
        reply: &Reply,
    ) {
        match self.mode {
            Mode::Finding(stage) => self.finding_on_answer(settings, stage, joint, request, reply),
            Mode::Homing(homing) if homing.joint == joint => {
                self.homing_on_answer(now, settings, homing, request);
            }
            Mode::Jogging(jog) if jog.joint == joint => self.jogging_on_answer(now, jog),
            Mode::Standing { .. } if self.timing.is_checking() && self.all_answered(settings) => {
                self.timing.end_check(now);
            }
            _ => {}
        }
    }

    /// What an answer says about its drive.
    fn learn(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        request: Request,
        reply: &Reply,
    ) {
        match *reply {
            Reply::Value(
                Parameter::PosStateDio,
                Value::PosStateDio(PosStateDio { position_rad, short_state, dio }),
            ) => {
                self.drives.at_mut(joint).note(short_state, dio);
                self.take_position(now, settings, joint, position_rad, None);
            }
            Reply::Value(Parameter::ActPos, Value::F32(position_rad)) => {
                self.take_position(now, settings, joint, position_rad, None);
            }
            Reply::Value(Parameter::CubeState, Value::U32(bits))
                if !self.drives.at(joint).is_before_reset =>
            {
                self.take_state(now, joint, CubeState::from_bits(bits));
            }
            Reply::Value(Parameter::Cur, Value::F32(current_a)) => {
                self.take_current(settings, joint, current_a);
            }
            Reply::Value(parameter @ (Parameter::MaxCur | Parameter::Config), value) => {
                self.compare_held(joint, parameter, value);
            }
            Reply::Value(Parameter::DefVersion, Value::U16(version)) => {
                self.drives.at_mut(joint).version = Some(protocol::powercube::FirmwareVersion(version));
            }
            Reply::SetAck { parameter, code } => self.take_ack(joint, request, parameter, code),
            Reply::MotionExtended {
                position: MotionPosition::Radians(position), short_state, dio, ..
            } => {
                self.drives.at_mut(joint).note(short_state, dio);
                self.take_position(now, settings, joint, position.get(), ramp_target(&request));
            }
            _ => {}
        }
    }

    /// A position, answered to a ramp to `target_rad` (drive side) or to a read.
    fn take_position(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        q_drive_rad: f32,
        target_rad: Option<f32>,
    ) {
        let limits = settings.joint.at(joint);
        let at = now.saturating_sub(Duration::from_micros(settings.reply_age_us.into()));
        let sample = PositionSample { q_rad: limits.to_joint_rad(q_drive_rad), at };
        let led = self.mode.may_move() && !matches!(self.mode, Mode::Homing(_));
        if led && self.drives.at(joint).is_held_up(now) {
            self.take_untimed(settings, joint, target_rad);
            return;
        }
        let drive = self.drives.at_mut(joint);
        let usable = if led {
            supervisor::is_plausible(sample.q_rad, at, drive.position, limits.v_max_rad_s)
        } else {
            // While homing, and while people may move the joints, any finite position is accepted.
            sample.q_rad.is_finite()
        };
        if !usable {
            drive.counters.implausible = drive.counters.implausible.saturating_add(1);
            drive.missed_in_row = drive.missed_in_row.saturating_add(1);
            let again = core::mem::replace(&mut drive.implausible, true);
            self.cycle.missed |= joint.bit();
            self.push(GroupEvent::Implausible(joint, again));
            return;
        }
        drive.implausible = false;
        drive.position = Some(sample);
        drive.rest.take(sample);
        if let Some(cause) = self.compare_with_model(settings, joint, sample) {
            self.fail(Fault::at(cause, joint));
        }
        if let Some(target_rad) = target_rad {
            self.model_command(now, settings, joint, target_rad);
        }
        let in_force = if matches!(self.mode, Mode::Tracking) && target_rad.is_some() {
            Some(self.take_in_force(now, settings, joint, sample))
        } else {
            None
        };
        let cause = self.cause_of_short_state(joint);
        if let (Some(cause), Mode::Jogging(jog)) = (cause, self.mode)
            && jog.joint == joint
            && jog.led
        {
            self.fail(Fault::at(cause, joint));
        }
        self.push(GroupEvent::Measured(Measured { joint, sample, in_force, cause }));
    }

    /// What the short state of a drive says. Without a zero it always says that something is wrong, and halted it says so.
    fn cause_of_short_state(&self, joint: JointIndex) -> Option<Cause> {
        let drive = self.drives.at(joint);
        let says = drive.is_homed() && !matches!(self.mode, Mode::Halted);
        if says { check_short_state(drive.short_state) } else { None }
    }

    /// A position of unknown time, answered while joints move: the drive lives and reports its state, but a position taken for
    /// one of now would be a joint that is slower, then faster than it is.
    fn take_untimed(&mut self, settings: &Settings, joint: JointIndex, target_rad: Option<f32>) {
        if target_rad.is_some() {
            self.doubt_motion(settings, joint);
        }
        if let Some(cause) = self.cause_of_short_state(joint) {
            self.fail(Fault::at(cause, joint));
        }
        // No answer in a row is missing: it is not silent.
        self.push(GroupEvent::Missed(joint, 0));
    }

    /// The answer to a motion of the control cycle: its set point is in force since the measurement.
    fn take_in_force(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        sample: PositionSample,
    ) -> InForce {
        let cap_rad_s = self.drives.at(joint).loaded.v_rad_s.unwrap_or(settings.joint.at(joint).v_max_rad_s);
        let axis = self.axes.at_mut(joint);
        let in_time = axis.take_over(sample.at, cap_rad_s, self.cycle.at);
        let u_rad_s2 = axis.sent.u_rad_s2;
        self.cycle.note_answer(joint, in_time);
        if self.cycle.has_all_answers(settings) {
            self.timing.end_cycle(now);
        }
        InForce { u_rad_s2, in_time }
    }

    /// What the drive's model says about a measured position, while the drive follows commands of this group.
    fn compare_with_model(
        &mut self,
        settings: &Settings,
        joint: JointIndex,
        sample: PositionSample,
    ) -> Option<Cause> {
        let follows = match self.mode {
            Mode::Tracking | Mode::Parking | Mode::Braking { .. } => true,
            Mode::Jogging(jog) => jog.joint == joint,
            Mode::Halted | Mode::Homing(_) | Mode::Standing { .. } | Mode::Finding(_) => false,
        };
        if !follows {
            return None;
        }
        let lag_s = settings.drive_lag_us as f32 * 1e-6;
        self.axes.at_mut(joint).model.compare(sample.at, sample.q_rad, lag_s)
    }

    /// The drive has answered a ramp: it goes to `target_rad` (drive side) with the speed and acceleration that it holds.
    fn model_command(&mut self, now: Instant, settings: &Settings, joint: JointIndex, target_rad: f32) {
        let limits = settings.joint.at(joint);
        // A write without an answer is repeated before the next motion, so both are known.
        let ramp::Loaded { v_rad_s, a_rad_s2 } = self.drives.at(joint).loaded;
        let late = self.drives.at(joint).lateness(now);
        self.axes.at_mut(joint).model.command(
            limits.to_joint_rad(target_rad),
            v_rad_s.unwrap_or(limits.v_max_rad_s),
            a_rad_s2.unwrap_or(limits.a_max_rad_s2),
            span::seconds(late),
        );
    }

    fn take_state(&mut self, now: Instant, joint: JointIndex, state: CubeState) {
        let drive = self.drives.at_mut(joint);
        let homed_before = drive.is_homed();
        drive.state = Some((state, now));
        let moves = state.intersects(CubeState::MOTION);
        drive.motion_words = if moves { drive.motion_words.saturating_add(1) } else { 0 };
        let watched = match self.mode {
            Mode::Tracking | Mode::Parking | Mode::Braking { .. } | Mode::Jogging(_) => true,
            // The joint at work is judged by its homing: it has no zero and may report what it does.
            Mode::Homing(homing) => homing.joint != joint,
            Mode::Halted | Mode::Standing { .. } | Mode::Finding(_) => false,
        };
        if watched {
            let lost = homed_before && !state.contains(CubeState::HOME_OK);
            let cause = check_state_word(state).or(lost.then_some(Cause::DriveLostHome));
            if let Some(cause) = cause {
                self.fail(Fault::at(cause, joint));
            }
        }
    }

    fn take_current(&mut self, settings: &Settings, joint: JointIndex, current_a: f32) {
        let limits = settings.joint.at(joint);
        let slow = matches!(self.mode, Mode::Jogging(_) | Mode::Homing(_));
        let limit_a = if slow { 1.2 * SLOW_CURRENT_A.at(settings, joint) } else { limits.current_max_a };
        let drive = self.drives.at_mut(joint);
        drive.current_a = Some(current_a);
        // Written so that NaN counts as too much.
        let fine = current_a.abs() <= limit_a;
        drive.over_current = if fine { 0 } else { drive.over_current.saturating_add(1) };
        if drive.over_current >= supervisor::OVER_CURRENT_READINGS && self.mode.may_move() {
            self.fail(Fault::at(Cause::OverCurrent, joint));
        }
    }

    fn take_ack(&mut self, joint: JointIndex, request: Request, parameter: Parameter, code: Option<u8>) {
        let accepted = code == Some(ACCEPTED);
        let value = match request {
            Request::Set(_, Value::F32(value)) if accepted => Some(value),
            _ => None,
        };
        let drive = self.drives.at_mut(joint);
        match parameter {
            Parameter::TargetVel => drive.loaded.v_rad_s = value,
            Parameter::TargetAcc => drive.loaded.a_rad_s2 = value,
            Parameter::MaxCur => drive.max_cur_a = value,
            _ => {}
        }
        if accepted {
            self.end_gripper_write(parameter);
        }
        if !accepted && self.mode.may_move() {
            self.fail(Fault::at(Cause::DriveRefused, joint));
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
