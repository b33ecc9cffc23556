//! `cubectl plan throw` for arms that follow the flight of the ball: industrial robots, and others with `--follow`.

use std::time::Instant;

use nalgebra::Vector3;
use planner::follow::best::{BestOptions, HandFreedom};
use planner::follow::found::NotFound;
use planner::follow::limits::{AXES, Arm, Axes, LimitSource, Limits};
use planner::follow::nearest::feasible_target;
use planner::follow::paper::{Criterion, PaperOptions, RampTiming};
use planner::follow::plan::FollowPlan;
use planner::follow::search::Search;
use planner::follow::setting::{CommandRange, PERIOD_S, Setting};
use planner::follow::verify::verify;
use planner::plan::file::RobotId;
use planner::store::file::write_whole;
use planner::store::robot_fingerprint;

use super::options::{FormName, two_numbers};
use super::throw::Args;
use crate::error::ExpectedError;
use crate::exit;
use crate::report::follow as report;

/// Options of throws that follow the flight of the ball.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Following the flight (industrial robots, or --follow)")]
pub struct FollowOptions {
    /// Follow the flight of the ball while the gripper opens, with any six-joint arm [industrial robots: always].
    #[arg(long, help_heading = "Throws that follow the flight")]
    pub follow: bool,
    /// Throw in the ordinary way, with the release at one instant, also with an industrial robot.
    #[arg(long, conflicts_with = "follow", help_heading = "Throws that follow the flight")]
    pub no_follow: bool,
    /// First-order lag of the controller in ms: the commands lead by it, and are what is limited.
    #[arg(long, value_name = "MS", help_heading = "Throws that follow the flight")]
    pub lag_ms: Option<f64>,
    /// Time between two set points in ms: the cycle of the robot's controller [default: 12].
    #[arg(long = "period", value_name = "MS", help_heading = "Throws that follow the flight")]
    pub period_ms: Option<f64>,
    /// How far the hand may turn away from being across the flight, in degrees [best: 0].
    #[arg(long, value_name = "DEG", help_heading = "Throws that follow the flight")]
    pub tilt_max_deg: Option<f64>,
    /// Acceleration of the ramps in deg/s2 [default: that of the robot file].
    #[arg(long, value_name = "DEG_S2", help_heading = "Throws that follow the flight")]
    pub ramps_deg_s2: Option<f64>,
    /// Limits of acceleration and jerk [industrial robots: controller, others: robot-file].
    #[arg(long, value_enum, help_heading = "Throws that follow the flight")]
    pub limits: Option<LimitsName>,
    /// Resolution of the grid of the paper form; the time grows with its fifth power [default: 1.3].
    #[arg(long, help_heading = "Throws that follow the flight")]
    pub resolution: Option<f64>,
    /// How often the paper form halves the steps of its grid around the best releases [default: 5 for points, 0 for j2].
    #[arg(long, value_name = "TIMES", help_heading = "Throws that follow the flight")]
    pub refine: Option<u32>,
    /// Timing of the ramps in the paper form.
    #[arg(long, value_enum, help_heading = "Throws that follow the flight")]
    pub ramps: Option<RampsName>,
    /// What the paper form makes best.
    #[arg(long, value_enum, help_heading = "Throws that follow the flight")]
    pub criterion: Option<CriterionName>,
    /// Diagonal of W in the first criterion.
    #[arg(long, value_name = "W1,...,W6", value_parser = six_weights, help_heading = "Throws that follow the flight")]
    pub weights_w: Option<[f64; AXES]>,
    /// Diagonal of G in the second criterion.
    #[arg(long, value_name = "G1,G2", value_parser = two_numbers, help_heading = "Throws that follow the flight")]
    pub weights_g: Option<[f64; 2]>,
}

/// Name of a source of limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LimitsName {
    /// Cut-out of the simulated industrial controller: 2000 deg/s2 and 150 000 deg/s3.
    Controller,
    /// Accelerations and jerk of the robot file.
    RobotFile,
}

/// Name of the timing of ramps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum RampsName {
    /// All axes start and stop together.
    Synchronised,
    /// Every axis takes its own shortest time.
    Own,
}

/// Name of a criterion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum CriterionName {
    /// The smallest j2.
    J2,
    /// The most followed points.
    Points,
}

fn six_weights(text: &str) -> Result<[f64; AXES], String> {
    let weights: Vec<f64> = text
        .split(',')
        .map(|p| p.trim().parse::<f64>().map_err(|_| format!("\"{p}\" is not a number")))
        .collect::<Result<_, _>>()?;
    let count = weights.len();
    weights.try_into().map_err(|_| format!("{count} numbers, expected {AXES} separated by commas"))
}

/// Longest lag that is a lag and not a mistake, in ms.
const LAG_MAX_MS: f64 = 200.0;
/// Halvings of the grid of the paper form where it is to follow the most points, and the most that can be asked for.
pub(crate) const REFINEMENTS: u32 = 5;
const REFINEMENTS_MAX: u32 = 12;
/// Starts of the best form if no number is asked for.
const STARTS: usize = 64;

