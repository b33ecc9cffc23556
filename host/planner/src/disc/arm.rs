//! The arm of paper 001: a turntable, three parallel axes and a gripper that takes a disc by its rim.
//!
//! The terminal point is the end of link 4; the gripper starts there. Its frame has x along the hand, y up for a level
//! hand, z across.

use nalgebra::{Matrix3, Vector3};
use robot_model::{Family, RobotModel};

use super::{HandJacobian, Joints};

/// θ2 + θ3 + θ4 of a level hand that points outwards.
pub const LEVEL_SUM_RAD: f64 = -std::f64::consts::FRAC_PI_2;

/// Where the arm waits for a throw, rad: folded, hand level and outwards, chosen so that most catch places are near.
pub const READY_RAD: [f64; 4] = [0.0, 0.4, -1.6, LEVEL_SUM_RAD + 1.2];

/// A four-axis arm with the zero position of paper 001, and its sizes.
#[derive(Debug, Clone)]
pub struct DiscArm {
    pub model: RobotModel,
    /// Its lengths.
    pub size: Size,
}

/// Lengths in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// Height of axis 2.
    pub base_m: f64,
    /// Axis 2 to axis 3.
    pub upper_m: f64,
    /// Axis 3 to axis 4.
    pub fore_m: f64,
    /// Axis 4 to the terminal point.
    pub hand_m: f64,
    /// Terminal point to the tip of the gripper.
    pub gripper_m: f64,
    /// Radius of the disc that the gripper takes.
    pub disc_radius_m: f64,
}

impl Size {
    /// Largest distance of axis 4 from axis 2.
    #[must_use]
    pub fn reach_m(&self) -> f64 {
        self.upper_m + self.fore_m
    }

    /// Distance from the terminal point to the disc's centre at which the tip touches the rim.
    #[must_use]
    pub fn touch_m(&self) -> f64 {
        self.gripper_m + self.disc_radius_m
    }
}

/// Why a robot is not an arm for discs.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NotADiscArm {
    /// Other kinematics.
    #[error(
        "its family is {0}; a turntable with three parallel axes is needed (family \"turntable_planar\")"
    )]
    Family(String),
    /// Other zero position or sense of rotation.
    #[error("at joint angles {q:?} rad its end is {off_m:.3} m from where the equations of paper 001 put it")]
    Zero {
        /// Where it was looked at.
        q: [f64; 4],
        /// How far off.
        off_m: f64,
    },
    /// The gripper does not reach beyond the end of link 4.
    #[error("the held body must be more than its radius ahead of the end effector along x, at y = z = 0")]
    Gripper,
}

/// Sine and cosine sums of eq. (6).
struct Sums {
    c: [f64; 3],
    s: [f64; 3],
}

impl DiscArm {
    /// Takes a robot whose kinematics are those of paper 001, with any lengths.
    ///
    /// # Errors
    /// [`NotADiscArm`] names what differs.
    pub fn new(model: RobotModel) -> Result<Self, NotADiscArm> {
        let Family::TurntablePlanar(plane) = model.family() else {
            return Err(NotADiscArm::Family(model.family().name().to_owned()));
        };
        let hand = model.gripper();
        let ahead = hand.x_eb.pos;
        let gripper_m = ahead.x - hand.ball_radius_m;
        if gripper_m <= 0.0 || ahead.yz().norm() > 1e-9 {
            return Err(NotADiscArm::Gripper);
        }
        let size = Size {
            base_m: plane.c1_m,
            upper_m: plane.upper_m,
            fore_m: plane.fore_m,
            hand_m: plane.hand_m,
            gripper_m,
            disc_radius_m: hand.ball_radius_m,
        };
        let arm = Self { model, size };
        // Three generic poses fix base height, axis offset, senses of rotation and zero positions.
        for q in [[0.0; 4], [0.4, -0.3, -0.5, -0.8], [-1.1, 0.6, -1.3, 0.9]] {
            let ee = arm.model.ee_at(&q.into());
            let off_m = (ee.pos - arm.terminal_point(&Joints::from(q))).norm()
                + (ee.rot - arm.hand_axes(&Joints::from(q))).amax();
            if off_m > 1e-9 {
                return Err(NotADiscArm::Zero { q, off_m });
            }
        }
        Ok(arm)
    }

    fn sums(&self, q: &Joints) -> Sums {
        let a2 = q[1] + std::f64::consts::FRAC_PI_2;
        let (alpha, beta) = (a2 + q[2], a2 + q[2] + q[3]);
        let Size { upper_m, fore_m, hand_m, .. } = self.size;
        let (c3, s3) = (hand_m * beta.cos(), hand_m * beta.sin());
        let (c2, s2) = (fore_m * alpha.cos() + c3, fore_m * alpha.sin() + s3);
        Sums { c: [upper_m * a2.cos() + c2, c2, c3], s: [upper_m * a2.sin() + s2, s2, s3] }
    }

