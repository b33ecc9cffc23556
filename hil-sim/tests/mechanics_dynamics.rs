//! The arm against closed forms, published torque vectors and balances.

use hil_sim::mechanics::perturb::Scatter;
use hil_sim::mechanics::{AxisInput, Body, Elasticity, JointMechanics, MechanicsOptions, Mechanism, Plant};
use nalgebra::Vector3;
use robot_model::{JointVec, RobotModel};

fn model() -> RobotModel {
    RobotModel::from_toml("powercube6", robot_model::built_in_text("powercube6").unwrap()).unwrap()
}

fn deg(v: [f64; 6]) -> JointVec {
    JointVec::from(v).map(f64::to_radians)
}

/// Torque vectors A and B of the machine's reference: state, acceleration, torque.
fn vectors() -> [(JointVec, JointVec, JointVec, JointVec); 2] {
    [
        (
            deg([30.0, -40.0, -110.0, 50.0, 70.0, -20.0]),
            JointVec::from([1.0, -1.5, 0.5, -0.2, 2.0, 3.0]),
            JointVec::from([5.0, -8.0, 6.0, 2.0, -10.0, 12.0]),
            JointVec::from([4.649112, -53.373074, 23.994172, 1.013119, -0.343705, -0.000107]),
        ),
        (
            deg([-100.0, -150.0, -60.0, -120.0, -40.0, 135.0]),
            JointVec::from([-2.0, 1.0, 2.0, 1.0, -3.0, 4.0]),
            JointVec::from([-10.0, 9.0, -7.0, 3.0, 15.0, -20.0]),
            JointVec::from([-15.510797, 60.18697, -26.347064, -0.644758, -1.086441, -0.004812]),
        ),
    ]
}

/// Arm without rotors and friction.
fn bare(model: &RobotModel, q: JointVec, v: JointVec) -> Mechanism {
    let mut arm = Mechanism::new(Body::Arm(Box::new(model.clone())), vec![JointMechanics::ideal(0.0); 6], q);
    arm.set_state(q, v);
    arm
}

fn torques(tau: &JointVec) -> Vec<AxisInput> {
    tau.iter().map(|t| AxisInput { torque_nm: *t, torque_max_nm: 1e6, ..AxisInput::default() }).collect()
}

#[test]
fn published_torques_give_the_published_accelerations() {
    let model = model();
    for (q, v, a, tau) in vectors() {
        let mut arm = bare(&model, q, v);
        arm.step(1e-7, &torques(&tau));
        let found = arm.link_acceleration();
        // Torques are given to 1e-6 N·m; the hand's inertia about its axis is 2.9e-4 kg·m².
        for i in 0..6 {
            assert!((found[i] - a[i]).abs() < 5e-3, "joint {}: {} against {}", i + 1, found[i], a[i]);
        }
        for i in 0..6 {
            assert!((arm.axis(i).link_torque_nm - tau[i]).abs() < 2e-5, "what arrives at the links");
        }
    }
}

/// Motor currents of vector A by eq. (9), measured by the drives of a cell would be K_B |q̇| + K_M |τ|.
#[test]
fn currents_of_the_published_state_are_those_of_equation_nine() {
    let model = model();
    let (q, v, _, tau) = vectors()[0];
    let mut arm = bare(&model, q, v);
    arm.step(1e-7, &torques(&tau));
    let expected = [3.571309, 11.941039, 4.860573, 0.204384, 0.978668, 0.471603];
    let drives = model.drives().unwrap();
    for i in 0..6 {
        let axis = arm.axis(i);
        let current =
            drives[i].k_b_a_s_rad * axis.v_rad_s.abs() + drives[i].k_m_a_nm * axis.link_torque_nm.abs();
        assert!((current - expected[i]).abs() < 1e-5, "joint {}: {current}", i + 1);
    }
}

