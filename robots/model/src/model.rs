//! The validated robot: the content of a robot file in SI units, with every check passed.

use nalgebra::{Matrix3, Vector3};

use crate::boxes::{BodyBox, CollisionModel};
use crate::drives::{Common, Drives};
use crate::family::Family;
use crate::fingers::Fingers;
use crate::per_joint::{JointVec, PerJoint};
use crate::pose::Pose;

/// A serial arm of four to seven revolute joints, read from a robot file and checked.
///
/// Immutable. Its user can rely on finite numbers, limits in order, positive masses and inertias (so the mass
/// matrix is positive definite), supplies that cover every drive once, and frames that fit the kinematic family.
/// The methods are in one file per concept: `kinematics`, `ik`, `dynamics`, `currents`, `collision`.
#[derive(Debug, Clone)]
pub struct RobotModel {
    pub(crate) name: String,
    pub(crate) description: String,
    pub(crate) joints: Vec<Joint>,
    pub(crate) links: Vec<Link>,
    pub(crate) x_ne: Pose,
    pub(crate) gripper: Gripper,
    pub(crate) fingers: Option<Fingers>,
    pub(crate) family: Family,
    pub(crate) drives: Option<(Drives, Common)>,
    pub(crate) supplies: Vec<Supply>,
    pub(crate) drive_loop: Option<DriveLoop>,
    pub(crate) world: World,
    pub(crate) collision: CollisionModel,
}

/// A revolute joint: where its axis is, and how far and fast it may turn.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Name, unique in the robot.
    pub name: String,
    /// Pose of the joint frame in the frame of the link before, at q = 0; the joint turns about its z axis.
    pub x_pj: Pose,
    /// Range and rates.
    pub limits: JointLimits,
}

/// Range and rates of a joint, on the joint side of the gear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits {
    /// Lower end of the range in rad.
    pub q_min_rad: f64,
    /// Upper end of the range in rad; above `q_min_rad`.
    pub q_max_rad: f64,
    /// Largest speed in rad/s.
    pub v_max_rad_s: f64,
    /// Largest acceleration a plan may use, in rad/s².
    pub a_max_rad_s2: f64,
    /// Largest acceleration the controller may command, in rad/s² (eq. (11) of the throwing paper);
    /// `a_max_rad_s2` where the file gives none.
    pub a_control_max_rad_s2: f64,
    /// Largest acceleration while the hand follows the flight parabola, in rad/s², where the machine has such a limit.
    pub a_follow_max_rad_s2: Option<f64>,
    /// Largest jerk in rad/s³.
    pub j_max_rad_s3: f64,
    /// Largest torque at the joint in N·m, where known.
    pub torque_max_nm: Option<f64>,
}

/// The rigid body that a joint moves, with everything bolted to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// Name, unique in the robot.
    pub name: String,
    /// Mass, centre of mass and inertia in the joint frame.
    pub inertia: LinkInertia,
    /// The frame in which the robot file gives this link's boxes, in the joint frame.
    ///
    /// Identity for modified DH; for standard DH the frame at the far end of the link, for an axis other than z the
    /// frame before it was turned so that the joint turns about z.
    pub x_jl: Pose,
}

/// Mass distribution of a link in its joint frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkInertia {
    mass_kg: f64,
    com_m: Vector3<f64>,
    about_com_kg_m2: Matrix3<f64>,
    // Derived once: first moment m·c and inertia about the frame origin, as the dynamics use them.
    pub(crate) first_moment_kg_m: Vector3<f64>,
    pub(crate) about_origin_kg_m2: Matrix3<f64>,
}

impl LinkInertia {
    /// From mass, centre of mass, and inertia tensor about the centre of mass.
    ///
    /// Returns `None` unless mass is positive, everything is finite, the tensor is symmetric and its principal
    /// moments are those of a body: positive, the largest not above the sum of the other two.
    #[must_use]
    pub fn new(mass_kg: f64, com_m: Vector3<f64>, about_com_kg_m2: Matrix3<f64>) -> Option<Self> {
        let finite = mass_kg.is_finite()
            && com_m.iter().all(|v| v.is_finite())
            && about_com_kg_m2.iter().all(|v| v.is_finite());
        if !finite || mass_kg <= 0.0 {
            return None;
        }
        let scale = about_com_kg_m2.amax();
        if (about_com_kg_m2 - about_com_kg_m2.transpose()).amax() > 1e-12 * scale {
            return None;
        }
        let moments = about_com_kg_m2.symmetric_eigenvalues();
        let (largest, smallest) = (moments.max(), moments.min());
        // Thin plates reach equality, so the triangle inequality gets rounding slack.
        if smallest <= 0.0 || 2.0 * largest > moments.sum() * (1.0 + 1e-9) {
            return None;
        }
        let c2 = com_m.norm_squared();
        let steiner = (Matrix3::identity() * c2 - com_m * com_m.transpose()) * mass_kg;
        Some(Self {
            mass_kg,
            com_m,
            about_com_kg_m2,
            first_moment_kg_m: com_m * mass_kg,
            about_origin_kg_m2: about_com_kg_m2 + steiner,
        })
    }