    /// Terminal point in the world, m: the last column of eq. (3) with its two misprints corrected (cosine in y,
    /// sin(θ2 + π/2) in z).
    #[must_use]
    pub fn terminal_point(&self, q: &Joints) -> Vector3<f64> {
        let sums = self.sums(q);
        let (s, c) = q[0].sin_cos();
        Vector3::new(c * sums.c[0], s * sums.c[0], self.size.base_m + sums.s[0])
    }

    /// Axes of the hand in the world: columns x along it, y up for a level hand, z across (eq. (3)).
    #[must_use]
    pub fn hand_axes(&self, q: &Joints) -> Matrix3<f64> {
        let (s1, c1) = q[0].sin_cos();
        let (sb, cb) = hand_elevation_rad(q).sin_cos();
        Matrix3::new(c1 * cb, -c1 * sb, s1, s1 * cb, -s1 * sb, -c1, sb, cb, 0.0)
    }

    /// Jacobian of the terminal point, eq. (5) and (6): joint speeds to `[v; ω]` in the world.
    #[must_use]
    pub fn jacobian(&self, q: &Joints) -> HandJacobian {
        let Sums { c: l, s: m } = self.sums(q);
        let (s, c) = q[0].sin_cos();
        HandJacobian::from_row_slice(&[
            -s * l[0],
            -c * m[0],
            -c * m[1],
            -c * m[2], //
            c * l[0],
            -s * m[0],
            -s * m[1],
            -s * m[2], //
            0.0,
            l[0],
            l[1],
            l[2], //
            0.0,
            s,
            s,
            s, //
            0.0,
            -c,
            -c,
            -c, //
            1.0,
            0.0,
            0.0,
            0.0,
        ])
    }

    /// Jacobian to the rates of position and of fixed-axis roll, pitch, yaw (`R = Rz(yaw) Ry(pitch) Rx(roll)`).
    ///
    /// `None` at pitch ±90°, where roll and yaw are not distinct: the hand points straight up or down.
    #[must_use]
    pub fn rpy_jacobian(&self, q: &Joints) -> Option<HandJacobian> {
        let [_, pitch, yaw] = self.rpy_rad(q);
        let (sp, cp) = pitch.sin_cos();
        let (sy, cy) = yaw.sin_cos();
        if cp.abs() < 1e-9 {
            return None;
        }
        // ω = E (roll rate, pitch rate, yaw rate), E = [Rz Ry x, Rz y, z].
        let rates_to_omega = Matrix3::new(cy * cp, -sy, 0.0, sy * cp, cy, 0.0, -sp, 0.0, 1.0);
        let mut out = self.jacobian(q);
        let omega = out.fixed_view::<3, 4>(3, 0).into_owned();
        out.fixed_view_mut::<3, 4>(3, 0).copy_from(&(rates_to_omega.try_inverse()? * omega));
        Some(out)
    }

    /// Roll, pitch and yaw of the hand, each in [-π, π].
    #[must_use]
    pub fn rpy_rad(&self, q: &Joints) -> [f64; 3] {
        robot_model::Pose::new(self.hand_axes(q), Vector3::zeros()).rpy_rad()
    }

    /// Axis 2, axis 3, axis 4 and the terminal point in the world, for distances and drawings.
    #[must_use]
    pub fn chain(&self, q: &Joints) -> [Vector3<f64>; 4] {
        let Size { base_m, upper_m, fore_m, hand_m, .. } = self.size;
        let (s, c) = q[0].sin_cos();
        let shoulder = Vector3::new(0.0, 0.0, base_m);
        let along =
            |angle: f64, length: f64| Vector3::new(c * angle.cos(), s * angle.cos(), angle.sin()) * length;
        let a2 = q[1] + std::f64::consts::FRAC_PI_2;
        let elbow = shoulder + along(a2, upper_m);
        let wrist = elbow + along(a2 + q[2], fore_m);
        [shoulder, elbow, wrist, wrist + along(a2 + q[2] + q[3], hand_m)]
    }
}

/// Elevation of the hand above the horizontal, β of eq. (3); beyond ±90° it points back over the base.
#[must_use]
pub(crate) fn hand_elevation_rad(q: &Joints) -> f64 {
    q[1] + q[2] + q[3] + std::f64::consts::FRAC_PI_2
}
