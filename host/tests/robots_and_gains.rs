//! Which gains a robot gets, and files that are read back by the verbs that take them.

use crate::bus_common::{Folder, code, cubectl, err, out};
use firmware::settings::Settings;
use serde_json::Value;
use tuner::gains::gains_file::GainsFile;

/// A robot file made of the built-in one with replacements.
fn robot(folder: &Folder, name: &str, changes: &[(&str, &str)]) -> String {
    let mut text = robot_model::built_in_text("powercube6").unwrap().to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let path = folder.file(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn summary(folder: &Folder, name: &str) -> Value {
    let text = std::fs::read_to_string(folder.0.join(name).join("summary.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

const NAME: (&str, &str) = ("name = \"powercube6\"", "name = \"my_arm\"");
const SLOWER: (&str, &str) =
    ("control_acceleration_max_rad_s2 = 10.4", "control_acceleration_max_rad_s2 = 8.0");

#[test]
fn another_robot_gets_gains_that_are_designed_for_it_and_the_report_names_their_certificate() {
    let folder = Folder::new("robots-own-gains");
    let foreign = format!("{:08x}", Settings::powercube6().gains_certificate_crc32);
    let my_arm = robot(&folder, "my_arm.toml", &[NAME, SLOWER]);
    let dir = folder.file("a");
    let thrown = cubectl(&["throw", "--robot", &my_arm, "--target", "0.9,0.9,-1", "--out", &dir]);
    assert_eq!(code(&thrown), 0, "{}{}", out(&thrown), err(&thrown));
    assert!(err(&thrown).contains("designed and certified for my_arm at 3 ms"), "{}", err(&thrown));
    let reported = summary(&folder, "a");
    assert_eq!((&reported["outcome"], &reported["gains_from"]), (&"landed".into(), &"designed".into()));
    let gains = std::fs::read_to_string(folder.0.join("a/gains.toml")).unwrap();
    let robot = robot_model::RobotModel::load(&my_arm).unwrap();
    let mut held = operator::bus::settings::settings_of(&robot).unwrap();
    let robot_crc32 = held.limits_robot_crc32;
    GainsFile::from_toml(&gains, "my_arm").unwrap().enter(robot_crc32, &mut held);
    let own = format!("{:08x}", held.gains_certificate_crc32);
    assert_eq!(reported["hashes"]["certificate_crc32"], own);
    assert_ne!(own, foreign);
    let report = std::fs::read_to_string(folder.0.join("a/report.html")).unwrap();
    assert!(report.contains(&own) && !report.contains(&foreign));
    assert!(gains.contains("robot = \"my_arm\"") && gains.contains("acceleration_max_rad_s2 = 8.0"));
    // The recording is of these gains.
    let replayed = cubectl(&["log", "replay", &dir, "--robot", &my_arm]);
    assert_eq!(code(&replayed), 0, "{}{}", out(&replayed), err(&replayed));
}

#[test]
fn gains_in_force_that_a_throw_writes_are_taken_by_replay() {
    let folder = Folder::new("robots-in-force");
    let dir = folder.file("a");
    let thrown = cubectl(&["throw", "--target", "1,1,-1", "--period-ms", "10", "--out", &dir]);
    assert_eq!(code(&thrown), 0, "{}", err(&thrown));
    // The form in which a throw with a controller of its own writes what that controller held.
    let file: toml::Table = std::fs::read_to_string(folder.0.join("a/gains.toml")).unwrap().parse().unwrap();
    let column = |key: &str| -> Vec<toml::Value> {
        file["joint"].as_array().unwrap().iter().map(|joint| joint[key].clone()).collect()
    };
    let mut in_force = toml::Table::new();
    in_force.insert("period_us".to_owned(), 10_000.into());
    let crc = summary(&folder, "a")["hashes"]["certificate_crc32"].as_str().unwrap().to_owned();
    in_force.insert("certificate_crc32".to_owned(), i64::from_str_radix(&crc, 16).unwrap().into());
    let robot = robot_model::RobotModel::load("powercube6").unwrap();
    let robot_crc32 = operator::bus::settings::crc32_of(&robot);
    in_force.insert("robot_crc32".to_owned(), i64::from(robot_crc32).into());
    for (key, us) in [("delay_us", [8_000, 10_000]), ("lags_us", [130, 5_000])] {
        in_force.insert(key.to_owned(), us.map(toml::Value::Integer).to_vec().into());
    }
    in_force.insert("estimator_alpha".to_owned(), file["estimator"]["alpha"].clone());
    in_force.insert("estimator_beta".to_owned(), file["estimator"]["beta"].clone());
    for key in ["k_pos_1_s2", "k_vel_1_s", "k_last"] {
        in_force.insert(key.to_owned(), column(key).into());
    }
    std::fs::write(folder.0.join("a/gains.toml"), in_force.to_string()).unwrap();
    let replayed = cubectl(&["log", "replay", &dir]);
    assert_eq!(code(&replayed), 0, "{}{}", out(&replayed), err(&replayed));
    // Other gains are another controller, and that is seen.
    in_force.insert("estimator_alpha".to_owned(), 0.5.into());
    std::fs::write(folder.0.join("a/gains.toml"), in_force.to_string()).unwrap();
    assert_eq!(code(&cubectl(&["log", "replay", &dir])), 9);
}

#[test]
fn a_plan_of_unknown_kind_is_refused_by_every_verb_that_reads_plans() {
    let folder = Folder::new("robots-kind");
    let plan = folder.file("plan.json");
    let planned = cubectl(&["plan", "throw", "--target", "1,1,-1", "--fast", "--out", &plan]);
    assert_eq!(code(&planned), 0, "{}", err(&planned));
    assert_eq!(code(&cubectl(&["plan", "check", &plan])), 0);
    let text = std::fs::read_to_string(&plan).unwrap();
    assert!(text.contains("\"kind\": \"throw\""));
    std::fs::write(&plan, text.replacen("\"kind\": \"throw\"", "\"kind\": \"dance\"", 1)).unwrap();
    for words in [
        &["plan", "check", &plan][..],
        &["throw", "--plan", &plan, "--out", &folder.file("out")],
        &["plan", "export", &plan, "--csv"],
        &["controller", "upload", &plan],
        &["tune", "--plan", &plan],
    ] {
        let refused = cubectl(words);
        assert_eq!(code(&refused), 4, "{words:?}: {}", err(&refused));
        assert!(err(&refused).contains("its kind is \"dance\""), "{words:?}: {}", err(&refused));
    }
}

#[test]
fn the_paper_settings_are_refused_for_another_robot() {
    let folder = Folder::new("robots-paper");
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let bus = format!("socketcand://{}/can0", nobody.local_addr().unwrap());
    drop(nobody);
    let served = crate::bus_common::Served::arm(hil_sim::CellOptions::default());
    let slower = robot(&folder, "slower.toml", &[SLOWER]);
    let refused =
        cubectl(&["controller", "run", "--paper", "--robot", &slower, "--bus", &served.spec, "--for", "1"]);
    assert_eq!(code(&refused), 4, "{}", err(&refused));
    assert!(err(&refused).contains("the settings of the paper are for powercube6"), "{}", err(&refused));
    // Without a bus nothing is settled.
    assert_eq!(code(&cubectl(&["controller", "run", "--paper", "--bus", &bus, "--for-s", "1"])), 7);
}

#[test]
fn a_second_controller_does_not_start_with_the_paper_settings_either() {
    let served = crate::bus_common::Served::new(|| {
        let robot = robot_model::RobotModel::load("powercube6").unwrap();
        let cell = hil_sim::Cell::new(&robot, &hil_sim::CellOptions::default(), 1).unwrap();
        (cell, operator::bus::sim::soft_controller_node())
    });
    let second = cubectl(&["controller", "run", "--paper", "--bus", &served.spec, "--for", "1"]);
    assert_eq!(code(&second), 7, "{}{}", out(&second), err(&second));
    assert!(err(&second).contains("another controller or host speaks to the modules"), "{}", err(&second));
}

/// Found with gains for a third of the delay of the loop: thrown, and reported to be inside the certificate.
#[test]
fn gains_for_another_delay_are_refused_before_anything_moves() {
    let folder = Folder::new("robots-delay");
    let gains = folder.file("g.toml");
    let tuned = cubectl(&["tune", "--period-ms", "3", "--delay-ms", "1", "--no-trial", "--out", &gains]);
    assert_eq!(code(&tuned), 0, "{}", err(&tuned));
    let dir = folder.file("a");
    let thrown = cubectl(&["throw", "--target", "1,1,-1", "--gains", &gains, "--out", &dir]);
    assert_ne!(code(&thrown), 0, "{}", out(&thrown));
    assert!(err(&thrown).contains("fault 732") && err(&thrown).contains("next: "), "{}", err(&thrown));
}

/// `tune --error 0.02 --plan` was refused for a delay that does not bind: a joint that stands uses no acceleration.
#[test]
fn gains_for_a_plan_are_designed_and_compared_with_others_in_its_throw() {
    let folder = Folder::new("robots-compare");
    let (thrown, a, b) = (folder.file("thrown"), folder.file("a.toml"), folder.file("b.toml"));
    assert_eq!(code(&cubectl(&["throw", "--target", "1,1,-1", "--out", &thrown])), 0);
    let plan = folder.file("thrown/plan.json");
    let tuned = cubectl(&["tune", "--error", "0.02", "--plan", &plan, "--no-trial", "--out", &a]);
    assert_eq!(code(&tuned), 0, "{}", err(&tuned));
    let mut own = std::fs::read_to_string(folder.0.join("thrown/gains.toml")).unwrap();
    own.insert_str(0, "# Of the throw.\n");
    std::fs::write(&b, own).unwrap();
    let compared = cubectl(&["tune", "--compare", &a, &b, "--log", &thrown, "--json"]);
    assert_eq!(code(&compared), 0, "{}{}", out(&compared), err(&compared));
    let reported: Value = serde_json::from_str(&out(&compared)).unwrap();
    let rows = reported["rows"].as_array().unwrap();
    let of = |gains: &str, start: &str| {
        let row = rows.iter().find(|row| row["gains"] == gains && row["start"] == start);
        row.unwrap_or_else(|| panic!("{gains} {start}: {reported:#}"))
    };
    // The measured throw is found to be of the second file, and its error is that of the simulation of it.
    let (seen, expected) = (of(&b, "recorded"), of(&b, "on it"));
    let ratio = seen["late_max_mrad"].as_f64().unwrap() / expected["late_max_mrad"].as_f64().unwrap();
    assert!((0.5..2.0).contains(&ratio), "{reported:#}");
    assert!(of(&a, "on it")["landing_mm"].as_f64().unwrap() < 20.0, "{reported:#}");
    // Gains for the plan use what it leaves: errors are halved no later.
    let halved = |gains: &str| -> Vec<f64> {
        let row = of(gains, "100 mrad beside")["halved_s"].as_array().unwrap();
        row.iter().map(|s| s.as_f64().unwrap()).collect()
    };
    assert!(halved(&a).iter().zip(halved(&b)).all(|(a, b)| *a <= b), "{reported:#}");
    let table = out(&cubectl(&["tune", "--compare", &a, &b, "--log", &thrown]));
    for said in ["certificates verified", "late mrad  ", "largest position error of any joint after 0.35 s"] {
        assert!(table.contains(said), "{said}: {table}");
    }
}

#[test]
fn errors_that_cannot_be_certified_give_the_gains_for_the_nearest_that_can() {
    let folder = Folder::new("robots-nearest");
    let gains = folder.file("g.toml");
    let words = ["tune", "--joint", "1", "--no-trial", "--reference-share", "0.99"];
    let backup = folder.file("before.toml");
    let page = folder.file("g.html");
    let asked = ["--error", "0.06", "--out", &gains, "--report", &page, "--apply", "--backup", &backup];
    let tuned = cubectl(&[&words[..], &asked].concat());
    assert_eq!(code(&tuned), 9, "{}{}", out(&tuned), err(&tuned));
    let reported = err(&tuned);
    assert!(reported.contains("saturation binds") && reported.contains("next: "), "{reported}");
    // What is named is what the file proves, and it is taken as named.
    let file = GainsFile::from_toml(&std::fs::read_to_string(&gains).unwrap(), "powercube6").unwrap();
    let nearest = file.joint[0].problem.error_position_rad;
    assert!(nearest < 0.06 && reported.contains(&format!("--error {nearest} ")), "{nearest}: {reported}");
    let advised: Vec<&str> = reported.split("--error ").nth(1).unwrap().split([' ', ',']).take(2).collect();
    let again = cubectl(&[&words[..], &["--error"], &advised].concat());
    assert_eq!(code(&again), 0, "{advised:?}: {}", err(&again));
    let page = std::fs::read_to_string(page).unwrap();
    for shown in ["certified, for smaller errors", "Sensitivity |S|", "Certified region", "Lyapunov"] {
        assert!(page.contains(shown), "{shown}");
    }
    // And it is the nearest: a twentieth more cannot be certified.
    let more = (1.05 * nearest).to_string();
    assert_eq!(code(&cubectl(&[&words[..], &["--error", &more]].concat())), 9, "{more}");
    // Nothing is put into a controller that was not asked for.
    assert!(!folder.0.join("before.toml").exists(), "{}", out(&tuned));
}
