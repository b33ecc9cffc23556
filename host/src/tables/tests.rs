//! Lists of targets; the folder of a sweep: parts are whole or not there, and have the same bytes whoever makes them.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use super::folder::{Folder, Study};
use super::shard::Shard;
use super::summary::Summary;
use super::targets::{TargetList, TargetRow};
use crate::error::ExpectedError;

/// An empty folder of the test's own.
fn folder(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("cubectl-tables-{}", std::process::id())).join(name);
    let _ = fs::remove_dir_all(&path);
    path
}

fn study(seed: &str, targets: u64, shards: u32) -> Study {
    let words = BTreeMap::from([("seed".to_owned(), seed.to_owned()), ("robot".to_owned(), "r".to_owned())]);
    Study::new(words, targets, shards)
}

fn columns() -> Vec<String> {
    ["row", "outcome", "objective", "draws_landed", "draws_hit", "draws_miss_rms_m", "note"]
        .map(str::to_owned)
        .to_vec()
}

/// A row whose numbers follow from its own: each third one is refused.
fn row(number: u64) -> Vec<String> {
    let objective = (10 + number).to_string();
    let row = if number % 3 == 2 {
        [&number.to_string(), "refused", "", "", "", "", "no throw, obstacle #1"]
    } else {
        [&number.to_string(), "thrown", &objective, "10", "4", "0.01", ""]
    };
    row.map(str::to_owned).to_vec()
}

fn make(folder: &Folder, shard: Shard) {
    let made = folder.make(shard, &columns(), |rows| Ok::<_, ExpectedError>(Some(rows.map(row).collect())));
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
    let expected = ["part-00001-of-00002.csv", "part-00002-of-00002.csv", "study.json"];
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
    for (other, reported) in
        [(study("2", 4, 2), "seed: 1 there, 2 asked for"), (study("1", 4, 4), "shards: 2 there, 4 asked for")]
    {
        let refused = Folder::for_study(&path, other).expect_err("refused").to_string();
        assert!(refused.contains(reported) && refused.contains("next:"), "{refused}");
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
    // Both ends are there and something between them is not.
    let middle = whole.len() / 2;
    fs::write(folder.part(shard), [&whole[..middle - 9], &whole[middle..]].concat()).unwrap();
    assert!(!folder.has(shard).unwrap(), "a hole");
    make(&folder, shard);
    assert_eq!(fs::read(folder.part(shard)).unwrap(), whole);
}

#[test]
fn what_a_killed_process_left_is_removed_and_what_a_living_one_writes_stays() {
    let path = folder("left-behind");
    let folder = Folder::for_study(&path, study("1", 4, 2)).expect("opens");
    let (dead, alive, of_other) = (
        path.join(".part-00001-of-00002.csv.1.tmp"),
        path.join(".part-00001-of-00002.csv.2.tmp"),
        path.join(".part-00002-of-00002.csv.3.tmp"),
    );
    fs::write(&dead, "row,outcome").unwrap();
    fs::write(&of_other, "row,outcome").unwrap();
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
    // In the second batch.
    let stopped = folder.make(shard, &columns(), |rows| {
        Ok::<_, ExpectedError>((rows.start == 0).then(|| rows.map(row).collect()))
    });
    assert!(!stopped.expect("is no error"));
    let failed = folder.make(shard, &columns(), |_| Err(ExpectedError::bad_input("on purpose")));
    assert_eq!(failed.expect_err("fails").to_string(), "on purpose");
    assert_eq!(names(&path), ["study.json"]);
}

#[test]
fn a_folder_without_a_sweep_is_refused_with_what_makes_one() {
    let path = folder("no-sweep");
    fs::create_dir_all(&path).unwrap();
    for content in [None, Some(""), Some("{}"), Some("{\"targets\":\"1\",\"shards\":\"0\"}")] {
        if let Some(content) = content {
            fs::write(path.join("study.json"), content).unwrap();
        }
        let refused = Folder::open(&path).expect_err("refused").to_string();
        assert!(refused.contains("next:") && refused.contains("study.json"), "{content:?}: {refused}");
    }
}

#[test]
fn every_row_of_a_part_is_read_as_it_was_made() {
    let folder = Folder::for_study(&folder("read"), study("1", 6, 1)).expect("opens");
    let shard = Shard::new(1, 1).unwrap();
    make(&folder, shard);
    let mut rows: Vec<Vec<String>> = Vec::new();
    folder
        .read(shard, |column| rows.push(columns().iter().map(|name| column(name).to_owned()).collect()))
        .unwrap();
    assert_eq!(rows, (0..6).map(row).collect::<Vec<_>>());
}

fn list(name: &str, content: &str) -> PathBuf {
    let path = folder(&format!("list-{name}")).join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(&path, content).unwrap();
    path
}

fn rows(list: &TargetList, from: u64) -> Vec<TargetRow> {
    list.rows_from(from).expect("opens").collect::<Result<_, _>>().expect("reads")
}

#[test]
fn a_list_has_its_columns_in_any_order_and_is_read_from_any_row() {
    let path = list("targets.csv", "\u{feff}# a comment\n z_m, x_m,y_m\n3,1,2\n6,4,5\n");
    let all = [TargetRow::point([1.0, 2.0, 3.0]), TargetRow::point([4.0, 5.0, 6.0])];
    let list = TargetList::open(&path).expect("opens");
    assert_eq!((list.count(), rows(&list, 0)), (2, all.to_vec()));
    assert_eq!((rows(&list, 1), rows(&list, 2)), (all[1..].to_vec(), Vec::new()));
    let path = self::list(
        "moving.csv",
        "x_m,y_m,z_m,nx,ny,nz,radius_m,incidence_max_deg,vx_m_s,vy_m_s,vz_m_s\n1,2,3,0,0,1,0.5,30,7,8,9\n",
    );
    let expected = TargetRow {
        normal: Some([0.0, 0.0, 1.0]),
        radius_m: Some(0.5),
        incidence_max_deg: Some(30.0),
        velocity_m_s: Some([7.0, 8.0, 9.0]),
        ..TargetRow::point([1.0, 2.0, 3.0])
    };
    assert_eq!(rows(&TargetList::open(&path).expect("opens"), 0), [expected]);
}

#[test]
fn files_that_are_not_lists_are_refused_with_row_and_column() {
    for (name, content, reported) in [
        ("a.csv", "x_m,y_m\n1,2\n", "all or none are needed"),
        ("b.csv", "x_m,y_m,z_m,colour\n1,2,3,red\n", "\"colour\" is not known"),
        ("c.csv", "x_m,y_m,z_m\n1,2,-1\n1,nan,-1\n", "row 2, column \"y_m\""),
        ("d.csv", "x_m,y_m,z_m\n", "no target"),
        ("e.csv", "x_m,y_m,z_m,nx,ny,nz\n1,1,-1,0,0,1\n", "an opening needs"),
        ("f.csv", "x_m,y_m,z_m\n1,2,-1\n1,2\n", "fields"),
        ("g.parquet", "PAR1", "next: python3 -c \"import pandas; pandas.read_parquet("),
    ] {
        let refused = TargetList::open(&list(name, content)).expect_err(name).to_string();
        assert!(refused.contains(reported) && refused.contains(name), "{name}: {refused}");
    }
    assert!(
        TargetList::open(Path::new("/dev/zero")).expect_err("no file").to_string().contains("must be a file")
    );
}
