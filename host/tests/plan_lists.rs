//! `cubectl plan throw` for openings, moving targets and measured release delays, from outside.

use crate::program::{cubectl, cubectl_line, empty_folder as folder, text};

#[test]
fn an_opening_and_a_moving_target_are_planned_reported_and_checked() {
    let folder = folder("plan-opening");
    let (out, report) = (folder.join("p.json"), folder.join("p.html"));
    let (out, report) = (out.display().to_string(), report.display().to_string());
    let line = "plan throw --target 1.6,0.2,-0.3 --opening-normal=-1,0,0 --opening-radius-m 0.1 \
        --target-velocity=0.1,0.1,0 --null-delay false --starts 8";
    let ended = cubectl_line(line, &["--out", &out, "--report", &report]);
    assert!(ended.status.success(), "{}", text(&ended.stderr));
    let reported = text(&ended.stdout);
    assert!(
        reported.contains("opening of 100 mm radius") && reported.contains("meets the moving target"),
        "{reported}"
    );
    assert!(reported.contains("probability of a hit"), "{reported}");
    let checked = cubectl(&["plan", "check", &out]);
    assert!(checked.status.success(), "{}", text(&checked.stdout));
    assert!(text(&checked.stdout).contains("rim of the opening"), "{}", text(&checked.stdout));
    assert!(std::fs::read_to_string(&report).expect("reads").contains("clear of the rim"));
}

#[test]
fn numbers_of_three_hundred_digits_are_refused_in_short_words() {
    let long = "9".repeat(300);
    for option in ["--jitter-s", "--time-budget-s", "--drag-per-m", "--speed-use", "--clearance-m"] {
        let ended = cubectl(&["plan", "throw", "--target=1,1,-1", option, &long]);
        assert_eq!(ended.status.code(), Some(i32::from(host::exit::BAD_INPUT)), "{option}");
        let reported = text(&ended.stderr);
        assert!(reported.contains("1.000e300") && reported.len() < 200, "{option}: {reported}");
    }
    let ended = cubectl(&["plan", "throw", &format!("--target={long},1,-1")]);
    assert_eq!(ended.status.code(), Some(i32::from(host::exit::BAD_INPUT)));
    assert!(text(&ended.stderr).len() < 200, "{}", text(&ended.stderr));
}

#[test]
fn measured_release_delays_are_in_plan_and_summary_and_bad_ones_are_refused_with_their_line() {
    let folder = folder("release-delays");
    let (delays, plan) = (folder.join("delays.txt"), folder.join("plan.json"));
    let plan_with = |text: &str| {
        std::fs::write(&delays, text).expect("writes");
        let (delays, plan) = (delays.display().to_string(), plan.display().to_string());
        let words = ["--fast", "--target", "1,1,-1", "--release-delays", &delays, "--out", &plan];
        cubectl(&[&["plan", "throw"], &words[..]].concat())
    };
    let ended = plan_with("# ms\n20.1\n19.9\n20.0\n20.2\n\n19.8\n28.0 # stuck\n20.0\n20.1\n19.9\n");
    assert!(ended.status.success(), "{}", text(&ended.stderr));
    // Mean 20.89 ms.
    assert!(
        text(&ended.stdout).contains("release delays as measured, 1σ 2.52 ms"),
        "{}",
        text(&ended.stdout)
    );
    let plan = std::fs::read_to_string(&plan).expect("written");
    assert!(plan.contains("\"release_nodes\""), "{plan}");
    for (bad, why) in [
        ("20\n20\n20\n", "3 release delays: 8 to 1000000 are needed"),
        ("20\n20\ntwenty\n", "line 3: \"twenty\" is not a number"),
        ("20\n20\n20\n20\n20\n20\n20\n20\n20\n200\n", "release delay 10 is 162.000 ms from the mean"),
    ] {
        let ended = plan_with(bad);
        assert_eq!(ended.status.code(), Some(2), "{bad}: {}", text(&ended.stderr));
        assert!(text(&ended.stderr).contains(why), "{bad}: {}", text(&ended.stderr));
    }
}

#[test]
fn fast_says_that_it_searched_and_how_long_where_no_stored_throw_leads() {
    let planned = |target: &str| {
        let ended = cubectl(&["plan", "throw", "--fast", &format!("--target={target}")]);
        assert!(ended.status.success(), "{target}: {}", text(&ended.stderr));
        text(&ended.stderr).lines().any(|line| {
            line.starts_with("cubectl: no stored throw led there; a search found this one, in ")
                && line.ends_with(" s")
        })
    };
    assert!(!planned("1,1,-1"));
    assert!(planned("3.5,0,-1"));
}

#[test]
fn weights_that_are_all_zero_are_refused_with_those_that_work() {
    let ended = cubectl(&["plan", "throw", "--target=1,1,-1", "--weights", "0,0,0"]);
    assert_eq!(ended.status.code(), Some(i32::from(host::exit::BAD_INPUT)));
    assert!(text(&ended.stderr).contains("--weights 15,20,0.01"), "{}", text(&ended.stderr));
    // Another objective does not use the weights.
    let line = "plan throw --target=1,1,-1 --weights 0,0,0 --objective energy --fast";
    let ended = cubectl_line(line, &[]);
    assert!(ended.status.success(), "{}", text(&ended.stderr));
}
