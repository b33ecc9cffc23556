//! Objective and constraints of a throw as functions of the variables, with exact gradients.
//!
//! # Variables
//! `x = (q_r, q̇_r, F, h_a, h_b [, q̈_r] [, u])`: the joint state at the release, time of flight and the two phases,
//! in our form the joint acceleration, and, when the nearest reachable target is looked for, the shift `u` of the
//! target. Pose and twist of the release enter as equalities:
//!
//! ```text
//! J_v q̇ = v0(p(q), F)        the ball leaves with the velocity that reaches the target
//! x_RF · v = y_RF · v = 0    the throw is along z of the release frame
//! x_RF · ω = y_RF · ω = 0    the hand turns only about the throw   (8 parameters; dropped for free spin)
//! dL/dδ = 0                  a late gripper does not move the landing   (our form)
//! ```
//!
//! # Map
//! | module | rows |
//! |---|---|
//! | `spline` | objective, limits (2) to (6), bounds of the times |
//! | `kinematic` | launch, direction of the throw, release point, arrival |
//! | `delay` | landing of a late or early release |
//! | `current` | currents at the release |
//! | `goal` | the part of the objective that looks at the landing |
//!
//! Why not the paper's `h` as variables: there, every evaluation solves the inverse kinematics, has eight branches
//! and no value where the pose is out of reach, and `q̇ = J⁻¹ [v0; ω]` blows up at the straight wrist on which the
//! best throws lie. Here all of (2) to (6) is polynomial, and infeasible points are just points.

mod current;
mod delay;
mod goal;
mod kinematic;
mod spline;

use nalgebra::Vector3;

pub(crate) use self::goal::{goal_rows, has_goal};
pub(crate) use self::kinematic::kinematic_rows;
pub(crate) use self::spline::spline_rows;
use super::cuts::Cut;
use super::problem::Problem;
use super::qp::{DIM, Row};
use crate::throw::{JOINTS, Joints, Throw};

/// First index of each group of variables.
pub(crate) const Q: usize = 0;
pub(crate) const QD: usize = 6;
pub(crate) const F: usize = 12;
pub(crate) const HA: usize = 13;
pub(crate) const HB: usize = 14;
pub(crate) const QDD: usize = 15;

/// Numbers of equalities and inequalities; a row keeps its number from evaluation to evaluation.
pub(crate) const EQUALITIES: usize = 9;
pub(crate) const CUTS_MAX: usize = 48;
const RANGE: usize = 0;
const SPEED: usize = 24;
const ACC_START: usize = 36;
const ACC_STOP: usize = 48;
const ACC_RELEASE: usize = 60;
const JERK_A: usize = 72;
const JERK_B: usize = 84;
const PEAK: usize = 96;
const TURN: usize = 108;
const MOTOR: usize = 120;
const SUPPLY: usize = 126;
const POINT: usize = 130;
const TIMES: usize = 136;
const SPIN: usize = 142;
const ALONG: usize = 144;
const ARRIVAL: usize = 145;
const DELAY: usize = 149;
/// Most limits of the landing's shift, each for late and for early release.
pub(crate) const DELAY_WINDOWS_MAX: usize = 4;
const CUT: usize = DELAY + 2 * DELAY_WINDOWS_MAX;
/// A target that may shift stays above the floor.
const TARGET_FLOOR: usize = CUT + CUTS_MAX;
/// Number of inequality numbers.
pub(crate) const INEQUALITIES: usize = TARGET_FLOOR + 1;

/// Rows whose scaled value is above this cannot become active within one step and are left out.
const WINDOW: f64 = 0.8;

/// Which variables a problem has beyond the first 15.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layout {
    pub(crate) n: usize,
    /// Whether q̈_r is free.
    pub(crate) qdd: bool,
    /// First index of the target's shift, if it is free, and which axes may shift.
    pub(crate) shift: Option<(usize, [bool; 3])>,
}

impl Layout {
    pub(crate) fn new(problem: &Problem<'_>, shift: Option<[bool; 3]>) -> Self {
        let qdd = problem.options.null_delay;
        let at = if qdd { QDD + JOINTS } else { QDD };
        let n = at + if shift.is_some() { 3 } else { 0 };
        Self { n, qdd, shift: shift.map(|axes| (at, axes)) }
    }

    pub(crate) fn throw(&self, x: &Row) -> Throw {
        Throw {
            q_rad: Joints::from_column_slice(&x[Q..Q + JOINTS]),
            qd_rad_s: Joints::from_column_slice(&x[QD..QD + JOINTS]),
            qdd_rad_s2: if self.qdd {
                Joints::from_column_slice(&x[QDD..QDD + JOINTS])
            } else {
                Joints::zeros()
            },
            flight_s: x[F],
            ha_s: x[HA],
            hb_s: x[HB],
        }
    }

