//! One start: from a point of the search space to a throw that keeps every limit at every instant, or to a reason.

use nalgebra::Vector3;

use super::cuts::Cut;
use super::layout::{CUTS_MAX, LAUNCH, Layout};
use super::problem::Problem;
use super::rows::{ThrowTask, describe};
use super::scan::Scanner;
use crate::solve::sqp::{self, Local, Multipliers, Settings};
use crate::throw::Throw;

/// A feasible throw and its price.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    pub throw: Throw,
    /// What the search makes small, see [`super::Goal`]; objective (1) by default.
    pub objective: f64,
    /// Steps of the local solver, all rounds together.
    pub iterations: usize,
    /// How the objective changes with the target, in 1/m.
    pub slope_per_m: Vector3<f64>,
    /// Whether a clearance or a current over the motion had to be kept by a row of its own.
    pub touches: bool,
}

/// What is known about a start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Begin {
    Anywhere {
        /// Whether a start that runs into a collision begins once more with its rows.
        again: bool,
    },
    /// As `Anywhere`, of an arm at rest: its contacts show nothing about the motion.
    Rest { again: bool },
    /// It is the best throw to a target near this one.
    Optimal {
        /// As [`Found::touches`].
        touches: bool,
    },
}

/// Why a start ended without a throw.
#[derive(Debug, Clone, PartialEq)]
pub struct Blocked {
    /// Largest violation left, scaled.
    pub violation: f64,
    /// The constraint that resisted most.
    pub constraint: String,
}

/// Rounds of solving and looking along the motion.
const ROUNDS_MAX: usize = 12;
/// A throw whose scaled rows are violated by no more than this is feasible; the exact checks decide afterwards.
pub(crate) const FEASIBLE: f64 = 1e-7;

/// Solves locally from a throw, in at most `iterations_max` steps of all rounds together.
pub(crate) fn solve_from(
    problem: &Problem<'_>,
    scanner: &Scanner,
    start: &Throw,
    begin: Begin,
    settings: &Settings,
    iterations_max: usize,
) -> Result<Found, Blocked> {
    let layout = Layout::new(problem, None);
    let mut x = layout.row(start);
    let mut cuts: Vec<Cut> = Vec::new();
    let mut iterations = 0;
    // The first round has no collision rows and may end deep inside a body, from where the rows lead nowhere. The
    // start is outside more often: with the rows that were found from there it stays outside.
    let mut may_begin_again = matches!(begin, Begin::Anywhere { again: true } | Begin::Rest { again: true });
    let mut multipliers = None;
    // Without rows for bodies near the start, the first round ends inside them, and from there the rows lead elsewhere.
    if matches!(begin, Begin::Anywhere { .. } | Begin::Optimal { touches: true }) {
        let scan = scanner.scan(problem, start);
        add(&mut cuts, &scan.cuts);
        add(&mut cuts, &scan.near);
    }
    if let Begin::Optimal { .. } = begin {
        multipliers = sqp::multipliers_at(&ThrowTask { problem, layout, cuts: &cuts }, &x);
    }
    for _ in 0..ROUNDS_MAX {
        let left = Settings {
            iterations_max: settings.iterations_max.min(iterations_max.saturating_sub(iterations)),
            ..*settings
        };
        let local: Local =
            sqp::solve(&ThrowTask { problem, layout, cuts: &cuts }, &x, &left, multipliers.take());
        iterations += local.iterations;
        if !local.is_feasible(FEASIBLE) {
            if may_begin_again && !cuts.is_empty() {
                may_begin_again = false;
                x = layout.row(start);
                continue;
            }
            return Err(Blocked {
                violation: local.violation,
                constraint: blocking(problem, &local.multipliers, &cuts),
            });
        }
        if local.objective > settings.give_up_above {
            return Err(Blocked { violation: 0.0, constraint: "a better throw is known".to_owned() });
        }
        x = local.x;
        let throw = layout.throw(&x);
        let scan = scanner.scan(problem, &throw);
        if scan.cuts.is_empty() {
            let slope_per_m = slope(&throw, &local.multipliers);
            let touches = !cuts.is_empty();
            return Ok(Found { throw, objective: local.objective, iterations, slope_per_m, touches });
        }
        if !add(&mut cuts, &scan.cuts) {
            break;
        }
        multipliers = Some(local.multipliers);
    }
    let constraint = cuts.last().map_or_else(String::new, |c| c.describe(problem));
    Err(Blocked { violation: f64::INFINITY, constraint })
}

