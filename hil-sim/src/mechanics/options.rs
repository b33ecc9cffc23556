//! From a robot file to a mechanism: values that the file does not have.

use nalgebra::{Matrix3, Vector3};
use robot_model::{JointVec, LinkInertia, RobotModel};

use super::arm::{Body, Mechanism};
use super::joint::{Elasticity, JointMechanics};
use super::perturb::JointDeviation;

/// Properties of joints that are not in a robot file; the table at the top of `mechanics` has the reasons for the defaults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MechanicsOptions {
    /// Share of the largest torque that accelerates the rotor alone at the control acceleration limit.
    pub rotor_share: f64,
    /// Viscous friction as share of the largest torque at the largest velocity.
    pub viscous_share: f64,
    /// Coulomb friction as deceleration, rad/s²; `None` takes the robot file's, or 5.
    pub coulomb_rad_s2: Option<f64>,
    /// Torque of the brake over the largest torque of the drive.
    pub brake_share: f64,
    /// End stops beyond the joint's range, rad.
    pub stop_margin_rad: f64,
    /// Stiffness of the end stops, N·m/rad.
    pub stop_stiffness_nm_rad: f64,
    /// Elasticity of the gears, the same for all joints; `None` for stiff ones.
    pub elasticity: Option<Elasticity>,
}

impl Default for MechanicsOptions {
    fn default() -> Self {
        Self {
            rotor_share: 0.2,
            viscous_share: 0.02,
            coulomb_rad_s2: None,
            brake_share: 1.5,
            stop_margin_rad: 5_f64.to_radians(),
            stop_stiffness_nm_rad: 20e3,
            elasticity: None,
        }
    }
}

/// Torque limit if a robot file gives none, N·m: enough for the inertia of a joint, with a margin.
const TORQUE_UNKNOWN_NM: f64 = 100.0;

impl MechanicsOptions {
    /// Inertia that each drive's loop is tuned for, kg·m².
    pub fn servo_inertia_kg_m2(&self, model: &RobotModel) -> JointVec {
        let middle = (model.q_min() + model.q_max()) * 0.5;
        let mass = model.mass_matrix(&middle);
        JointVec::from_fn(model.n(), |i| mass[(i, i)] + self.rotor_kg_m2(model, i))
    }

    fn torque_max_nm(model: &RobotModel, i: usize) -> f64 {
        model.joints()[i].limits.torque_max_nm.unwrap_or(TORQUE_UNKNOWN_NM)
    }

    fn rotor_kg_m2(&self, model: &RobotModel, i: usize) -> f64 {
        model.rotor_kg_m2(i).unwrap_or_else(|| {
            self.rotor_share * Self::torque_max_nm(model, i) / model.joints()[i].limits.a_control_max_rad_s2
        })
    }

    /// The arm at rest in `q_rad`, with deviations of each joint from its model.
    pub fn build(&self, model: &RobotModel, q_rad: JointVec, deviations: &[JointDeviation]) -> Mechanism {
        // The modules were tuned on the nominal arm; friction belongs to the module.
        let tuned = self.servo_inertia_kg_m2(model);
        let coulomb_rad_s2 =
            self.coulomb_rad_s2.or(model.drive_loop().map(|l| l.coulomb_friction_rad_s2)).unwrap_or(5.0);
        let joint = |i: usize| {
            let (limits, deviation) = (&model.joints()[i].limits, &deviations[i]);
            let torque = Self::torque_max_nm(model, i);
            let stiffness = self.stop_stiffness_nm_rad;
            JointMechanics {
                rotor_kg_m2: self.rotor_kg_m2(model, i) * deviation.rotor,
                coulomb_nm: coulomb_rad_s2 * tuned[i] * deviation.friction,
                viscous_nms_rad: self.viscous_share * torque / limits.v_max_rad_s * deviation.friction,
                brake_nm: self.brake_share * torque,
                stop_min_rad: limits.q_min_rad - self.stop_margin_rad,
                stop_max_rad: limits.q_max_rad + self.stop_margin_rad,
                stop_stiffness_nm_rad: stiffness,
                // Critical damping of the tuned inertia: a stop that does not throw the arm back.
                stop_damping_nms_rad: 2.0 * (stiffness * tuned[i]).sqrt(),
                elasticity: self.elasticity,
            }
        };
        let joints = (0..model.n()).map(joint).collect();
        let model = model.clone().with_inertias(|i, link| deviated(link, &deviations[i]));
        Mechanism::new(Body::Arm(Box::new(model)), joints, q_rad)
    }
}

/// A link with its mass scaled and its centre of mass shifted; the nominal one if the result is not a possible body.
fn deviated(link: &LinkInertia, deviation: &JointDeviation) -> LinkInertia {
    let tensor: Matrix3<f64> = link.about_com_kg_m2() * deviation.mass;
    LinkInertia::new(link.mass_kg() * deviation.mass, link.com_m() + Vector3::from(deviation.com_m), tensor)
        .unwrap_or(*link)
}
