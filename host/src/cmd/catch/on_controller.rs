//! `cubectl catch --disc --on-controller`

use operator::ball_catch::trial::TrialFault;
use operator::dialogue::operator::OperatorError;
use operator::disc::{DriveLost, Judged, NoRun, run as run_plan};
use planner::disc::arm::DiscArm;
use planner::disc::flight::Path;
use planner::disc::intercept::Plan;
use planner::disc::witness::{Rule, Verdict};
use robot_model::{JointVec, RobotModel};
use serde_json::{Value, json};

use super::witness_words::{list, seen_json};
use crate::error::ExpectedError;
use crate::exit;

/// Joint whose drive is lost: the shoulder, which carries most.
const LOST_JOINT: usize = 1;

/// Runs the plan.
///
/// # Errors
/// The robot has no drives, the controller refuses the motion, or a fault has no meaning for a disc.
pub(super) fn run(
    robot: &RobotModel,
    arm: &DiscArm,
    path: &Path,
    plan: &Plan,
    faults: &[TrialFault],
) -> Result<Judged, ExpectedError> {
    let lost = match faults {
        [] => None,
        [TrialFault::DriveLost { at_s }] => Some(DriveLost { joint: LOST_JOINT, at_s: *at_s }),
        _ => {
            return Err(ExpectedError::new(exit::USAGE, "with --on-controller only one fault is known")
                .next("`--fault drive-lost:SECONDS`"));
        }
    };
    run_plan(robot, arm, path, plan, lost).map_err(|why| match why {
        NoRun::Settings(why) => ExpectedError::bad_input(&why),
        NoRun::Trajectory(why) => ExpectedError::bad_input(&why),
        NoRun::Bus(why) => why.into(),
        NoRun::Operator(why) => why.into(),
    })
}

/// The run as an outcome with its exit code.
///
/// # Errors
/// The controller stopped the arm, or the disc was not caught.
pub(super) fn ended(run: &Judged) -> Result<(), ExpectedError> {
    if let Err(why) = &run.executed.reported {
        let code = match why {
            OperatorError::Stopped { .. } => exit::STOPPED,
            why if why.is_stop_by_other() => exit::STOPPED,
            OperatorError::Bus(_) => exit::BUS,
            OperatorError::Interrupted => exit::INTERRUPTED,
            _ => exit::DRIVE,
        };
        return Err(ExpectedError::of(code, why));
    }
    if run.verdict.caught.is_none() {
        let what = match &run.verdict.touched {
            Some(touch) => format!("the disc touched the {} at {:.3} s", touch.body, touch.t_s),
            None => "it was not between the fingers while they closed".to_owned(),
        };
        return Err(ExpectedError::new(exit::MISSED, format!("the disc was not caught: {what}"))
            .next("`--report` shows the tracking error of each joint"));
    }
    Ok(())
}

pub(super) fn as_text(arm: &DiscArm, run: &Judged, planned: &Verdict) -> String {
    let (executed, tracking) = (&run.executed, &run.tracking);
    let mut out = format!("on the controller, period {:.0} ms:\n", executed.period_s * 1e3);
    out += &match &executed.reported {
        Ok(()) => "  controller: the motion ran to its end\n".to_owned(),
        Err(why) => format!("  controller: {why}\n"),
    };
    out += &match (&run.verdict.caught, &run.verdict.touched) {
        (Some((_, seen)), _) => format!(
            "  observer: caught at {:.3} s, tip {:.1} cm inside the rim, {:.1} mm off the middle of the gap\n",
            seen.t_s,
            seen.depth_m * 100.0,
            seen.height_m * 1e3
        ),
        (None, Some(touch)) => {
            format!("  observer: not caught; touches the {} at {:.3} s\n", touch.body, touch.t_s)
        }
        (None, None) => "  observer: not caught\n".to_owned(),
    };
    if let (Some((_, plan)), Some((_, seen))) = (&planned.caught, &run.verdict.caught) {
        let least_m = Rule::default().depth_min_m;
        out += &format!(
            "  room beyond the least depth of {:.0} cm: {:.2} cm planned, {:.2} cm executed\n",
            least_m * 100.0,
            (plan.depth_m - least_m) * 100.0,
            (seen.depth_m - least_m) * 100.0
        );
    }
    out += &match executed.closed_s {
        Some(at_s) => format!("  order to close the gripper at {at_s:.3} s"),
        None => "  no order to close the gripper".to_owned(),
    };
    let mrad = |q: &planner::disc::Joints| list(q.iter().map(|q| q * 1e3), 1);
    out += &format!("; controller's clock known to {:.2} ms\n", executed.clock_off_s * 1e3);
    out += &format!(
        "  tracking error at most {} mrad, at the catch {} mrad; tip {:.1} mm at most, {:.1} mm at the catch\n",
        mrad(&tracking.worst_rad),
        mrad(&tracking.at_catch_rad),
        tracking.tip_m.0 * 1e3,
        tracking.tip_m.1 * 1e3
    );
    let use_of = |most: &planner::disc::Joints, limit: &JointVec| {
        JointVec::from(*most).component_div(limit).max() * 100.0
    };
    out += &format!(
        "  largest use: {:.0} % of speed, {:.0} % of acceleration (means over 40 ms)\n",
        use_of(&run.speed_rad_s, &arm.model.limit(|l| l.v_max_rad_s)),
        use_of(&run.acceleration_rad_s2, &arm.model.limit(|l| l.a_max_rad_s2))
    );
    out
}

/// The run as JSON; times count from the release.
pub(super) fn as_json(path: &Path, run: &Judged) -> Value {
    let (executed, tracking) = (&run.executed, &run.tracking);
    let discs: Vec<_> = executed.moved.iter().map(|moved| path.at(moved.t_s)).collect();
    json!({
        "reported": executed.reported.as_ref().map_or_else(ToString::to_string, |()| "ended".to_owned()),
        "witness": seen_json(&run.verdict),
        "closed_s": executed.closed_s,
        "clock_off_s": executed.clock_off_s,
        "tracking_error_max_rad": tracking.worst_rad.as_slice(),
        "tracking_error_at_catch_rad": tracking.at_catch_rad.as_slice(),
        "tip_error_max_m": tracking.tip_m.0,
        "tip_error_at_catch_m": tracking.tip_m.1,
        "speed_rad_s": run.speed_rad_s.as_slice(),
        "acceleration_40ms_rad_s2": run.acceleration_rad_s2.as_slice(),
        "trace": {
            "t_s": executed.moved.iter().map(|moved| moved.t_s).collect::<Vec<_>>(),
            "q_rad": executed.moved.iter().map(|moved| moved.q.as_slice()).collect::<Vec<_>>(),
            "disc_m": discs.iter().map(|disc| disc.p_m.as_slice()).collect::<Vec<_>>(),
            "disc_normal": discs.iter().map(|disc| disc.normal.as_slice()).collect::<Vec<_>>(),
        },
    })
}
