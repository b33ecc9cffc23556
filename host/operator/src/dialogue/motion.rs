//! Bounded motions of single drives without a controller: homing and jogging at reduced speed.
//!
//! A dead host must not leave a drive running. Jogging therefore never orders a velocity: it orders a ramp to a
//! point that lies [`JOG_HORIZON`] ahead, again and again; when nobody asks any more, the drive stops there by
//! itself. Homing has no such form in the protocol; it is bounded by time and current, and by the drive's limits.

use protocol::cyphal::cubecell::stop::Reason;
use protocol::powercube::{CubeState, Motion, MotionCommand, Parameter, Request, SimpleCommand, Value};
use protocol::units::{RadPerSec, Radians};
use protocol::{Duration, Instant, ModuleId};

use super::ask::AskError;
use super::zero_check::{ZeroCheck, ZeroOffset};
use crate::bus::BusFailure;
use crate::bus::session::Session;

/// How far ahead of itself a jogged drive is sent.
pub const JOG_HORIZON: Duration = Duration::from_millis(200);
/// Time between two orders of a jog.
const JOG_PERIOD: Duration = Duration::from_millis(40);
/// Time between two readings of the position while the zero is compared.
const ZERO_PERIOD: Duration = Duration::from_millis(2);
/// Time between two looks at a drive that moves.
const LOOK_PERIOD: Duration = Duration::from_millis(20);
/// A current above the bound this long ends a homing.
const OVER_CURRENT_TIME: Duration = Duration::from_millis(100);
/// Time that a drive gets to stand still.
const STAND_TIME: Duration = Duration::from_millis(500);
/// Time that a drive gets to show that it has begun.
const BEGIN_TIME: Duration = Duration::from_millis(200);

/// Why a motion did not end as it should. Whatever moved was halted.
#[derive(Debug, thiserror::Error)]
pub enum MotionError {
    /// A question failed; the modules were halted.
    #[error(transparent)]
    Ask(#[from] AskError),
    /// Error of the drive.
    #[error("module {module} reports {state}{}\n  next: {}", if .state.intersects(CubeState::NEEDS_POWER_CYCLE) { ", which only switching it off clears" } else { "" }, .next)]
    Drive {
        /// Which.
        module: ModuleId,
        /// Its causes.
        state: CubeState,
        /// What to do.
        next: &'static str,
    },
    /// Took too long.
    #[error(
        "module {module} did not find its zero within {limit}; it was halted\n  next: check the home switch, the direction of homing (sign of HomeVel) and that the joint is free; `--timeout` gives it longer"
    )]
    HomingTimeout {
        /// Which.
        module: ModuleId,
        /// The bound.
        limit: Duration,
    },
    /// Drew too much current.
    #[error(
        "module {module} drew {current_a:.1} A, more than the {bound_a:.1} A allowed; it was halted\n  next: see what blocks the joint; `--current` raises the bound"
    )]
    OverCurrent {
        /// Which.
        module: ModuleId,
        /// What it drew.
        current_a: f64,
        /// The bound.
        bound_a: f64,
    },
    /// Did not stand still; it was halted.
    #[error("module {module} did not stand still after the jog; it was halted\n  next: `cubectl status`")]
    StillMoving {
        /// Which.
        module: ModuleId,
    },
}

impl From<BusFailure> for MotionError {
    fn from(failure: BusFailure) -> Self {
        Self::Ask(failure.into())
    }
}

/// Bounds of a homing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingBounds {
    /// Largest homing speed, rad/s.
    pub speed_max_rad_s: f64,
    /// Largest current, as a share of the drive's own maximum, 0..=1.
    pub current_share: f64,
    /// Longest time.
    pub time: Duration,
}

impl Default for HomingBounds {
    fn default() -> Self {
        Self { speed_max_rad_s: 0.2, current_share: 0.8, time: Duration::from_secs(40) }
    }
}

/// What a homing did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homed {
    /// Which module.
    pub module: ModuleId,
    /// How long.
    pub took: Duration,
    /// Where it stands now, rad.
    pub position_rad: f64,
    /// Largest current seen, A.
    pub current_max_a: f64,
    /// How far its reading was off before, if that was looked at and can be said.
    pub zero: Option<ZeroOffset>,
}

