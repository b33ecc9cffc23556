//! `cubectl plan sweep` from outside: lists and grids, killed in mid-run, torn parts, with other threads, through the script for job
//! arrays.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use crate::page_data;
use crate::program::{cubectl, empty_folder as folder, text};

const PROGRAM: &str = env!("CARGO_BIN_EXE_cubectl");
/// About a millisecond for each target.
const FAST: [&str; 6] = ["--form", "paper", "--fast", "--starts", "2", "--y=0,0,1"];

fn sweep(words: &[&str]) -> Command {
    let mut command = Command::new(PROGRAM);
    command.args(["plan", "sweep"]).args(FAST).args(words);
    command
}

fn ran(mut command: Command) -> Output {
    command.output().expect("runs")
}

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).expect("lists");
    entries
        .map(|entry| {
            let entry = entry.expect("reads");
            let bytes = std::fs::read(entry.path()).expect("reads");
            (entry.file_name().to_string_lossy().into_owned(), bytes)
        })
        .collect()
}

fn parts(folder: &Path) -> usize {
    let there = |entry: &std::fs::DirEntry| {
        let name = entry.file_name();
        name.to_string_lossy().starts_with("part-")
    };
    std::fs::read_dir(folder).map_or(0, |entries| entries.flatten().filter(there).count())
}

#[test]
fn a_sweep_that_is_killed_in_mid_run_is_completed_with_the_same_bytes() {
    let folder = folder("shards-killed");
    let (whole, killed) = (folder.join("whole"), folder.join("killed"));
    let grid = ["--x=1.0,1.4,0.02", "--z=-1,-0.5,0.02", "--shards", "40", "--out"];
    let (whole_name, killed_name) = (whole.display().to_string(), killed.display().to_string());
    let all = |out: &str| sweep(&[&grid[..], &[out]].concat());
    let mut one_thread = all(&whole_name);
    one_thread.env("RAYON_NUM_THREADS", "1");
    assert!(ran(one_thread).status.success());

    let mut run = all(&killed_name).stdout(Stdio::null()).spawn().expect("starts");
    // In mid-run: two parts are there, most are not.
    while parts(&killed) < 2 {
        assert!(run.try_wait().expect("is asked").is_none(), "it ended before it was killed");
        std::thread::yield_now();
    }
    run.kill().expect("kills");
    run.wait().expect("ends");
    let left = parts(&killed);
    assert!(left < 40, "{left} parts");

    let ended = ran(all(&killed_name));
    assert!(ended.status.success(), "{}", text(&ended.stderr));
    let reported = text(&ended.stdout);
    assert!(reported.contains(&format!("{} shards made, {left} were there", 40 - left)), "{reported}");
    // Nothing else is left: no temporary file either.
    assert!(files(&whole) == files(&killed), "the bytes differ");
    assert_eq!(files(&whole).len(), 41);
}

#[test]
fn shards_made_apart_are_those_made_together_and_rows_are_plans() {
    let folder = folder("shards-apart");
    let (list, together, apart) = (folder.join("targets.csv"), folder.join("together"), folder.join("apart"));
    std::fs::write(&list, "x_m,y_m,z_m\n1,1,-1\n9,0,0\n1.4,-0.5,-0.5\n1,0,-0.5\n").expect("writes");
    let list = list.display().to_string();
    let words = |shards: &str, out: &Path| {
        ran(sweep(&["--targets", &list, "--draws", "20", shards, "--out", &out.display().to_string()]))
    };
    // `--y` is for grids.
    let refused = words("--shards=3", &together);
    assert_eq!(refused.status.code(), Some(i32::from(host::exit::USAGE)));
    let words = |shards: &str, out: &Path| {
        let mut command = Command::new(PROGRAM);
        command.args(["plan", "sweep", "--form", "paper", "--fast", "--starts", "2", "--targets", &list]);
        ran({
            command.args(["--draws", "20", shards, "--out", &out.display().to_string()]);
            command
        })
    };
    assert!(words("--shards=3", &together).status.success());
    for shard in ["--shard=3/3", "--shard=1/3", "--shard=2/3"] {
        assert!(words(shard, &apart).status.success(), "{shard}");
    }
    assert!(files(&together) == files(&apart), "the bytes differ");

    let summary = Command::new(PROGRAM)
        .args(["plan", "sweep", "--json", "--summary", &apart.display().to_string()])
        .output()
        .expect("runs");
    let reported: serde_json::Value = serde_json::from_slice(&summary.stdout).expect("is JSON");
    assert_eq!(
        (&reported["thrown"], &reported["refused"], &reported["draws_landed"]),
        (&3.into(), &1.into(), &60.into())
    );

    // Another number of shards is another sweep, and changes nothing.
    let refused = words("--shards=4", &apart);
    assert_eq!(refused.status.code(), Some(i32::from(host::exit::BAD_INPUT)));
    let reported = text(&refused.stderr);
    assert!(reported.contains("shards: 3 there, 4 asked for") && reported.contains("next:"), "{reported}");
    assert!(files(&together) == files(&apart), "the bytes differ");
}