    pub(crate) fn variables(&self, throw: &Throw) -> Row {
        let mut x = [0.0; DIM];
        x[Q..Q + JOINTS].copy_from_slice(throw.q_rad.as_slice());
        x[QD..QD + JOINTS].copy_from_slice(throw.qd_rad_s.as_slice());
        x[F] = throw.flight_s;
        x[HA] = throw.ha_s;
        x[HB] = throw.hb_s;
        if self.qdd {
            x[QDD..QDD + JOINTS].copy_from_slice(throw.qdd_rad_s2.as_slice());
        }
        x
    }

    pub(crate) fn target(&self, problem: &Problem<'_>, x: &Row) -> Vector3<f64> {
        let mut target = problem.target;
        if let Some((at, _)) = self.shift {
            target += Vector3::new(x[at], x[at + 1], x[at + 2]);
        }
        target
    }
}

/// Where a row adds its gradient, times a factor.
pub(crate) struct Gradient<'a> {
    pub(crate) row: &'a mut Row,
    pub(crate) factor: f64,
}

impl Gradient<'_> {
    #[inline]
    pub(crate) fn add(&mut self, i: usize, value: f64) {
        self.row[i] += self.factor * value;
    }
}

/// Receives the rows of an evaluation. Inequalities mean `value ≥ 0`.
pub(crate) trait Sink {
    /// Whether this inequality is of interest; asked before costly rows.
    fn wants(&self, id: usize) -> bool;
    /// Whether this equality is of interest.
    fn wants_eq(&self, id: usize) -> bool;
    /// A summand of the objective.
    fn objective(&mut self, value: f64, gradient: impl FnOnce(&mut Gradient<'_>));
    fn eq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>));
    fn ineq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>));
}

/// Name of an inequality for people.
pub(crate) fn describe(problem: &Problem<'_>, id: usize, cuts: &[Cut]) -> String {
    let joint = |i: usize| problem.arm.joints()[i % JOINTS].name.clone();
    match id {
        RANGE..SPEED => {
            let at = if (id - RANGE) / 12 == 0 { "start" } else { "stop" };
            format!("range of {} at the {at}", joint((id - RANGE) / 2))
        }
        SPEED..ACC_START => format!("speed of {}", joint((id - SPEED) / 2)),
        ACC_START..ACC_STOP => format!("acceleration of {} at the start", joint((id - ACC_START) / 2)),
        ACC_STOP..ACC_RELEASE => format!("acceleration of {} at the stop", joint((id - ACC_STOP) / 2)),
        ACC_RELEASE..JERK_A => format!("acceleration of {} at the release", joint((id - ACC_RELEASE) / 2)),
        JERK_A..JERK_B => format!("jerk of {} before the release", joint((id - JERK_A) / 2)),
        JERK_B..PEAK => format!("jerk of {} after the release", joint((id - JERK_B) / 2)),
        PEAK..TURN => format!("speed of {} beside the release", joint(id - PEAK)),
        TURN..MOTOR => format!("range of {} where it turns round", joint(id - TURN)),
        MOTOR..SUPPLY => format!("current of {} at the release", joint(id - MOTOR)),
        SUPPLY..POINT => {
            let name = problem.arm.supplies().get(id - SUPPLY).map_or("?", |s| s.name.as_str());
            format!("current of supply \"{name}\" at the release")
        }
        POINT..TIMES => ["release radius", "release radius", "release elevation", "release elevation"]
            .get(id - POINT)
            .unwrap_or(&"release azimuth")
            .to_string(),
        TIMES..SPIN => {
            ["time of flight", "time of flight", "duration", "duration", "braking ratio", "braking ratio"]
                [id - TIMES]
                .to_string()
        }
        SPIN..ALONG => "spin of the hand".to_owned(),
        ALONG => "direction of the throw".to_owned(),
        ARRIVAL..DELAY => "arrival".to_owned(),
        DELAY..CUT => {
            let (window, late) = ((id - DELAY) / 2, (id - DELAY).is_multiple_of(2));
            let side = if late { "late" } else { "early" };
            problem.options.delay_windows.get(window).map_or_else(String::new, |w| {
                format!("shift of the landing when the gripper opens {:.0} ms {side}", w.delay_s * 1e3)
            })
        }
        TARGET_FLOOR => "the floor".to_owned(),
        _ => cuts.get(id.wrapping_sub(CUT)).map_or_else(|| "target".to_owned(), |c| c.describe(problem)),
    }
}

/// Evaluates everything at `x`.
pub(crate) fn evaluate<S: Sink>(problem: &Problem<'_>, layout: &Layout, x: &Row, cuts: &[Cut], sink: &mut S) {
    kinematic_rows(problem, layout, x, cuts, sink);
    spline_rows(problem, layout, x, sink);
    goal_rows(problem, layout, x, sink);
}
