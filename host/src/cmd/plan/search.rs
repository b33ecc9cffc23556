//! The search for one throw: its options, its progress on a terminal, and what is kept of it.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use nalgebra::{Vector2, Vector3};

use super::options::{PlanOptions, Starts, note, require_metres};
use crate::cmd::request::readers;
use crate::cmd::values::numbers;
use crate::error::ExpectedError;
use crate::exit;
use crate::tables::targets::TargetRow;
use operator::interrupt::interrupt;
use planner::flight::Course;
use planner::plan::file::PlanFile;
use planner::plan::problem::{Weights, short};
use planner::plan::release_delays::ReleaseNodes;
use planner::plan::statistics::{Noise, Region};
use planner::plan::{Budget, Goal, NoThrow, Obstruction, Options, Watch};
use planner::request::{self, Answer, Refusal, Request, Wanted};
use robot_model::RobotModel;

/// How to look for a throw.
#[derive(Debug, Clone, Default, clap::Args, serde::Deserialize)]
pub struct SearchOptions {
    #[command(flatten)]
    #[serde(rename = "+options")]
    pub options: PlanOptions,
    /// Random starts after the stored ones; all of them are made [default: up to 192, or up to 768 where none of this robot are stored; fewer
    /// if more are unlikely to find a better throw].
    /// With a seed and no time budget the result is always the same.
    #[arg(long, help_heading = "Search")]
    pub starts: Option<usize>,
    /// Stop starting after this many seconds.
    #[arg(long, alias = "time-budget", help_heading = "Search")]
    pub time_budget_s: Option<f64>,
    /// Radius of the disc about the target that counts as a hit, in m.
    #[arg(long, conflicts_with = "hit_box", help_heading = "Throws that are allowed")]
    pub hit_radius_m: Option<f64>,
    /// Half edges of the rectangle about the target that counts as a hit, in m.
    #[arg(long, value_name = "HX,HY", value_parser = numbers::<2>, help_heading = "Throws that are allowed")]
    pub hit_box: Option<[f64; 2]>,
    /// Standard deviation of the release time in s.
    #[arg(long, help_heading = "Flight")]
    pub jitter_s: Option<f64>,
    /// Measured delays of the gripper instead: a text file with one number per line, in ms from the order to the free ball. Their
    /// mean is what the controller allows for; the landing is predicted for their distribution about it.
    #[arg(long, value_name = "FILE", conflicts_with = "jitter_s", value_parser = release_nodes, help_heading = "Flight")]
    #[serde(default, deserialize_with = "release_nodes_of")]
    pub release_delays: Option<ReleaseNodes>,
    /// What to make small, under all limits; `hit` needs a region (--hit-radius-m or --hit-box).
    #[arg(long, value_enum, default_value = "effort", help_heading = "Search")]
    pub objective: ObjectiveName,
}

/// Who may stop a search, and who sees how far it is.
#[derive(Debug, Clone, Copy)]
pub enum Watcher<'a> {
    /// Ctrl-C stops it; progress and remarks go to standard error.
    Terminal,
    /// This flag stops it. Nothing is printed, and the signals of the process stay as they are.
    Program(&'a AtomicBool),
    /// The caller runs many searches. Its watch stops all of them. Nothing is printed.
    Caller(&'a Watch),
}

/// A throw that was found.
#[derive(Debug, Clone)]
pub struct Solved {
    pub plan: PlanFile,
    /// What was given up of what was asked for.
    pub note: Option<&'static str>,
    /// Whether stored throws were asked for and did not suffice.
    pub(super) searched: bool,
    /// Landings of disturbed throws, if any were asked for.
    pub(super) landings: Option<Landings>,
    /// Time of the search.
    pub took: Duration,
}

/// Landings of disturbed throws to a target (Monte Carlo).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Landings {
    /// Balls that came down on the plane of the target.
    pub(super) landed: u64,
    /// Of them, those in the region that counts as a hit; none without a region.
    pub(super) hits: Option<u64>,
    /// Root mean square distance of the landings from the target in m; none if no ball landed.
    pub(super) miss_rms_m: Option<f64>,
    pub(super) miss_max_m: Option<f64>,
}

/// Disturbed throws to draw.
#[derive(Debug, Clone, Copy)]
pub(in crate::cmd) struct Draws {
    pub(super) count: usize,
    pub(super) seed: u64,
}

