//! `cubectl robot import | check | show`: files, findings, refusals, exit codes.

use crate::bus_common::{Folder, code, cubectl, err, out};
use crate::page_data;

const URDF: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/robots/arm.urdf");
const ARM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/robots/arm.toml");

#[test]
fn an_imported_arm_is_checked_drawn_and_not_overwritten() {
    let folder = Folder::new("robot-import");
    let arm = folder.file("arm.toml");
    let import = ["robot", "import", URDF, "--end-effector", "tool", "--floor-z-m", "-0.8", "--out", &arm];
    let made = cubectl(&import);
    assert_eq!(code(&made), 0, "{}", err(&made));
    assert!(out(&made).contains("6 joints"), "{}", out(&made));
    // What URDF does not say is listed with its line.
    let checked = cubectl(&["robot", "check", &arm]);
    assert_eq!(code(&checked), 9, "{}", out(&checked));
    let text = std::fs::read_to_string(&arm).unwrap();
    let line = 1 + text.lines().position(|line| line.starts_with("ball_radius_m")).unwrap();
    assert!(out(&checked).contains(&format!("{arm}:{line}: assumed: ball_radius_m")), "{}", out(&checked));
    assert!(
        err(&checked).contains("to plan and to simulate; 0 values are implausible, 25 are assumed"),
        "{}",
        err(&checked)
    );
    // A second import keeps the file, and says how to overwrite it.
    std::fs::write(&arm, text.replace("ball_radius_m = 0.03", "ball_radius_m = 0.02")).unwrap();
    let again = cubectl(&import);
    assert_eq!(code(&again), 10, "{}", err(&again));
    assert!(err(&again).contains("--force"), "{}", err(&again));
    assert!(std::fs::read_to_string(&arm).unwrap().contains("ball_radius_m = 0.02"));
    let picture = folder.file("arm.html");
    let shown = cubectl(&["robot", "show", &arm, "--pose-deg", "0,-90,90,0,90,0", "--out", &picture]);
    assert_eq!(code(&shown), 0, "{}", err(&shown));
    let page = page_data::of(&std::fs::read_to_string(&picture).unwrap());
    let titles: Vec<_> = page_data::charts(&page).iter().map(|chart| chart["title"].clone()).collect();
    let names = ["side, at zero", "side, in the pose", "above, at zero", "above, in the pose"];
    assert!(
        titles.iter().zip(names).all(|(title, name)| title.as_str().unwrap().ends_with(name)),
        "{titles:?}"
    );
    let limits = page_data::all(&page, "rows")[0].as_array().unwrap();
    assert_eq!((titles.len(), limits.len(), limits[1][3][0].as_str()), (4, 6, Some("−90")));
}

#[test]
fn refusals_name_file_line_and_next_step() {
    let folder = Folder::new("robot-refusals");
    let broken = folder.file("broken.toml");
    let text = std::fs::read_to_string(ARM).unwrap();
    std::fs::write(&broken, text.replacen("velocity_max_deg_s", "# velocity_max_deg_s", 1)).unwrap();
    let checked = cubectl(&["robot", "check", &broken]);
    assert_eq!(code(&checked), 4);
    assert!(
        out(&checked).contains("error: joint[0].velocity_max_deg_s: missing\n  next: the data sheet"),
        "{}",
        out(&checked)
    );
    let json = cubectl(&["robot", "check", &broken, "--json"]);
    let rows: serde_json::Value = serde_json::from_str(&out(&json)).unwrap();
    assert_eq!((&rows[0]["weight"], rows[0]["line"].is_u64()), (&"error".into(), true), "{rows}");

    let urdf = folder.file("branch.urdf");
    let text = std::fs::read_to_string(URDF).unwrap();
    std::fs::write(&urdf, text.replacen("type=\"revolute\"", "type=\"prismatic\"", 1)).unwrap();
    let refused = cubectl(&["robot", "import", &urdf]);
    assert_eq!(code(&refused), 4);
    assert!(
        err(&refused).contains("branch.urdf:") && err(&refused).contains("prismatic"),
        "{}",
        err(&refused)
    );

    for (words, what) in [
        (&["robot", "show", ARM, "--pose-deg", "0,1"][..], "has 6 joints"),
        (&["robot", "check", "no-such-robot"], "next: name one of powercube6"),
        (&["robot", "import", "no-such.urdf"], "no-such.urdf"),
        (&["robot", "import", URDF, "--end-effector", "tcp"], "tcp"),
    ] {
        let refused = cubectl(words);
        assert_eq!(code(&refused), 4, "{words:?}");
        assert!(err(&refused).contains(what), "{words:?}: {}", err(&refused));
    }
}
