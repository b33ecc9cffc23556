//! `cubectl plan throw` for openings, moving targets and lists of targets, and `plan prepare`, from outside.

use std::path::Path;

use crate::program::{cubectl, empty_folder as folder, text};

fn rows(path: &Path) -> Vec<String> {
    std::fs::read_to_string(path).expect("reads").lines().map(str::to_owned).collect()
}

#[test]
fn a_list_has_one_row_of_results_per_target_in_order_and_is_continued() {
    let folder = folder("plan-list");
    let (list, out, plans) = (folder.join("targets.csv"), folder.join("results.csv"), folder.join("plans"));
    // The second is out of reach, the third below the floor, the first stands twice.
    std::fs::write(&list, "z_m,x_m,y_m\n-1.0,1.0,1.0\n0,9,0\n-3,1,1\n-1.0,1.0,1.0\n").expect("writes");
    let (list, out, plans) =
        (list.display().to_string(), out.display().to_string(), plans.display().to_string());
    let run = || {
        cubectl(&[
            "plan",
            "throw",
            "--form",
            "paper",
            "--fast",
            "--starts",
            "2",
            "--targets",
            &list,
            "--out",
            &out,
            "--plans",
            &plans,
        ])
    };
    let ended = run();
    assert!(ended.status.success(), "{}", text(&ended.stderr));
    let first = rows(Path::new(&out));
    assert_eq!(first.len(), 5, "{first:?}");
    assert!(first[1].starts_with("1,1,1,-1,thrown,31.26"), "{}", first[1]);
    assert!(
        first[2].starts_with("2,9,0,0,refused,") && first[2].contains("no throw reaches"),
        "{}",
        first[2]
    );
    assert!(
        first[3].starts_with("3,1,1,-3,refused,") && first[3].contains("below the floor"),
        "{}",
        first[3]
    );
    assert_eq!(first[1].strip_prefix('1'), first[4].strip_prefix('4'));
    let told = text(&ended.stdout);
    assert!(told.contains("2 throws with all that was asked for") && told.contains("2 refused"), "{told}");
    let plan = format!("{plans}/plan-000004.json");
    assert!(cubectl(&["check", &plan]).status.success());

    // Torn in the third row: that one is planned again, the others stay as they are.
    std::fs::write(&out, first[..3].join("\n") + "\n3,1,1").expect("writes");
    let ended = run();
    assert!(text(&ended.stderr).contains("2 already"), "{}", text(&ended.stderr));
    assert_eq!(rows(Path::new(&out)), first);

    // The table of another list is neither continued nor overwritten.
    std::fs::write(&list, "x_m,y_m,z_m\n1.5,0,-0.5\n").expect("writes");
    let ended = run();
    assert_eq!(ended.status.code(), Some(i32::from(host::exit::BAD_INPUT)));
    assert!(text(&ended.stderr).contains("next:"), "{}", text(&ended.stderr));
    assert_eq!(rows(Path::new(&out)), first);
}

#[test]
fn lists_that_are_none_are_refused_with_row_and_column() {
    let folder = folder("plan-list-refused");
    let out = folder.join("results.csv").display().to_string();
    for (name, content, told) in [
        ("a.csv", "x_m,y_m\n1,2\n", "all or none are needed"),
        ("b.csv", "x_m,y_m,z_m,colour\n1,2,3,red\n", "\"colour\" is not known"),
        ("c.csv", "x_m,y_m,z_m\n1,2,-1\n1,nan,-1\n", "row 2, column \"y_m\""),
        ("d.csv", "x_m,y_m,z_m\n", "no target"),
        ("e.csv", "x_m,y_m,z_m,nx,ny,nz\n1,1,-1,0,0,1\n", "an opening needs"),
        ("f.parquet", "PAR1", "not a Parquet file"),
    ] {
        let list = folder.join(name);
        std::fs::write(&list, content).expect("writes");
        let ended = cubectl(&["plan", "throw", "--targets", &list.display().to_string(), "--out", &out]);
        assert_eq!(ended.status.code(), Some(i32::from(host::exit::BAD_INPUT)), "{name}");
        assert!(text(&ended.stderr).contains(told), "{name}: {}", text(&ended.stderr));
        assert!(!Path::new(&out).exists(), "{name}");
    }
}

