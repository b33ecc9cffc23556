//! `cubectl modules show`: CANopen servos beside their electronic data sheet.

use std::path::{Path, PathBuf};

use operator::bus::BusArgs;
use operator::bus::session::Session;
use operator::bus::settings::{NoSettings, settings_of};
use operator::dialogue::ask::AskError;
use operator::dialogue::objects::SHEET_MAX;
use operator::drives::cia402;
use operator::eds::Eds;
use operator::eds::compare::{Report, compare};
use protocol::JointIndex;
use robot_model::Cia402Servo;

use super::counted;
use super::progress::while_working;
use crate::error::ExpectedError;
use crate::exit;

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  cubectl modules show --robot robots/canopen6.toml --bus can0\n  \
                  cubectl modules show --eds servo.eds --robot robots/canopen6.toml --node 3 --bus can0\n\n\
                  Compares with the node: who it is (object 1018), and each object that the controller uses, with its length, access, limits and \
                  place in process data; of a DCF also the values. Nothing is written.")]
pub struct ShowArgs {
    /// Electronic data sheet (EDS) or sheet with values (DCF) of the servos, as CiA 306 says. Default: the sheet that each servo stores
    /// (object 1021).
    #[arg(long, value_name = "FILE")]
    pub eds: Option<PathBuf>,
    /// Node of the servo. Default: all servos of the robot.
    #[arg(long, value_name = "NODE")]
    pub node: Option<u8>,
    #[command(flatten)]
    pub bus: BusArgs,
}

fn read(path: &Path) -> Result<Eds, ExpectedError> {
    let failed = |error: std::io::Error| ExpectedError::io(path, &error);
    let bytes = std::fs::metadata(path).map_err(failed)?.len();
    if bytes > SHEET_MAX.into() {
        return Err(ExpectedError::bad_input(&format!(
            "{}: {bytes} bytes are too many for a sheet",
            path.display()
        )));
    }
    // Sheets of makers have texts in several encodings; numbers and keys are ASCII.
    let text = std::fs::read(path).map_err(failed)?;
    Eds::read(&String::from_utf8_lossy(&text)).map_err(|error| {
        ExpectedError::bad_input(&format!("{}: {error}", path.display()))
            .next("check the sheet with the maker's tool, or take it from the maker again")
    })
}

/// The sheet that a servo stores.
fn stored(session: &mut Session, servo: &Cia402Servo) -> Result<Eds, ExpectedError> {
    let node = servo.node;
    let failed = |what: String| {
        ExpectedError::new(exit::DRIVE, format!("node {node}: {what}"))
            .next("name the sheet of the maker with --eds FILE")
    };
    let what = format!("node {node} sends its sheet");
    let text = while_working(&what, "a few seconds", |_| session.read_sheet(node))?
        .map_err(|why| failed(why.to_string()))?;
    Eds::read(&String::from_utf8_lossy(&text))
        .map_err(|error| failed(format!("its sheet (object 1021): {error}")))
}

/// Runs the verb.
///
/// # Errors
/// A bad file, a robot without servos, another master, a silent node, or differences.
pub(super) fn run(args: &ShowArgs) -> Result<(), ExpectedError> {
    let of_file = args.eds.as_deref().map(read).transpose()?;
    let cell = args.bus.cell.load()?;
    let robot = &cell.robot;
    let Some(group) = robot.cia402_servos() else {
        let what = format!("robot {} has no CANopen servos", robot.name());
        return Err(ExpectedError::bad_input(&what)
            .next("name the robot of this arm with --robot; its file has [joint.cia402]"));
    };
    let servos = &group.servos;
    let options = cia402::options(group, robot)
        .map_err(|cause| NoSettings::Invalid { robot: robot.name().to_owned(), cause })
        .map_err(|error| ExpectedError::bad_input(&error))?;
    let settings = settings_of(robot).map_err(|error| ExpectedError::bad_input(&error))?;
    let of_node = |number: u8| servos.iter().position(|servo| servo.node.get() == number);
    let joints: Vec<usize> = match args.node {
        None => (0..servos.len()).collect(),
        Some(number) => vec![of_node(number).ok_or_else(|| {
            let nodes: Vec<String> = servos.iter().map(|servo| servo.node.get().to_string()).collect();
            ExpectedError::bad_input(&format!(
                "node {number} is the servo of no joint of robot {}",
                robot.name()
            ))
            .next(format!("name one of {}", nodes.join(", ")))
        })?],
    };
    let mut session = args.bus.open()?;
    if !args.bus.beside && session.hears_canopen_master()? {
        return Err(ExpectedError::new(
            exit::DRIVE,
            format!(
                "{}: another master reads and writes objects of these nodes: nothing was asked",
                args.bus.bus
            ),
        )
        .next("end the controller, or ask beside it with --beside: a search for the servos may then fail"));
    }
    let mut differences = 0;
    for joint in joints {
        let node = servos[joint].node;
        let first = session.find_node(node)?;
        if let Err(failure) = first {
            return Err(ExpectedError::new(exit::DRIVE, format!("node {node}: {failure}")).next(
                "check its supply, its plug and its number; a node that was stopped answers after its power was off, or after `cubectl home`",
            ));
        }
        let index = JointIndex::new(joint).map_err(|error| ExpectedError::bad_input(&error.to_string()))?;
        let needs = options.needs(&settings, index);
        let eds = match &of_file {
            Some(eds) => eds,
            None => &stored(&mut session, &servos[joint])?,
        };
        let Report { read, findings } =
            compare::<AskError>(eds, node, needs, &mut |object| session.read_object(node, object))?;
        for finding in &findings {
            console::line!("node {node}, {finding}\n    next: {}", finding.difference.next());
        }
        differences += findings.len();
        if findings.is_empty() {
            let sheet = args
                .eds
                .as_ref()
                .map_or_else(|| "its own sheet".to_owned(), |file| file.display().to_string());
            console::line!("node {node}: {} as in {sheet}", counted(read, "object"));
        }
    }
    session.finish()?;
    if differences == 0 {
        return Ok(());
    }
    Err(ExpectedError::new(exit::FINDINGS, counted(differences, "difference"))
        .next("do what stands below each; what the node says counts when the arm is driven"))
}
