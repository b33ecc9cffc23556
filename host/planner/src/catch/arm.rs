//! The arm that catches: kinematics, cup, place in the world, limits.

use std::sync::Arc;

use nalgebra::Vector3;
use robot_model::collision::{Obb, Scene};
use robot_model::{AxisTool, Family, Pose, RobotModel};

use super::Joints;
use super::bounce::{CupNow, StayTable};
use super::cup::Cup;
use crate::motion_law::{Limits, MotionLaw};

/// Shares of the limits that a plan may use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shares {
    pub speed: f64,
    /// Of the acceleration, for the first motion of a catch.
    pub first: f64,
    /// Of the acceleration, for corrections.
    pub correction: f64,
    pub current: f64,
}

impl Default for Shares {
    /// 95 % of speed and current, 80 % of the acceleration at first and 95 % for corrections.
    fn default() -> Self {
        Self { speed: 0.95, first: 0.8, correction: 0.95, current: 0.95 }
    }
}

/// Why an arm cannot catch.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NotACatcher {
    /// Its family has no closed form, or the tool axis is not its last axis.
    #[error(
        "its tool axis is not the last axis of a wrist of three axes that meet: no closed form for a cup"
    )]
    NoClosedForm,
    /// It has no drives, so no currents.
    #[error("its file describes no drives: currents cannot be checked")]
    NoDrives,
}

/// Name of the cup among the boxes of the arm.
pub const CUP_BODY: &str = "cup";
/// Margin to the ends of the joint ranges, rad.
const RANGE_MARGIN_RAD: f64 = 0.01;

/// The arm, ready to plan catches.
#[derive(Debug, Clone)]
pub struct CatchArm {
    pub(super) model: RobotModel,
    pub(super) x_wb: Pose,
    pub(super) tool: AxisTool,
    pub(super) cup: Cup,
    pub(super) stays: Arc<StayTable>,
    pub(super) law: MotionLaw,
    pub(super) shares: Shares,
    first: [Limits; 6],
    correction: [Limits; 6],
    pub(super) scene: Scene,
}

impl CatchArm {
    /// `x_wb` is the pose of the arm's base in the world; `jerk` keeps the jerk limits of the robot file as well. How a ball bounces in the
    /// cup is worked out here; [`CatchArm::with_arm`] has another arm with the same cup.
    ///
    /// # Errors
    /// The arm cannot hold a cup that this planner can aim.
    pub fn new(
        model: RobotModel,
        x_wb: Pose,
        cup: Cup,
        shares: Shares,
        jerk: bool,
    ) -> Result<Self, NotACatcher> {
        let stays = Arc::new(StayTable::new(&cup));
        Self::holding(model, x_wb, (cup, stays), shares, jerk)
    }

    /// Another arm with the same cup and shares of its limits.
    ///
    /// # Errors
    /// As for [`CatchArm::new`].
    pub fn with_arm(&self, model: RobotModel, x_wb: Pose, jerk: bool) -> Result<Self, NotACatcher> {
        Self::holding(model, x_wb, (self.cup.clone(), self.stays.clone()), self.shares, jerk)
    }

    fn holding(
        model: RobotModel,
        x_wb: Pose,
        (cup, stays): (Cup, Arc<StayTable>),
        shares: Shares,
        jerk: bool,
    ) -> Result<Self, NotACatcher> {
        let tool = model.axis_tool(cup.mouth_m).ok_or(NotACatcher::NoClosedForm)?;
        if model.drives().is_none() {
            return Err(NotACatcher::NoDrives);
        }
        let limits = |acceleration: f64| {
            std::array::from_fn(|i| {
                let l = &model.joints()[i].limits;
                let margin = RANGE_MARGIN_RAD.min(0.1 * (l.q_max_rad - l.q_min_rad));
                Limits {
                    q_rad: (l.q_min_rad + margin, l.q_max_rad - margin),
                    v_rad_s: l.v_max_rad_s * shares.speed,
                    a_rad_s2: l.a_max_rad_s2.min(l.a_control_max_rad_s2) * acceleration,
                    j_rad_s3: if jerk { l.j_max_rad_s3 * shares.correction } else { f64::INFINITY },
                }
            })
        };
        let (first, correction) = (limits(shares.first), limits(shares.correction));
        let half = 0.5 * cup.length_m();
        let shell = (
            CUP_BODY.to_owned(),
            Pose::translation(0.0, 0.0, cup.mouth_m - half),
            Vector3::new(cup.outer_radius_m(), cup.outer_radius_m(), half),
        );
        let model = model.with_hand(&cup.replaces, [shell]);
        Ok(Self {
            model,
            x_wb,
            tool,
            cup,
            stays,
            law: MotionLaw::new(jerk),
            shares,
            first,
            correction,
            scene: Scene::default(),
        })
    }

