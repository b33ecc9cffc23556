//! The operator of a robot that is led: the controller is in this program, between the telegrams of the robot.
//!
//! The robot waits for no computation: while a function of this operator waits, telegrams are answered, and between
//! two calls of them at most one is due. So the way to the start of a motion begins where the robot's program
//! begins ([`Operator::foreseen_pose`]), and is planned before the robot is there. If the robot stands elsewhere,
//! the controller refuses.
//!
//! A throw ends with the robot's program; between other motions the robot is held, and the owner of the operator releases it.
//!
//! "Armed" is a robot that stands where the motion begins, ready to be led. The station gives its controller the
//! remaining orders with the next telegrams, so that a motion begins with a cycle.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use firmware::fault::Refusal;
use hil_sim::krc::KrcScenario;
use planner::motion::Motion;
use planner::plan::Joints;
use planner::throw::Arm;
use protocol::cyphal::bits::Encode;
use protocol::cyphal::cubecell::command::Trajectory;
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::cubecell::target;
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant};

use super::cell::{AFTER, Seen, SimulatedRobot};
use super::cycles::{cycles, last_outputs};
use super::live::{Exchange, Live, Port};
use super::log::Line;
use super::program::{passes, start_of};
use super::station::{Stage, Station};
use crate::dialogue::online::{EndStates, message_of};
use crate::dialogue::operator::{OperatorError, name_of, refused};
use crate::dialogue::presence::PRESENCE;
use crate::dialogue::registers::Numbers;
use crate::port::{BallSeen, Interactive, Operator};
use crate::samples::Samples;
use crate::samples::drives::Drives;
use crate::samples::of_controller::Kept;
use crate::servo::LEAD;
use crate::trajectory::Encoded;

/// Lines of an exchange that are kept; the oldest go first. A throw takes 6 000.
const LINES_MAX: usize = 100_000;
/// Longest time until a run that was ordered to begin at once shows.
const BEGIN_MAX: Duration = Duration::from_secs(1);
/// Time between two checks of work that runs beside the exchange.
const MEANWHILE: Duration = Duration::from_millis(2);
/// Longest wait for an arm that was ordered to stop.
const STOPPING: Duration = Duration::from_secs(3);

/// Where the robot is.
pub enum Place {
    /// Inside this program, in virtual time.
    Inside(Box<SimulatedRobot>),
    /// Behind a socket.
    Outside(Box<Live<Port>>),
}

/// Data that only a robot that is led has.
#[derive(Clone, Debug, Default)]
pub struct Led {
    /// When the last motion began.
    pub started_at: Option<Instant>,
    /// How much later than expected the axes passed the path, s.
    pub path_delay_s: f64,
    /// How far the axes were from their path at a release that was not given for that, rad.
    pub release_withheld_rad: Option<f64>,
    pub answers: u64,
    /// What the simulated robot did.
    pub seen: Option<Seen>,
    /// How the exchange with a robot outside went.
    pub exchange: Option<Exchange>,
}

/// Gets what goes in and out of a station.
pub type KeepLines<'a> = Box<dyn FnMut(&[Line]) + 'a>;

/// A robot that is led along the motions of a job.
pub struct LedRobot<'a> {
    station: Station,
    place: Option<Place>,
    described: KrcScenario,
    stop: Arc<AtomicBool>,
    log: KeepLines<'a>,
    lines: Vec<Line>,
    /// What the controller would have reported by now, and when.
    reported: (Instant, GroupState),
    started_at: Option<Instant>,
    kept: Option<Kept>,
    /// Why the controller refused end states, since the last check.
    refused: Vec<Refusal>,
    led: Led,
}

impl<'a> LedRobot<'a> {
    /// Leads the robot that `described` describes with a station for it that has no motions yet. `log` gets the
    /// input and the output; `stop`, once it is set, ends the work in progress.
    pub fn new(
        described: KrcScenario,
        station: Station,
        place: Place,
        stop: Arc<AtomicBool>,
        log: KeepLines<'a>,
    ) -> Self {
        Self {
            station,
            place: Some(place),
            described,
            stop,
            log,
            lines: Vec::new(),
            reported: (Instant::ZERO, GroupState::default()),
            started_at: None,
            kept: None,
            refused: Vec::new(),
            led: Led::default(),
        }
    }