/// Evaluates all rows of a throw with gradients once; the largest violation.
pub(crate) fn evaluate_once(problem: &Problem<'_>, throw: &Throw) -> f64 {
    let layout = Layout::new(problem, None);
    sqp::evaluate_once(&ThrowTask { problem, layout, cuts: &[] }, &layout.row(throw))
}

/// `dJ/d(target) = -λᵀ ∂c/∂(target)`; the target enters through the launch rows only, over the time of flight.
fn slope(throw: &Throw, multipliers: &Multipliers) -> Vector3<f64> {
    Vector3::from_column_slice(&multipliers.eq[LAUNCH..LAUNCH + 3]) / throw.flight_s
}

/// The point nearest to the target that a throw can reach, looked for from one start.
#[derive(Debug, Clone, PartialEq)]
pub struct Nearest {
    /// The throw that reaches it.
    pub throw: Throw,
    /// Shift of the target in m.
    pub shift_m: Vector3<f64>,
    /// The constraint that blocks the rest of the way.
    pub constraint: String,
}

/// Moves the target along `axes` by as little as makes it reachable.
pub(crate) fn nearest_from(
    problem: &Problem<'_>,
    scanner: &Scanner,
    start: &Throw,
    axes: [bool; 3],
    settings: &Settings,
) -> Result<Nearest, Blocked> {
    let layout = Layout::new(problem, Some(axes));
    let mut x = layout.row(start);
    let mut cuts: Vec<Cut> = Vec::new();
    for _ in 0..ROUNDS_MAX {
        let local: Local = sqp::solve(&ThrowTask { problem, layout, cuts: &cuts }, &x, settings, None);
        let constraint = blocking(problem, &local.multipliers, &cuts);
        if !local.is_feasible(FEASIBLE) {
            return Err(Blocked { violation: local.violation, constraint });
        }
        x = local.x;
        let throw = layout.throw(&x);
        let scan = scanner.scan(problem, &throw);
        if scan.cuts.is_empty() {
            let shift_m = layout.target(problem, &x) - problem.target;
            return Ok(Nearest { throw, shift_m, constraint });
        }
        if !add(&mut cuts, &scan.cuts) {
            break;
        }
    }
    let constraint = cuts.last().map_or_else(String::new, |c| c.describe(problem));
    Err(Blocked { violation: f64::INFINITY, constraint })
}

/// The constraint with the largest multiplier.
pub(crate) fn blocking(problem: &Problem<'_>, multipliers: &Multipliers, cuts: &[Cut]) -> String {
    let largest = multipliers
        .ineq
        .iter()
        .enumerate()
        .fold((0, 0.0), |best, (id, m)| if *m > best.1 { (id, *m) } else { best });
    describe(problem, largest.0, cuts)
}

/// Adds the findings of a scan; false if there is no room left.
pub(crate) fn add(cuts: &mut Vec<Cut>, found: &[Cut]) -> bool {
    for cut in found {
        let near = cuts.iter().position(|c| c.kind == cut.kind && (c.sigma - cut.sigma).abs() < 0.012);
        match near {
            Some(at) => cuts[at].sigma = cut.sigma,
            None if cuts.len() < CUTS_MAX => cuts.push(*cut),
            None => return false,
        }
    }
    true
}
