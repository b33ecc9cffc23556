//! `cubectl arm pose`: named poses for `cubectl move --pose`.

use crate::cmd::goal::Angles;
use crate::cmd::poses::{NamedPose, Poses, PosesArgs};
use crate::cmd::{fixed, print_json};
use crate::error::ExpectedError;
use operator::bus::BusArgs;
use planner::plan::Joints;
use protocol::cyphal::id::NodeId;

/// What to do with named poses.
#[derive(Debug, clap::Subcommand)]
pub enum PoseVerb {
    /// Save where the arm stands, or given angles, under a name.
    Save(SaveArgs),
    /// Show the named poses.
    List(ListArgs),
    /// Remove a named pose.
    Remove(RemoveArgs),
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl arm pose save park --bus can0\n  cubectl arm pose save park --joints 0,-90deg,90deg,0,0,0 --robot powercube6"
)]
pub struct SaveArgs {
    /// Name of the pose. A pose of this robot with this name is replaced.
    pub name: String,
    /// These joint angles, base first, instead of where the arm stands: rad, or degrees with `deg`.
    #[arg(long, value_name = "ANGLE,..", allow_hyphen_values = true)]
    pub joints: Option<Angles>,
    #[command(flatten)]
    pub poses: PosesArgs,
    #[command(flatten)]
    pub bus: BusArgs,
    /// Cyphal node-ID of the controller. Default: the one that is heard.
    #[arg(long, value_name = "NODE-ID", value_parser = crate::cmd::values::node_id)]
    pub controller: Option<NodeId>,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl arm pose list --poses cell.toml")]
pub struct ListArgs {
    #[command(flatten)]
    pub poses: PosesArgs,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl arm pose remove park --robot powercube6")]
pub struct RemoveArgs {
    /// Name of the pose.
    pub name: String,
    /// Robot that it is of.
    #[arg(long, default_value = "powercube6")]
    pub robot: String,
    #[command(flatten)]
    pub poses: PosesArgs,
}

pub fn run(verb: &PoseVerb) -> Result<(), ExpectedError> {
    match verb {
        PoseVerb::Save(args) => save(args),
        PoseVerb::List(args) => list(args),
        PoseVerb::Remove(args) => remove(args),
    }
}

fn save(args: &SaveArgs) -> Result<(), ExpectedError> {
    let arm = crate::cmd::robot(args.bus.cell.robot.as_deref().unwrap_or("powercube6"))?;
    let mut poses = Poses::read(args.poses.path())?;
    let q = match &args.joints {
        Some(Angles(q)) => q.clone(),
        None => measured(args)?,
    };
    let joints = arm.joints().len();
    if q.len() != joints || !arm.in_range(&Joints::from_slice(&q), 0.02) {
        return Err(ExpectedError::bad_input(&format!(
            "({}) rad is no pose of {} inside its joint ranges; it has {joints} joints",
            q.iter().map(|q| fixed(*q, 3)).collect::<Vec<_>>().join(", "),
            arm.name()
        ))
        .next("name the robot with --robot"));
    }
    let was_there = poses.put(NamedPose { name: args.name.clone(), robot: arm.name().to_owned(), q_rad: q });
    poses.write(args.poses.path())?;
    let how = if was_there { "replaced" } else { "saved" };
    console::line!("pose \"{}\" of {} {how} in {}", args.name, arm.name(), args.poses.path().display());
    Ok(())
}

/// Where the arm stands, rad.
fn measured(args: &SaveArgs) -> Result<Vec<f64>, ExpectedError> {
    let mut session = args.bus.open_with_controller()?;
    let node = session.find_controller(args.controller)?;
    let group = session.group().unwrap_or_default();
    let pose = session.measured_pose(node)?;
    let homed = (1_u16 << pose.len()) - 1 == u16::from(group.homed_mask);
    session.finish()?;
    if !homed {
        return Err(ExpectedError::new(
            crate::exit::DRIVE,
            "not all joints are homed, so their angles are not known",
        )
        .next("`cubectl home`, or give the angles with --joints"));
    }
    Ok(pose)
}

fn list(args: &ListArgs) -> Result<(), ExpectedError> {
    let poses = Poses::read(args.poses.path())?.poses;
    if args.json {
        print_json(&serde_json::json!(poses));
        return Ok(());
    }
    if poses.is_empty() {
        console::line!("no poses in {}", args.poses.path().display());
    }
    for pose in poses {
        let degrees: Vec<String> = pose.q_rad.iter().map(|q| fixed(q.to_degrees(), 2)).collect();
        console::line!("{:<20} {:<14} {} deg", pose.name, pose.robot, degrees.join(" "));
    }
    Ok(())
}

fn remove(args: &RemoveArgs) -> Result<(), ExpectedError> {
    let mut poses = Poses::read(args.poses.path())?;
    poses.of(&args.name, &args.robot)?;
    poses.poses.retain(|pose| (pose.name.as_str(), pose.robot.as_str()) != (&args.name, &args.robot));
    poses.write(args.poses.path())
}