    /// The same body with a point mass bolted to it at `at_m` in the joint frame, for example a ball in the hand.
    ///
    /// `None` if the mass is negative or not finite.
    #[must_use]
    pub fn with_point_mass(&self, mass_kg: f64, at_m: &Vector3<f64>) -> Option<Self> {
        if !(mass_kg >= 0.0 && mass_kg.is_finite()) {
            return None;
        }
        let total = self.mass_kg + mass_kg;
        let apart = at_m - self.com_m;
        let com = self.com_m + apart * (mass_kg / total);
        let reduced = self.mass_kg * mass_kg / total;
        let steiner = (Matrix3::identity() * apart.norm_squared() - apart * apart.transpose()) * reduced;
        Self::new(total, com, self.about_com_kg_m2 + steiner)
    }

    /// Mass in kg.
    #[must_use]
    pub fn mass_kg(&self) -> f64 {
        self.mass_kg
    }

    /// Centre of mass in the joint frame, in m.
    #[must_use]
    pub fn com_m(&self) -> &Vector3<f64> {
        &self.com_m
    }

    /// Inertia tensor about the centre of mass, axes of the joint frame, in kg·m².
    #[must_use]
    pub fn about_com_kg_m2(&self) -> &Matrix3<f64> {
        &self.about_com_kg_m2
    }

    /// Mass times centre of mass in the joint frame, kg·m.
    #[must_use]
    pub fn first_moment_kg_m(&self) -> &Vector3<f64> {
        &self.first_moment_kg_m
    }

    /// Inertia tensor about the origin of the joint frame, kg·m².
    #[must_use]
    pub fn about_origin_kg_m2(&self) -> &Matrix3<f64> {
        &self.about_origin_kg_m2
    }
}

/// A power supply and the joints on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Supply {
    /// Name, unique in the robot.
    pub name: String,
    /// Voltage in V.
    pub voltage_v: f64,
    /// Largest current in A.
    pub current_max_a: f64,
    /// Which joints it feeds.
    pub feeds: PerJoint<bool>,
}

/// Inner position loop and friction of a drive, the same for all joints; used by the simulator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveLoop {
    /// Natural frequency of the position loop in rad/s.
    pub natural_frequency_rad_s: f64,
    /// Damping ratio of the position loop.
    pub damping_ratio: f64,
    /// Coulomb friction as the joint deceleration it causes, in rad/s².
    pub coulomb_friction_rad_s2: f64,
    /// Step of the measured position in rad.
    pub position_resolution_rad: f64,
    /// Command periods between a command and its effect.
    pub delay_periods: u32,
}

/// What the hand holds, and how.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gripper {
    /// T_ball: release frame in the end-effector frame; origin at the ball's centre, z along the throw.
    pub x_eb: Pose,
    /// Radius of the ball in m.
    pub ball_radius_m: f64,
    /// Mass of the ball in kg, part of the dynamics until the release; zero: the mass is neglected.
    pub ball_mass_kg: f64,
}

/// Surroundings in the world frame (arm base, z up).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct World {
    /// Gravity along -z, in m/s².
    pub gravity_m_s2: f64,
    /// Height of the floor in m.
    pub floor_z_m: f64,
}

impl RobotModel {
    /// The same arm with its ball in the hand, as a point mass fixed to the last link at the release frame; `None`
    /// for a ball without mass, which has no effect.
    #[must_use]
    pub fn holding_ball(&self) -> Option<Self> {
        let mass_kg = self.gripper.ball_mass_kg;
        let last = self.links.last().filter(|_| mass_kg > 0.0)?;
        let at_m = (self.x_ne * self.gripper.x_eb).pos;
        let inertia = last.inertia.with_point_mass(mass_kg, &at_m)?;
        let mut holding = self.clone();
        holding.links[self.n() - 1].inertia = inertia;
        Some(holding)
    }

    /// Number of joints.
    #[must_use]
    #[inline]
    pub fn n(&self) -> usize {
        self.joints.len()
    }

    /// Name of the robot.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// One line about the robot.
    #[must_use]
    pub fn description(&self) -> &str {
        &self.description
    }

    /// The joints, base first.
    #[must_use]
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// The moving links, base first; link `i` is moved by joint `i`.
    #[must_use]
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// End effector in the last joint frame, `X_NE`.
    #[must_use]
    pub fn end_effector(&self) -> &Pose {
        &self.x_ne
    }

    /// Hand and ball.
    #[must_use]
    pub fn gripper(&self) -> &Gripper {
        &self.gripper
    }

