//! One throw, from the run-up to the ball at rest.

use hil_sim::mechanics::LooseBall;
use hil_sim::rng::Rng;
use hil_sim::tracker::{TrackerFault, TrackerFaultKind};
use hil_sim::two_arms::{ArmPlace, BallPlace, Crossing, JointsNow, TwoArmCell, TwoArmEvent, TwoArmOptions};
use nalgebra::Vector3;
use planner::catch::Joints;
use planner::catch::arm::{CatchArm, NotACatcher, Shares};
use planner::catch::clear::CLEARS_FROM_LINK;
use planner::catch::cup::{Ball, Contact, Cup};
use planner::catch::draw::Aimed;
use planner::catch::motion::used;
use planner::catch::online::{Catcher, Logged};
use planner::catch::search::Choice;
use planner::catch::task::Settings;
use planner::throw::Throw;
use protocol::{Duration, Instant};
use robot_model::collision::Obb;

use super::executor::{Executor, LaggingArm, Order, Refused};
use super::limits::{Executed, LimitWatch};
use super::obstacles::{reach, swept, touch, within_reach};
pub use super::reported::CatchOutcome;
use super::reported::{InCup, in_cup, place_in_cup, report};
use super::thrower::{Scatter, ThrowFault, Thrower};
use crate::flight_estimator::fit::Air;
use crate::flight_estimator::{BallWatch, FlightPrior, MarkerStream, WatchOptions};

/// Step of a trial.
const STEP: Duration = Duration::from_millis(1);
/// The clocks settle before the thrower moves, s.
const SETTLE_S: f64 = 0.2;
/// A trial goes on for this long after the last motion, s.
const AFTER_S: f64 = 1.0;
/// And for this much longer as long as the ball still moves in the cup, s.
const LONGER_S: f64 = 0.2;
/// Longest trial, s.
const TRIAL_MAX_S: f64 = 8.0;
/// Samples before the first forecast without a plan.
const FIRST_SAMPLES: usize = 5;
/// Both arms are looked at for contact with each other every this many steps.
const TOUCH_EVERY: u64 = 8;
/// Places are kept for pictures every this many steps.
const TRACE_EVERY: u64 = 8;

/// What goes wrong with the catcher or its eyes; times in s after the planned release.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrialFault {
    /// The tracker's data end.
    TrackerDead { at_s: f64 },
    /// Frames are lost with this probability.
    FramesLost { probability: f64 },
    /// All positions are off by this much in each axis, mm.
    Bias { by_mm: f64 },
    /// This many false markers in each frame.
    FalseMarkers { count: u32 },
    /// One drive of the catcher is lost.
    DriveLost { at_s: f64 },
    /// The thrower's arm or fingers fail.
    Throw(ThrowFault),
}

#[derive(Debug, Clone, PartialEq)]
pub struct TrialOptions {
    /// What counts as a catch.
    pub settings: Settings,
    /// The catcher knows the thrower's plan.
    pub cooperative: bool,
    /// Without eyes: the plan alone.
    pub blind: bool,
    /// Jerk limits are kept too.
    pub jerk: bool,
    pub scatter: Scatter,
    /// Where the ball is gripped beside the place from which the throw is planned, in the thrower's end-effector frame, m.
    pub grip_off_m: Vector3<f64>,
    /// Drag that the catcher believes in, as a factor on the ball's; and its standard deviation as a share.
    pub drag: (f64, f64),
    /// Restitution of ball and cup that the catcher counts on, 0 to 1; `None` for that of the cell.
    pub restitution: Option<f64>,
    /// Where the catcher waits, rad.
    pub wait: Joints,
    pub faults: Vec<TrialFault>,
}

/// Waiting pose that reaches most matched catches at 2.5 m, deg.
pub const WAIT_MATCHED_DEG: [f64; 6] = [5.0, -48.0, -157.0, 8.0, -53.0, 0.0];
/// The same for catches with the hand at rest, deg.
pub const WAIT_HOLD_DEG: [f64; 6] = [-4.0, -40.0, -173.0, -3.0, -88.0, 0.0];

