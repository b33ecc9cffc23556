//! What was looked at, how bad it is, and what to do; equal findings of several modules as one.

use protocol::ModuleId;

/// How bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// As it should be.
    Ok,
    /// Worth knowing.
    Note,
    /// Wrong.
    Problem,
}

impl Level {
    pub(crate) const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Note => "note",
            Self::Problem => "PROBLEM",
        }
    }
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// How bad.
    pub level: Level,
    /// Name of the check, stable.
    pub check: &'static str,
    /// Modules it is about, by address; empty if it is about the bus.
    pub modules: Vec<ModuleId>,
    /// What was found.
    pub what: String,
    /// What to do; empty if nothing.
    pub next: String,
}

impl Finding {
    /// `module 3: not homed`, `modules 1-4, 6: not homed`, or what was found of the bus.
    #[must_use]
    pub fn text(&self) -> String {
        match self.modules.as_slice() {
            [] => self.what.clone(),
            [module] => format!("module {module}: {}", self.what),
            many => format!("modules {}: {}", ranges(many), self.what),
        }
    }

    pub(crate) fn to_json(&self) -> serde_json::Value {
        let modules: Vec<u8> = self.modules.iter().map(|module| module.get()).collect();
        serde_json::json!({
            "level": self.level.word(), "check": self.check, "modules": modules, "what": self.what, "next": self.next,
        })
    }
}

/// Of the bus.
pub(crate) fn finding(
    level: Level,
    check: &'static str,
    what: impl Into<String>,
    next: impl Into<String>,
) -> Finding {
    of_modules(level, check, &[], what, next)
}

pub(crate) fn of_modules(
    level: Level,
    check: &'static str,
    modules: &[ModuleId],
    what: impl Into<String>,
    next: impl Into<String>,
) -> Finding {
    Finding { level, check, modules: modules.to_vec(), what: what.into(), next: next.into() }
}

/// Equal findings of different modules as one, at the place of the first.
pub(crate) fn grouped(findings: Vec<Finding>) -> Vec<Finding> {
    let mut groups: Vec<Finding> = Vec::new();
    for found in findings {
        let same = |group: &&mut Finding| {
            !found.modules.is_empty()
                && !group.modules.is_empty()
                && (group.level, group.check, &group.what, &group.next)
                    == (found.level, found.check, &found.what, &found.next)
        };
        match groups.iter_mut().find(same) {
            Some(group) => group.modules.extend(found.modules),
            None => groups.push(found),
        }
    }
    for group in &mut groups {
        group.modules.sort_unstable();
        group.modules.dedup();
    }
    groups
}

/// `1-4, 6` of addresses in ascending order.
fn ranges(modules: &[ModuleId]) -> String {
    let mut runs: Vec<(u8, u8)> = Vec::new();
    for address in modules.iter().map(|module| module.get()) {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == address => *last = address,
            _ => runs.push((address, address)),
        }
    }
    let words: Vec<String> = runs
        .iter()
        .map(|(first, last)| if first == last { first.to_string() } else { format!("{first}-{last}") })
        .collect();
    words.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(address: u8, what: &str) -> Finding {
        of_modules(Level::Note, "homing", &[ModuleId::new(address).unwrap()], what, "`cubectl home`")
    }

    #[test]
    fn equal_findings_of_several_modules_are_one_with_their_addresses() {
        let bus = finding(Level::Ok, "traffic", "nobody else speaks", "");
        let list = vec![
            bus.clone(),
            of(6, "not homed"),
            of(1, "not homed"),
            of(2, "halted"),
            of(2, "not homed"),
            of(3, "not homed"),
            bus.clone(),
        ];
        let texts: Vec<String> = grouped(list).iter().map(Finding::text).collect();
        assert_eq!(
            texts,
            ["nobody else speaks", "modules 1-3, 6: not homed", "module 2: halted", "nobody else speaks"]
        );
    }

    #[test]
    fn findings_of_another_level_check_or_advice_stay_apart() {
        let first = of(1, "not homed");
        let others = [
            Finding { level: Level::Problem, ..of(2, "not homed") },
            Finding { check: "state", ..of(3, "not homed") },
            Finding { next: String::new(), ..of(4, "not homed") },
        ];
        let list: Vec<Finding> = std::iter::once(first).chain(others).collect();
        assert_eq!(grouped(list.clone()), list);
    }
}
