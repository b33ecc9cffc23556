//! Catches as MCAP files for viewers: joints as executed, and where ball or disc was.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use operator::ball_catch::on_bus::Caught;
use operator::ball_catch::trial::{Outcome, Pair};
use operator::disc::Executed;
use operator::log::arm_view::Thrown;
use operator::log::{files_of, mcap};
use operator::machine::Machine;
use planner::disc::aero::Body;
use planner::disc::flight;
use protocol::{Duration, Instant};
use robot_model::{Pose, RobotModel};

use crate::error::ExpectedError;

/// The file of `--record PATH`.
pub(super) fn file_of(path: &Path) -> PathBuf {
    let [_, mcap] = files_of(path);
    mcap
}

/// A simulated catch: the joints of one arm of the cell, 0 (thrower) or 1 (catcher), and the ball. Times count from the start of the
/// trial.
pub fn simulated(file: &Path, pair: &Pair, arm: usize, outcome: &Outcome) -> Result<(), ExpectedError> {
    let place = &pair.cell.arms[arm];
    let shape = Thrown::Ball { radius_m: pair.cell.ball.radius_m };
    let moments = outcome
        .trace
        .iter()
        .map(|moment| (moment.t_s, moment.q[arm].as_slice().to_vec(), moment.ball_m.into(), shape));
    write(file, &place.model, &place.x_wb.inverse(), moments)
}

/// A disc, and the joints as the simulated drives moved them. Times count from the release.
pub(super) fn disc(
    file: &Path,
    robot: &RobotModel,
    path: &flight::Path,
    radius_m: f64,
    executed: &Executed,
) -> Result<(), ExpectedError> {
    let thickness_m = 2.0 * Body::of_paper().half_height_m;
    let moments = executed.moved.iter().map(|moved| {
        let disc = path.at(moved.t_s);
        let shape = Thrown::Disc { radius_m, thickness_m, normal: disc.normal.into() };
        (moved.t_s, moved.q.as_slice().to_vec(), disc.p_m.into(), shape)
    });
    write(file, robot, &Pose::identity(), moments)
}

/// Time in s, joint angles in rad, place in the room in m, and what is there.
type Sample = (f64, Vec<f64>, [f64; 3], Thrown);

fn write(
    file: &Path,
    robot: &RobotModel,
    x_br: &Pose,
    samples: impl Iterator<Item = Sample>,
) -> Result<(), ExpectedError> {
    let write = || -> io::Result<()> {
        let mut log = mcap::Log::new(File::create_new(file)?, Duration::ZERO, Some(Machine::of(robot)))?;
        log.room(Instant::ZERO, x_br)?;
        for (t_s, q_rad, p_m, shape) in samples {
            let at = at(t_s);
            log.joints(at, &q_rad)?;
            log.thrown(at, p_m, &shape)?;
        }
        log.finish()
    };
    write().map_err(|e| ExpectedError::output(file, &e))
}

/// What the tracker showed of the ball in catches over a bus, at the times of the recordings of the buses.
pub fn markers<'a>(
    file: &Path,
    radius_m: f64,
    catches: impl IntoIterator<Item = &'a Caught>,
) -> Result<(), ExpectedError> {
    let mut catches = catches.into_iter().peekable();
    let Some((_, zero_unix)) = catches.peek().map(|first| first.zero) else { return Ok(()) };
    let write = || -> io::Result<()> {
        let mut log = mcap::Log::new(File::create_new(file)?, zero_unix, None)?;
        for caught in catches {
            let (zero, unix) = caught.zero;
            for (t_s, p_m) in &caught.ball {
                // The clocks of the sessions begin at different times.
                let at_s = (unix.as_secs_f64() - zero_unix.as_secs_f64()) + zero.as_secs_f64() + t_s;
                log.thrown(at(at_s), (*p_m).into(), &Thrown::Ball { radius_m })?;
            }
        }
        log.finish()
    };
    write().map_err(|e| ExpectedError::output(file, &e))
}

fn at(t_s: f64) -> Instant {
    Instant::ZERO + Duration::from_secs_f64(t_s.max(0.0))
}
