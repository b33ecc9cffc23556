//! Arrows between packages and rooms go down only: the order is data in `order.rs`. Lines per package are those that
//! `docs/walk-through.md` tells.

mod lines;
mod order;
mod paths;
mod rooms;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use order::{FOLDERS, PACKAGES};
use rooms::{Package, Tree, wrong_arrows};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap().to_owned()
}

/// Floor of a name.
fn floor_of(floors: &[&[&str]], name: &str) -> Option<usize> {
    floors.iter().position(|floor| floor.contains(&name))
}

/// Rust sources under a folder: path from the folder → text.
fn sources(folder: &Path) -> Tree {
    fn walk(root: &Path, folder: &Path, found: &mut Tree) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
                walk(root, &path, found);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let name = path.strip_prefix(root).unwrap().to_str().unwrap().to_owned();
                found.insert(name, std::fs::read_to_string(&path).unwrap());
            }
        }
    }
    let mut found = Tree::new();
    walk(folder, folder, &mut found);
    found
}

/// Package names and the workspace packages each one depends on, development and build included.
fn packages() -> BTreeMap<String, Vec<String>> {
    let cargo = std::process::Command::new(env!("CARGO"))
        .args([
            "tree",
            "--workspace",
            "--locked",
            "--offline",
            "--depth",
            "1",
            "--prefix",
            "depth",
            "--format",
            " {p}",
        ])
        .args(["--edges", "normal,build,dev", "--no-dedupe", "--all-features"])
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
        match depth {
            "0" => {
                user.clone_from(&name);
                found.entry(name).or_default();
            }
            _ => found.get_mut(&user).unwrap().push(name),
        }
    }
    found
}

fn wrong_packages(packages: &BTreeMap<String, Vec<String>>, floors: &[&[&str]]) -> Vec<String> {
    let mut wrong = Vec::new();
    for (user, used) in packages {
        let Some(floor) = floor_of(floors, user) else {
            wrong.push(format!("package {user} is on no floor of tests/layers/order.rs"));
            continue;
        };
        for used in used {
            if floor_of(floors, used).is_none_or(|below| below >= floor) {
                wrong.push(format!("package {user} must not use package {used}"));
            }
        }
    }
    wrong
}