/// Largest deviation of the energy over two seconds of free swing, J, and the largest kinetic energy in it.
fn drift(dt: f64) -> (f64, f64) {
    let model = model();
    let mut arm = bare(&model, deg([30.0, -40.0, -110.0, 50.0, 70.0, -20.0]), JointVec::zeros(6));
    // Rotors keep the wrist's motion slow enough to be resolved, as they do on the machine.
    let joints = [0.5, 0.5, 0.5, 0.2, 0.1, 0.05].map(JointMechanics::ideal).to_vec();
    arm = Mechanism::new(arm.body().clone(), joints, arm.link_state().0);
    let start = arm.energy().total_j();
    let (mut worst, mut most) = (0.0_f64, 0.0_f64);
    for _ in 0..(2.0 / dt).round() as usize {
        arm.step(dt, &torques(&JointVec::zeros(6)));
        worst = worst.max((arm.energy().total_j() - start).abs());
        most = most.max(arm.energy().kinetic_j);
    }
    assert_eq!(arm.fault(), None);
    (worst, most)
}

#[test]
fn free_swing_keeps_its_energy_to_second_order_in_the_step() {
    let (coarse, kinetic) = drift(5e-4);
    let (fine, _) = drift(2.5e-4);
    assert!((20.0..80.0).contains(&kinetic), "{kinetic} J: it does swing");
    assert!((1e-6..2e-3).contains(&(coarse / kinetic)), "{coarse} of {kinetic} J");
    // Halving the step quarters the drift.
    assert!((2.5..6.0).contains(&(coarse / fine)), "{coarse} J against {fine} J");
}

#[test]
fn work_of_the_drives_is_the_gain_in_energy() {
    let model = model();
    let (q, _, _, tau) = vectors()[0];
    let mut arm = bare(&model, q, JointVec::zeros(6));
    let joints = vec![JointMechanics::ideal(0.5); 6];
    arm = Mechanism::new(arm.body().clone(), joints, q);
    let (start, mut work) = (arm.energy().total_j(), 0.0);
    for _ in 0..1000 {
        let before = arm.link_state().1;
        arm.step(5e-4, &torques(&(tau * 1.5)));
        let middle = (before + arm.link_state().1) * 0.5;
        work += (0..6).map(|i| arm.axis(i).drive_torque_nm * middle[i]).sum::<f64>() * 5e-4;
    }
    let gained = arm.energy().total_j() - start;
    assert!(gained.abs() > 5.0 && (gained - work).abs() < 2e-3 * work.abs(), "{gained} J against {work} J");
}

/// Without gravity, torques and friction the angular momentum about joint 1's axis is constant.
#[test]
fn momentum_about_the_first_axis_is_kept_without_gravity() {
    let text = robot_model::built_in_text("powercube6")
        .unwrap()
        .replace("gravity_m_s2 = 9.81", "gravity_m_s2 = 1e-9");
    let model: RobotModel = RobotModel::from_toml("free", &text).unwrap();
    let (q, v, _, _) = vectors()[0];
    let mut arm = bare(&model, q, v * 0.5);
    let momentum = |arm: &Mechanism| {
        let (q, v) = arm.link_state();
        (model.mass_matrix(&q) * v)[0]
    };
    let start = momentum(&arm);
    for _ in 0..4000 {
        arm.step(2.5e-4, &torques(&JointVec::zeros(6)));
    }
    assert!(
        start.abs() > 0.1 && (momentum(&arm) - start).abs() < 1e-3 * start.abs(),
        "{start} to {}",
        momentum(&arm)
    );
}

fn wheel(joint: JointMechanics, inertia: f64) -> Mechanism {
    Mechanism::new(Body::Wheels(JointVec::repeat(1, inertia)), vec![joint], JointVec::zeros(1))
}

fn servo(reference_rad: f64, inertia: f64) -> AxisInput {
    AxisInput {
        reference_rad,
        stiffness_nm_rad: inertia * 320.0 * 320.0,
        damping_nms_rad: 2.0 * 0.8 * 320.0 * inertia,
        torque_max_nm: 1e9,
        ..AxisInput::default()
    }
}

