//! Torque that the set points need: the arm as rigid bodies, by the recursive Newton-Euler algorithm (Luh, Walker, Paul 1980; Craig,
//! "Introduction to Robotics", section 6.5).

use heapless::Vec;
use protocol::JOINTS_MAX;

use crate::joints::PerJoint;

type Vector = [f32; 3];
/// Rows.
type Matrix = [Vector; 3];

/// What a joint moves, in the frame of the joint, which turns about its z axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Body {
    /// Orientation of the joint frame in the one before at an angle of zero; rows.
    pub rotation: [[f32; 3]; 3],
    /// Its origin there, m.
    pub origin_m: [f32; 3],
    /// Mass of the link, kg.
    pub mass_kg: f32,
    /// Mass times centre of mass, kg·m.
    pub first_moment_kg_m: [f32; 3],
    /// Inertia about the origin, kg·m².
    pub inertia_kg_m2: [[f32; 3]; 3],
    /// Inertia of the rotor behind its gear, kg·m².
    pub rotor_kg_m2: f32,
}

/// The bodies of an arm, base first, whose base stands upright.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArmModel {
    /// One for each joint.
    pub bodies: Vec<Body, JOINTS_MAX>,
    /// Gravity along -z of the base, m/s².
    pub gravity_m_s2: f32,
}

/// State of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Angle, rad.
    pub q_rad: f32,
    /// Speed, rad/s.
    pub qd_rad_s: f32,
    /// Acceleration, rad/s².
    pub qdd_rad_s2: f32,
}

#[derive(Clone, Copy, Default)]
struct OnLink {
    rotation: Matrix,
    force: Vector,
    moment: Vector,
}

impl ArmModel {
    /// Torque of each joint for this motion, N·m: `(M + B) q̈ + C q̇ + g`, without friction.
    pub fn torques_nm(&self, motion: &PerJoint<Motion>) -> PerJoint<f32> {
        let mut links = [OnLink::default(); JOINTS_MAX];
        let (mut w, mut alpha) = ([0.0; 3], [0.0; 3]);
        // An upward acceleration of the base stands for gravity.
        let mut a = [0.0, 0.0, self.gravity_m_s2];
        for ((at, body), link) in motion.0.iter().zip(&self.bodies).zip(&mut links) {
            let Motion { q_rad, qd_rad_s, qdd_rad_s2 } = *at;
            let rotation = turned(&body.rotation, q_rad);
            let at_origin = sum(sum(a, cross(alpha, body.origin_m)), cross(w, cross(w, body.origin_m)));
            (a, alpha) = (into(&rotation, at_origin), into(&rotation, alpha));
            w = into(&rotation, w);
            alpha = sum(alpha, sum(cross(w, [0.0, 0.0, qd_rad_s]), [0.0, 0.0, qdd_rad_s2]));
            w = sum(w, [0.0, 0.0, qd_rad_s]);
            let c = body.first_moment_kg_m;
            let force = sum(scaled(a, body.mass_kg), sum(cross(alpha, c), cross(w, cross(w, c))));
            let spin = cross(w, times(&body.inertia_kg_m2, w));
            let moment = sum(sum(times(&body.inertia_kg_m2, alpha), spin), cross(c, a));
            *link = OnLink { rotation, force, moment };
        }
        let mut torques: PerJoint<f32> = PerJoint::default();
        let (mut force, mut moment) = ([0.0; 3], [0.0; 3]);
        let inwards = torques.0.iter_mut().zip(&motion.0).zip(&self.bodies).zip(&links).rev();
        for (((torque_nm, at), body), link) in inwards {
            (force, moment) = (sum(force, link.force), sum(moment, link.moment));
            let [_, _, about_axis_nm] = moment;
            *torque_nm = about_axis_nm + body.rotor_kg_m2 * at.qdd_rad_s2;
            force = times(&link.rotation, force);
            moment = sum(times(&link.rotation, moment), cross(body.origin_m, force));
        }
        torques
    }
}

/// [`ArmModel::torques_nm`] of a model that may be missing, or of a motion that is not finite: 0.
pub(super) fn torques_ahead_nm(model: Option<&ArmModel>, motion: &PerJoint<Motion>) -> PerJoint<f32> {
    let torques = model.map(|model| model.torques_nm(motion)).unwrap_or_default();
    PerJoint(torques.0.map(|t_nm| if t_nm.is_finite() { t_nm } else { 0.0 }))
}

