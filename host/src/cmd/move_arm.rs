//! `cubectl move`

use std::path::PathBuf;

use planner::motion::Motion;
use planner::plan::{Arm, Joints};
use planner::store::fingerprint_of;
use planner::way::{Goal, WayError};
use robot_model::collision::CollisionChecker;

use super::connected::Connected;
use super::goal::{Angles, Difference, Hand};
use super::link::{Link, Machine};
use super::poses::{Poses, PosesArgs};
use super::results::Results;
use super::target::{Bounds, Moving};
use super::{fixed, print_json};
use crate::error::ExpectedError;
use crate::exit;
use operator::job::{Extent, Order, Target, TargetError, perform};

#[derive(Debug, clap::Args)]
#[command(
    group = clap::ArgGroup::new("goal").required(true).args(["joints", "by", "to", "pose"]),
    after_help = "Examples:\n  cubectl move --joints 0,-40deg,60deg,0,30deg,0 --bus can0\n  cubectl move --by 3=+10deg --bus can0\n  \
cubectl move --to 0.4,0.1,0.5 --home\n  cubectl move --to 0.4,0.1,0.5,0,90deg,0 --straight --dry-run --home\n  cubectl move --pose park --bus can0\n\n\
The arm goes around its own body, the floor and obstacles. On every bus but `sim` it asks first, with the way known; without a terminal it needs\n--yes. \
Ctrl-C stops it along its path. On the bus `sim` the arm is gone when the command ends: `cubectl sim` serves one that stays."
)]
pub struct Args {
    /// To these joint angles, base first: rad, or degrees with `deg` behind the number.
    #[arg(long, value_name = "ANGLE,..", allow_hyphen_values = true)]
    pub joints: Option<Angles>,
    /// Turn joints by angles: JOINT=ANGLE, for example 3=+10deg; several with commas.
    #[arg(long, value_name = "JOINT=ANGLE", allow_hyphen_values = true, value_delimiter = ',')]
    pub by: Vec<Difference>,
    /// The hand (end effector of the robot file) to a place: x,y,z in m, turned as comes with the least motion; or a pose with
    /// roll,pitch,yaw behind it.
    #[arg(long, value_name = "X,Y,Z[,R,P,Y]", allow_hyphen_values = true)]
    pub to: Option<Hand>,
    /// To a named pose.
    #[arg(long, value_name = "NAME")]
    pub pose: Option<String>,
    /// The hand goes on a straight line; with x,y,z alone it keeps its orientation.
    #[arg(long, requires = "to")]
    pub straight: bool,
    /// The place of --to is in the frame of the room, which this calibration of `cubectl tracker calibrate` relates to the robot.
    #[arg(long, value_name = "FILE", requires = "to")]
    pub calibration: Option<PathBuf>,
    #[command(flatten)]
    pub bounds: Bounds,
    /// Seed of the search for a way around.
    #[arg(long, default_value_t = 1)]
    pub way_seed: u64,
    /// Find the way and say how long it takes; nothing moves.
    #[arg(long)]
    pub dry_run: bool,
    /// Folder for plan.json, which `cubectl run` takes, and after the motion bus.log, bus.mcap, summary.json and report.html.
    #[arg(long, value_name = "DIR", conflicts_with = "record")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub poses: PosesArgs,
    #[command(flatten)]
    pub moving: Moving,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let Args { moving, bounds, .. } = args;
    let mut ui = moving.ui("The arm moves. Nobody near?", !args.dry_run)?;
    let mut on = moving.on.clone();
    let machine = Machine::of(&on)?;
    let arm = &machine.arm;
    let scene = bounds.scene();
    let target = target(args, arm)?;
    let fingerprint = fingerprint_of(arm);
    let results = Results::create(args.out.as_deref(), &mut on.bus)?;
    if args.dry_run {
        on.bus.record = None;
    }
    let link = Link::open(&on, &machine, results.folder(), moving.json || args.dry_run)?;
    let mut link = link.watched(&moving.web, &machine)?;
    let done = link.with(|operator| -> Result<_, ExpectedError> {
        let mut connected = Connected::new(operator, arm, &fingerprint);
        let from = connected.begin(moving.home, &mut |step| ui.answer(step))?;
        let travel = machine.travel(bounds.speed_share, args.way_seed);
        let way = target.way(arm, &scene, &travel, &from).map_err(|error| no_way(&error))?;
        way.iter().try_for_each(|motion| results.write_plan(&machine, motion))?;
        let Some(motion) = way.clone().filter(|_| !args.dry_run) else { return Ok((from, way, None)) };
        ui.progress.way(&describe(arm, &motion));
        let order = Order { homes: moving.home, scene, ..connected.order(motion, Extent::Run) };
        let record = perform(connected.operator, &order, &mut |step| ui.answer(step));
        Ok((from, way, Some((order, record))))
    });
    match done {
        Ok((from, way, Some((order, record)))) => {
            results.conclude(link, &ui, (&order, record), &machine, |record| {
                let record = Some(record.verdict.text.as_str());
                say(args, arm, &Said { from: &from, motion: way.as_ref(), moved: true, record });
            })
        }
        done => {
            ui.progress.quiet();
            link.end().finished?;
            let (from, way, _) = done?;
            say(args, arm, &Said { from: &from, motion: way.as_ref(), moved: false, record: None });
            Ok(())
        }
    }
}