/// Step response of ωn = 320 rad/s, ζ = 0.8, and the lag of 5 ms behind a ramp.
#[test]
fn position_loop_has_the_response_of_its_second_order_system() {
    let (wn, zeta) = (320.0_f64, 0.8_f64);
    let wd = wn * (1.0 - zeta * zeta).sqrt();
    for (dt, allowed) in [(1e-4, 2e-4), (5e-4, 5e-3), (1e-3, 2e-2)] {
        let mut axis = wheel(JointMechanics::ideal(1.0), 3.0);
        let mut worst = 0.0_f64;
        for k in 1..=(0.05 / dt) as usize {
            axis.step(dt, &[servo(1.0, 4.0)]);
            let t = k as f64 * dt;
            let expected = 1.0
                - (-zeta * wn * t).exp()
                    * ((wd * t).cos() + zeta / (1.0 - zeta * zeta).sqrt() * (wd * t).sin());
            worst = worst.max((axis.axis(0).q_rad - expected).abs());
        }
        assert!(worst < allowed, "step {dt}: {worst}");
        let mut axis = wheel(JointMechanics::ideal(1.0), 3.0);
        let mut lag = 0.0;
        for k in 0..(0.2 / dt) as usize {
            axis.step(dt, &[servo((k as f64 + 0.5) * dt, 4.0)]);
            lag = (k as f64 + 1.0) * dt - axis.axis(0).q_rad;
        }
        assert!((lag - 0.005).abs() < 1e-6, "step {dt}: lag {lag} s at 1 rad/s");
    }
}

#[test]
fn sliding_stops_where_the_closed_form_says_and_stays() {
    let joint = JointMechanics { coulomb_nm: 20.0, ..JointMechanics::ideal(1.0) };
    let mut axis = wheel(joint, 3.0);
    axis.set_state(JointVec::zeros(1), JointVec::repeat(1, 2.0));
    let off = AxisInput::default();
    let mut last = 2.0;
    for _ in 0..2000 {
        axis.step(5e-4, &[off]);
        let v = axis.axis(0).v_rad_s;
        assert!(v.abs() <= f64::abs(last) + 1e-15, "friction never speeds up");
        last = v;
    }
    // v²/2a with a = 20/4.
    assert!((axis.axis(0).q_rad - 0.4).abs() < 1e-3 && last.abs() < 1e-6, "{:?}", axis.axis(0));
    // Below the friction nothing moves, above it moves with what is left.
    for (torque, expected) in [(19.9, 0.0), (24.0, 0.5)] {
        let mut axis = wheel(joint, 3.0);
        let input = AxisInput { torque_nm: torque, torque_max_nm: 100.0, ..AxisInput::default() };
        for _ in 0..1000 {
            axis.step(5e-4, &[input]);
        }
        assert!((axis.axis(0).v_rad_s - expected).abs() < 2e-3, "{torque} Nm: {}", axis.axis(0).v_rad_s);
    }
}

#[test]
fn elastic_gear_swings_with_the_frequency_of_two_masses() {
    let gear = Elasticity { stiffness_nm_rad: 20e3, damping_nms_rad: 0.0 };
    let joint = JointMechanics { elasticity: Some(gear), ..JointMechanics::ideal(4.0) };
    let mut axis = wheel(joint, 2.0);
    // A push on the rotor, then free: sqrt(k (1/4 + 1/2)) = 122.5 rad/s.
    axis.step(1e-4, &[AxisInput { torque_nm: 100.0, torque_max_nm: 100.0, ..AxisInput::default() }]);
    let energy = axis.energy().total_j();
    let (mut crossings, mut before) = (0, 0.0);
    let (dt, steps) = (1e-4, 20_000);
    for _ in 0..steps {
        axis.step(dt, &[AxisInput::default()]);
        let twist = axis.axis(0).q_rad - axis.link_q_rad(0);
        crossings += usize::from(twist > 0.0 && before <= 0.0);
        before = twist;
    }
    let expected = (20e3_f64 * 0.75).sqrt() / std::f64::consts::TAU * dt * f64::from(steps);
    assert!((crossings as f64 - expected).abs() <= 1.0, "{crossings} against {expected}");
    assert!((axis.energy().total_j() / energy - 1.0).abs() < 1e-6, "the midpoint rule loses nothing");
}

#[test]
fn stiff_gear_is_the_limit_of_an_elastic_one() {
    let run = |elasticity| {
        let joint = JointMechanics { elasticity, ..JointMechanics::ideal(1.0) };
        let mut axis = wheel(joint, 3.0);
        for _ in 0..100 {
            axis.step(5e-4, &[servo(0.1, 4.0)]);
        }
        axis.link_q_rad(0)
    };
    let stiff = Elasticity { stiffness_nm_rad: 1e9, damping_nms_rad: 1e5 };
    assert!((run(None) - run(Some(stiff))).abs() < 1e-5);
}

