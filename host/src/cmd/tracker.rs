//! `cubectl tracker`: targets and calibration from an optical tracker; options of `throw --target tracker`.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::Ordering;
use std::time::{SystemTime, UNIX_EPOCH};

use operator::interrupt::interrupt;
use operator::tracker::calibration::{Calibration, Pair, RoomToRobot, Solved, Unsolved, solve};
use operator::tracker::client::{Place, TrackerError, measure};
use operator::tracker::target::{Target, TargetRequest};
use planner::store::file::write_whole;
use robot_model::{Pose, RobotModel};

use super::print_json;
use super::values::numbers;
use crate::error::ExpectedError;
use crate::exit;

/// A target that moved farther than this between two looks is not thrown at, m.
const MOVED_MAX_M: f64 = 0.005;

/// Where to throw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TargetArg {
    /// A point in the robot's frame, m.
    Point([f64; 3]),
    /// Where the tracker sees it.
    Tracker,
}

impl FromStr for TargetArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "tracker" { Ok(Self::Tracker) } else { numbers(text).map(Self::Point) }
    }
}

/// Options of the tracker: its address, its calibration, and which body is the target.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "An optical tracker")]
pub struct TrackerArgs {
    /// Tracker: HOST:PORT of this machine to which DTrack sends its data, dtrack://HOST:PORT?commands=HOST:PORT to start and
    /// stop its measurement too, or vrpn://HOST/NAME.
    #[arg(long, default_value = "127.0.0.1:5000", value_name = "TRACKER")]
    pub tracker: Place,
    /// Number of the tracked body.
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub tracker_body: u32,
    /// The point on the body, m, in the frame of the body.
    #[arg(long, default_value = "0,0,0", value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = numbers::<3>)]
    pub tracker_offset: [f64; 3],
    /// Frames whose mean is taken.
    #[arg(long, default_value_t = 60, value_name = "K", value_parser = clap::value_parser!(u16).range(6..=6000))]
    pub tracker_frames: u16,
    /// Calibration from the tracker's room to the robot, of `cubectl tracker calibrate` [default: the room's frame is the
    /// robot's].
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
}

/// The verbs.
#[derive(Debug, clap::Subcommand)]
pub enum TrackerVerb {
    /// Measure the target and say where it is, and how sure that is.
    Show(ShowArgs),
    /// Add a point that robot and tracker both know to a calibration, and solve it.
    Calibrate(CalibrateArgs),
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl tracker show --tracker 0.0.0.0:5000\n  cubectl tracker show --tracker vrpn://lab/Tracker0 --tracker-body 2 --calibration room.toml --json"
)]
pub struct ShowArgs {
    #[command(flatten)]
    pub tracker: TrackerArgs,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples, once for each of four or more places of the tool, which are not in a plane:\n  cubectl tracker calibrate --file room.toml --tool-at 1.1,0.4,0.9 --tracker-body 1\n  cubectl tracker calibrate --file room.toml        # solves again, measures nothing\n\nMove the robot to a place, read the position of the tracked body from its pendant (in the robot's base frame, m), and give it\nas --tool-at. As long as the points do not check each other the file is kept and the exit code is 9."
)]
pub struct CalibrateArgs {
    /// The tracker; with --tracker-offset the body need not be at the tool point itself.
    #[command(flatten)]
    pub tracker: TrackerArgs,
    /// Calibration file; new points are added to it.
    #[arg(long, value_name = "FILE")]
    pub file: PathBuf,
    /// Where the tracked point is in the robot's base frame, m.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = numbers::<3>)]
    pub tool_at: Option<[f64; 3]>,
    /// Robot whose frame it is.
    #[arg(long, default_value = "kr16_2", value_name = "ROBOT")]
    pub robot: String,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

impl From<TrackerError> for ExpectedError {
    fn from(error: TrackerError) -> Self {
        let code = match error {
            TrackerError::NoTarget(_) => exit::FINDINGS,
            TrackerError::Interrupted => exit::INTERRUPTED,
            _ => exit::BUS,
        };
        Self::of(code, &error)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// In the robot's frame, m.
    pub robot_m: [f64; 3],
    /// In the room.
    pub target: Target,
    /// Residual of the calibration, m; `None` without one.
    pub residual_m: Option<f64>,
}

impl TrackerArgs {
    fn wish(&self) -> TargetRequest {
        TargetRequest {
            offset_m: self.tracker_offset,
            frames: usize::from(self.tracker_frames),
            ..TargetRequest::new(self.tracker_body)
        }
    }

