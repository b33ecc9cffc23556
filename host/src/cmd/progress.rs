//! What a person at the terminal reads during a job, and is asked.

use std::io::IsTerminal;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant as WallTime};

use indicatif::{ProgressBar, ProgressStyle};
use nalgebra::Vector3;

use operator::analysis::tracking::JointTracking;
use operator::bus::cycle_timing::CycleTiming;
use operator::bus::period::Choice;
use operator::interrupt::interrupt;
use operator::job::{Answer, Progress, Question, Record, Verdict};
use operator::port::Operator;
use planner::follow::plan::FollowPlan;
use planner::plan::file::PlanFile;
use tuner::gains::choose::GainsFrom;

use super::consent::Consent;
use super::last_look::LastLook;
use crate::error::ExpectedError;
use crate::exit;

/// How long a search for a throw that follows the flight takes as a rule.
pub(super) const USUAL_SEARCH: &str = "10 to 30 s";

/// Does `work`. A terminal shows meanwhile what it is, for how long already, and how long it takes as a rule. Lines that `work`
/// prints go through `suspend` of the bar.
pub fn while_working<T>(what: &str, usual: &str, work: impl FnOnce(&ProgressBar) -> T) -> T {
    let bar = ProgressBar::new_spinner().with_message(format!("{what}, as a rule {usual}"));
    if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {msg}") {
        bar.set_style(style);
    }
    // Nothing is drawn where standard error is no terminal.
    bar.enable_steady_tick(Duration::from_millis(200));
    let result = work(&bar);
    bar.finish_and_clear();
    result
}

/// What people see while it works.
pub(super) struct ProgressView {
    /// The results are printed as JSON, and nothing else is.
    pub(super) silent: bool,
    bar: ProgressBar,
    begun: WallTime,
    /// Time of each step by the wall, s.
    pub(super) wall_s: Vec<f64>,
}

impl ProgressView {
    pub(super) fn new(silent: bool) -> Self {
        Self { silent, bar: ProgressBar::hidden(), begun: WallTime::now(), wall_s: Vec::new() }
    }

    fn line(&self, what: &str, wall_s: f64, found: &str) {
        if !self.silent {
            self.bar.suspend(|| console::note!("{what:<20} {wall_s:7.3} s  {found}"));
        }
    }

    pub(super) fn planned(&self, plan: &PlanFile, took_s: f64) {
        let [x, y, z] = plan.target.position_m;
        let found = format!(
            "to ({x}, {y}, {z}) m in {:.2} s, released at {:.2} m/s",
            plan.end_time_s,
            Vector3::from(plan.release.velocity_m_s).norm()
        );
        self.line("plan", took_s, &found);
    }

    pub(super) fn following(&self, plan: &FollowPlan, took_s: f64) {
        let (points, release_s) = (plan.followed_points, plan.release_time_s);
        self.line(
            "plan",
            took_s,
            &format!("{points} points of the flight followed, release after {release_s:.3} s"),
        );
    }

    /// A motion that was planned.
    pub(super) fn way(&self, found: &str) {
        self.line("way", self.begun.elapsed().as_secs_f64(), found);
    }

    /// Says that a cycle of a program is over.
    pub(super) fn cycle(&self, cycle: u32, of: u32) {
        self.line("program", self.begun.elapsed().as_secs_f64(), &format!("cycle {cycle} of {of}"));
    }

    /// Says so if the gains were designed on the way.
    pub(super) fn gains(&self, choice: &Choice) {
        if choice.gains_from == GainsFrom::Designed {
            let (robot, ms) = (&choice.gains.robot, f64::from(choice.period_us) * 1e-3);
            self.line(
                "gains",
                0.0,
                &format!("designed and certified for {robot} at {ms} ms; kept in gains.toml"),
            );
        }
    }

