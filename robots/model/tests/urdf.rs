//! The URDF export is read back as the same robot; other files are read or refused with a reason.

use nalgebra::Vector3;
use robot_model::urdf::{UrdfOptions, UrdfProblem, robot_file_from_urdf};
use robot_model::{JointVec, RobotModel};

fn options(end_effector: &str) -> UrdfOptions {
    UrdfOptions { end_effector: Some(end_effector.to_owned()), ..UrdfOptions::default() }
}

fn round_trip(name: &str) {
    let robot: RobotModel = RobotModel::load(name).expect("built in");
    let made = robot_file_from_urdf("x.urdf", &robot.to_urdf(), &options("ee")).expect("our own export");
    let n = robot.n();
    assert_eq!(made.joints, n);
    let back: RobotModel = RobotModel::from_toml("x.toml", &made.toml).expect("our own import");
    assert_eq!(back.family().name(), robot.family().name());
    assert_eq!(back.collision().boxes().len(), robot.collision().boxes().len());
    for k in 0..20 {
        let at = |i: usize, s: f64| ((k * 7 + i * 3) as f64 * 0.7 * s).sin() * 2.0;
        let q = JointVec::from_fn(n, |i| at(i, 1.0));
        let qd = JointVec::from_fn(n, |i| at(i, 1.3));
        let qdd = JointVec::from_fn(n, |i| at(i, 1.7) * 4.0);
        let (a, b) = (robot.ee_at(&q), back.ee_at(&q));
        assert!((a.to_matrix() - b.to_matrix()).amax() < 1e-13);
        let tau = robot.inverse_dynamics(&q, &qd, &qdd);
        assert!((tau - back.inverse_dynamics(&q, &qd, &qdd)).amax() < 1e-12 * (1.0 + tau.amax()));
        for (a, b) in robot.boxes_at(&robot.fk(&q)).iter().zip(back.boxes_at(&back.fk(&q))) {
            let corner_gap = a.corners().zip(b.corners()).map(|(p, q)| (p - q).norm()).fold(0.0, f64::max);
            assert!(corner_gap < 1e-12, "{corner_gap:e}");
        }
    }
    for (a, b) in robot.joints().iter().zip(back.joints()) {
        assert!((a.limits.q_min_rad - b.limits.q_min_rad).abs() < 1e-14);
        assert!((a.limits.v_max_rad_s - b.limits.v_max_rad_s).abs() < 1e-14);
    }
}

#[test]
fn every_built_in_robot_survives_the_round_trip() {
    round_trip("powercube6");
    round_trip("kr16_2");
    round_trip("pincher4");
}

#[test]
fn the_last_link_is_the_end_effector_unless_another_is_named() {
    let robot: RobotModel = RobotModel::load("kr16_2").expect("built in");
    let urdf = robot.to_urdf();
    let read = |options: &UrdfOptions| {
        let made = robot_file_from_urdf("x.urdf", &urdf, options).expect("our own export");
        RobotModel::from_toml("x.toml", &made.toml).expect("our own import")
    };
    let q = JointVec::from([0.3, -1.2, 1.0, 0.4, 0.5, 0.6]);
    let frames = robot.fk(&q);
    assert!((read(&UrdfOptions::default()).ee_at(&q).pos - frames.origin(5)).amax() < 1e-13);
    assert!((read(&options("release")).ee_at(&q).pos - robot.ball(&frames).pos).amax() < 1e-13);
    let wrong = robot_file_from_urdf("x.urdf", &urdf, &options("tcp")).expect_err("no such link");
    assert!(matches!(wrong.problem, UrdfProblem::NoSuchEndEffector { .. }), "{wrong}");
}

const INERTIAL: &str = r#"<inertial><origin xyz="0 0 0.1"/><mass value="2"/>
  <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial>"#;

fn link(name: &str, inside: &str) -> String {
    format!("<link name=\"{name}\">{inside}</link>\n")
}

fn joint(name: &str, kind: &str, parent: &str, child: &str, more: &str) -> String {
    format!(
        "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
         <origin xyz=\"0 0 0.5\"/>{more}</joint>\n"
    )
}

const LIMIT: &str = r#"<axis xyz="0 1 0"/><limit lower="-1" upper="1.5" velocity="2" effort="30"/>"#;

