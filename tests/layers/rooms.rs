//! Arrows between the rooms of one folder, from the paths in their sources.

use std::collections::{BTreeMap, BTreeSet};

use crate::floor_of;
use crate::paths::{Source, read};

/// Sources of a package: path from the folder of its `lib.rs` → text.
pub(crate) type Tree = BTreeMap<String, String>;

/// A package: its sources, each read once.
pub(crate) struct Package {
    tree: Tree,
    /// File, module path, what it uses.
    read: Vec<(String, Vec<String>, Source)>,
}

impl Package {
    pub(crate) fn of(tree: Tree) -> Self {
        let read = tree.iter().map(|(file, text)| (file.clone(), module(file), read(text))).collect();
        Self { tree, read }
    }

    /// Folders with their path from the root of the package; the root itself is an empty one.
    pub(crate) fn folders(&self) -> BTreeSet<String> {
        let parents = |file: &str| -> Vec<String> {
            let folder = file.rsplit_once('/').map_or("", |(folder, _)| folder);
            let ends = folder.match_indices('/').map(|(at, _)| at).chain([folder.len(), 0]);
            ends.map(|end| folder[..end].to_owned()).collect()
        };
        self.tree.keys().flat_map(|file| parents(file)).filter(|folder| !folder.starts_with("bin")).collect()
    }
}

/// Module path of a file: `a/mod.rs` and `a.rs` are `[a]`, `lib.rs` is `[]`.
fn module(file: &str) -> Vec<String> {
    let path = file.strip_suffix(".rs").unwrap_or(file);
    let mut parts: Vec<String> = path.split('/').map(str::to_owned).collect();
    if matches!(parts.last().map(String::as_str), Some("mod" | "lib" | "main")) {
        parts.pop();
    }
    parts
}

/// The path from the root of the package, of a path in the module `user`.
fn absolute(user: &[String], path: &[String]) -> Vec<String> {
    let mut found: Vec<String> = match path.first().map(String::as_str) {
        Some("crate") => Vec::new(),
        _ => user.to_vec(),
    };
    for part in path {
        match part.as_str() {
            "crate" | "self" => {}
            "super" => drop(found.pop()),
            name => found.push(name.to_owned()),
        }
    }
    found
}

/// Names that the root of `folder` brings in from its rooms: name → room.
fn re_exports(folder: &[String], root: &str, rooms: &BTreeSet<String>) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    for statement in root.split("pub use ").skip(1) {
        let statement = statement.split(';').next().unwrap_or_default();
        let statement = statement.trim_start_matches("self::");
        let begins_here = statement.split("::").next().is_some_and(|first| rooms.contains(first));
        if !begins_here {
            continue;
        }
        for path in read(&format!("use self::{statement};")).paths {
            let path = absolute(folder, &path);
            if let (Some(room), Some(name)) = (path.get(folder.len()), path.last()) {
                found.insert(name.clone(), room.clone());
            }
        }
    }
    found
}

