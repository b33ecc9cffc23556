//! `docs/trust.md` names tests that exist, and the kinds of faults that are tried.

use std::collections::BTreeMap;
use std::path::Path;

use cell_tests::page;
use lab::trust::Bench;
use lab::trust::matrix::entries;
use protocol::Instant;

#[test]
fn the_page_lists_every_kind_of_the_matrix_with_its_number_of_runs() {
    let mut runs: BTreeMap<String, usize> = BTreeMap::new();
    for entry in entries(&Bench::new().unwrap(), |_| Some(Instant::ZERO)) {
        *runs.entry(entry.variant.to_owned()).or_default() += 1;
    }
    runs.insert("all".to_owned(), runs.values().sum());
    let reported: BTreeMap<String, usize> = page::table("The matrix")
        .into_iter()
        .map(|row| (row[0].clone(), row[1].parse().unwrap_or_else(|_| panic!("no number of runs: {row:?}"))))
        .collect();
    assert_eq!(reported, runs);
}

#[test]
fn every_test_that_the_page_names_exists_in_its_file() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let mut names = 0;
    for row in page::table("What was found") {
        let (what, tests) = (&row[0], row.last().unwrap());
        let mut file: Option<(String, String)> = None;
        let words: Vec<&str> = tests.split('`').skip(1).step_by(2).collect();
        assert!(words.len() >= 2, "{what}: no file and test");
        for word in words {
            if word.contains('/') {
                let text = std::fs::read_to_string(root.join(word)).unwrap_or_else(|e| panic!("{word}: {e}"));
                file = Some((word.to_owned(), text));
                continue;
            }
            let (path, text) = file.as_ref().unwrap_or_else(|| panic!("{what}: a test before its file"));
            assert!(text.contains(&format!("fn {word}(")), "{path} has no {word}");
            names += 1;
        }
    }
    assert!(names >= 13, "{names} tests named");
}
