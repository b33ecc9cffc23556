//! The rules that every run has to keep, with their bounds.

use hil_sim::drive::COUNT_LOSS_RAD_S;
use hil_sim::fault::{Fault, FaultKind, PhysicalFault, Target, WireFault};
use hil_sim::scenario::{Action, Scenario};
use hil_sim::witness::Trace;
use operator::job::BallOutcome;
use operator::job::Step;
use planner::plan::Arm;
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::{Duration, Instant};

use super::evidence::{Evidence, ReportedOutcome, Seen};

/// A run that lasts longer than the nominal one by more than this hangs: start-up may take 20 s.
const LONGER_MAX: Duration = Duration::from_secs(30);
/// Longest time that the frames of a message take on the bus.
const MESSAGE_MAX: Duration = Duration::from_millis(50);
/// A joint slower than this rests, rad/s: the drives themselves report a slower one as standing.
const REST_RAD_S: f64 = 0.02;
/// The end of a run in which all joints must rest.
const REST_SPAN: Duration = Duration::from_millis(200);
/// A drive that brakes at the rate of its commands stands after 0.26 s; a halt, a watchdog and the controller's reaction
/// take less than 0.2 s.
const FAULT_TO_REST: Duration = Duration::from_millis(500);
/// After a disturbance the drive's position loop settles.
const SETTLING: Duration = Duration::from_millis(100);
/// A standing controller looks at each drive every 60 ms; a motion that begins unasked is reported after one look more.
const DETECTION_MAX: Duration = Duration::from_millis(100);
/// The drives' position loops overshoot the speed of a ramp by this share.
const SPEED_SHARE: f64 = 0.05;
/// A loop at rest swings by this much, rad/s.
const SPEED_SLACK_RAD_S: f64 = 0.05;
/// Position loops overshoot by this much, rad.
const POSITION_SLACK_RAD: f64 = 0.005;
/// Largest distance from the path of the nominal run, rad: a joint that brakes on its own at the rate of its commands from
/// the top speeds of the throw (1.7 rad/s at 10.4 rad/s², 2.5 rad/s at 22.3 rad/s²) needs v²/(2a), 0.14 rad, while the
/// others may stop elsewhere.
pub const EXCURSION_MAX_RAD: f64 = 0.15;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rule {
    /// No panic, no livelock, no world broken down.
    Runs,
    /// Every joint stays in its range.
    Position,
    /// Every joint stays below its top speed.
    Speed,
    /// No command exceeds the limits.
    Command,
    /// The joints stay near the path of the nominal run.
    Excursion,
    Rest,
    /// Nothing moves while the controller reports a standing state.
    Supervised,
    /// The gripper gets no order to open after a stop.
    Ball,
    /// The reported outcome is the outcome seen.
    Outcome,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    pub rule: Rule,
    pub what: String,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// Rules broken; empty if all is well.
    pub findings: Vec<Finding>,
    /// What was reported, in few words.
    pub reported: String,
    /// Something is wrong and the program does not report it.
    pub silent: bool,
    /// Largest distance from the nominal path, rad.
    pub excursion_rad: f64,
}

impl Verdict {
    pub fn ok(&self) -> bool {
        self.findings.is_empty()
    }
}

/// What is compared with.
pub struct Judge<'a> {
    pub arm: &'a Arm,
    /// The run of the same cell without faults.
    pub nominal: &'a Evidence,
}

