//! Joint torques from momentum: for each joint, the moment about its axis of `d/dt(momentum)` minus weight, summed over
//! all bodies behind it. Derivatives are differences in time along the plan.

use nalgebra::{Matrix3, Vector3};
use robot_model::{JointVec, RobotModel};

use super::chain::Chain;
use super::motion;
use crate::plan::file::PlanFile;

/// Step of the differences in s.
const DT: f64 = 1e-4;

/// Torques in N·m at `t_s`, which must be farther than 2e-4 s from every joint of two segments.
#[must_use]
pub fn torques(arm: &RobotModel, chain: &Chain, plan: &PlanFile, t_s: f64) -> JointVec {
    let at = |t: f64| chain.displacements(&motion::at(plan, t).q);
    let (before, now, after) = (at(t_s - DT), at(t_s), at(t_s + DT));
    let gravity = Vector3::new(0.0, 0.0, -arm.world().gravity_m_s2);
    let mut tau = JointVec::zeros(arm.n());
    for (i, link) in arm.links().iter().enumerate() {
        let inertia = &link.inertia;
        let place = |d| {
            let x = chain.link(d, i);
            (x.rot, x.transform_point(inertia.com_m()))
        };
        let ((r0, c0), (r1, c1), (r2, c2)) = (place(&before), place(&now), place(&after));
        let acceleration = (c2 - c1 * 2.0 + c0) / (DT * DT);
        // Angular momentum about the centre of mass, in the middle of each half step.
        let momentum = |ra: &Matrix3<f64>, rb: &Matrix3<f64>| {
            let spin = (rb - ra) * ((ra + rb) * 0.5).transpose() / DT;
            let w = Vector3::new(
                spin[(2, 1)] - spin[(1, 2)],
                spin[(0, 2)] - spin[(2, 0)],
                spin[(1, 0)] - spin[(0, 1)],
            ) * 0.5;
            let middle = (ra + rb) * 0.5;
            middle * inertia.about_com_kg_m2() * middle.transpose() * w
        };
        let moment = (momentum(&r1, &r2) - momentum(&r0, &r1)) / DT;
        let force = (acceleration - gravity) * inertia.mass_kg();
        for j in 0..=i {
            let (axis, point) = chain.axis(&now, j);
            tau[j] += axis.dot(&((c1 - point).cross(&force) + moment));
        }
    }
    // The ball in the hand, by itself: a point that the last link carries until the release.
    let mass_kg = arm.gripper().ball_mass_kg;
    if mass_kg > 0.0 && t_s <= plan.release_time_s {
        let at_m = (*arm.end_effector() * arm.gripper().x_eb).pos;
        let place = |d| chain.link(d, arm.n() - 1).transform_point(&at_m);
        let (p0, p1, p2) = (place(&before), place(&now), place(&after));
        let force = ((p2 - p1 * 2.0 + p0) / (DT * DT) - gravity) * mass_kg;
        for j in 0..arm.n() {
            let (axis, point) = chain.axis(&now, j);
            tau[j] += axis.dot(&(p1 - point).cross(&force));
        }
    }
    tau
}

/// Motor currents in A by eq. (9), if the robot file describes drives.
#[must_use]
pub fn motor_currents(arm: &RobotModel, qd: &JointVec, tau: &JointVec) -> Option<JointVec> {
    let drives = arm.drives()?;
    Some(JointVec::from_fn(arm.n(), |j| {
        drives[j].k_b_a_s_rad * qd[j].abs() + drives[j].k_m_a_nm * tau[j].abs()
    }))
}