    pub(super) fn timing(&self, choice: &Choice, timing: &CycleTiming) {
        let found = format!("{} ms ({}): {timing}", f64::from(choice.period_us) * 1e-3, choice.why);
        self.line("control period", operator::bus::cycle_timing::SPAN.as_secs_f64(), &found);
        self.line("", 0.0, &timing.granted.to_string());
    }

    pub(super) fn show(&mut self, progress: Progress<'_>) {
        match progress {
            Progress::Begin(step) => {
                self.begun = WallTime::now();
                if !self.silent && std::io::stderr().is_terminal() {
                    self.bar = ProgressBar::new_spinner().with_message(step.name());
                    self.bar.enable_steady_tick(Duration::from_millis(200));
                }
            }
            Progress::Part(done, all) => {
                self.bar.set_length(all as u64);
                self.bar.set_position(done as u64);
            }
            Progress::End(step, found) => {
                self.bar.finish_and_clear();
                let took_s = self.begun.elapsed().as_secs_f64();
                self.wall_s.push(took_s);
                self.line(step.name(), took_s, found);
            }
            Progress::May(_) => {}
        }
    }

    pub(super) fn quiet(&self) {
        self.bar.finish_and_clear();
    }

    /// The last lines: the verdict if it is good (else it is the error's text), tracking, and where the results are.
    pub(super) fn closing(&self, record: &Record, verdict: Option<&Verdict>, folder: &Path, begun: WallTime) {
        if self.silent {
            return;
        }
        if let Some(verdict) = verdict {
            console::line!("{}", verdict.text);
        }
        if let Some(analysis) = &record.analysis {
            let largest = |joint: &JointTracking| format!("{:.1}", 1e3 * joint.position_error_rad.max);
            let mrad: Vec<String> = analysis.joints.iter().map(largest).collect();
            console::line!("largest tracking errors {} mrad", mrad.join(" "));
            match &analysis.coverage {
                Some(coverage) => console::line!("{}", coverage.sentence()),
                None => console::line!("{}", operator::job::summary::NOT_COMPARED),
            }
        }
        console::line!("{:.2} s in all; results in {}", begun.elapsed().as_secs_f64(), folder.display());
    }
}

/// Time between two looks for the answer of a person.
const ANSWER_LOOK: protocol::Duration = protocol::Duration::from_millis(20);

/// The person at the terminal, and the tracker.
pub(super) struct Ui {
    pub(super) progress: ProgressView,
    pub(super) consent: Consent,
    /// What is asked before the first motion, and before a throw.
    pub(super) words: [&'static str; 2],
    pub(super) look: Option<LastLook>,
    /// The person has agreed to the throw; the tracker is looked at since.
    pub(super) agreed: bool,
}

impl Ui {
    /// Asks before anything moves; a stop of somebody else ends it.
    pub(super) fn agree(&mut self, operator: &mut dyn Operator) -> Result<(), ExpectedError> {
        loop {
            match self.answer(Progress::May(Question::Move)) {
                Answer::Yes => return Ok(()),
                Answer::No => {
                    return Err(ExpectedError::new(exit::INTERRUPTED, "not agreed; nothing has moved"));
                }
                Answer::Waiting => operator.pass(ANSWER_LOOK)?,
            }
            operator.heed_stops()?;
        }
    }

    pub(super) fn answer(&mut self, step: Progress<'_>) -> Answer {
        let question = match step {
            Progress::May(_) if interrupt().load(Ordering::Relaxed) => return Answer::No,
            Progress::May(question) => question,
            other => {
                self.progress.show(other);
                return Answer::Yes;
            }
        };
        if !self.agreed {
            let [before, throw] = self.words;
            let words = if question == Question::Throw { throw } else { before };
            match self.progress.bar.suspend(|| self.consent.look(words)) {
                Answer::Yes if question == Question::Throw => self.agreed = true,
                answer => return answer,
            }
        }
        self.look.as_mut().map_or(Answer::Yes, LastLook::answer)
    }
}