impl Judge<'_> {
    pub fn judge(&self, scenario: &Scenario, run: &Evidence) -> Verdict {
        let mut findings = Vec::new();
        let mut found = |rule, what: String| findings.push(Finding { rule, what });
        if let ReportedOutcome::Panicked(text) = &run.reported {
            found(Rule::Runs, format!("panic: {text}"));
        }
        if let Some(broken) = &run.broken {
            found(Rule::Runs, broken.clone());
        }
        let limit = self.nominal.trace.at(self.nominal.trace.len()) + LONGER_MAX;
        if run.end > limit {
            found(Rule::Runs, format!("ends at {}, long after {limit}", run.end));
        }
        if let Some(first) = run.bus.beyond.first().filter(|_| !forges_frames(&scenario.faults)) {
            found(Rule::Command, first.clone());
        }
        self.limits(scenario, run, &mut found);
        let excursion = self.excursion(scenario, run);
        let excursion_rad = excursion.rad;
        if excursion_rad > self.excursion_max_rad() + encoder_slack_rad(&scenario.faults) {
            let Excursion { joint, at, .. } = excursion;
            found(
                Rule::Excursion,
                format!("joint {} {excursion_rad:.3} rad from the path at {at}", joint + 1),
            );
        }
        let hidden = Window::hidden(self.arm, &scenario.faults);
        rest(run, &hidden, &mut found);
        supervised(self.arm, run, &hidden, &mut found);
        ball(scenario, run, &mut found);
        if let Some(what) = outcome(scenario, run) {
            found(Rule::Outcome, what);
        }
        // A reported miss does not report an arm that left its path.
        let tells_of_arm = matches!(
            run.reported,
            ReportedOutcome::Cause { .. } | ReportedOutcome::Failed(_) | ReportedOutcome::Panicked(_)
        );
        let silent = findings.iter().any(|finding| !tells_of_arm || finding.rule == Rule::Outcome);
        Verdict { findings, reported: in_words(&run.reported), silent, excursion_rad }
    }

    /// See [`EXCURSION_MAX_RAD`]. For other arms: the longest braking distance from the fastest speeds of the nominal run.
    fn excursion_max_rad(&self) -> f64 {
        if self.arm.drives().is_some() {
            return EXCURSION_MAX_RAD;
        }
        let trace = &self.nominal.trace;
        let brake_rad = |(joint, limits): (usize, &robot_model::JointLimits)| {
            let speeds = (0..trace.len()).map(|index| trace.sample(index)[joint][1].abs());
            let v_rad_s = speeds.fold(0.0, f64::max);
            v_rad_s * v_rad_s / (2.0 * limits.a_control_max_rad_s2)
        };
        let limits = self.arm.joints().iter().map(|joint| &joint.limits).enumerate();
        limits.map(brake_rad).fold(0.0, f64::max) + 0.01
    }

    /// Largest distance of any joint from the nearest pose of the nominal run, rad. From a homing to the throw only the limits
    /// hold: the search may take the whole range, and the way to the start of the throw is chosen again from where it ends.
    fn excursion(&self, scenario: &Scenario, run: &Evidence) -> Excursion {
        let limp: Vec<Window> = Window::limp(self.arm, &scenario.faults).collect();
        let mut largest = Excursion::default();
        let path = &self.nominal.trace;
        let Some(last) = path.len().checked_sub(1) else { return largest };
        let throw_begin = self.nominal.step(Step::Throw).map_or(0, |(at, _)| path.index_at(at)).min(last);
        let homing = run.bus.states.iter().find(|(_, group)| group.state == State::Homing);
        let unknown_from = homing.map_or(run.trace.len(), |(at, _)| run.trace.index_at(*at));
        let known_from = run.step(Step::Throw).map_or(run.trace.len(), |(at, _)| run.trace.index_at(at));

        let mut near = Some(0);
        for index in (0..run.trace.len()).step_by(STRIDE) {
            if (unknown_from..known_from).contains(&index) {
                near = None;
                continue;
            }
            // The throw is compared with the throw: a joint that has lost counts is off by a constant, and the way to the
            // start may be nearer.
            let first = if index >= known_from { throw_begin } else { 0 };
            let range = near.map_or(first..=last, |near: usize| {
                near.saturating_sub(WINDOW).max(first)..=(near + WINDOW).min(last)
            });
            let at = run.trace.at(index);
            let falls = |joint| limp.iter().any(|window| window.joint == joint && window.covers(at));
            let (found, joint, rad) = nearest(run.trace.sample(index), path, range, falls);
            near = Some(found);
            if rad > largest.rad {
                largest = Excursion { rad, joint, at: run.trace.at(index) };
            }
        }
        largest
    }

    fn limits(&self, scenario: &Scenario, run: &Evidence, found: &mut impl FnMut(Rule, String)) {
        let slack_rad = POSITION_SLACK_RAD + encoder_slack_rad(&scenario.faults);
        let released = Window::released(self.arm, &scenario.faults);
        let limp: Vec<Window> = Window::limp(self.arm, &scenario.faults).collect();
        let (mut worst_q, mut worst_v) = ((0.0, String::new()), (0.0, String::new()));
        for index in 0..run.trace.len() {
            for (j, (joint, [q, v])) in self.arm.joints().iter().zip(run.trace.sample(index)).enumerate() {
                let limits = &joint.limits;
                if limp.iter().any(|window| window.joint == j && window.covers(run.trace.at(index))) {
                    continue;
                }
                let beyond_q = (limits.q_min_rad - slack_rad - q).max(q - limits.q_max_rad - slack_rad);
                if beyond_q > worst_q.0 {
                    worst_q = (beyond_q, format!("joint {} at {q:.3} rad at {}", j + 1, run.trace.at(index)));
                }
                if released.iter().any(|r| r.joint == j && r.covers(run.trace.at(index))) {
                    continue;
                }
                let beyond_v = v.abs() - (1.0 + SPEED_SHARE) * limits.v_max_rad_s - SPEED_SLACK_RAD_S;
                if beyond_v > worst_v.0 {
                    worst_v =
                        (beyond_v, format!("joint {} at {v:.3} rad/s at {}", j + 1, run.trace.at(index)));
                }
            }
        }
        if worst_q.0 > 0.0 {
            found(Rule::Position, worst_q.1);
        }
        if worst_v.0 > 0.0 {
            found(Rule::Speed, worst_v.1);
        }
    }
}