#[test]
fn packages_use_lower_floors_only() {
    let packages = packages();
    let edges: usize = packages.values().map(Vec::len).sum();
    assert!(
        packages.len() >= 14 && edges >= 40,
        "the scan found {} packages and {edges} arrows",
        packages.len()
    );
    let wrong = wrong_packages(&packages, PACKAGES);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
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

#[test]
fn rooms_use_lower_floors_only() {
    let (mut wrong, mut arrows) = (Vec::new(), 0);
    let mut packages: BTreeMap<PathBuf, Package> = BTreeMap::new();
    for folder in FOLDERS {
        let path = root().join(folder.path);
        let crate_root = path.ancestors().find(|above| above.join("lib.rs").exists()).unwrap();
        let package =
            packages.entry(crate_root.to_owned()).or_insert_with(|| Package::of(sources(crate_root)));
        let inside = path.strip_prefix(crate_root).unwrap().to_str().unwrap();
        let (found, count) = wrong_arrows(package, inside, folder.floors);
        arrows += count;
        wrong.extend(found.into_iter().map(|what| format!("{}: {what}", folder.path)));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(arrows > 400, "the scan found {arrows} arrows");
}

/// Words of a family of drives, which the code of the controller must not name; comments and strings may.
const FAMILY_WORDS: [&str; 4] = ["groups", "Frame", "PowerCubes", "embedded_can"];

fn family_words(tree: &Tree) -> Vec<String> {
    let mut found = Vec::new();
    for (file, text) in tree {
        let words = paths::words(text);
        let named = FAMILY_WORDS.iter().filter(|family| words.iter().any(|word| word == *family));
        found.extend(named.map(|family| format!("{file} names {family}")));
    }
    found
}

#[test]
fn the_controller_names_no_frame_and_no_family_of_drives() {
    let tree = sources(&root().join("firmware/src/controller"));
    assert!(tree.len() >= 8, "the scan found {} files", tree.len());
    let found = family_words(&tree);
    assert!(found.is_empty(), "firmware/src/controller: {}", found.join("\n"));
}

#[test]
fn a_controller_that_names_a_frame_or_a_family_is_found() {
    let tree = Tree::from([
        ("a.rs".to_owned(), "//! Frame\nuse protocol::{Frame, Instant};".to_owned()),
        ("b.rs".to_owned(), "type G = crate::groups::powercube::PowerCubes; // PowerCubes".to_owned()),
        ("c.rs".to_owned(), "struct FreezeFrame; /* groups */ const A: &str = \"groups\";".to_owned()),
    ]);
    assert_eq!(family_words(&tree), ["a.rs names Frame", "b.rs names groups", "b.rs names PowerCubes"]);
}

#[test]
fn every_folder_in_which_rooms_use_each_other_is_listed() {
    let listed: Vec<&str> = FOLDERS.iter().map(|folder| folder.path).collect();
    let crate_roots: BTreeSet<&str> =
        listed.iter().map(|path| &path[..path.find("src").unwrap() + 3]).collect();
    assert!(crate_roots.len() >= 12, "{crate_roots:?}");
    let mut missing = Vec::new();
    for crate_root in crate_roots {
        let package = Package::of(sources(&root().join(crate_root)));
        for inside in package.folders() {
            let path = format!("{crate_root}/{inside}");
            let (_, arrows) = wrong_arrows(&package, &inside, &[]);
            if arrows > 0 && !listed.contains(&path.trim_end_matches('/')) {
                missing.push(path);
            }
        }
    }
    assert!(missing.is_empty(), "tests/layers/order.rs does not list {}", missing.join(", "));
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
        ["package low must not use package high", "package new is on no floor of tests/layers/order.rs"]
    );
}

/// Files and folders of tests beside `tests/main.rs` that it does not name: they would never run.
fn left_out(names: &[&str], main: &str) -> Vec<String> {
    let modules: BTreeSet<&str> =
        main.lines().filter_map(|line| line.strip_prefix("mod ")?.strip_suffix(';')).collect();
    let stems = names.iter().map(|name| name.trim_end_matches(".rs"));
    stems.filter(|stem| *stem != "main" && !modules.contains(stem)).map(str::to_owned).collect()
}

#[test]
fn every_file_of_tests_is_a_module_of_its_packages_test_program() {
    let mut programs = 0;
    for package in packages_with_one_test_program() {
        let folder = package.join("tests");
        let main = std::fs::read_to_string(folder.join("main.rs")).unwrap();
        let names: Vec<String> = std::fs::read_dir(&folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|end| end == "rs") || path.join("mod.rs").exists())
            .map(|path| path.file_name().unwrap().to_str().unwrap().to_owned())
            .collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let missing = left_out(&names, &main);
        assert!(missing.is_empty(), "{}/main.rs does not name {}", folder.display(), missing.join(", "));
        programs += 1;
    }
    assert!(programs >= 10, "{programs} packages with one test program");
}

/// Folders of the packages whose manifest turns automatic tests off and that have `tests/main.rs`.
fn packages_with_one_test_program() -> Vec<PathBuf> {
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let members = manifest.split_once("members = [").unwrap().1.split_once(']').unwrap().0;
    let folders = members.split('"').skip(1).step_by(2).map(|member| root().join(member));
    folders
        .filter(|folder| {
            let own = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap();
            own.contains("autotests = false") && folder.join("tests/main.rs").exists()
        })
        .collect()
}

#[test]
fn a_file_of_tests_that_is_in_no_program_is_found() {
    assert_eq!(left_out(&["main.rs", "a.rs", "rig", "b.rs"], "mod a;\nmod rig;\n// mod b;\n"), ["b"]);
}
