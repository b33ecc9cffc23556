//! Values of an answer to a set point.

use nalgebra::Vector3;
use robot_model::{JointVec, Pose, RobotModel};

use super::event::FaultCause;
use super::options::{CorrectionOptions, Space};

const MM_PER_M: f64 = 1000.0;

/// The sum of corrections since the start of the program, and the pose it starts from.
#[derive(Clone, Debug)]
pub struct Correction {
    options: CorrectionOptions,
    start_deg: [f64; 6],
    start_pose: Pose,
    offset: [f64; 6],
}

impl Correction {
    /// Zero, from the start pose.
    pub fn new(options: CorrectionOptions, model: &RobotModel, start_deg: [f64; 6]) -> Self {
        Self { options, start_deg, start_pose: tool(model, &start_deg), offset: [0.0; 6] }
    }

    pub fn start_deg(&self) -> [f64; 6] {
        self.start_deg
    }

    /// The offset from the start pose, after clamping: degrees, or mm and degrees.
    pub fn offset(&self) -> [f64; 6] {
        self.offset
    }

    /// Takes the values of one cycle and returns the set point of the axes.
    ///
    /// # Errors
    /// The overall limit is exceeded, or no axis position reaches the pose.
    pub fn apply(
        &mut self,
        values: &[f64; 6],
        model: &RobotModel,
        last_deg: &[f64; 6],
    ) -> Result<[f64; 6], FaultCause> {
        let limits = self.options.lower.iter().zip(self.options.upper);
        for ((offset, value), (low, high)) in self.offset.iter_mut().zip(values).zip(limits) {
            let wanted = if self.options.relative { *offset + value } else { *value };
            *offset = wanted.max(*low).min(high);
        }
        self.check_overall()?;
        match self.options.space {
            Space::Axes => {
                let mut q_deg = self.start_deg;
                for (q, offset) in q_deg.iter_mut().zip(self.offset) {
                    *q += offset;
                }
                Ok(q_deg)
            }
            Space::Base | Space::Tool => self.reach(model, last_deg),
        }
    }

    fn check_overall(&self) -> Result<(), FaultCause> {
        for (index, offset) in self.offset.iter().enumerate() {
            let limit = match (self.options.space, index) {
                (Space::Axes, _) => self.options.overall_axis_deg,
                (_, 0..3) => self.options.overall_mm,
                _ => self.options.overall_rotation_deg,
            };
            if offset.abs() > limit {
                return Err(FaultCause::OverallLimit { component: index, offset: *offset });
            }
        }
        Ok(())
    }

    /// The axes that put the tool at the corrected pose, in the posture of the last set point.
    fn reach(&self, model: &RobotModel, last_deg: &[f64; 6]) -> Result<[f64; 6], FaultCause> {
        let [x, y, z, a, b, c] = self.offset;
        let shift = Vector3::new(x, y, z) / MM_PER_M;
        let turn = Pose::from_rpy([c, b, a].map(f64::to_radians), Vector3::zeros()).rot;
        let start = self.start_pose;
        let target = match self.options.space {
            Space::Tool => Pose::new(start.rot * turn, start.pos + start.rot * shift),
            Space::Axes | Space::Base => Pose::new(turn * start.rot, start.pos + shift),
        };
        let last = radians(last_deg);
        let solution = model
            .ik_near(&target, &last)
            .ok()
            .zip(model.branch_of(&last))
            .and_then(|(solutions, branch)| solutions.get(branch));
        solution.map(|found| found.q.map(f64::to_degrees).array()).ok_or(FaultCause::NotReachable)
    }
}

/// Axis angles for the robot model.
pub fn radians(q_deg: &[f64; 6]) -> JointVec {
    JointVec::from(q_deg.map(f64::to_radians))
}

/// Pose of the tool (the end effector of the robot file).
pub fn tool(model: &RobotModel, q_deg: &[f64; 6]) -> Pose {
    model.ee_at(&radians(q_deg))
}

/// X, Y, Z in mm and A, B, C in degrees with `R = Rz(A) Ry(B) Rx(C)`.
pub fn cartesian(pose: &Pose) -> [f64; 6] {
    let [c, b, a] = pose.rpy_rad().map(|angle| upper_half(angle.to_degrees()));
    let p = pose.pos * MM_PER_M;
    [p.x, p.y, p.z, a, b, c]
}

/// -180 degrees is written as 180.
fn upper_half(angle_deg: f64) -> f64 {
    if angle_deg <= -180.0 + 1e-9 { angle_deg + 360.0 } else { angle_deg }
}
