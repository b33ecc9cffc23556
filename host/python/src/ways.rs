//! Ways of an arm between bodies, without an arm: contact, search and times.

use host::cmd::move_arm::no_way;
use host::cmd::target::scene;
use planner::motion::Motion;
use planner::plan::file::{MotionInfo, RobotId};
use planner::record::MovePlan;
use planner::timing::{self, Limits, Path};
use planner::way::{self, Travel, WayError};
use pyo3::prelude::*;
use robot_model::collision::{CollisionChecker, Scene};
use robot_model::{JointVec, RobotModel};

use crate::arrays::doubles;
use crate::errors::{bad, refused};
use crate::robot::Robot;

/// A robot and what stands around it.
#[pyclass(frozen)]
pub(crate) struct Surroundings {
    robot: RobotModel,
    source: String,
    scene: Scene,
}

#[pymethods]
impl Surroundings {
    /// `obstacles`: centre and half edges of each box, m, base frame.
    #[new]
    fn new(robot: &Robot, obstacles: &[u8], ball: bool) -> PyResult<Self> {
        let obstacles = doubles(obstacles)?;
        let (boxes, rest) = obstacles.as_chunks::<6>();
        if !rest.is_empty() {
            return Err(bad(&"an obstacle has six numbers: its centre and its half edges"));
        }
        Ok(Self { robot: robot.robot.clone(), source: robot.source.clone(), scene: scene(boxes, ball) })
    }

    /// For each row of angles, whether two bodies touch.
    fn contacts(&self, py: Python<'_>, q_rad: &[u8]) -> PyResult<Vec<bool>> {
        let rows = rows(&self.robot, q_rad)?;
        let mut checker = CollisionChecker::new(&self.robot, &self.scene);
        Ok(py.detach(move || rows.iter().map(|q| checker.collides(&self.robot.fk(q))).collect()))
    }

    /// Whether no two bodies touch while the joints go evenly from the first row to the second.
    fn is_free_line(&self, q_rad: &[u8]) -> PyResult<bool> {
        let rows = rows(&self.robot, q_rad)?;
        let [from, to] = rows[..] else { return Err(bad(&"a line has two ends")) };
        Ok(way::is_free_line(&mut CollisionChecker::new(&self.robot, &self.scene), &from, &to))
    }

    /// The way of `cubectl move` from the first row to the second, as a plan; empty if the arm is there.
    fn way(&self, py: Python<'_>, q_rad: &[u8], speed_share: f64, seed: u64) -> PyResult<String> {
        let rows = rows(&self.robot, q_rad)?;
        let [from, to] = rows[..] else { return Err(bad(&"a way has two ends")) };
        let travel = Travel { share: speed_share, seed, range: None };
        self.plan(py.detach(|| way::way(&self.robot, &self.scene, &travel, &from, &to)))
    }

    /// The motion along lines through corners, each rounded as much as is free, as a plan; empty if all are one place.
    fn through(&self, py: Python<'_>, q_rad: &[u8], speed_share: f64) -> PyResult<String> {
        let rows = rows(&self.robot, q_rad)?;
        self.plan(py.detach(|| way::through(&self.robot, &self.scene, speed_share, &rows)))
    }
}

impl Surroundings {
    fn plan(&self, found: Result<Option<Motion>, WayError>) -> PyResult<String> {
        let motion = found.map_err(|error| refused(&no_way(&error)))?;
        Ok(motion.map_or_else(String::new, |motion| plan(&self.robot, &self.source, &motion)))
    }
}

/// The fastest motion along lines through rows of angles, rounded within `blend_rad`, as a plan. `limits`: largest speeds,
/// accelerations and jerks, one after the other; without jerks these have no limit.
#[pyfunction]
pub(crate) fn along(
    py: Python<'_>,
    robot: &Robot,
    q_rad: &[u8],
    blend_rad: f64,
    limits: &[u8],
) -> PyResult<String> {
    let (points, limits, n) = (rows(&robot.robot, q_rad)?, doubles(limits)?, robot.robot.n());
    let no_jerk = vec![f64::INFINITY; n];
    let parts: Vec<&[f64]> = limits.chunks(n).collect();
    let limits = match parts[..] {
        [v, a] => Limits::new(v, a, &no_jerk),
        [v, a, j] => Limits::new(v, a, j),
        _ => None,
    };
    let limits = limits.ok_or_else(|| bad(&"limits are positive numbers, one for each joint"))?;
    let motion = py.detach(|| {
        // Two points are a line: its times are known in closed form.
        if let [from, to] = &points[..] {
            return Ok(timing::straight(from, to, &limits));
        }
        let points: Vec<&[f64]> = points.iter().map(JointVec::as_slice).collect();
        Path::through(&points, blend_rad).map(|path| timing::along(&path, &limits))
    });
    let motion = motion.map_err(|error| bad(&error))?;
    let motion = motion.ok_or_else(|| bad(&"no times were found: take points out"))?;
    Ok(plan(&robot.robot, &robot.source, &motion))
}

fn plan(robot: &RobotModel, source: &str, motion: &Motion) -> String {
    let names = robot.joints().iter().map(|joint| joint.name.clone());
    MovePlan::new(RobotId::of(source, robot), MotionInfo::of(names, motion)).to_json()
}

fn rows(robot: &RobotModel, q_rad: &[u8]) -> PyResult<Vec<JointVec>> {
    let values = doubles(q_rad)?;
    Ok(values.chunks_exact(robot.n()).map(JointVec::from_slice).collect())
}