    #[must_use]
    pub const fn station(&self) -> &Station {
        &self.station
    }

    /// Input and output, as far as they are kept.
    #[must_use]
    pub fn lines(&self) -> &[Line] {
        &self.lines
    }

    fn keep(&mut self, lines: Vec<Line>) {
        (self.log)(&lines);
        self.lines.extend(lines);
        // In large pieces: each costs a move of all.
        if self.lines.len() > 2 * LINES_MAX {
            self.lines.drain(..self.lines.len() - LINES_MAX);
        }
    }

    /// One telegram or deadline, or time alone.
    fn step(&mut self, until: Instant) -> Result<(), OperatorError> {
        let stepped = match &mut self.place {
            Some(Place::Inside(robot)) => {
                robot.step(&mut self.station, until);
                Ok(())
            }
            Some(Place::Outside(live)) => live.step(&mut self.station),
            None => Ok(()),
        };
        let lines = self.station.take_log();
        self.keep(lines);
        let now = self.now();
        let reported = self.station.report(now, &self.reported.1);
        if let Some(state) = reported {
            self.reported = (now, state);
        }
        if let Some(kept) = &mut self.kept {
            let controller = self.station.controller();
            kept.collect(now, controller, reported.is_some());
            if let Some(state) = &reported {
                kept.hear(now, controller, state);
            }
        }
        stepped.map_err(OperatorError::Socket)
    }

    /// Why the robot stopped by itself, where that is known.
    fn by_itself(&self) -> Option<String> {
        match &self.place {
            Some(Place::Inside(robot)) => robot.fault().map(|fault| fault.to_string()),
            _ => None,
        }
    }

    /// The exchange was ended by another party, the robot or its controller.
    fn require_led(&self) -> Result<(), OperatorError> {
        self.station.failure(self.by_itself()).map_or(Ok(()), Err)
    }

    /// Steps until `done`, a stop, or an interruption, upon which the arm is stopped first.
    fn wait(
        &mut self,
        limit: Option<Duration>,
        done: &mut dyn FnMut(&Self) -> bool,
    ) -> Result<(), OperatorError> {
        let until = limit.map(|limit| self.now() + limit);
        loop {
            self.require_led()?;
            if done(self) {
                return Ok(());
            }
            if self.stop.load(Ordering::Relaxed) {
                self.stop()?;
                return Err(OperatorError::Interrupted);
            }
            if let Some(mut heard) = self.station.waits_in_vain(self.now()) {
                let by_itself = self.by_itself();
                heard += &by_itself
                    .map_or_else(String::new, |why| format!("; the robot stopped by itself: {why}"));
                return Err(OperatorError::RobotNotReady { heard });
            }
            if let (Some(until), Some(limit)) = (until, limit)
                && self.now() >= until
            {
                self.stop()?;
                return Err(OperatorError::NoProgress { state: self.station.state(), limit });
            }
            self.step(until.unwrap_or(self.now() + PRESENCE))?;
        }
    }
}

