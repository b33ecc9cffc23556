//! Median, 99th percentile and extremes of a set of numbers.

use serde::Serialize;

/// See the [module](self). The unit is the one of the numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Distribution {
    /// How many numbers.
    pub count: usize,
    /// Smallest.
    pub min: f64,
    /// Half of the numbers are not above it.
    pub median: f64,
    /// 99 % of the numbers are not above it.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

impl Distribution {
    /// Of these numbers; those that are not finite are left out. `None` without any.
    #[must_use]
    pub fn of(numbers: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = numbers.into_iter().filter(|x| x.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let (first, last) = (*sorted.first()?, *sorted.last()?);
        // Nearest rank: the smallest number that at least this share of all do not exceed.
        let at = |share: f64| {
            let rank = (share * sorted.len() as f64).ceil() as usize;
            sorted[rank.clamp(1, sorted.len()) - 1]
        };
        Some(Self { count: sorted.len(), min: first, median: at(0.5), p99: at(0.99), max: last })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_are_those_of_the_definition() {
        let d = Distribution::of((1..=200).rev().map(f64::from).chain([f64::NAN])).unwrap();
        assert_eq!(d, Distribution { count: 200, min: 1.0, median: 100.0, p99: 198.0, max: 200.0 });
        let one = Distribution::of([3.5]).unwrap();
        assert_eq!((one.min, one.median, one.p99, one.max), (3.5, 3.5, 3.5, 3.5));
        assert_eq!(Distribution::of([f64::INFINITY]), None);
    }
}
