//! `cubectl throw --robot kr16_2`: outcome, exit code and files. The witness is the motion of the simulated robot as it is
//! recorded: the landing is computed again from its actual axes, without controller, planner and simulator code.

use std::path::Path;

use nalgebra::Vector3;
use robot_model::RobotModel;
use serde_json::Value;

use crate::page_data;
use crate::program::{cubectl, folder, text};

const TARGET: [f64; 3] = [2.5, 0.0, 0.6];

fn summary(folder: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(folder.join("summary.json")).expect("written"))
        .expect("JSON")
}

/// Actual axes by time, from the recorded motion.
fn actual(folder: &Path) -> Vec<(f64, [f64; 6])> {
    let csv = std::fs::read_to_string(folder.join("motion.csv")).expect("written");
    let row = |line: &str| {
        let numbers: Vec<f64> = line.split(',').map(|n| n.parse().expect("a number")).collect();
        (numbers[0], std::array::from_fn(|axis| numbers[8 + axis].to_radians()))
    };
    csv.lines().skip(1).map(row).collect()
}

/// Where a ball that is free at `t_s` comes down to the height of the target: position and speed of the hand from the
/// forward kinematics of cubics through the recorded axes, flight in closed form.
fn landing(motion: &[(f64, [f64; 6])], t_s: f64) -> Vector3<f64> {
    let arm = RobotModel::load("kr16_2").expect("built in");
    let ball = |t: f64| {
        let k = motion.iter().position(|(at, _)| *at > t).expect("inside").clamp(2, motion.len() - 2);
        let near = &motion[k - 2..k + 2];
        // Lagrange through four cycles.
        let q = std::array::from_fn::<f64, 6, _>(|axis| {
            (0..4)
                .map(|i| {
                    let weight =
                        |j: usize| if i == j { 1.0 } else { (t - near[j].0) / (near[i].0 - near[j].0) };
                    near[i].1[axis] * (0..4).map(weight).product::<f64>()
                })
                .sum()
        });
        arm.ball(&arm.fk(&q.into())).pos
    };
    let h = 1e-4;
    let (p, v) = (ball(t_s), (ball(t_s + h) - ball(t_s - h)) / (2.0 * h));
    let g = 9.81;
    let fall = (v.z + (v.z * v.z + 2.0 * g * (p.z - TARGET[2])).sqrt()) / g;
    let mut down = p + v * fall;
    down.z = TARGET[2];
    down
}

/// Names and numbers of points of the curves of the chart with this title.
fn curves(page: &Value, title: &str) -> Vec<(String, usize)> {
    let charts = page_data::charts(page);
    let [chart] = charts.iter().filter(|chart| chart["title"] == title).collect::<Vec<_>>()[..] else {
        panic!("one chart {title}");
    };
    let points = |curve: &Value| {
        let points = curve["points"].as_array().expect("points");
        points.iter().filter(|point| point[0].is_number() && point[1].is_number()).count()
    };
    let curves = chart["curves"].as_array().expect("curves").iter();
    curves.map(|curve| (curve["name"].as_str().expect("a name").to_owned(), points(curve))).collect()
}