    fn room(&self) -> Result<(RoomToRobot, Option<f64>), ExpectedError> {
        let Some(path) = &self.calibration else { return Ok((RoomToRobot::identity(), None)) };
        let calibration = Calibration::load(path).map_err(|error| ExpectedError::bad_input(&error))?;
        let solved = solved(&calibration, path)?;
        Ok((solved.x_wr, Some(solved.residual_rms_m)))
    }

    /// Refuses a calibration that was made for another robot.
    ///
    /// # Errors
    /// So it is, or the file cannot be read.
    pub(super) fn require_robot(&self, robot: &str) -> Result<(), ExpectedError> {
        let Some(path) = &self.calibration else { return Ok(()) };
        let calibration = Calibration::load(path).map_err(|error| ExpectedError::bad_input(&error))?;
        require_robot(&calibration, path, robot)
    }

    /// Measures the target.
    ///
    /// # Errors
    /// The calibration is refused, or there is no target.
    pub fn measure(&self) -> Result<Measured, ExpectedError> {
        let (x_wr, residual_m) = self.room()?;
        let stop = interrupt();
        let target = measure(&self.tracker, &self.wish(), &|| !stop.load(Ordering::Relaxed))?;
        Ok(Measured { robot_m: x_wr.apply(&target.mean_m), target, residual_m })
    }

    /// Measures again: how far the target is from where it was, m.
    pub fn moved(&self, before: &Measured) -> Result<f64, ExpectedError> {
        let now = self.measure()?;
        let squares: f64 = now.robot_m.iter().zip(before.robot_m).map(|(a, b)| (a - b) * (a - b)).sum();
        Ok(squares.sqrt())
    }

