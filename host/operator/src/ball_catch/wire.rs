//! What a catch over the wire needs: an arm on its bus with a controller in this program, and the tracker's data.
//!
//! In lock step buses and tracker have one virtual time ([`hil_sim::two_arms::in_step`]), and a run depends on the programs and the seed alone.

use std::net::UdpSocket;
use std::path::PathBuf;

use can_link::BusSpec;
use firmware::settings::Settings;
use hil_sim::two_arms::in_step::Follower;
use planner::way::WayError;
use protocol::{Duration, Instant};
use robot_model::RobotModel;

use super::controller_arm::{ControllerArm, NoArm};
use crate::bus::args::{Cell, CellArgs};
use crate::bus::period::{NoPeriod, PeriodRequest, apply, choose};
use crate::bus::settings::{NoSettings, settings_of};
use crate::bus::sim::SimSetup;
use crate::bus::{BusArgs, BusFailure, Session};
use crate::dialogue::operator::OperatorError;
use crate::trajectory::TrajectoryError;

/// Largest datagram, bytes.
const DATAGRAM_MAX: usize = 32_768;
/// Time between two looks at whether work has ended.
const LOOK: Duration = Duration::from_millis(5);

/// Why there was no catch, or why it ended before its time.
#[derive(Debug, thiserror::Error)]
pub enum WireError {
    #[error(transparent)]
    Settings(#[from] NoSettings),
    #[error(transparent)]
    Period(#[from] NoPeriod),
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    #[error(transparent)]
    Bus(#[from] BusFailure),
    #[error(transparent)]
    Operator(Box<OperatorError>),
    #[error(transparent)]
    Arm(Box<NoArm>),
    #[error("{address}: {error}")]
    Tracker { address: String, error: std::io::Error },
    #[error("{address}: no frame of the tracker came")]
    Silent { address: String },
    /// The other arm of a rally has ended.
    #[error("the other arm did not get ready")]
    NotReady,
    /// No way that is free of contact leads from where the arm stands to where it waits.
    #[error("the arm finds no way to where it waits: {0}")]
    NoWay(Box<WayError>),
}

impl WireError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Tracker { .. } => {
                "name an address of this machine and a free port, where the tracker sends its data".to_owned()
            }
            Self::Silent { .. } => {
                "start the tracker and let it send to this address; nothing was thrown".to_owned()
            }
            Self::NotReady => "look at its bus with `cubectl status --bus SPEC`".to_owned(),
            Self::NoWay(_) => {
                "bring the arm to a pose that is free, with `cubectl jog` or `cubectl move`".to_owned()
            }
            Self::Arm(why) => return why.next(),
            Self::Settings(error) => return error.next(),
            Self::Period(error) => return error.next(),
            Self::Trajectory(error) => return error.next(),
            Self::Bus(error) => return error.next(),
            Self::Operator(error) => return error.next(),
        })
    }

    /// The order of the arm behind it, if the arm or its operator ended it.
    #[must_use]
    pub fn operator(&self) -> Option<&OperatorError> {
        match self {
            Self::Operator(why) => Some(why),
            Self::Arm(why) => match &**why {
                NoArm::Operator(why) => Some(why),
                _ => None,
            },
            _ => None,
        }
    }
}

impl From<OperatorError> for WireError {
    fn from(why: OperatorError) -> Self {
        Self::Operator(Box::new(why))
    }
}

impl From<WayError> for WireError {
    fn from(why: WayError) -> Self {
        Self::NoWay(Box::new(why))
    }
}

impl From<NoArm> for WireError {
    fn from(why: NoArm) -> Self {
        Self::Arm(Box::new(why))
    }
}

/// An arm on a bus, with a controller in this program.
#[derive(Clone, Debug)]
pub struct ArmOnBus {
    pub bus: BusSpec,
    pub robot: RobotModel,
    /// Control period, µs.
    pub period_us: u32,
    /// Every frame is recorded to this path with `.log`, and with `.mcap`.
    pub record: Option<PathBuf>,
}

impl ArmOnBus {
    /// The bus is in lock step with others.
    #[must_use]
    pub const fn is_in_step(&self) -> bool {
        matches!(self.bus, BusSpec::Lockstep { .. })
    }