/// A pendulum of two links, with a fixed sensor, a cylinder and a mesh.
fn pendulum() -> String {
    let cylinder = r#"<collision><geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>"#;
    let mesh = r#"<collision name="cover"><geometry><mesh filename="cover.stl"/></geometry></collision>"#;
    let body = format!(
        "{}{}{}{}{}{}",
        link("world", ""),
        link("first", &format!("{INERTIAL}{cylinder}{mesh}")),
        link("sensor", INERTIAL),
        link("second", INERTIAL),
        joint("a", "revolute", "world", "first", LIMIT),
        joint("b", "continuous", "sensor", "second", r#"<axis xyz="1 0 0"/>"#)
    );
    let fixed = joint("mount", "fixed", "first", "sensor", "");
    format!("<robot name=\"pendulum\">\n{body}{fixed}</robot>\n")
}

/// The pendulum with two links more: as few joints as an arm may have.
fn chain() -> String {
    let about_x = r#"<axis xyz="1 0 0"/>"#;
    let more = [("e", "second", "third"), ("f", "third", "fourth")].map(|(name, parent, child)| {
        link(child, INERTIAL) + &joint(name, "continuous", parent, child, about_x)
    });
    pendulum().replace("</robot>", &format!("{}</robot>", more.concat()))
}

#[test]
fn fixed_links_are_merged_and_assumptions_are_stated() {
    let made = robot_file_from_urdf("p.urdf", &chain(), &UrdfOptions::default()).expect("a serial arm");
    assert_eq!(made.joints, 4);
    let all = made.notes.join("\n");
    for part in [
        "`b` is continuous",
        "`b` has no velocity limit",
        "mesh `cover` is left out",
        "accelerations are assumed",
    ] {
        assert!(all.contains(part), "{part} in {all}");
    }
    let robot: RobotModel = RobotModel::from_toml("p.toml", &made.toml).expect("loads");
    assert_eq!(robot.family().name(), "general");
    // Two masses of 2 kg, at 0.1 m and 0.5 + 0.1 m above joint a.
    let inertia = &robot.links()[0].inertia;
    assert!((inertia.mass_kg() - 4.0).abs() < 1e-15);
    let centre = robot.links()[0].x_jl.inverse_transform_point(inertia.com_m());
    assert!((centre - Vector3::new(0.0, 0.0, 0.35)).amax() < 1e-15, "{centre}");
    // The hand is 1.5 m up at rest, and joint b is behind the sensor's mount.
    let frames = robot.fk(&JointVec::zeros(4));
    assert!((frames.origin(1) - Vector3::new(0.0, 0.0, 1.5)).amax() < 1e-15);
    assert!((frames.axis(1) - Vector3::x()).amax() < 1e-15);
    assert_eq!(robot.collision().boxes().len(), 1);
    let made = robot_file_from_urdf("p.urdf", &pendulum(), &UrdfOptions::default()).expect("a serial arm");
    assert!(
        matches!(RobotModel::from_toml("p.toml", &made.toml), Err(e) if e.key == "joint"),
        "too few joints"
    );
}

#[test]
fn what_a_serial_revolute_arm_cannot_have_is_refused_with_line_and_reason() {
    let good = pendulum();
    let second_arm = joint("c", "revolute", "first", "third", LIMIT) + &link("third", INERTIAL);
    let with = |extra: &str| good.replace("</robot>", &format!("{extra}</robot>"));
    let table: [(&str, String, &str); 16] = [
        ("not xml", "<robot".to_owned(), "not valid XML"),
        ("xacro", "<xacro/>".to_owned(), "outermost element is `xacro`"),
        ("branch", with(&second_arm), "branches at link `first`"),
        ("prismatic", good.replace("revolute", "prismatic"), "joint `a` is prismatic"),
        ("mimic", good.replace("<axis xyz=\"1 0 0\"/>", "<mimic joint=\"a\"/>"), "joint `b` mimics"),
        ("no inertial", good.replace(&link("second", INERTIAL), &link("second", "")), "link `second` moves"),
        ("no limit", good.replace(LIMIT, ""), "joint `a`: `limit` is missing"),
        ("nan", good.replace("upper=\"1.5\"", "upper=\"nan\""), "`nan` is not a finite number"),
        ("two numbers", good.replace("xyz=\"0 1 0\"", "xyz=\"0 1\""), "`0 1` is not three finite numbers"),
        ("zero axis", good.replace("xyz=\"0 1 0\"", "xyz=\"0 0 0\""), "not an axis"),
        ("unknown link", good.replace("child link=\"second\"", "child link=\"thrid\""), "names link `thrid`"),
        ("two roots", with(&link("lonely", "")), "both have no parent"),
        ("loop", with(&joint("back", "fixed", "second", "world", "")), "every link has a parent"),
        ("two parents", with(&joint("again", "fixed", "world", "second", "")), "child of two joints"),
        ("twice", with(&link("first", "")), "`first` is used twice"),
        ("flat", good.replace("radius=\"0.05\"", "radius=\"0\""), "not a size above zero"),
    ];
    for (name, text, want) in table {
        let error = robot_file_from_urdf("p.urdf", &text, &UrdfOptions::default()).expect_err(name);
        let message = error.to_string();
        assert!(message.starts_with("p.urdf:") && message.contains(want), "{name}: {message}");
        assert!(error.line >= 1);
    }
    let still = "<robot name=\"x\"><link name=\"a\"/></robot>";
    let error = robot_file_from_urdf("p.urdf", still, &UrdfOptions::default()).expect_err("nothing moves");
    assert_eq!(error.problem, UrdfProblem::NoJoints);
}

#[test]
fn impossible_values_are_refused_by_the_loader_of_the_robot_file() {
    let heavy = chain().replace("<mass value=\"2\"/>", "<mass value=\"-2\"/>");
    let made = robot_file_from_urdf("p.urdf", &heavy, &UrdfOptions::default()).expect("still a tree");
    let error = RobotModel::from_toml("p.toml", &made.toml).expect_err("negative mass");
    assert_eq!(error.key, "link[0].inertial.mass_kg");
    let reversed = chain().replace("upper=\"1.5\"", "upper=\"-1.5\"");
    let made = robot_file_from_urdf("p.urdf", &reversed, &UrdfOptions::default()).expect("still a tree");
    let error = RobotModel::from_toml("p.toml", &made.toml).expect_err("limits reversed");
    assert_eq!(error.key, "joint[0].range_deg");
}

#[test]
fn what_is_behind_the_arm_is_held_at_zero_as_a_hand() {
    let finger = |name: &str, kind: &str, more: &str| {
        link(name, INERTIAL) + &joint(&format!("to_{name}"), kind, "fourth", name, more)
    };
    let slide = r#"<axis xyz="0 1 0"/><limit lower="0" upper="0.1" velocity="1" effort="5"/>"#;
    let mimic = format!("{slide}<mimic joint=\"to_left\"/>");
    let hand = finger("left", "prismatic", slide) + &finger("right", "prismatic", &mimic);
    let text = chain().replace("</robot>", &format!("{hand}</robot>"));
    let import = |end: Option<&str>| {
        let options = UrdfOptions { end_effector: end.map(str::to_owned), ..UrdfOptions::default() };
        robot_file_from_urdf("p.urdf", &text, &options)
    };
    for end in [None, Some("fourth"), Some("left")] {
        let made = import(end).expect("an arm with a hand");
        assert_eq!(made.joints, 4, "{end:?}");
        assert!(
            made.notes.iter().any(|note| note.contains("`to_right` (mimic) is held at zero")),
            "{:?}",
            made.notes
        );
        let robot = RobotModel::from_toml("p.toml", &made.toml).expect("loads");
        assert!(
            (robot.links()[3].inertia.mass_kg() - 6.0).abs() < 1e-12,
            "two fingers of 2 kg on a link of 2 kg"
        );
        let z_m = if end == Some("left") { 0.5 } else { 0.0 };
        assert!((robot.end_effector().pos.z.abs() + robot.end_effector().pos.x.abs() - z_m).abs() < 1e-12);
    }
    // In the chain: the arm ends there.
    assert_eq!(import(Some("third")).expect("three joints").joints, 3);
    let refused = import(Some("tcp")).expect_err("no such link").to_string();
    assert!(refused.contains("`tcp` is not a link of this file (there: world, first"), "{refused}");
}
