//! The experiments on a drive: turns one joint within bounds, reads currents and positions.
//!
//! Every order is a ramp to a checked position, so a drive that hears no more stands at its end. Whatever
//! goes wrong, Ctrl-C included, halts everything on the bus.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;

use protocol::cyphal::cubecell::stop::Reason;
use protocol::powercube::{CubeState, Motion, MotionCommand, Parameter, Reply, Request, Value};
use protocol::units::Radians;
use protocol::{Duration, Frame, Instant, ModuleId};
use robot_model::{JointVec, RobotModel};

use super::current::{HoldSample, SpeedSample};
use super::lag::StepSample;
use super::poses::{APPROACH_RAD, HOLDS, Sweep};
use crate::bus::Session;
use crate::bus::ask::AskError;
use crate::bus::session::{BusFailure, Tap, Way};

/// Speeds at which the current is measured, share of the fastest.
const SPEED_SHARES: [f64; 6] = [0.25, 0.4, 0.55, 0.7, 0.85, 1.0];
/// Longest stretch over which a current is averaged, rad, and the shortest that is worth it.
const WINDOW_RAD: (f64, f64) = (0.2, 1.0);
/// Way that a joint gets to settle on its speed, rad.
const SETTLE_RAD: f64 = 0.06;
/// Readings averaged for a holding current.
pub(super) const HOLD_READINGS: usize = 300;
/// Readings that a steady speed must have at least.
const SPEED_READINGS_MIN: usize = 20;
/// A joint stands after a ramp for so long before its holding current counts.
const REST: Duration = Duration::from_millis(300);
/// Speed of ways between measurements, rad/s, and its share of the largest speed at most.
const TRAVEL_RAD_S: f64 = 0.5;
/// Steps of acceleration for the lag.
pub const STEPS: usize = 8;
/// Time after a step that is looked at.
const STEP_TIME: Duration = Duration::from_millis(70);
/// Time beyond the planned one that a ramp may take.
const LATE: Duration = Duration::from_millis(1_500);
/// A ramp ends this near its target, rad.
const ARRIVED_RAD: f64 = 0.01;
/// A current above the bound this long ends the experiment.
const OVER_CURRENT_TIME: Duration = Duration::from_millis(100);
/// Time after which a joint that was sent off must have moved.
const BEGIN_TIME: Duration = Duration::from_millis(400);
/// Bits around the data of a frame with an 11-bit identifier (ISO 11898-1), and its share of stuff bits.
const FRAME_BITS: (f64, f64) = (47.0, 1.1);

/// Why an experiment did not end. What moved was halted.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// A question failed.
    #[error(transparent)]
    Ask(#[from] AskError),
    /// Not homed.
    #[error(
        "module {module} is not homed, so that its position is not known; nothing moved\n  next: `cubectl home`, or add --home"
    )]
    NotHomed {
        /// Which.
        module: ModuleId,
    },
    /// An error of the drive, in the middle of it.
    #[error(
        "joint {joint} is blocked or in error: module {module} reports {state}; nothing is concluded, everything was halted\n  next: remove what blocks the joint or the cause, `cubectl status`, then identify again"
    )]
    Drive {
        /// Joint number.
        joint: usize,
        /// Its module.
        module: ModuleId,
        /// What it reports.
        state: CubeState,
    },
    /// It was sent off and does not move.
    #[error(
        "joint {joint} is blocked: it moved {moved_rad:.4} rad of {wanted_rad:.3} rad and draws {current_a:.1} A; nothing is concluded, everything was halted\n  next: remove what blocks the joint (brake, cable, end stop), then identify again"
    )]
    Blocked {
        /// Joint number.
        joint: usize,
        /// Way so far.
        moved_rad: f64,
        /// Way that was ordered.
        wanted_rad: f64,
        /// Last reading.
        current_a: f64,
    },
    /// Too much current.
    #[error(
        "joint {joint} drew {current_a:.1} A, more than the {bound_a:.1} A allowed; nothing is concluded, everything was halted\n  next: see what brakes the joint; `--current` raises the bound"
    )]
    OverCurrent {
        /// Joint number.
        joint: usize,
        /// What it drew.
        current_a: f64,
        /// The bound.
        bound_a: f64,
    },
    /// No way to turn.
    #[error(
        "joint {joint} can only turn from {low_rad:.2} to {high_rad:.2} rad here before a limit or a collision; {needed_rad:.2} rad are needed\n  next: bring the arm to another pose (`cubectl jog`), or lower --speed"
    )]
    NoRoom {
        /// Joint number.
        joint: usize,
        /// From.
        low_rad: f64,
        /// To.
        high_rad: f64,
        /// Needed.
        needed_rad: f64,
    },
}