/// Homes one module. With `looks_at_zero` its reading before is compared with the zero that is found: reduced speed,
/// bounded in time and current. `has_home_vel` says whether its firmware lets the
/// speed be set; the value it had is put back. An interruption halts it.
///
/// # Errors
/// [`MotionError`]; the module was halted.
pub fn home(
    session: &mut Session,
    module: ModuleId,
    bounds: &HomingBounds,
    has_home_vel: bool,
    looks_at_zero: bool,
) -> Result<Homed, MotionError> {
    recover(session, module)?;
    let bound_a = bounds.current_share * session.get_f64(module, Parameter::MaxCur)?;
    let mut usual = None;
    if has_home_vel {
        let v = session.get_f64(module, Parameter::HomeVel)?;
        if v.abs() > bounds.speed_max_rad_s {
            session.set_f32(module, Parameter::HomeVel, (bounds.speed_max_rad_s.copysign(v)) as f32)?;
            usual = Some(v as f32);
        }
    }
    session.guard_motion();
    let zero = looks_at_zero.then(|| ZeroCheck::new(bounds.speed_max_rad_s));
    let result = watch_homing(session, module, bounds, bound_a, zero);
    if result.is_err() {
        session.halt(Reason::HOST)?;
    }
    session.release_motion();
    if let Some(v) = usual {
        session.set_f32(module, Parameter::HomeVel, v)?;
    }
    result
}

fn watch_homing(
    session: &mut Session,
    module: ModuleId,
    bounds: &HomingBounds,
    bound_a: f64,
    mut zero: Option<ZeroCheck>,
) -> Result<Homed, MotionError> {
    session.command(module, SimpleCommand::Home)?;
    let begun = session.now();
    let (mut over_since, mut current_max_a) = (None, 0.0_f64);
    // HOME_OK falls when homing starts; a module that was homed must first be seen to have begun.
    let mut seen_unhomed = false;
    loop {
        let now = session.now();
        let state = state_of(session, module)?;
        if state.intersects(CubeState::ERROR) {
            let causes = CubeState::from_bits(state.bits() & CubeState::CAUSES.bits());
            return Err(MotionError::Drive {
                module,
                state: causes,
                next: "`cubectl explain 502`; remove the cause, then home again",
            });
        }
        seen_unhomed |= !state.contains(CubeState::HOME_OK);
        let may_be_done = seen_unhomed || now.saturating_since(begun) > BEGIN_TIME;
        if may_be_done && state.contains(CubeState::HOME_OK) && !state.contains(CubeState::MOTION) {
            let position_rad = session.get_f64(module, Parameter::ActPos)?;
            let zero = zero.and_then(ZeroCheck::finish);
            return Ok(Homed {
                module,
                took: now.saturating_since(begun),
                position_rad,
                current_max_a,
                zero,
            });
        }
        let current_a = session.get_f64(module, Parameter::Cur)?.abs();
        current_max_a = current_max_a.max(current_a);
        over_since = if current_a > bound_a { over_since.or(Some(now)) } else { None };
        if over_since.is_some_and(|since| now.saturating_since(since) >= OVER_CURRENT_TIME) {
            return Err(MotionError::OverCurrent { module, current_a, bound_a });
        }
        if now.saturating_since(begun) >= bounds.time {
            return Err(MotionError::HomingTimeout { module, limit: bounds.time });
        }
        let Some(zero) = &mut zero else {
            session.sleep_until(now + LOOK_PERIOD)?;
            continue;
        };
        while session.now() < now + LOOK_PERIOD {
            let q_rad = session.get_f64(module, Parameter::ActPos)?;
            zero.take(session.now(), q_rad);
            session.sleep_until(session.now() + ZERO_PERIOD)?;
        }
    }
}

/// Clears a halt or an error that RESET clears.
fn recover(session: &mut Session, module: ModuleId) -> Result<(), MotionError> {
    let state = state_of(session, module)?;
    if !state.intersects(CubeState::ERROR | CubeState::HALTED) {
        return Ok(());
    }
    session.command(module, SimpleCommand::Reset)?;
    session.sleep_until(session.now() + BEGIN_TIME)?;
    let state = state_of(session, module)?;
    if state.intersects(CubeState::ERROR | CubeState::HALTED) {
        let causes = CubeState::from_bits(state.bits() & CubeState::CAUSES.bits());
        return Err(MotionError::Drive {
            module,
            state: causes,
            next: "remove the cause; `cubectl doctor` says more",
        });
    }
    Ok(())
}

fn state_of(session: &mut Session, module: ModuleId) -> Result<CubeState, AskError> {
    match session.get(module, Parameter::CubeState)? {
        Value::U32(bits) => Ok(CubeState::from_bits(bits)),
        _ => Ok(CubeState::EMPTY),
    }
}

/// What a jog did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jogged {
    /// Where it began, rad.
    pub from_rad: f64,
    /// Where it stands, rad.
    pub to_rad: f64,
    /// How long it was held.
    pub held: Duration,
    /// It stopped before a soft limit although it was still held.
    pub at_limit: bool,
}