#[test]
fn end_stop_holds_against_full_torque_and_does_not_throw_back() {
    let joint = JointMechanics {
        stop_max_rad: 0.5,
        stop_stiffness_nm_rad: 20e3,
        stop_damping_nms_rad: 2.0 * (20e3_f64 * 4.0).sqrt(),
        coulomb_nm: 2.0,
        ..JointMechanics::ideal(1.0)
    };
    let mut axis = wheel(joint, 3.0);
    axis.set_state(JointVec::zeros(1), JointVec::repeat(1, 3.0));
    let (mut deepest, mut rebound) = (0.0_f64, 0.0_f64);
    for _ in 0..4000 {
        axis.step(5e-4, &[AxisInput::default()]);
        deepest = deepest.max(axis.axis(0).q_rad);
        rebound = rebound.min(axis.axis(0).v_rad_s);
    }
    assert!((0.5..0.53).contains(&deepest) && rebound > -0.5, "{deepest} rad, {rebound} rad/s");
    for _ in 0..4000 {
        axis.step(5e-4, &[AxisInput { torque_nm: 200.0, torque_max_nm: 200.0, ..AxisInput::default() }]);
    }
    assert!((axis.axis(0).q_rad - 0.51).abs() < 1e-3, "200 Nm on 20 kNm/rad: {}", axis.axis(0).q_rad);
}

#[test]
fn torque_limit_saturates_and_is_said() {
    let mut axis = wheel(JointMechanics::ideal(1.0), 3.0);
    let input = AxisInput { torque_max_nm: 8.0, ..servo(1.0, 4.0) };
    for _ in 0..100 {
        axis.step(5e-4, &[input]);
        assert!(axis.axis(0).saturated && (axis.axis(0).drive_torque_nm - 8.0).abs() < 1e-12);
    }
    // 2 rad/s² for 50 ms.
    assert!((axis.axis(0).v_rad_s - 0.1).abs() < 1e-9);
}

#[test]
fn brake_holds_the_arm_and_without_it_the_arm_falls() {
    let model = model();
    let deviations: [_; 6] = std::array::from_fn(|i| Scatter::default().draw(1, i));
    // Stretched out: 54 N·m on the shoulder.
    let q = deg([0.0, 0.0, -90.0, 0.0, 0.0, 0.0]);
    for (brake, fallen) in [(true, false), (false, true)] {
        let mut arm = MechanicsOptions::default().build(&model, q, &deviations);
        let input = AxisInput { brake, ..AxisInput::default() };
        for _ in 0..4000 {
            arm.step(5e-4, &[input; 6]);
        }
        let moved = (arm.link_state().0 - q).amax();
        assert_eq!(moved > 0.1, fallen, "brake {brake}: moved {moved} rad");
        assert!(fallen || moved < 1e-5);
    }
}

#[test]
fn servo_holds_the_arm_against_gravity_with_the_offset_of_its_stiffness() {
    let model = model();
    let options = MechanicsOptions::default();
    let tuned = options.servo_inertia_kg_m2(&model);
    let deviations: [_; 6] = std::array::from_fn(|i| Scatter::default().draw(1, i));
    let q = deg([0.0, 0.0, -90.0, 0.0, 0.0, 0.0]);
    let no_friction = MechanicsOptions { coulomb_rad_s2: Some(0.0), ..options };
    let mut arm = no_friction.build(&model, q, &deviations);
    let inputs: Vec<AxisInput> = (0..6).map(|i| servo(q[i], tuned[i])).collect();
    for _ in 0..2000 {
        arm.step(5e-4, &inputs);
    }
    let gravity = model.gravity_torques(&q);
    for i in 0..6 {
        let sag = q[i] - arm.link_state().0[i];
        let expected = gravity[i] / inputs[i].stiffness_nm_rad;
        assert!((sag - expected).abs() < 1e-6, "joint {}: {sag} against {expected}", i + 1);
        assert!((arm.axis(i).link_torque_nm - gravity[i]).abs() < 0.05);
    }
}

