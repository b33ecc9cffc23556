//! Where each variable and each row of a throw stands.

use nalgebra::Vector3;
use robot_model::{JOINTS_MAX, JointVec};

use super::options::DELAY_WINDOWS_MAX;
use super::problem::Problem;
use crate::flight::Aim;
use crate::solve::{Row, WIDTH};
use crate::throw::Throw;

/// First index of each group of variables.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Variables {
    /// Joint angles at the release.
    pub(crate) q: usize,
    /// Joint speeds at the release.
    pub(crate) qd: usize,
    /// Time of flight.
    pub(crate) f: usize,
    /// Phase before the release.
    pub(crate) ha: usize,
    /// Phase after the release.
    pub(crate) hb: usize,
    /// Joint accelerations at the release, if they are free; else what comes next.
    pub(crate) qdd: usize,
}

impl Variables {
    /// Of a throw of `n` joints.
    #[inline]
    pub(crate) const fn of(n: usize) -> Self {
        Self { q: 0, qd: n, f: 2 * n, ha: 2 * n + 1, hb: 2 * n + 2, qdd: 2 * n + 3 }
    }
}

// Angles, speeds and accelerations, three times, three coordinates of a shift of the target.
const _: () = assert!(3 * JOINTS_MAX + 6 <= WIDTH, "a row has room for all variables");

/// Equalities: the ball leaves with the velocity that reaches the target (3).
pub(crate) const LAUNCH: usize = 0;
/// The throw is along z of the release frame (2).
pub(crate) const ACROSS: usize = LAUNCH + 3;
/// The hand turns only about the throw (2).
pub(crate) const TURNING: usize = ACROSS + 2;
/// A late gripper does not move the landing (2).
pub(crate) const SLOPE: usize = TURNING + 2;
/// Number of equalities.
pub(crate) const EQUALITIES: usize = SLOPE + 2;

/// Most cuts of one problem.
pub(crate) const CUTS_MAX: usize = 48;
/// Supplies with a row of their own.
pub(crate) const SUPPLIES_MAX: usize = 4;

/// First number of each group of inequalities; a row keeps its number from evaluation to evaluation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Numbers {
    /// Both ends of the range at the start, then at the stop: two numbers per joint each.
    pub(crate) range: usize,
    /// Speed at the release: two per joint, as the next five.
    pub(crate) speed: usize,
    pub(crate) acc_start: usize,
    pub(crate) acc_stop: usize,
    pub(crate) acc_release: usize,
    pub(crate) jerk_a: usize,
    pub(crate) jerk_b: usize,
    /// Speed beside the release: one per joint and phase.
    pub(crate) peak: usize,
    /// Range where a joint turns round: one per joint and phase.
    pub(crate) turn: usize,
    /// Motor currents at the release: one per joint.
    pub(crate) motor: usize,
    /// Supply currents at the release: [`SUPPLIES_MAX`].
    pub(crate) supply: usize,
    /// Radius, elevation, azimuth of the release point: two each.
    pub(crate) point: usize,
    /// Flight, duration, braking ratio: two each.
    pub(crate) times: usize,
    /// Spin of the hand: two.
    pub(crate) spin: usize,
    /// Direction of the throw.
    pub(crate) along: usize,
    /// Speed and steepness at the target: two each.
    pub(crate) arrival: usize,
    /// Angle and rim of an opening: one each.
    pub(crate) opening: usize,
    /// Shift of the landing: two per window.
    pub(crate) delay: usize,
    /// Speed of a late or early ball through the plane: two per window.
    pub(crate) through: usize,
    /// Cuts: [`CUTS_MAX`].
    pub(crate) cut: usize,
    /// A target that may shift stays above the floor.
    pub(crate) target_floor: usize,
    /// How many numbers there are.
    pub(crate) count: usize,
}

impl Numbers {
    /// Of a throw of `joints` joints.
    #[inline]
    pub(crate) const fn of(joints: usize) -> Self {
        let range = 0;
        let speed = range + 4 * joints;
        let acc_start = speed + 2 * joints;
        let acc_stop = acc_start + 2 * joints;
        let acc_release = acc_stop + 2 * joints;
        let jerk_a = acc_release + 2 * joints;
        let jerk_b = jerk_a + 2 * joints;
        let peak = jerk_b + 2 * joints;
        let turn = peak + 2 * joints;
        let motor = turn + 2 * joints;
        let supply = motor + joints;
        let point = supply + SUPPLIES_MAX;
        let times = point + 6;
        let spin = times + 6;
        let along = spin + 2;
        let arrival = along + 1;
        let opening = arrival + 4;
        let delay = opening + 2;
        let through = delay + 2 * DELAY_WINDOWS_MAX;
        let cut = through + 2 * DELAY_WINDOWS_MAX;
        let target_floor = cut + CUTS_MAX;
        Self {
            range,
            speed,
            acc_start,
            acc_stop,
            acc_release,
            jerk_a,
            jerk_b,
            peak,
            turn,
            motor,
            supply,
            point,
            times,
            spin,
            along,
            arrival,
            opening,
            delay,
            through,
            cut,
            target_floor,
            count: target_floor + 1,
        }
    }
}

