//! Inverse kinematics of a point and a direction, the roll about the direction left free.
//!
//! The point lies on the axis of the last joint and the direction is that axis, as with a cup or a drill.

use nalgebra::Vector3;

use crate::family::Family;
use crate::ik_solution::Branch;
use crate::mat3;
use crate::model::RobotModel;
use crate::per_joint::JointVec;

/// A tool point farther from the last axis than this is not on it, m.
const ON_LAST_AXIS_M: f64 = 1e-6;

/// A tool on the axis of the last joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisTool {
    /// From the wrist centre to the tool point along the tool axis, m.
    pub length_m: f64,
    /// +1 where the tool axis is the axis of the last joint, -1 where it is against it.
    sign: f64,
}

impl RobotModel {
    /// The tool whose point is `ahead_m` from the end effector along its z axis; `None` for families other than
    /// ortho-parallel, and if that axis is not the axis of the last joint.
    #[must_use]
    pub fn axis_tool(&self, ahead_m: f64) -> Option<AxisTool> {
        let Family::OrthoParallel(arm) = self.family() else { return None };
        let point_n = self.x_ne.transform_point(&Vector3::new(0.0, 0.0, ahead_m)) - arm.wrist_centre_n;
        let z_n = self.x_ne.rot.column(2);
        let on_axis = point_n.x.hypot(point_n.y) <= ON_LAST_AXIS_M && z_n.x.hypot(z_n.y) <= ON_LAST_AXIS_M;
        on_axis.then(|| AxisTool { length_m: point_n.z * z_n.z.signum(), sign: z_n.z.signum() })
    }

    /// Calls `found` with each posture that brings the tool point to `p_w` (m) and the tool axis along the unit vector `axis_w`,
    /// with joints 1 to 5 inside `[low, high]` (rad). Joint 6 stays at `low[5]`. Straight wrists are left out.
    ///
    /// Does nothing for an arm of another family than the tool's.
    #[inline]
    pub fn ik_axis(
        &self,
        tool: &AxisTool,
        p_w: &Vector3<f64>,
        axis_w: &Vector3<f64>,
        (low, high): (&JointVec, &JointVec),
        mut found: impl FnMut(Branch, JointVec),
    ) {
        let Family::OrthoParallel(arm) = self.family() else { return };
        let centre = arm.x_wf.inverse_transform_point(&(p_w - axis_w * tool.length_m));
        let axis = mat3::tr_mul_v(&arm.x_wf.rot, axis_w) * tool.sign;
        arm.solve_axis(&centre, &axis, low, high, &mut |branch, five| {
            let [q1, q2, q3, q4, q5] = five;
            found(branch, [q1, q2, q3, q4, q5, low[5]].into());
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arm() -> RobotModel {
        RobotModel::load("powercube6").unwrap()
    }

    /// Every posture reaches point and direction, and the posture that the target was made from is among them.
    #[test]
    fn postures_reach_point_and_direction_and_no_posture_is_missing() {
        let arm = arm();
        let tool = arm.axis_tool(0.05).unwrap();
        assert!((tool.length_m - 0.267).abs() < 1e-12);
        let mut most = 0;
        for k in 0..2000 {
            let q = arm.spread_configuration(k);
            let x_we = arm.ee_at(&q);
            let axis = x_we.rot.column(2).into_owned();
            let point = x_we.pos + axis * 0.05;
            let (mut low, high) = (arm.q_min(), arm.q_max());
            low[5] = q[5];
            let (mut count, mut same) = (0, false);
            arm.ik_axis(&tool, &point, &axis, (&low, &high), |branch, found| {
                let x = arm.ee_at(&found);
                assert!((x.rot.column(2) - axis).norm() < 1e-9);
                assert!((x.pos + x.rot.column(2) * 0.05 - point).norm() < 1e-9);
                assert!(arm.in_range(&found, 1e-9));
                assert_eq!(arm.branch_of(&found), Some(branch));
                same |= (found - q).amax() < 1e-6;
                count += 1;
            });
            assert!(same, "posture {k} is not found: {q}");
            // Full inverse kinematics with the same roll differs only in joint 6 of its solutions.
            let full = arm.ik(&x_we).unwrap();
            let inside = |q: &JointVec| (0..5).all(|i| q[i] >= low[i] && q[i] <= high[i]);
            assert!(count >= full.iter().filter(|s| inside(&s.q)).count(), "posture {k}");
            most = most.max(count);
        }
        assert_eq!(most, 8);
    }

    #[test]
    fn a_window_leaves_out_what_is_outside() {
        let arm = arm();
        let tool = arm.axis_tool(0.05).unwrap();
        let q = arm.spread_configuration(17);
        let x_we = arm.ee_at(&q);
        let axis = x_we.rot.column(2).into_owned();
        let point = x_we.pos + axis * 0.05;
        let width = JointVec::repeat(6, 0.01);
        let mut found = Vec::new();
        arm.ik_axis(&tool, &point, &axis, (&(q - width), &(q + width)), |_, q| found.push(q));
        assert_eq!(found.len(), 1);
        arm.ik_axis(&tool, &(point * 5.0), &axis, (&arm.q_min(), &arm.q_max()), |_, q| panic!("{q}"));
        let nan = Vector3::repeat(f64::NAN);
        arm.ik_axis(&tool, &nan, &axis, (&arm.q_min(), &arm.q_max()), |_, q| panic!("{q}"));
    }

    #[test]
    fn arms_of_other_families_have_no_such_tool() {
        assert_eq!(RobotModel::load("pincher4").unwrap().axis_tool(0.05), None);
    }
}
