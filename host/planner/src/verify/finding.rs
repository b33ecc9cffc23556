//! Result of one check.

/// Result of one check.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Finding {
    pub what: String,
    /// Whether it holds.
    pub ok: bool,
    /// Worst value, with its limit, as text.
    pub worst: String,
    /// When it is worst, in s, if it depends on time.
    pub at_s: Option<f64>,
    /// Whether the plan claims it; other findings are for information.
    pub enforced: bool,
}

impl Finding {
    /// What the plan claims and no time belongs to.
    pub(super) fn claimed(what: &str, ok: bool, worst: String) -> Self {
        Self { what: what.to_owned(), ok, worst, at_s: None, enforced: true }
    }
}
