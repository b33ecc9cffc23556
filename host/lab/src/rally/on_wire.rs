//! A rally over the wire: two buses with a controller each, and a tracker, in real time or in one lock step.
//!
//! ```text
//! thread of arm 1:  session ── bus 1 ── controller ──┐ throws, while the other one catches by what the tracker shows;
//! thread of arm 2:  session ── bus 2 ── controller ──┘ then the other way round
//!
//! catcher  stands at ─────────────►  thrower plans ── plan ──►  both go, free of contact
//! thrower  ready ─────────────────►  catcher settles ── begin ──►  throw and catch
//! both     what became of it ─────►  the catcher grips where the tracker saw the ball lie, and throws next
//! ```
//!
//! What this side reports comes from tracker and controllers alone. Whoever serves drives and ball knows what really happened.
//!
//! # Times
//!
//! Time zero of an exchange is that of the catcher's run, on the monotonic clock of this machine. Each controller's clock is related to it
//! by readings with bounds ([`operator::dialogue::clock`]), before the throw and once more after it. The tracker's clock is related to it
//! by the least late datagram ([`operator::flight_estimator::MarkerStream`]).
//!
//! In lock step both buses and the tracker's data have one virtual time ([`hil_sim::two_arms::in_step`]). The cell gives turns to the
//! clients of one bus and then to those of the other, so the two threads of this side never have a turn at once.

use std::fmt;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration as WallSpan, Instant as WallTime};

use hil_sim::rng::Rng;
use nalgebra::Vector3;
use operator::ball_catch::controller_arm::ControllerArm;
use operator::ball_catch::on_bus::{Caught, Expected, actuation_s, catch, settle};
use operator::ball_catch::reported::CatchOutcome;
use operator::ball_catch::thrower::{Scatter, Thrower};
use operator::ball_catch::trial::TrialOptions;
use operator::ball_catch::wire::{ArmOnBus, Eyes, WireError, idle, meanwhile};
use operator::dialogue::operator::OperatorError;
use operator::interrupt::interrupt;
use operator::trajectory::encode;
use planner::catch::Joints;
use planner::motion::Motion;
use protocol::{Duration, Instant};

use super::exchange::{Exchange, Partners, Planned, RallyEnd};

/// Time between the order to throw and the throw, s. A catcher that knows the throw plans in this time.
const AHEAD_S: f64 = 2.0;
/// Longest time until the other arm is ready: homing takes most of it.
const READY_MAX: Duration = Duration::from_secs(180);
const RUN_MAX: Duration = Duration::from_secs(20);

#[derive(Clone, Debug)]
pub struct WireOptions {
    /// Arm 1, which throws first, and arm 2.
    pub arms: [ArmOnBus; 2],
    /// Address of this machine to which the tracker sends; in lock step where the cell has its data.
    pub tracker: String,
}

/// How a throw went, by its controller.
#[derive(Debug)]
pub struct Thrown {
    pub ended: Result<(), OperatorError>,
    /// By how much the controller's clock was known, s.
    pub clock_off_s: f64,
    /// Joints as the drives measured them (rad), at times of the exchange, s.
    pub joints: Vec<(f64, Joints)>,
}

/// What this side knows of a throw and its catch.
#[derive(Debug)]
pub struct WireExchange {
    /// 0 or 1.
    pub thrower: usize,
    pub planned: Planned,
    /// Where the plan has the ball in the thrower's hand, in its end-effector frame, m.
    pub gripped_e_m: Vector3<f64>,
    /// When the plan releases the ball, s.
    pub release_s: f64,
    pub thrown: Thrown,
    pub caught: Caught,
}

impl WireExchange {
    /// The tracker shows the ball at rest in the cup, and the throw ran to its end.
    #[must_use]
    pub fn known_caught(&self) -> bool {
        self.caught.reported == CatchOutcome::Caught && self.thrown.ended.is_ok()
    }
}

impl WireExchange {
    /// The exchange as the report shows it: caught is what the tracker shows, and nobody knows how the ball crossed the mouth.
    #[must_use]
    pub fn as_shown(&self) -> Exchange {
        let aimed = self.planned.aimed;
        let thrower = |t_s: f64| {
            let before = self.thrown.joints.partition_point(|(at_s, _)| *at_s <= t_s).checked_sub(1);
            before.map_or(aimed.throw.start(), |k| self.thrown.joints[k].1)
        };
        let planned_s = (self.release_s, self.release_s + aimed.flight_s);
        let outcome = self.caught.as_shown(planned_s, aimed.p_m, thrower);
        let gripped_e_m = [self.gripped_e_m; 2];
        Exchange { thrower: self.thrower, transit_s: self.planned.transit_s(), aimed, gripped_e_m, outcome }
    }
}

