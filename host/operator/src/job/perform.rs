//! The steps of a job, in order, for any operator.

use firmware::registers::{self, RegisterInfo};
use protocol::cyphal::cubecell::command::Trajectory;
use protocol::cyphal::cubecell::group_state::State;
use protocol::{Duration, Instant};
use robot_model::collision::Scene;

use super::order::{Extent, Judge, Order, Program};
use super::record::{BallOutcome, JobError, Record, Start, Step};
use super::{follow, reach, throw, verdict};
use crate::analysis::coverage::Certified;
use crate::dialogue::operator::{FINDING_MAX, OperatorError};
use crate::dialogue::registers::{Numbers, settings_of, to_host};
use crate::port::Operator;
use crate::samples::drives::Drives;
use crate::trajectory::{Encoded, TrajectoryError, encode, encode_any, require_supply};
use firmware::trajectory_format::AHEAD_MARGIN_US;
use planner::motion::Motion;
use planner::plan::Joints;
use planner::way::{is_straight, way};
use tuner::gains::choose::built_in_of;
use tuner::gains::gains_file::REGISTERS;

/// Longest start-up of a controller.
const BOOT_MAX: Duration = Duration::from_secs(20);
/// Longest homing of a group.
const HOMING_MAX: Duration = Duration::from_secs(180);

/// A ball that is still in the hand this long after the end of a run stays there.
const BALL_MAX: Duration = Duration::from_secs(1);
/// Time between two looks at the simulated ball.
const BALL_LOOK: Duration = Duration::from_millis(10);

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress<'a> {
    Begin(Step),
    /// Progress of the step: done, of all.
    Part(usize, usize),
    /// Asks whether the job may continue. Asked before the first motion, and with the arm at the start before a
    /// throw; again and again while the answer is [`Answer::Waiting`].
    May(Question),
    /// A step has ended, with its result as text.
    End(Step, &'a str),
}

/// What a person decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Question {
    /// The arm homes, goes to the start, or runs a motion without a throw.
    Move,
    /// The ball is thrown.
    Throw,
}

/// Answer of a person so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    Yes,
    No,
    /// Nothing yet.
    Waiting,
}