impl From<BusFailure> for ExperimentError {
    fn from(failure: BusFailure) -> Self {
        Self::Ask(failure.into())
    }
}

/// A frame that passed.
#[derive(Clone, Copy, Debug)]
struct Passed {
    at: Instant,
    way: Way,
    frame: Frame,
}

/// Keeps frames while it is asked to.
#[derive(Default)]
struct FrameLog {
    on: bool,
    frames: Vec<Passed>,
}

struct LogTap(Rc<RefCell<FrameLog>>);

impl Tap for LogTap {
    fn frame(&mut self, at: Instant, way: Way, frame: &Frame) -> io::Result<()> {
        let mut log = self.0.borrow_mut();
        if log.on {
            log.frames.push(Passed { at, way, frame: *frame });
        }
        Ok(())
    }
}

/// Bounds of an experiment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Largest current, as a share of the drive's own maximum, 0..=1.
    pub current_share: f64,
    /// Largest speed, as a share of the joint's largest, 0..=1.
    pub speed_share: f64,
    /// Bit rate of the bus, bit/s: for the length of frames.
    pub bit_rate_bit_s: f64,
}

/// Steady speeds with their mean load.
#[derive(Clone, Debug, PartialEq)]
pub struct Speeds {
    /// One per run.
    pub samples: Vec<SpeedSample>,
    /// Fastest that was asked for, rad/s.
    pub top_rad_s: f64,
    /// Stretch over which the currents were averaged.
    pub stretch: Sweep,
}

/// Answers to steps of acceleration.
#[derive(Clone, Debug, PartialEq)]
pub struct Steps {
    /// All steps laid over each other, upwards.
    pub samples: Vec<StepSample>,
    /// Acceleration commanded, rad/s2.
    pub acceleration_rad_s2: f64,
    /// From the end of a question to the begin of its answer, s.
    pub answers_s: Vec<f64>,
}

/// One joint of a robot on a bus.
pub struct Experiment<'a, const N: usize> {
    session: &'a mut Session,
    model: &'a RobotModel<N>,
    modules: [ModuleId; N],
    joint: usize,
    bounds: Bounds,
    bound_a: f64,
    log: Rc<RefCell<FrameLog>>,
    over_since: Option<Instant>,
    progress: &'a mut dyn FnMut(&str),
}

/// What each question during a ramp brought.
struct Look {
    at: Instant,
    position_rad: f64,
    current_a: f64,
}

impl<'a, const N: usize> Experiment<'a, N> {
    /// Looks at every module: there, homed, without error.
    ///
    /// # Errors
    /// [`ExperimentError`]; nothing has moved.
    pub fn new(
        session: &'a mut Session,
        model: &'a RobotModel<N>,
        modules: [ModuleId; N],
        joint: usize,
        bounds: Bounds,
        progress: &'a mut dyn FnMut(&str),
    ) -> Result<Self, ExperimentError> {
        for (i, module) in modules.into_iter().enumerate() {
            let Value::U32(bits) = session.get(module, Parameter::CubeState)? else { continue };
            let state = CubeState::from_bits(bits);
            if state.intersects(CubeState::ERROR | CubeState::HALTED) {
                return Err(ExperimentError::Drive { joint: i + 1, module, state: causes(state) });
            }
            if !state.contains(CubeState::HOME_OK) {
                return Err(ExperimentError::NotHomed { module });
            }
        }
        let bound_a = bounds.current_share * session.get_f64(modules[joint], Parameter::MaxCur)?;
        let log = Rc::new(RefCell::new(FrameLog::default()));
        session.add_tap(Box::new(LogTap(Rc::clone(&log))));
        session.guard_motion();
        Ok(Self { session, model, modules, joint, bounds, bound_a, log, over_since: None, progress })
    }

    /// Positions of all joints, rad.
    ///
    /// # Errors
    /// [`ExperimentError`].
    pub fn positions(&mut self) -> Result<JointVec<N>, ExperimentError> {
        let questions = self.modules.map(|module| (module, Request::Get(Parameter::ActPos)));
        let mut q = JointVec::<N>::zeros();
        for (i, answer) in self.session.ask_all(&questions)?.into_iter().enumerate() {
            if let Reply::Value(_, value) = answer.map_err(AskError::Request)? {
                q[i] = value.as_f64().unwrap_or(f64::NAN);
            }
        }
        Ok(q)
    }