/// The report shows what the paper's figures 7 to 9 show: every curve is there, with a point for each step or cycle.
fn shows_the_figures(folder: &Path) {
    let html = std::fs::read_to_string(folder.join("report.html")).expect("written");
    let page = page_data::of(&html);
    let plan: Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("plan.json")).expect("written"))
            .expect("JSON");
    let steps = plan["steps"].as_array().expect("steps").len();
    let followed = plan["followed_points"].as_u64().expect("a number") as usize;
    for title in ["From the side", "From above"] {
        let shown = curves(&page, title);
        let names: Vec<&str> = shown.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["actual", "flight", "accelerate", "follow the parabola", "decelerate"], "{title}");
        assert!(shown[0].1 >= steps, "{title}: {shown:?}");
        // The first step of the next phase belongs to both.
        assert_eq!((shown[2].1 + shown[3].1 + shown[4].1, shown[3].1), (steps + 2, followed + 1), "{title}");
    }
    for axis in 1..=6 {
        for what in ["angle", "speed", "acceleration"] {
            let shown = curves(&page, &format!("A{axis}: {what}"));
            let names: Vec<&str> = shown.iter().map(|(name, _)| name.as_str()).collect();
            assert_eq!(
                names,
                ["accelerate", "follow the parabola", "decelerate", "actual"],
                "A{axis}: {what}"
            );
            // A cycle each; the follow phase has its steps and the border to the next one.
            let set: usize = shown[..3].iter().map(|(_, points)| points).sum();
            assert!(shown[1].1.abs_diff(followed + 1) <= 1, "A{axis}: {what}: {shown:?}");
            assert!(shown[3].1 >= steps && set.abs_diff(shown[3].1) <= 3, "A{axis}: {what}: {shown:?}");
        }
    }
    assert_eq!(curves(&page, "Landing error").len(), 2);
    let space = page_data::all(&page, "space");
    let steps = space[0]["scene"]["steps"].as_array().expect("an animation");
    assert!(steps.len() > 90 && html.contains("bottle hit"), "the animation and the bottle");
}