#[test]
fn hand_point_moves_as_its_position_says() {
    let model = model();
    let (q, v, _, tau) = vectors()[0];
    let mut arm = bare(&model, q, v);
    arm.step(1e-6, &torques(&tau));
    let h = 1e-5;
    let (before, at, after) = (arm.hand(-h).unwrap(), arm.hand(0.0).unwrap(), arm.hand(h).unwrap());
    let difference = (after.p_m - before.p_m) / (2.0 * h);
    assert!((difference - at.v_m_s).norm() < 1e-6, "{difference} against {}", at.v_m_s);
    let expected = Vector3::new(0.625274, 0.582934, 0.507103);
    assert!((at.p_m - expected).norm() < 1e-5, "ball of vector A");
}

#[test]
fn sphere_touches_the_box_it_is_in_and_nothing_far_away() {
    let model = model();
    let arm = bare(&model, deg([0.0, -90.0, -90.0, 0.0, 0.0, 0.0]), JointVec::zeros(6));
    // Upright: the fingers are just below (0, 0, 1.277).
    let touch = arm.touch(&Vector3::new(0.0, 0.0, 1.28), 0.03).unwrap();
    assert_eq!(touch.part, "fingers");
    // The fingers' box ends 2 cm above the hand's frame: 1.277 + 0.02.
    assert!((0.03..0.08).contains(&touch.depth_m), "{touch:?}");
    assert_eq!(arm.touch(&Vector3::new(0.5, 0.5, 1.0), 0.03), None);
}

#[test]
fn nan_stops_the_plant_and_nothing_else() {
    let model = model();
    let q = deg([0.0, -90.0, -90.0, 0.0, 0.0, 0.0]);
    for torque in [f64::NAN, f64::INFINITY, 1e300] {
        let mut arm = bare(&model, q, JointVec::zeros(6));
        let mut inputs = torques(&JointVec::zeros(6));
        inputs[2] = AxisInput { torque_nm: torque, torque_max_nm: f64::INFINITY, ..AxisInput::default() };
        for _ in 0..10 {
            arm.step(5e-4, &inputs);
        }
        let fault = arm.fault().expect("reported");
        assert!(!fault.to_string().is_empty());
        for i in 0..6 {
            let axis = arm.axis(i);
            assert!(axis.q_rad.is_finite() && axis.v_rad_s == 0.0 && axis.link_torque_nm.is_finite());
        }
    }
}

#[test]
fn scatter_changes_the_arm_and_the_same_seed_changes_it_the_same_way() {
    let model = model();
    let scatter = Scatter { mass_share: 0.1, com_m: 0.01, friction_share: 0.3, ..Scatter::default() };
    let fall = |seed| {
        let deviations: [_; 6] = std::array::from_fn(|i| scatter.draw(seed, i));
        let mut arm =
            MechanicsOptions::default().build(&model, deg([0.0, 0.0, -90.0, 0.0, 0.0, 0.0]), &deviations);
        for _ in 0..500 {
            arm.step(5e-4, &[AxisInput::default(); 6]);
        }
        arm.link_state().0
    };
    assert_eq!(fall(3), fall(3));
    assert!((fall(3) - fall(4)).amax() > 1e-6);
}

/// Torques that hold the arm with its ball let it accelerate without: the difference is the weight of a point mass.
#[test]
fn the_ball_weighs_on_the_arm_until_it_leaves_the_hand() {
    let text = robot_model::built_in_text("powercube6").unwrap();
    let heavy =
        RobotModel::from_toml("heavy", &text.replacen("ball_mass_kg = 0", "ball_mass_kg = 0.4", 1)).unwrap();
    let bare_model = model();
    let q = deg([30.0, -40.0, -110.0, 50.0, 70.0, -20.0]);
    let frames = bare_model.fk(&q);
    let jacobian = frames.jacobian(&bare_model.ball(&frames).pos);
    let weight = jacobian.row(2) * (0.4 * bare_model.world().gravity_m_s2);
    let holds = bare_model.gravity_torques(&q) + weight;
    let mut arm = bare(&heavy, q, JointVec::zeros(6));
    arm.step(1e-4, &torques(&holds));
    assert!(arm.link_acceleration().amax() < 1e-9, "{}", arm.link_acceleration());
    arm.set_state(q, JointVec::zeros(6));
    arm.set_ball_held(false);
    arm.step(1e-4, &torques(&holds));
    let expected = bare_model.forward_dynamics(&q, &JointVec::zeros(6), &holds);
    assert!(expected.amax() > 1.0);
    assert!((arm.link_acceleration() - expected).amax() < 1e-2 * expected.amax());
}