/// The thrower while it only stands there, deg.
const STANDING_DEG: [f64; 6] = [0.0, -90.0, -90.0, 0.0, 0.0, 0.0];

impl Default for TrialOptions {
    /// Both kinds of catches, eyes only, acceleration limits, 5 ms and 1 % of scatter, drag known to 10 %.
    fn default() -> Self {
        Self {
            settings: Settings::default(),
            cooperative: false,
            blind: false,
            jerk: false,
            scatter: Scatter::default(),
            grip_off_m: Vector3::zeros(),
            drag: (1.0, 0.1),
            restitution: None,
            wait: Joints::from(WAIT_HOLD_DEG.map(f64::to_radians)),
            faults: Vec::new(),
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Moment {
    pub t_s: f64,
    /// Joints of thrower and catcher, rad.
    pub q: [Joints; 2],
    pub ball_m: Vector3<f64>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Nobody but the tracker saw the ball: on real buses there is no cell.
    pub by_tracker: bool,
    /// The ball lay in the catcher's cup at the end: the cell's word, or what the tracker shows.
    pub caught: bool,
    pub reported: CatchOutcome,
    /// How the ball crossed the plane of the mouth.
    pub crossing: Option<Crossing>,
    /// What the cell saw, s.
    pub events: Vec<(f64, TwoArmEvent)>,
    pub choice: Option<Choice>,
    pub log: Vec<Logged>,
    pub refusals: Vec<Refused>,
    /// Times of planned release and planned passage of the window, s.
    pub planned_s: (f64, f64),
    /// Largest use of speed, acceleration, jerk by motions that were executed.
    pub used: [f64; 3],
    /// Limits of thrower and catcher against their joints as they moved.
    pub executed: [Executed; 2],
    pub arms_touched: bool,
    /// Time from the first to the last sample of the flight.
    pub seen_s: f64,
    /// Distance of the ball from the cup's axis at the catch, by the last forecast, m.
    pub off_m: Option<f64>,
    /// Where a ball that rests in the cup lies, and where its markers say that it lies, in the end-effector frame, m.
    pub lies_e_m: Option<[Vector3<f64>; 2]>,
    pub trace: Vec<Moment>,
}

impl Outcome {
    /// The ball lies in the cup, and the catcher knows it: with less nobody can throw it on.
    #[must_use]
    pub fn known_caught(&self) -> bool {
        self.caught && self.reported == CatchOutcome::Caught
    }

    /// What was reported is what happened, or that it is not known.
    #[must_use]
    pub fn reported_truly(&self) -> bool {
        self.reported.agrees(self.caught)
    }

    /// No limit of speed, acceleration or range was passed by either arm, none of jerk by the catcher's plans if `jerk`, and the arms did
    /// not touch each other.
    #[must_use]
    pub fn within_limits(&self, jerk: bool) -> bool {
        let planned = self.used[0] <= 1.0 && self.used[1] <= 1.0 && (!jerk || self.used[2] <= 1.0);
        planned && self.executed.iter().all(Executed::within) && !self.arms_touched
    }

    /// The part of the catcher that the ball touched first, before it hit the floor.
    #[must_use]
    pub fn first_touch(&self) -> Option<Touch> {
        let flight = self.events.iter().take_while(|(_, event)| *event != TwoArmEvent::HitFloor);
        flight.map(|(_, event)| event).find_map(|event| match event {
            TwoArmEvent::HitCup { arm: 1, .. } => Some(Touch::Moving),
            TwoArmEvent::HitLink { arm: 1, link, .. } if *link >= CLEARS_FROM_LINK => Some(Touch::Moving),
            TwoArmEvent::HitLink { arm: 1, .. } => Some(Touch::Base),
            _ => None,
        })
    }
}

/// A part of the catcher that the ball touched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Touch {
    /// Column or turntable: they stay where they are, whatever the joints do.
    Base,
    /// The cup, or a link that can get out of the ball's way.
    Moving,
}

/// Thrower and catcher on a cell, ready for trials.
#[derive(Debug, Clone)]
pub struct Pair {
    pub cell: TwoArmOptions,
    /// The catcher with both laws: without and with jerk. It keeps out of the thrower's reach.
    catchers: [CatchArm; 2],
}

impl Pair {
    /// Arm 0 throws, arm 1 catches; on a cell with one arm, that is arm 1.
    ///
    /// # Errors
    /// The catcher's arm cannot hold a cup.
    pub fn new(cell: TwoArmOptions) -> Result<Self, NotACatcher> {
        let (shape, surface) = (cell.cup.shape, cell.cup.surface);
        let cup = Cup {
            mouth_m: cell.cup.mouth_from_ee_m,
            inner_radius_m: shape.inner_radius_m,
            depth_m: shape.depth_m,
            wall_m: shape.wall_m,
            replaces: cell.cup.replaces.clone(),
            ball: Ball { radius_m: cell.ball.radius_m, inertia: cell.ball.inertia },
            contact: Contact {
                restitution: surface.restitution,
                friction: surface.friction,
                rolling: surface.rolling,
                rest_m_s: surface.rest_m_s,
            },
        };
        let [thrower, ArmPlace { model, x_wb }] = &cell.arms;
        let arm = CatchArm::new(model.clone(), *x_wb, cup, Shares::default(), false)?;
        let with_jerk = arm.with_arm(model.clone(), *x_wb, true)?;
        let mut catchers = [arm, with_jerk];
        if !cell.alone {
            // The boxes of a hand reach as far as its cup would.
            let other = catchers[0].with_arm(thrower.model.clone(), thrower.x_wb, false)?;
            let boxes = reach(thrower, other.reach_m() + other.cup().outer_radius_m());
            for catcher in &mut catchers {
                let near = within_reach(catcher, boxes.clone());
                catcher.set_obstacles(&near);
            }
        }
        Ok(Self { catchers, cell })
    }

    /// The same pair with the ball gripped at this place of the thrower's end-effector frame (m) for a throw.
    #[must_use]
    pub fn gripped_at(mut self, at_e_m: Vector3<f64>) -> Self {
        let arm = &mut self.cell.arms[0];
        arm.model = arm.model.clone().with_release_at(at_e_m);
        self
    }

    #[must_use]
    pub fn catcher(&self, jerk: bool) -> &CatchArm {
        &self.catchers[usize::from(jerk)]
    }

    /// The catcher with the restitution that it counts on.
    #[must_use]
    pub fn catcher_with(&self, options: &TrialOptions) -> CatchArm {
        let mut arm = self.catcher(options.jerk).clone();
        if let Some(restitution) = options.restitution {
            arm.set_restitution(restitution);
        }
        arm
    }

    /// The catcher for one throw, with the restitution that it counts on: whoever knows the plan keeps clear of the way that the thrower takes, not of all its reach.
    #[must_use]
    pub fn catcher_for(&self, aimed: &Aimed, options: &TrialOptions) -> CatchArm {
        let mut arm = self.catcher_with(options);
        if options.cooperative && !self.cell.alone {
            let boxes = within_reach(&arm, swept(&self.cell.arms[0], &aimed.throw));
            arm.set_obstacles(&boxes);
        }
        arm
    }

    /// Standard deviation of a marker per axis, m.
    fn marker_sigma_m(&self) -> f64 {
        (self.cell.tracker.noise_mm * 1e-3).max(1e-4)
    }

    /// What the watcher knows of ball and tracker.
    #[must_use]
    pub fn watch_options(&self, options: &TrialOptions) -> WatchOptions {
        let drag_1_m = self.cell.ball.drag_1_m * options.drag.0;
        WatchOptions {
            sigma_m: self.marker_sigma_m(),
            period_s: self.cell.tracker.period.as_secs_f64(),
            air: Air {
                gravity_m_s2: self.cell.arms[0].model.world().gravity_m_s2,
                drag_1_m,
                drag_sigma_1_m: drag_1_m * options.drag.1,
            },
            first_samples: FIRST_SAMPLES,
            prior: None,
        }
    }

    /// A ball that comes out of nowhere: `p_m` and `v_m_s` in the world. The thrower stands.
    #[must_use]
    pub fn ball(&self, p_m: Vector3<f64>, v_m_s: Vector3<f64>) -> Aimed {
        let q = Joints::from(STANDING_DEG.map(f64::to_radians));
        let still = Joints::zeros(6);
        let throw =
            Throw { q_rad: q, qd_rad_s: still, qdd_rad_s2: still, flight_s: 1.0, ha_s: 0.2, hb_s: 0.2 };
        Aimed { throw, p_m, v_m_s, flight_s: 1.0 }
    }

    /// One throw. The same seed, options and throw give the same outcome to the bit.
    #[must_use]
    pub fn run(&self, aimed: &Aimed, options: &TrialOptions, seed: u64) -> Outcome {
        self.run_timed(aimed, options, seed, |observe| observe())
    }

    /// The same; `timed` gets each call that turns a sample into a decision, for a clock.
    #[must_use]
    pub fn run_timed(
        &self,
        aimed: &Aimed,
        options: &TrialOptions,
        seed: u64,
        timed: impl FnMut(&mut dyn FnMut()),
    ) -> Outcome {
        let mut executor = LaggingArm::new(self.catcher(options.jerk), &options.wait);
        for fault in &options.faults {
            if let TrialFault::DriveLost { at_s } = fault {
                executor.lose_drive(SETTLE_S + aimed.throw.ha_s + at_s);
            }
        }
        self.run_on(aimed, options, seed, &mut executor, timed)
    }

    /// The same with another arm, which stands at the waiting pose at time zero. A lost drive is its own business.
    #[must_use]
    pub fn run_on(
        &self,
        aimed: &Aimed,
        options: &TrialOptions,
        seed: u64,
        executor: &mut impl Executor,
        mut timed: impl FnMut(&mut dyn FnMut()),
    ) -> Outcome {
        let mut rng = Rng::stream(seed, "throw scatter");
        let fault = options.faults.iter().find_map(|fault| match fault {
            TrialFault::Throw(fault) => Some(*fault),
            _ => None,
        });
        let by_hand = aimed.throw.qd_rad_s == Joints::zeros(6);
        let throwing = &self.cell.arms[0].model;
        let thrower = Thrower::new(throwing, aimed, SETTLE_S, &options.scatter, fault, &mut rng);
        let planned_s = thrower.planned_release_s();
        let arm = &self.catcher_for(aimed, options);
        let cell = self.cell_with(options, planned_s, seed);
        let rest = JointsNow { q: options.wait, qd: Joints::zeros(6) };
        let mut cell = TwoArmCell::new(cell, 0, [thrower.joints(0.0), rest]);
        cell.grip_at(throwing.gripper().x_eb.pos + options.grip_off_m);
        if let Some(release_s) = thrower.release_s().filter(|_| !by_hand) {
            cell.release_at(Instant::ZERO + Duration::from_secs_f64(release_s));
        }
        let mut run = self.new_run(arm, self.prior(&thrower, aimed, options), options);
        if options.cooperative {
            run.decide(executor, SETTLE_S, &mut timed);
        }
        let mut cell_joints = rest;
        let mut watches = [LimitWatch::new(throwing), LimitWatch::new(arm.model())];
        let (mut trace, mut arms_touched) = (Vec::new(), false);
        let mut until_s = planned_s + aimed.flight_s + AFTER_S;
        let mut step = 0;
        let mut now = Instant::ZERO;
        while now.as_secs_f64() < until_s.min(TRIAL_MAX_S) {
            now += STEP;
            step += 1;
            let now_s = now.as_secs_f64();
            let joints = executor.advance(now_s);
            cell_joints = joints;
            if by_hand
                && thrower.release_s().is_some()
                && now_s >= planned_s
                && now_s < planned_s + STEP.as_secs_f64()
            {
                let (p_m, v_m_s) = (aimed.p_m, aimed.v_m_s);
                cell.throw_in(LooseBall { p_m, v_m_s, spin_rad_s: Vector3::zeros() });
            }
            let both = [thrower.joints(now_s), joints];
            cell.step(now, both);
            while let Some(why) = executor.refused() {
                run.refusals.push(why);
                run.catcher.refused();
            }
            for (watch, joints) in watches.iter_mut().zip(&both) {
                watch.see(now_s, joints);
            }
            if step % TOUCH_EVERY == 0 && !arms_touched && !self.cell.alone {
                arms_touched = self.arms_touch(&both[0].q, &arm.boxes(&joints.q));
            }
            while let Some(bytes) = cell.poll_datagram() {
                let Ok(Some(frame)) = run.stream.push(&bytes, now_s) else { continue };
                run.seen.extend(frame.markers.iter().map(|(_, p)| (frame.t_s, *p)));
                if !options.blind && run.watch.observe(&frame) {
                    run.decide(executor, now_s, &mut timed);
                }
            }
            until_s = until_s.max(run.catcher.motion().end_s() + AFTER_S);
            if now_s >= until_s && in_cup(&run.catcher, &run.seen, &cell_joints, now_s) == InCup::Moving {
                until_s += LONGER_S;
            }
            if step % TRACE_EVERY == 0 {
                let q = both.map(|joints| joints.q);
                // A ball that no arm throws waits where it begins.
                let waits = by_hand && matches!(cell.place(), BallPlace::Held { .. });
                let ball_m = if waits { aimed.p_m } else { cell.ball().0 };
                trace.push(Moment { t_s: now_s, q, ball_m });
            }
        }
        let reported =
            report(&run.catcher, &run.watch, &run.seen, executor.halted(), &cell_joints, now.as_secs_f64());
        let events: Vec<(f64, TwoArmEvent)> =
            cell.events().iter().map(|(at, event)| (at.as_secs_f64(), event.clone())).collect();
        let crossing = events.iter().find_map(|(_, event)| match event {
            TwoArmEvent::Crossed { arm: 1, crossing } => Some(*crossing),
            _ => None,
        });
        let samples = run.watch.samples();
        let x_we = *arm.x_wb() * arm.model().ee_at(&cell_joints.q);
        let at_e_m = |p_w: Vector3<f64>| x_we.inverse_transform_point(&p_w);
        let seen_m = place_in_cup(&run.catcher, &run.seen, &cell_joints, now.as_secs_f64());
        let rests = cell.resting_in() == Some(1);
        let lies_e_m = seen_m.filter(|_| rests).map(|seen_m| [cell.ball().0, seen_m].map(at_e_m));
        Outcome {
            by_tracker: false,
            caught: rests,
            reported,
            crossing,
            events,
            choice: run.catcher.choice().cloned(),
            log: run.catcher.log().to_vec(),
            refusals: run.refusals,
            planned_s: (planned_s, planned_s + aimed.flight_s),
            used: run.used,
            executed: watches.map(|watch| watch.executed()),
            arms_touched,
            seen_s: samples.last().map_or(0.0, |last| last.t_s - samples[0].t_s),
            off_m: run.catcher.log().iter().rev().map(|logged| logged.off_m).find(|off_m| off_m.is_finite()),
            lies_e_m,
            trace,
        }
    }

    /// What a catcher knows beforehand who cooperates.
    #[must_use]
    pub fn prior(&self, thrower: &Thrower, aimed: &Aimed, options: &TrialOptions) -> Option<FlightPrior> {
        let ArmPlace { model, x_wb } = &self.cell.arms[0];
        options.cooperative.then(|| thrower.prior(model, x_wb, aimed, &options.scatter))
    }

    /// The catcher before it has seen anything.
    #[must_use]
    pub fn new_run<'a>(
        &self,
        arm: &'a CatchArm,
        prior: Option<FlightPrior>,
        options: &TrialOptions,
    ) -> Run<'a> {
        Run {
            catcher: Catcher::new(arm, options.settings, &options.wait),
            watch: BallWatch::new(WatchOptions { prior, ..self.watch_options(options) }),
            stream: MarkerStream::new(),
            refusals: Vec::new(),
            seen: Vec::new(),
            used: [0.0; 3],
        }
    }

