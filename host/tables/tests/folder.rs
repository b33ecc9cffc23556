//! The folder of a sweep: parts are whole or not there, and have the same bytes whoever makes them.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use throw_tables::{Folder, Landings, Outcome, Row, Shard, Study, Summary, TableError, Thrown};

/// An empty folder of the test's own.
fn folder(name: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&path);
    path
}

fn study(seed: &str, targets: u64, shards: u32) -> Study {
    let words = BTreeMap::from([("seed".to_owned(), seed.to_owned()), ("robot".to_owned(), "r".to_owned())]);
    Study::new(words, targets, shards, 2)
}

/// A row whose numbers follow from its own: each third one is refused.
fn row(number: u64) -> Row {
    let v = number as f64;
    let target_m = [v, 0.1 * v, -0.25];
    if number % 3 == 2 {
        let note = format!("no throw reaches {v}");
        return Row { number, target_m, outcome: Outcome::Refused, note, throw: None };
    }
    let landings = Landings { landed: 10, hits: Some(4), miss_rms_m: Some(0.01), miss_max_m: Some(0.02) };
    let throw = Thrown {
        objective: 10.0 + v,
        release_s: 0.5,
        duration_s: 0.75,
        flight_s: 0.3 + v,
        spread_m: 0.01,
        hit_probability: None,
        position_m: [v, 1.0, 2.0],
        velocity_m_s: [3.0, 0.0, 4.0],
        q_rad: vec![0.1, 0.2],
        qd_rad_s: vec![1.1, 1.2],
        qdd_rad_s2: vec![2.1, 2.2],
        plan_crc32: u32::MAX,
        landings: Some(landings),
    };
    Row { number, target_m, outcome: Outcome::Thrown, note: String::new(), throw: Some(throw) }
}

fn make(folder: &Folder, shard: Shard) {
    let made = folder.make(shard, |rows| Ok::<_, TableError>(Some(rows.map(row).collect())));
    assert!(made.expect("makes"));
}

