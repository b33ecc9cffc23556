//! The arm: rigid bodies of a robot file, or free wheels on a bench, behind [`Plant`].

use nalgebra::Vector3;
use robot_model::linalg::SquareMatrix;
use robot_model::release::HandMotion;
use robot_model::{JointVec, PerJoint, RobotModel};

use super::joint::JointMechanics;
use super::plant::{AxisInput, AxisState, Energy, Plant, PlantFault, Touch};
use super::solver::{Solution, Start, solve};

/// Beyond these a state is a fault; no arm of this kind comes near.
const Q_MAX_RAD: f64 = 1e3;
const V_MAX_RAD_S: f64 = 1e3;
/// Longest step: with a longer one a servo loop of 50 Hz is no longer resolved.
const DT_MAX_S: f64 = 0.01;

/// What the joints move.
#[derive(Clone, Debug)]
pub enum Body {
    Arm(Box<RobotModel>),
    /// One wheel of this inertia (kg·m²) per joint: no coupling, no gravity.
    Wheels(JointVec),
}

impl Body {
    /// Mass matrix, kg·m², and torques at zero acceleration, N·m.
    pub fn dynamics(&self, q: &JointVec, v: &JointVec) -> (SquareMatrix, JointVec) {
        match self {
            Self::Arm(model) => (model.mass_matrix(q), model.bias_torques(q, v)),
            Self::Wheels(inertia) => (SquareMatrix::from_diagonal(inertia), JointVec::zeros(q.len())),
        }
    }
}

/// Joints with drives, and what they move.
#[derive(Clone, Debug)]
pub struct Mechanism {
    body: Body,
    /// The arm with the ball in its hand; `None` for a ball without mass.
    holding: Option<Box<RobotModel>>,
    ball_held: bool,
    joints: Vec<JointMechanics>,
    blocked: PerJoint<bool>,
    // Rotor side, at the joint.
    q: JointVec,
    v: JointVec,
    // Link side; equal to the rotor side if the gear is stiff.
    link_q: JointVec,
    link_v: JointVec,
    link_a: JointVec,
    drive_nm: JointVec,
    link_nm: JointVec,
    output_nm: JointVec,
    saturated: PerJoint<bool>,
    fault: Option<PlantFault>,
}

impl Mechanism {
    /// At rest in `q` (rad), nothing twisted.
    pub fn new(body: Body, joints: Vec<JointMechanics>, q: JointVec) -> Self {
        let holding = match &body {
            Body::Arm(model) => model.holding_ball().map(Box::new),
            Body::Wheels(_) => None,
        };
        let n = q.len();
        Self {
            body,
            holding,
            ball_held: true,
            joints,
            blocked: PerJoint::default_of(n),
            q,
            v: JointVec::zeros(n),
            link_q: q,
            link_v: JointVec::zeros(n),
            link_a: JointVec::zeros(n),
            drive_nm: JointVec::zeros(n),
            link_nm: JointVec::zeros(n),
            output_nm: JointVec::zeros(n),
            saturated: PerJoint::default_of(n),
            fault: None,
        }
    }

    /// Sets position (rad) and velocity (rad/s) of all joints, gears untwisted; clears a fault.
    pub fn set_state(&mut self, q: JointVec, v: JointVec) {
        (self.q, self.v, self.link_q, self.link_v) = (q, v, q, v);
        self.link_a = JointVec::zeros(q.len());
        self.fault = None;
    }

    /// Position and velocity of the links, rad and rad/s.
    pub fn link_state(&self) -> (JointVec, JointVec) {
        (self.link_q, self.link_v)
    }

    /// Accelerations of the links over the last step, rad/s².
    pub fn link_acceleration(&self) -> JointVec {
        self.link_a
    }

    /// What the joints move.
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// Torque behind the gear of joint `i`, N·m: the links' torque, and of the rest (friction, brake, stop,
    /// obstacle) the part above the gear's own Coulomb friction.
    fn output_torque(&self, i: usize, solution: &Solution, h: f64) -> f64 {
        let (joint, a) = (&self.joints[i], solution.rotor_a[i]);
        let v_mid = self.v[i] + 0.5 * h * a;
        let rest =
            solution.drive_nm[i] - joint.rotor_kg_m2 * a - joint.viscous_nms_rad * v_mid - self.link_nm[i];
        self.link_nm[i] + rest - rest.clamp(-joint.coulomb_nm, joint.coulomb_nm)
    }

    /// The axis whose new state is not a number or out of range.
    fn bad_axis(&self, q: &JointVec, v: &JointVec) -> Option<PlantFault> {
        (0..q.len()).find_map(|axis| {
            let good = q[axis].abs() <= Q_MAX_RAD && v[axis].abs() <= V_MAX_RAD_S;
            // A comparison with NaN is false, so NaN is bad.
            (!good).then(|| PlantFault { axis, q_rad: q[axis], v_rad_s: v[axis] })
        })
    }
}

impl Plant for Mechanism {
    fn axes(&self) -> usize {
        self.joints.len()
    }

