//! Periods: set points become requests, drives are read while nothing moves, signs of life go out.
//!
//! A period of the control cycle lasts [`Settings::cycle_period`], one of the monitor [`Settings::monitor_period_us`]. It
//! begins at its deadline, not when the runner comes to it.

use core::mem::{Discriminant, discriminant};

use protocol::powercube::{Broadcast, Gate, MotionCommand, MotionRequest, Parameter, Request, Value};
use protocol::units::Radians;
use protocol::{Duration, Instant, JointIndex};

use super::drive_model::DriveModel;
use super::drives::DriveRecord;
use super::order::Order;
use super::ramp::{self, RampLimits, RampState};
use super::schedule::Agenda;
use super::settings::{MONITORING, REACH_RAD};
use super::slots::Slots;
use super::{Mode, PowerCubes};
use crate::group::{GroupEvent, PositionSample, SetPoint, Taken};
use crate::joints::{PerJoint, at_least, clamp};
use crate::reach::{self, SoftLimits};
use crate::settings::Settings;
use crate::span;

/// Firmware that answers [`Parameter::PosStateDio`].
const POS_STATE_GATE: Gate = Gate::From2518Or3518;
/// From the order to stop to the drive braking: two requests and their answers.
const BRAKE_LEAD: Duration = Duration::from_micros(700);
/// From a motion's leaving to the drive braking: its frame.
const MOTION_LEAD: Duration = Duration::from_micros(150);
/// Added to the computed time of a ramp to rest.
const BRAKE_SLACK: Duration = Duration::from_millis(40);
/// Pull of the generator model to the measured speed, 1/s: against drift by jitter of the slots; slow, because the
/// measured speed lags by the drive's position loop.
const GENERATOR_PULL_1_S: f32 = 5.0;

/// Ramp generator of a drive as the commands should have left it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RampModel {
    v_rad_s: f32,
    a_rad_s2: f32,
    /// Speed it keeps once reached.
    cap_rad_s: f32,
    at: Instant,
}

impl RampModel {
    /// Velocity at a time near the last command.
    fn v_at(&self, t: Instant) -> f32 {
        let dt_s = span::seconds(t.saturating_since(self.at));
        let v = self.v_rad_s + self.a_rad_s2 * dt_s;
        if v * self.a_rad_s2 > 0.0 {
            let cap = at_least(self.v_rad_s.abs(), self.cap_rad_s);
            clamp(v, -cap, cap)
        } else {
            v
        }
    }

    /// Corrects the velocity by a measured one, `dt_s` after the last correction.
    pub(super) fn pull(&mut self, qd_rad_s: f32, dt_s: f32) {
        self.v_rad_s += clamp(GENERATOR_PULL_1_S * dt_s, 0.0, 0.2) * (qd_rad_s - self.v_rad_s);
    }
}

/// A motion on its way: an answer after the next control step belongs to this one, not to the one planned meanwhile.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sent {
    /// Start of its period.
    pub(super) cycle_at: Instant,
    /// Acceleration it amounts to, rad/s².
    pub(super) qdd_rad_s2: f32,
    /// The part of it beside the reference's.
    pub(super) u_rad_s2: f32,
}

/// Command side of a drive.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Axis {
    pub(super) generator: RampModel,
    pub(super) model: DriveModel,
    /// What bound the last command.
    pub(super) speed_limited: bool,
    pub(super) position_limited: bool,
    /// What the next motion amounts to.
    pub(super) planned: Sent,
    /// The motion last sent.
    pub(super) sent: Sent,
    /// From the start of a period to the drive's measurement, µs.
    pub(super) phase_us: u32,
}

impl Axis {
    /// The motion sent last has been in force since `at`; true if it is the one of the period that began at `cycle_at`.
    pub(super) fn take_over(&mut self, at: Instant, cap_rad_s: f32, cycle_at: Instant) -> bool {
        self.phase_us = at.saturating_since(self.sent.cycle_at).as_micros().min(40_000) as u32;
        let v_rad_s = self.generator.v_at(at);
        self.generator = RampModel { v_rad_s, a_rad_s2: self.sent.qdd_rad_s2, cap_rad_s, at };
        self.sent.cycle_at == cycle_at
    }
}

