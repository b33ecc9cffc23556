//! The hand-checked vectors of the PowerCube arm: poses, torques and currents at two states, and the published
//! optimum of the throwing paper.

use std::sync::LazyLock;

use nalgebra::{Matrix3, Vector3};
use robot_model::{JointVec, RobotModel};

struct State {
    q: JointVec,
    qd: JointVec,
    qdd: JointVec,
}

fn deg(q: [f64; 6]) -> JointVec {
    JointVec::from(q.map(f64::to_radians))
}

fn state_a() -> State {
    State {
        q: deg([30.0, -40.0, -110.0, 50.0, 70.0, -20.0]),
        qd: [1.0, -1.5, 0.5, -0.2, 2.0, 3.0].into(),
        qdd: [5.0, -8.0, 6.0, 2.0, -10.0, 12.0].into(),
    }
}

fn state_b() -> State {
    State {
        q: deg([-100.0, -150.0, -60.0, -120.0, -40.0, 135.0]),
        qd: [-2.0, 1.0, 2.0, 1.0, -3.0, 4.0].into(),
        qdd: [-10.0, 9.0, -7.0, 3.0, 15.0, -20.0].into(),
    }
}

static ARM: LazyLock<RobotModel> =
    LazyLock::new(|| RobotModel::load("powercube6").expect("the built-in robot loads"));

fn arm() -> &'static RobotModel {
    &ARM
}

/// The vectors are printed with six decimals.
#[track_caller]
fn close<const N: usize>(got: &[f64], want: [f64; N]) {
    let off = got.iter().zip(want).map(|(got, want)| (got - want).abs()).fold(0.0, f64::max);
    assert_eq!(got.len(), N);
    assert!(off < 6e-7, "off by {off:e}: got {got:?}, want {want:?}");
}

#[test]
fn upright_pose_puts_the_hand_above_the_base() {
    let arm = arm();
    let ee = arm.ee(&arm.fk(&deg([0.0, -90.0, -90.0, 0.0, 0.0, 0.0])));
    assert!((ee.pos - Vector3::new(0.0, 0.0, 1.277)).amax() < 1e-15);
}

#[test]
fn poses_of_state_a_and_b() {
    let arm = arm();
    let a = arm.fk(&state_a().q);
    close(arm.ee(&a).pos.as_slice(), [0.620408, 0.538565, 0.529634]);
    let rot = Matrix3::new(
        -0.592984, -0.799311, 0.097322, //
        -0.311926, 0.339456, 0.887396, //
        -0.742343, 0.495854, -0.450618,
    );
    assert!((arm.ee(&a).rot - rot).amax() < 6e-7);
    close(arm.ball(&a).pos.as_slice(), [0.625274, 0.582934, 0.507103]);
    close(arm.ee(&arm.fk(&state_b().q)).pos.as_slice(), [0.278263, 0.882466, 0.484742]);
}

#[test]
fn torques_of_state_a_and_b() {
    let arm = arm();
    let s = state_a();
    let tau = [4.649112, -53.373074, 23.994172, 1.013119, -0.343705, -0.000107];
    close(&arm.inverse_dynamics(&s.q, &s.qd, &s.qdd), tau);
    close(&arm.gravity_torques(&s.q), [0.0, -30.481361, 12.870202, 0.444600, -0.347027, 0.0]);
    let s = state_b();
    let tau = [-15.510797, 60.18697, -26.347064, -0.644758, -1.086441, -0.004812];
    close(&arm.inverse_dynamics(&s.q, &s.qd, &s.qdd), tau);
    close(&arm.gravity_torques(&s.q), [0.0, 33.740078, -13.830383, -0.365883, -0.251749, 0.0]);
}

#[test]
fn gravity_is_inverse_dynamics_at_rest() {
    let arm = arm();
    for s in [state_a(), state_b()] {
        let at_rest = arm.inverse_dynamics(&s.q, &JointVec::zeros(6), &JointVec::zeros(6));
        assert!((arm.gravity_torques(&s.q) - at_rest).amax() < 1e-13);
    }
}

#[test]
fn currents_of_state_a_load_both_supplies() {
    let arm = arm();
    let s = state_a();
    let tau = arm.inverse_dynamics(&s.q, &s.qd, &s.qdd);
    let motor_a = arm.motor_currents(&s.qd, &tau).expect("this robot has drives");
    let want = [3.571309, 11.941039, 4.860573, 0.204384, 0.978668, 0.471603];
    close(&motor_a, want);
    let supply: Vec<f64> = arm.supply_currents(&motor_a).collect();
    assert_eq!(supply.len(), 2);
    assert!((supply[0] - want[..3].iter().sum::<f64>()).abs() < 2e-6);
    assert!((supply[1] - want[3..].iter().sum::<f64>()).abs() < 2e-6);
}