/// A joint, and a time in which it moves as the physics of its fault wants.
struct Window {
    joint: usize,
    from: Instant,
    to: Instant,
}

impl Window {
    fn covers(&self, at: Instant) -> bool {
        at >= self.from && at <= self.to
    }

    /// When a drive loses counts its position loop moves the joint although the drive sees it at rest, until all is lost
    /// or the brake is closed. Nobody on the bus can see this motion.
    fn hidden(arm: &Arm, faults: &[Fault]) -> Vec<Self> {
        let hidden = |fault: &Fault| {
            let FaultKind::Physical(_, PhysicalFault::EncoderOffset { offset_rad }) = fault.kind else {
                return None;
            };
            let lasts = Duration::from_secs_f64(offset_rad.abs() / COUNT_LOSS_RAD_S) + SETTLING;
            Some(Self { joint: joint_of(arm, fault.target)?, from: fault.start, to: fault.start + lasts })
        };
        // A joint that falls swings the others against the gains of their motors.
        let swings = Self::limp(arm, faults).map(|limp| limp.from).min();
        let swung =
            (0..arm.n()).filter_map(|joint| Some(Self { joint, from: swings?, to: Instant::FAR_FUTURE }));
        faults.iter().filter_map(hidden).chain(swung).collect()
    }

    /// An arm of motors without brakes: a motor whose frames are lost or wrong, or that restarts, is switched off and its joint falls. A
    /// fault of the bus may switch all of them off.
    fn limp<'a>(arm: &'a Arm, faults: &'a [Fault]) -> impl Iterator<Item = Self> + 'a {
        let faults = faults.iter().filter(|_| arm.mit_motors().is_some());
        faults.flat_map(|fault| {
            let joints = match fault.target {
                Target::Bus => 0..arm.n(),
                target => joint_of(arm, target).map_or(0..0, |joint| joint..joint + 1),
            };
            joints.map(|joint| Self { joint, from: fault.start, to: Instant::FAR_FUTURE })
        })
    }

    /// An axis that was held and is let go is thrown back to its set-point by the drive's own position loop. The first
    /// time only: one that is held again and again is stopped before.
    fn released(arm: &Arm, faults: &[Fault]) -> Vec<Self> {
        let released = |fault: &Fault| {
            let FaultKind::Physical(_, PhysicalFault::Blocked) = fault.kind else { return None };
            let from = fault.start + fault.length?;
            Some(Self { joint: joint_of(arm, fault.target)?, from, to: from + SETTLING })
        };
        faults.iter().filter_map(released).collect()
    }
}

fn joint_of(arm: &Arm, target: Target) -> Option<usize> {
    let Target::Module(module) = target else { return None };
    arm.addresses()?.iter().position(|address| *address == module.get())
}

/// The fastest joint whose motion the bus can show.
fn fastest(trace: &Trace, index: usize, hidden: &[Window]) -> (usize, f64) {
    let at = trace.at(index);
    let is_hidden = |joint| hidden.iter().any(|window| window.joint == joint && window.covers(at));
    let speeds = trace.sample(index).iter().map(|[_, v]| v.abs()).enumerate();
    speeds.fold((0, 0.0), |best, next| if next.1 > best.1 && !is_hidden(next.0) { next } else { best })
}

/// Frames on the bus that no controller sent.
fn forges_frames(faults: &[Fault]) -> bool {
    faults.iter().any(|fault| matches!(fault.kind, FaultKind::Wire(WireFault::Babble { .. })))
}

