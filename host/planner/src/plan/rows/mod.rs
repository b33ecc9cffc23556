//! Objective and constraints of a throw as functions of the variables, with exact gradients.
//!
//! # Variables
//! `x = (q_r, q̇_r, F, h_a, h_b [, q̈_r] [, u])`: the joint state at the release, time of flight and the two
//! phases, in the best form the joint acceleration, and, in a search for the nearest reachable target, the shift
//! `u` of the target. Pose and twist of the release enter as equalities:
//!
//! ```text
//! p(F; p(q), J_v q̇) = target(F)   the ball is at the target after the time of flight (divided by F)
//! x_RF · v = y_RF · v = 0    the throw is along z of the release frame
//! x_RF · ω = y_RF · ω = 0    the hand turns only about the throw   (8 parameters; dropped for free spin)
//! dL/dδ = 0                  a late gripper does not move the landing   (our form)
//! ```
//!
//! # Map
//! `layout` of the parent folder has the place of each variable and each row.
//!
//! | module | rows |
//! |---|---|
//! | `spline` | objective, limits (2) to (6), bounds of the times |
//! | `kinematic` | launch, direction of the throw, release point, arrival; limits at instants of the motion |
//! | `arriving` | the ball at the end of its flight, as rows use it |
//! | `opening` | the ball passes through an opening |
//! | `delay` | landing of a late or early release |
//! | `current` | currents at the release |
//! | `goal` | the part of the objective that depends on the landing |
//!
//! Why the paper's `h` are not the variables: there, every evaluation solves the inverse kinematics, has eight
//! branches and no value if the pose is out of reach, and `q̇ = J⁻¹ [v0; ω]` grows without bound at the straight
//! wrist, near which the best throws are. Here all of (2) to (6) is polynomial, and infeasible points are ordinary
//! points.

mod arriving;
mod current;
mod delay;
mod goal;
mod kinematic;
mod opening;
mod spline;

use std::ops::Range;

use self::delay::{JITTER_S, delay_rows};
use self::goal::{goal_rows, has_goal};
use self::kinematic::{AtRelease, cut_rows, release_rows};
use self::spline::spline_rows;
use super::cuts::Cut;
use super::layout::{EQUALITIES, Layout};
use super::problem::Problem;
use crate::solve::{Row, Sink, Task, When};

/// Rows whose scaled value is above this cannot become active within one step and are left out.
const WINDOW: f64 = 0.8;

/// A throw as a task of the local solver: the problem, its variables and the instants that are checked.
pub(crate) struct ThrowTask<'t, 'a> {
    pub(crate) problem: &'t Problem<'a>,
    pub(crate) layout: Layout,
    pub(crate) cuts: &'t [Cut],
}

/// Rows that bend with the same variables.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Part {
    /// Functions of (q̇, h_a, h_b[, q̈]), linear in q.
    Spline,
    /// The landing; it does not depend on the time of flight but follows from the motion at the release.
    Goal,
    /// Functions of (q, q̇, F) at the release. Most are linear in q̇ (J q̇).
    Release,
    /// Functions of (q, q̇, q̈) at other instants: the landing of a late or early release, cuts. Without nulling their curvature
    /// along q̇ is left out.
    Motion,
}

impl ThrowTask<'_, '_> {
    /// Whether some rows at the release are nonlinear in the speeds or accelerations of the joints.
    fn release_bends_with_speed(&self) -> bool {
        let options = &self.problem.options;
        let arrival = &options.arrival;
        let of_arrival =
            arrival.speed_m_s.is_some() || arrival.descent_rad.is_some() || options.opening.is_some();
        self.layout.qdd && (of_arrival || !options.current_over_motion || !self.problem.flight.is_vacuum())
    }
}

impl Task for ThrowTask<'_, '_> {
    type Part = Part;

    fn variables(&self) -> usize {
        self.layout.n
    }

    fn numbers(&self) -> (usize, usize) {
        (EQUALITIES, self.problem.numbers().count)
    }

    fn angles(&self) -> Range<usize> {
        let var = self.layout.variables();
        var.q..var.qd
    }

    fn is_motion(&self, x: &Row) -> bool {
        let var = self.layout.variables();
        x[var.f] > 1e-3 && x[var.ha] > 1e-3 && x[var.hb] > 1e-3
    }

    fn rows<S: Sink>(&self, x: &Row, sink: &mut S) {
        let release = AtRelease::of(self.problem, &self.layout.throw(x));
        release_rows(self.problem, &self.layout, x, &release, sink);
        delay_rows(self.problem, &self.layout, x, &release.throw, sink);
        cut_rows(self.problem, &self.layout, self.cuts, &release, sink);
        spline_rows(self.problem, &self.layout, x, sink);
        goal_rows(self.problem, &self.layout, x, sink);
    }

