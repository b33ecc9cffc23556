//! Tables of `docs/trust.md`, which the suites compare with what they find.

use std::path::Path;

#[must_use]
pub fn text() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/trust.md")).unwrap()
}

/// Rows of the table under a heading, cells trimmed, without its two first lines.
///
/// # Panics
/// No such heading, or no table under it.
#[must_use]
pub fn table(heading: &str) -> Vec<Vec<String>> {
    let text = text();
    let part = text.split("\n## ").find(|part| part.starts_with(heading));
    let part = part.unwrap_or_else(|| panic!("docs/trust.md has no heading '{heading}'"));
    let lines =
        part.lines().skip_while(|line| !line.starts_with('|')).take_while(|line| line.starts_with('|'));
    let rows: Vec<Vec<String>> = lines
        .skip(2)
        .map(|line| line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect())
        .collect();
    assert!(!rows.is_empty(), "docs/trust.md has no table under '{heading}'");
    rows
}

/// True if a figure of the page says what was found: within a twentieth of `whole`, and within `step` in any case.
#[must_use]
pub fn agrees(cell: &str, found: f64, whole: f64, step: f64) -> bool {
    cell.parse::<f64>().is_ok_and(|reported| (reported - found).abs() <= step.max(0.05 * whole))
}