    /// Reads the current while standing, several times, A.
    fn readings(&mut self, count: usize) -> Result<Vec<f64>, ExperimentError> {
        let module = self.modules[self.joint];
        let mut read = || self.session.get_f64(module, Parameter::Cur).map_err(ExperimentError::from);
        (0..count).map(|_| read()).collect()
    }

    /// Standard deviation of the current reading of the standing joint, A.
    ///
    /// # Errors
    /// [`ExperimentError`].
    pub fn scatter_a(&mut self) -> Result<f64, ExperimentError> {
        (self.progress)("noise of the current");
        let readings = self.readings(HOLD_READINGS)?;
        let mean = mean(&readings);
        let squares: f64 = readings.iter().map(|a| (a - mean).powi(2)).sum();
        Ok((squares / (readings.len() - 1) as f64).sqrt())
    }

    /// Goes to a pose, one joint after the other.
    ///
    /// # Errors
    /// [`ExperimentError`].
    pub fn go(&mut self, pose: &JointVec<N>, order: &[usize]) -> Result<(), ExperimentError> {
        for &i in order {
            (self.progress)(&format!("joint {} to {:.2} rad", i + 1, pose[i]));
            self.travel(i, pose[i])?;
        }
        Ok(())
    }

    fn travel(&mut self, joint: usize, to_rad: f64) -> Result<(), ExperimentError> {
        let limits = &self.model.joints()[joint].limits;
        let v = TRAVEL_RAD_S.min(0.5 * limits.v_max_rad_s);
        let a = (2.0 * v).min(limits.a_control_max_rad_s2);
        self.ramp(joint, to_rad, v, a, &mut |_| {})
    }

    /// Steady speeds in both directions over the same stretch of `sweep`: the mean load is then the same in all runs
    /// and does not look like K_B.
    ///
    /// # Errors
    /// [`ExperimentError`].
    pub fn speeds(&mut self, sweep: &Sweep) -> Result<Speeds, ExperimentError> {
        let limits = self.model.joints()[self.joint].limits;
        let a = limits.a_control_max_rad_s2.min(limits.a_max_rad_s2);
        let needed = |v: f64| v * v / a + 2.0 * SETTLE_RAD + WINDOW_RAD.0;
        let fastest = self.bounds.speed_share * limits.v_max_rad_s;
        let room = ((sweep.length_rad() - 2.0 * SETTLE_RAD - WINDOW_RAD.0).max(0.0) * a).sqrt();
        let top_rad_s = fastest.min(room);
        if top_rad_s < 0.5 * fastest {
            let needed_rad = needed(fastest);
            let (low_rad, high_rad) = (sweep.low_rad, sweep.high_rad);
            return Err(ExperimentError::NoRoom { joint: self.joint + 1, low_rad, high_rad, needed_rad });
        }
        let window = (sweep.length_rad() - top_rad_s * top_rad_s / a - 2.0 * SETTLE_RAD).min(WINDOW_RAD.1);
        let half = 0.5 * (window + top_rad_s * top_rad_s / a) + SETTLE_RAD;
        let centre = sweep.centre_rad();
        self.travel(self.joint, centre - half)?;
        let mut runs: Vec<(f64, Vec<Look>)> = Vec::new();
        for share in SPEED_SHARES {
            for direction in [1.0, -1.0] {
                let v = share * top_rad_s;
                (self.progress)(&format!("current at {:+.2} rad/s", direction * v));
                let mut looks = Vec::new();
                self.ramp(self.joint, centre + direction * half, v, a, &mut |look| {
                    if (look.position_rad - centre).abs() < 0.5 * window {
                        looks.push(look);
                    }
                })?;
                runs.push((direction, looks));
            }
        }
        // As many readings for each run: then they are equally certain.
        let count = runs.iter().map(|(_, looks)| looks.len()).min().unwrap_or(0);
        if count < SPEED_READINGS_MIN {
            let (low_rad, high_rad) = (sweep.low_rad, sweep.high_rad);
            let needed_rad = needed(fastest) + WINDOW_RAD.1;
            return Err(ExperimentError::NoRoom { joint: self.joint + 1, low_rad, high_rad, needed_rad });
        }
        let samples = runs
            .iter()
            .map(|(direction, looks)| {
                let kept: Vec<f64> = (0..count).map(|i| looks[i * looks.len() / count].current_a).collect();
                SpeedSample { speed_rad_s: slope(looks), current_a: signed(mean(&kept), *direction) }
            })
            .collect();
        let stretch = Sweep { low_rad: centre - 0.5 * window, high_rad: centre + 0.5 * window };
        Ok(Speeds { samples, top_rad_s, stretch })
    }

