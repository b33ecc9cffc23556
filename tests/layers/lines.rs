//! Lines of Rust per package, as `docs/walk-through.md` tells them.

use std::collections::BTreeMap;

use crate::rooms::Tree;
use crate::{root, sources};

/// Folders of packages with several packages inside; a file belongs to the innermost.
const FOLDERS: [&str; 16] = [
    "firmware",
    "hil-sim/console",
    "hil-sim",
    "host/operator",
    "host/planner",
    "host/python",
    "host/tables",
    "host/tuner",
    "host",
    "protocol/link",
    "protocol/rsi",
    "protocol/tracker",
    "protocol",
    "robots/model",
    "robots/reader",
    "tests",
];
/// A number of the page may be off by this share of itself, and by this many lines.
const OFF_SHARE: f64 = 0.05;
const OFF_LINES: f64 = 150.0;

/// Lines of source and of tests.
type Count = (usize, usize);

/// Tests are what lies in `tests`, `benches`, `examples` and `fuzz`, and modules that hold tests only.
fn is_test(file: &str) -> bool {
    let (folder, name) = file.rsplit_once('/').unwrap_or(("", file));
    folder
        .split('/')
        .any(|part| matches!(part, "tests" | "benches" | "examples" | "fuzz" | "suites" | "layers"))
        || name == "tests.rs"
        || name.ends_with("_tests.rs")
}

fn counted(files: &Tree) -> BTreeMap<&'static str, Count> {
    let mut counts: BTreeMap<&'static str, Count> = FOLDERS.iter().map(|folder| (*folder, (0, 0))).collect();
    for (file, text) in files {
        let inside = |folder: &&&str| file.strip_prefix(**folder).is_some_and(|rest| rest.starts_with('/'));
        let Some(folder) = FOLDERS.iter().filter(inside).max_by_key(|folder| folder.len()) else { continue };
        let rest = &file[folder.len() + 1..];
        if rest.split('/').any(|part| part == "target") {
            continue;
        }
        let count = counts.get_mut(folder).unwrap();
        *(if is_test(rest) { &mut count.1 } else { &mut count.0 }) += text.lines().count();
    }
    counts
}

/// Source and tests of a row `| name | before | now | before | now |`.
fn told(page: &str, name: &str) -> Option<Count> {
    let row = page.lines().find(|line| line.starts_with(&format!("| `{name}` |")))?;
    let cells: Vec<&str> = row.split('|').map(str::trim).collect();
    let number = |cell: &str| cell.parse().unwrap_or(0);
    Some((number(cells.get(3)?), number(cells.get(5)?)))
}

fn is_near(told: usize, counted: usize) -> bool {
    (told as f64 - counted as f64).abs() <= OFF_SHARE * counted as f64 + OFF_LINES
}

fn wrong_rows(page: &str, counts: &BTreeMap<&'static str, Count>) -> Vec<String> {
    let wrong = |(name, count): (&&str, &Count)| {
        let fits = told(page, name).is_some_and(|told| is_near(told.0, count.0) && is_near(told.1, count.1));
        (!fits).then(|| format!("| `{name}` | … | {} | … | {} |", count.0, count.1))
    };
    counts.iter().filter_map(wrong).collect()
}

fn repository() -> Tree {
    let mut files = Tree::new();
    for top in ["firmware", "hil-sim", "host", "protocol", "robots", "tests"] {
        files.extend(
            sources(&root().join(top)).into_iter().map(|(file, text)| (format!("{top}/{file}"), text)),
        );
    }
    files
}

#[test]
fn the_walk_through_tells_the_lines_of_every_package() {
    let page = std::fs::read_to_string(root().join("docs/walk-through.md")).unwrap();
    let counts = counted(&repository());
    assert!(counts.values().map(|count| count.0).sum::<usize>() > 50_000, "the scan found {counts:?}");
    let wrong = wrong_rows(&page, &counts);
    assert!(
        wrong.is_empty(),
        "docs/walk-through.md must tell, with the columns of before as they are:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn a_row_that_is_missing_or_far_off_is_found_and_tests_are_counted_apart() {
    let lines = |n: usize| "x\n".repeat(n);
    let files = Tree::from([
        ("host/src/lib.rs".to_owned(), lines(3000)),
        ("host/src/a_tests.rs".to_owned(), lines(500)),
        ("host/planner/src/lib.rs".to_owned(), lines(1000)),
        ("host/planner/target/x.rs".to_owned(), lines(9000)),
    ]);
    let mut counts = counted(&files);
    counts.retain(|_, count| *count != (0, 0));
    assert_eq!(counts, BTreeMap::from([("host", (3000, 500)), ("host/planner", (1000, 0))]));
    let page = "| `host` | - | 3100 | 7 | 450 |\n| `host/planner` | - | 1500 | - | 0 |\n";
    assert_eq!(wrong_rows(page, &counts), ["| `host/planner` | … | 1000 | … | 0 |"]);
    assert_eq!(wrong_rows("", &counts).len(), 2);
}