/// The running period.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cycle {
    /// Next period.
    pub(super) due: Instant,
    /// When this one was due; later if the runner came so late that its slots are over.
    pub(super) at: Instant,
    /// Periods since start-up.
    pub(super) number: u32,
    /// Drives whose motion of this period was answered, bit n: joint n.
    answered: u8,
    /// Drives that missed an answer since the last set points.
    pub(super) missed: u8,
    /// What may follow the set points of this period.
    extra: Option<Extra>,
    /// What the group was at when the period began, until the controller has reacted to it.
    begun_in: Option<Discriminant<Mode>>,
}

/// Bus time beside one write and one motion per drive.
#[derive(Clone, Copy, Debug)]
struct Extra {
    /// Whose turn it is to be read, or to have its speed raised ahead of need.
    monitored: Option<JointIndex>,
    /// A drive has got two writes.
    second_write: bool,
    /// The period began late: the time is for catching up.
    overrun: bool,
}

impl Cycle {
    /// An answer to a motion has come: to the one of this period, or to an older one.
    pub(super) const fn note_answer(&mut self, joint: JointIndex, in_time: bool) {
        self.missed &= !joint.bit();
        self.answered = if in_time { self.answered | joint.bit() } else { self.answered & !joint.bit() };
    }

    /// True if each motion of this period was answered.
    pub(super) const fn has_all_answers(&self, settings: &Settings) -> bool {
        all_of(settings) & !self.answered == 0
    }

    /// True if a drive has neither answered nor missed its answer. A read that is still on its way delays nothing.
    const fn is_unfinished(&self, settings: &Settings) -> bool {
        all_of(settings) & !(self.answered | self.missed) != 0
    }
}

/// A bit for each joint in use.
const fn all_of(settings: &Settings) -> u8 {
    (1u32.wrapping_shl(settings.joints) - 1) as u8
}

impl PowerCubes {
    /// Begins the period that is due. Work that a fault in this call must be able to drop comes before the event, work that
    /// must not follow a fault comes in [`Self::end_period`].
    #[inline(never)]
    pub(super) fn begin_period(&mut self, now: Instant, settings: &Settings) {
        if self.cycle.due > now {
            return;
        }
        let period = if self.mode.is_cyclic() {
            settings.cycle_period()
        } else {
            Duration::from_micros(settings.monitor_period_us.into())
        };
        let late = now.saturating_since(self.cycle.due);
        // Commands keep their distance after a late start as long as their slots are ahead. After a later one they are
        // all moved: one long interval, and no short ones to catch up.
        self.cycle.at = if late * 4 > period { now } else { self.cycle.due };
        self.cycle.due = self.cycle.at + period;
        self.cycle.number = self.cycle.number.wrapping_add(1);
        self.cycle.begun_in = Some(discriminant(&self.mode));
        let mut overrun = false;
        match self.mode {
            Mode::Finding(stage) => self.finding_period(now, settings, stage),
            Mode::Standing { armed } => self.read_at_rest(now, settings, armed),
            Mode::Homing(homing) => self.homing_period(settings, homing),
            Mode::Jogging(jog) => self.jogging_period(now, settings, jog),
            Mode::Tracking => {
                overrun = self.cycle.is_unfinished(settings) || late * 2 > period;
                self.begin_set_points(now, settings, overrun);
            }
            Mode::Parking | Mode::Braking { .. } | Mode::Halted => {}
        }
        self.push(GroupEvent::Cycle { late, overrun });
    }

    /// What follows the set points and the controller's decision.
    pub(super) fn end_period(&mut self, settings: &Settings) {
        if self.cycle.begun_in.take() != Some(discriminant(&self.mode)) {
            // Outside of a period, or the controller has stopped or begun something: that comes first.
            return;
        }
        match self.mode {
            Mode::Tracking => self.read_for_monitoring(settings),
            Mode::Parking | Mode::Braking { .. } | Mode::Halted => {
                for joint in settings.joints() {
                    self.watch(joint);
                }
            }
            Mode::Finding(_) | Mode::Standing { .. } | Mode::Homing(_) | Mode::Jogging(_) => {}
        }
    }