#[test]
fn an_opening_and_a_moving_target_are_planned_told_and_checked() {
    let folder = folder("plan-opening");
    let (out, report) = (folder.join("p.json"), folder.join("p.html"));
    let (out, report) = (out.display().to_string(), report.display().to_string());
    let ended = cubectl(&[
        "plan",
        "throw",
        "--target",
        "1.6,0.2,-0.3",
        "--opening-normal=-1,0,0",
        "--opening-radius-m",
        "0.1",
        "--target-velocity=0.1,0.1,0",
        "--null-delay",
        "false",
        "--starts",
        "8",
        "--out",
        &out,
        "--report",
        &report,
    ]);
    assert!(ended.status.success(), "{}", text(&ended.stderr));
    let told = text(&ended.stdout);
    assert!(told.contains("opening of 100 mm radius") && told.contains("meets the moving target"), "{told}");
    assert!(told.contains("probability of a hit"), "{told}");
    let checked = cubectl(&["check", &out]);
    assert!(checked.status.success(), "{}", text(&checked.stdout));
    assert!(text(&checked.stdout).contains("rim of the opening"), "{}", text(&checked.stdout));
    assert!(std::fs::read_to_string(&report).expect("reads").contains("clear of the rim"));
}

#[test]
fn the_same_arguments_prepare_the_same_table_and_options_for_one_target_are_refused() {
    let folder = folder("plan-prepare");
    let path = |name: &str| folder.join(name).display().to_string();
    let prepare = |out: &str| {
        cubectl(&[
            "plan",
            "prepare",
            "powercube6",
            "--form",
            "paper",
            "--step-m",
            "0.5",
            "--range-max-m",
            "2",
            "--height-max-m",
            "0",
            "--starts",
            "2",
            "--sweeps",
            "1",
            "--trials",
            "4",
            "--out",
            out,
        ])
    };
    let (one, two) = (path("one.table"), path("two.table"));
    assert!(prepare(&one).status.success());
    assert!(prepare(&two).status.success());
    let bytes = std::fs::read(&one).expect("reads");
    assert!(bytes.len() > 1000, "there are throws in it");
    assert_eq!(bytes, std::fs::read(&two).expect("reads"), "same arguments, same table");
    let refused =
        cubectl(&["plan", "prepare", "powercube6", "--target-velocity=1,0,0", "--out", &path("none.table")]);
    assert_eq!(refused.status.code(), Some(i32::from(host::exit::BAD_INPUT)));
    assert!(text(&refused.stderr).contains("--target-velocity"), "{}", text(&refused.stderr));
}

#[test]
fn a_table_of_a_sweep_tells_relaxed_throws_from_others_in_the_order_of_the_grid() {
    let table = folder("plan-table").join("reach.csv");
    let out = table.display().to_string();
    let words =
        ["plan", "sweep", "--x=1,5,2", "--y=0.5,0.5,1", "--z=-1,-1,1", "--starts", "8", "--out", &out];
    let ended = cubectl(&words);
    assert!(ended.status.success(), "{}", text(&ended.stderr));
    let told = text(&ended.stdout);
    assert!(told.contains("1 of 3 targets in reach with all that was asked for, 1 more without"), "{told}");
    let first = rows(&table);
    let begin: Vec<String> =
        first.iter().map(|row| row.split(',').take(4).collect::<Vec<_>>().join(",")).collect();
    assert_eq!(begin, ["x_m,y_m,z_m,outcome", "1,0.5,-1,thrown", "3,0.5,-1,relaxed", "5,0.5,-1,refused"]);
    // A table that is there is told in the same way.
    let again = cubectl(&words);
    assert!(text(&again.stdout).contains("1 of 3 targets"), "{}", text(&again.stdout));
    assert_eq!(rows(&table), first);
}

