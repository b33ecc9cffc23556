//! A joint turned within bounds, and what is measured on it meanwhile (`samples`).
//!
//! Every order is a ramp to a checked position, so a drive without further orders stands at its end. Every failure,
//! also Ctrl-C, halts everything on the bus.

mod samples;

use std::cell::RefCell;
use std::rc::Rc;

use firmware::settings::JointSettings;
use protocol::cyphal::cubecell::stop::Reason;
use protocol::powercube::{CubeState, MotionCommand, MotionRequest, Parameter, Reply, Request, Value};
use protocol::units::Radians;
use protocol::{Duration, Instant, ModuleId};
use robot_model::{JointVec, RobotModel};

use crate::bus::BusFailure;
use crate::bus::Session;
use crate::dialogue::ask::AskError;
use samples::{FrameLog, LogTap};

/// Speed of ways between measurements, rad/s, and its share of the largest speed at most.
const TRAVEL_RAD_S: f64 = 0.5;
/// Time beyond the planned one that a ramp may take.
const LATE: Duration = Duration::from_millis(1_500);
/// A ramp ends this near its target, rad.
const ARRIVED_RAD: f64 = 0.01;
/// A current above the bound this long ends the experiment.
const OVER_CURRENT_TIME: Duration = Duration::from_millis(100);
/// Time after which a joint that was sent off must have moved.
const BEGIN_TIME: Duration = Duration::from_millis(400);

/// Why an experiment did not end. What moved was halted.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// A question failed.
    #[error(transparent)]
    Ask(#[from] AskError),
    #[error("module {module} is not homed, so that its position is not known; nothing moved")]
    NotHomed { module: ModuleId },
    /// An error of the drive, in the middle of it.
    #[error(
        "joint {joint} is blocked or in error: module {module} reports {state}; nothing is concluded, everything was halted"
    )]
    Drive {
        joint: usize,
        module: ModuleId,
        /// What it reports.
        state: CubeState,
    },
    /// It was sent off and does not move.
    #[error(
        "joint {joint} is blocked: it moved {moved_rad:.4} rad of {wanted_rad:.3} rad and draws {current_a:.1} A; nothing is concluded, everything was halted"
    )]
    Blocked {
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
        "joint {joint} drew {current_a:.1} A, more than the {bound_a:.1} A allowed; nothing is concluded, everything was halted"
    )]
    OverCurrent {
        joint: usize,
        /// What it drew.
        current_a: f64,
        bound_a: f64,
    },
    /// No way to turn.
    #[error(
        "joint {joint} can only turn from {low_rad:.2} to {high_rad:.2} rad here before a limit or a collision; {needed_rad:.2} rad are needed"
    )]
    NoRoom { joint: usize, low_rad: f64, high_rad: f64, needed_rad: f64 },
}

impl ExperimentError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::NotHomed { .. } => "`cubectl home`, or add --home".to_owned(),
            Self::Drive { .. } => {
                "remove what blocks the joint or the cause, `cubectl status`, then identify again".to_owned()
            }
            Self::Blocked { .. } => {
                "remove what blocks the joint (brake, cable, end stop), then identify again".to_owned()
            }
            Self::OverCurrent { .. } => {
                "see what brakes the joint; `--current-share` raises the bound".to_owned()
            }
            Self::NoRoom { .. } => {
                "bring the arm to another pose (`cubectl jog`), or lower --speed-share".to_owned()
            }
            Self::Ask(error) => return error.next(),
        })
    }
}