    /// Set points follow. The joints stand.
    pub(super) fn track(&mut self, now: Instant, settings: &Settings) {
        self.schedule.clear_all();
        // Arming has asked for a timing check; without one the period is all that is known.
        let cycle_us = self.cycle_times(settings).1.unwrap_or(settings.cycle_period_us);
        let answer_us = PerJoint(self.drives.0.each_ref().map(DriveRecord::answer_us));
        let order = Order::slowest_first(settings.joints as usize, &answer_us);
        self.schedule.set_order(order);
        self.slots = Slots::plan(settings, cycle_us, &order);
        let hurry = now + Duration::from_micros(settings.reply_deadline_us.into());
        for joint in settings.joints() {
            self.drives.at_mut(joint).hasten(hurry);
            let q_rad = self.q_rad(joint);
            let axis = self.axes.at_mut(joint);
            axis.generator = RampModel { at: now, ..RampModel::default() };
            axis.model = DriveModel::at_rest(now, q_rad);
            axis.planned = Sent::default();
            axis.phase_us = self.slots.expected_phase_us(joint);
        }
        // Nothing is asked yet, and nothing is missing.
        (self.cycle.answered, self.cycle.missed) = (u8::MAX, 0);
        self.timing.begin_run();
        self.mode = Mode::Tracking;
        // The first period begins now; one of the monitor may be half way.
        self.cycle.due = now + Duration::from_micros(1);
    }

    fn begin_set_points(&mut self, now: Instant, settings: &Settings, overrun: bool) {
        self.timing.begin_cycle(now);
        self.schedule.begin_cycle(self.cycle.at, self.slots.first(), self.slots.monitoring());
        let joints = settings.joints.max(1);
        let monitored = JointIndex::new((self.cycle.number % joints) as usize).ok();
        self.cycle.extra = Some(Extra { monitored, second_write: false, overrun });
        (self.cycle.answered, self.cycle.missed) = (0, 0);
    }

    /// Says a set point in the words of the drive and puts it on its agenda.
    pub(super) fn realise(&mut self, settings: &Settings, joint: JointIndex, set_point: &SetPoint) -> Taken {
        if !matches!(self.mode, Mode::Tracking) {
            return Taken::default();
        }
        let limits = settings.joint.at(joint);
        let loaded = self.drives.at(joint).loaded;
        let axis = self.axes.at_mut(joint);
        let state = RampState { q_rad: set_point.q_rad, v_rad_s: axis.generator.v_at(set_point.acts_at) };
        let limits_of_ramp = RampLimits::of(limits, SoftLimits::of(limits), REACH_RAD.get(settings));
        let mut command =
            ramp::realise(set_point.qdd_rad_s2, set_point.period_s, state, &limits_of_ramp, &loaded);
        let u_rad_s2 = command.qdd_rad_s2 - set_point.qdd_reference_rad_s2;
        axis.planned = Sent { qdd_rad_s2: command.qdd_rad_s2, u_rad_s2, ..axis.planned };
        if let Some(extra) = &mut self.cycle.extra {
            let both = command.velocity_rad_s.is_some() && command.acceleration_rad_s2.is_some();
            // A low speed is raised ahead of need, one joint per cycle, when the bus has room.
            if command.velocity_stale && !both && !extra.second_write && extra.monitored == Some(joint) {
                command.velocity_rad_s = Some(limits.v_max_rad_s);
            }
            extra.second_write |= command.velocity_rad_s.is_some() && command.acceleration_rad_s2.is_some();
        }
        (axis.speed_limited, axis.position_limited) = (command.speed_limited, command.position_limited);
        self.plan(settings, joint, &command);
        self.schedule.hold_motion(joint, self.slots.of_us(joint));
        Taken { position_limited: command.position_limited }
    }

    /// One drive is read in what is left of the period.
    fn read_for_monitoring(&mut self, settings: &Settings) {
        let Some(Extra { monitored, second_write: false, overrun: false }) = self.cycle.extra.take() else {
            return;
        };
        if let Some(joint) = monitored.filter(|_| MONITORING.get(settings)) {
            let turn = self.cycle.number / settings.joints.max(1);
            let parameter =
                if turn.is_multiple_of(2) { Self::slow_look(turn / 2) } else { Parameter::CubeState };
            self.schedule.push(joint, Request::Get(parameter));
        }
    }