/// `rotation` times a turn about z.
fn turned(rotation: &Matrix, q_rad: f32) -> Matrix {
    let (s, c) = (libm::sinf(q_rad), libm::cosf(q_rad));
    rotation.map(|[x, y, z]| [x * c + y * s, y * c - x * s, z])
}

fn sum([a, b, c]: Vector, [x, y, z]: Vector) -> Vector {
    [a + x, b + y, c + z]
}

fn scaled(v: Vector, by: f32) -> Vector {
    v.map(|x| x * by)
}

fn cross([a, b, c]: Vector, [x, y, z]: Vector) -> Vector {
    [b * z - c * y, c * x - a * z, a * y - b * x]
}

fn times(matrix: &Matrix, [x, y, z]: Vector) -> Vector {
    matrix.map(|[a, b, c]| a * x + b * y + c * z)
}

/// By the transposed matrix: from the frame before into the one of the joint.
fn into(matrix: &Matrix, [x, y, z]: Vector) -> Vector {
    let [r0, r1, r2] = *matrix;
    sum(scaled(r0, x), sum(scaled(r1, y), scaled(r2, z)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::JointIndex;

    fn joint(index: usize) -> JointIndex {
        JointIndex::new(index).unwrap()
    }

    /// Two rods in a vertical plane, axes along y of the base, point masses at their ends.
    fn two_rods(masses_kg: [f32; 2], lengths_m: [f32; 2]) -> ArmModel {
        // z of the joint is -y of the base, x stays.
        let upright = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]];
        let along = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let body = |rotation, origin_m, m: f32, l: f32| Body {
            rotation,
            origin_m,
            mass_kg: m,
            first_moment_kg_m: [m * l, 0.0, 0.0],
            inertia_kg_m2: [[0.0; 3], [0.0, m * l * l, 0.0], [0.0, 0.0, m * l * l]],
            rotor_kg_m2: 0.0,
        };
        let bodies = [
            body(upright, [0.0; 3], masses_kg[0], lengths_m[0]),
            body(along, [lengths_m[0], 0.0, 0.0], masses_kg[1], lengths_m[1]),
        ];
        ArmModel { bodies: Vec::from_slice(&bodies).unwrap(), gravity_m_s2: 9.81 }
    }

    /// The closed form of two point masses, Craig, section 6.7.
    #[test]
    fn torques_of_two_rods_are_those_of_the_closed_form() {
        let ([m1, m2], [l1, l2], g) = ([1.3_f32, 0.7], [0.4_f32, 0.3], 9.81_f32);
        let arm = two_rods([m1, m2], [l1, l2]);
        for k in 0..50 {
            let x = k as f32;
            let [q1, q2, v1, v2, a1, a2] = [1.1, 1.7, 2.3, 2.9, 3.1, 3.7].map(|f| libm::sinf(x * f) * 2.0);
            let mut motion = PerJoint::default();
            motion.set(joint(0), Motion { q_rad: q1, qd_rad_s: v1, qdd_rad_s2: a1 });
            motion.set(joint(1), Motion { q_rad: q2, qd_rad_s: v2, qdd_rad_s2: a2 });
            let found = arm.torques_nm(&motion);
            let (c1, c12, s2, c2) = (libm::cosf(q1), libm::cosf(q1 + q2), libm::sinf(q2), libm::cosf(q2));
            let second = m2 * l2 * l2 * (a1 + a2)
                + m2 * l1 * l2 * c2 * a1
                + m2 * l1 * l2 * s2 * v1 * v1
                + m2 * l2 * g * c12;
            let first =
                m2 * l2 * l2 * (a1 + a2) + m2 * l1 * l2 * c2 * (2.0 * a1 + a2) + (m1 + m2) * l1 * l1 * a1
                    - m2 * l1 * l2 * s2 * v2 * v2
                    - 2.0 * m2 * l1 * l2 * s2 * v1 * v2
                    + m2 * l2 * g * c12
                    + (m1 + m2) * l1 * g * c1;
            assert!((found.get(joint(0)) - first).abs() < 1e-4, "{k}: {} {first}", found.get(joint(0)));
            assert!((found.get(joint(1)) - second).abs() < 1e-4, "{k}: {} {second}", found.get(joint(1)));
        }
    }
}
