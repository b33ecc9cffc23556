//! Local optima found by the starts of a search, and an estimate of the chance that another start finds a better one.
//!
//! A local solve from a random start ends in one of a few local optima. A multi-start search knows two things about
//! its result: how many starts ended in the best local optimum, and how many starts ago it was found. After `n`
//! random starts in a row without a better throw, the chance that the next start finds one is estimated as 1/(n +
//! 2) (rule of succession).

use super::local::Found;

/// Information of the stored throws around a target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Surroundings {
    /// There are too few of them for a conclusion.
    Unknown,
    /// By a table no throw comes near the target.
    Empty,
    /// A table has throws to targets around.
    Stored,
}

/// How likely it is that there is a better throw than the best one found.
#[derive(
    Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
#[serde(deny_unknown_fields)]
pub struct Confidence {
    /// Random starts that were run.
    pub random_starts: usize,
    /// Starts of all kinds that ended at the price of the best throw.
    pub at_best: usize,
    /// Different prices at which starts ended.
    pub distinct: usize,
    /// Random starts since the best price was first found.
    pub since_best: usize,
    /// Estimated chance that one more random start finds a better throw.
    pub better_chance: f64,
    /// Estimated decrease of the price by one more random start: the chance times the mean step between the prices
    /// that were found.
    pub gap_share: f64,
}

/// Ends of starts at one price.
#[derive(Debug, Clone, Copy)]
struct Optimum {
    found: Found,
    hits: usize,
}

/// Ends of all starts of a search so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Optima {
    /// Cheapest first.
    optima: Vec<Optimum>,
    stored: usize,
    random: usize,
    solved: usize,
    since_best: usize,
}

/// Prices that differ by less than this share are one price.
const SAME_SHARE: f64 = 1e-3;
/// Number of optima that are kept. Those with the highest price are dropped.
const REMEMBERED: usize = 64;
/// Random starts that have to fail to find a better throw than those stored around the target.
pub(super) const ENOUGH_STORED: usize = 4;
/// The same without nulling, where a start takes a fifth of the time.
const ENOUGH_STORED_PLAIN: usize = 40;
/// Random starts that have to fail where a table has no throw near the target.
const ENOUGH_EMPTY: usize = 8;
/// Without a table: random starts in vain, and hits of the best throw.
const ENOUGH_ALONE: usize = 96;
const ENOUGH_HITS: usize = 4;

impl Optima {
    /// A random start has ended.
    pub(super) fn add_random(&mut self, found: Option<Found>) {
        self.random += 1;
        self.since_best += 1;
        self.add(found);
    }

    /// A start from a stored throw has ended.
    pub(super) fn add_stored(&mut self, found: Option<Found>) {
        self.stored += 1;
        self.add(found);
    }

    fn add(&mut self, found: Option<Found>) {
        let Some(found) = found else { return };
        self.solved += 1;
        let price = found.objective;
        if self
            .optima
            .first()
            .is_none_or(|b| price < b.found.objective - SAME_SHARE * b.found.objective.abs())
        {
            self.since_best = 0;
        }
        let same = |b: &Optimum| (b.found.objective - price).abs() <= SAME_SHARE * price.abs();
        match self.optima.iter_mut().find(|b| same(b)) {
            Some(optimum) => {
                optimum.hits += 1;
                // Of equal prices the first stays, so that its throw does not change with the number of starts.
                if price < optimum.found.objective {
                    optimum.found = found;
                }
            }
            None => self.optima.push(Optimum { found, hits: 1 }),
        }
        self.optima.sort_by(|a, b| a.found.objective.total_cmp(&b.found.objective));
        self.optima.truncate(REMEMBERED);
    }

    /// True if more random starts are unlikely to find a better throw.
    pub(super) fn enough(&self, surroundings: Surroundings, nulled: bool) -> bool {
        let enough_stored = if nulled { ENOUGH_STORED } else { ENOUGH_STORED_PLAIN };
        match (surroundings, self.optima.first()) {
            (Surroundings::Stored, Some(_)) => self.since_best >= enough_stored,
            (Surroundings::Empty, None) => self.random >= ENOUGH_EMPTY,
            (_, Some(best)) => self.since_best >= ENOUGH_ALONE && best.hits >= ENOUGH_HITS,
            (_, None) => false,
        }
    }

    /// The cheapest throw of every local optimum, cheapest first.
    pub(super) fn found(&self) -> Vec<Found> {
        self.optima.iter().map(|b| b.found).collect()
    }

    /// Starts that were run.
    pub(super) fn starts(&self) -> usize {
        self.stored + self.random
    }

    /// Random starts that were run.
    pub(super) fn random(&self) -> usize {
        self.random
    }

    /// Starts that ended in a throw.
    pub(super) fn solved(&self) -> usize {
        self.solved
    }

    pub(super) fn confidence(&self) -> Confidence {
        let prices: Vec<f64> = self.optima.iter().map(|b| b.found.objective).collect();
        let better_chance = 1.0 / (self.since_best as f64 + 2.0);
        let steps = prices.len().saturating_sub(1);
        let mean_step = match prices[..] {
            [first, .., last] if first > 0.0 => ((last - first) / first / steps as f64).min(1.0),
            _ => 0.0,
        };
        Confidence {
            random_starts: self.random,
            at_best: self.optima.first().map_or(0, |b| b.hits),
            distinct: prices.len(),
            since_best: self.since_best,
            better_chance,
            gap_share: better_chance * mean_step,
        }
    }
}