/// Lost encoder counts move the true range by as much as was lost.
fn encoder_slack_rad(faults: &[Fault]) -> f64 {
    let lost = |fault: &Fault| match fault.kind {
        FaultKind::Physical(_, PhysicalFault::EncoderOffset { offset_rad }) => offset_rad.abs(),
        _ => 0.0,
    };
    faults.iter().map(lost).sum()
}

/// Samples between two comparisons with the nominal path.
const STRIDE: usize = 10;
/// Samples looked at before and behind the last nearest pose: both runs pass the path in the same order.
const WINDOW: usize = 400;

/// The largest distance from the path.
#[derive(Clone, Copy, Debug, Default)]
struct Excursion {
    rad: f64,
    joint: usize,
    at: Instant,
}

/// The index of the nearest sample of `nominal` in a range, the joint farthest off it, and by how much. The sum of the
/// squares decides what is nearest: of the largest distance alone, one joint that is off by a constant would hide the
/// others.
fn nearest(
    here: &[[f64; 2]],
    nominal: &Trace,
    range: std::ops::RangeInclusive<usize>,
    falls: impl Fn(usize) -> bool,
) -> (usize, usize, f64) {
    let mut best = (*range.start(), f64::INFINITY);
    for index in range.step_by(STRIDE) {
        let there = nominal.sample(index);
        // A joint that falls is left out: it leaves the path, and the others may still be on it.
        let held = here.iter().zip(there).enumerate().filter(|(joint, _)| !falls(*joint));
        let squares: f64 = held.map(|(_, (a, b))| (a[0] - b[0]).powi(2)).sum();
        // Of equal ones the last: a standing arm is at the end of its stay.
        if squares <= best.1 {
            best = (index, squares);
        }
    }
    let distances = here.iter().zip(nominal.sample(best.0)).map(|(a, b)| (a[0] - b[0]).abs()).enumerate();
    let (joint, rad) = distances
        .filter(|(joint, _)| !falls(*joint))
        .fold((0, 0.0), |best, next| if next.1 > best.1 { next } else { best });
    (best.0, joint, rad)
}

fn rest(run: &Evidence, hidden: &[Window], found: &mut impl FnMut(Rule, String)) {
    let trace = &run.trace;
    let span = REST_SPAN.as_micros() / trace.step().as_micros().max(1);
    let from = trace.len().saturating_sub(span as usize);
    if let Some((joint, v)) =
        (from..trace.len()).map(|i| fastest(trace, i, hidden)).find(|(_, v)| *v > REST_RAD_S)
    {
        found(Rule::Rest, format!("joint {} still moves at {v:.3} rad/s", joint + 1));
    }
}

/// Drives other than PowerCubes lose their torque while their time-outs are proven. A joint sinks until brake or loop holds it again.
fn may_move(arm: &Arm, state: State) -> bool {
    state.may_move() || (state == State::Boot && arm.drives().is_none())
}

/// Between two messages that both report a standing state nothing may have moved; after a fault no longer than it takes to
/// brake.
fn supervised(arm: &Arm, run: &Evidence, hidden: &[Window], found: &mut impl FnMut(Rule, String)) {
    let trace = &run.trace;
    let mut fault_since = None;
    for (k, (at, group)) in run.bus.states.iter().enumerate() {
        let at = &made_at(*at, group);
        if group.state == State::Fault {
            fault_since = fault_since.or(Some(*at));
        } else {
            fault_since = None;
        }
        let next = run.bus.states.get(k + 1);
        // Without further messages the state stands until the end.
        let (until, next_state) =
            next.map_or((run.end, group.state), |(at, group)| (made_at(*at, group), group.state));
        if [group.state, next_state].into_iter().any(|state| may_move(arm, state)) {
            continue;
        }
        let from = match fault_since {
            Some(since) => (since + FAULT_TO_REST).max(*at),
            None => *at,
        };
        let (from, to) = (trace.index_at(from), trace.index_at(until));
        // What begins to move is a fault, and reported within the time of a look at all drives.
        let to = match run.bus.first(*at, |state| state == State::Fault) {
            Some(known) if group.state != State::Fault => {
                to.min(trace.index_at(known.saturating_sub(DETECTION_MAX)))
            }
            _ => to,
        };
        if let Some((i, (joint, v))) =
            (from..to).map(|i| (i, fastest(trace, i, hidden))).find(|(_, (_, v))| *v > REST_RAD_S)
        {
            let what =
                format!("{:?}: joint {} moves at {v:.3} rad/s at {}", group.state, joint + 1, trace.at(i));
            found(Rule::Supervised, what);
            return;
        }
    }
}

