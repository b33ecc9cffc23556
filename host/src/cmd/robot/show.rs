//! `cubectl robot show ROBOT --out arm.html`

use std::path::PathBuf;

use robot_model::{JointVec, RobotModel};

use crate::error::ExpectedError;
use crate::report::robot;

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl robot show arm.toml --pose-deg 0,-90,90,0,45,0 --out arm.html")]
pub struct Args {
    /// Robot, by name or file.
    pub robot: String,
    /// Joint angles of a second pose, degrees, from the base to the hand; by default the middle of the ranges.
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true)]
    pub pose_deg: Option<Vec<f64>>,
    /// HTML file to write.
    #[arg(long, default_value = "robot.html")]
    pub out: PathBuf,
    /// Overwrite the file.
    #[arg(long)]
    pub force: bool,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let robot = super::super::robot(&args.robot)?;
    let pose = pose(&robot, args.pose_deg.as_deref())?;
    for (joint, q) in robot.joints().iter().zip(pose.iter()) {
        if !(joint.limits.q_min_rad..=joint.limits.q_max_rad).contains(q) {
            console::line!("note: {:.1}° is outside the range of joint {}", q.to_degrees(), joint.name);
        }
    }
    super::write(&args.out, &robot::html(&robot, &pose), args.force)?;
    let angles: Vec<String> = pose.iter().map(|q| format!("{:.0}°", q.to_degrees())).collect();
    console::line!("{}: {} at zero and at {}", args.out.display(), robot.name(), angles.join(" "));
    Ok(())
}

fn pose(arm: &RobotModel, pose_deg: Option<&[f64]>) -> Result<JointVec, ExpectedError> {
    let Some(given) = pose_deg else { return Ok((arm.q_min() + arm.q_max()) * 0.5) };
    let n = arm.n();
    if given.len() != n || given.iter().any(|q| !q.is_finite()) {
        return Err(ExpectedError::bad_input(&format!(
            "--pose-deg gives {} angles; {} has {n} joints",
            given.len(),
            arm.name()
        ))
        .next(format!("give {n} numbers in degrees, separated by commas")));
    }
    Ok(JointVec::from_fn(n, |k| given[k].to_radians()))
}
