//! A throw and its catch over the wire: two buses with a controller each, and a tracker, in real time or in one lock step.
//!
//! ```text
//! thrower's thread:  session ── bus 1 ── controller: goes to the start, stores the throw, runs it at the time agreed on
//! catcher:           session ── bus 2 ── controller: waits, takes end states
//!                    socket  ── datagrams of the tracker ──► forecast ──► decision ──► end state
//! ```
//!
//! What this side reports comes from tracker and controllers alone. Whoever serves drives and ball knows what really happened.
//!
//! # Times
//!
//! Time zero is that of the catcher's run, on the monotonic clock of this machine. Each controller's clock is related to it by readings
//! with bounds ([`operator::dialogue::clock`]), before the throw and once more after it. The tracker's clock is related to it by the least
//! late datagram ([`MarkerStream`]).
//!
//! In lock step both buses and the tracker's data have one virtual time ([`hil_sim::court::in_step`]). The court gives turns to the
//! clients of one bus and then to those of the other, so the two threads of this side never have a turn at once.

use host::error::Cause;
use std::net::UdpSocket;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::{Duration as WallSpan, Instant as WallTime};

use can_link::BusSpec;
use firmware::settings::Settings;
use hil_sim::court::in_step::Follower;
use hil_sim::rng::Rng;
use operator::ball_catch::executor::{Executor, Refused};
use operator::ball_catch::reported::{CatchOutcome, report};
use operator::ball_catch::thrower::{Scatter, Thrower};
use operator::ball_catch::trial::{Pair, TrialOptions};
use operator::bus::args::{Cell, CellArgs};
use operator::bus::period::{NoPeriod, PeriodRequest, apply, choose};
use operator::bus::settings::{NoSettings, settings_of};
use operator::bus::sim::SimSetup;
use operator::bus::{BusArgs, BusFailure, Session};
use operator::dialogue::operator::OperatorError;
use operator::flight_estimator::MarkerStream;
use operator::interrupt::interrupt;
use operator::trajectory::{TrajectoryError, encode};
use planner::catch::draw::Aimed;
use planner::motion::Motion;
use protocol::{Duration, Instant};
use robot_model::RobotModel;

use super::on_controller::{ControllerArm, NoArm};

/// Time between the order to throw and the throw, s. A catcher that knows the throw plans in this time.
const AHEAD_S: f64 = 2.0;
/// Before that the client listens to the tracker for this long, s, and needs at least this many frames.
const SETTLE_S: f64 = 1.0;
const SETTLED_FRAMES: usize = 10;
/// The catcher watches for this long after the last motion and the planned end of the flight, s.
const AFTER_S: f64 = 1.2;
/// Longest turn of the catcher between two looks at the tracker.
const TURN_S: f64 = 0.5e-3;
/// Longest trial after the agreement, s; shorter than the run that takes end states.
const TRIAL_MAX_S: f64 = 12.0;
/// Longest time until both arms are ready: homing takes most of it.
const READY_MAX: Duration = Duration::from_secs(180);
const RUN_MAX: Duration = Duration::from_secs(20);
/// A message on a bus that the drives share, a decision, and the lag of the drives, s; two control periods come on top.
const ACTUATION_S: f64 = 0.016;
/// Largest datagram, bytes.
const DATAGRAM_MAX: usize = 32_768;

#[derive(Clone, Debug)]
pub struct WireOptions {
    pub thrower: BusSpec,
    pub catcher: BusSpec,
    /// Address of this machine to which the tracker sends; in lock step where the court has its data.
    pub tracker: String,
    pub robot: String,
    pub period_us: u32,
}

impl WireOptions {
    /// Buses and tracker have one virtual time.
    pub const fn is_in_step(&self) -> bool {
        matches!(self.catcher, BusSpec::Lockstep { .. })
    }
}

