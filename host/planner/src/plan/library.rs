//! A library of throws: look-up of the stored throws nearest to a target, and the local solve from them.
//!
//! A library is a table as `plan prepare` makes it. The look-up sorts the throws around the target by the price each is
//! expected to have there; the local solve brings the best of them to the target under all limits. Nothing is random and nothing
//! searches: the same library gives the same throw.

use super::local::Found;
use super::planner::Planner;
use super::warm_start::WarmStart;
use crate::store::{Index, Record};
use crate::throw::JOINTS;

/// Stored throws that a look-up offers.
pub const OFFERED: usize = 6;

/// Stored throws around a target, the most promising first: what a look-up gives.
#[derive(Debug, Clone)]
pub struct LookUp<'i, const N: usize = JOINTS> {
    offered: Vec<WarmStart<'i, N>>,
}

impl<'i, const N: usize> LookUp<'i, N> {
    /// Whether no throw is stored around the target.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.offered.is_empty()
    }

    /// Stored throws that are offered, the most promising first.
    pub fn records(&self) -> impl Iterator<Item = &'i Record<N>> + '_ {
        self.offered.iter().map(|(_, record)| *record)
    }
}

impl<const N: usize> Planner<'_, '_, N> {
    /// Looks the target up.
    #[must_use]
    pub fn look_up<'i>(&self, index: &'i Index<N>) -> LookUp<'i, N> {
        LookUp { offered: self.warm_starts(index, OFFERED) }
    }

    /// The throw to the target from what a look-up has offered; `None` if no stored throw leads there in a few steps.
    #[must_use]
    pub fn from_look_up(&self, look_up: &LookUp<'_, N>) -> Option<Found<N>> {
        self.quickly(&look_up.offered)
    }
}

/// The stored throw, of any form, to the target nearest to one, and how far away that is in m (over range and height); `None`
/// for an empty library.
#[must_use]
pub fn nearest_stored<const N: usize>(
    index: &Index<N>,
    range_m: f64,
    height_m: f64,
) -> Option<(&Record<N>, f64)> {
    let away = |record: &Record<N>| (record.range_m - range_m).hypot(record.height_m - height_m);
    index.records().iter().map(|record| (record, away(record))).min_by(|a, b| a.1.total_cmp(&b.1))
}
