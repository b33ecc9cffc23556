//! The ball at the end of its flight, as rows use it.

use nalgebra::Vector3;
use robot_model::Jacobian;

use crate::flight::model::FlightState;
use crate::plan::problem::Problem;
use crate::solve::Gradient;
use crate::throw::Throw;

/// The ball at the end of its flight, and what it depends on.
pub(super) struct Arriving<'c> {
    pub(super) end: &'c FlightState,
    pub(super) throw: &'c Throw,
    pub(super) by_q: &'c Jacobian,
    pub(super) jac: &'c Jacobian,
}

impl Arriving<'_> {
    /// Adds the gradient of a function of the velocity at the end (`by_v`) and of the time of flight (`by_f`, at a fixed
    /// velocity).
    pub(super) fn add_gradient(
        &self,
        problem: &Problem<'_>,
        g: &mut Gradient<'_>,
        by_v: &Vector3<f64>,
        by_f: f64,
    ) {
        let var = problem.variables();
        let by_v0 = self.end.v_by_v0.tr_mul(by_v);
        for k in 0..problem.joints() {
            g.add(var.q + k, by_v0.dot(&self.by_q.linear(k)));
            g.add(var.qd + k, by_v0.dot(&self.jac.linear(k)));
        }
        g.add(var.f, by_v.dot(&problem.flight.acceleration(&self.end.v)) + by_f);
    }
}
