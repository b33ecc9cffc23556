//! One implicit step of all joints together.
//!
//! ```text
//! unknown   a      accelerations over the step, rad/s²          (rotor side α, link side a, with elastic gears)
//! q, v              at the start of the step; h = dt
//! q½ = q + h/2 v + h²/4 a,   v½ = v + h/2 a,   v⁺ = v + h a,   q⁺ = q + h v½
//!
//! M a + c = τ_servo(q½, v½) - b v½ - f(v⁺) - s(q⁺, v⁺) - B a           rigid gear
//! B α    = τ_servo(θ½, θ̇½) - b θ̇½ - f(θ̇⁺) - s(θ⁺, θ̇⁺) - n               elastic gear, rotor side
//! M a + c = n,  n = k (θ½ - q½) + d (θ̇½ - v½)                            elastic gear, link side
//!
//! M, c   mass matrix kg·m² and Coriolis, centrifugal and gravity torques N·m at the predicted middle of the step
//! B      rotor inertia seen through the gear, kg·m²;   b viscous friction, N·m·s/rad;   k, d gear, N·m/rad and N·m·s/rad
//! f      Coulomb friction and brake: |f| <= F, f = F sign(v⁺), or F v⁺/ε while |v⁺| <= ε = 1e-6 rad/s
//! s      end stops: spring and damper beyond the stop, never pulling
//! τ      clamp(τ0 + k_s (r - q½) - d_s v½, ± τ_max)
//! ```
//!
//! * The servo is in the implicit midpoint rule: second order, stable at any stiffness; its 5 ms lag is right already
//!   with steps of 1 ms. Friction and stops are in backward Euler: they must not ring. `v½ f(v⁺) >= 0` in sliding
//!   and in coming to rest, so friction never adds energy.
//! * The friction branch and the side of the clamp are found by trying: solve, check, correct, at most
//!   [`PASSES`] times. The matrix stays positive definite in all of them.

use robot_model::linalg::{Cholesky, SquareMatrix};
use robot_model::{JointVec, PerJoint};

use super::joint::JointMechanics;
use super::plant::AxisInput;

/// Most attempts to find the branches; usually one, two when a joint starts, stops or saturates.
const PASSES: usize = 5;
/// Speed below which a joint sticks, rad/s.
const STICK_RAD_S: f64 = 1e-6;
/// Friction that holds a blocked joint, N·m.
const BLOCK_NM: f64 = 1e6;

/// Rotor side of all joints at the start of a step.
pub(super) struct Start<'a> {
    pub(super) dt_s: f64,
    pub(super) q: &'a JointVec,
    pub(super) v: &'a JointVec,
    /// Link side; equal to `q`, `v` at joints with stiff gears.
    pub(super) link_q: &'a JointVec,
    pub(super) link_v: &'a JointVec,
    pub(super) mass: &'a SquareMatrix,
    /// c, N·m.
    pub(super) bias: &'a JointVec,
}

/// Accelerations and torques over the step.
pub(super) struct Solution {
    /// Rotor side, rad/s².
    pub(super) rotor_a: JointVec,
    /// Link side, rad/s².
    pub(super) link_a: JointVec,
    pub(super) drive_nm: JointVec,
    pub(super) saturated: PerJoint<bool>,
}

#[derive(Clone, Copy, Default, PartialEq)]
enum Friction {
    #[default]
    Stick,
    Slide(f64),
}

#[derive(Clone, Copy, Default, PartialEq)]
enum Torque {
    #[default]
    Loop,
    Clamped(f64),
}

/// Coefficients of one joint's rotor equation `(B + kappa) α = rhs - n`.
#[derive(Clone, Copy, Default)]
struct Row {
    kappa: f64,
    rhs: f64,
}

pub(super) fn solve(
    joints: &[JointMechanics],
    blocked: &[bool],
    inputs: &[AxisInput],
    start: &Start<'_>,
) -> Solution {
    let (n, h) = (joints.len(), start.dt_s);
    let mut friction = PerJoint::from_fn(n, |i| branch_of(start.v[i]));
    let mut torque = PerJoint::<Torque>::default_of(n);
    let fixed = PerJoint::from_fn(n, |i| fixed_row(&joints[i], start.q[i], start.v[i], h));
    let limit = JointVec::from_fn(n, |i| friction_limit(&joints[i], blocked[i], inputs[i].brake));
    let mut last = None;
    for _ in 0..PASSES {
        let rows = PerJoint::from_fn(n, |i| {
            let mut row = fixed[i];
            add_torque(&mut row, &inputs[i], torque[i], start.q[i], start.v[i], h);
            add_friction(&mut row, friction[i], limit[i], start.v[i], h);
            row
        });
        let (rotor_a, link_a) = accelerations(joints, &rows, start);
        let mut agreed = true;
        let mut drive_nm = JointVec::zeros(n);
        for i in 0..n {
            let v_end = start.v[i] + h * rotor_a[i];
            let next = corrected_friction(friction[i], v_end);
            let (applied, side) = applied_torque(&inputs[i], start.q[i], start.v[i], rotor_a[i], h);
            drive_nm[i] = applied;
            agreed &= next == friction[i] && side == torque[i];
            (friction[i], torque[i]) = (next, side);
        }
        last = Some((rotor_a, link_a, drive_nm));
        if agreed {
            break;
        }
    }
    let zero = JointVec::zeros(n);
    let (rotor_a, link_a, drive_nm) = last.unwrap_or((zero, zero, zero));
    // A stage that is off orders no torque and is not at its limit.
    let saturated = PerJoint::from_fn(n, |i| torque[i] != Torque::Loop && inputs[i].torque_max_nm > 0.0);
    Solution { rotor_a, link_a, drive_nm, saturated }
}