    /// Refuses a target that is no longer where it was measured.
    ///
    /// # Errors
    /// It moved, or is lost.
    pub fn still_there(&self, before: &Measured) -> Result<(), ExpectedError> {
        let by_m = self.moved(before)?;
        if by_m <= MOVED_MAX_M {
            return Ok(());
        }
        Err(ExpectedError::new(
            exit::FINDINGS,
            format!("the target moved by {:.1} mm since it was measured; nothing was thrown", 1e3 * by_m),
        )
        .next("fix the target and throw again"))
    }
}

/// Two names of one robot are the same: its file, and the name in it.
/// The frame of the room in that of the robot, by a calibration that was made for this robot.
pub(super) fn room_to_robot(path: &Path, robot: &str) -> Result<Pose, ExpectedError> {
    let calibration = Calibration::load(path).map_err(|error| ExpectedError::bad_input(&error))?;
    require_robot(&calibration, path, robot)?;
    let solved = solved(&calibration, path)?;
    Ok(Pose::new(solved.x_wr.rotation, solved.x_wr.translation_m))
}

/// Most that the room may lean against the base of an arm that catches, degrees: gravity is along z of the room, and a lean of one
/// degree moves a ball by 4 cm in 0.7 s.
const LEAN_MAX_DEG: f64 = 1.0;

/// Where the base of the robot stands in the room of the tracker, by a calibration that was made for this robot.
///
/// # Errors
/// The file is refused or belongs to another robot, or the z axis of the room is not that of the base.
pub fn base_in_room(path: &Path, robot: &str) -> Result<Pose, ExpectedError> {
    let x_room_base = room_to_robot(path, robot)?.inverse();
    let lean_deg = x_room_base.rot[(2, 2)].clamp(-1.0, 1.0).acos().to_degrees();
    if lean_deg <= LEAN_MAX_DEG {
        return Ok(x_room_base);
    }
    Err(ExpectedError::bad_input(&format!(
        "{}: z of the room leans by {lean_deg:.1} degrees against z of the base; a ball falls along one of them",
        path.display()
    ))
    .next("level the room calibration of the tracker, so that its z axis points up"))
}

fn solved(calibration: &Calibration, path: &Path) -> Result<Solved, ExpectedError> {
    let refused = |error: Unsolved| ExpectedError::bad_input(&error).at(path.display());
    let solved = solve(&calibration.pairs).map_err(refused)?;
    solved.agree().map_err(refused)?;
    Ok(solved)
}

fn require_robot(calibration: &Calibration, path: &Path, robot: &str) -> Result<(), ExpectedError> {
    let name = |robot: &str| {
        RobotModel::load(robot).map_or_else(|_| robot.to_owned(), |robot| robot.name().to_owned())
    };
    if name(&calibration.robot) == name(robot) {
        return Ok(());
    }
    Err(ExpectedError::bad_input(&format!(
        "{} is for the robot {}, not for {robot}",
        path.display(),
        calibration.robot
    ))
    .next("name another calibration, or the robot with --robot"))
}

impl Measured {
    /// For people.
    #[must_use]
    pub fn words(&self) -> String {
        let [x, y, z] = self.robot_m;
        let t = &self.target;
        let calibration = match self.residual_m {
            Some(residual_m) => format!("calibration within {:.2} mm", 1e3 * residual_m),
            None => "no calibration: the room's frame is taken as the robot's".to_owned(),
        };
        format!(
            "target at ({x:.4}, {y:.4}, {z:.4}) m: {} frames in {:.2} s scatter by {:.2} mm, mean known to {:.3} mm, {} frames without \
             the body; {calibration}",
            t.frames,
            t.span_s,
            1e3 * t.scatter_m,
            1e3 * t.error_m,
            t.missing
        )
    }