impl FollowOptions {
    /// Whether throws of this arm follow the flight: asked for, or an industrial robot for which nobody asks otherwise.
    pub fn apply_to(&self, arm: &Arm) -> bool {
        self.follow || (is_industrial(arm) && !self.no_follow)
    }

    fn limit_source(&self, arm: &Arm) -> LimitSource {
        match self.limits {
            Some(LimitsName::Controller) => LimitSource::ControllerModel,
            Some(LimitsName::RobotFile) => LimitSource::RobotFile,
            None if is_industrial(arm) => LimitSource::ControllerModel,
            None => LimitSource::RobotFile,
        }
    }

    /// The first option that only such throws have.
    pub fn first_given(&self) -> Option<&'static str> {
        let given = [
            (self.lag_ms.is_some(), "--lag-ms"),
            (self.period_ms.is_some(), "--period"),
            (self.tilt_max_deg.is_some(), "--tilt-max-deg"),
            (self.ramps_deg_s2.is_some(), "--ramps-deg-s2"),
            (self.resolution.is_some(), "--resolution"),
            (self.refine.is_some(), "--refine"),
            (self.limits.is_some(), "--limits"),
            (self.ramps.is_some(), "--ramps"),
            (self.criterion.is_some(), "--criterion"),
            (self.weights_w.is_some(), "--weights-w"),
            (self.weights_g.is_some(), "--weights-g"),
        ];
        given.into_iter().find(|(given, _)| *given).map(|(_, name)| name)
    }

    fn checked(&self) -> Result<(), ExpectedError> {
        let within = |name: &str, value: Option<f64>, least: f64, most: f64| match value {
            Some(v) if !(least..=most).contains(&v) => {
                Err(ExpectedError::bad_input(&format!("{name} {v} is outside {least} to {most}")))
            }
            _ => Ok(()),
        };
        within("--lag-ms", self.lag_ms, 0.0, LAG_MAX_MS)?;
        within("--period", self.period_ms, 1.0, 50.0)?;
        within("--tilt-max-deg", self.tilt_max_deg, 0.0, 60.0)?;
        within("--ramps-deg-s2", self.ramps_deg_s2, 1.0, 5000.0)?;
        within("--resolution", self.resolution, 0.2, 4.0)?;
        if let Some(refine) = self.refine.filter(|times| *times > REFINEMENTS_MAX) {
            return Err(ExpectedError::bad_input(&format!("--refine {refine} is above {REFINEMENTS_MAX}")));
        }
        let weights = self.weights_w.iter().flatten().chain(self.weights_g.iter().flatten());
        if let Some(w) = weights.into_iter().find(|w| !(**w >= 0.0 && w.is_finite())) {
            return Err(ExpectedError::bad_input(&format!("weight {w} is not zero or positive")));
        }
        Ok(())
    }
}

/// Whether the arm's own controller closes its loops (no drive modules) and its file has limits for following.
pub(crate) fn is_industrial(arm: &Arm) -> bool {
    arm.drives().is_none() && arm.joints().iter().any(|j| j.limits.a_follow_max_rad_s2.is_some())
}

/// Programs of industrial robots pass commands up to 0.1 deg inside the ranges of the axes (`robots/kr16_2`).
const PROGRAM_INSIDE_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// Limits for the search in a form, of those that commands must keep.
pub(crate) fn searched(limits: &Limits, form: FormName) -> Limits {
    match form {
        FormName::Paper => *limits,
        FormName::Best => limits.with_spare_for_commands(),
    }
}

/// Grid of the paper form over the reach of an arm [default resolution: 1.3].
pub(crate) fn paper_grid(arm: &Arm, resolution: Option<f64>) -> PaperOptions {
    let base_z_m = arm.fk(&Axes::zeros()).origin(0).z;
    PaperOptions::covering(reach_m(arm), base_z_m, arm.world().floor_z_m, resolution.unwrap_or(1.3))
}

/// The search that the options ask for.
fn search_of(args: &Args, arm: &Arm) -> Search {
    let follow = &args.follow;
    let (w, g) = (follow.weights_w.unwrap_or([1.0; AXES]), follow.weights_g.unwrap_or([1.0; 2]));
    match args.search.options.form {
        FormName::Paper => {
            let grid = paper_grid(arm, follow.resolution);
            let criterion = match follow.criterion {
                Some(CriterionName::Points) => Criterion::Points,
                _ => Criterion::J2,
            };
            // The paper has the grid alone.
            let usual = if criterion == Criterion::Points { REFINEMENTS } else { 0 };
            Search::Paper(PaperOptions {
                w,
                g,
                ramps: match follow.ramps {
                    Some(RampsName::Own) => RampTiming::Own,
                    _ => RampTiming::Synchronised,
                },
                criterion,
                refinements: follow.refine.unwrap_or(usual),
                ..grid
            })
        }
        FormName::Best => Search::Best(BestOptions {
            hand: match follow.tilt_max_deg {
                Some(deg) if deg > 0.0 => HandFreedom::Tilted(deg.to_radians()),
                _ => HandFreedom::TangentAndRoll,
            },
            starts: args.search.starts.unwrap_or(STARTS),
            seed: args.seed,
            w,
            g,
            ..BestOptions::default()
        }),
    }
}