fn branch_of(v: f64) -> Friction {
    if v.abs() <= STICK_RAD_S { Friction::Stick } else { Friction::Slide(1.0_f64.copysign(v)) }
}

/// The branch that fits the velocity at the end of the step; a joint that slid through zero sticks first.
fn corrected_friction(tried: Friction, v_end: f64) -> Friction {
    match tried {
        Friction::Stick => branch_of(v_end),
        Friction::Slide(s) if s * v_end >= 0.0 => tried,
        Friction::Slide(_) => Friction::Stick,
    }
}

fn friction_limit(joint: &JointMechanics, blocked: bool, brake: bool) -> f64 {
    let brake = if brake { joint.brake_nm } else { 0.0 };
    joint.coulomb_nm + brake + if blocked { BLOCK_NM } else { 0.0 }
}

/// Viscous friction and end stops.
fn fixed_row(joint: &JointMechanics, q: f64, v: f64, h: f64) -> Row {
    let mut row = Row { kappa: 0.5 * h * joint.viscous_nms_rad, rhs: -joint.viscous_nms_rad * v };
    let ahead = q + h * v;
    let beyond = if ahead < joint.stop_min_rad {
        Some(joint.stop_min_rad)
    } else if ahead > joint.stop_max_rad {
        Some(joint.stop_max_rad)
    } else {
        None
    };
    if let Some(stop) = beyond {
        let (k, d) = (joint.stop_stiffness_nm_rad, joint.stop_damping_nms_rad);
        let push = k * (stop - ahead) - d * v;
        // The damper may not hold the joint back on its way out.
        if push * (stop - ahead) > 0.0 {
            row.kappa += 0.5 * h * h * k + h * d;
            row.rhs += push;
        }
    }
    row
}

fn add_torque(row: &mut Row, input: &AxisInput, torque: Torque, q: f64, v: f64, h: f64) {
    match torque {
        Torque::Loop => {
            let (k, d) = (input.stiffness_nm_rad, input.damping_nms_rad);
            row.kappa += 0.25 * h * h * k + 0.5 * h * d;
            row.rhs += input.torque_nm + k * (input.reference_rad - q - 0.5 * h * v) - d * v;
        }
        Torque::Clamped(at) => row.rhs += at,
    }
}

fn add_friction(row: &mut Row, friction: Friction, limit_nm: f64, v: f64, h: f64) {
    match friction {
        Friction::Stick => {
            let c = limit_nm / STICK_RAD_S;
            row.kappa += h * c;
            row.rhs -= c * v;
        }
        Friction::Slide(s) => row.rhs -= s * limit_nm,
    }
}

/// Torque of the drive for acceleration `a`, and which side of the clamp it is on.
fn applied_torque(input: &AxisInput, q: f64, v: f64, a: f64, h: f64) -> (f64, Torque) {
    let q_mid = q + 0.5 * h * v + 0.25 * h * h * a;
    let v_mid = v + 0.5 * h * a;
    let wanted = input.torque_nm + input.stiffness_nm_rad * (input.reference_rad - q_mid)
        - input.damping_nms_rad * v_mid;
    let max = input.limit_nm(wanted, v);
    if wanted > max {
        (max, Torque::Clamped(max))
    } else if wanted < -max {
        (-max, Torque::Clamped(-max))
    } else {
        (wanted, Torque::Loop)
    }
}

fn accelerations(joints: &[JointMechanics], rows: &[Row], start: &Start<'_>) -> (JointVec, JointVec) {
    let (n, h) = (joints.len(), start.dt_s);
    let mut a_matrix = *start.mass;
    let mut rhs = -*start.bias;
    // Rotor sides are eliminated: (D + κ) α = r - n0 + κ a with the spring's part n = n0 + κ (α - a).
    let mut back = PerJoint::<(f64, f64)>::default_of(n);
    for i in 0..n {
        let d = joints[i].rotor_kg_m2 + rows[i].kappa;
        match joints[i].elasticity {
            None => {
                a_matrix[(i, i)] += d;
                rhs[i] += rows[i].rhs;
            }
            Some(gear) => {
                let kappa = 0.25 * h * h * gear.stiffness_nm_rad + 0.5 * h * gear.damping_nms_rad;
                let twist_v = start.v[i] - start.link_v[i];
                let twist = start.q[i] - start.link_q[i] + 0.5 * h * twist_v;
                let n0 = gear.stiffness_nm_rad * twist + gear.damping_nms_rad * twist_v;
                let share = kappa / (d + kappa);
                let rotor_rhs = rows[i].rhs - n0;
                a_matrix[(i, i)] += kappa - share * kappa;
                rhs[i] += n0 + share * rotor_rhs;
                back[i] = (rotor_rhs / (d + kappa), share);
            }
        }
    }
    // Positive definite for finite states; the caller's check catches the rest.
    let link_a = match Cholesky::new(&a_matrix) {
        Some(factor) => factor.solve(&rhs),
        None => JointVec::repeat(n, f64::NAN),
    };
    let rotor_a = JointVec::from_fn(n, |i| match joints[i].elasticity {
        None => link_a[i],
        Some(_) => back[i].0 + back[i].1 * link_a[i],
    });
    (rotor_a, link_a)
}