    /// Settings of its controller.
    ///
    /// # Errors
    /// The robot has none, or not with this period.
    pub fn settings(&self) -> Result<Settings, WireError> {
        let mut settings = settings_of(&self.robot)?;
        let request = PeriodRequest::Period(self.period_us);
        apply(&choose(request, None, &self.robot, settings.cycle_period_us)?, &mut settings);
        Ok(settings)
    }

    /// Opens the bus and starts the controller; the arm is homed, if it was not, and stands.
    pub fn connect(&self, settings: &Settings) -> Result<ControllerArm, WireError> {
        let robot_source = self.robot.name().to_owned();
        let cell = Cell { robot_source, robot: self.robot.clone(), seed: 1, setup: SimSetup::default() };
        let args = BusArgs {
            bus: self.bus.clone(),
            cell: CellArgs::default(),
            record: self.record.clone(),
            ..BusArgs::default()
        };
        Ok(ControllerArm::connect(args.open_cell(&cell, Some(settings))?, settings)?)
    }
}

/// Does `work`, which takes long, while the session goes on. In lock step, and in virtual time, no time passes meanwhile.
///
/// # Errors
/// The bus is gone, somebody has stopped the arm, or this program is to end.
pub fn meanwhile<R: Send>(
    session: &mut Session,
    in_step: bool,
    work: impl FnOnce() -> R + Send,
) -> Result<R, OperatorError> {
    if in_step || session.is_simulated() {
        return Ok(work());
    }
    std::thread::scope(|scope| {
        let thread = scope.spawn(work);
        while !thread.is_finished() {
            idle(session)?;
        }
        Ok(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

/// Lets a little time pass.
pub fn idle(session: &mut Session) -> Result<(), OperatorError> {
    session.pass(LOOK)?;
    session.heed_stops()?;
    if session.is_interrupted() { Err(OperatorError::Interrupted) } else { Ok(()) }
}

/// The tracker's data.
pub struct Eyes {
    address: String,
    source: Source,
    buffer: Vec<u8>,
}

enum Source {
    Socket(UdpSocket),
    /// In lock step; connected from the first question on.
    InStep(Option<Follower>),
}

impl Eyes {
    /// `address` is one of this machine, to which the tracker sends; in lock step where the cell has its data.
    ///
    /// # Errors
    /// [`WireError::Tracker`].
    pub fn open(address: &str, in_step: bool) -> Result<Self, WireError> {
        let open = || {
            let socket = UdpSocket::bind(address)?;
            socket.set_nonblocking(true)?;
            Ok(Source::Socket(socket))
        };
        let source = if in_step { Ok(Source::InStep(None)) } else { open() };
        let address = address.to_owned();
        match source {
            Ok(source) => Ok(Self { address, source, buffer: vec![0; DATAGRAM_MAX] }),
            Err(error) => Err(WireError::Tracker { address, error }),
        }
    }

    /// Where they are.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The next datagram that is there at `now`.
    ///
    /// # Errors
    /// [`WireError::Tracker`]: in lock step the cell is gone.
    pub fn next(&mut self, now: Instant) -> Result<Option<&[u8]>, WireError> {
        let follower = match &mut self.source {
            Source::Socket(socket) => {
                let length = socket.recv(&mut self.buffer).ok();
                return Ok(length.and_then(|length| self.buffer.get(..length)));
            }
            Source::InStep(follower) => follower,
        };
        let address = &self.address;
        let mut ask = || {
            if follower.is_none() {
                *follower = Some(Follower::connect(address, now)?);
            }
            follower.as_mut().map_or(Ok(None), |follower| follower.next(now))
        };
        let bytes = ask().map_err(|error| WireError::Tracker { address: address.clone(), error })?;
        Ok(bytes.map(|bytes| {
            self.buffer = bytes;
            self.buffer.as_slice()
        }))
    }

    /// Leaves out what has come by `now`.
    pub fn skip(&mut self, now: Instant) -> Result<(), WireError> {
        while self.next(now)?.is_some() {}
        Ok(())
    }
}