/// The callback; its answer is used for [`Progress::May`] only. It does not wait: the job follows the arm meanwhile.
pub type OnProgress<'a> = &'a mut dyn FnMut(Progress<'_>) -> Answer;

/// Time between two looks for an answer.
const ANSWER_LOOK: Duration = Duration::from_millis(20);

/// Does what is ordered, follows it to its end and judges it. The arm stands when this returns.
pub fn perform(operator: &mut dyn Operator, order: &Order<'_>, ui: OnProgress<'_>) -> Record {
    let mut steps =
        Steps { operator, order, record: Record::default(), ui, may_move: false, observed: false };
    steps.record.ended = steps.all().err();
    if !steps.observed && matches!(order.extent, Extent::Run | Extent::Back) {
        // The ball may have left the hand before a stop, or leave it after.
        steps.observe();
    }
    let Steps { operator, mut record, .. } = steps;
    if order.judge.throws() {
        operator.leave();
    }
    record.led = operator.led();
    if let Judge::Follow { .. } = order.judge {
        follow::conclude(order, &mut record);
    }
    record.verdict = verdict::judge(order, &record);
    record
}

/// Keeps the times of the steps.
struct Steps<'a, 'b> {
    operator: &'a mut dyn Operator,
    order: &'a Order<'a>,
    record: Record,
    ui: OnProgress<'b>,
    /// A motion was agreed to.
    may_move: bool,
    /// The data of the samples and of the observer of the ball are in the record.
    observed: bool,
}

impl Steps<'_, '_> {
    fn all(&mut self) -> Result<(), JobError> {
        let order = self.order;
        let motion = order.program.motion();
        // A robot that waits for answers is not left alone while a way is looked for.
        let foreseen =
            self.operator.foreseen_pose().map(|from| Ok::<_, JobError>((from, self.way_to_start(&from)?)));
        let foreseen = foreseen.transpose()?;
        let found = self.find_drives()?;
        if order.extent == Extent::Upload {
            self.record.period_us = self.operator.natural("cycle.period_us")?;
            return self.upload().map(drop);
        }
        self.home(&found)?;
        if order.extent == Extent::Ready {
            self.record.pose = Some(Joints::from_slice(&self.operator.pose()?));
            return Ok(());
        }
        self.begin(Step::Gains)?;
        self.agree()?;
        let ahead_us = self.operator.natural("stop.path_max_us")? + u64::from(AHEAD_MARGIN_US);
        require_supply(motion, self.operator.segment_s(), 1e-6 * ahead_us as f64)?;
        self.operator.require_passed(motion)?;
        self.end(if order.gains.is_some() { "written and read back" } else { "those of the controller" });

        let (before, approach) = match foreseen {
            Some(foreseen) => foreseen,
            None => {
                let before = Joints::from_slice(&self.operator.pose()?);
                (before, self.way_to_start(&before)?)
            }
        };
        if order.judge.throws() {
            self.operator.set_gripper(false)?;
        }
        if let Some(motion) = &approach {
            self.begin(Step::Approach)?;
            self.require(Question::Move)?;
            self.drive(motion)?;
            self.record.approach_s = Some(motion.duration_s());
            let kind = if is_straight(motion) { "straight" } else { "around what is in the way" };
            self.end(&format!("{kind}, {:.1} s", motion.duration_s()));
        }
        self.require(if order.judge.throws() { Question::Throw } else { Question::Move })?;
        self.run(motion)?;
        if order.judge.throws() {
            self.watch_flight(motion)?;
        } else {
            self.observe();
        }
        // A ball that hangs in an open hand may fall at any time: the arm stays where it is.
        if order.extent == Extent::Back && self.record.ball != BallOutcome::InHand {
            let here = Joints::from_slice(&self.operator.pose()?);
            let empty = Scene { ball_held: false, ..order.scene.clone() };
            if let Some(motion) = self.way(&empty, &here, &before)? {
                self.begin(Step::Return)?;
                self.drive(&motion)?;
                self.end(&format!("{:.1} s", motion.duration_s()));
            }
        }
        Ok(())
    }

    fn begin(&mut self, step: Step) -> Result<(), JobError> {
        self.record.at_work = Some((step, self.operator.now()));
        (self.ui)(Progress::Begin(step));
        Ok(self.operator.heed_stops()?)
    }

    /// Waits for the answer of a person and for a stop.
    fn require(&mut self, question: Question) -> Result<(), JobError> {
        if question == Question::Move && std::mem::replace(&mut self.may_move, true) {
            return Ok(());
        }
        loop {
            let answer = (self.ui)(Progress::May(question));
            self.operator.heed_stops()?;
            match answer {
                Answer::Yes => return Ok(()),
                Answer::No => {
                    return Err(JobError::Declined { moved: self.may_move && question == Question::Throw });
                }
                Answer::Waiting => self.operator.pass(ANSWER_LOOK)?,
            }
        }
    }

    fn end(&mut self, found: &str) {
        if let Some((step, begun)) = self.record.at_work.take() {
            self.record.steps.push((step, begun, self.operator.now()));
            (self.ui)(Progress::End(step, found));
        }
    }

    /// The controller, and the joints whose drives it has found.
    fn find_drives(&mut self) -> Result<Vec<f64>, JobError> {
        self.begin(Step::Controller)?;
        self.record.node = self.operator.connect()?;
        let who = self.record.node.map_or("in this program".to_owned(), |node| node.get().to_string());
        self.end(&format!("controller {who}"));

        self.begin(Step::Drives)?;
        if self.order.extent == Extent::Upload {
            // A file may be stored in any state of the drives.
            self.operator.wait_for(FINDING_MAX, &|state| state != State::Boot)?;
            self.end("asked");
            return Ok(Vec::new());
        }
        self.operator.wait_for(BOOT_MAX, &|state| !matches!(state, State::Boot | State::Fault))?;
        let found = self.operator.pose()?;
        let wanted = self.order.arm.joints().len();
        if found.len() != wanted {
            return Err(JobError::Joints { found: found.len(), wanted });
        }
        let double = self.operator.double_answers();
        if !double.is_empty() {
            return Err(JobError::Double { addresses: double.join(", ") });
        }
        self.end(&format!("{} drives answer, watchdogs proven", found.len()));
        Ok(found)
    }

    /// Lets the joints that have no zero find it.
    fn home(&mut self, found: &[f64]) -> Result<(), JobError> {
        let group = self.operator.group();
        if group.state == State::Idle {
            if !self.order.homes {
                return Err(JobError::NotHomed);
            }
            self.begin(Step::Home)?;
            self.require(Question::Move)?;
            let mask = !group.homed_mask & ((1_u16 << found.len()) - 1) as u8;
            self.operator.home(mask, HOMING_MAX)?;
            self.end(&format!("{} joints found their zeros", mask.count_ones()));
        }
        Ok(())
    }

    /// The way from a pose to where the program begins; empty without [`Order::travel`].
    fn way_to_start(&mut self, from: &Joints) -> Result<Option<Motion>, JobError> {
        self.way(&self.order.scene, from, &self.order.program.motion().start_rad())
    }

    fn way(&mut self, scene: &Scene, from: &Joints, to: &Joints) -> Result<Option<Motion>, JobError> {
        let (arm, Some(travel)) = (self.order.arm, self.order.travel) else { return Ok(None) };
        let mut found = Ok(None);
        self.operator.meanwhile(&mut || found = way(arm, scene, &travel, from, to))?;
        Ok(found?)
    }

    fn encoded(&self, motion: &Motion) -> Result<Encoded, TrajectoryError> {
        encode_any(motion, self.record.period_us as u32, self.order.robot_crc32, None)
    }

    /// Runs one motion to its end.
    fn drive(&mut self, motion: &Motion) -> Result<(), JobError> {
        let plan = self.encoded(motion)?;
        let name = self.operator.upload(&plan, &mut |_, _| {})?;
        self.operator.arm(&name)?;
        let limit = Duration::from_secs_f64(motion.duration_s()) + Order::PATIENCE;
        self.operator.run(&name, None, limit, &mut |_, _| {})?;
        Ok(())
    }

    fn upload(&mut self) -> Result<Trajectory, JobError> {
        self.begin(Step::Upload)?;
        let plan = match &self.order.program {
            // A plan that only continues while it runs is not stored for later.
            Program::Motion(motion) if self.order.extent == Extent::Upload => {
                encode(motion, self.record.period_us as u32, self.order.robot_crc32, None)?.into()
            }
            Program::Motion(motion) => self.encoded(motion)?,
            Program::File(bytes, _) => bytes.clone().into(),
        };
        let ui = &mut *self.ui;
        let name = self.operator.upload(&plan, &mut |done, all| {
            ui(Progress::Part(done, all));
        })?;
        self.record.trajectory = Some(name);
        let after = match plan.segments.len() {
            0 => String::new(),
            segments => format!(", {segments} segments follow in motion"),
        };
        self.end(&format!("{} bytes, hash {:016x}{after}", plan.file.len(), name.trajectory_crc64));
        Ok(name)
    }

    fn run(&mut self, motion: &Motion) -> Result<(), JobError> {
        let name = self.upload()?;
        self.operator.keep_samples();
        self.begin(Step::Arm)?;
        self.operator.arm(&name)?;
        self.end("offered and confirmed");

        let throws = self.order.judge.throws();
        self.begin(if throws { Step::Throw } else { Step::Run })?;
        let frames_before = self.operator.frames_kept();
        self.record.before = self.operator.group();
        let mut limit = Duration::from_secs_f64(motion.duration_s()) + self.order.patience;
        let mut start: Option<Instant> = None;
        if let Some(ahead) = self.order.start_in {
            let (at, known_to) = self.operator.controller_time(self.operator.now() + ahead)?;
            self.record.start = Some(Start { at, known_to });
            start = Some(at);
            limit += ahead;
        }
        if let Judge::Throw { plan, .. } = self.order.judge {
            self.operator.expect_throw(plan.release_time_s);
        }
        let states = &mut self.record.states;
        let ended = self.operator.run(&name, start, limit, &mut |at, group| states.push((at, *group)));
        self.record.frames = (self.operator.frames_kept() - frames_before) as u64;
        ended?;
        if !throws {
            let rests = self.order.tolerances.goal_time.max(Duration::from_secs_f64(reach::REST_S));
            self.operator.pass(rests)?;
            self.operator.heed_stops()?;
        }
        self.end(&format!("{:.3} s", motion.duration_s()));
        Ok(())
    }

    fn watch_flight(&mut self, motion: &Motion) -> Result<(), JobError> {
        self.begin(Step::Flight)?;
        let flight_left = match self.order.judge {
            Judge::Throw { plan, .. } => plan.release_time_s + plan.landing.flight_s - motion.duration_s(),
            Judge::Follow { .. } | Judge::Reach => 0.0,
        };
        self.operator.pass(Duration::from_secs_f64(flight_left.max(0.0) + 0.05))?;
        self.observe();
        self.end(&match (self.record.ball, self.record.landing) {
            (BallOutcome::InHand, _) => "the ball is still in the hand".to_owned(),
            (_, Some(landing)) if landing.source.is_observed() => {
                format!("the ball came down {:.1} mm from the target", 1e3 * landing.error_m)
            }
            (BallOutcome::Released, _) => "the ball does not come down on the plane of the target".to_owned(),
            (BallOutcome::NotObserved, _) => "nobody watches the ball".to_owned(),
        });
        Ok(self.operator.heed_stops()?)
    }

    /// Data of an observer and of the samples.
    fn observe(&mut self) {
        let Self { operator, order, record, .. } = self;
        if order.judge.throws() {
            record.ball = watch_ball(*operator);
        }
        match &order.judge {
            Judge::Throw { plan, .. } => throw::observe(*operator, order, plan, record),
            Judge::Follow { .. } => follow::observe(*operator, order, record),
            Judge::Reach => reach::observe(*operator, order, record),
        }
        self.observed = true;
    }

    /// Gains, robot and period: written if the order requires it, read back, kept in the record.
    fn agree(&mut self) -> Result<(), JobError> {
        let Self { operator, order, record, .. } = self;
        record.period_us = operator.natural("cycle.period_us")?;
        let crc = order.robot_crc32;
        if order.travel.is_some() {
            operator.set_register("group.robot_crc32", &crc.into())?;
        }
        if let Some(file) = order.gains {
            let gains_us = (file.period_s * 1e6).round();
            if gains_us != record.period_us as f64 {
                return Err(JobError::Period { controller_us: record.period_us as f64, gains_us });
            }
            let wanted = order.arm.joints().len();
            if !file.joint.iter().map(|joint| joint.number).eq(1..=wanted) {
                let numbers: Vec<String> = file.joint.iter().map(|joint| joint.number.to_string()).collect();
                return Err(JobError::GainsJoints { found: numbers.join(", "), wanted });
            }
            file.check_robot(order.arm).map_err(JobError::GainsRobot)?;
            let mut wanted = settings_of(RegisterInfo::is_of_gains, &mut |name| operator.register(name))?;
            file.enter(crc, &mut wanted);
            for name in REGISTERS {
                let index = registers::find(&wanted, name).unwrap_or(usize::MAX);
                let numbers = registers::read(&wanted, index).map(|numbers| to_host(numbers.as_slice()));
                operator.set_register(
                    name,
                    &numbers.ok_or(OperatorError::NoRegister { name: name.to_owned() })?,
                )?;
            }
        }
        let held = settings_of(RegisterInfo::is_of_gains, &mut |name| operator.register(name))?;
        let joints = || held.joints().map(|joint| held.joint.at(joint));
        record.gains = [
            joints().map(|joint| joint.k_error_1_s2).collect(),
            joints().map(|joint| joint.k_rate_1_s).collect(),
            joints().map(|joint| joint.k_last).collect(),
        ];
        record.estimator = Some([held.estimator_alpha, held.estimator_beta]);
        record.certificate_crc32 = held.gains_certificate_crc32.into();
        record.certified = match order.gains {
            Some(file) => Certified::of(file),
            // Proving one anew takes longer than a robot that is led waits.
            None if held.gains_certificate_crc32 == 0 => None,
            None => built_in_of(&held).and_then(|file| Certified::of(&file)),
        };
        record.held = Some(held);
        record.drives = Some(drives_of(*operator)?);
        record.gripper_opening = Some(Duration::from_micros(operator.natural("gripper.opening_us")?));
        Ok(())
    }
}

/// As the controller knows its drives.
fn drives_of(operator: &mut dyn Operator) -> Result<Drives, JobError> {
    let unreadable = || JobError::Operator(OperatorError::NoRegister { name: "joint.address".to_owned() });
    let (Numbers::Natural(addresses), Numbers::Bit(inverted), Numbers::Real(offset_rad)) = (
        operator.register("joint.address")?,
        operator.register("joint.inverted")?,
        operator.register("joint.offset_rad")?,
    ) else {
        return Err(unreadable());
    };
    let address: Option<Vec<u8>> = addresses.iter().map(|n| u8::try_from(*n).ok()).collect();
    let offset_rad: Vec<f64> = offset_rad.into_iter().map(f64::from).collect();
    let address = address.filter(|all| [inverted.len(), offset_rad.len()] == [all.len(); 2]);
    Ok(Drives { address: address.ok_or_else(unreadable)?, inverted, offset_rad })
}

/// Follows the ball of a simulated cell until it has landed, or for [`BALL_MAX`] if it stays in the hand.
fn watch_ball(operator: &mut dyn Operator) -> BallOutcome {
    let until = operator.now() + BALL_MAX;
    loop {
        let now = operator.now();
        let Some(ball) = operator.ball() else { return BallOutcome::NotObserved };
        let left = match (ball.released_at, ball.landing) {
            (None, _) if now >= until => return BallOutcome::InHand,
            (None, _) => BALL_LOOK,
            (Some(_), None) => return BallOutcome::Released,
            (Some(at), Some((flight_s, _))) => {
                let landed_at = at + Duration::from_secs_f64(flight_s);
                if now >= landed_at {
                    return BallOutcome::Released;
                }
                landed_at.saturating_since(now).min(BALL_LOOK)
            }
        };
        // A link that has failed gives no data about the ball.
        if operator.pass(left).is_err() {
            return BallOutcome::NotObserved;
        }
    }
}