/// Which variables a problem has beyond joint angles, joint speeds and times.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layout {
    joints: usize,
    /// How many variables there are.
    pub(crate) n: usize,
    /// Whether q̈_r is free.
    pub(crate) qdd: bool,
    /// First index of the target's shift, if it is free, and which axes may shift.
    pub(crate) shift: Option<(usize, [bool; 3])>,
}

impl Layout {
    pub(crate) fn new(problem: &Problem<'_>, shift: Option<[bool; 3]>) -> Self {
        let qdd = problem.options.null_delay;
        let joints = problem.joints();
        let at = Variables::of(joints).qdd + if qdd { joints } else { 0 };
        let n = at + if shift.is_some() { 3 } else { 0 };
        Self { joints, n, qdd, shift: shift.map(|axes| (at, axes)) }
    }

    /// Where the variables stand.
    #[inline]
    pub(crate) fn variables(&self) -> Variables {
        Variables::of(self.joints)
    }

    pub(crate) fn throw(&self, x: &Row) -> Throw {
        let (n, var) = (self.joints, self.variables());
        Throw {
            q_rad: JointVec::from_slice(&x[var.q..var.q + n]),
            qd_rad_s: JointVec::from_slice(&x[var.qd..var.qd + n]),
            qdd_rad_s2: if self.qdd {
                JointVec::from_slice(&x[var.qdd..var.qdd + n])
            } else {
                JointVec::zeros(n)
            },
            flight_s: x[var.f],
            ha_s: x[var.ha],
            hb_s: x[var.hb],
        }
    }

    pub(crate) fn row(&self, throw: &Throw) -> Row {
        let (n, var) = (self.joints, self.variables());
        let mut x = [0.0; WIDTH];
        x[var.q..var.q + n].copy_from_slice(&throw.q_rad);
        x[var.qd..var.qd + n].copy_from_slice(&throw.qd_rad_s);
        x[var.f] = throw.flight_s;
        x[var.ha] = throw.ha_s;
        x[var.hb] = throw.hb_s;
        if self.qdd {
            x[var.qdd..var.qdd + n].copy_from_slice(&throw.qdd_rad_s2);
        }
        x
    }

    /// The aim of a problem, moved by the shift of the target if that is free.
    pub(crate) fn aim(&self, problem: &Problem<'_>, x: &Row) -> Aim {
        self.shift
            .map_or(problem.aim, |(at, _)| problem.aim.shifted(&Vector3::new(x[at], x[at + 1], x[at + 2])))
    }

    /// The target at the planned release in m, with its shift if that is free.
    pub(crate) fn target(&self, problem: &Problem<'_>, x: &Row) -> Vector3<f64> {
        self.aim(problem, x).point_at(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(n: usize) {
        let (var, number) = (Variables::of(n), Numbers::of(n));
        assert_eq!(
            [var.q, var.qd, var.f, var.ha, var.hb, var.qdd],
            [0, n, 2 * n, 2 * n + 1, 2 * n + 2, 2 * n + 3]
        );
        // All variables with a free shift of the target fit into a row.
        assert!(var.qdd + n + 3 <= WIDTH);
        let first = [
            (number.range, 4 * n),
            (number.speed, 2 * n),
            (number.acc_start, 2 * n),
            (number.acc_stop, 2 * n),
            (number.acc_release, 2 * n),
            (number.jerk_a, 2 * n),
            (number.jerk_b, 2 * n),
            (number.peak, 2 * n),
            (number.turn, 2 * n),
            (number.motor, n),
            (number.supply, SUPPLIES_MAX),
            (number.point, 6),
            (number.times, 6),
            (number.spin, 2),
            (number.along, 1),
            (number.arrival, 4),
            (number.opening, 2),
            (number.delay, 2 * DELAY_WINDOWS_MAX),
            (number.through, 2 * DELAY_WINDOWS_MAX),
            (number.cut, CUTS_MAX),
            (number.target_floor, 1),
        ];
        let mut at = 0;
        for (begin, count) in first {
            assert_eq!(begin, at, "groups follow each other without gap and overlap");
            at += count;
        }
        assert_eq!(number.count, at);
    }

    #[test]
    fn variables_and_rows_of_any_number_of_joints_do_not_overlap() {
        (1..=JOINTS_MAX).for_each(check);
        assert_eq!(Variables::of(6).qdd, 15);
    }
}
