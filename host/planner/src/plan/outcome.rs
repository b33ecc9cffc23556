//! Request to a search, and its result.

use std::sync::atomic::{AtomicBool, AtomicUsize};
use std::time::Duration;

use nalgebra::Vector3;

use super::local::Found;
use super::obstruction::Obstruction;
use super::optima::Confidence;

/// How long to search.
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    /// Random starts after the stored ones, at most. Unless `all` is set, a search without a table that has found a throw may
    /// make four times as many.
    pub starts: usize,
    /// Whether all of these starts are run, instead of as many as are likely to find a better throw.
    pub all: bool,
    /// No new start after this time.
    pub time: Option<Duration>,
    /// Seed of the random starts; same seed and same starts give the same throw on any number of cores.
    pub seed: u64,
}

impl Default for Budget {
    fn default() -> Self {
        Self { starts: 192, all: false, time: None, seed: 1 }
    }
}

/// Shared with the code that watches or stops a search.
#[derive(Debug, Default)]
pub struct Watch {
    /// Set to end the search; the best throw so far is returned.
    pub stop: AtomicBool,
    /// Starts that have ended.
    pub done: AtomicUsize,
    /// Starts that found a throw.
    pub solved: AtomicUsize,
}

/// The best throw of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Best {
    /// The throw with its price.
    pub found: Found,
    /// Starts that were run, stored ones included.
    pub starts: usize,
    /// Starts that ended in a throw.
    pub solved: usize,
    /// Whether the search was stopped before its budget was used.
    pub interrupted: bool,
    /// Conclusion of the starts about throws that were not found.
    pub confidence: Confidence,
    /// The cheapest throws that were found, cheapest first; equal ones once.
    pub others: Vec<Found>,
}

impl Best {
    /// The throw of one start.
    #[must_use]
    pub fn alone(found: Found) -> Self {
        let confidence = Confidence { at_best: 1, distinct: 1, ..Confidence::default() };
        Self { found, starts: 1, solved: 1, interrupted: false, confidence, others: vec![found] }
    }
}

/// No start ended in a throw.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("no throw reaches {} m{}", point_text(target), reason_text(self))]
pub struct NoThrow {
    /// The target in m.
    pub target: Vector3<f64>,
    /// The nearest target that a throw reaches, if one was found.
    pub nearest: Option<NearestTarget>,
    /// The body that blocks every posture of the arm, if that is the reason.
    pub obstruction: Option<Box<Obstruction>>,
    /// Starts that were run.
    pub starts: usize,
    /// True if the search was stopped before its budget was used, so that a missing throw is not proven.
    pub interrupted: bool,
}

fn reason_text(none: &NoThrow) -> String {
    match &none.obstruction {
        Some(found) => format!(": {found}"),
        None => nearest_text(none.nearest.as_ref()),
    }
}

/// A reachable target near one that is not.
#[derive(Debug, Clone, PartialEq)]
pub struct NearestTarget {
    /// The point in m.
    pub point: Vector3<f64>,
    /// Distance from the requested target in m.
    pub distance_m: f64,
    /// The constraint that blocks the rest of the way.
    pub constraint: String,
}

/// Coordinates with three decimals; no "-0.000".
fn point_text(point: &Vector3<f64>) -> String {
    let [x, y, z] = (*point).into();
    let reported = |value: f64| (value * 1e3).round() / 1e3 + 0.0;
    format!("({:.3}, {:.3}, {:.3})", reported(x), reported(y), reported(z))
}

/// End of a message: where the nearest target is and what blocks; empty if no such target is known.
fn nearest_text(nearest: Option<&NearestTarget>) -> String {
    nearest.map_or_else(String::new, |n| {
        format!(
            "; the nearest target found in reach is {} m, {:.3} m away, blocked by: {}",
            point_text(&n.point),
            n.distance_m,
            n.constraint
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coordinate_that_rounds_to_zero_has_no_sign() {
        assert_eq!(point_text(&Vector3::new(-1e-9, -0.0004, -0.0006)), "(0.000, 0.000, -0.001)");
    }
}