    /// How the fingers of the gripper open; `None` if the robot file does not describe them.
    ///
    /// Not part of [`Gripper`]: throws are planned without it, so that stored throws of a robot do not depend on it.
    #[must_use]
    pub fn fingers(&self) -> Option<&Fingers> {
        self.fingers.as_ref()
    }

    /// Kinematic family with its dimensions.
    #[must_use]
    pub fn family(&self) -> &Family {
        &self.family
    }

    /// The power supplies; together they feed every drive exactly once. Empty without drives.
    #[must_use]
    pub fn supplies(&self) -> &[Supply] {
        &self.supplies
    }

    /// Drive loop and friction for simulation, if the robot file describes them.
    #[must_use]
    pub fn drive_loop(&self) -> Option<&DriveLoop> {
        self.drive_loop.as_ref()
    }

    /// Gravity and floor.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Boxes and the pairs to test.
    #[must_use]
    pub fn collision(&self) -> &CollisionModel {
        &self.collision
    }

    /// Lower ends of the joint ranges in rad.
    #[must_use]
    pub fn q_min(&self) -> JointVec {
        self.limit(|l| l.q_min_rad)
    }

    /// Upper ends of the joint ranges in rad.
    #[must_use]
    pub fn q_max(&self) -> JointVec {
        self.limit(|l| l.q_max_rad)
    }

    /// Any limit as a vector, for example `model.limit(|l| l.v_max_rad_s)`.
    #[must_use]
    pub fn limit(&self, pick: impl Fn(&JointLimits) -> f64) -> JointVec {
        JointVec::from_fn(self.n(), |i| pick(&self.joints[i].limits))
    }

    /// Largest torque that gravity causes at each joint, Nm, over a grid of poses: six angles of each of the first
    /// four joints, the others at zero or as near to it as their range allows. The wrist's angles have little
    /// influence. The first axis need not be upright.
    #[must_use]
    pub fn holding_torques(&self) -> JointVec {
        let mut worst = JointVec::zeros(self.n());
        let moved = self.n().min(4);
        for number in 0..6_usize.pow(moved as u32) {
            let mut rest = number;
            let q = JointVec::from_fn(self.n(), |k| {
                let (low, high) = (self.joints[k].limits.q_min_rad, self.joints[k].limits.q_max_rad);
                if k >= moved {
                    return 0_f64.clamp(low, high);
                }
                let angle = low + (rest % 6) as f64 / 5.0 * (high - low);
                rest /= 6;
                angle
            });
            worst = worst.sup(&self.gravity_torques(&q).abs());
        }
        worst
    }

    /// Whether every joint is inside its range, widened by `slack_rad` on both sides.
    #[must_use]
    pub fn in_range(&self, q_rad: &JointVec, slack_rad: f64) -> bool {
        self.joints
            .iter()
            .zip(q_rad.iter())
            .all(|(j, q)| *q >= j.limits.q_min_rad - slack_rad && *q <= j.limits.q_max_rad + slack_rad)
    }

    /// The same robot with the ball held at another point of the end-effector frame, m. Inertias stay as they are.
    #[must_use]
    pub fn with_release_at(mut self, at_e_m: Vector3<f64>) -> Self {
        self.gripper.x_eb.pos = at_e_m;
        self.with_hand(&[], [])
    }

    /// The same robot with another hand for the collision tests: boxes of the last link with the names in `gone`
    /// are removed; `boxes` (name, pose in the end-effector frame, half edge lengths in m, all positive) are added.
    /// Masses stay as they are.
    #[must_use]
    pub fn with_hand(
        mut self,
        gone: &[String],
        boxes: impl IntoIterator<Item = (String, Pose, Vector3<f64>)>,
    ) -> Self {
        let last = self.n();
        let kept = |b: &&BodyBox| b.link != last || !gone.contains(&b.name);
        let mut all: Vec<BodyBox> = self.collision.boxes().iter().filter(kept).cloned().collect();
        let hand = boxes.into_iter();
        all.extend(hand.map(|(name, x_eb, half_m)| BodyBox {
            name,
            link: last,
            x_lb: self.x_ne * x_eb,
            half_m,
        }));
        let x_pj: Vec<Pose> = self.joints.iter().map(|joint| joint.x_pj).collect();
        let ball_n = self.x_ne.transform_point(&self.gripper.x_eb.pos);
        self.collision = CollisionModel::new(all, self.collision.rule(), &x_pj, &ball_n);
        self
    }

    /// The same robot with other link inertias, for robustness studies and payloads.
    #[must_use]
    pub fn with_inertias(mut self, change: impl Fn(usize, &LinkInertia) -> LinkInertia) -> Self {
        for (i, link) in self.links.iter_mut().enumerate() {
            link.inertia = change(i, &link.inertia);
        }
        self
    }
}