    fn step(&mut self, dt_s: f64, inputs: &[AxisInput]) {
        if self.fault.is_some() || inputs.len() != self.axes() {
            return;
        }
        let h = dt_s.clamp(0.0, DT_MAX_S);
        // The middle of the step as the last step's acceleration predicts it: second order for free motion.
        let q_mid = self.link_q + self.link_v * (0.5 * h) + self.link_a * (0.125 * h * h);
        let v_mid = self.link_v + self.link_a * (0.5 * h);
        let (mass, bias) = match self.holding.as_deref().filter(|_| self.ball_held) {
            Some(model) => (model.mass_matrix(&q_mid), model.bias_torques(&q_mid, &v_mid)),
            None => self.body.dynamics(&q_mid, &v_mid),
        };
        let start = Start {
            dt_s: h,
            q: &self.q,
            v: &self.v,
            link_q: &self.link_q,
            link_v: &self.link_v,
            mass: &mass,
            bias: &bias,
        };
        let solution = solve(&self.joints, &self.blocked, inputs, &start);
        let advance = |q: &JointVec, v: &JointVec, a: &JointVec| {
            let v_end = v + a * h;
            (q + (v + v_end) * (0.5 * h), v_end)
        };
        let (q, v) = advance(&self.q, &self.v, &solution.rotor_a);
        let (link_q, link_v) = advance(&self.link_q, &self.link_v, &solution.link_a);
        if let Some(fault) = self.bad_axis(&q, &v).or_else(|| self.bad_axis(&link_q, &link_v)) {
            self.fault = Some(fault);
            let zero = JointVec::zeros(self.axes());
            (self.v, self.link_v, self.link_a) = (zero, zero, zero);
            (self.drive_nm, self.link_nm, self.output_nm) = (zero, zero, zero);
            return;
        }
        self.link_nm = mass * solution.link_a + bias;
        self.output_nm = JointVec::from_fn(self.axes(), |i| self.output_torque(i, &solution, h));
        (self.q, self.v, self.link_q, self.link_v) = (q, v, link_q, link_v);
        self.link_a = solution.link_a;
        self.drive_nm = solution.drive_nm;
        self.saturated = solution.saturated;
    }

    fn axis(&self, index: usize) -> AxisState {
        AxisState {
            q_rad: self.q[index],
            v_rad_s: self.v[index],
            drive_torque_nm: self.drive_nm[index],
            link_torque_nm: self.link_nm[index],
            output_torque_nm: self.output_nm[index],
            saturated: self.saturated[index],
        }
    }

    fn link_q_rad(&self, index: usize) -> f64 {
        self.link_q[index]
    }

    fn set_blocked(&mut self, index: usize, blocked: bool) {
        self.blocked[index] = blocked;
    }

    fn set_ball_held(&mut self, held: bool) {
        self.ball_held = held;
    }

    fn hand_motion(&self, ahead_s: f64) -> Option<HandMotion> {
        let Body::Arm(model) = &self.body else { return None };
        let q = self.link_q + self.link_v * ahead_s + self.link_a * (0.5 * ahead_s * ahead_s);
        Some(model.hand_motion(&q, &(self.link_v + self.link_a * ahead_s)))
    }

    fn touch(&self, center_m: &Vector3<f64>, radius_m: f64) -> Option<Touch> {
        let Body::Arm(model) = &self.body else { return None };
        let frames = model.fk(&self.link_q);
        let mut deepest: Option<Touch> = None;
        for part in model.collision().boxes() {
            let x_wb = match part.link.checked_sub(1) {
                None => part.x_lb,
                Some(link) => frames.x_w[link] * part.x_lb,
            };
            let local = x_wb.rot.tr_mul(&(center_m - x_wb.pos));
            let outside = local.abs() - part.half_m;
            // Signed distance of a point to a box: outside to the nearest point, inside to the nearest face.
            let distance = outside.sup(&Vector3::zeros()).norm() + outside.max().min(0.0);
            let depth_m = radius_m - distance;
            if depth_m > deepest.as_ref().map_or(0.0, |touch| touch.depth_m) {
                deepest = Some(Touch { part: part.name.clone(), depth_m });
            }
        }
        deepest
    }

    fn energy(&self) -> Energy {
        let rotors: f64 =
            (0..self.axes()).map(|i| 0.5 * self.joints[i].rotor_kg_m2 * self.v[i] * self.v[i]).sum();
        let gears: f64 = (0..self.axes())
            .map(|i| {
                let twist = self.q[i] - self.link_q[i];
                self.joints[i].elasticity.map_or(0.0, |gear| 0.5 * gear.stiffness_nm_rad * twist * twist)
            })
            .sum();
        let (links, height) = match &self.body {
            Body::Arm(model) => {
                let model = self.holding.as_ref().filter(|_| self.ball_held).unwrap_or(model);
                (model.kinetic_energy_j(&self.link_q, &self.link_v), model.potential_energy_j(&self.link_q))
            }
            Body::Wheels(inertia) => (0.5 * inertia.dot(&self.link_v.component_mul(&self.link_v)), 0.0),
        };
        Energy { kinetic_j: rotors + links, potential_j: height + gears }
    }

    fn fault(&self) -> Option<PlantFault> {
        self.fault
    }
}