#[test]
fn what_would_differ_between_machines_is_refused_before_anything_is_written() {
    let folder = folder("shards-refused");
    let out = folder.join("out");
    let grid = ["--x=1,1,1", "--z=-1,-1,1", "--shard", "1/2", "--out"];
    let out_name = out.display().to_string();
    for (words, reported) in [
        (["--time-budget-s", "1"], "--time-budget-s does not go with a sweep"),
        (["--draws", "1000001"], "at most 1000000 per target"),
        (["--objective", "hit"], "needs to know what a hit is"),
    ] {
        let ended = ran(sweep(&[&grid[..], &[&out_name], &words].concat()));
        assert_eq!(ended.status.code(), Some(i32::from(host::exit::BAD_INPUT)), "{words:?}");
        assert!(text(&ended.stderr).contains(reported), "{words:?}: {}", text(&ended.stderr));
        assert!(!out.exists(), "{words:?}");
    }
    for shard in ["0/2", "3/2", "2"] {
        let ended = ran(sweep(&["--x=1,1,1", "--z=-1,-1,1", "--shard", shard, "--out", &out_name]));
        assert_eq!(ended.status.code(), Some(i32::from(host::exit::USAGE)), "{shard}");
    }
}

#[test]
fn the_script_for_job_arrays_makes_the_shards_of_its_tasks() {
    let folder = folder("shards-array");
    let (array, together) = (folder.join("array"), folder.join("together"));
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/cluster/sweep.sbatch");
    let words = ["--form", "paper", "--fast", "--starts", "2", "--x=1.0,1.4,0.1", "--z=-1,-0.5,0.25"];
    let program = Path::new(PROGRAM).parent().expect("a folder").display().to_string();
    let path = format!("{program}:{}", std::env::var("PATH").unwrap_or_default());
    let task = |number: &str, environment: &[(&str, &str)]| {
        let mut command = Command::new("bash");
        command.arg(&script).arg(&array).args(words).env("PATH", &path).env("SLURM_ARRAY_TASK_ID", number);
        ran({
            command.envs(environment.iter().copied());
            command
        })
    };
    let of_three =
        [("SLURM_ARRAY_TASK_COUNT", "3"), ("SLURM_ARRAY_TASK_MAX", "3"), ("SLURM_ARRAY_TASK_MIN", "1")];
    for number in ["2", "3", "1"] {
        let ended = task(number, &of_three);
        assert!(ended.status.success(), "{}", text(&ended.stderr));
    }
    let out = together.display().to_string();
    let mut command = Command::new(PROGRAM);
    command.args(["plan", "sweep"]).args(words).args(["--shards", "3", "--out", &out]);
    assert!(ran(command).status.success());
    assert!(files(&array) == files(&together), "the bytes differ");
    // A job array that begins at 0 would leave out the last shard.
    let from_zero = task(
        "0",
        &[("SLURM_ARRAY_TASK_COUNT", "3"), ("SLURM_ARRAY_TASK_MAX", "2"), ("SLURM_ARRAY_TASK_MIN", "0")],
    );
    assert!(!from_zero.status.success());
    assert!(text(&from_zero.stderr).contains("--array=1-"), "{}", text(&from_zero.stderr));
    // Missing tasks are made later by an array of those alone, which names the number of shards.
    let alone = task(
        "2",
        &[
            ("SHARDS", "3"),
            ("SLURM_ARRAY_TASK_COUNT", "1"),
            ("SLURM_ARRAY_TASK_MIN", "2"),
            ("SLURM_ARRAY_TASK_MAX", "2"),
        ],
    );
    assert!(text(&alone.stdout).contains("0 shards made, 1 were there"), "{}", text(&alone.stdout));
}

fn part(out: &Path) -> String {
    std::fs::read_to_string(out.join("part-00001-of-00001.csv")).expect("reads")
}

