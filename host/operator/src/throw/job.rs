//! The steps of a throw, in order, for any operator.

use firmware::registers::{self, RegisterInfo};
use nalgebra::Vector3;
use protocol::Duration;
use protocol::cyphal::cubecell::group_state::State;
use robot_model::collision::Scene;

use super::approach::rest_to_rest;
use super::record::{BallOutcome, Landing, LandingSource};
pub use super::record::{Job, JobError, Record, Step};
use super::trajectory::{encode, robot_crc32};
use crate::analysis::coverage::Certified;
use crate::analysis::{Run, RunAnalysis, analyse};
use crate::dialogue::operator::OperatorError;
use crate::dialogue::registers::{Numbers, settings_of, to_host};
use crate::port::Operator;
use crate::samples::drives::Drives;
use planner::motion::Motion;
use planner::plan::Joints;
use tuner::gains::choose::built_in_of;
use tuner::gains::gains_file::REGISTERS;

/// Longest start-up of a controller.
const BOOT_MAX: Duration = Duration::from_secs(20);
/// Longest homing of a group.
const HOMING_MAX: Duration = Duration::from_secs(180);
/// Room after the planned end of a run.
const RUN_EXTRA: Duration = Duration::from_secs(5);

/// A ball that is still in the hand this long after the end of a run stays there.
const BALL_MAX: Duration = Duration::from_secs(1);
/// Time between two looks at the simulated ball.
const BALL_LOOK: Duration = Duration::from_millis(10);

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress<'a> {
    Begin(Step),
    /// Progress of the step: done, of all.
    Part(usize, usize),
    /// May it go on? Asked before the first motion, and with the arm at the start before the throw; again and again
    /// while the answer is [`Answer::Waiting`].
    May(Question),
    /// A step has ended, with its result as text.
    End(Step, &'a str),
}

/// What a person decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Question {
    /// The arm homes, or goes to the start of the throw.
    Move,
    /// The ball is thrown.
    Throw,
}

/// What a person has said so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    Yes,
    No,
    /// Nothing yet.
    Waiting,
}

