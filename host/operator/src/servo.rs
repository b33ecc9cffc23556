//! An arm that follows a stream of commands: the states of [`planner::servo`] as end states of a controller.
//!
//! ```text
//! commands ──▶ planner::servo ──▶ state at now + LEAD ──▶ end state, one per tick ──▶ controller: law, limits, braking
//! ```
//!
//! The controller runs a plan that stands still and accepts end states in flight ([`crate::dialogue::online`]). It
//! moves to each of them in time and brakes after it. If the host is late or has failed, the arm comes to rest on a
//! way that was proven free.
//!
//! From any state on its way the controller can reach the next end state within the acceleration of the servo: the
//! way by the end state before is such a way, and its law takes the one of least acceleration. Lost messages change
//! nothing as long as one of [`LEAD`] arrives. An end state that comes too late is refused; the arm brakes, and the
//! stream begins anew where it rests.

use std::collections::BTreeMap;

use firmware::envelope::Envelope;
use firmware::settings::Settings;
use planner::plan::{Arm, Joints};
use planner::servo::{BRAKE_SHARE, Bounds, Command, Limited, NoServo, Refused, Servo, TICK_S, bounds_of};
use protocol::cyphal::cubecell::group_state::State;
use protocol::{Duration, Instant};
use robot_model::PerJoint;
use robot_model::collision::Scene;

use crate::dialogue::online::EndStates;
use crate::dialogue::operator::{OperatorError, stopped};
use crate::dialogue::registers::settings_of;
use crate::port::Interactive;
use crate::trajectory::standing_within;

/// Time from a command to the state that contains it, on a CAN bus: a message of up to 6 ms, two control periods
/// and the lag of the drives, the shortest way of the controller, and 40 ms for a host that is late. Of other
/// links: [`Interactive::lead`].
pub const LEAD: Duration = Duration::from_millis(80);
/// Between two states.
const TICK: Duration = Duration::from_millis((TICK_S * 1e3) as u64);
/// The plan that stands still: until the first end state is taken.
const STANDING_US: u32 = 20_000_000;
/// A run counts microseconds in 32 bits. After this the arm comes to rest once and a new run begins.
const RUN_MAX: Duration = Duration::from_secs(3_600);
/// Time between two comparisons with the clock of the controller: it drifts 0.2 ms a second at most.
const CLOCK_LOOK: Duration = Duration::from_secs(5);
/// Largest change of the used clock difference in a tick, µs: 0.1 %, more than clocks drift. A leap of half a
/// millisecond would be half a milliradian at 1 rad/s, and an end state beyond the acceleration.
const SLEW_US: f64 = 20.0;
/// Longest time that braking takes.
const REST_MAX: Duration = Duration::from_secs(10);
/// Share of the speed of the controller's envelope that the servo uses: the rest is for rounding.
const SPEED_SHARE: f64 = 0.99;
/// Registers from which the envelope is made.
const REGISTERS: [&str; 6] = [
    "group.robot_crc32",
    "cycle.period_us",
    "joint.q_min_rad",
    "joint.q_max_rad",
    "joint.v_max_rad_s",
    "joint.a_max_rad_s2",
];

/// What a stream has next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Next {
    Command(Command),
    /// Nothing now.
    Nothing,
    /// Nothing any more: the arm comes to rest.
    End,
}

/// Who streams, and who watches.
pub trait Stream {
    /// The next command at `t_s`, s after the first run of the controller began; called until there is no command.
    fn next(&mut self, t_s: f64) -> Next;

    /// A command that was not taken.
    fn refused(&mut self, t_s: f64, why: Refused);

    /// The newest state, and what keeps the arm from more; once per tick.
    fn ticked(&mut self, t_s: f64, servo: &Servo<'_>, limited: Option<&Limited>);
}

/// What keeps a stream in bounds.
#[derive(Clone, Debug)]
pub struct Keeps {
    /// Share of the limits of the arm, above 0 and at most 1.
    pub share: f64,
    /// No joint is faster, rad/s.
    pub v_max_rad_s: f64,
    /// Without a command for this long the arm comes to rest.
    pub hold: Duration,
    pub scene: Scene,
}

/// What became of a stream.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Streamed {
    pub duration_s: f64,
    /// Counts of commands that the servo took and refused.
    pub taken: u64,
    pub refused: u64,
    /// End states that were sent, and that the controller refused, by its cause.
    pub sent: u64,
    pub late: BTreeMap<u16, u64>,
    /// End states for which the queue to the bus had no room.
    pub unsent: u64,
    /// The stream began anew after the arm had come to rest because end states came too late.
    pub restarts: u64,
    /// Ticks in which limits kept the arm from its command.
    pub limited: u64,
    /// Where it rests by the stream and as measured, rad.
    pub end_rad: Vec<f64>,
    pub measured_rad: Vec<f64>,
    /// The program was ordered to end.
    pub interrupted: bool,
}

