//! `cubectl controller upload`

use std::path::{Path, PathBuf};

use crate::cmd::ended::{failure, outcome_last};
use crate::cmd::path_file::{self, RetimeArgs};
use crate::cmd::progress::ProgressView;
use crate::cmd::target::Target;
use crate::error::ExpectedError;
use operator::job::{Answer, Extent, Judge, Order, Program, perform};
use operator::port::OnBus;
use operator::trajectory::motion_of;
use planner::plan::Arm;
use planner::plan::file::{Kind, PlanFileError, require_robot};
use planner::record::PlanRecord;
use planner::store::fingerprint_of;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  cubectl controller upload plan.json --bus can0\n\nThe file is a plan, or the controller's binary form of one. It is checked in the controller before it is committed."
)]
pub struct Args {
    /// Plan (JSON), waypoints (CSV, or JointTrajectory as JSON or YAML), or trajectory file of a controller.
    pub file: PathBuf,
    #[command(flatten)]
    pub on: Target,
    #[command(flatten)]
    pub retime: RetimeArgs,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let source = read(&args.file, args.on.bus.cell.robot.as_deref(), &args.retime)?;
    let mut session = args.on.session()?;
    let mut order = source.order();
    order.extent = Extent::Upload;
    let mut progress = ProgressView::new(false);
    let mut operator = OnBus::new(&mut session, args.on.controller);
    let record = perform(&mut operator, &order, &mut |step| {
        progress.show(step);
        Answer::Yes
    });
    let finished = session.finish().map_err(ExpectedError::from);
    if let (None, Some(name), Some(node)) = (&record.ended, record.trajectory, record.node) {
        console::line!(
            "controller {}: {} bytes stored and committed, hash {:016x}",
            node.get(),
            name.length_bytes,
            name.trajectory_crc64
        );
    }
    outcome_last(failure(&record), finished, None)
}

impl Source {
    /// The motion of an arm that stands where it begins.
    pub(in crate::cmd) fn order(&self) -> Order<'_> {
        Order::new(&self.arm, &self.fingerprint, self.program.clone(), Judge::Reach)
    }
}

/// What a file holds that can be run.
pub(in crate::cmd) struct Source {
    /// Its name or file.
    pub(in crate::cmd) robot: String,
    pub(in crate::cmd) arm: Arm,
    /// Fingerprint of its robot.
    pub(in crate::cmd) fingerprint: String,
    pub(in crate::cmd) program: Program,
    /// The arm goes to the start by itself.
    pub(in crate::cmd) travels: bool,
}

/// Reads a trajectory file of a controller or a plan; a plan must be for `robot`, if that is given.
pub(in crate::cmd) fn read(
    path: &Path,
    robot: Option<&str>,
    retime: &RetimeArgs,
) -> Result<Source, ExpectedError> {
    let bytes = toml_reader::read_bytes(path, planner::plan::file::FILE_MAX_BYTES)
        .map_err(|error| ExpectedError::io(path, &error))?;
    let is_controllers = bytes.starts_with(&firmware::trajectory_format::MAGIC);
    let of_arm = |program: &dyn Fn(&Arm) -> Result<Program, ExpectedError>, travels| {
        let robot = robot.unwrap_or("powercube6").to_owned();
        let arm = crate::cmd::robot(&robot)?;
        let fingerprint = fingerprint_of(&arm);
        Ok(Source { program: program(&arm)?, robot, arm, fingerprint, travels })
    };
    if let Some(text) = path_file::waypoints_in(&bytes).filter(|_| !is_controllers) {
        return of_arm(&|arm| path_file::motion(path, text, arm, retime).map(Program::Motion), true);
    }
    retime.require_none()?;
    if is_controllers {
        return of_arm(&|_| Ok(Program::File(bytes.clone(), motion_of(&bytes).unwrap_or_default())), false);
    }
    if !bytes.trim_ascii_start().starts_with(b"{") {
        return Err(ExpectedError::bad_input(&format!(
            "{}: neither a plan (JSON) nor a trajectory file of a controller (it does not begin with \
                     CTRJ), and no waypoints",
            path.display()
        ))
        .next("`cubectl plan throw --out FILE` makes a plan"));
    }
    let bad = |error: &PlanFileError| ExpectedError::bad_input(error);
    let plan = PlanRecord::read(path).map_err(|error| bad(&error))?;
    let id = plan.robot().clone();
    let source = robot.unwrap_or(&id.source).to_owned();
    let arm = crate::cmd::robot(&source)?;
    let motion = match &plan {
        PlanRecord::Throw(plan) => &plan.motion,
        PlanRecord::Move(plan) => &plan.motion,
        PlanRecord::Follow(_) => {
            let (found, wanted) = (Kind::Follow, Kind::Throw);
            return Err(bad(&PlanFileError::OtherKind { path: path.to_owned(), found, wanted }));
        }
    };
    require_robot(path, &id, motion.joints.len(), &arm).map_err(|error| bad(&error))?;
    Ok(Source {
        robot: source,
        arm,
        fingerprint: id.fingerprint,
        program: Program::Motion(motion.to_motion()),
        travels: false,
    })
}