#[test]
fn link_inertias_follow_from_the_boxes() {
    let want = [
        (3.80, [0.0, 0.0, -0.010526], [0.011096, 0.009849, 0.007453]),
        (3.75, [0.276933, 0.0, 0.0], [0.007123, 0.013894, 0.012648]),
        (1.95, [0.0, 0.107308, 0.0], [0.003482, 0.001963, 0.003482]),
        (1.45, [0.0, 0.0, -0.086724], [0.007278, 0.007278, 0.001130]),
        (0.60, [0.0, 0.0, 0.0], [0.000490, 0.000490, 0.000490]),
        (0.50, [0.0, 0.0, -0.083], [0.001080, 0.001113, 0.000288]),
    ];
    let arm = arm();
    for (link, (mass, com, moments)) in arm.links().iter().zip(want) {
        let inertia = &link.inertia;
        assert!((inertia.mass_kg() - mass).abs() < 1e-12, "{}", link.name);
        close(inertia.com_m().as_slice(), com);
        let tensor = Matrix3::from_diagonal(&Vector3::from(moments));
        assert!((inertia.about_com_kg_m2() - tensor).amax() < 6e-7, "{}", link.name);
    }
}

/// The published optimum for the target (1, 1, -1) m, worked out by hand from its eight parameters.
mod published_optimum {
    use nalgebra::{Matrix3, Vector3, Vector6};
    use robot_model::collision::{CollisionChecker, Scene};
    use robot_model::jacobian::joint_rates;
    use robot_model::{IkSolution, JointVec, Pose};

    use super::{arm, close};

    const H: [f64; 8] = [0.493, -0.465, 0.858, 0.583, -1.098, 0.586, 0.920, 0.391];

    /// Release frame and velocity: equations of robot model notes 1.2.
    fn release() -> (Pose, Vector3<f64>) {
        let [theta, phi, r, gamma, _, flight_s, _, _] = H;
        let p0 = Vector3::new(0.0, 0.0, 0.27)
            + Vector3::new(phi.cos() * theta.cos(), phi.cos() * theta.sin(), phi.sin()) * r;
        let v0 =
            (Vector3::new(1.0, 1.0, -1.0) - p0) / flight_s + Vector3::new(0.0, 0.0, 9.81) * (flight_s / 2.0);
        let azimuth = v0.y.atan2(v0.x);
        let polar = v0.x.hypot(v0.y).atan2(v0.z);
        let rot: Matrix3<f64> = (Pose::rot_z(azimuth) * Pose::rot_y(polar) * Pose::rot_z(gamma)).rot;
        (Pose::new(rot, p0), v0)
    }

    fn solution() -> (IkSolution, JointVec) {
        let arm = arm();
        let (x_wb, v0) = release();
        let x_we = x_wb * arm.gripper().x_eb.inverse();
        let solutions = arm.ik(&x_we).expect("closed form");
        assert_eq!(solutions.len_in_range(), 8);
        let q = [0.199999, 0.125428, -1.856562, 1.004064, 1.387908, 1.654417];
        let near = |s: &IkSolution| (s.q - JointVec::from(q)).amax() < 6e-7;
        let found = solutions.in_range().find(near).expect("the published solution is among the branches");
        let spin = x_wb.rot.column(2) * H[4];
        let twist = Vector6::new(v0.x, v0.y, v0.z, spin.x, spin.y, spin.z);
        let jacobian = arm.fk(&found.q).jacobian(&x_wb.pos);
        (found, joint_rates(&jacobian, &twist).expect("regular"))
    }

    #[test]
    fn release_point_and_velocity() {
        let (x_wb, v0) = release();
        close(x_wb.pos.as_slice(), [0.675574, 0.362951, -0.114747]);
        close(v0.as_slice(), [0.553627, 1.087115, 1.363659]);
    }

    #[test]
    fn joint_speeds_at_release() {
        let (_, qd) = solution();
        close(&qd, [1.358402, -1.675786, 0.482325, -0.010697, -0.986023, 2.548397]);
        let arm = arm();
        let use_of_speed = qd.component_div(&arm.limit(|l| l.v_max_rad_s)).amax();
        assert!((0.64..0.65).contains(&use_of_speed), "{use_of_speed}");
    }

    #[test]
    fn currents_at_release() {
        let (found, qd) = solution();
        let arm = arm();
        let tau = arm.inverse_dynamics(&found.q, &qd, &JointVec::zeros(6));
        let motor_a = arm.motor_currents(&qd, &tau).expect("this robot has drives");
        let want = JointVec::from([4.392, 9.780, 3.008, 0.041, 0.487, 0.401]);
        assert!((motor_a - want).amax() < 6e-4, "{motor_a}");
    }

    #[test]
    fn clearance_over_the_whole_motion() {
        let (found, qd) = solution();
        let (ha, hb) = ((1.0 - H[7]) * H[6], H[7] * H[6]);
        // Two-segment cubic about the release: q̇ = q̇_r (1 - s²/h²), s from -ha to hb.
        let at = |s: f64| {
            let h = if s < 0.0 { ha } else { hb };
            found.q + qd * (s - s * s * s / (3.0 * h * h))
        };
        let arm = arm();
        let scene = Scene::default();
        let mut checker = CollisionChecker::new(arm, &scene);
        let mut smallest = |t0: f64, t1: f64| {
            (0..=1000)
                .map(|k| checker.clearance(&arm.fk(&at(t0 + (t1 - t0) * f64::from(k) / 1000.0))).distance_m)
                .fold(f64::INFINITY, f64::min)
        };
        let over_motion = smallest(-ha, hb);
        assert!((over_motion - 0.0231).abs() < 6e-5, "{over_motion}");
    }
}