/// Upward and level arrows between the rooms of the folder `inside` of a package, as text; and how many arrows there are.
pub(crate) fn wrong_arrows(package: &Package, inside: &str, floors: &[&[&str]]) -> (Vec<String>, usize) {
    let folder: Vec<String> = inside.split('/').filter(|part| !part.is_empty()).map(str::to_owned).collect();
    let Package { tree, read: sources } = package;
    let tests: Vec<Vec<String>> = sources
        .iter()
        .flat_map(|(_, user, source)| {
            source.test_modules.iter().map(|name| user.iter().chain([name]).cloned().collect())
        })
        .collect();
    let inside = |user: &[String]| user.len() > folder.len() && user.starts_with(&folder);
    let rooms: BTreeSet<String> = sources
        .iter()
        .filter(|(_, user, _)| inside(user) && !tests.iter().any(|test| user.starts_with(test)))
        .map(|(_, user, _)| user[folder.len()].clone())
        .filter(|room| !(folder.is_empty() && room == "bin"))
        .collect();
    let roots: String =
        sources.iter().filter(|(_, user, _)| *user == folder).map(|(file, ..)| tree[file].as_str()).collect();
    let names = re_exports(&folder, &roots, &rooms);
    let mut wrong: BTreeSet<String> = rooms
        .iter()
        .filter(|room| floor_of(floors, room).is_none())
        .map(|room| format!("{room} is on no floor"))
        .collect();
    wrong.extend(
        floors
            .iter()
            .copied()
            .flatten()
            .filter(|room| !rooms.contains(**room))
            .map(|room| format!("there is no {room}")),
    );
    let mut arrows = BTreeSet::new();
    for (file, user, source) in sources {
        if !inside(user) || tests.iter().any(|test| user.starts_with(test)) {
            continue;
        }
        let room = &user[folder.len()];
        for path in &source.paths {
            let path = absolute(user, path);
            if path.len() <= folder.len() || !path.starts_with(&folder) {
                continue;
            }
            let name = &path[folder.len()];
            let Some(used) = rooms.get(name).or_else(|| names.get(name)).filter(|used| *used != room) else {
                continue;
            };
            arrows.insert((room.clone(), used.clone()));
            if let (Some(above), Some(below)) = (floor_of(floors, room), floor_of(floors, used))
                && below >= above
            {
                wrong.insert(format!("{file} uses {}: {room} must not use {used}", path.join("::")));
            }
        }
    }
    (wrong.into_iter().collect(), arrows.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(files: &[(&str, &str)]) -> Package {
        Package::of(files.iter().map(|(file, text)| ((*file).to_owned(), (*text).to_owned())).collect())
    }

    const FLOORS: &[&[&str]] = &[&["low"], &["high"]];

    #[test]
    fn a_ring_of_two_rooms_is_found_where_it_goes_up() {
        let ring = tree(&[
            ("lib.rs", "pub mod high;\npub mod low;"),
            ("high/mod.rs", "mod part;"),
            ("high/part.rs", "use super::super::low::L;"),
            ("low.rs", "use crate::high::{part::P};"),
        ]);
        let (wrong, arrows) = wrong_arrows(&ring, "", FLOORS);
        assert_eq!(wrong, ["low.rs uses high::part::P: low must not use high"]);
        assert_eq!(arrows, 2);
    }

    #[test]
    fn a_ring_through_a_name_that_the_root_re_exports_is_found() {
        let ring = tree(&[
            ("lib.rs", "mod high;\nmod low;\npub use high::{H, other::K};\npub use low::L;"),
            ("high.rs", "use crate::L;"),
            ("low.rs", "fn f() -> crate::K { }"),
        ]);
        let (wrong, arrows) = wrong_arrows(&ring, "", FLOORS);
        assert_eq!(wrong, ["low.rs uses K: low must not use high"]);
        assert_eq!(arrows, 2);
    }

    #[test]
    fn rooms_of_an_inner_folder_rooms_without_a_floor_and_floors_without_a_room_are_found() {
        let inner = tree(&[
            ("lib.rs", "pub mod a;"),
            ("a/mod.rs", ""),
            ("a/low.rs", "use super::new::N;\nuse crate::a::new;"),
            ("a/new.rs", ""),
        ]);
        let (wrong, _) = wrong_arrows(&inner, "a", FLOORS);
        assert_eq!(wrong, ["new is on no floor", "there is no high"]);
    }

    #[test]
    fn tests_may_use_what_they_like() {
        let tested = tree(&[
            ("lib.rs", "pub mod high;\npub mod low;"),
            ("high.rs", "use crate::low::L;"),
            ("low.rs", "#[cfg(test)]\nmod far;\n#[cfg(test)]\nmod tests { use crate::high::H; }"),
            ("low/far.rs", "use crate::high::H;"),
        ]);
        assert_eq!(wrong_arrows(&tested, "", FLOORS), (Vec::new(), 1));
    }
}
