//! `cubectl log replay`

use std::path::{Path, PathBuf};

use firmware::settings::Settings;
use planner::record::PlanRecord;
use protocol::cyphal::cubecell::group_state;
use protocol::cyphal::id::{NodeId, Route};
use protocol::{Frame, Id, Instant, Node};
use robot_model::RobotModel;
use toml_reader::{DESCRIPTION_MAX_BYTES, read_text};

use crate::cmd::print_json;
use crate::cmd::throw::read_gains;
use crate::cmd::tune::InForce;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::period::{PeriodRequest, apply, choose, settings_with_gains};
use operator::bus::settings::settings_of;
use operator::bus::sim::SimSetup;
use operator::bus::sim::soft_controller;
use operator::drives::CanDrives;
use operator::drives::is_order;

use operator::log::candump::{Line, Recording, read_file};
use operator::log::text_in;

/// Frames that a controller may send at one deadline; more is taken for a defect.
const FRAMES_MAX: usize = 4_096;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl log record boot --controller --for-s 2 && cubectl log replay boot.log\n  cubectl throw --target 1,1,-1 --period-ms 10 --out throw1 && cubectl log replay throw1\n\nThe times of the log must be the controller's own clock, beginning at its start, as recordings of the simulated\ncell are; in real time the clock of the bus is another one."
)]
pub struct Args {
    /// Candump log of a run with a controller, or the folder of a throw.
    pub log: PathBuf,
    /// Gains the controller began with [default: gains.toml beside the log, or the built-in ones].
    #[arg(long, value_name = "FILE")]
    pub gains: Option<PathBuf>,
    /// Robot of the recorded cell: a built-in name or a file [default: that of the plan beside the log, or powercube6].
    #[arg(long, value_name = "ROBOT")]
    pub robot: Option<String>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Where a replay left the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Difference {
    /// Line of the log; `None` after its end.
    pub line: Option<usize>,
    /// What the log has.
    pub recorded: Option<Frame>,
    /// What the controller sent.
    pub sent: Option<Frame>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Replayed {
    /// Frames handed to the controller.
    pub received: usize,
    /// Frames of the controller that were as recorded.
    pub same: usize,
    /// The first that was not.
    pub difference: Option<Difference>,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if crate::cmd::rsi::is_recording(&args.log) {
        return crate::cmd::rsi::replay(&args.log, args.json);
    }
    let path = &if args.log.is_dir() { text_in(&args.log) } else { args.log.clone() };
    let Recording { lines, tear } = read_file(path)?;
    if let Some(tear) = &tear {
        console::note!("{}: {tear}", path.display());
    }
    let robot = RobotModel::load(&robot_of(args, path)?).map_err(|error| ExpectedError::bad_input(&error))?;
    let node = controller_of(&lines);
    if !lines.iter().any(|line| is_from_controller(line, &robot, node)) {
        return Err(ExpectedError::bad_input(&format!("{}: no frame of a controller in it", path.display()))
            .next("record a run with one, for example `cubectl log record boot --controller --for-s 2`"));
    }
    let beside = path.with_file_name("gains.toml");
    let gains = args.gains.as_ref().or_else(|| beside.is_file().then_some(&beside));
    let settings =
        if gains.is_some() { settings_of(&robot) } else { settings_with_gains(&robot, &SimSetup::default()) };
    let mut settings = settings.map_err(|error| ExpectedError::bad_input(&error))?;
    settings.node_id = node.get().into();
    if let Some(path) = gains {
        begin_with(path, &robot, &mut settings)?;
    }
    let mut controller =
        soft_controller(&settings, CanDrives::of(&robot).map_err(|error| ExpectedError::bad_input(&error))?);
    let replayed = replay(&lines, &robot, &mut controller);
    if args.json {
        print_json(&serde_json::json!({
            "received": replayed.received,
            "same": replayed.same,
            "torn": tear,
            "identical": replayed.difference.is_none(),
            "difference": replayed.difference.map(|difference| serde_json::json!({
                "line": difference.line,
                "recorded": difference.recorded.map(|frame| frame.to_string()),
                "sent": difference.sent.map(|frame| frame.to_string()),
            })),
        }));
    }
    match replayed.difference {
        None => {
            if !args.json {
                console::line!(
                    "identical: {} frames of the controller after {} received ones",
                    replayed.same,
                    replayed.received
                );
            }
            Ok(())
        }
        Some(Difference { line, recorded, sent }) => {
            let show = |frame: Option<Frame>| frame.map_or("nothing".to_owned(), |frame| frame.to_string());
            let place = line.map_or("after the end".to_owned(), |line| format!("line {line}"));
            let what = format!(
                "{}, {place}: recorded {}, but the controller sends {} ({} frames before it were the same)",
                path.display(),
                show(recorded),
                show(sent),
                replayed.same
            );
            let next = "same version and settings as in the recording? then the controller has changed";
            Err(ExpectedError::new(exit::FINDINGS, what).next(next))
        }
    }
}

/// The robot: asked for, or that of the plan beside the log.
fn robot_of(args: &Args, log: &Path) -> Result<String, ExpectedError> {
    let plan = log.with_file_name("plan.json");
    match &args.robot {
        Some(robot) => Ok(robot.clone()),
        None if plan.is_file() => {
            let plan = PlanRecord::read(&plan).map_err(|error| ExpectedError::bad_input(&error))?;
            Ok(plan.robot().source.clone())
        }
        None => Ok("powercube6".to_owned()),
    }
}

/// Lets the controller begin with the gains of a file: a certified one, or what a controller held during a throw.
fn begin_with(path: &Path, robot: &RobotModel, settings: &mut Settings) -> Result<(), ExpectedError> {
    let text = read_text(path, DESCRIPTION_MAX_BYTES).map_err(|error| ExpectedError::io(path, &error))?;
    if let Ok(in_force) = InForce::from_toml(&text) {
        in_force.begin(settings);
        return Ok(());
    }
    let gains = read_gains(path, robot.name())?;
    apply(&choose(PeriodRequest::Gains(Box::new(gains)), None, robot, settings.cycle_period_us)?, settings);
    Ok(())
}

/// Cyphal node-ID that the settings of a controller have from the start.
const USUAL: NodeId = NodeId::from_low_bits(10);

/// Cyphal node-ID of the controller: the node that reports the state of a group.
fn controller_of(lines: &[Line]) -> NodeId {
    let source = |line: &Line| match line.frame.id() {
        Id::Extended(id) if line.sent != Some(true) => match Route::parse(id).ok()?.1 {
            Route::Message { source, subject } if subject == group_state::SUBJECT => Some(source),
            _ => None,
        },
        _ => None,
    };
    lines.iter().find_map(source).unwrap_or(USUAL)
}

/// Frames to drives, which on a bus with a controller only it sends, and its half of the host link.
///
/// What the recording program sent itself (a stop, orders of an operator) is not the controller's.
fn is_from_controller(line: &Line, robot: &RobotModel, node: NodeId) -> bool {
    let frame = &line.frame;
    if line.sent == Some(true) {
        return false;
    }
    if let Id::Extended(id) = frame.id() {
        return Route::parse(id).is_ok_and(|(_, route)| route.source() == Some(node));
    }
    is_order(robot, frame)
}

/// Hands the frames of the log that the controller received to `node`, at their times, and compares what it sends,
/// in order, with those it sent then.
///
/// A frame that leaves at time t is on the bus later, so only the order of the sent ones is compared; their contents
/// and number must be the same. Frames that still waited when the recording ended are no difference.
pub fn replay(lines: &[Line], robot: &RobotModel, node: &mut dyn Node) -> Replayed {
    let mut replayed = Replayed::default();
    let controller = controller_of(lines);
    let mut recorded = lines.iter().filter(|line| is_from_controller(line, robot, controller));
    let end = lines.last().map_or(Instant::ZERO, |line| line.at);
    let inputs = lines.iter().filter(|line| !is_from_controller(line, robot, controller));
    let mut now = Instant::ZERO;
    let mut check = |node: &mut dyn Node, replayed: &mut Replayed| -> bool {
        for _ in 0..FRAMES_MAX {
            let Some(sent) = node.poll_frame() else { return true };
            match recorded.next() {
                Some(line) if line.frame == sent => replayed.same += 1,
                // The bus had not carried it yet when the recording ended.
                None => return false,
                Some(line) => {
                    replayed.difference = Some(Difference {
                        line: Some(line.number),
                        recorded: Some(line.frame),
                        sent: Some(sent),
                    });
                    return false;
                }
            }
        }
        true
    };
    if !check(node, &mut replayed) {
        return replayed;
    }
    for line in inputs.map(Some).chain([None]) {
        let until = line.map_or(end, |line| line.at);
        // At one time frames come before deadlines, as on the bus that was recorded.
        while let Some(due) =
            node.poll_timeout().filter(|due| *due < until || (line.is_none() && *due <= until))
        {
            now = now.max(due);
            node.handle_timeout(now);
            if !check(node, &mut replayed) {
                return replayed;
            }
            if node.poll_timeout() == Some(due) {
                break;
            }
        }
        let Some(line) = line else { break };
        now = now.max(line.at);
        replayed.received += 1;
        node.handle_frame(now, &line.frame);
        if !check(node, &mut replayed) {
            return replayed;
        }
    }
    if let Some(line) = recorded.next() {
        replayed.difference =
            Some(Difference { line: Some(line.number), recorded: Some(line.frame), sent: None });
    }
    replayed
}
