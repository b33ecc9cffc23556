//! A thing arrives with its axis of symmetry, or its angular momentum, near a wanted direction.

use nalgebra::Vector3;
use robot_model::Frames;

use super::WINDOW;
use super::arriving::Arriving;
use crate::plan::attitude::{angle_to, release_rotation};
use crate::plan::layout::Layout;
use crate::plan::options::Attitude;
use crate::plan::problem::Problem;
use crate::solve::Sink;

/// Where the angle has no derivative: at the wanted direction and opposite to it, in rad.
const SINE_MIN: f64 = 1e-4;
/// Rate in rad/s that keeps a thing at rest from dividing by zero.
const SLOW_RAD_S: f64 = 1e-3;

/// Angles of the axis and of the angular momentum, and the size of the latter. `omega_rad_s` is that of the hand, world.
pub(super) fn attitude_rows<S: Sink<D>, const N: usize, const D: usize>(
    problem: &Problem<'_, N>,
    frames: &Frames<N>,
    arriving: &Arriving<'_, N>,
    omega_rad_s: &Vector3<f64>,
    sink: &mut S,
) {
    let var = Layout::<N>::VARIABLES;
    let number = Layout::<N>::NUMBERS;
    let Some(attitude) = problem.options.attitude.filter(Attitude::is_asked) else { return };
    let released = release_rotation(problem.arm, &attitude, frames, omega_rad_s);
    let angular = |m: &robot_model::Jacobian<N>, k: usize| Vector3::new(m[(3, k)], m[(4, k)], m[(5, k)]);
    // Gradient of a function of the angular velocity and the axis at the release, and of the time of flight.
    let mut row = |id: usize, value: f64, by_omega: Vector3<f64>, by_axis: Vector3<f64>, by_flight: f64| {
        if value < WINDOW && sink.wants(id) {
            sink.ineq(id, value, |g| {
                for k in 0..N {
                    let turned = frames.axis(k).cross(&released.axis);
                    g.add(var.q + k, by_omega.dot(&angular(arriving.by_q, k)) + by_axis.dot(&turned));
                    g.add(var.qd + k, by_omega.dot(&angular(arriving.jac, k)));
                }
                g.add(var.f, by_flight);
            });
        }
    };
    if let Some(cone) = &attitude.axis {
        let end = released.state_at(arriving.throw.flight_s);
        let (angle, wanted) = angle_to(cone, &end.axis);
        let by_end = -wanted / wanted.cross(&end.axis).norm().max(SINE_MIN);
        // The angle shrinks where the value grows.
        row(
            number.attitude,
            cone.angle_max_rad - angle,
            -end.by_omega.tr_mul(&by_end),
            -end.by_axis.tr_mul(&by_end),
            -end.by_time.dot(&by_end),
        );
    }
    if let Some(cone) = &attitude.spin {
        let momentum = released.momentum_rad_s;
        let rate = momentum.norm();
        let size = rate.max(SLOW_RAD_S);
        let unit = momentum / size;
        let (angle, wanted) = angle_to(cone, &unit);
        let by_unit = -wanted / wanted.cross(&unit).norm().max(SINE_MIN);
        let by_momentum = (by_unit - unit * unit.dot(&by_unit)) / size;
        row(
            number.attitude + 1,
            cone.angle_max_rad - angle,
            -released.momentum_by_omega().tr_mul(&by_momentum),
            -released.momentum_by_axis().tr_mul(&by_momentum),
            0.0,
        );
        row(
            number.attitude + 2,
            rate - attitude.spin_min_rad_s,
            released.momentum_by_omega().tr_mul(&unit),
            released.momentum_by_axis().tr_mul(&unit),
            0.0,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::layout::width;
    use crate::plan::options::Cone;
    use crate::plan::paper::PaperParameters;
    use crate::plan::problem::Options;
    use crate::plan::rows::kinematic::{AtRelease, release_rows};
    use crate::solve::{Gradient, Row};
    use crate::throw::{Arm, Joints};

    const WIDE: usize = width(6);

    /// Takes the three rows of the attitude.
    struct Rows {
        value: [f64; 3],
        gradient: [Row<WIDE>; 3],
    }

    impl Sink<WIDE> for Rows {
        fn wants(&self, id: usize) -> bool {
            let first = Layout::<6>::NUMBERS.attitude;
            (first..first + 3).contains(&id)
        }
        fn wants_eq(&self, _: usize) -> bool {
            false
        }
        fn objective(&mut self, _: f64, _: impl FnOnce(&mut Gradient<'_, WIDE>)) {}
        fn eq(&mut self, _: usize, _: f64, _: impl FnOnce(&mut Gradient<'_, WIDE>)) {}
        fn ineq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_, WIDE>)) {
            let Some(at) = id.checked_sub(Layout::<6>::NUMBERS.attitude).filter(|at| *at < 3) else { return };
            self.value[at] = value;
            gradient(&mut Gradient { row: &mut self.gradient[at], factor: 1.0 });
        }
    }

    #[test]
    fn gradients_of_the_attitude_rows_match_differences() {
        let arm = Arm::load("powercube6").expect("built in");
        let h = PaperParameters::from_array([0.493, -0.465, 0.858, 0.583, -1.098, 0.586, 0.920, 0.06]);
        for (inertia_ratio, either_sign) in [(1.8, false), (0.05, true), (1.0, false)] {
            let cone = |x: f64, y: f64, z: f64| Cone {
                direction_w: Vector3::new(x, y, z),
                angle_max_rad: 0.2,
                either_sign,
            };
            let attitude = Attitude {
                axis_e: Vector3::new(0.2, -0.4, 0.9),
                inertia_ratio,
                axis: Some(cone(0.3, -1.0, -0.6)),
                spin: Some(cone(-0.8, 1.4, 0.5)),
                // Above what the hand has, so that the row counts.
                spin_min_rad_s: 50.0,
            };
            let options = Options { attitude: Some(attitude), ..Options::best() };
            let problem = Problem::new(&arm, Vector3::new(1.0, 1.0, -1.0), options).expect("valid");
            let layout = Layout::new(&problem, None);
            let mut throw = h.throws(&problem)[0].throw;
            throw.qd_rad_s += Joints::from_column_slice(&[0.5, -1.0, 0.7, 0.9, -0.7, 1.1]);
            let x = layout.variables(&throw);
            let at = |x: &Row<WIDE>| {
                let mut rows = Rows { value: [f64::NAN; 3], gradient: [[0.0; WIDE]; 3] };
                release_rows(&problem, &layout, x, &AtRelease::of(&problem, &layout.throw(x)), &mut rows);
                rows
            };
            let claimed = at(&x);
            assert!(claimed.value.iter().all(|v| *v < 0.0), "all three are violated: {:?}", claimed.value);
            for row in 0..3 {
                let largest = claimed.gradient[row].iter().fold(0.0_f64, |m, g| m.max(g.abs()));
                assert!(largest > 0.1, "row {row} has a gradient");
                for k in 0..layout.n {
                    let mut moved = x;
                    let eps = 1e-6;
                    moved[k] = x[k] + eps;
                    let after = at(&moved).value[row];
                    moved[k] = x[k] - eps;
                    let differenced = (after - at(&moved).value[row]) / (2.0 * eps);
                    assert!(
                        (claimed.gradient[row][k] - differenced).abs() < 1e-6 * largest.max(1.0),
                        "ratio {inertia_ratio}, row {row}, variable {k}: {} claimed, {differenced} by differences",
                        claimed.gradient[row][k]
                    );
                }
            }
        }
    }

    #[test]
    fn a_hand_that_does_not_rotate_leaves_finite_rows_and_no_spin() {
        let arm = Arm::load("powercube6").expect("built in");
        let up = Cone { direction_w: Vector3::z(), angle_max_rad: 0.2, either_sign: false };
        let attitude = Attitude {
            axis_e: Vector3::z(),
            inertia_ratio: 1.8,
            axis: Some(up),
            spin: Some(up),
            spin_min_rad_s: 1.0,
        };
        let options = Options { attitude: Some(attitude), ..Options::best() };
        let problem = Problem::new(&arm, Vector3::new(1.0, 1.0, -1.0), options).expect("valid");
        let layout = Layout::new(&problem, None);
        let h = PaperParameters::from_array([0.493, -0.465, 0.858, 0.583, -1.098, 0.586, 0.920, 0.06]);
        let mut throw = h.throws(&problem)[0].throw;
        throw.qd_rad_s = Joints::zeros();
        let mut rows = Rows { value: [f64::NAN; 3], gradient: [[0.0; WIDE]; 3] };
        release_rows(
            &problem,
            &layout,
            &layout.variables(&throw),
            &AtRelease::of(&problem, &throw),
            &mut rows,
        );
        assert!((rows.value[2] + 1.0).abs() < 1e-9, "at rest it lacks the whole rate: {:?}", rows.value);
        assert!(rows.gradient.iter().flatten().all(|g| g.is_finite()));
    }
}