impl Operator for LedRobot<'_> {
    fn now(&self) -> Instant {
        match &self.place {
            Some(Place::Inside(robot)) => robot.now(),
            Some(Place::Outside(live)) => live.now(),
            None => self.reported.0,
        }
    }

    fn connect(&mut self) -> Result<Option<NodeId>, OperatorError> {
        Ok(None)
    }

    fn heed_stops(&mut self) -> Result<(), OperatorError> {
        self.require_led()
    }

    fn pass(&mut self, span: Duration) -> Result<(), OperatorError> {
        let until = self.now() + span;
        while self.now() < until {
            if self.place.is_none() {
                return Ok(());
            }
            self.step(until)?;
            // Time stands while no robot is connected; a robot that connects is answered.
            if matches!(&self.place, Some(Place::Outside(live)) if live.is_silent()) {
                return Ok(());
            }
        }
        Ok(())
    }

    fn group(&mut self) -> GroupState {
        self.reported.1
    }

    /// Waits without limit until the robot's program runs, and ten seconds more until it is ready: `limit` is not used.
    fn wait_for(&mut self, _: Duration, wanted: &dyn Fn(State) -> bool) -> Result<(), OperatorError> {
        self.wait(None, &mut |this| this.station.measured_rad().is_some() && wanted(this.station.state()))
    }

    fn foreseen_pose(&self) -> Option<Joints> {
        let measured = self.station.measured_rad().map(|q_rad| Joints::from_slice(&q_rad));
        Some(measured.unwrap_or_else(|| start_of(&self.described)))
    }

    fn meanwhile(&mut self, work: &mut (dyn FnMut() + Send)) -> Result<(), OperatorError> {
        if !matches!(self.place, Some(Place::Outside(_))) {
            work();
            return Ok(());
        }
        std::thread::scope(|scope| {
            let worker = scope.spawn(work);
            while !worker.is_finished() {
                self.step(self.now() + MEANWHILE)?;
            }
            Ok(())
        })
    }

    fn require_passed(&self, motion: &Motion) -> Result<(), OperatorError> {
        passes(&self.described, motion)
            .map_err(|why| OperatorError::NotPassed { what: why.to_string(), next: why.next() })
    }

    fn pose(&mut self) -> Result<Vec<f64>, OperatorError> {
        self.station.measured_rad().ok_or(OperatorError::Lost)
    }

    fn register(&mut self, name: &str) -> Result<Numbers, OperatorError> {
        self.station.register(name).ok_or_else(|| OperatorError::NoRegister { name: name.to_owned() })
    }

    fn set_register(&mut self, name: &str, wanted: &Numbers) -> Result<(), OperatorError> {
        let found = self.register(name)?.to_string();
        let (name, wanted) = (name.to_owned(), wanted.to_string());
        // The settings follow from plan and description, and a recording is run again with them.
        if found == wanted { Ok(()) } else { Err(OperatorError::RegisterRefused { name, wanted, found }) }
    }

    fn set_gripper(&mut self, open: bool) -> Result<(), OperatorError> {
        let now = self.now();
        self.station.set_gripper(now, open).map_err(|refusal| refused("the gripper", refusal))
    }

    fn home(&mut self, _: u8, limit: Duration) -> Result<(), OperatorError> {
        Err(OperatorError::NoProgress { state: self.station.state(), limit })
    }

    fn upload(
        &mut self,
        plan: &Encoded,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Trajectory, OperatorError> {
        self.require_led()?;
        let (now, name) = (self.now(), name_of(&plan.file)?);
        self.started_at = None;
        self.station.hold(now);
        self.station.push(now, plan.clone());
        progress(plan.file.len(), plan.file.len());
        Ok(name)
    }

    fn arm(&mut self, _: &Trajectory) -> Result<(), OperatorError> {
        self.wait(None, &mut |this| this.station.is_held())
    }

    fn run(
        &mut self,
        _: &Trajectory,
        _: Option<Instant>,
        limit: Duration,
        progress: &mut dyn FnMut(Instant, &GroupState),
    ) -> Result<(), OperatorError> {
        let now = self.now();
        self.station.proceed_from_hold(now);
        self.started_at = None;
        let (mut last, mut started_at) = (None, None);
        let ended = self.wait(Some(limit), &mut |this| {
            let (at, state) = this.reported;
            if last.replace(state.sequence) != Some(state.sequence) {
                progress(at, &state);
            }
            if let Stage::Running { starts_at } = *this.station.stage() {
                started_at = Some(starts_at);
            }
            matches!(this.station.stage(), Stage::Finished { .. })
        });
        self.started_at = started_at;
        ended
    }

    fn stop(&mut self) -> Result<(), OperatorError> {
        let now = self.now();
        let moves = matches!(self.station.stage(), Stage::Running { .. });
        self.station.stop(now);
        while moves && !self.station.stage().is_end() && self.now() < now + STOPPING {
            self.step(now + STOPPING)?;
        }
        Ok(())
    }

    /// The lines of the whole exchange are kept anyway: those before a motion show where its set points begin.
    fn keep_samples(&mut self) {
        self.kept = Some(Kept::new(self.station.controller()));
    }

    fn take_samples(&mut self, _: &Arm, _: Option<Drives>) -> Option<Samples> {
        let krc = &self.described.options;
        let cycles =
            cycles(&self.lines, &self.described.config, &krc.outputs_name, krc.sensor_name.as_deref());
        let last_outputs = last_outputs(&self.lines, &krc.outputs_name);
        let samples = self.kept.take().map(|kept| kept.samples).unwrap_or_default();
        Some(Samples { cycles, last_outputs, begun: self.started_at, ..samples })
    }

    fn ball(&mut self) -> Option<BallSeen> {
        match &self.place {
            Some(Place::Inside(robot)) => Some(robot.ball()),
            _ => None,
        }
    }

    fn leave(&mut self) {
        let Some(place) = self.place.take() else { return };
        let mut kept = Vec::new();
        match place {
            Place::Inside(mut robot) => {
                let until = robot.now() + AFTER;
                while robot.now() < until {
                    robot.step(&mut self.station, until);
                }
                kept.extend(self.station.take_log());
                self.reported.0 = until;
                self.led.seen = Some(robot.into_seen());
            }
            Place::Outside(mut live) => {
                // A failure of the socket now does not change what was done before.
                let _ = live.leave(&mut self.station, &mut |lines| kept.extend(lines));
                self.reported.0 = live.now();
                self.led.exchange = Some(live.exchange().clone());
            }
        }
        self.keep(kept);
    }

    fn led(&mut self) -> Option<Led> {
        Some(Led {
            started_at: self.started_at,
            path_delay_s: self.station.path_delay_s(),
            release_withheld_rad: self.station.release_withheld_rad(),
            answers: self.station.counts().answers,
            ..self.led.clone()
        })
    }
}

