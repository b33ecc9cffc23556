//! A ball that weighs something, from the robot file to the landing.

use crate::bus_common::{Folder, code, cubectl, err, out};
use serde_json::Value;

#[test]
fn a_heavy_ball_needs_more_current_in_plan_check_and_cell_and_lands() {
    let folder = Folder::new("ball-mass");
    let mut peaks_a = Vec::new();
    for mass_kg in ["0", "0.3"] {
        let text = robot_model::built_in_text("powercube6").unwrap().replacen(
            "ball_mass_kg = 0",
            &format!("ball_mass_kg = {mass_kg}"),
            1,
        );
        let robot = folder.file(&format!("robot-{mass_kg}.toml"));
        std::fs::write(&robot, text).unwrap();
        let dir = folder.file(mass_kg);
        let thrown =
            cubectl(&["throw", "--robot", &robot, "--target", "1,1,-1", "--starts", "12", "--out", &dir]);
        assert_eq!(code(&thrown), 0, "{}{}", out(&thrown), err(&thrown));
        // The plan holds by other means than the planner's.
        let checked = cubectl(&["plan", "check", &folder.file(&format!("{mass_kg}/plan.json"))]);
        assert_eq!(code(&checked), 0, "{}{}", out(&checked), err(&checked));
        let read = |name: &str| -> Value {
            serde_json::from_str(&std::fs::read_to_string(folder.0.join(mass_kg).join(name)).unwrap())
                .unwrap()
        };
        let (plan, summary) = (read("plan.json"), read("summary.json"));
        assert_eq!(summary["outcome"], "landed");
        let peaks: Vec<f64> = plan["currents"]["motor_peak_a"]
            .as_array()
            .unwrap()
            .iter()
            .map(|a| a.as_f64().unwrap())
            .collect();
        // Measured in the cell against the model with the ball: they agree as without one.
        let off_a: Vec<f64> = summary["analysis"]["supplies"]
            .as_array()
            .unwrap()
            .iter()
            .map(|supply| supply["difference_rms_a"].as_f64().unwrap())
            .collect();
        println!("{mass_kg} kg: peaks {peaks:?} A, measured off by {off_a:?} A");
        peaks_a.push((peaks, off_a));
    }
    let [(light_a, light_off_a), (heavy_a, heavy_off_a)] = &peaks_a[..] else { unreachable!("two runs") };
    assert!(heavy_a[1] > light_a[1] && heavy_a[2] > light_a[2], "{heavy_a:?} against {light_a:?}");
    for (heavy, light) in heavy_off_a.iter().zip(light_off_a) {
        assert!(*heavy > 0.0 && *heavy < light + 0.5, "{heavy_off_a:?} against {light_off_a:?}");
    }
}