/// Moves one module while `held` says so, at `speed_rad_s` (its sign is the direction), not beyond its soft limits
/// if it is homed.
///
/// `held` is asked with the time before each order; a drive that is no longer ordered stops within
/// [`JOG_HORIZON`]. The same happens on Ctrl-C, which is no error here.
///
/// # Errors
/// [`MotionError`]; the module was halted.
pub fn jog(
    session: &mut Session,
    module: ModuleId,
    speed_rad_s: f64,
    held: &mut dyn FnMut(Instant) -> bool,
) -> Result<Jogged, MotionError> {
    recover(session, module)?;
    let homed = state_of(session, module)?.contains(CubeState::HOME_OK);
    let limits = if homed {
        let low = session.get_f64(module, Parameter::MinPos)?;
        Some((low, session.get_f64(module, Parameter::MaxPos)?))
    } else {
        None
    };
    let a_max = session.get_f64(module, Parameter::MaxAcc)?;
    let from_rad = session.get_f64(module, Parameter::ActPos)?;
    session.set_f32(module, Parameter::TargetVel, speed_rad_s.abs() as f32)?;
    // Reaches the speed within a quarter of the horizon, as far as the drive can.
    let a = (4.0 * speed_rad_s.abs() / JOG_HORIZON.as_secs_f64()).min(a_max);
    session.set_f32(module, Parameter::TargetAcc, a as f32)?;
    let begun = session.now();
    session.guard_motion();
    let result = hold(session, module, speed_rad_s, limits, held);
    let at_limit = match result {
        Ok(at_limit) => at_limit,
        Err(error) => {
            session.halt(Reason::HOST)?;
            return Err(error);
        }
    };
    let held_for = session.now().saturating_since(begun);
    stand_still(session, module)?;
    session.release_motion();
    // Ctrl-C has been obeyed by now: this question is asked all the same.
    let to_rad = session.desk().heard().get(&module).and_then(|heard| heard.position_rad);
    Ok(Jogged { from_rad, to_rad: to_rad.map_or(from_rad, f64::from), held: held_for, at_limit })
}

fn hold(
    session: &mut Session,
    module: ModuleId,
    speed_rad_s: f64,
    limits: Option<(f64, f64)>,
    held: &mut dyn FnMut(Instant) -> bool,
) -> Result<bool, MotionError> {
    while !session.is_interrupted() && held(session.now()) {
        let now = session.now();
        let position = match session.get_f64(module, Parameter::ActPos) {
            Err(AskError::Interrupted) => break,
            other => other?,
        };
        let ahead = position + speed_rad_s * JOG_HORIZON.as_secs_f64();
        let target = limits.map_or(ahead, |(low, high)| ahead.clamp(low.min(position), high.max(position)));
        if limits.is_some() && (target - position).abs() < 1e-3 {
            return Ok(true);
        }
        let command = MotionCommand::Ramp { target: Radians::new(target as f32) };
        match session.ask(module, Request::Move(Motion::extended(command))) {
            Err(AskError::Interrupted) => break,
            other => drop(other?),
        }
        let state = match state_of(session, module) {
            Err(AskError::Interrupted) => break,
            other => other?,
        };
        if state.intersects(CubeState::ERROR | CubeState::HALTED) {
            let state = CubeState::from_bits(state.bits() & CubeState::CAUSES.bits());
            return Err(MotionError::Drive {
                module,
                state,
                next: "`cubectl status`, then `cubectl doctor`",
            });
        }
        match session.sleep_until(now + JOG_PERIOD) {
            Err(AskError::Interrupted) => break,
            other => other?,
        }
    }
    Ok(false)
}

/// Orders velocity zero and watches; halts what does not obey. Works after Ctrl-C too.
fn stand_still(session: &mut Session, module: ModuleId) -> Result<(), MotionError> {
    let begun = session.now();
    let desk = session.desk();
    desk.drives.cancel_all();
    let zero = Motion::extended(MotionCommand::Velocity(RadPerSec::new(0.0)));
    // An empty queue takes these.
    let _ = desk.start(module, Request::Move(zero));
    while session.now() < begun + STAND_TIME {
        let asked = session.now();
        let _ = session.desk().start(module, Request::Get(Parameter::CubeState));
        let _ = session.desk().start(module, Request::Get(Parameter::ActPos));
        session.pass(LOOK_PERIOD)?;
        let desk = session.desk();
        while desk.poll_outcome().is_some() {}
        // The first look may still see the motion of before.
        let heard = desk.heard().get(&module).filter(|heard| heard.at > asked && asked > begun);
        if heard.and_then(|heard| heard.state).is_some_and(|state| !state.contains(CubeState::MOTION)) {
            return Ok(());
        }
    }
    session.halt(Reason::HOST)?;
    Err(MotionError::StillMoving { module })
}