/// Name of an objective.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ObjectiveName {
    /// The paper's: time, braking and jerk, with --weights.
    #[default]
    Effort,
    /// The duration of the motion alone.
    Time,
    /// The electrical energy from the supplies.
    Energy,
    /// The predicted root mean square distance of the landing from the target.
    Spread,
    /// The predicted odds against a hit of the region.
    Hit,
}

impl SearchOptions {
    /// The search with the usual options, for a robot among boxes.
    pub(in crate::cmd) fn usual(robot: &str, obstacle: &[[f64; 6]], starts: Option<usize>) -> Self {
        let options =
            PlanOptions { robot: robot.to_owned(), obstacle: obstacle.to_vec(), ..PlanOptions::default() };
        Self { options, starts, ..Self::default() }
    }

    fn region(&self) -> Result<Option<Region>, ExpectedError> {
        let positive = |v: f64| {
            if v > 0.0 && v.is_finite() {
                Ok(v)
            } else {
                Err(ExpectedError::bad_input(&format!("a hit region needs positive sizes, got {v} m")))
            }
        };
        match (self.hit_radius_m, self.hit_box) {
            (Some(r), _) => Ok(Some(Region::Disc { radius_m: positive(r)? })),
            (None, Some([x, y])) => Ok(Some(Region::Box { half_x_m: positive(x)?, half_y_m: positive(y)? })),
            _ => Ok(None),
        }
    }

    fn noise(&self) -> Result<Noise, ExpectedError> {
        let mut noise = Noise::default();
        if let Some(jitter) = self.jitter_s {
            let sensible = (0.0..=0.05).contains(&jitter);
            if !sensible {
                return Err(ExpectedError::bad_input(&format!(
                    "release jitter of {} s is outside 0 to 0.05 s",
                    short(jitter)
                )));
            }
            noise.release_time_s = jitter;
        }
        if let Some(nodes) = self.release_delays {
            noise.release_time_s = nodes.sigma_s();
            noise.release_nodes = Some(nodes);
        }
        Ok(noise)
    }

    fn goal(&self, noise: Noise, region: Option<Region>) -> Result<Goal, ExpectedError> {
        match (self.objective, region) {
            (ObjectiveName::Effort | ObjectiveName::Time, _) => Ok(Goal::Effort),
            (ObjectiveName::Energy, _) => Ok(Goal::Energy),
            (ObjectiveName::Spread, _) => Ok(Goal::Spread(noise)),
            (ObjectiveName::Hit, Some(region)) => Ok(Goal::Miss(noise, region)),
            (ObjectiveName::Hit, None) => Err(ExpectedError::bad_input(
                &"--objective hit needs to know what a hit is: add --hit-radius-m or --hit-box",
            )),
        }
    }

    /// Refuses options that make no sense together, for any target.
    ///
    /// # Errors
    /// Which, and what to do instead.
    pub(super) fn require_sound(&self) -> Result<(), ExpectedError> {
        if self.objective == ObjectiveName::Time && self.options.weights.is_some() {
            return Err(ExpectedError::bad_input(
                &"--objective time has no weights: leave out --weights, or leave out --objective",
            ));
        }
        if self.objective == ObjectiveName::Effort && self.options.weights == Some([0.0; 3]) {
            return Err(ExpectedError::bad_input(&"--weights 0,0,0: every throw costs nothing, so none is the best")
                .next("make one of them larger than 0 (the usual ones: --weights 15,20,0.01), or name another --objective"));
        }
        self.goal(self.noise()?, self.region()?).map(drop)
    }

    /// What is planned, in words: everything but target, robot and stored throws that a plan follows from.
    pub(super) fn in_words(&self) -> Result<String, ExpectedError> {
        let (region, noise) = (self.region()?, self.noise()?);
        let (goal, kept) = (self.goal(noise, region)?, self.options.kept());
        let (asked, starts, name) = (self.options.resolve(), self.starts, self.objective);
        Ok(format!("{asked:?} {kept:?} {name:?} {goal:?} {region:?} {noise:?} starts {starts:?}"))
    }

    /// The same options for a row of a list, whose own words count more.
    pub(super) fn with_target(&self, row: &TargetRow) -> Self {
        let mut own = self.clone();
        let o = &mut own.options;
        o.opening_normal = row.normal.or(o.opening_normal);
        o.opening_radius_m = row.radius_m.or(o.opening_radius_m);
        o.incidence_max_deg = row.incidence_max_deg.unwrap_or(o.incidence_max_deg);
        if let Some(velocity) = row.velocity_m_s {
            o.target_velocity = Course::new(&[velocity]);
            o.target_course = None;
        }
        own
    }

