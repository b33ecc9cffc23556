//! `cubectl plan sweep` in shards, from outside: killed in mid-run, with other threads, through the script for job arrays.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use crate::program::{empty_folder as folder, text};

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

/// All files of a folder.
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
    let told = text(&ended.stdout);
    assert!(told.contains(&format!("{} shards made, {left} were there", 40 - left)), "{told}");
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
    let told: serde_json::Value = serde_json::from_slice(&summary.stdout).expect("is JSON");
    assert_eq!(
        (&told["thrown"], &told["refused"], &told["draws_landed"]),
        (&3.into(), &1.into(), &60.into())
    );

    // Another number of shards is another sweep, and changes nothing.
    let refused = words("--shards=4", &apart);
    assert_eq!(refused.status.code(), Some(i32::from(host::exit::BAD_INPUT)));
    let told = text(&refused.stderr);
    assert!(told.contains("shards: 3 there, 4 asked for") && told.contains("next:"), "{told}");
    assert!(files(&together) == files(&apart), "the bytes differ");
}

#[test]
fn what_would_differ_between_machines_is_refused_before_anything_is_written() {
    let folder = folder("shards-refused");
    let out = folder.join("out");
    let grid = ["--x=1,1,1", "--z=-1,-1,1", "--shard", "1/2", "--out"];
    let out_name = out.display().to_string();
    for (words, told) in [
        (["--time-budget", "1"], "--time-budget does not go with --shard"),
        (["--store", "s"], "--store does not go with --shard"),
        (["--draws", "1000001"], "at most 1000000 per target"),
        (["--objective", "hit"], "needs to know what a hit is"),
    ] {
        let ended = ran(sweep(&[&grid[..], &[&out_name], &words].concat()));
        assert_eq!(ended.status.code(), Some(i32::from(host::exit::BAD_INPUT)), "{words:?}");
        assert!(text(&ended.stderr).contains(told), "{words:?}: {}", text(&ended.stderr));
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
