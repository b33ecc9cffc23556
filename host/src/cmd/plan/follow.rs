//! `cubectl plan throw` for arms that follow the flight of the ball: industrial robots, and others with `--follow`.

use std::time::Instant;

use nalgebra::Vector3;
use planner::follow::best::{BestOptions, HandFreedom};
use planner::follow::found::{Found, NotFound};
use planner::follow::limits::{AXES, Arm, Axes, Limits};
use planner::follow::paper::{Criterion, PaperOptions, RampTiming};
use planner::follow::plan::FollowPlan;
use planner::follow::posture::reach_m;
use planner::follow::search::Search;
use planner::follow::setting::{CommandRange, PERIOD_S, Setting};
use planner::follow::verify::{Report, verify_commands};
use planner::plan::file::RobotId;
use planner::store::file::write_whole;

use super::args::Args;
use super::follow_options::{CriterionName, RampsName};
pub(crate) use super::follow_options::{REFINEMENTS, is_industrial};
use super::options::FormName;
use super::options::require_metres;
use crate::cmd::meaning::Deed;
use crate::cmd::progress::{USUAL_SEARCH, while_working};
use crate::error::ExpectedError;
use crate::exit;
use crate::report::follow as report;

/// Starts of the best form if no number is asked for.
const STARTS: usize = 64;

/// Programs of industrial robots pass commands up to 0.1 deg inside the ranges of the axes (`robots/kr16_2`).
const PROGRAM_INSIDE_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// Grid of the paper form over the reach of an arm [default resolution: 1.3].
pub(crate) fn paper_grid(arm: &Arm, resolution: Option<f64>) -> PaperOptions {
    let base_z_m = arm.fk(&Axes::zeros(6)).origin(0).z;
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

/// A verified plan.
pub(super) struct Followed {
    pub(super) plan: FollowPlan,
    limits: Limits,
    verdict: Report,
}

/// Plans, verifies, and writes what was asked for.
pub fn run(args: &Args, arm: &Arm) -> Result<(), ExpectedError> {
    let Followed { plan, limits, verdict } = plan(args, arm)?;
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

/// Plans and verifies; nothing is written or printed.
pub(super) fn plan(args: &Args, arm: &Arm) -> Result<Followed, ExpectedError> {
    let form = args.search.options.form;
    args.given.require_meaning(&[Deed::Following, form.search_of_following()])?;
    args.follow.checked()?;
    let source = args.follow.limit_source(arm, form);
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
    let setting =
        Setting { commands, lag_s, period_s, ..Setting::new(arm, Vector3::from(args.target), limits) };
    let search = search_of(args, arm);
    let began = Instant::now();
    let found = throw_for(&setting, &search)?;
    let took_s = began.elapsed().as_secs_f64();
    let id = RobotId::of(&args.search.options.robot, arm);
    let plan = FollowPlan::new(&setting, source, id, search.form(), &found, took_s);
    let verdict = verify_commands(arm, &limits, &commands, &plan);
    if let Some(finding) = verdict.findings.first() {
        return Err(ExpectedError::new(
            exit::BUG,
            format!("the verifier refuses the plan that was found: {finding}"),
        ));
    }
    Ok(Followed { plan, limits, verdict })
}

/// The throw to the target of a setting.
///
/// # Errors
/// The target is not finite or not in metres, or no throw leads there. In the second case the error names a target to which the
/// same search has found a throw.
pub(crate) fn throw_for(setting: &Setting<'_>, search: &Search) -> Result<Found, ExpectedError> {
    let target = setting.target;
    if !target.iter().all(|v| v.is_finite()) {
        return Err(ExpectedError::bad_input(&"the target needs three finite numbers"));
    }
    require_metres(target.into())?;
    let found = while_working("looking for a throw", USUAL_SEARCH, |_| search.plan(&spared(setting, search)));
    found.map_err(|none| {
        let next = while_working("looking for the nearest target with a plan", USUAL_SEARCH, |_| {
            next_step(setting, search, &none)
        });
        ExpectedError::new(exit::NO_THROW, none.to_string()).next(next)
    })
}

/// The setting with the limits that a search keeps.
fn spared<'m>(setting: &Setting<'m>, search: &Search) -> Setting<'m> {
    let limits = match search {
        Search::Paper(_) => setting.limits,
        Search::Best(_) => setting.limits.with_spare_for_commands(),
    };
    Setting { limits, ..*setting }
}

/// What to do where a search found nothing. A grid that finds nothing says little: the other form is asked for the same target.
fn next_step(setting: &Setting<'_>, search: &Search, none: &NotFound) -> String {
    let named =
        |p: Vector3<f64>| format!("the nearest target with a plan that was found is {},{},{}", p.x, p.y, p.z);
    match (search, none.nearest) {
        (_, Some(nearest)) => named(nearest),
        (Search::Best(_), None) => {
            "choose a target closer to the arm: none was found on the way to it, nor lower".to_owned()
        }
        (Search::Paper(_), None) => {
            let free =
                Search::Best(BestOptions { starts: 8, kicks: 0, points_max: 1, ..BestOptions::default() });
            let finds = match free.plan(&spared(setting, &free)) {
                Ok(_) => "a throw to this target is found".to_owned(),
                Err(none) => none.nearest.map_or_else(|| "nothing was found either".to_owned(), named),
            };
            format!("leave out --form paper: without a grid {finds}")
        }
    }
}
