//! A file of waypoints as a motion: at its own times, or as fast as the limits allow.

use std::path::Path;

use planner::motion::Motion;
use planner::plan::Arm;
use planner::timing::{self, Limits, Row, along, motion_of_rows, thinned};
use planner::way::{Travel, along_places, require_free_motion};
use planner::waypoints;
use robot_model::collision::Scene;

use super::move_arm::no_way;
use crate::error::ExpectedError;
use crate::exit;

/// Farthest way of a joint from points with times, rad: what the drives do not resolve. Points that lie close to each other then need
/// few knots, and a bus carries them beside its other traffic.
const OFF_RAD: f64 = 2e-5;

/// Options for files of waypoints.
#[derive(Debug, Clone, Copy, clap::Args)]
#[command(next_help_heading = "Waypoints")]
pub struct RetimeArgs {
    /// Find the shortest times within the limits, also where the file has times.
    #[arg(long)]
    pub retime: bool,
    /// Leave a waypoint by at most this to pass it without a stop, rad over all joints (Euclidean); 0 stops at each
    /// [default: 0.02].
    #[arg(long, value_name = "RAD", value_parser = super::values::within(0.0..=10.0, "rad"))]
    pub blend_rad: Option<f64>,
    /// Share of the robot's speeds, accelerations and jerks on the way to the first waypoint, and where times are found
    /// [default: 0.3].
    #[arg(long, value_name = "SHARE", value_parser = super::values::share)]
    pub speed_share: Option<f64>,
}

impl RetimeArgs {
    pub(super) fn share(&self) -> f64 {
        self.speed_share.unwrap_or(0.3)
    }

    /// Refuses the options for a file that holds no waypoints.
    pub(super) fn require_none(&self) -> Result<(), ExpectedError> {
        let given = [
            ("--retime", self.retime),
            ("--blend-rad", self.blend_rad.is_some()),
            ("--speed-share", self.speed_share.is_some()),
        ];
        match given.into_iter().find(|(_, is_given)| *is_given) {
            None => Ok(()),
            Some((option, _)) => Err(ExpectedError::bad_input(&format!(
                "{option} is for waypoints; this file has a motion of its own"
            ))
            .next(format!("leave {option} out"))),
        }
    }
}

/// The text of a file, if it is neither a plan nor a trajectory file of a controller but may hold waypoints.
pub(super) fn waypoints_in(bytes: &[u8]) -> Option<&str> {
    let text = std::str::from_utf8(bytes).ok()?;
    let first = text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#'))?;
    let is_plan = first.starts_with('{') && !text.contains("\"joint_names\"");
    let may_be = first.starts_with('{') || first.contains(',') || text.contains("joint_names");
    (may_be && !is_plan).then_some(text)
}

/// The motion through the waypoints of `text`, which was read from `path`.
///
/// # Errors
/// The file, a limit that its times exceed (joint, time, value and limit), or two bodies that would touch.
pub(super) fn motion(path: &Path, text: &str, arm: &Arm, args: &RetimeArgs) -> Result<Motion, ExpectedError> {
    let found = through(path, text, arm, args)?;
    require_free_motion(arm, &Scene::default(), &found).map_err(|error| no_way(&error).at(path.display()))?;
    Ok(found)
}

fn through(path: &Path, text: &str, arm: &Arm, args: &RetimeArgs) -> Result<Motion, ExpectedError> {
    let refused = |what: &dyn std::fmt::Display, next: &str| {
        ExpectedError::bad_input(&format!("{}: {what}", path.display())).next(next)
    };
    if waypoints::is_of_hand(text) {
        return of_hand(path, text, arm, args);
    }
    let names: Vec<&str> = arm.joints().iter().map(|joint| joint.name.as_str()).collect();
    let found =
        waypoints::read(text, &names).map_err(|error| ExpectedError::bad_input(&error).at(path.display()))?;
    for (row, number) in found.rows.iter().zip(1..) {
        let outside = |j: &usize| !(arm.q_min()[*j]..=arm.q_max()[*j]).contains(&row.q_rad[*j]);
        if let Some(j) = (0..names.len()).find(outside) {
            let (name, q, low, high) = (names[j], row.q_rad[j], arm.q_min()[j], arm.q_max()[j]);
            let what = format!("point {number}: {name} at {q:.4} rad is outside {low:.4} to {high:.4} rad");
            return Err(refused(&what, "move the point into the joint ranges"));
        }
    }
    if found.timed && !args.retime && args.blend_rad.is_some() {
        return Err(refused(
            &"--blend-rad is for times that are found; this file has times",
            "add --retime, or leave it out",
        ));
    }
    let share = if found.timed && !args.retime { 1.0 } else { args.share() };
    let limits =
        Limits::of_arm(arm, share).ok_or_else(|| refused(&"the robot has no limits", "mend its file"))?;
    if found.timed && !args.retime {
        let rows: Vec<Row> = found
            .rows
            .into_iter()
            .map(|point| Row { t_s: point.t_s.unwrap_or(0.0), q_rad: point.q_rad, qd_rad_s: point.qd_rad_s })
            .collect();
        let motion = motion_of_rows(&rows, &limits)
            .map_err(|error| refused(&error, "change the times, or find new ones with --retime"))?;
        return Ok(thinned(&motion, &limits, OFF_RAD));
    }
    let points: Vec<&[f64]> = found.rows.iter().map(|point| point.q_rad.as_slice()).collect();
    let path_of = timing::Path::through(&points, args.blend_rad.unwrap_or(0.02))
        .map_err(|error| refused(&error, "give two places"))?;
    along(&path_of, &limits).ok_or_else(|| refused(&"no times were found", "take points out"))
}

/// The hand on straight lines from place to place, with a stop at each.
fn of_hand(path: &Path, text: &str, arm: &Arm, args: &RetimeArgs) -> Result<Motion, ExpectedError> {
    let place = path.display();
    if args.blend_rad.is_some() {
        let what =
            "--blend-rad is for waypoints of the joints; on lines of the hand the arm stops at each corner";
        return Err(ExpectedError::bad_input(&format!("{place}: {what}")).next("leave --blend-rad out"));
    }
    let goals = waypoints::read_hand(text).map_err(|error| ExpectedError::bad_input(&error).at(&place))?;
    let travel = Travel { share: args.share(), ..Travel::default() };
    let middle = (arm.q_min() + arm.q_max()) * 0.5;
    let motion = along_places(arm, &Scene::default(), &travel, &middle, &goals).map_err(|(number, error)| {
        let next =
            "choose places that the hand reaches in one posture, or leave the angles out; nothing has moved";
        ExpectedError::new(exit::NO_THROW, format!("{place}: place {number}: {error}")).next(next)
    })?;
    if motion.knots.len() < 2 {
        return Err(ExpectedError::bad_input(&format!("{place}: all places are one")).next("give two"));
    }
    Ok(motion)
}
