//! The paper's eight parameters, and how they become a throw.

use nalgebra::{Matrix3, Vector3, Vector6};
use robot_model::jacobian::joint_rates;
use robot_model::{JointVec, Pose, RobotModel};

use super::margins::Margins;
use super::posture::postures;
use super::problem::Problem;
use crate::throw::Throw;

/// `h = [θ, φ, r, γ, ω, F, H_s, d_r]` of the paper (section IV).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
pub struct PaperParameters {
    /// Azimuth θ of the ball seen from the shoulder in rad.
    pub azimuth_rad: f64,
    /// Elevation φ of the ball seen from the shoulder in rad.
    pub elevation_rad: f64,
    /// Distance r of the ball from the shoulder in m.
    pub radius_m: f64,
    /// Angle γ of the hand about the throw in rad; at 0 x of the release frame lies in the vertical plane of v0.
    pub roll_rad: f64,
    /// Angular velocity ω of the hand about the throw in rad/s.
    pub spin_rad_s: f64,
    /// Time of flight F in s.
    pub flight_s: f64,
    /// Duration H_s of the movement in s.
    pub duration_s: f64,
    /// Ratio d_r of braking to duration.
    pub braking_ratio: f64,
}

/// A throw from the parameters, with the branch of inverse kinematics that was chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BranchedThrow {
    /// Number of the posture: the branch of the closed form, or the order in which it was found.
    pub posture: usize,
    pub throw: Throw,
    /// Largest violation of a limit (2) to (8) in scaled units; zero if all hold.
    pub violation: f64,
    /// Sum of the motor currents at the release in A.
    pub current_a: f64,
}

impl PaperParameters {
    /// From the paper's order of numbers.
    #[must_use]
    pub fn from_array(h: [f64; 8]) -> Self {
        let [azimuth_rad, elevation_rad, radius_m, roll_rad, spin_rad_s, flight_s, duration_s, braking_ratio] =
            h;
        Self {
            azimuth_rad,
            elevation_rad,
            radius_m,
            roll_rad,
            spin_rad_s,
            flight_s,
            duration_s,
            braking_ratio,
        }
    }

    /// In the paper's order of numbers.
    #[must_use]
    pub fn to_array(&self) -> [f64; 8] {
        [
            self.azimuth_rad,
            self.elevation_rad,
            self.radius_m,
            self.roll_rad,
            self.spin_rad_s,
            self.flight_s,
            self.duration_s,
            self.braking_ratio,
        ]
    }

    /// Release point p0 in the world, in m.
    #[must_use]
    pub(crate) fn release_point(&self, shoulder: &Vector3<f64>) -> Vector3<f64> {
        let (sp, cp) = self.elevation_rad.sin_cos();
        let (st, ct) = self.azimuth_rad.sin_cos();
        shoulder + Vector3::new(cp * ct, cp * st, sp) * self.radius_m
    }

    /// Pose of the end effector and launch velocity; `None` if no launch velocity reaches the target.
    #[must_use]
    pub fn release(&self, problem: &Problem<'_>) -> Option<(Pose, Vector3<f64>)> {
        let p0 = self.release_point(&problem.shoulder);
        let v0 = problem.flight.launch(&p0, &problem.aim.point_at(self.flight_s), self.flight_s).ok()?.v0;
        let x_w_rf = Pose::new(release_rotation(&v0, self.roll_rad), p0);
        Some((x_w_rf * problem.arm.gripper().x_eb.inverse(), v0))
    }

    /// Throws for all postures that reach the release inside the joint ranges; best first.
    ///
    /// Order: least violation of (2) to (8), then least current at the release, then order of branches. The paper
    /// takes the least current; but wrist twins always tie in current and other twins can, while only one may keep the
    /// limits at start and stop, so violation comes first.
    #[must_use]
    pub fn throws(&self, problem: &Problem<'_>) -> Vec<BranchedThrow> {
        let Some((x_we, v0)) = self.release(problem) else { return Vec::new() };
        let mut out: Vec<BranchedThrow> = postures(problem.arm, &x_we)
            .into_iter()
            .filter_map(|(posture, q)| {
                let throw = self.throw_at(problem, &q, &v0)?;
                let margins = Margins::of(problem, &throw);
                let current_a = margins.release_currents_a.map_or(0.0, |i| i.sum());
                Some(BranchedThrow { posture, throw, violation: margins.violation(), current_a })
            })
            .collect();
        // Rounding must not decide between twins.
        let key = |t: &BranchedThrow| ((t.violation * 1e7).round(), (t.current_a * 1e6).round(), t.posture);
        out.sort_by(|a, b| key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal));
        out
    }

    /// The throw through a given posture; `None` where the Jacobian is singular.
    #[must_use]
    pub(crate) fn throw_at(&self, problem: &Problem<'_>, q: &JointVec, v0: &Vector3<f64>) -> Option<Throw> {
        let frames = problem.arm.fk(q);
        let jac = frames.jacobian(&problem.arm.ball(&frames).pos);
        let w = v0.normalize() * self.spin_rad_s;
        let qd = joint_rates(&jac, &Vector6::new(v0.x, v0.y, v0.z, w.x, w.y, w.z))?;
        Some(Throw {
            q_rad: *q,
            qd_rad_s: qd,
            qdd_rad_s2: JointVec::zeros(q.len()),
            flight_s: self.flight_s,
            ha_s: (1.0 - self.braking_ratio) * self.duration_s,
            hb_s: self.braking_ratio * self.duration_s,
        })
    }

    /// The parameters of a throw; for a free spin ω is the part about the throw.
    #[must_use]
    pub fn of(arm: &RobotModel, shoulder: &Vector3<f64>, throw: &Throw) -> Self {
        let frames = arm.fk(&throw.q_rad);
        let ball = arm.ball(&frames);
        let twist = frames.jacobian(&ball.pos) * throw.qd_rad_s;
        let v = Vector3::new(twist[0], twist[1], twist[2]);
        let d = ball.pos - shoulder;
        let z: Vector3<f64> = ball.rot.column(2).into();
        let unrolled = release_rotation(&v, 0.0).tr_mul(&ball.rot);
        Self {
            azimuth_rad: d.y.atan2(d.x),
            elevation_rad: (d.z / d.norm()).asin(),
            radius_m: d.norm(),
            roll_rad: unrolled[(1, 0)].atan2(unrolled[(0, 0)]),
            spin_rad_s: z.dot(&Vector3::new(twist[3], twist[4], twist[5])),
            flight_s: throw.flight_s,
            duration_s: throw.duration_s(),
            braking_ratio: throw.braking_ratio(),
        }
    }
}

/// `R_RF = Rz(az) Ry(polar) Rz(γ)` with azimuth and polar angle of `v`: z along `v`.
#[must_use]
pub(crate) fn release_rotation(v: &Vector3<f64>, roll_rad: f64) -> Matrix3<f64> {
    let flat = v.x.hypot(v.y);
    let (ca, sa) = if flat > 0.0 { (v.x / flat, v.y / flat) } else { (1.0, 0.0) };
    let speed = v.norm();
    let (cp, sp) = (v.z / speed, flat / speed);
    let turned = Matrix3::new(ca * cp, -sa, ca * sp, sa * cp, ca, sa * sp, -sp, 0.0, cp);
    let (s, c) = roll_rad.sin_cos();
    turned * Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}