    fn parts(&self) -> impl Iterator<Item = (Part, When)> {
        let goal = has_goal(self.problem, &self.layout).then_some((Part::Goal, When::Always));
        [(Part::Spline, When::Always)]
            .into_iter()
            .chain(goal)
            .chain([(Part::Release, When::WithMultipliers), (Part::Motion, When::WithMultipliers)])
    }

    fn part_rows<S: Sink>(&self, part: Part, x: &Row, sink: &mut S) {
        let (problem, layout) = (self.problem, &self.layout);
        match part {
            Part::Spline => spline_rows(problem, layout, x, sink),
            Part::Goal => goal_rows(problem, layout, x, sink),
            Part::Release => {
                release_rows(problem, layout, x, &AtRelease::of(problem, &layout.throw(x)), sink);
            }
            Part::Motion => {
                let throw = layout.throw(x);
                delay_rows(problem, layout, x, &throw, sink);
                let first = problem.numbers().cut;
                if (0..self.cuts.len()).any(|i| sink.wants(first + i)) {
                    cut_rows(problem, layout, self.cuts, &AtRelease::of(problem, &throw), sink);
                }
            }
        }
    }

    fn bends(&self, part: Part, k: usize) -> bool {
        let var = self.layout.variables();
        let of_state = k != var.ha && k != var.hb;
        match part {
            Part::Spline => k >= var.qd && k != var.f,
            Part::Goal => k != var.f,
            Part::Release => k < var.qd || k == var.f || of_state && self.release_bends_with_speed(),
            Part::Motion => k < var.qd || self.layout.qdd && of_state && k != var.f,
        }
    }

    fn twice(&self, part: Part, i: usize) -> bool {
        match part {
            // Linear in q: only its coupling is left, and it is not differenced along q.
            Part::Spline => i >= self.layout.variables().qd,
            Part::Goal => true,
            Part::Release | Part::Motion => self.bends(part, i),
        }
    }
}

/// Name of an inequality for people.
pub(crate) fn describe(problem: &Problem<'_>, id: usize, cuts: &[Cut]) -> String {
    let (n, number) = (problem.joints(), problem.numbers());
    let joint = |i: usize| problem.arm.joints()[i % n].name.clone();
    let end = |i: usize| if i < 2 * n { "start" } else { "stop" };
    if id < number.speed {
        let i = id - number.range;
        format!("range of {} at the {}", joint(i / 2), end(i))
    } else if id < number.acc_start {
        format!("speed of {}", joint((id - number.speed) / 2))
    } else if id < number.acc_stop {
        format!("acceleration of {} at the start", joint((id - number.acc_start) / 2))
    } else if id < number.acc_release {
        format!("acceleration of {} at the stop", joint((id - number.acc_stop) / 2))
    } else if id < number.jerk_a {
        format!("acceleration of {} at the release", joint((id - number.acc_release) / 2))
    } else if id < number.jerk_b {
        format!("jerk of {} before the release", joint((id - number.jerk_a) / 2))
    } else if id < number.peak {
        format!("jerk of {} after the release", joint((id - number.jerk_b) / 2))
    } else if id < number.turn {
        format!("speed of {} beside the release", joint(id - number.peak))
    } else if id < number.motor {
        format!("range of {} where it turns round", joint(id - number.turn))
    } else if id < number.supply {
        format!("current of {} at the release", joint(id - number.motor))
    } else if id < number.point {
        let name = problem.arm.supplies().get(id - number.supply).map_or("?", |s| s.name.as_str());
        format!("current of supply \"{name}\" at the release")
    } else if id < number.times {
        pick(&["release radius", "release elevation", "release azimuth"], (id - number.point) / 2)
    } else if id < number.spin {
        pick(&["time of flight", "duration", "braking ratio"], (id - number.times) / 2)
    } else if id < number.along {
        "spin of the hand".to_owned()
    } else if id < number.arrival {
        "direction of the throw".to_owned()
    } else if id < number.opening {
        "arrival".to_owned()
    } else if id < number.delay {
        pick(&["angle of incidence at the opening", "rim of the opening"], id - number.opening)
    } else if id < number.cut {
        let (what, i) = match id.checked_sub(number.through) {
            Some(i) => ("height of the flight", i),
            None => ("shift of the landing", id - number.delay),
        };
        let side = if i.is_multiple_of(2) { "late" } else { "early" };
        let delay_s = problem.options.delay_windows.get(i / 2).map_or(JITTER_S, |window| window.delay_s);
        format!("{what} when the gripper opens {:.0} ms {side}", delay_s * 1e3)
    } else if id == number.target_floor {
        "the floor".to_owned()
    } else {
        cuts.get(id.wrapping_sub(number.cut)).map_or_else(|| "target".to_owned(), |c| c.describe(problem))
    }
}

fn pick(names: &[&str], i: usize) -> String {
    names.get(i).copied().unwrap_or("?").to_owned()
}