    /// Holding currents at `holds_rad`, each approached from both sides; the other joints stand.
    ///
    /// # Errors
    /// [`ExperimentError`].
    pub fn holds(&mut self, holds_rad: &[f64]) -> Result<Vec<HoldSample>, ExperimentError> {
        let mut samples = Vec::new();
        for &hold in holds_rad {
            for approach in [1.0, -1.0] {
                (self.progress)(&format!("holding current at {hold:.2} rad"));
                self.travel(self.joint, hold - approach * APPROACH_RAD)?;
                self.travel(self.joint, hold)?;
                self.session.sleep_until(self.session.now() + REST)?;
                let q = self.positions()?;
                let torque_nm = self.model.gravity_torques(&q)[self.joint];
                let current_a = signed(mean(&self.readings(HOLD_READINGS)?), torque_nm);
                samples.push(HoldSample { torque_nm, current_a, approach });
            }
        }
        Ok(samples)
    }

    /// Answers to steps of acceleration about the middle of `sweep`, up and down.
    ///
    /// # Errors
    /// [`ExperimentError`].
    pub fn steps(&mut self, sweep: &Sweep) -> Result<Steps, ExperimentError> {
        let limits = self.model.joints()[self.joint].limits;
        let a = (0.8 * limits.a_control_max_rad_s2).min(limits.a_max_rad_s2);
        // Far enough for the whole step at full acceleration, and back.
        let reach = (a * STEP_TIME.as_secs_f64().powi(2)).max(0.1);
        if sweep.length_rad() < reach {
            let (low_rad, high_rad) = (sweep.low_rad, sweep.high_rad);
            return Err(ExperimentError::NoRoom {
                joint: self.joint + 1,
                low_rad,
                high_rad,
                needed_rad: reach,
            });
        }
        let from = sweep.centre_rad() - 0.5 * reach;
        let mut steps = Steps { samples: Vec::new(), acceleration_rad_s2: a, answers_s: Vec::new() };
        self.travel(self.joint, from)?;
        for i in 0..STEPS {
            let direction = if i % 2 == 0 { 1.0 } else { -1.0 };
            (self.progress)(&format!("step of {:+.1} rad/s2", direction * a));
            self.session.sleep_until(self.session.now() + REST)?;
            let start = self.positions()?[self.joint];
            self.log.borrow_mut().on = true;
            let target = if direction > 0.0 { from + reach } else { from };
            let done = self.ramp(self.joint, target, limits.v_max_rad_s, a, &mut |_| {});
            let frames = {
                let mut log = self.log.borrow_mut();
                log.on = false;
                std::mem::take(&mut log.frames)
            };
            done?;
            self.take_step(&frames, start, direction, &mut steps);
        }
        Ok(steps)
    }

    /// Positions after the motion command, and how long answers took, from the frames of one step.
    fn take_step(&self, frames: &[Passed], start_rad: f64, direction: f64, steps: &mut Steps) {
        let module = self.modules[self.joint];
        let span_s = |frame: &Frame| {
            (FRAME_BITS.0 + 8.0 * frame.data().len() as f64) * FRAME_BITS.1 / self.bounds.bit_rate_bit_s
        };
        let (mut asked, mut moved) = (None, None);
        for passed in frames {
            match passed.way {
                Way::Sent => {
                    asked = Some(passed.at);
                    // The ramp is the only motion command of a step.
                    if passed.frame.data().first() == Some(&MOTION_BYTE) {
                        moved = moved.or(Some(passed.at));
                    }
                }
                Way::Received => {
                    let Ok((from, reply)) = Reply::decode(&passed.frame) else { continue };
                    if from != module {
                        continue;
                    }
                    let answered_s = passed.at.as_secs_f64() - span_s(&passed.frame);
                    if let Some(asked) = asked.take() {
                        steps.answers_s.push((answered_s - asked.as_secs_f64()).max(0.0));
                    }
                    if let (Some(moved), Reply::Value(Parameter::ActPos, Value::F32(rad))) = (moved, reply) {
                        let t_s = answered_s - moved.as_secs_f64();
                        if (0.0..STEP_TIME.as_secs_f64()).contains(&t_s) {
                            let position_rad = direction * (f64::from(rad) - start_rad);
                            steps.samples.push(StepSample { t_s, position_rad });
                        }
                    }
                }
            }
        }
    }

