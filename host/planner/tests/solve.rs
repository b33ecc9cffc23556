//! The local solver on problems in the plane, whose solutions are known in closed form: where it ends, and why.

use std::ops::Range;

use planner::solve::sqp::{Ended, Local, Settings, solve};
use planner::solve::{Row, Sink, Task, WIDTH, When};

/// The point nearest to (1, 2) in half planes a·x ≥ b, on a circle about the origin if there is one.
#[derive(Default)]
struct Nearest {
    half_planes: Vec<([f64; 2], f64)>,
    radius: Option<f64>,
    /// For a smaller x[0] the objective is not a number.
    defined_from: Option<f64>,
}

impl Task for Nearest {
    type Part = ();

    fn variables(&self) -> usize {
        2
    }
    fn numbers(&self) -> (usize, usize) {
        (1, self.half_planes.len())
    }
    fn angles(&self) -> Range<usize> {
        0..0
    }
    fn is_motion(&self, _: &Row) -> bool {
        true
    }
    fn rows<S: Sink>(&self, x: &Row, sink: &mut S) {
        let (dx, dy) = (x[0] - 1.0, x[1] - 2.0);
        let defined = self.defined_from.is_none_or(|from| x[0] >= from);
        sink.objective(if defined { dx * dx + dy * dy } else { f64::NAN }, |g| {
            g.add(0, 2.0 * dx);
            g.add(1, 2.0 * dy);
        });
        if let Some(radius) = self.radius {
            sink.eq(0, x[0] * x[0] + x[1] * x[1] - radius * radius, |g| {
                g.add(0, 2.0 * x[0]);
                g.add(1, 2.0 * x[1]);
            });
        }
        for (id, ([a, b], c)) in self.half_planes.iter().enumerate() {
            sink.ineq(id, a * x[0] + b * x[1] - c, |g| {
                g.add(0, *a);
                g.add(1, *b);
            });
        }
    }
    fn parts(&self) -> impl Iterator<Item = ((), When)> {
        std::iter::once(((), When::Always))
    }
    fn part_rows<S: Sink>(&self, (): (), x: &Row, sink: &mut S) {
        self.rows(x, sink);
    }
    fn bends(&self, (): (), k: usize) -> bool {
        k < 2
    }
    fn twice(&self, (): (), _: usize) -> bool {
        true
    }
}

fn run(task: &Nearest, start: [f64; 2], settings: &Settings) -> Local {
    let mut x = [0.0; WIDTH];
    x[..2].copy_from_slice(&start);
    solve(task, &x, settings, None)
}

fn assert_at(local: &Local, x: [f64; 2], objective: f64) {
    let off = (local.x[0] - x[0]).hypot(local.x[1] - x[1]);
    // A run ends when the next step would change the objective by 1e-10 or less. Here that is twice the squared distance to the solution.
    assert!(off < 1e-5 && (local.objective - objective).abs() < 1e-6, "{:?}", &local.x[..2]);
    assert!(local.is_feasible(Settings::default().feasibility), "{}", local.violation);
}

#[test]
fn a_run_that_has_converged_is_at_the_solution_and_says_so() {
    let settings = Settings::default();
    let free = run(&Nearest::default(), [-4.0, 9.0], &settings);
    assert_eq!(free.ended, Ended::Converged);
    assert_at(&free, [1.0, 2.0], 0.0);

    let beside = Nearest { half_planes: vec![([1.0, 0.0], 3.0)], ..Nearest::default() };
    let beside = run(&beside, [-4.0, 9.0], &settings);
    assert_eq!(beside.ended, Ended::Converged);
    assert_at(&beside, [3.0, 2.0], 4.0);

    // On the ray from the origin through (1, 2).
    let circle = Nearest { radius: Some(5.0), ..Nearest::default() };
    let round = run(&circle, [4.0, 1.0], &settings);
    assert_eq!(round.ended, Ended::Converged);
    let root = 5.0_f64.sqrt();
    assert_at(&round, [root, 2.0 * root], (5.0 - root).powi(2));
}

#[test]
fn constraints_that_contradict_each_other_end_as_infeasible_with_what_is_left() {
    let half_planes = vec![([1.0, 0.0], 1.0), ([-1.0, 0.0], 1.0)];
    let local = run(&Nearest { half_planes, ..Nearest::default() }, [5.0, 0.0], &Settings::default());
    assert_eq!(local.ended, Ended::Infeasible);
    // x ≥ 1 and x ≤ -1: no point violates both by less than 1.
    assert!(local.violation >= 1.0 - 1e-9 && !local.is_feasible(0.5), "{}", local.violation);
}

#[test]
fn a_run_out_of_steps_a_run_that_is_not_better_and_one_without_numbers_say_what_they_are() {
    let circle = Nearest { radius: Some(5.0), ..Nearest::default() };
    let short = Settings { iterations_max: 2, ..Settings::default() };
    assert_eq!(run(&circle, [40.0, -30.0], &short).ended, Ended::OutOfSteps);

    let beside = Nearest { half_planes: vec![([1.0, 0.0], 3.0)], ..Nearest::default() };
    let known = Settings { give_up_above: 3.5, ..Settings::default() };
    assert_eq!(run(&beside, [3.05, 2.05], &known).ended, Ended::NotBetter);
    let known = Settings { give_up_above: 4.1, ..Settings::default() };
    assert_eq!(run(&beside, [3.05, 2.05], &known).ended, Ended::Converged);

    let far = Settings { hopeless_above: 10.0, ..Settings::default() };
    assert_eq!(run(&beside, [-40.0, 0.0], &far).ended, Ended::Infeasible);

    let undefined = Nearest { defined_from: Some(0.0), ..Nearest::default() };
    assert_eq!(run(&undefined, [-1.0, 0.0], &Settings::default()).ended, Ended::Undefined);
}