/// The callback; its answer matters to [`Progress::May`] only. It does not wait: the job follows the bus meanwhile.
pub type OnProgress<'a> = &'a mut dyn FnMut(Progress<'_>) -> Answer;

/// Time between two looks for an answer.
const ANSWER_LOOK: Duration = Duration::from_millis(20);

/// Does the job; `record` holds what is known, however it ends.
///
/// # Errors
/// [`JobError`]; the arm stands.
pub fn run(
    operator: &mut dyn Operator,
    job: &Job<'_>,
    record: &mut Record,
    told: OnProgress<'_>,
) -> Result<(), JobError> {
    let ended = all_steps(operator, job, record, told);
    if ended.is_err() && record.ball == BallOutcome::NotObserved {
        // The ball may have left the hand before a stop, or leave it after: that is told too.
        record.ball = watch_ball(operator);
        record.analysis = analysed(operator, job, record);
        // Where nobody watches the ball, it has left the hand if the gripper was ordered to open.
        let release = record.analysis.as_ref().and_then(|analysis| analysis.release);
        let ordered = release.is_some_and(|release| release.gripper_ordered_t_s.is_some());
        if record.ball == BallOutcome::Released || (record.ball == BallOutcome::NotObserved && ordered) {
            record.landing = landing(operator, job, record.analysis.as_ref());
        }
    }
    ended
}

fn all_steps(
    operator: &mut dyn Operator,
    job: &Job<'_>,
    record: &mut Record,
    told: OnProgress<'_>,
) -> Result<(), JobError> {
    let mut steps = Steps { operator, record, told, may_move: false };
    let found = steps.find_drives(job.arm.n())?;
    steps.home(&found)?;
    steps.begin(Step::Gains)?;
    agree(steps.operator, job, steps.record)?;
    steps.end(if job.gains.is_some() { "written and read back" } else { "those of the controller" });

    let (throw, scene): (Motion, _) = (job.plan.motion.to_motion(), job.plan.scene());
    let before = Joints::from_slice(&steps.operator.pose()?);
    steps.operator.set_gripper(false)?;
    let approach =
        rest_to_rest(job.arm, &scene, (&before, &throw.start_rad()), job.approach_share, job.seed)?;
    if let Some(motion) = &approach {
        steps.begin(Step::Approach)?;
        steps.require(Question::Move)?;
        drive(steps.operator, job, steps.record.period_us, motion)?;
        steps.record.approach_s = Some(motion.duration_s());
        steps.end(&format!("{} legs, {:.1} s", motion.knots.len() - 1, motion.duration_s()));
    }
    steps.require(Question::Throw)?;
    steps.throw(job, &throw)?;
    steps.watch_flight(job, &throw)?;

    // A ball that hangs in an open hand may fall at any time: the arm stays where it is.
    if job.go_back && steps.record.ball != BallOutcome::InHand {
        let here = Joints::from_slice(&steps.operator.pose()?);
        let empty = Scene { ball_held: false, ..scene };
        if let Some(motion) = rest_to_rest(job.arm, &empty, (&here, &before), job.approach_share, job.seed)? {
            steps.begin(Step::Return)?;
            drive(steps.operator, job, steps.record.period_us, &motion)?;
            steps.end(&format!("{:.1} s", motion.duration_s()));
        }
    }
    Ok(())
}

/// Keeps the times of the steps.
struct Steps<'a, 'b> {
    operator: &'a mut dyn Operator,
    record: &'a mut Record,
    told: OnProgress<'b>,
    /// A motion was agreed to.
    may_move: bool,
}

impl Steps<'_, '_> {
    fn begin(&mut self, step: Step) -> Result<(), JobError> {
        self.record.at_work = Some((step, self.operator.now()));
        (self.told)(Progress::Begin(step));
        Ok(self.operator.heed_stops()?)
    }

    /// Waits for the answer of a person and for a stop.
    fn require(&mut self, question: Question) -> Result<(), JobError> {
        if question == Question::Move && std::mem::replace(&mut self.may_move, true) {
            return Ok(());
        }
        loop {
            let answer = (self.told)(Progress::May(question));
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
            (self.told)(Progress::End(step, found));
        }
    }

    /// The controller, and the joints whose drives it has found.
    fn find_drives(&mut self, robot: usize) -> Result<Vec<f64>, JobError> {
        self.begin(Step::Controller)?;
        self.record.node = self.operator.connect()?;
        let who = self.record.node.map_or("in this program".to_owned(), |node| node.get().to_string());
        self.end(&format!("controller {who}"));

        self.begin(Step::Drives)?;
        self.operator.wait_for(BOOT_MAX, &|state| !matches!(state, State::Boot | State::Fault))?;
        let found = self.operator.pose()?;
        if found.len() != robot {
            return Err(JobError::Joints { found: found.len(), robot });
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
            self.begin(Step::Home)?;
            self.require(Question::Move)?;
            let mask = !group.homed_mask & ((1 << found.len()) - 1) as u8;
            self.operator.home(mask, HOMING_MAX)?;
            self.end(&format!("{} joints found their zeros", mask.count_ones()));
        }
        Ok(())
    }

    fn throw(&mut self, job: &Job<'_>, throw: &Motion) -> Result<(), JobError> {
        self.begin(Step::Upload)?;
        let crc = robot_crc32(&job.plan.robot.fingerprint);
        let bytes = encode(throw, self.record.period_us as u32, crc, None)?;
        let told = &mut *self.told;
        let name = self.operator.upload(&bytes, &mut |done, all| {
            told(Progress::Part(done, all));
        })?;
        self.record.trajectory = Some(name);
        self.end(&format!("{} bytes, hash {:016x}", bytes.len(), name.trajectory_crc64));

        self.operator.keep_samples();
        self.begin(Step::Arm)?;
        self.operator.arm(&name)?;
        self.end("offered and confirmed");

        self.begin(Step::Throw)?;
        let frames_before = self.operator.frames_kept();
        self.record.before = self.operator.group();
        let limit = Duration::from_secs_f64(throw.duration_s()) + RUN_EXTRA;
        let states = &mut self.record.states;
        let ended = self.operator.run(&name, limit, &mut |at, group| states.push((at, *group)));
        self.record.frames = (self.operator.frames_kept() - frames_before) as u64;
        ended?;
        self.end(&format!("{:.3} s", throw.duration_s()));
        Ok(())
    }

    fn watch_flight(&mut self, job: &Job<'_>, throw: &Motion) -> Result<(), JobError> {
        self.begin(Step::Flight)?;
        let flight_left = job.plan.release_time_s + job.plan.landing.flight_s - throw.duration_s();
        self.operator.pass(Duration::from_secs_f64(flight_left.max(0.0) + 0.05))?;
        self.record.ball = watch_ball(self.operator);
        self.record.analysis = analysed(self.operator, job, self.record);
        let landing = landing(self.operator, job, self.record.analysis.as_ref());
        self.record.landing = landing;
        self.end(&match (self.record.ball, landing) {
            (BallOutcome::InHand, _) => "the ball is still in the hand".to_owned(),
            (_, Some(landing)) if landing.source.is_observed() => {
                format!("the ball came down {:.1} mm from the target", 1e3 * landing.error_m)
            }
            (BallOutcome::Released, _) => "the ball does not come down on the plane of the target".to_owned(),
            (BallOutcome::NotObserved, _) => "nobody watches the ball".to_owned(),
        });
        Ok(self.operator.heed_stops()?)
    }
}

/// Runs one motion to its end.
fn drive(
    operator: &mut dyn Operator,
    job: &Job<'_>,
    period_us: u64,
    motion: &Motion,
) -> Result<(), JobError> {
    let bytes = encode(motion, period_us as u32, robot_crc32(&job.plan.robot.fingerprint), None)?;
    let name = operator.upload(&bytes, &mut |_, _| {})?;
    operator.arm(&name)?;
    let limit = Duration::from_secs_f64(motion.duration_s()) + RUN_EXTRA;
    operator.run(&name, limit, &mut |_, _| {})?;
    Ok(())
}

/// Gains, robot and period: written where the job says so, read back, kept in the record.
fn agree(operator: &mut dyn Operator, job: &Job<'_>, record: &mut Record) -> Result<(), JobError> {
    record.period_us = operator.natural("cycle.period_us")?;
    let crc = robot_crc32(&job.plan.robot.fingerprint);
    operator.set_register("group.robot_crc32", &crc.into())?;
    if let Some(file) = job.gains {
        let gains_us = (file.period_s * 1e6).round();
        if gains_us != record.period_us as f64 {
            return Err(JobError::Period { controller_us: record.period_us as f64, gains_us });
        }
        if !file.joint.iter().map(|joint| joint.number).eq(1..=job.arm.n()) {
            let numbers: Vec<String> = file.joint.iter().map(|joint| joint.number.to_string()).collect();
            return Err(JobError::GainsJoints { found: numbers.join(", "), robot: job.arm.n() });
        }
        file.check_robot(job.arm).map_err(JobError::GainsRobot)?;
        let mut wanted = settings_of(RegisterInfo::is_of_gains, &mut |name| operator.register(name))?;
        file.enter(crc, &mut wanted);
        for name in REGISTERS {
            let index = registers::find(name).unwrap_or(usize::MAX);
            let numbers = registers::read(&wanted, index).map(|numbers| to_host(numbers.as_slice()));
            operator
                .set_register(name, &numbers.ok_or(OperatorError::NoRegister { name: name.to_owned() })?)?;
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
    record.certified = match job.gains {
        Some(file) => Certified::of(file),
        None => built_in_of(&held).and_then(|file| Certified::of(&file)),
    };
    record.held = Some(held);
    record.drives = Some(drives_of(operator)?);
    record.gripper_opening = Some(Duration::from_micros(operator.natural("gripper.opening_us")?));
    Ok(())
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

/// What the samples say of the run; `None` if it never began, or a joint was not heard.
fn analysed(operator: &mut dyn Operator, job: &Job<'_>, record: &Record) -> Option<RunAnalysis> {
    let run = Run {
        samples: &operator.take_samples(job.arm, record.drives.clone())?,
        plan: job.plan,
        arm: job.arm,
        start: None,
        gripper_opening: record.gripper_opening,
        certified: record.certified,
    };
    analyse(&run).ok()
}

/// Follows the ball of the simulated cell until it has landed, or for [`BALL_MAX`] if it stays in the hand.
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
        // A link that failed has told nothing about the ball so far.
        if operator.pass(left).is_err() {
            return BallOutcome::NotObserved;
        }
    }
}

/// Where the ball landed: the cell knows, or the measured motion says where it should.
fn landing(operator: &mut dyn Operator, job: &Job<'_>, analysis: Option<&RunAnalysis>) -> Option<Landing> {
    let target = Vector3::from(job.plan.meeting_m());
    if let Some(ball) = operator.ball() {
        let (_, position_m) = ball.landing?;
        let planned_log_s = analysis.map(|analysis| analysis.start_log_s + job.plan.release_time_s);
        return Some(Landing {
            source: LandingSource::Cell,
            position_m,
            error_m: (position_m - target).norm(),
            uncertainty_m: None,
            release_late_s: ball.released_at.zip(planned_log_s).map(|(free, s)| free.as_secs_f64() - s),
            touch_after_s: ball.touch_after_s,
        });
    }
    computed_landing(job, analysis?)
}

/// Where the measured motion sends the ball; `None` if it was not measured about the release, or the ball does not come
/// down on the plane of the target.
#[must_use]
pub fn computed_landing(job: &Job<'_>, analysis: &RunAnalysis) -> Option<Landing> {
    let release = analysis.release?;
    let position_m = Vector3::from(release.landing_m?);
    Some(Landing {
        source: LandingSource::Measured,
        position_m,
        error_m: release.landing_error_m?,
        uncertainty_m: release.landing_uncertainty_m,
        release_late_s: Some(release.t_s - job.plan.release_time_s),
        touch_after_s: None,
    })
}
