//! The simulated cell of a plan.

use hil_sim::CellOptions;
use hil_sim::mechanics::Plane;
use planner::plan::file::PlanFile;

/// Lets the ball of `cell` leave the fingers, fly and land as in the plan. Drag in a scenario stays: it is the true
/// one there, whatever the plan assumes.
pub fn take_plan(cell: &mut CellOptions, plan: &PlanFile) {
    // The ball lands where the target is, not only on the floor.
    let met_m = plan.meeting_m();
    let plane = |normal: [f64; 3]| Plane { point_m: met_m.into(), normal: normal.into() };
    cell.finger_release |= plan.landing.fingers.is_some();
    let gripper = &mut cell.gripper;
    gripper.landing_z_m = Some(met_m[2]);
    gripper.landing_plane = plan.target.opening.map(|opening| plane(opening.normal));
    gripper.drag_1_m = gripper.drag_1_m.or(Some(plan.landing.drag_per_m));
    gripper.magnus_rad_s = plan.landing.magnus_rad_s.into();
}