fn names(path: &Path) -> Vec<String> {
    let entries = fs::read_dir(path).expect("lists");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("reads").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn parts_have_the_same_bytes_in_any_order_and_nothing_else_is_left() {
    let (there, other) = (folder("same-there"), folder("same-other"));
    let first = Folder::for_study(&there, study("1", 20_000, 2)).expect("opens");
    let second = Folder::for_study(&other, study("1", 20_000, 2)).expect("opens");
    Shard::all(2).for_each(|shard| make(&first, shard));
    Shard::all(2).collect::<Vec<_>>().into_iter().rev().for_each(|shard| make(&second, shard));
    // Made again over itself.
    make(&second, Shard::new(1, 2).unwrap());
    let expected = ["part-00001-of-00002.parquet", "part-00002-of-00002.parquet", "study.json"];
    assert_eq!(names(&there), expected);
    assert_eq!(names(&other), expected);
    for name in expected {
        assert_eq!(fs::read(there.join(name)).unwrap(), fs::read(other.join(name)).unwrap(), "{name}");
    }
    assert_eq!(Summary::of(&first).unwrap(), Summary::of(&second).unwrap());
}

#[test]
fn a_summary_counts_what_is_there_and_names_what_is_not() {
    let folder = Folder::for_study(&folder("summary"), study("1", 9, 3)).expect("opens");
    make(&folder, Shard::new(1, 3).unwrap());
    make(&folder, Shard::new(3, 3).unwrap());
    let summary = Summary::of(&folder).expect("reads");
    assert_eq!((summary.targets, summary.shards, &summary.missing[..]), (9, 3, &[2][..]));
    // Rows 0, 1, 2 and 6, 7, 8.
    assert_eq!((summary.thrown, summary.relaxed, summary.refused), (4, 0, 2));
    assert_eq!(summary.objective, Some([10.0, 13.5, 17.0]));
    assert_eq!((summary.landed, summary.hits), (Some(40), Some(16)));
    assert!((summary.miss_rms_m.unwrap() - 0.01).abs() < 1e-12);
}

#[test]
fn another_sweep_is_refused_with_what_differs_and_changes_nothing() {
    let path = folder("other-sweep");
    let ours = Folder::for_study(&path, study("1", 4, 2)).expect("opens");
    make(&ours, Shard::new(1, 2).unwrap());
    let before = names(&path);
    for (other, told) in
        [(study("2", 4, 2), "seed: 1 there, 2 asked for"), (study("1", 4, 4), "shards: 2 there, 4 asked for")]
    {
        let refused = Folder::for_study(&path, other).expect_err("refused").to_string();
        assert!(refused.contains(told) && refused.contains("next:"), "{refused}");
    }
    // A part that was copied in from another sweep.
    let from = folder("other-sweep-from");
    let theirs = Folder::for_study(&from, study("7", 4, 2)).expect("opens");
    let second = Shard::new(2, 2).unwrap();
    make(&theirs, second);
    fs::copy(theirs.part(second), ours.part(second)).expect("copies");
    let refused = ours.has(second).expect_err("refused").to_string();
    assert!(refused.contains("seed: 7 there, 1 asked for"), "{refused}");
    assert!(Summary::of(&ours).is_err());
    fs::remove_file(ours.part(second)).expect("removes");
    assert_eq!(names(&path), before);
}

#[test]
fn a_cut_part_is_not_there_and_is_made_again() {
    let folder = Folder::for_study(&folder("cut"), study("1", 100, 1)).expect("opens");
    let shard = Shard::new(1, 1).unwrap();
    assert!(!folder.has(shard).unwrap());
    make(&folder, shard);
    assert!(folder.has(shard).unwrap());
    let whole = fs::read(folder.part(shard)).unwrap();
    for length in [0, 3, whole.len() / 2, whole.len() - 1] {
        fs::write(folder.part(shard), &whole[..length]).unwrap();
        assert!(!folder.has(shard).unwrap(), "{length} bytes");
    }
    make(&folder, shard);
    assert_eq!(fs::read(folder.part(shard)).unwrap(), whole);
}

#[test]
fn what_a_killed_process_left_is_removed_and_what_a_living_one_writes_stays() {
    let path = folder("left-behind");
    let folder = Folder::for_study(&path, study("1", 4, 2)).expect("opens");
    let (dead, alive, of_other) = (
        path.join(".part-00001-of-00002.parquet.1.tmp"),
        path.join(".part-00001-of-00002.parquet.2.tmp"),
        path.join(".part-00002-of-00002.parquet.3.tmp"),
    );
    fs::write(&dead, "PAR1 torn").unwrap();
    fs::write(&of_other, "PAR1 torn").unwrap();
    let held = File::create(&alive).unwrap();
    held.try_lock().expect("locks");
    make(&folder, Shard::new(1, 2).unwrap());
    assert!(!dead.exists() && alive.exists() && of_other.exists(), "{:?}", names(&path));
}

#[test]
fn a_shard_that_is_stopped_or_fails_leaves_no_file() {
    let path = folder("stopped");
    let folder = Folder::for_study(&path, study("1", 20_000, 1)).expect("opens");
    let shard = Shard::new(1, 1).unwrap();
    // In the second row group.
    let stopped =
        folder.make(shard, |rows| Ok::<_, TableError>((rows.start == 0).then(|| rows.map(row).collect())));
    assert!(!stopped.expect("is no error"));
    let failed = folder.make(shard, |_| Err(TableError::Refused("on purpose".to_owned())));
    assert_eq!(failed.expect_err("fails").to_string(), "on purpose");
    assert_eq!(names(&path), ["study.json"]);
}

#[test]
fn a_folder_without_a_sweep_is_refused_with_what_makes_one() {
    let path = folder("no-sweep");
    fs::create_dir_all(&path).unwrap();
    for content in [None, Some(""), Some("{}"), Some("{\"targets\":\"1\",\"shards\":\"0\",\"joints\":\"6\"}")]
    {
        if let Some(content) = content {
            fs::write(path.join("study.json"), content).unwrap();
        }
        let refused = Folder::open(&path).expect_err("refused").to_string();
        assert!(refused.contains("next:") && refused.contains("study.json"), "{content:?}: {refused}");
    }
}