    /// Whether the throwing arm at `q_rad` touches the boxes of the other one.
    fn arms_touch(&self, q_rad: &Joints, others: &[Obb]) -> bool {
        let ArmPlace { model, x_wb } = &self.cell.arms[0];
        let boxes = model.boxes_at(&model.fk(q_rad)).into_iter();
        let boxes: Vec<Obb> = boxes.map(|b| Obb::new(*x_wb * b.pose, b.half_m)).collect();
        touch(&boxes, others)
    }

    /// The cell with the trial's faults.
    fn cell_with(&self, options: &TrialOptions, planned_s: f64, seed: u64) -> TwoArmOptions {
        let mut cell = self.cell.clone();
        cell.seed = seed;
        let always =
            |kind| TrackerFault { kind, from: Instant::ZERO, until: Instant::FAR_FUTURE, probability: 1.0 };
        for fault in &options.faults {
            match *fault {
                TrialFault::TrackerDead { at_s } => cell.tracker.faults.push(TrackerFault {
                    from: Instant::ZERO + Duration::from_secs_f64((planned_s + at_s).max(0.0)),
                    ..always(TrackerFaultKind::FramesLost)
                }),
                TrialFault::FramesLost { probability } => cell
                    .tracker
                    .faults
                    .push(TrackerFault { probability, ..always(TrackerFaultKind::FramesLost) }),
                TrialFault::Bias { by_mm } => {
                    cell.tracker.faults.push(always(TrackerFaultKind::Bias { by_mm: [by_mm; 3] }));
                }
                TrialFault::FalseMarkers { count } => {
                    cell.tracker.faults.push(always(TrackerFaultKind::FalseMarkers { count }));
                }
                TrialFault::DriveLost { .. } | TrialFault::Throw(_) => {}
            }
        }
        cell
    }
}