    /// The throw to `target` (m, world frame) from stored throws and random starts. With `fast` stored throws are enough, if one of
    /// them leads there.
    ///
    /// # Errors
    /// Options or target are refused, or no throw reaches the target: [`exit::NO_THROW`].
    pub(in crate::cmd) fn solve(
        &self,
        arm: &RobotModel,
        starts: &Starts,
        target: [f64; 3],
        (seed, fast): (u64, bool),
        watcher: Watcher<'_>,
        draws: Option<Draws>,
    ) -> Result<Solved, ExpectedError> {
        self.require_sound()?;
        require_metres(target)?;
        let (region, noise) = (self.region()?, self.noise()?);
        let goal = self.goal(noise, region)?;
        let time = match self.time_budget_s {
            None => None,
            Some(t) => Some(Duration::try_from_secs_f64(t).map_err(|_| {
                ExpectedError::bad_input(&format!("time budget of {} s is not a duration", short(t)))
            })?),
        };
        let count = self.starts.unwrap_or(Budget::default().starts);
        let budget = Budget { starts: count, all: self.starts.is_some(), time, seed };
        let mut asked = Options { goal, ..self.options.resolve() };
        if self.objective == ObjectiveName::Time {
            asked.weights = Weights { k_b: 0.0, k_j: 0.0, ..asked.weights };
        }
        let own = Watch::default();
        let watch = if let Watcher::Caller(watch) = watcher { watch } else { &own };
        let wanted = Wanted {
            robot: &self.options.robot,
            noise: &noise,
            region,
            draws: draws.map(|Draws { count, seed }| (count, seed)),
        };
        let request = Request {
            target: Vector3::from(target),
            options: &asked,
            kept: self.options.kept(),
            quick: fast.then_some(FAST_TRIES),
            budget,
        };
        let plan = || request.plan(arm, &starts.index, &wanted, watch);
        let planned = watched(watch, &budget, watcher, plan);
        let request::Planned {
            answer: Answer { given_up, best, searched, took },
            plan,
            region,
            centre,
            landings: found,
        } = planned.map_err(|refusal| match refusal {
            Refusal::NoThrow(e) => no_throw(&e),
            refusal @ Refusal::Options(_) => ExpectedError::bad_input(&refusal),
        })?;
        let stopped = best.interrupted && watch.stop.load(Ordering::Relaxed);
        if stopped && matches!(watcher, Watcher::Terminal) {
            console::note!("cubectl: stopped; this is the best of {} starts", best.starts);
        }
        let searched = fast && searched;
        if searched && matches!(watcher, Watcher::Terminal) {
            console::note!("cubectl: {}, in {:.2} s", NOT_FAST, took.as_secs_f64());
        }
        let landings = found.map(|found| landings(&found, &centre, region));
        let mut plan = plan.ok_or_else(|| {
            if asked.finger_release {
                ExpectedError::new(
                    exit::NO_THROW,
                    "the ball stays between the fingers in some openings that the noise allows",
                )
                .next(
                    "fingers that open faster or farther in [fingers] of the robot file, or leave \
                     --finger-release out",
                )
            } else {
                ExpectedError::new(
                    exit::BUG,
                    "the planned ball does not come down on the plane of the target",
                )
            }
        })?;
        plan.search.stored.clone_from(&starts.sources);
        let note = note(given_up);
        if let (Some(note), Watcher::Terminal) = (note, watcher) {
            console::note!("cubectl: {note}");
        }
        Ok(Solved { plan, note, searched, landings, took })
    }
}

/// Largest file of release delays.
const DELAYS_MAX_BYTES: u64 = 32 << 20;

readers! {
    release_nodes_of: release_nodes => ReleaseNodes;
}

/// Measured release delays of a file: one number of ms per line; empty lines and what follows a `#` are left out.
fn release_nodes(path: &str) -> Result<ReleaseNodes, String> {
    let text = toml_reader::read_text(Path::new(path), DELAYS_MAX_BYTES).map_err(|e| e.to_string())?;
    let mut delays_s = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let word = line.split('#').next().unwrap_or_default().trim();
        if word.is_empty() {
            continue;
        }
        let ms: f64 = word.parse().map_err(|_| {
            let next = "one number per line, ms from the order to open to the free ball";
            format!("line {}: \"{}\" is not a number; {next}", number + 1, excerpt(word))
        })?;
        delays_s.push(1e-3 * ms);
    }
    ReleaseNodes::of(&delays_s).map(|(_, nodes)| nodes).map_err(|e| e.to_string())
}

