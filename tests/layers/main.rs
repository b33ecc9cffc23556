//! Arrows between packages go down only, the controller names no family of drives, and every file of tests runs.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Floors of packages, from the bottom to the top. A package uses packages of lower floors only.
const PACKAGES: &[&[&str]] = &[
    &["protocol", "toml-reader", "cell-console"],
    &["can-link", "rsi-protocol", "tracker-protocol"],
    &["robot-model"],
    &["firmware", "hil-sim"],
    &["board-example", "drives", "planner", "sequences", "tuner"],
    &["operator"],
    &["host"],
    &["lab"],
    &["cell-tests", "cubecell-python", "layers"],
];

/// Words that name a drive family or its packets. The code of the controller must not use them; its comments may.
const FAMILY_WORDS: [&str; 4] = ["groups", "Frame", "PowerCubes", "embedded_can"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap().to_owned()
}

fn floor_of(floors: &[&[&str]], name: &str) -> Option<usize> {
    floors.iter().position(|floor| floor.contains(&name))
}

/// Package names and the workspace packages each one depends on, development and build included.
fn packages() -> BTreeMap<String, Vec<String>> {
    let cargo = std::process::Command::new(env!("CARGO"))
        .args(["tree", "--workspace", "--locked", "--offline", "--depth", "1", "--prefix", "depth"])
        .args(["--format", " {p}", "--edges", "normal,build,dev", "--no-dedupe", "--all-features"])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(cargo.status.success(), "{}", String::from_utf8_lossy(&cargo.stderr));
    let text = String::from_utf8(cargo.stdout).unwrap();
    let here = root().to_str().unwrap().to_owned();
    let mut found: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let mut user = String::new();
    for line in text.lines().filter(|line| line.contains(&here)) {
        let (depth, package) = line.split_once(' ').unwrap();
        let name = package.split(' ').next().unwrap().to_owned();
        if depth == "0" {
            user.clone_from(&name);
            found.entry(name).or_default();
        } else {
            found.get_mut(&user).unwrap().push(name);
        }
    }
    found
}

fn wrong_packages(packages: &BTreeMap<String, Vec<String>>, floors: &[&[&str]]) -> Vec<String> {
    let mut wrong = Vec::new();
    for (user, used) in packages {
        let Some(floor) = floor_of(floors, user) else {
            wrong.push(format!("package {user} is on no floor of tests/layers/main.rs"));
            continue;
        };
        let above = used.iter().filter(|used| floor_of(floors, used).is_none_or(|below| below >= floor));
        wrong.extend(above.map(|used| format!("package {user} must not use package {used}")));
    }
    wrong
}

#[test]
fn packages_use_lower_floors_only() {
    let packages = packages();
    let arrows: usize = packages.values().map(Vec::len).sum();
    assert!(packages.len() >= 14 && arrows >= 40, "found {} packages, {arrows} arrows", packages.len());
    let wrong = wrong_packages(&packages, PACKAGES);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_package_that_uses_a_higher_one_or_has_no_floor_is_found() {
    let packages = BTreeMap::from([
        ("low".to_owned(), vec!["high".to_owned()]),
        ("high".to_owned(), vec!["low".to_owned()]),
        ("new".to_owned(), Vec::new()),
    ]);
    let wrong = wrong_packages(&packages, &[&["low"], &["high"]]);
    assert_eq!(
        wrong,
        ["package low must not use package high", "package new is on no floor of tests/layers/main.rs"]
    );
}

/// The floors as `docs/walk-through.md` lists them, the highest first.
fn listed(floors: &[&[&str]]) -> String {
    let line = |(number, names): (usize, &&[&str])| {
        let mut names = names.to_vec();
        names.sort_unstable();
        format!(" {}  {}\n", number + 1, names.join("  "))
    };
    floors.iter().enumerate().rev().map(line).collect()
}

#[test]
fn the_walk_through_lists_the_floors() {
    let page = std::fs::read_to_string(root().join("docs/walk-through.md")).unwrap();
    let wanted = listed(PACKAGES);
    assert!(page.contains(&wanted), "docs/walk-through.md must list\n{wanted}");
}

fn family_words(text: &str) -> Vec<&'static str> {
    let code = text.lines().filter_map(|line| line.split("//").next());
    let words: BTreeSet<&str> =
        code.flat_map(|line| line.split(|letter: char| !letter.is_alphanumeric() && letter != '_')).collect();
    FAMILY_WORDS.into_iter().filter(|word| words.contains(word)).collect()
}

#[test]
fn the_controller_names_no_frame_and_no_family_of_drives() {
    let mut files = 0;
    for entry in std::fs::read_dir(root().join("firmware/src/controller")).unwrap() {
        let path = entry.unwrap().path();
        let found = family_words(&std::fs::read_to_string(&path).unwrap());
        assert!(found.is_empty(), "{} names {found:?}", path.display());
        files += 1;
    }
    assert!(files >= 8, "{files} files");
}

#[test]
fn code_that_names_a_family_is_found_and_a_comment_is_not() {
    assert_eq!(family_words("//! Frame\nuse protocol::{Frame, Instant};"), ["Frame"]);
    assert_eq!(family_words("type G = crate::groups::powercube::PowerCubes;"), ["groups", "PowerCubes"]);
    assert!(family_words("struct FreezeFrame; // groups, PowerCubes").is_empty());
}

/// Test files that `tests/main.rs` does not declare as modules. Cargo would never run them.
fn left_out(names: &[String], main: &str) -> Vec<String> {
    let modules: BTreeSet<&str> =
        main.lines().filter_map(|line| line.strip_prefix("mod ")?.strip_suffix(';')).collect();
    let stems = names.iter().map(|name| name.trim_end_matches(".rs"));
    stems.filter(|stem| *stem != "main" && !modules.contains(stem)).map(str::to_owned).collect()
}

#[test]
fn every_file_of_tests_is_a_module_of_its_packages_test_program() {
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let members = manifest.split_once("members = [").unwrap().1.split_once(']').unwrap().0;
    let mut programs = 0;
    for package in members.split('"').skip(1).step_by(2).map(|member| root().join(member)) {
        let own = std::fs::read_to_string(package.join("Cargo.toml")).unwrap();
        let folder = package.join("tests");
        let Ok(main) = std::fs::read_to_string(folder.join("main.rs")) else { continue };
        if !own.contains("autotests = false") {
            continue;
        }
        let names: Vec<String> = std::fs::read_dir(&folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|end| end == "rs") || path.join("mod.rs").exists())
            .map(|path| path.file_name().unwrap().to_str().unwrap().to_owned())
            .collect();
        let missing = left_out(&names, &main);
        assert!(missing.is_empty(), "{}/main.rs does not name {}", folder.display(), missing.join(", "));
        programs += 1;
    }
    assert!(programs >= 10, "{programs} packages with one test program");
}

#[test]
fn a_file_of_tests_that_is_in_no_program_is_found() {
    let names = ["main.rs", "a.rs", "rig", "b.rs"].map(str::to_owned);
    assert_eq!(left_out(&names, "mod a;\nmod rig;\n// mod b;\n"), ["b"]);
}