/// Rows of another robot, seed, obstacle or objective would stand as those of this one.
#[test]
fn a_table_is_continued_only_with_what_made_it() {
    let folder = folder("plan-other-table");
    let list = folder.join("targets.csv").display().to_string();
    std::fs::write(&list, "x_m,y_m,z_m\n1,1,-1\n").expect("writes");
    let table = ["plan", "sweep", "--x=1,1,1", "--y=1,1,1", "--z=-1,-1,1", "--starts", "1"];
    let results = ["plan", "throw", "--fast", "--targets", &list];
    for (name, words) in [("reach.csv", &table[..]), ("results.csv", &results)] {
        let path = folder.join(name);
        let out = path.display().to_string();
        let run = |more: &[&str]| cubectl(&[words, &["--out", &out], more].concat());
        let made = run(&["--form", "paper"]);
        assert!(made.status.success(), "{}", text(&made.stderr));
        let first = std::fs::read(&path).expect("reads");
        for (more, differs) in [
            (&["--form", "paper", "--robot", "pincher4"][..], "robot: powercube6"),
            (&["--form", "paper", "--seed", "2"], "seed: 1 there, 2 asked for"),
            (&["--form", "paper", "--obstacle", "2,2,2,0.1,0.1,0.1"], "options: "),
            (&["--form", "best"], "options: "),
        ] {
            let refused = run(more);
            assert_eq!(refused.status.code(), Some(i32::from(host::exit::BAD_INPUT)), "{name} {more:?}");
            let told = text(&refused.stderr);
            assert!(told.contains(differs) && told.contains("next:"), "{name} {more:?}: {told}");
            assert_eq!(std::fs::read(&path).expect("reads"), first, "{name} {more:?}");
        }
        assert!(run(&["--form", "paper"]).status.success(), "the same words go on");
        std::fs::remove_file(path.with_extension("study.json")).expect("removes");
        let unknown = run(&["--form", "paper"]);
        assert!(text(&unknown.stderr).contains("does not say what made them"), "{}", text(&unknown.stderr));
    }
}

/// The witness is a second name of the earlier file: it loses nothing, so neither would a full disk or a kill at that moment.
#[test]
fn a_torn_table_is_replaced_by_a_whole_one_and_not_truncated() {
    let folder = folder("plan-torn-table");
    let list = folder.join("targets.csv").display().to_string();
    std::fs::write(&list, "x_m,y_m,z_m\n1,1,-1\n1,1,-1\n").expect("writes");
    let table = ["plan", "sweep", "--x=1,1.2,0.2", "--y=1,1,1", "--z=-1,-1,1", "--starts", "1"];
    let results = ["plan", "throw", "--fast", "--targets", &list];
    for (name, words) in [("reach.csv", &table[..]), ("results.csv", &results)] {
        let (path, earlier) = (folder.join(name), folder.join("earlier"));
        let out = path.display().to_string();
        let run = || cubectl(&[words, &["--form", "paper", "--out", &out]].concat());
        assert!(run().status.success());
        let whole = std::fs::read_to_string(&path).expect("reads");
        let torn = &whole[..whole.len() - 9];
        std::fs::write(&path, torn).expect("writes");
        std::fs::hard_link(&path, &earlier).expect("links");
        assert!(run().status.success());
        assert_eq!(std::fs::read_to_string(&path).expect("reads"), whole, "{name}");
        assert_eq!(std::fs::read_to_string(&earlier).expect("reads"), torn, "{name}");
        std::fs::remove_file(&earlier).expect("removes");
    }
}

#[test]
fn numbers_of_three_hundred_digits_are_refused_in_short_words() {
    let long = "9".repeat(300);
    for option in ["--jitter-s", "--time-budget", "--drag-per-m", "--speed-use", "--clearance-m"] {
        let ended = cubectl(&["plan", "throw", "--target=1,1,-1", option, &long]);
        assert_eq!(ended.status.code(), Some(i32::from(host::exit::BAD_INPUT)), "{option}");
        let told = text(&ended.stderr);
        assert!(told.contains("1.000e300") && told.len() < 200, "{option}: {told}");
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