/// When a state was published, by the controller's clock, which starts with the cell's. Its frames wait for the control cycle: the last
/// one leaves up to 12 ms later.
fn made_at(ended: Instant, group: &GroupState) -> Instant {
    let made = Instant::from_micros(group.uptime_us);
    if made <= ended && ended < made + MESSAGE_MAX { made } else { ended }
}

/// When the throw was stopped: the first halt or message of it.
fn stopped_at(run: &Evidence) -> Option<Instant> {
    let (from, _) = run.step(Step::Throw)?;
    let halt = run.bus.halts.iter().copied().find(|at| *at >= from);
    let reported =
        run.bus.first(from, |state| matches!(state, State::Stopping | State::Stopped | State::Fault));
    match (halt, reported) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}

fn ball(scenario: &Scenario, run: &Evidence, found: &mut impl FnMut(Rule, String)) {
    let Some(stop) = stopped_at(run) else { return };
    // An order that was sent before the stop may come after it where the bus holds frames back.
    let late = |fault: &Fault| match fault.kind {
        FaultKind::Wire(WireFault::Delay(by)) => by,
        _ => Duration::ZERO,
    };
    // The plant is looked at once per step of its trace, so an order is up to one step older than it seems.
    let held_back = scenario.faults.iter().map(late).fold(run.trace.step(), |sum, by| sum + by);
    let opened = run.trace.gripper_orders().iter().find(|(at, open)| *open && *at > stop + held_back);
    if let Some((at, _)) = opened {
        found(Rule::Ball, format!("the gripper gets the order to open at {at}, after the stop at {stop}"));
    }
}

/// Another node opened the hand when the job was over: what was reported of the ball was so when it was reported.
fn opened_afterwards(scenario: &Scenario, run: &Evidence) -> bool {
    // Without a count an action is repeated until the end.
    let last = |action: &Action| match (action.every, action.count) {
        (Some(every), Some(count)) => action.at + every * count.saturating_sub(1),
        (Some(_), None) => Instant::FAR_FUTURE,
        (None, _) => action.at,
    };
    let acts_late = scenario.actions.iter().any(|action| last(action) >= run.job_end);
    acts_late && run.ball.released_at.is_some_and(|at| at > run.job_end)
}

fn outcome(scenario: &Scenario, run: &Evidence) -> Option<String> {
    let seen = match run.seen {
        Seen::Landed { error_m } => format!("landed {:.1} mm from the target", 1e3 * error_m),
        Seen::Missed { error_m } => format!("missed by {:.1} mm", 1e3 * error_m),
        Seen::Touched => "the ball touched the arm".to_owned(),
        Seen::Away => "the ball does not come down".to_owned(),
        Seen::NotReleased => "the ball is in the hand".to_owned(),
    };
    let ball = match run.reported_ball {
        BallOutcome::NotObserved => true,
        BallOutcome::InHand => run.seen == Seen::NotReleased || opened_afterwards(scenario, run),
        BallOutcome::Released => run.seen != Seen::NotReleased,
    };
    let right = match &run.reported {
        ReportedOutcome::Landed => matches!(run.seen, Seen::Landed { .. }),
        ReportedOutcome::Missed => matches!(run.seen, Seen::Missed { .. } | Seen::Touched | Seen::Away),
        ReportedOutcome::NotReleased => run.seen == Seen::NotReleased,
        // A report of a stop makes no statement about the ball. The other rules judge the arm.
        ReportedOutcome::Cause { .. } | ReportedOutcome::Failed(_) | ReportedOutcome::Panicked(_) => true,
    };
    (!right || !ball).then(|| {
        format!("reported: {}, ball {}; seen: {seen}", in_words(&run.reported), run.reported_ball.json_name())
    })
}

fn in_words(reported: &ReportedOutcome) -> String {
    match reported {
        ReportedOutcome::Landed => "landed".to_owned(),
        ReportedOutcome::Missed => "missed".to_owned(),
        ReportedOutcome::NotReleased => "not released".to_owned(),
        ReportedOutcome::Cause { cause, joint: 0 } => format!("cause {cause}"),
        ReportedOutcome::Cause { cause, joint } => format!("cause {cause} joint {joint}"),
        ReportedOutcome::Failed(text) => format!("failed: {text}"),
        ReportedOutcome::Panicked(text) => format!("panic: {text}"),
    }
}