    /// Puts a command on the agenda of its drive, in place of what is left there.
    fn plan(&mut self, settings: &Settings, joint: JointIndex, command: &ramp::RampCommand) {
        let target = Radians::new(settings.joint.at(joint).to_drive_rad(command.target_rad));
        let agenda = self.schedule.restart(joint);
        if let Some(v) = command.velocity_rad_s {
            agenda.push(Request::Set(Parameter::TargetVel, Value::F32(v)));
        }
        if let Some(a) = command.acceleration_rad_s2 {
            agenda.push(Request::Set(Parameter::TargetAcc, Value::F32(a)));
        }
        agenda.push(Request::Move(MotionRequest::extended(MotionCommand::Ramp { target })));
    }

    /// Slow ramp to a position.
    pub(super) fn move_to(&mut self, settings: &Settings, joint: JointIndex, q_rad: f32) {
        self.mode = Mode::Parking;
        let limits = settings.joint.at(joint);
        let command = ramp::RampCommand {
            target_rad: clamp(q_rad, limits.q_min_rad, limits.q_max_rad),
            velocity_rad_s: Some(limits.jog_v_rad_s),
            acceleration_rad_s2: Some(limits.jog_a_rad_s2),
            ..ramp::RampCommand::default()
        };
        self.plan(settings, joint, &command);
    }

    /// Every joint on its own: one ramp to where it can just stop.
    pub(super) fn brake_all(&mut self, now: Instant, settings: &Settings) -> Instant {
        let jog = if let Mode::Jogging(jog) = self.mode { Some(jog) } else { None };
        let jogged = jog.map(|jog| jog.joint);
        self.schedule.clear_all();
        self.mode = Mode::Braking { jogged };
        if let Some(jog) = jog {
            // A joint that was not led yet stays: a command would open its brake.
            return if jog.led { self.ramp_down(now, settings, jog.joint, jogged) } else { now };
        }
        settings.joints().fold(now, |until, joint| until.max(self.ramp_down(now, settings, joint, None)))
    }

    /// Ramp of one joint to rest, from where its generator is by the model of its commands: no measured position leads it,
    /// because one that is wrong may be the reason to stop. Returns the end of the ramp.
    pub(super) fn ramp_down(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        jogged: Option<JointIndex>,
    ) -> Instant {
        let limits = settings.joint.at(joint);
        let a_rad_s2 = if jogged.is_some() { limits.jog_a_rad_s2 } else { limits.a_max_rad_s2 };
        let state = self.axes.at(joint).model.generator_at(now + BRAKE_LEAD);
        let soft = SoftLimits::kept(limits, self.drives.at(joint).is_homed());
        let a_rad_s2 =
            ramp::stop_rad_s2(state, a_rad_s2, &RampLimits::of(limits, soft, REACH_RAD.get(settings)));
        // The speed in the drive is at least the present one; writing it would cost time.
        let requests = [
            Request::Set(Parameter::TargetAcc, Value::F32(a_rad_s2)),
            self.stop_from_here(now, settings, joint),
        ];
        self.set_agenda(joint, &requests);
        now + BRAKE_LEAD + span::of_seconds(1.1 * state.v_rad_s.abs() / at_least(a_rad_s2, 0.1)) + BRAKE_SLACK
    }

    /// The motion of a ramp to rest from where the joint is now. Made once more when it leaves: the write before it may have been
    /// answered late, and the drive would go back to a target of that time.
    pub(super) fn stop_from_here(&self, now: Instant, settings: &Settings, joint: JointIndex) -> Request {
        let limits = settings.joint.at(joint);
        let RampState { q_rad, v_rad_s } = self.axes.at(joint).model.generator_at(now + MOTION_LEAD);
        let soft = SoftLimits::kept(limits, self.drives.at(joint).is_homed());
        let a_rad_s2 = self.drives.at(joint).loaded.a_rad_s2.unwrap_or(limits.a_max_rad_s2);
        let target = Radians::new(limits.to_drive_rad(reach::rest_rad(q_rad, v_rad_s, a_rad_s2, soft)));
        Request::Move(MotionRequest::extended(MotionCommand::Ramp { target }))
    }

