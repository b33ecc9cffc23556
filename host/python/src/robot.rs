//! A robot: names, limits, kinematics and gravity.

use pyo3::prelude::*;
use pyo3::types::PyByteArray;
use robot_model::{JointVec, RobotModel};

use crate::arrays::{array, doubles};
use crate::errors::bad;

/// A robot from its file.
#[pyclass(frozen)]
pub(crate) struct Robot {
    pub(crate) robot: RobotModel,
    #[pyo3(get)]
    pub(crate) source: String,
}

#[pymethods]
impl Robot {
    #[new]
    fn new(source: String) -> PyResult<Self> {
        let robot = RobotModel::load(&source).map_err(|error| bad(&error))?;
        Ok(Self { robot, source })
    }

    #[getter]
    fn name(&self) -> String {
        self.robot.name().to_owned()
    }

    #[getter]
    fn joint_names(&self) -> Vec<String> {
        self.robot.joints().iter().map(|joint| joint.name.clone()).collect()
    }

    #[getter]
    fn gravity_m_s2(&self) -> f64 {
        self.robot.world().gravity_m_s2
    }

    /// Smallest and largest angles, rad, then largest speeds, rad/s, accelerations, rad/s², and jerks, rad/s³.
    fn limits<'py>(&self, py: Python<'py>) -> Bound<'py, PyByteArray> {
        let robot = &self.robot;
        let (v, a) = (robot.limit(|l| l.v_max_rad_s), robot.limit(|l| l.a_max_rad_s2));
        let j = robot.limit(|l| l.j_max_rad_s3);
        array(py, &[&robot.q_min()[..], &robot.q_max(), &v, &a, &j].concat())
    }

    /// Poses of the ball in the hand in the world, 4 × 4 by rows, for rows of angles.
    fn hand<'py>(&self, py: Python<'py>, q_rad: &[u8]) -> PyResult<Bound<'py, PyByteArray>> {
        let values = doubles(q_rad)?;
        let poses = py.detach(|| {
            rows(&self.robot, &values, |q| {
                self.robot.ball(&self.robot.fk(q)).to_matrix().transpose().iter().copied().collect()
            })
        });
        Ok(array(py, &poses))
    }

    /// Torques that hold the arm against gravity, Nm, for rows of angles.
    fn gravity_torques<'py>(&self, py: Python<'py>, q_rad: &[u8]) -> PyResult<Bound<'py, PyByteArray>> {
        let values = doubles(q_rad)?;
        let torques = py.detach(|| {
            rows(&self.robot, &values, |q| self.robot.gravity_torques(q).iter().copied().collect())
        });
        Ok(array(py, &torques))
    }
}

/// A function of each row of as many angles as there are joints, its results one after the other.
fn rows(robot: &RobotModel, values: &[f64], of: impl Fn(&JointVec) -> Vec<f64>) -> Vec<f64> {
    values.chunks_exact(robot.n()).flat_map(|row| of(&JointVec::from_slice(row))).collect()
}