    /// Boxes in the world that the arm keeps clear of: the other arm where it stands.
    pub fn set_obstacles(&mut self, boxes: &[Obb]) {
        let x_bw = self.x_wb.inverse();
        let placed = boxes.iter().map(|b| ("other arm".to_owned(), Obb::new(x_bw * b.pose, b.half_m)));
        self.scene.obstacles = placed.collect();
    }

    /// What the arm keeps clear of beside itself and the floor, in its base frame.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Boxes of this arm in the world.
    #[must_use]
    pub fn boxes(&self, q: &Joints) -> Vec<Obb> {
        let boxes = self.model.boxes_at(&self.model.fk(q));
        boxes.into_iter().map(|b| Obb::new(self.x_wb * b.pose, b.half_m)).collect()
    }

    /// Limits for the first motion of a catch, or for a correction.
    #[must_use]
    pub fn limits(&self, correction: bool) -> &[Limits; 6] {
        if correction { &self.correction } else { &self.first }
    }

    /// The arm with its cup in the place of the boxes that the cup replaces.
    #[must_use]
    pub fn model(&self) -> &RobotModel {
        &self.model
    }

    /// Farthest that the middle of the mouth is from [`CatchArm::shoulder_m`], m.
    #[must_use]
    pub fn reach_m(&self) -> f64 {
        match self.model.family() {
            Family::OrthoParallel(arm) => {
                arm.arm_reach_m() + arm.a1_m.abs() + arm.b_m.abs() + self.tool.length_m.abs()
            }
            _ => 0.0,
        }
    }

    /// What gravity presses a ball in a cup at rest with: upwards, m/s².
    pub(super) fn gravity_m_s2(&self) -> Vector3<f64> {
        Vector3::z() * self.model.world().gravity_m_s2
    }

    /// Middle of the shoulder in the world, m.
    #[must_use]
    pub fn shoulder_m(&self) -> Vector3<f64> {
        let frames = self.model.fk(&Joints::zeros(6));
        let axis = frames.axis(0);
        let on_axis = frames.origin(0) + axis * (frames.origin(1) - frames.origin(0)).dot(&axis);
        self.x_wb.transform_point(&on_axis)
    }

    /// Radius of the ball in the robot file, m.
    #[must_use]
    pub fn ball_radius_m(&self) -> f64 {
        self.model.gripper().ball_radius_m
    }

    /// Pose of the base in the world.
    #[must_use]
    pub fn x_wb(&self) -> &Pose {
        &self.x_wb
    }

    #[must_use]
    pub fn cup(&self) -> &Cup {
        &self.cup
    }

    /// The law of motion.
    #[must_use]
    pub fn law(&self) -> &MotionLaw {
        &self.law
    }

    /// Middle of the mouth (m), tool axis, and velocity of the mouth (m/s) in the world.
    #[must_use]
    pub fn mouth(&self, q: &Joints, qd: &Joints) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
        let now = self.cup_at(q, qd);
        (now.mouth_m, now.axis, now.v_m_s)
    }

    /// The cup in the world.
    pub(super) fn cup_at(&self, q: &Joints, qd: &Joints) -> CupNow {
        let frames = self.model.fk(q);
        let x_be = self.model.ee(&frames);
        let axis = x_be.rot.column(2).into_owned();
        let p = x_be.pos + axis * self.cup.mouth_m;
        let (mut v, mut w) = (Vector3::zeros(), Vector3::zeros());
        for i in 0..6 {
            let rate = frames.axis(i) * qd[i];
            v += rate.cross(&(p - frames.origin(i)));
            w += rate;
        }
        let rot = &self.x_wb.rot;
        CupNow { mouth_m: self.x_wb.transform_point(&p), axis: rot * axis, v_m_s: rot * v, w_rad_s: rot * w }
    }

    /// The same arm for a cup with another restitution, 0 to 1.
    pub fn set_restitution(&mut self, restitution: f64) {
        self.cup.contact.restitution = restitution;
        self.stays = Arc::new(StayTable::new(&self.cup));
    }
}
