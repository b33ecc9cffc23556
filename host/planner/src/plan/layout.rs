//! Where each variable and each row of a throw of `N` joints stands.

use nalgebra::Vector3;
use robot_model::JointVec;

use super::options::DELAY_WINDOWS_MAX;
use super::problem::Problem;
use crate::flight::Aim;
use crate::solve::Row;
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

/// Width of rows for throws of `joints` joints: angles, speeds and accelerations, three times, three coordinates of a
/// shift of the target; a multiple of four.
pub(crate) const fn width(joints: usize) -> usize {
    (3 * joints + 6).next_multiple_of(4)
}

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
    const fn of(joints: usize) -> Self {
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
pub(crate) struct Layout<const N: usize> {
    pub(crate) n: usize,
    /// Whether q̈_r is free.
    pub(crate) qdd: bool,
    /// First index of the target's shift, if it is free, and which axes may shift.
    pub(crate) shift: Option<(usize, [bool; 3])>,
}

impl<const N: usize> Layout<N> {
    /// Where the variables stand.
    pub(crate) const VARIABLES: Variables =
        Variables { q: 0, qd: N, f: 2 * N, ha: 2 * N + 1, hb: 2 * N + 2, qdd: 2 * N + 3 };
    /// Where the inequalities stand.
    pub(crate) const NUMBERS: Numbers = Numbers::of(N);

    pub(crate) fn new(problem: &Problem<'_, N>, shift: Option<[bool; 3]>) -> Self {
        let qdd = problem.options.null_delay;
        let at = Self::VARIABLES.qdd + if qdd { N } else { 0 };
        let n = at + if shift.is_some() { 3 } else { 0 };
        Self { n, qdd, shift: shift.map(|axes| (at, axes)) }
    }

    pub(crate) fn throw<const D: usize>(&self, x: &Row<D>) -> Throw<N> {
        let var = Self::VARIABLES;
        Throw {
            q_rad: JointVec::from_column_slice(&x[var.q..var.q + N]),
            qd_rad_s: JointVec::from_column_slice(&x[var.qd..var.qd + N]),
            qdd_rad_s2: if self.qdd {
                JointVec::from_column_slice(&x[var.qdd..var.qdd + N])
            } else {
                JointVec::zeros()
            },
            flight_s: x[var.f],
            ha_s: x[var.ha],
            hb_s: x[var.hb],
        }
    }

    pub(crate) fn variables<const D: usize>(&self, throw: &Throw<N>) -> Row<D> {
        let var = Self::VARIABLES;
        let mut x = [0.0; D];
        x[var.q..var.q + N].copy_from_slice(throw.q_rad.as_slice());
        x[var.qd..var.qd + N].copy_from_slice(throw.qd_rad_s.as_slice());
        x[var.f] = throw.flight_s;
        x[var.ha] = throw.ha_s;
        x[var.hb] = throw.hb_s;
        if self.qdd {
            x[var.qdd..var.qdd + N].copy_from_slice(throw.qdd_rad_s2.as_slice());
        }
        x
    }

    /// The aim of a problem, moved by the shift of the target if that is free.
    pub(crate) fn aim<const D: usize>(&self, problem: &Problem<'_, N>, x: &Row<D>) -> Aim {
        self.shift
            .map_or(problem.aim, |(at, _)| problem.aim.shifted(&Vector3::new(x[at], x[at + 1], x[at + 2])))
    }

    /// The target at the planned release in m, with its shift if that is free.
    pub(crate) fn target<const D: usize>(&self, problem: &Problem<'_, N>, x: &Row<D>) -> Vector3<f64> {
        self.aim(problem, x).point_at(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check<const N: usize>() {
        let (var, number) = (Layout::<N>::VARIABLES, Layout::<N>::NUMBERS);
        assert_eq!(
            [var.q, var.qd, var.f, var.ha, var.hb, var.qdd],
            [0, N, 2 * N, 2 * N + 1, 2 * N + 2, 2 * N + 3]
        );
        // All variables with a free shift of the target fit into a row.
        assert!(width(N) >= var.qdd + N + 3 && width(N).is_multiple_of(4));
        let first = [
            (number.range, 4 * N),
            (number.speed, 2 * N),
            (number.acc_start, 2 * N),
            (number.acc_stop, 2 * N),
            (number.acc_release, 2 * N),
            (number.jerk_a, 2 * N),
            (number.jerk_b, 2 * N),
            (number.peak, 2 * N),
            (number.turn, 2 * N),
            (number.motor, N),
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
    fn variables_and_rows_of_four_to_seven_joints_do_not_overlap() {
        check::<4>();
        check::<5>();
        check::<6>();
        check::<7>();
        assert_eq!((width(6), Layout::<6>::VARIABLES.qdd), (24, 15));
    }
}
