//! Lost encoder counts, found at the next homing; the simulated cell knows how many were lost.

use crate::bus_common::{Served, code, cubectl, err, out};
use hil_sim::scenario::fault_from_line;
use hil_sim::{Cell, CellOptions};
use operator::bus::BusArgs;
use protocol::Duration;
use robot_model::RobotModel;

fn verify(offset_deg: f64) -> (i32, String, serde_json::Value) {
    let line = format!(
        "kind = \"encoder-error\", target = \"module 2\", offset_deg = {offset_deg:?}, start_s = 0.0"
    );
    let faults = if offset_deg == 0.0 { Vec::new() } else { vec![fault_from_line(&line, 0).unwrap()] };
    let options = CellOptions {
        drive: hil_sim::drive::DriveOptions { starts_homed: true, ..Default::default() },
        ..CellOptions::default()
    };
    let make = move || Cell::new(&RobotModel::load("powercube6").unwrap(), &options, 1).unwrap();
    let served = Served::with_faults(make, faults);
    // The drive holds what it counts, so it moves while the counts get lost. Then the joint stands.
    let mut waits = BusArgs { bus: served.spec.parse().unwrap(), ..BusArgs::default() }.open().unwrap();
    waits.pass(Duration::from_secs(5)).unwrap();
    drop(waits);
    let words =
        ["home", "--verify", "--modules", "2-4", "--speed-rad-s", "0.2", "--timeout-s", "60", "--json"];
    let output = cubectl(&[&words[..], &["--bus", &served.spec]].concat());
    println!("{offset_deg} degrees: exit {}\n{}{}", code(&output), out(&output), err(&output));
    (code(&output), err(&output), serde_json::from_str(&out(&output)).unwrap())
}

#[test]
fn lost_counts_are_reported_per_joint_when_the_switch_is_found_again() {
    // With 30 degrees the joint starts on the other side of its switch; with 90 it meets its end stop on the way.
    for lost_deg in [5.0, -5.0, -40.0, 0.6, 30.0, 90.0, -90.0] {
        let (code, said, report) = verify(lost_deg);
        assert_eq!(code, 9, "{said}");
        assert!(said.contains("module 2: its reading was off by") && said.contains("next: "), "{said}");
        for module in report["modules"].as_array().unwrap() {
            let lost = if module["module"] == 2 { lost_deg } else { 0.0 };
            let off_deg = module["zero_offset_rad"].as_f64().unwrap().to_degrees();
            let resolution_deg = module["zero_resolution_rad"].as_f64().unwrap().to_degrees();
            assert!((0.05..0.5).contains(&resolution_deg), "{report:#}");
            assert!((off_deg - lost).abs() <= resolution_deg, "{lost_deg}: {report:#}");
        }
    }
    let (code, said, _) = verify(0.0);
    assert_eq!(code, 0, "{said}");
}
