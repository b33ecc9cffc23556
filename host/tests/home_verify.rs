//! Lost encoder counts, found at the next homing; the simulated cell knows how many were lost.

mod bus_common;

use bus_common::{Folder, code, cubectl, err, out};

fn verify(folder: &Folder, offset_deg: f64) -> (i32, String, serde_json::Value) {
    let fault = format!(
        "[[fault]]\nkind = \"encoder-error\"\ntarget = \"module 2\"\noffset_deg = {offset_deg:?}\nstart_s = 0.0\n"
    );
    let scenario = folder.file("scenario.toml");
    let cell = "schema_version = 1\nname = \"f\"\nduration_s = 60.0\n[drive]\nstarts_homed = true\n";
    std::fs::write(&scenario, format!("{cell}{}", if offset_deg == 0.0 { "" } else { &fault })).unwrap();
    let words = ["home", "--verify", "--modules", "2-4", "--scenario", &scenario, "--json"];
    let output = cubectl(&words);
    println!("{offset_deg} degrees: exit {}\n{}{}", code(&output), out(&output), err(&output));
    (code(&output), err(&output), serde_json::from_str(&out(&output)).unwrap())
}

#[test]
fn lost_counts_are_told_per_joint_when_the_switch_is_found_again() {
    let folder = Folder::new("home-verify");
    // With 30 degrees the joint starts on the other side of its switch.
    for lost_deg in [5.0, -5.0, -40.0, 0.6, 30.0] {
        let (code, said, report) = verify(&folder, lost_deg);
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
    let (code, said, _) = verify(&folder, 0.0);
    assert_eq!(code, 0, "{said}");
}