/// A coarse search, to find the nearest target that has a plan.
fn coarse(search: &Search) -> Search {
    match search {
        Search::Paper(o) => {
            let fewer = |count: usize| (count * 2).div_ceil(3).max(2);
            let mut o = o.clone();
            for axis in [&mut o.radius_m, &mut o.height_m, &mut o.beta_deg] {
                axis.count = fewer(axis.count);
            }
            (o.places, o.rolls) = (fewer(o.places), fewer(o.rolls));
            Search::Paper(o)
        }
        Search::Best(o) => Search::Best(BestOptions { starts: 12, kicks: 0, draws: 8000, ..o.clone() }),
    }
}

/// Plans, verifies, and writes what was asked for.
///
/// # Errors
/// If input is refused, no throw reaches the target, or a file cannot be written.
pub fn run(args: &Args, arm: &Arm) -> Result<(), ExpectedError> {
    args.follow.checked()?;
    if let Some(option) = args.search.first_for_drive_modules() {
        return Err(ExpectedError::bad_input(&format!(
            "{option} has no meaning for a throw that follows the flight; leave it out (see the last group of \
             `cubectl plan throw --help`)"
        )));
    }
    let Some(target) = args.target else {
        return Err(ExpectedError::bad_input(&"name a target with --target"));
    };
    if !target.iter().all(|v| v.is_finite()) {
        return Err(ExpectedError::bad_input(&"the target needs three finite numbers"));
    }
    let source = args.follow.limit_source(arm);
    let mut limits = Limits::of(arm, source);
    if let Some(deg_s2) = args.follow.ramps_deg_s2 {
        limits = limits.with_ramps(deg_s2.to_radians());
    }
    let lag_s = args.follow.lag_ms.unwrap_or(0.0) * 1e-3;
    let period_s = args.follow.period_ms.map_or(PERIOD_S, |ms| 1e-3 * ms);
    let commands = if is_industrial(arm) {
        CommandRange::inside(&limits, PROGRAM_INSIDE_RAD)
    } else {
        CommandRange::default()
    };
    let setting = Setting { commands, lag_s, period_s, ..Setting::new(arm, Vector3::from(target), limits) };
    let search = search_of(args, arm);
    let began = Instant::now();
    let searching = Setting { limits: searched(&limits, args.search.options.form), ..setting };
    let found = search.plan(&searching).map_err(|none| no_throw(&none, &search, &searching))?;
    let took_s = began.elapsed().as_secs_f64();
    let id = RobotId {
        name: arm.name().to_owned(),
        source: args.search.options.robot.clone(),
        fingerprint: format!("{:016x}", robot_fingerprint(arm)),
    };
    let plan = FollowPlan::new(&setting, source, id, search.form(), &found, took_s);
    let verdict = verify(arm, &limits, &plan);
    if let Some(finding) = verdict.findings.first() {
        return Err(ExpectedError::new(
            exit::BUG,
            format!("the verifier refuses the plan that was found: {finding}"),
        ));
    }
    if let Some(path) = &args.out {
        write_whole(path, plan.to_json().as_bytes()).map_err(|e| ExpectedError::output(path, &e))?;
    }
    if let Some(path) = &args.report {
        let html = report::html(arm, &plan, &limits, &verdict);
        std::fs::write(path, html).map_err(|e| ExpectedError::output(path, &e))?;
    }
    if args.json {
        console::line!("{}", plan.to_json());
    } else {
        console::text!("{}", report::summary(arm, &plan, &limits, &verdict));
    }
    Ok(())
}

fn no_throw(none: &NotFound, search: &Search, setting: &Setting<'_>) -> ExpectedError {
    let quick = coarse(search);
    let near = feasible_target(&setting.target, setting.arm.world().floor_z_m, |target| {
        quick.plan(&setting.at(*target)).is_ok()
    });
    let next = match near {
        Some(p) => format!("the nearest target with a plan is about {:.2},{:.2},{:.2}", p.x, p.y, p.z),
        None => "choose a target closer to the arm: none was found on the way to it, nor lower".to_owned(),
    };
    ExpectedError::new(exit::NO_THROW, format!("{none}\n  next: {next}"))
}

/// Largest distance of the ball from the first joint, by the lengths of the links, in m.
fn reach_m(arm: &Arm) -> f64 {
    let links: f64 = arm.joints().iter().skip(1).map(|j| j.x_pj.pos.norm()).sum();
    links + (*arm.end_effector() * arm.gripper().x_eb).pos.norm()
}