/// The catcher's side of a trial.
#[derive(Debug)]
pub struct Run<'a> {
    pub catcher: Catcher<'a>,
    pub watch: BallWatch,
    pub stream: MarkerStream,
    pub refusals: Vec<Refused>,
    /// All markers with their times (s) and places (m), in order of arrival.
    pub seen: Vec<(f64, Vector3<f64>)>,
    used: [f64; 3],
}

impl Run<'_> {
    /// Decides with what was seen so far; a new motion goes to the arm.
    pub fn decide(
        &mut self,
        executor: &mut impl Executor,
        now_s: f64,
        timed: &mut impl FnMut(&mut dyn FnMut()),
    ) {
        let mut moved = false;
        let (watch, catcher) = (&self.watch, &mut self.catcher);
        timed(&mut || {
            moved = watch.forecast(now_s).is_some_and(|forecast| catcher.observe(&forecast, now_s).is_some());
        });
        if !moved {
            return;
        }
        let order = self.catcher.choice().map_or_else(|| Order::rest(self.catcher.motion()), Order::catch);
        match executor.take(&order, now_s) {
            Ok(()) => {
                let share = used(self.catcher.arm(), order.motion);
                for (most, share) in self.used.iter_mut().zip(share) {
                    *most = most.max(share);
                }
            }
            Err(why) => {
                self.refusals.push(why);
                self.catcher.refused();
            }
        }
    }
}
