//! `cubectl throw` with arms of four, five and seven joints, in the simulated cell, which says where the ball lands, and on a bus.

use crate::bus_common::{Folder, Served, code, cubectl, err, out};
use hil_sim::{Cell, CellOptions};
use robot_model::RobotModel;
use serde_json::Value;

/// A robot file of the planner's tests with drives: its joints carry no drives of their own.
fn with_drives(text: &str, torque_per_a_nm: f64) -> String {
    let mut address = 0;
    let mut names = Vec::new();
    let mut made = String::new();
    let mut in_joint = false;
    for line in text.lines() {
        in_joint = if line.starts_with('[') { line == "[[joint]]" } else { in_joint };
        if let Some(name) = line.strip_prefix("name = ").filter(|_| in_joint) {
            names.push(name.to_owned());
        }
        made += &format!("{line}\n");
        if line.starts_with("jerk_max_deg_s3") && in_joint {
            address += 1;
            made += &format!(
                "[joint.drive]\nmodule = \"drive\"\naddress = {address}\nfirmware = 0x4614\ngear_ratio = 100\nencoder_slots = 4096\n\
                 current_max_a = 20.0\nk_b_a_s_rad = 0.05\nk_m_a_nm = {}\n",
                1.0 / torque_per_a_nm
            );
        }
    }
    made += &format!(
        "[[supply]]\nname = \"arm\"\nvoltage_v = 24\ncurrent_max_a = 100\njoints = [{}]\n[drive_loop]\nnatural_frequency_rad_s = 320\n\
         damping_ratio = 0.8\ncoulomb_friction_rad_s2 = 5\nposition_resolution_deg = 0.02\ndelay_periods = 1\n",
        names.join(", ")
    );
    made
}

/// Throws in the simulated cell; the ball lands at the target, and summary and report have every joint.
fn throws(name: &str, robot: &str, target: &str, joints: usize) {
    let folder = Folder::new(&format!("other-arms-{name}"));
    let dir = folder.file("throw");
    let words = ["--robot", robot, "--target", target, "--yes", "--starts", "48", "--out", &dir];
    let output = cubectl(&[&["throw"], &words[..]].concat());
    let printed = format!("{}{}", out(&output), err(&output));
    println!("{name}: exit {}\n{printed}", code(&output));
    assert_eq!(code(&output), 0, "{printed}");
    let read = |file: &str| std::fs::read_to_string(folder.0.join("throw").join(file)).unwrap();
    let summary: Value = serde_json::from_str(&read("summary.json")).unwrap();
    assert_eq!(summary["outcome"], "landed");
    let error_m = summary["landing_error_m"].as_f64().unwrap();
    assert!((1e-7..0.03).contains(&error_m), "{error_m} m");
    let plan: Value = serde_json::from_str(&read("plan.json")).unwrap();
    assert_eq!(plan["motion"]["joints"].as_array().unwrap().len(), joints);
    // The analysis has heard every drive, and the report has a chart of each.
    let report = read("report.html");
    for joint in plan["motion"]["joints"].as_array().unwrap() {
        assert!(report.contains(&format!("{}: position error", joint.as_str().unwrap())), "{joint}");
    }
    // The same from the files, by the verb that reads a folder.
    let again = cubectl(&["log", "report", &dir, "--out", &folder.file("again.html")]);
    assert_eq!(code(&again), 0, "{}", err(&again));
}

#[test]
fn an_arm_of_four_joints_hits_its_target() {
    throws("four", "pincher4", "1.2,0.4,0.1", 4);
}

#[test]
fn an_arm_of_five_joints_hits_its_target() {
    let folder = Folder::new("other-arms-five-file");
    let robot = folder.file("youbot5.toml");
    std::fs::write(&robot, with_drives(include_str!("../planner/tests/data/youbot5.toml"), 10.0)).unwrap();
    throws("five", &robot, "0.8,0.1,-0.7", 5);
}

#[test]
fn an_arm_of_seven_joints_hits_its_target() {
    let folder = Folder::new("other-arms-seven-file");
    let robot = folder.file("iiwa7.toml");
    std::fs::write(&robot, with_drives(include_str!("../planner/tests/data/iiwa7.toml"), 10.0)).unwrap();
    throws("seven", &robot, "1.3,0.2,-0.7", 7);
}

/// A controller in the program leads seven drives over a socket; nobody sees the ball there.
#[test]
fn an_arm_of_seven_joints_throws_on_a_served_bus() {
    let folder = Folder::new("other-arms-served");
    let robot = folder.file("iiwa7.toml");
    std::fs::write(&robot, with_drives(include_str!("../planner/tests/data/iiwa7.toml"), 10.0)).unwrap();
    let file = robot.clone();
    let cell = move || Cell::new(&RobotModel::load(&file).unwrap(), &CellOptions::default(), 1).unwrap();
    let served = Served::new(cell);
    let dir = folder.file("throw");
    let words = ["throw", "--robot", &robot, "--target", "1.3,0.2,-0.7", "--yes", "--starts", "48"];
    let output =
        cubectl(&[&words[..], &["--controller", "soft", "--bus", &served.spec, "--out", &dir]].concat());
    assert_eq!(code(&output), 0, "{}{}", out(&output), err(&output));
    let summary = std::fs::read_to_string(folder.0.join("throw").join("summary.json")).unwrap();
    let summary: Value = serde_json::from_str(&summary).unwrap();
    assert_eq!(summary["outcome"], "not_observed");
    assert_eq!(summary["tracking"]["error_max_rad"].as_array().unwrap().len(), 7);
    // Where the measured motion sends the ball.
    let error_m = summary["landing_error_m"].as_f64().unwrap();
    assert!((1e-7..0.03).contains(&error_m), "{error_m} m");
}