/// Why there was no trial, or why it ended before its time.
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
    Operator(#[from] OperatorError),
    #[error("{arm}: {why}")]
    Arm { arm: &'static str, why: Box<NoArm> },
    #[error("{address}: {error}")]
    Tracker { address: String, error: std::io::Error },
    #[error("{address}: no frame of the tracker came")]
    Silent { address: String },
    #[error("the thrower did not get ready")]
    NotReady,
}

impl Cause for WireError {
    fn next(&self) -> Option<String> {
        Some(match self {
            Self::Tracker { .. } => {
                "name an address of this machine and a free port, where the tracker sends its data".to_owned()
            }
            Self::Silent { .. } => {
                "start the tracker and let it send to this address; nothing was thrown".to_owned()
            }
            Self::NotReady => "look at its bus with `cubectl status --bus SPEC`".to_owned(),
            Self::Arm { why, .. } => return why.next(),
            Self::Settings(error) => return error.next(),
            Self::Period(error) => return error.next(),
            Self::Trajectory(error) => return error.next(),
            Self::Bus(error) => return error.next(),
            Self::Operator(error) => return error.next(),
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clocks {
    /// Clock of this machine minus the tracker's, s; by the least late of so many datagrams.
    pub tracker_offset_s: f64,
    pub datagrams: usize,
    /// By how much the controllers' clocks were known at the start: thrower, catcher, s.
    pub controllers_off_s: [f64; 2],
    /// The catcher's clock had not jumped when it was read again at the end; `None`: it was not readable.
    pub catcher_held: Option<bool>,
}

/// What this side knows of a throw and its catch.
#[derive(Debug)]
pub struct WireOutcome {
    pub reported: CatchOutcome,
    /// How the thrower's run ended, by its controller.
    pub thrown: Result<(), OperatorError>,
    pub clocks: Clocks,
    /// End states that the catcher's controller took and refused.
    pub answered: (usize, usize),
    pub refusals: Vec<Refused>,
    /// Decisions: how many, and the longest, s.
    pub decisions: usize,
    pub longest_decision_s: f64,
    /// Largest age of a datagram when it was read, beside the tracker's latency, s.
    pub latest_datagram_s: f64,
    /// The catch that was tried: time after the planned release (s) and predicted probability.
    pub choice: Option<(f64, f64)>,
}

/// Throws once and catches.
///
/// # Errors
/// [`WireError`]: before the throw nothing has been thrown; the session that ends halts what moves.
pub fn run(
    pair: &Pair,
    aimed: &Aimed,
    options: &TrialOptions,
    wire: &WireOptions,
) -> Result<WireOutcome, WireError> {
    let (cell, settings) = cell_of(wire)?;
    let throw =
        encode(&Motion::from(&aimed.throw), settings.cycle_period_us, settings.robot_crc32, Some(&settings))?;
    let eyes = Eyes::open(wire)?;
    let (ready, is_ready) = mpsc::channel();
    let (go, goes) = mpsc::channel();
    std::thread::scope(|scope| {
        let (cell, settings) = (&cell, &settings);
        let (spec, start) = (&wire.thrower, aimed.throw.start());
        let thread = scope.spawn(move || {
            let session = open(spec, cell, settings)?;
            let arm = ControllerArm::at(session, settings, &start);
            let mut arm = arm.map_err(|why| WireError::Arm { arm: "thrower", why: Box::new(why) })?;
            let thrown = throw_when_agreed(&mut arm, &throw, &ready, &goes);
            if let Err(WireError::Operator(why)) | Ok((Err(why), _)) = &thrown {
                end_both(why);
            }
            thrown
        });
        let caught = catch(pair, aimed, options, wire, (cell, settings), eyes, &is_ready, &go);
        if let Err(WireError::Operator(why)) = &caught {
            end_both(why);
        }
        // Without it the thrower waits no longer.
        drop(go);
        let thrown = thread.join().unwrap_or(Err(WireError::NotReady));
        // The thrower's own words say more than that it did not get ready.
        let mut outcome = match (caught, thrown) {
            (Err(WireError::NotReady | WireError::Operator(OperatorError::Interrupted)), Err(why)) => {
                return Err(why);
            }
            // The thrower was stopped, and the catcher ended because of it.
            (Err(WireError::Operator(OperatorError::Interrupted)), Ok((Err(why), _))) => {
                return Err(why.into());
            }
            (Err(why), _) | (Ok(_), Err(why)) => return Err(why),
            (Ok(outcome), Ok((thrown, off_s))) => WireOutcome { thrown, ..outcome }.with_thrower_off(off_s),
        };
        outcome.refusals.truncate(20);
        Ok(outcome)
    })
}

/// A stop of one arm by somebody else ends the session of the other one too, as Ctrl-C does.
fn end_both(why: &OperatorError) {
    if why.is_stop_by_other() {
        interrupt().store(true, Ordering::Relaxed);
    }
}

impl WireOutcome {
    const fn with_thrower_off(mut self, off_s: f64) -> Self {
        self.clocks.controllers_off_s[0] = off_s;
        self
    }
}

fn cell_of(wire: &WireOptions) -> Result<(Cell, Settings), WireError> {
    let robot = RobotModel::load(&wire.robot).map_err(BusFailure::from)?;
    let mut settings = settings_of(&robot)?;
    let choice = choose(PeriodRequest::Period(wire.period_us), None, &robot, settings.cycle_period_us)?;
    apply(&choice, &mut settings);
    let cell = Cell { robot_source: wire.robot.clone(), robot, seed: 1, setup: SimSetup::default() };
    Ok((cell, settings))
}

fn open(spec: &BusSpec, cell: &Cell, settings: &Settings) -> Result<Session, WireError> {
    let args = BusArgs { bus: spec.clone(), cell: CellArgs::default(), ..BusArgs::default() };
    Ok(args.open_cell(cell, Some(settings))?)
}

#[derive(Clone, Copy)]
enum Begin {
    /// By the clock of this machine.
    Clock(WallTime),
    /// In the time of all sessions in lock step.
    InStep(Instant),
}

enum Eyes {
    Socket(UdpSocket),
    /// In lock step: where they are, and the connection from the first question on.
    InStep(String, Option<Follower>),
}

impl Eyes {
    fn open(wire: &WireOptions) -> Result<Self, WireError> {
        if wire.is_in_step() {
            return Ok(Self::InStep(wire.tracker.clone(), None));
        }
        let open = || {
            let socket = UdpSocket::bind(&wire.tracker)?;
            socket.set_nonblocking(true)?;
            Ok(Self::Socket(socket))
        };
        open().map_err(|error| WireError::Tracker { address: wire.tracker.clone(), error })
    }

    /// The next datagram that is there at `now`, in a buffer of [`DATAGRAM_MAX`] bytes.
    fn next<'a>(&mut self, now: Instant, buffer: &'a mut [u8]) -> Result<Option<&'a [u8]>, WireError> {
        let (address, follower) = match self {
            Self::Socket(socket) => {
                return Ok(socket.recv(buffer).ok().and_then(|length| buffer.get(..length)));
            }
            Self::InStep(address, follower) => (address, follower),
        };
        let mut ask = || {
            if follower.is_none() {
                *follower = Some(Follower::connect(address, now)?);
            }
            follower.as_mut().map_or(Ok(None), |follower| follower.next(now))
        };
        let bytes = ask().map_err(|error| WireError::Tracker { address: address.clone(), error })?;
        Ok(bytes.and_then(|bytes| {
            let place = buffer.get_mut(..bytes.len())?;
            place.copy_from_slice(&bytes);
            Some(&*place)
        }))
    }
}

type Thrown = (Result<(), OperatorError>, f64);

/// Keeps the session alive until the time of the throw, then runs it. Returns how the run ended, and the bound of the error of
/// the controller's clock, s.
fn throw_when_agreed(
    arm: &mut ControllerArm,
    file: &[u8],
    ready: &Sender<()>,
    goes: &Receiver<Begin>,
) -> Result<Thrown, WireError> {
    let (session, node, clock) = arm.parts();
    let name = session.upload(node, file, &mut |_, _| {})?;
    let _ = ready.send(());
    let begin = loop {
        session.pass(Duration::from_millis(5))?;
        session.heed_stops().map_err(OperatorError::from)?;
        if session.is_interrupted() {
            return Err(OperatorError::Interrupted.into());
        }
        match goes.try_recv() {
            Ok(begin) => break begin,
            Err(mpsc::TryRecvError::Empty) => {}
            // The catcher has given up.
            Err(mpsc::TryRecvError::Disconnected) => return Err(WireError::NotReady),
        }
    };
    session.arm(node, &name)?;
    session.read_clock(node, clock)?;
    let ours = match begin {
        Begin::InStep(at) => at,
        Begin::Clock(at) => {
            let ahead = at.saturating_duration_since(WallTime::now());
            session.now() + Duration::from_secs_f64(ahead.as_secs_f64())
        }
    };
    let (start, off) = clock.controller_time(ours).ok_or(OperatorError::NoAnswer { node })?;
    let thrown = session.run_trajectory_at(node, &name, Some(start), RUN_MAX, &[], &mut |_, _| {}).map(drop);
    session.halt_if_moving()?;
    Ok((thrown, off.as_secs_f64()))
}

/// Relates the tracker's clock to that of the trial before the throw is ordered. Returns how many frames came.
fn settle(
    arm: &mut ControllerArm,
    eyes: &mut Eyes,
    buffer: &mut [u8],
) -> Result<(MarkerStream, usize), WireError> {
    let (mut stream, mut frames) = (MarkerStream::new(), 0);
    let until_s = arm.now_s() + SETTLE_S;
    while arm.now_s() < until_s {
        let session = arm.parts().0;
        if session.is_interrupted() {
            return Err(OperatorError::Interrupted.into());
        }
        session.pass(Duration::from_micros(500))?;
        session.heed_stops().map_err(OperatorError::from)?;
        while let Some(bytes) = eyes.next(arm.parts().0.now(), buffer)? {
            frames += usize::from(matches!(stream.push(bytes, arm.now_s()), Ok(Some(_))));
        }
    }
    Ok((stream, frames))
}

#[expect(clippy::too_many_arguments, reason = "both ends of a channel, and what a trial is made of")]
fn catch(
    pair: &Pair,
    aimed: &Aimed,
    options: &TrialOptions,
    wire: &WireOptions,
    (cell, settings): (&Cell, &Settings),
    mut eyes: Eyes,
    ready: &Receiver<()>,
    go: &Sender<Begin>,
) -> Result<WireOutcome, WireError> {
    let of_catcher = |why| WireError::Arm { arm: "catcher", why: Box::new(why) };
    let session = open(&wire.catcher, cell, settings)?;
    let mut arm = ControllerArm::at(session, settings, &options.wait).map_err(of_catcher)?;
    let patience = arm.parts().0.now() + READY_MAX;
    while let Err(none) = ready.try_recv() {
        arm.parts().0.pass(Duration::from_millis(5))?;
        arm.parts().0.heed_stops().map_err(OperatorError::from)?;
        if none == mpsc::TryRecvError::Disconnected || arm.parts().0.now() > patience {
            return Err(WireError::NotReady);
        }
    }
    arm.begin().map_err(of_catcher)?;
    let mut buffer = vec![0; DATAGRAM_MAX];
    let (stream, settled) = settle(&mut arm, &mut eyes, &mut buffer)?;
    if settled < SETTLED_FRAMES {
        arm.parts().0.halt_if_moving()?;
        return Err(WireError::Silent { address: wire.tracker.clone() });
    }
    let mut options = options.clone();
    options.settings.actuation_s = ACTUATION_S + 2e-6 * f64::from(settings.cycle_period_us);
    let start_s = arm.now_s() + AHEAD_S;
    let begin = if wire.is_in_step() {
        Begin::InStep(arm.parts().0.now() + Duration::from_secs_f64(AHEAD_S))
    } else {
        Begin::Clock(WallTime::now() + WallSpan::from_secs_f64(AHEAD_S))
    };
    // The plan, without scatter: what comes of it is the business of the arm.
    let nothing = Scatter { delay_s: 0.0, share: 0.0 };
    let model = &pair.court.arms[0].model;
    let planned = Thrower::new(model, aimed, start_s, &nothing, None, &mut Rng::stream(0, "none"));
    let catcher = pair.catcher_for(aimed, &options);
    let mut run = pair.new_run(&catcher, &planned, aimed, &options);
    run.stream = stream;
    let _ = go.send(begin);
    let release_s = planned.planned_release_s();
    let mut longest_s = 0.0_f64;
    let mut timed = |decide: &mut dyn FnMut()| {
        let begun = WallTime::now();
        decide();
        longest_s = longest_s.max(begun.elapsed().as_secs_f64());
    };
    let latency_s = pair.court.tracker.latency.as_secs_f64();
    let (mut datagrams, mut latest_s) = (settled, 0.0_f64);
    let (mut until_s, mut is_planned) = (release_s + aimed.flight_s + AFTER_S, false);
    let mut joints = arm.advance(arm.now_s());
    while arm.now_s() < until_s.min(start_s + TRIAL_MAX_S) {
        let now_s = arm.now_s();
        joints = arm.advance(now_s + TURN_S);
        // A fault of the catcher is an outcome; a stop by somebody else ends both arms.
        if let Err(why) = arm.parts().0.heed_stops().map_err(OperatorError::from)
            && why.is_stop_by_other()
        {
            arm.parts().0.halt_if_moving()?;
            return Err(why.into());
        }
        if arm.parts().0.is_interrupted() {
            arm.parts().0.halt_if_moving()?;
            return Err(OperatorError::Interrupted.into());
        }
        while let Some(why) = arm.refused() {
            run.refusals.push(why);
            run.catcher.refused();
        }
        if now_s > start_s - 0.5 * AHEAD_S && !is_planned {
            if options.cooperative {
                run.decide(&mut arm, now_s, &mut timed);
            }
            is_planned = true;
        }
        while let Some(bytes) = eyes.next(arm.parts().0.now(), &mut buffer)? {
            let now_s = arm.now_s();
            let Ok(Some(frame)) = run.stream.push(bytes, now_s) else { continue };
            datagrams += 1;
            if now_s > release_s {
                latest_s = latest_s.max(frame.age_s - latency_s);
            }
            run.seen.extend(frame.markers.iter().map(|(_, p)| (frame.t_s, *p)));
            if run.watch.observe(&frame) {
                run.decide(&mut arm, now_s, &mut timed);
            }
        }
        until_s = until_s.max(run.catcher.motion().end_s() + AFTER_S);
    }
    let reported = report(&run.catcher, &run.watch, &run.seen, arm.halted(), &joints, arm.now_s());
    let answered = arm.answered;
    let (session, node, clock) = arm.parts();
    let off_s = clock.controller_time(session.now()).map_or(f64::NAN, |(_, off)| off.as_secs_f64());
    let catcher_held = match session.read_clock(node, clock) {
        Ok(()) => Some(true),
        Err(OperatorError::ClockJumped { .. }) => Some(false),
        Err(_) => None,
    };
    session.halt_if_moving()?;
    Ok(WireOutcome {
        reported,
        thrown: Ok(()),
        clocks: Clocks {
            tracker_offset_s: run.stream.offset_s().unwrap_or(f64::NAN),
            datagrams,
            controllers_off_s: [f64::NAN, off_s],
            catcher_held,
        },
        answered,
        refusals: run.refusals,
        decisions: run.catcher.log().len(),
        longest_decision_s: longest_s,
        latest_datagram_s: latest_s,
        choice: run.catcher.choice().map(|choice| (choice.t_s - release_s, choice.probability)),
    })
}