fn excerpt(word: &str) -> String {
    word.chars().take(20).collect()
}

/// Counts and distances of landings from the target, all in m in the plane of the target.
fn landings(found: &[Vector2<f64>], target: &Vector2<f64>, region: Option<Region>) -> Landings {
    let hit = |p: &Vector2<f64>| {
        let off = p - target;
        region.map(|region| match region {
            Region::Disc { radius_m } => off.norm() <= radius_m,
            Region::Box { half_x_m, half_y_m } => off.x.abs() <= half_x_m && off.y.abs() <= half_y_m,
        })
    };
    let hits = region.map(|_| found.iter().filter(|p| hit(p) == Some(true)).count() as u64);
    let squares_m2: f64 = found.iter().map(|p| (p - target).norm_squared()).sum();
    Landings {
        landed: found.len() as u64,
        hits,
        miss_rms_m: (!found.is_empty()).then(|| (squares_m2 / found.len() as f64).sqrt()),
        miss_max_m: found.iter().map(|p| (p - target).norm()).reduce(f64::max),
    }
}

/// What is said of a throw that `fast` asked stored throws for.
pub(super) const NOT_FAST: &str = "no stored throw led there; a search found this one";
/// Stored throws that `fast` tries.
const FAST_TRIES: usize = 6;

fn no_throw(e: &NoThrow) -> ExpectedError {
    if e.interrupted && e.nearest.is_none() {
        return ExpectedError::new(
            exit::INTERRUPTED,
            format!("stopped after {} starts without a throw; more starts may find one", e.starts),
        );
    }
    let in_reach = "choose a target in reach; `cubectl plan sweep` finds what is";
    let next = e.obstruction.as_deref().map_or(in_reach, Obstruction::next_step);
    ExpectedError::new(exit::NO_THROW, e.to_string()).next(next)
}

/// Runs a search that a watcher may stop; what was found by then is kept. On a terminal a progress bar appears after a second.
pub(super) fn watched<T: Send>(
    watch: &Watch,
    budget: &Budget,
    watcher: Watcher<'_>,
    work: impl FnOnce() -> T + Send,
) -> T {
    let progress = Progress {
        total: budget.starts as u64,
        template: "{bar:30} {pos}/{len} starts, {msg} solved, {elapsed}",
        show: &|bar| {
            let done = watch.done.load(Ordering::Relaxed) as u64;
            // The starts of the budget are made for each set of limits, and more of them without a table.
            bar.set_length(done.max(budget.starts as u64));
            bar.set_position(done);
            bar.set_message(watch.solved.load(Ordering::Relaxed).to_string());
        },
    };
    watched_with(watch, &progress, watcher, work)
}

/// What a progress bar shows.
pub(super) struct Progress<'a> {
    pub(super) total: u64,
    /// In the form of `indicatif`.
    pub(super) template: &'static str,
    /// Brings the bar up to date.
    pub(super) show: &'a (dyn Fn(&ProgressBar) + Sync),
}

/// Runs work that a watcher may stop through `watch`. On a terminal a progress bar appears after a second.
pub(super) fn watched_with<T: Send>(
    watch: &Watch,
    progress: &Progress<'_>,
    watcher: Watcher<'_>,
    work: impl FnOnce() -> T + Send,
) -> T {
    let ctrl_c;
    let (interrupt, shows) = match watcher {
        Watcher::Caller(_) => return work(),
        Watcher::Terminal => {
            ctrl_c = interrupt();
            (&*ctrl_c, true)
        }
        Watcher::Program(stop) => (stop, false),
    };
    let finished = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let began = Instant::now();
            let mut bar: Option<ProgressBar> = None;
            while !finished.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(20));
                if interrupt.load(Ordering::Relaxed) {
                    watch.stop.store(true, Ordering::Relaxed);
                }
                if shows && began.elapsed() > Duration::from_secs(1) {
                    let bar = bar.get_or_insert_with(|| {
                        let style = ProgressStyle::with_template(progress.template);
                        ProgressBar::new(progress.total)
                            .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
                    });
                    (progress.show)(bar);
                }
            }
            if let Some(bar) = bar {
                bar.finish_and_clear();
            }
        });
        let result = work();
        finished.store(true, Ordering::Relaxed);
        result
    })
}