#[derive(Debug)]
pub struct WireRally {
    /// The exchanges, the last one caught or not. Those before an arm broke off are there, too.
    pub exchanges: Vec<WireExchange>,
    pub end: Result<RallyEnd, Broken>,
}

impl WireRally {
    #[must_use]
    pub fn length(&self) -> usize {
        self.exchanges.iter().filter(|exchange| exchange.known_caught()).count()
    }
}

/// Why a rally ended before its time.
#[derive(Debug)]
pub struct Broken {
    /// The arm that ended it, 0 or 1; `None`: the tracker could not be heard.
    pub arm: Option<usize>,
    pub why: Box<WireError>,
}

impl Broken {
    /// As the report shows it.
    #[must_use]
    pub fn as_end(&self) -> RallyEnd {
        RallyEnd::Broken { what: self.to_string(), next: self.why.next().unwrap_or_default() }
    }
}

impl fmt::Display for Broken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { arm, why } = self;
        arm.map_or(Ok(()), |arm| write!(f, "arm {}: ", arm + 1))?;
        write!(f, "{why}")
    }
}

/// Up to `throws` throws; arm 1 begins with the ball in its hand. `observe` gets the number of each throw, from 0, and what became of it.
/// If an arm breaks off, its session halts what moves.
pub fn play(
    partners: &Partners,
    throws: usize,
    options: &TrialOptions,
    wire: &WireOptions,
    seed: u64,
    mut observe: impl FnMut(usize, &WireExchange),
) -> WireRally {
    let in_step = wire.arms[1].is_in_step();
    let broken = |arm, why| Err(Broken { arm, why: Box::new(why) });
    let eyes = match Eyes::open(&wire.tracker, in_step) {
        Ok(eyes) => &Mutex::new(eyes),
        Err(why) => return WireRally { exchanges: Vec::new(), end: broken(None, why) },
    };
    let (done, exchanged) = mpsc::channel();
    let (to_second, from_first) = mpsc::channel();
    let (to_first, from_second) = mpsc::channel();
    std::thread::scope(|scope| {
        let side = |me: usize, to: Sender<Note>, from: Receiver<Note>, done: Sender<WireExchange>| {
            scope.spawn(move || {
                let links = Links { to, from, eyes, done };
                let side = Side { me, partners, options, on_bus: &wire.arms[me], in_step, seed, links };
                let ended = side.play(throws);
                if let Err(why) = &ended {
                    end_both(why);
                }
                ended
            })
        };
        let first = side(0, to_second, from_second, done.clone());
        let second = side(1, to_first, from_first, done);
        let mut exchanges = Vec::new();
        for exchange in exchanged {
            observe(exchanges.len(), &exchange);
            exchanges.push(exchange);
        }
        let ended = [first, second].map(|thread| thread.join().unwrap_or(Err(WireError::NotReady)));
        let end = match ended {
            // An arm that waited for the other one, or was stopped because of it, has less to say.
            [Err(waited), Err(why)] if is_consequence(&waited) => broken(Some(1), why),
            [Err(why), _] => broken(Some(0), why),
            [_, Err(why)] => broken(Some(1), why),
            [Ok(end), Ok(_)] => Ok(end),
        };
        WireRally { exchanges, end }
    })
}

/// A stop of one arm by somebody else ends the session of the other one too, as Ctrl-C does.
fn end_both(why: &WireError) {
    if why.operator().is_some_and(OperatorError::is_stop_by_other) {
        interrupt().store(true, Ordering::Relaxed);
    }
}

fn is_consequence(why: &WireError) -> bool {
    matches!(why, WireError::NotReady) || matches!(why.operator(), Some(OperatorError::Interrupted))
}

/// When a throw begins.
#[derive(Clone, Copy)]
struct Begin {
    /// In the time of the exchange.
    start_s: f64,
    at: BeginAt,
}

#[derive(Clone, Copy)]
enum BeginAt {
    /// By the clock of this machine.
    Clock(WallTime),
    /// In the time of all sessions in lock step.
    InStep(Instant),
}

/// The cup comes to rest, and its jaws grip the ball.
fn grip(arm: &mut ControllerArm) -> Result<(), WireError> {
    arm.end()?;
    Ok(arm.set_hand(false)?)
}