#[test]
fn a_list_has_a_row_for_each_target_in_order_and_a_torn_part_is_made_again() {
    let folder = folder("sweep-list");
    let (list, out, earlier) = (folder.join("targets.csv"), folder.join("out"), folder.join("earlier"));
    // The second is out of reach, the third below the floor, the first stands twice.
    std::fs::write(&list, "z_m,x_m,y_m\n-1.0,1.0,1.0\n0,9,0\n-3,1,1\n-1.0,1.0,1.0\n").expect("writes");
    let (list_name, out_name) = (list.display().to_string(), out.display().to_string());
    let run = || {
        let words = ["--form", "paper", "--fast", "--starts", "2", "--targets", &list_name];
        cubectl(&[&["plan", "sweep"], &words[..], &["--out", &out_name]].concat())
    };
    let made = run();
    assert!(made.status.success(), "{}", text(&made.stderr));
    let whole = part(&out);
    let rows: Vec<&str> = whole.lines().collect();
    assert!(
        rows[0].starts_with("# {") && rows[1].starts_with("row,x_m,y_m,z_m,outcome,objective"),
        "{whole}"
    );
    assert!(rows[2].starts_with("0,1,1,-1,thrown,31.26"), "{}", rows[2]);
    assert!(rows[3].starts_with("1,9,0,0,refused,,") && rows[3].contains("no throw reaches"), "{}", rows[3]);
    assert!(rows[4].starts_with("2,1,1,-3,refused,,") && rows[4].contains("below the floor"), "{}", rows[4]);
    assert_eq!(rows[2].strip_prefix('0'), rows[5].strip_prefix('3'));
    assert!(rows[6].starts_with("# end: 4 rows,") && rows.len() == 7, "{whole}");

    // The witness is a second name of the earlier file: it is replaced and not truncated, so a full disk or a kill loses nothing.
    let (path, torn) = (out.join("part-00001-of-00001.csv"), &whole[..whole.len() - 9]);
    std::fs::write(&path, torn).expect("writes");
    std::fs::hard_link(&path, &earlier).expect("links");
    let again = run();
    assert!(text(&again.stdout).contains("1 shards made, 0 were there"), "{}", text(&again.stdout));
    assert_eq!(
        (part(&out), std::fs::read_to_string(&earlier).expect("reads")),
        (whole.clone(), torn.to_owned())
    );
    assert!(text(&run().stdout).contains("0 shards made, 1 were there"));

    // Nothing else continues it.
    std::fs::write(&list, "x_m,y_m,z_m\n1.5,0,-0.5\n").expect("writes");
    let refused = run();
    assert_eq!(refused.status.code(), Some(i32::from(host::exit::BAD_INPUT)));
    let reported = text(&refused.stderr);
    assert!(reported.contains("target list: ") && reported.contains("next:"), "{reported}");
    assert_eq!(part(&out), whole);
}

#[test]
fn a_sweep_is_continued_only_with_what_made_it() {
    let out = folder("sweep-continued").join("out");
    let out_name = out.display().to_string();
    let run = |more: &[&str]| {
        let words = ["plan", "sweep", "--x=1,1,1", "--y=1,1,1", "--z=-1,-1,1", "--starts", "1", "--out"];
        cubectl(&[&words[..], &[&out_name], more].concat())
    };
    assert!(run(&["--form", "paper"]).status.success());
    let first = files(&out);
    for (more, differs) in [
        (&["--form", "paper", "--robot", "pincher4"][..], "robot: powercube6"),
        (&["--form", "paper", "--seed", "2"], "seed: 1 there, 2 asked for"),
        (&["--form", "paper", "--obstacle", "2,2,2,0.1,0.1,0.1"], "options: "),
        (&["--form", "paper", "--objective", "energy"], "options: "),
        (&["--form", "best"], "options: "),
    ] {
        let refused = run(more);
        assert_eq!(refused.status.code(), Some(i32::from(host::exit::BAD_INPUT)), "{more:?}");
        let reported = text(&refused.stderr);
        assert!(reported.contains(differs) && reported.contains("next:"), "{more:?}: {reported}");
        assert!(files(&out) == first, "{more:?}");
    }
    assert!(run(&["--form", "paper"]).status.success(), "the same words go on");
}

#[test]
fn a_sweep_tells_relaxed_throws_from_others_and_draws_its_reach() {
    let folder = folder("sweep-reach");
    let (out, picture) = (folder.join("out"), folder.join("reach.html"));
    let (out_name, picture_name) = (out.display().to_string(), picture.display().to_string());
    let grid = ["--x=1,5,2", "--y=0.5,0.5,1", "--z=-1,-1,1", "--starts", "8", "--out", &out_name];
    let made = cubectl(&[&["plan", "sweep"], &grid[..]].concat());
    assert!(made.status.success(), "{}", text(&made.stderr));
    let rows = part(&out);
    let begin: Vec<String> =
        rows.lines().skip(1).map(|row| row.split(',').take(5).collect::<Vec<_>>().join(",")).collect();
    assert_eq!(
        begin[..4],
        ["row,x_m,y_m,z_m,outcome", "0,1,0.5,-1,thrown", "1,3,0.5,-1,relaxed", "2,5,0.5,-1,refused"]
    );
    let summary = cubectl(&["plan", "sweep", "--summary", &out_name, "--picture", &picture_name]);
    let reported = text(&summary.stdout);
    assert!(
        reported.contains("1 throws with all that was asked for, 1 without some of it, 1 refused"),
        "{reported}"
    );
    let page = page_data::of(&std::fs::read_to_string(&picture).expect("reads"));
    let shown: Vec<_> = page_data::all(&page, "cells")[0].as_array().unwrap().iter().collect();
    // What is out of reach first, then from the dearest to the cheapest.
    let prices: Vec<Option<f64>> = shown.iter().map(|cell| cell["value"].as_f64()).collect();
    assert_eq!(
        (prices.len(), prices[0], &shown[0]["target"]),
        (3, None, &serde_json::json!([5.0, 0.5, -1.0]))
    );
    assert!(prices[1] >= prices[2] && prices[2] > Some(0.0), "{prices:?}");
    assert!(page["title"].as_str().unwrap().starts_with("Reach of powercube6 "), "{}", page["title"]);
    assert_eq!(page["answer"]["verdict"], "2 of 3 targets have a throw");
}