    /// Reads position and state word of a drive in turn, once it has nothing else to do.
    pub(super) fn watch(&mut self, joint: JointIndex) {
        if self.schedule.is_done(joint, self.drives.at(joint)) {
            let parameter = if self.cycle.number.is_multiple_of(2) {
                Parameter::PosStateDio
            } else {
                Parameter::CubeState
            };
            self.schedule.push(joint, Request::Get(parameter));
        }
    }

    /// Nothing moves: one thing of each drive is read, in turn. Every fourth time two things, as long as a control cycle
    /// ([`super::cycle_timing`]).
    fn read_at_rest(&mut self, now: Instant, settings: &Settings, armed: bool) {
        let free = self.all_answered(settings);
        let request = |this: &Self, joint| this.look_request(settings, joint, armed);
        let reads = settings.joints().all(|joint| matches!(request(self, joint), Request::Get(_)));
        let timed = free && reads && self.cycle.number.is_multiple_of(4);
        if timed {
            self.timing.begin_check(now);
        } else if free {
            // One that is at work may last longer than the time between two looks.
            self.timing.abandon();
        }
        self.schedule.set_order(Order::turned(settings.joints as usize, self.cycle.number as usize));
        for joint in settings.joints() {
            let request = request(self, joint);
            if self.schedule.is_done(joint, self.drives.at(joint)) {
                if timed {
                    self.schedule.push(joint, Request::Get(Parameter::ActPos));
                }
                self.schedule.push(joint, request);
            }
        }
    }

    /// What to read next from a drive that does not move.
    pub(super) fn look_request(&self, settings: &Settings, joint: JointIndex, armed: bool) -> Request {
        if armed && self.drives.at(joint).loaded.v_rad_s.is_none() {
            // Then the first cycle of the run need not.
            return Request::Set(Parameter::TargetVel, Value::F32(settings.joint.at(joint).v_max_rad_s));
        }
        let position = if self.has_pos_state(joint) { Parameter::PosStateDio } else { Parameter::ActPos };
        Request::Get(match self.cycle.number % 4 {
            0 | 2 => position,
            1 => Parameter::CubeState,
            // Beside a joint at work each look is for its current.
            _ if !matches!(self.mode, Mode::Standing { .. }) => Parameter::Cur,
            _ if !self.holds_settings(settings, joint) => return Self::current_write(settings, joint),
            _ => Self::slow_look(self.cycle.number / 4),
        })
    }

    /// True if no drive has anything left to be asked, or to answer.
    pub(super) fn all_answered(&self, settings: &Settings) -> bool {
        settings.joints().all(|joint| self.schedule.is_done(joint, self.drives.at(joint)))
    }

    pub(super) fn has_pos_state(&self, joint: JointIndex) -> bool {
        // Not through the parameter table: its texts would fill a board's flash.
        self.drives.at(joint).version.is_some_and(|version| POS_STATE_GATE.allows(version))
    }

    /// Last position, rad; zero before the first.
    pub(super) fn q_rad(&self, joint: JointIndex) -> f32 {
        self.drives.at(joint).position.map_or(0.0, |PositionSample { q_rad, .. }| q_rad)
    }

    /// A new agenda for a drive.
    pub(super) fn set_agenda(&mut self, joint: JointIndex, requests: &[Request]) {
        self.schedule.set(joint, Agenda::of(requests));
    }

    /// Sends a sign of life that is due. One that falls due in a control cycle goes with the writes at its beginning:
    /// later it could take a motion's slot.
    pub(super) fn refresh_watchdog(&mut self, now: Instant, settings: &Settings) {
        let Some(due) = self.watchdog_due else { return };
        let early =
            self.mode.is_cyclic() && due < self.cycle.due && now < self.cycle.at + self.slots.writes();
        if due <= now || early {
            self.send_watchdog(now, settings);
        }
    }

    pub(super) fn send_watchdog(&mut self, now: Instant, settings: &Settings) {
        self.watchdog_due = Some(now + Duration::from_micros(settings.watchdog_refresh_us.into()));
        self.send(&Broadcast::Watchdog.encode());
    }

    /// Clears errors and halts of all drives; nothing moves by it. What was read before is void.
    pub(super) fn send_reset(&mut self, now: Instant, settings: &Settings) {
        self.reset_at = now + Duration::from_micros(1);
        for joint in settings.joints() {
            self.drives.at_mut(joint).reset();
        }
        self.send(&Broadcast::Reset.encode());
    }
}