fn halt(arm: &mut ControllerArm) -> Result<(), WireError> {
    Ok(arm.parts().0.halt_if_moving()?)
}

/// What one arm's thread lets the other one know.
enum Note {
    /// The catcher stands there.
    Stands(Joints),
    Plan(Box<Result<Planned, RallyEnd>>),
    /// The thrower is ready.
    Ready,
    Begin(Begin),
    Thrown(Thrown),
    /// Where the ball was gripped in the catcher's hand; `None`: it was not caught.
    Gripped(Option<Vector3<f64>>),
}

struct Links<'a> {
    to: Sender<Note>,
    from: Receiver<Note>,
    eyes: &'a Mutex<Eyes>,
    done: Sender<WireExchange>,
}

/// An arm in its thread.
struct Side<'a> {
    me: usize,
    partners: &'a Partners,
    options: &'a TrialOptions,
    on_bus: &'a ArmOnBus,
    in_step: bool,
    seed: u64,
    links: Links<'a>,
}

impl Side<'_> {
    fn play(&self, throws: usize) -> Result<RallyEnd, WireError> {
        let settings = self.on_bus.settings()?;
        let mut arm = self.on_bus.connect(&settings)?;
        // Around the ball, or to a cup.
        arm.set_hand(false)?;
        let mut gripped_e_m = Some(self.partners.first_e_m());
        let mut end = RallyEnd::Complete;
        for k in 0..throws {
            let Some(lies_e_m) = gripped_e_m else {
                end = RallyEnd::NotCaught;
                break;
            };
            let gripped = if k % 2 == self.me {
                self.throw(&mut arm, k, lies_e_m)
            } else {
                self.catch(&mut arm, lies_e_m)
            };
            match gripped? {
                Ok(gripped) => gripped_e_m = gripped,
                Err(why) => {
                    end = why;
                    break;
                }
            }
        }
        if gripped_e_m.is_none() {
            end = RallyEnd::NotCaught;
        }
        arm.finish()?;
        Ok(end)
    }

    /// Plans throw number `k` and throws. Returns where the other arm has gripped the ball.
    fn throw(
        &self,
        arm: &mut ControllerArm,
        k: usize,
        gripped_e_m: Vector3<f64>,
    ) -> Result<Result<Option<Vector3<f64>>, RallyEnd>, WireError> {
        let other = self.wait(arm, |note| if let Note::Stands(q) = note { Some(q) } else { None })?;
        let here = arm.pose()?;
        let q = if self.me == 0 { [here, other] } else { [other, here] };
        let Self { partners, options, seed, .. } = *self;
        let planned =
            meanwhile(arm.parts().0, self.in_step, || partners.plan(k, &q, gripped_e_m, options, seed))?;
        self.send(Note::Plan(Box::new(planned.clone())));
        let Planned { aimed, ways, .. } = match planned {
            Ok(planned) => planned,
            Err(end) => return Ok(Err(end)),
        };
        let settings = self.on_bus.settings()?;
        let file = encode(
            &Motion::from(&aimed.throw),
            settings.cycle_period_us,
            settings.robot_crc32,
            Some(&settings),
        )?;
        if let [Some(way), _] = &ways {
            arm.go(way)?;
        }
        let (session, node, _) = arm.parts();
        let name = session.upload(node, &file, &mut |_, _| {})?;
        self.send(Note::Ready);
        let begin = self.wait(arm, |note| if let Note::Begin(begin) = note { Some(begin) } else { None })?;

        arm.keep();
        let (session, node, clock) = arm.parts();
        session.arm(node, &name)?;
        session.read_clock(node, clock)?;
        let ours = match begin.at {
            BeginAt::InStep(at) => at,
            BeginAt::Clock(at) => {
                let ahead = at.saturating_duration_since(WallTime::now());
                session.now() + Duration::from_secs_f64(ahead.as_secs_f64())
            }
        };
        let (start, off) = clock.controller_time(ours).ok_or(OperatorError::NoAnswer { node })?;
        let ran = session.run_trajectory_at(node, &name, Some(start), RUN_MAX, &[], &mut |_, _| {}).map(drop);
        let halted = session.halt_if_moving().map_err(OperatorError::from);
        // A fault from here on ends the rally, and the ball is in the air: the catcher goes on, and the exchange is reported.
        let ended = match ran.and(halted) {
            Err(why) if why.is_stop_by_other() || matches!(why, OperatorError::Interrupted) => {
                return Err(why.into());
            }
            ended => ended.and_then(|()| arm.set_hand(false)),
        };
        let since_s = begin.start_s - arm.at_s(ours);
        let joints =
            arm.kept_joints(&self.on_bus.robot).into_iter().map(|(t_s, q)| (t_s + since_s, q)).collect();
        self.send(Note::Thrown(Thrown { ended, clock_off_s: off.as_secs_f64(), joints }));
        self.wait(arm, |note| if let Note::Gripped(lies_e_m) = note { Some(lies_e_m) } else { None }).map(Ok)
    }

    /// Catches the throw that the other arm plans, and grips. Returns where.
    fn catch(
        &self,
        arm: &mut ControllerArm,
        gripped_e_m: Vector3<f64>,
    ) -> Result<Result<Option<Vector3<f64>>, RallyEnd>, WireError> {
        self.send(Note::Stands(arm.pose()?));
        let planned = self.wait(arm, |note| if let Note::Plan(plan) = note { Some(*plan) } else { None })?;
        let planned = match planned {
            Ok(planned) => planned,
            Err(end) => return Ok(Err(end)),
        };
        if let [_, Some(way)] = &planned.ways {
            arm.go(way)?;
        }
        self.wait(arm, |note| matches!(note, Note::Ready).then_some(()))?;
        arm.begin()?;
        let mut eyes = self.links.eyes.lock().unwrap_or_else(PoisonError::into_inner);
        let stream = settle(arm, &mut eyes)?;
        let start_s = arm.now_s() + AHEAD_S;
        let at = if self.in_step {
            BeginAt::InStep(arm.parts().0.now() + Duration::from_secs_f64(AHEAD_S))
        } else {
            BeginAt::Clock(WallTime::now() + WallSpan::from_secs_f64(AHEAD_S))
        };
        // The plan, without scatter: what comes of it is the business of the arm.
        let nothing = Scatter { delay_s: 0.0, share: 0.0 };
        let Planned { pair, aimed, .. } = &planned;
        let thrower = &pair.cell.arms[0].model;
        let thrower = Thrower::new(thrower, aimed, start_s, &nothing, None, &mut Rng::stream(0, "none"));
        let mut options = self.options.clone();
        options.settings.actuation_s = actuation_s(self.on_bus.period_us);
        let catcher = pair.catcher_for(aimed, &options);
        let mut run = pair.new_run(&catcher, pair.prior(&thrower, aimed, &options), &options);
        run.stream = stream;
        self.send(Note::Begin(Begin { start_s, at }));
        let release_s = thrower.planned_release_s();
        let expected = Expected::Throw {
            start_s,
            passes_s: release_s + aimed.flight_s,
            plans_s: options.cooperative.then_some(start_s - 0.5 * AHEAD_S),
        };
        let caught = catch(arm, &mut eyes, run, expected)?;
        drop(eyes);
        let gripped = caught.lies_e_m.filter(|_| caught.reported == CatchOutcome::Caught);
        // A fault from here on ends the rally, and the exchange is reported.
        let held = if gripped.is_some() { grip(arm) } else { halt(arm) };
        let thrown =
            self.wait(arm, |note| if let Note::Thrown(thrown) = note { Some(thrown) } else { None })?;
        let exchange = WireExchange { thrower: 1 - self.me, planned, gripped_e_m, release_s, thrown, caught };
        let gripped = gripped.filter(|_| exchange.known_caught());
        self.send(Note::Gripped(gripped));
        let _ = self.links.done.send(exchange);
        held.map(|()| Ok(gripped))
    }

    /// The other arm may have ended; then the next wait says so.
    fn send(&self, note: Note) {
        let _ = self.links.to.send(note);
    }

    /// Keeps the session alive until the other arm lets something be known.
    fn wait<T>(&self, arm: &mut ControllerArm, wanted: impl Fn(Note) -> Option<T>) -> Result<T, WireError> {
        let session = arm.parts().0;
        let until = session.now() + READY_MAX;
        loop {
            match self.links.from.try_recv() {
                // The threads take turns by one script.
                Ok(note) => return wanted(note).ok_or(WireError::NotReady),
                Err(mpsc::TryRecvError::Disconnected) => return Err(WireError::NotReady),
                Err(mpsc::TryRecvError::Empty) if session.now() > until => return Err(WireError::NotReady),
                Err(mpsc::TryRecvError::Empty) => idle(session)?,
            }
        }
    }
}