impl From<BusFailure> for ExperimentError {
    fn from(failure: BusFailure) -> Self {
        Self::Ask(failure.into())
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Largest current, as a share of the drive's own maximum, 0..=1.
    pub current_share: f64,
    /// Largest speed, as a share of the joint's largest, 0..=1.
    pub speed_share: f64,
    /// Bit rate of the bus, bit/s: for the length of frames.
    pub bit_rate_bit_s: f64,
}

/// One joint of a robot on a bus. All angles are of joints; drives are ordered and read as they are mounted.
pub struct Experiment<'a> {
    session: &'a mut Session,
    model: &'a RobotModel,
    drives: Vec<JointSettings>,
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

impl<'a> Experiment<'a> {
    /// Checks every module: present, homed, without error.
    ///
    /// # Errors
    /// [`ExperimentError`]; nothing has moved.
    pub fn new(
        session: &'a mut Session,
        model: &'a RobotModel,
        drives: Vec<JointSettings>,
        joint: usize,
        bounds: Bounds,
        progress: &'a mut dyn FnMut(&str),
    ) -> Result<Self, ExperimentError> {
        for (i, module) in drives.iter().map(JointSettings::module).enumerate() {
            let Value::U32(bits) = session.get(module, Parameter::CubeState)? else { continue };
            let state = CubeState::from_bits(bits);
            if state.intersects(CubeState::ERROR | CubeState::HALTED) {
                return Err(ExperimentError::Drive { joint: i + 1, module, state: causes(state) });
            }
            if !state.contains(CubeState::HOME_OK) {
                return Err(ExperimentError::NotHomed { module });
            }
        }
        let bound_a = bounds.current_share * session.get_f64(drives[joint].module(), Parameter::MaxCur)?;
        let log = Rc::new(RefCell::new(FrameLog::default()));
        session.add_tap(Box::new(LogTap(Rc::clone(&log))));
        session.guard_motion();
        Ok(Self { session, model, drives, joint, bounds, bound_a, log, over_since: None, progress })
    }

    /// Angles of all joints, rad.
    pub fn positions(&mut self) -> Result<JointVec, ExperimentError> {
        let questions: Vec<_> =
            self.drives.iter().map(|drive| (drive.module(), Request::Get(Parameter::ActPos))).collect();
        let mut q = JointVec::zeros(self.drives.len());
        for (i, answer) in self.session.ask_all(&questions)?.into_iter().enumerate() {
            if let Reply::Value(_, value) = answer.map_err(AskError::Request)? {
                q[i] = self.joint_rad(i, value.as_f64().unwrap_or(f64::NAN));
            }
        }
        Ok(q)
    }

    fn joint_rad(&self, joint: usize, drive_rad: f64) -> f64 {
        f64::from(self.drives[joint].to_joint_rad(drive_rad as f32))
    }

    /// Goes to a pose, one joint after the other.
    pub fn go(&mut self, pose: &JointVec, order: &[usize]) -> Result<(), ExperimentError> {
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

    /// Orders a ramp and watches it to its end.
    fn ramp(
        &mut self,
        joint: usize,
        to_rad: f64,
        v_rad_s: f64,
        a_rad_s2: f64,
        seen: &mut dyn FnMut(Look),
    ) -> Result<(), ExperimentError> {
        let drive = self.drives[joint];
        let module = drive.module();
        let from_rad = self.session.get_f64(module, Parameter::ActPos)?;
        let from_rad = self.joint_rad(joint, from_rad);
        let way = (to_rad - from_rad).abs();
        if way < 0.5 * ARRIVED_RAD {
            return Ok(());
        }
        self.session.set_f32(module, Parameter::TargetVel, v_rad_s as f32)?;
        self.session.set_f32(module, Parameter::TargetAcc, a_rad_s2 as f32)?;
        let command = MotionCommand::Ramp { target: Radians::new(drive.to_drive_rad(to_rad as f32)) };
        let begun = self.session.now();
        self.session.ask(module, Request::Move(MotionRequest::extended(command)))?;
        let planned = Duration::from_secs_f64(way / v_rad_s + v_rad_s / a_rad_s2);
        // A slow ramp takes its time to get there.
        let begun_rad = 0.1 * way.min(0.1);
        let begins_by = BEGIN_TIME + Duration::from_secs_f64(begun_rad / v_rad_s);
        self.over_since = None;
        let mut looks = 0u32;
        loop {
            let position_rad = self.session.get_f64(module, Parameter::ActPos)?;
            let position_rad = self.joint_rad(joint, position_rad);
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
            if (elapsed > begins_by && moved_rad < begun_rad) || elapsed > planned + LATE {
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
}

fn causes(state: CubeState) -> CubeState {
    CubeState::from_bits(state.bits() & (CubeState::CAUSES.bits() | CubeState::HALTED.bits()))
}