    /// Orders a ramp and watches it to its end.
    fn ramp(
        &mut self,
        joint: usize,
        to_rad: f64,
        v_rad_s: f64,
        a_rad_s2: f64,
        seen: &mut dyn FnMut(Look),
    ) -> Result<(), ExperimentError> {
        let module = self.modules[joint];
        let from_rad = self.session.get_f64(module, Parameter::ActPos)?;
        let way = (to_rad - from_rad).abs();
        if way < 0.5 * ARRIVED_RAD {
            return Ok(());
        }
        self.session.set_f32(module, Parameter::TargetVel, v_rad_s as f32)?;
        self.session.set_f32(module, Parameter::TargetAcc, a_rad_s2 as f32)?;
        let command = MotionCommand::Ramp { target: Radians::new(to_rad as f32) };
        let begun = self.session.now();
        self.session.ask(module, Request::Move(Motion::extended(command)))?;
        let planned = Duration::from_secs_f64(way / v_rad_s + v_rad_s / a_rad_s2);
        self.over_since = None;
        let mut looks = 0u32;
        loop {
            let position_rad = self.session.get_f64(module, Parameter::ActPos)?;
            let current_a = self.session.get_f64(module, Parameter::Cur)?;
            let now = self.session.now();
            seen(Look { at: now, position_rad, current_a });
            self.watch_current(joint, now, current_a)?;
            let elapsed = now.saturating_since(begun);
            let moved_rad = (position_rad - from_rad).abs();
            let blocked =
                ExperimentError::Blocked { joint: joint + 1, moved_rad, wanted_rad: way, current_a };
            looks += 1;
            // The state word takes time from the readings: every tenth time is soon enough.
            if looks.is_multiple_of(10) {
                let Value::U32(bits) = self.session.get(module, Parameter::CubeState)? else { continue };
                let state = CubeState::from_bits(bits);
                if state.intersects(CubeState::ERROR | CubeState::HALTED) {
                    return Err(ExperimentError::Drive { joint: joint + 1, module, state: causes(state) });
                }
                if !state.contains(CubeState::MOTION) && (position_rad - to_rad).abs() < ARRIVED_RAD {
                    return Ok(());
                }
            }
            if (elapsed > BEGIN_TIME && moved_rad < 0.1 * way.min(0.1)) || elapsed > planned + LATE {
                return Err(blocked);
            }
        }
    }

    fn watch_current(&mut self, joint: usize, now: Instant, current_a: f64) -> Result<(), ExperimentError> {
        let over = joint == self.joint && current_a.abs() > self.bound_a;
        self.over_since = if over { self.over_since.or(Some(now)) } else { None };
        match self.over_since {
            Some(since) if now.saturating_since(since) >= OVER_CURRENT_TIME => {
                Err(ExperimentError::OverCurrent { joint: joint + 1, current_a, bound_a: self.bound_a })
            }
            _ => Ok(()),
        }
    }

    /// Everything stands; the bus is as it was.
    pub fn finish(self) {
        self.session.release_motion();
    }

    /// Halts everything, because of `error`.
    pub fn abort(self, error: ExperimentError) -> ExperimentError {
        match self.session.halt(Reason::HOST) {
            Ok(()) => error,
            Err(failure) => failure.into(),
        }
    }

    /// Number of progress reports of all parts, for a bar; `poses` joints change places twice.
    pub const fn parts(has_holds: bool, poses: usize) -> usize {
        let holds = if has_holds { 2 * HOLDS } else { 0 };
        1 + 2 * SPEED_SHARES.len() + STEPS + holds + 2 * poses
    }
}

/// First byte of a motion command on the wire (protocol: SET MOTION).
const MOTION_BYTE: u8 = 0x0B;

fn causes(state: CubeState) -> CubeState {
    CubeState::from_bits(state.bits() & (CubeState::CAUSES.bits() | CubeState::HALTED.bits()))
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// A reading with the sign of what causes it: drives of this kind report the amount.
fn signed(reading_a: f64, cause: f64) -> f64 {
    if reading_a < 0.0 { reading_a } else { reading_a.copysign(cause) }
}

/// Speed as the slope of the straight line through the positions, rad/s.
fn slope(looks: &[Look]) -> f64 {
    let t = |look: &Look| look.at.as_secs_f64();
    let n = looks.len() as f64;
    let (t_mean, q_mean) =
        (looks.iter().map(t).sum::<f64>() / n, looks.iter().map(|l| l.position_rad).sum::<f64>() / n);
    let (mut above, mut below) = (0.0, 0.0);
    for look in looks {
        let dt = t(look) - t_mean;
        above += dt * (look.position_rad - q_mean);
        below += dt * dt;
    }
    above / below
}