/// Why a stream did not begin, or ended.
#[derive(Debug, thiserror::Error)]
pub enum ServoError {
    #[error(transparent)]
    Operator(#[from] OperatorError),
    #[error(transparent)]
    NoServo(#[from] NoServo),
    #[error("a share of the limits is above 0 and at most 1; {share} is not")]
    Share { share: f64 },
    #[error("the plan that stands still does not fit a file")]
    Plan,
}

/// A run of the controller that takes end states.
struct Taking {
    begun: Instant,
    /// When the newest end state is to be reached, in our time.
    front: Instant,
    looked: Instant,
    /// Time of the controller less ours, as it is used, µs.
    offset_us: f64,
}

impl Taking {
    /// The time of the controller at the front.
    fn front_there(&mut self, operator: &mut dyn Interactive) -> Instant {
        let offset_us = operator.clock_offset_us(self.front).unwrap_or(self.offset_us);
        self.offset_us += (offset_us - self.offset_us).clamp(-SLEW_US, SLEW_US);
        Instant::from_micros((self.front.as_micros() as f64 + self.offset_us).round().max(0.0) as u64)
    }
}

/// Follows `stream` to its end, with a homed arm that stands and is ready. The arm stands when this returns without an error;
/// with one it is halted when the session ends.
///
/// # Errors
/// [`ServoError`]; a stop by another node or a person, or a fault, ends it.
pub fn follow(
    operator: &mut dyn Interactive,
    arm: &Arm,
    keeps: &Keeps,
    stream: &mut dyn Stream,
) -> Result<Streamed, ServoError> {
    if !(keeps.share > 0.0 && keeps.share <= 1.0) {
        return Err(ServoError::Share { share: keeps.share });
    }
    let wanted = |info: &firmware::registers::RegisterInfo| REGISTERS.contains(&info.name);
    let settings = settings_of(wanted, &mut |name| operator.register(name))?;
    let lead = operator.lead();
    let mut bounds = within(&settings, lead, bounds_of(arm, keeps.share));
    bounds.iter_mut().for_each(|joint| joint.v_rad_s = joint.v_rad_s.min(keeps.v_max_rad_s));
    let mut streamed = Streamed::default();
    let hold_s = keeps.hold.as_secs_f64();
    let since = |now: Instant, zero: Instant| now.saturating_since(zero).as_secs_f64();
    let (mut zero, mut ended) = (None, false);
    loop {
        let pose = Joints::from_slice(&operator.pose()?);
        let bounds = around(bounds, &pose, &settings);
        let mut servo = Servo::new(arm, &keeps.scene, bounds, &pose, hold_s)?;
        let mut taking = begin(operator, &settings, &bounds, &pose)?;
        let zero = *zero.get_or_insert(taking.begun);
        loop {
            let t_s = since(operator.now(), zero);
            while !ended {
                match stream.next(t_s) {
                    Next::Command(command) => match servo.take(t_s, command) {
                        Ok(()) => streamed.taken += 1,
                        Err(why) => {
                            streamed.refused += 1;
                            stream.refused(t_s, why);
                        }
                    },
                    Next::Nothing => break,
                    Next::End => ended = true,
                }
            }
            let ends = ended || operator.now().saturating_since(taking.begun) > RUN_MAX;
            if ends {
                servo.release();
            }
            let limited = servo.tick(t_s);
            streamed.limited += u64::from(limited.is_some());
            stream.ticked(t_s, &servo, limited.as_ref());
            taking.front += TICK;
            send(operator, &mut taking, &servo, &mut streamed)?;
            if operator.now().saturating_since(taking.looked) > CLOCK_LOOK && !ended {
                operator.look_at_clock()?;
                taking.looked = operator.now();
            }
            let until = Instant::from_micros(taking.front.as_micros().saturating_sub(lead.as_micros()));
            // When the program is ordered to end, the arm has come to rest first.
            if streamed.interrupted {
                operator.pass(until.saturating_since(operator.now()))?;
            } else if operator.run_until(until)? {
                (streamed.interrupted, ended) = (true, true);
            }
            for refusal in operator.refused_targets() {
                *streamed.late.entry(refusal.cause.code()).or_default() += 1;
            }
            let group = operator.group();
            match group.state {
                State::Ready => break,
                // One end state of rest ends the run; the plan that stands still would continue.
                _ if ends && servo.is_at_rest() => break,
                State::Running => {}
                _ => return Err(stopped(&group).into()),
            }
        }
        rest(operator)?;
        operator.release_motion();
        streamed.end_rad = servo.q_rad().to_vec();
        if ended {
            break;
        }
        streamed.restarts += 1;
    }
    streamed.duration_s = zero.map_or(0.0, |zero| since(operator.now(), zero));
    if !streamed.interrupted {
        streamed.measured_rad = operator.pose()?;
    }
    Ok(streamed)
}

/// Bounds inside the envelope that the controller allows.
///
/// The controller's way from state to state differs from that of the servo. Two ways with the same ends and at most
/// the acceleration A are at most A T² / 8 apart after T; the servo stays away from the ends of the joint ranges by
/// this distance.
fn within(settings: &Settings, lead: Duration, bounds: PerJoint<Bounds>) -> PerJoint<Bounds> {
    let widest = Envelope::widest(settings);
    let mut narrower = bounds;
    for (joint, bounds) in settings.joints().zip(narrower.iter_mut()) {
        let most = widest.joint.at(joint);
        bounds.v_rad_s = bounds.v_rad_s.min(SPEED_SHARE * f64::from(most.v_max_rad_s));
        bounds.a_rad_s2 = bounds.a_rad_s2.min(f64::from(most.a_max_rad_s2) / BRAKE_SHARE);
        let apart_rad = BRAKE_SHARE * bounds.a_rad_s2 * (lead + TICK).as_secs_f64().powi(2) / 8.0;
        bounds.q_min_rad = bounds.q_min_rad.max(f64::from(most.q_min_rad)) + apart_rad;
        bounds.q_max_rad = bounds.q_max_rad.min(f64::from(most.q_max_rad)) - apart_rad;
    }
    narrower
}

/// The same with an arm inside that stands nearer to the end of a range, but not outside the envelope.
fn around(bounds: PerJoint<Bounds>, pose: &Joints, settings: &Settings) -> PerJoint<Bounds> {
    let widest = Envelope::widest(settings);
    let mut wider = bounds;
    for (k, (joint, bounds)) in settings.joints().zip(wider.iter_mut()).enumerate() {
        let most = widest.joint.at(joint);
        bounds.q_min_rad = bounds.q_min_rad.min(pose[k].max(most.q_min_rad.into()));
        bounds.q_max_rad = bounds.q_max_rad.max(pose[k].min(most.q_max_rad.into()));
    }
    wider
}

/// Uploads, arms and runs a plan that holds the arm where it stands. The controller brakes with the accelerations that were checked before.
fn begin(
    operator: &mut dyn Interactive,
    settings: &Settings,
    bounds: &PerJoint<Bounds>,
    pose: &Joints,
) -> Result<Taking, ServoError> {
    let mut envelope = Envelope::widest(settings);
    for (joint, bounds) in settings.joints().zip(bounds.iter()) {
        let most = envelope.joint.at_mut(joint);
        most.v_max_rad_s = (bounds.v_rad_s / SPEED_SHARE) as f32;
        most.a_max_rad_s2 = (BRAKE_SHARE * bounds.a_rad_s2) as f32;
    }
    let bytes = standing_within(settings, envelope, pose, STANDING_US).ok_or(ServoError::Plan)?;
    let name = operator.upload(&bytes.into(), &mut |_, _| {})?;
    operator.read_clock()?;
    operator.arm(&name)?;
    operator.start(&name)?;
    let now = operator.now();
    let offset_us = operator.clock_offset_us(now).ok_or(OperatorError::Lost)?;
    Ok(Taking { begun: now, front: now + operator.lead(), looked: now, offset_us })
}

fn send(
    operator: &mut dyn Interactive,
    taking: &mut Taking,
    servo: &Servo<'_>,
    streamed: &mut Streamed,
) -> Result<(), OperatorError> {
    let state = servo.state();
    let end = EndStates {
        at: taking.front_there(operator),
        q_rad: state.iter().map(|joint| joint.q_rad).collect(),
        qd_rad_s: state.iter().map(|joint| joint.qd_rad_s).collect(),
        events: Vec::new(),
    };
    match operator.send_target(streamed.sent as u8, &end) {
        Ok(()) => streamed.sent += 1,
        // The next one stands for it.
        Err(OperatorError::TargetNotSaid { .. }) => streamed.unsent += 1,
        Err(error) => return Err(error),
    }
    Ok(())
}

/// Waits, also after an interruption, until the run has ended.
fn rest(operator: &mut dyn Interactive) -> Result<(), OperatorError> {
    let until = operator.now() + REST_MAX;
    while operator.now() < until {
        operator.pass(TICK)?;
        let group = operator.group();
        match group.state {
            State::Ready => return Ok(()),
            state if !state.may_move() => return Err(stopped(&group)),
            _ => {}
        }
    }
    Err(OperatorError::Lost)
}