impl Interactive for LedRobot<'_> {
    /// The controller changes the motion two cycles and the dead time of the axes after an end state has come.
    fn lead(&self) -> Duration {
        self.station.controller().committed() + LEAD
    }

    fn start(&mut self, _: &Trajectory) -> Result<(), OperatorError> {
        let now = self.now();
        self.station.proceed_from_hold(now);
        self.wait(Some(BEGIN_MAX), &mut |this| this.station.state() == State::Running)
    }

    fn clock_offset_us(&mut self, _: Instant) -> Option<f64> {
        Some(0.0)
    }

    fn send_target(&mut self, sequence: u8, end: &EndStates) -> Result<(), OperatorError> {
        let (now, mut bytes) = (self.now(), [0; target::EXTENT as usize]);
        let length = message_of(sequence, end)?.to_bytes(&mut bytes).unwrap_or(0);
        self.refused.extend(self.station.retarget(now, &bytes[..length]).err());
        Ok(())
    }

    fn refused_targets(&mut self) -> Vec<Refusal> {
        std::mem::take(&mut self.refused)
    }

    fn run_until(&mut self, until: Instant) -> Result<bool, OperatorError> {
        while self.now() < until {
            self.require_led()?;
            if self.is_interrupted() {
                return Ok(true);
            }
            self.step(until)?;
        }
        Ok(false)
    }

    fn is_interrupted(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn needs_times(&self) -> bool {
        matches!(self.place, Some(Place::Inside(_)))
    }

    /// The robot's program has ended with the fault, and begins where it began before.
    fn clear_fault(&mut self) -> Result<(), OperatorError> {
        self.require_led()
    }

    fn heed_stops_from_now(&mut self) {}
}