    #[must_use]
    pub fn json(&self) -> serde_json::Value {
        serde_json::json!({
            "position_m": self.robot_m,
            "room_m": self.target.mean_m,
            "scatter_m": self.target.scatter_m,
            "standard_error_m": self.target.error_m,
            "frames": self.target.frames,
            "span_s": self.target.span_s,
            "missing_frames": self.target.missing,
            "calibration_residual_m": self.residual_m,
        })
    }
}

pub fn run(verb: &TrackerVerb) -> Result<(), ExpectedError> {
    match verb {
        TrackerVerb::Show(args) => show(args),
        TrackerVerb::Calibrate(args) => calibrate(args),
    }
}

fn show(args: &ShowArgs) -> Result<(), ExpectedError> {
    let measured = args.tracker.measure()?;
    if args.json {
        print_json(&measured.json());
    } else {
        console::line!("{}", measured.words());
    }
    Ok(())
}

fn calibrate(args: &CalibrateArgs) -> Result<(), ExpectedError> {
    let mut calibration = if args.file.is_file() {
        Calibration::load(&args.file).map_err(|error| ExpectedError::bad_input(&error))?
    } else {
        Calibration { robot: args.robot.clone(), ..Calibration::default() }
    };
    require_robot(&calibration, &args.file, &args.robot)?;
    if let Some(robot_m) = args.tool_at {
        let stop = interrupt();
        let target = measure(&args.tracker.tracker, &args.tracker.wish(), &|| !stop.load(Ordering::Relaxed))?;
        calibration.pairs.push(Pair { robot_m, room_m: target.mean_m, scatter_m: target.scatter_m });
        calibration.source = format!(
            "{}, body {}, offset {:?} m",
            args.tracker.tracker, args.tracker.tracker_body, args.tracker.tracker_offset
        );
        let s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        calibration.changed = format!("{s} s after 1970-01-01 UTC");
        write_whole(&args.file, calibration.to_toml().as_bytes())
            .map_err(|error| ExpectedError::output(&args.file, &error))?;
    }
    let judged = solve(&calibration.pairs).and_then(|solved| {
        print(args, &calibration, &solved);
        solved.agree()
    });
    judged.map_err(|error| ExpectedError::of(exit::FINDINGS, &error).at(args.file.display()))
}

fn print(args: &CalibrateArgs, calibration: &Calibration, solved: &Solved) {
    if args.json {
        let rows: Vec<Vec<f64>> =
            (0..3).map(|row| solved.x_wr.rotation.row(row).iter().copied().collect()).collect();
        let translation: [f64; 3] = solved.x_wr.translation_m.into();
        print_json(&serde_json::json!({
            "points": calibration.pairs.len(),
            "residual_rms_m": solved.residual_rms_m,
            "residuals_m": solved.residuals_m,
            "distances_from_where_the_others_put_it_m": solved.foretold_m,
            "rotation_rows": rows,
            "translation_m": translation,
        }));
        return;
    }
    console::line!(
        "{} points fit within {:.2} mm (root mean square)",
        calibration.pairs.len(),
        1e3 * solved.residual_rms_m
    );
    let distances = solved.residuals_m.iter().zip(&solved.foretold_m);
    for (k, (pair, (residual_m, foretold_m))) in calibration.pairs.iter().zip(distances).enumerate() {
        let [x, y, z] = pair.robot_m;
        console::line!(
            "  point {} at ({x:.3}, {y:.3}, {z:.3}) m: {:.2} mm, {:.2} mm from where the others put it",
            k + 1,
            1e3 * residual_m,
            1e3 * foretold_m
        );
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use hil_sim::tracker::serve::Sockets;
    use hil_sim::tracker::{BodyMotion, BodyOptions, Tracker, TrackerOptions};
    use protocol::{Duration, Instant};

    use super::*;

    /// Calls `look` with the options of a simulated tracker that sees a body there, or none.
    fn looked<T>(at_mm: Option<[f64; 3]>, look: impl FnOnce(&TrackerArgs) -> T) -> T {
        let body = |p| BodyOptions { id: 0, motion: BodyMotion::at_rest(p) };
        let bodies = at_mm.map(body).into_iter().collect();
        let period = Duration::from_millis(2);
        let mut tracker = Tracker::new(TrackerOptions { period, bodies, ..TrackerOptions::default() }, 2);
        let mut sockets = Sockets::bind(([127, 0, 0, 1], 0).into()).expect("a port");
        let commands = sockets.command_address().expect("bound").to_string();
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                sockets.run(&mut tracker, Instant::FAR_FUTURE, &|| !over.load(Ordering::Relaxed));
            });
            let args = TrackerArgs {
                tracker: Place::DTrack { data: "127.0.0.1:0".to_owned(), commands: Some(commands) },
                tracker_body: 0,
                tracker_offset: [0.0; 3],
                tracker_frames: 60,
                calibration: None,
            };
            let result = look(&args);
            over.store(true, Ordering::Relaxed);
            result
        })
    }

    #[test]
    fn target_that_moved_by_more_than_5_mm_or_is_gone_is_not_thrown_at() {
        let before = looked(Some([2_500.0, 0.0, 600.0]), TrackerArgs::measure).expect("a target");
        let still = |at_mm| looked(at_mm, |args| args.still_there(&before));
        assert!(still(Some([2_500.0, 2.0, 600.0])).is_ok(), "2 mm");
        let error = still(Some([2_500.0, 4.8, 603.6])).expect_err("6 mm");
        assert_eq!(error.code, exit::FINDINGS);
        assert!(error.what.contains("moved by 6.0 mm") && error.what.contains("nothing was thrown"));
        let error = still(None).expect_err("gone");
        assert_eq!(error.code, exit::FINDINGS);
        assert!(error.what.contains("was not seen"), "{error}");
    }
}