#[test]
fn industrial_robot_throws_and_its_recorded_motion_sends_the_ball_to_the_target() {
    let folder = folder("robot-throw");
    let path = folder.to_string_lossy().into_owned();
    let out =
        cubectl(&["throw", "--robot", "kr16_2", "--target", "2.5,0,0.6", "--starts", "16", "--out", &path]);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    assert!(text(&out.stdout).contains("landed"), "{}", text(&out.stdout));
    let summary = summary(&folder);
    assert_eq!((summary["outcome"].as_str(), summary["exit_code"].as_u64()), (Some("landed"), Some(0)));
    assert_eq!(summary["late_answers"].as_u64(), Some(0));
    let reported = summary["landing"]["error_m"].as_f64().expect("a landing");
    let release_s = {
        let plan: Value =
            serde_json::from_str(&std::fs::read_to_string(folder.join("plan.json")).expect("written"))
                .expect("JSON");
        plan["release_time_s"].as_f64().expect("a time")
            + summary["release"]["late_s"].as_f64().expect("a time")
    };
    let own = (landing(&actual(&folder), release_s) - Vector3::from(TARGET)).xy().norm();
    println!("reported {:.2} mm, from the recorded motion {:.2} mm", 1e3 * reported, 1e3 * own);
    assert!(reported < 0.02 && (own - reported).abs() < 0.005, "{reported} {own}");
    shows_the_figures(&folder);

    // The same plan with a tolerance that no throw keeps is reported as a miss.
    let plan = folder.join("plan.json").to_string_lossy().into_owned();
    let again = self::folder("robot-throw-missed").to_string_lossy().into_owned();
    let words = ["throw", "--robot", "kr16_2", "--plan", &plan, "--out", &again, "--tolerance-m", "0.000001"];
    let out = cubectl(&words);
    assert_eq!(out.status.code(), Some(11), "{}", text(&out.stderr));
    assert!(text(&out.stderr).contains("missed"), "{}", text(&out.stderr));

    // Results that cannot be written hide neither the outcome nor its code, and the others are written.
    let blocked = self::folder("robot-throw-unwritten");
    std::fs::create_dir_all(blocked.join("motion.csv")).expect("writable");
    let blocked_text = blocked.to_string_lossy().into_owned();
    let words =
        ["throw", "--robot", "kr16_2", "--plan", &plan, "--out", &blocked_text, "--tolerance-m", "0.000001"];
    let out = cubectl(&words);
    let reported = text(&out.stderr);
    assert_eq!(out.status.code(), Some(11), "{reported}");
    assert!(
        reported.contains("missed")
            && reported.contains("not all of them")
            && reported.contains("motion.csv"),
        "{reported}"
    );
    assert_eq!(self::summary(&blocked)["exit_code"].as_u64(), Some(11));

    // A CAN bus has no meaning here.
    let out = cubectl(&["throw", "--robot", "kr16_2", "--plan", &plan, "--bus", "can0"]);
    assert_eq!(out.status.code(), Some(4), "{}", text(&out.stderr));
    assert!(text(&out.stderr).contains("leave --bus out"), "{}", text(&out.stderr));

    // The exchange runs again with the same answers.
    let out = cubectl(&["log", "replay", &path]);
    assert!(text(&out.stdout).starts_with("identical: "), "{} {}", text(&out.stdout), text(&out.stderr));

    // A robot that cuts out while it follows the flight is reported as stopped.
    let scenario = self::folder("robot-throw-scenario");
    std::fs::create_dir_all(&scenario).expect("writable");
    let krc = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/kr16_2");
    std::fs::copy(krc.join("rsi_udp.xml"), scenario.join("rsi_udp.xml")).expect("copied");
    let text_of = std::fs::read_to_string(krc.join("kr_c2.toml")).expect("readable");
    let file = scenario.join("cut_out.toml");
    // Shortly before the release of the first throw, whose way to the start takes as long.
    let at_s = summary["plan_started_s"].as_f64().expect("a time") + release_s - 0.1;
    std::fs::write(&file, format!("{text_of}\n[[fault]]\nkind = \"cut-out\"\nstart_s = {at_s:.3}\n"))
        .expect("writable");
    let file = file.to_string_lossy().into_owned();
    let stopped = self::folder("robot-throw-stopped").to_string_lossy().into_owned();
    let words = ["throw", "--robot", "kr16_2", "--plan", &plan, "--out", &stopped, "--scenario", &file];
    let out = cubectl(&words);
    assert_eq!(out.status.code(), Some(13), "{}", text(&out.stderr));
    assert!(text(&out.stderr).contains("the robot stopped by itself"), "{}", text(&out.stderr));

    // The folder has what the controller saw: the robot fell silent, in which state, and each axis at that moment.
    let out = cubectl(&["explain", "--last", &stopped]);
    let reported = text(&out.stdout);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    for words in ["DriveSilent (101)", "in state running", "reaction:", "last events"] {
        assert!(reported.contains(words), "{words}: {reported}");
    }
    let out = cubectl(&["explain", "--last", &path]);
    assert!(text(&out.stdout).contains("no fault is latched"), "{}", text(&out.stdout));
    let out = cubectl(&["explain", "--last", "no-such-folder"]);
    assert_eq!(out.status.code(), Some(4), "{}", text(&out.stderr));

    // A robot that adds corrections is not led.
    let file = scenario.join("relative.toml");
    std::fs::write(&file, text_of.replace("relative = false", "relative = true")).expect("writable");
    let file = file.to_string_lossy().into_owned();
    let out = cubectl(&["throw", "--robot", "kr16_2", "--target", "2.5,0,0.6", "--rsi", &file]);
    assert_eq!(out.status.code(), Some(4), "{}", text(&out.stderr));
    assert!(text(&out.stderr).contains("relative = true"), "{}", text(&out.stderr));

    // A program whose corrections do not reach the throw is refused before anything moves.
    let narrow =
        text_of.replace("lower = [-184.9,", "lower = [-5,").replace("upper = [184.9,", "upper = [5,");
    let file = scenario.join("narrow.toml");
    std::fs::write(&file, narrow).expect("writable");
    let file = file.to_string_lossy().into_owned();
    let out = cubectl(&["throw", "--robot", "kr16_2", "--plan", &plan, "--rsi", &file]);
    assert_eq!(out.status.code(), Some(4), "{}", text(&out.stderr));
    assert!(text(&out.stderr).contains("needs a correction of"), "{}", text(&out.stderr));
}

#[test]
fn identify_of_an_industrial_robot_refuses_the_options_of_a_joint_by_name() {
    for words in [
        ["--report", "r.html"],
        ["--joint", "1"],
        ["--level", "0.9"],
        ["--speed-share", "0.5"],
        ["--current-share", "0.5"],
    ] {
        let out = cubectl(&["arm", "identify", "--robot", "kr16_2", words[0], words[1]]);
        assert_eq!(out.status.code(), Some(4), "{words:?}: {}", text(&out.stderr));
        let refused = format!("{} has no meaning", words[0]);
        assert!(text(&out.stderr).contains(&refused), "{words:?}: {}", text(&out.stderr));
    }
}