/// Where to, as the command line says.
fn target(args: &Args, arm: &Arm) -> Result<Target, ExpectedError> {
    if args.poses.poses.is_some() && args.pose.is_none() {
        return Err(ExpectedError::bad_input(&"--poses is for --pose").next("leave --poses out"));
    }
    let bad = |error: TargetError| ExpectedError::bad_input(&error);
    if let Some(Angles(q)) = &args.joints {
        return Target::joints(arm, q).map_err(bad);
    }
    if let Some(name) = &args.pose {
        return Target::joints(arm, Poses::read(args.poses.path())?.of(name, arm.name())?).map_err(bad);
    }
    let Some(Hand(goal)) = args.to else {
        let turned: Vec<(usize, f64)> = args.by.iter().map(|by| (by.joint - 1, by.by_rad)).collect();
        return Target::by(arm, &turned).map_err(bad);
    };
    let goal = match &args.calibration {
        None => goal,
        Some(path) => {
            let x_wr = super::tracker::room_to_robot(path, arm.name())?;
            match goal {
                Goal::Point(p) => Goal::Point(x_wr.transform_point(&p)),
                Goal::Pose(pose) => Goal::Pose(x_wr * pose),
            }
        }
    };
    Ok(Target::Hand { goal, straight: args.straight })
}

/// The error of a way that was not found; the arm stands, and may have found its zeros before.
pub fn no_way(error: &WayError) -> ExpectedError {
    let next = match error {
        WayError::Blocked { at_start: true, .. } => "`cubectl jog` frees the arm; the arm stands",
        WayError::Blocked { .. } => "choose another place; the arm stands",
        WayError::NoWay { .. } => "try another --way-seed, or go by a place between; the arm stands",
        WayError::Goal(_) => "choose another place, or leave the orientation out; the arm stands",
        WayError::Line(_) => "leave --straight out, or go to another place first; the arm stands",
        WayError::Contact { .. } | WayError::Leg { .. } => "change the path; the arm stands",
        WayError::Share { .. } => "--speed-share 0.2",
    };
    let code = if matches!(error, WayError::Share { .. }) { exit::BAD_INPUT } else { exit::NO_THROW };
    ExpectedError::new(code, error.to_string()).next(next)
}

/// What came of it.
struct Said<'a> {
    from: &'a Joints,
    motion: Option<&'a Motion>,
    moved: bool,
    record: Option<&'a str>,
}

fn describe(arm: &Arm, motion: &Motion) -> String {
    let hand = arm.ee_at(&motion.stop_rad()).pos;
    let [x, y, z] = [hand.x, hand.y, hand.z].map(|value| fixed(value, 3));
    format!("{:.2} s, {} knots; the hand comes to ({x}, {y}, {z}) m", motion.duration_s(), motion.knots.len())
}

/// Says where the arm is or would be.
fn say(args: &Args, arm: &Arm, said: &Said<'_>) {
    let end = said.motion.map_or(*said.from, Motion::stop_rad);
    let clearance = said.motion.map(|motion| clearance_m(args, arm, motion));
    if args.moving.json {
        print_json(&serde_json::json!({
            "outcome": if said.motion.is_none() { "there" } else { "dry_run" },
            "from_rad": said.from.as_slice(),
            "to_rad": end.as_slice(),
            "duration_s": said.motion.map(Motion::duration_s),
            "knots": said.motion.map(|motion| motion.knots.len()),
            "clearance_m": clearance,
        }));
        return;
    }
    let degrees: Vec<String> = end.iter().map(|q| fixed(q.to_degrees(), 2)).collect();
    match said.motion {
        None => console::line!("the arm is there: {} deg; nothing has moved", degrees.join(" ")),
        Some(motion) => {
            if let Some(verdict) = said.record {
                console::line!("{verdict}");
            } else {
                console::line!("way: {}", describe(arm, motion));
            }
            let nearest = clearance
                .map_or_else(String::new, |m| format!("; nearest approach of two bodies {:.0} mm", 1e3 * m));
            console::line!("{} deg{nearest}", degrees.join(" "));
            if !said.moved {
                console::line!("nothing has moved");
            }
        }
    }
}

/// Nearest approach of any two bodies that are tested, at samples of the motion, m.
fn clearance_m(args: &Args, arm: &Arm, motion: &Motion) -> f64 {
    let scene = args.bounds.scene();
    let mut checker = CollisionChecker::new(arm, &scene);
    let at = |i: u32| motion.at(motion.duration_s() * f64::from(i) / 200.0).q;
    (0..=200).map(|i| checker.clearance(&arm.fk(&at(i))).distance_m).fold(f64::INFINITY, f64::min)
}
