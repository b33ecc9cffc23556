//! The ball at the end of its flight, as rows use it.

use nalgebra::Vector3;
use robot_model::Jacobian;

use crate::flight::model::FlightState;
use crate::plan::layout::Layout;
use crate::plan::problem::Problem;
use crate::solve::Gradient;
use crate::throw::Throw;

/// The ball at the end of its flight, and what it depends on.
pub(super) struct Arriving<'c, const N: usize> {
    pub(super) end: &'c FlightState,
    pub(super) throw: &'c Throw<N>,
    pub(super) by_q: &'c Jacobian<N>,
    pub(super) jac: &'c Jacobian<N>,
}

impl<const N: usize> Arriving<'_, N> {
    /// Adds the gradient of a function of the velocity at the end (`by_v`) and of the time of flight (`by_f`, at a fixed
    /// velocity).
    pub(super) fn add_gradient<const D: usize>(
        &self,
        problem: &Problem<'_, N>,
        g: &mut Gradient<'_, D>,
        by_v: &Vector3<f64>,
        by_f: f64,
    ) {
        let var = Layout::<N>::VARIABLES;
        let by_v0 = self.end.v_by_v0.tr_mul(by_v);
        for k in 0..N {
            g.add(var.q + k, (0..3).map(|i| by_v0[i] * self.by_q[(i, k)]).sum());
            g.add(var.qd + k, (0..3).map(|i| by_v0[i] * self.jac[(i, k)]).sum());
        }
        g.add(var.f, by_v.dot(&problem.flight.acceleration(&self.end.v)) + by_f);
    }
}
