//! Which rows a shard has.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

/// Most shards of a sweep: more than job arrays have tasks, and few enough files for one folder.
pub(crate) const SHARDS_MAX: u32 = 100_000;

/// Shard `number` of `count`; numbers begin at 1, as the tasks of `sbatch --array=1-100` do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Shard {
    number: u32,
    count: u32,
}

impl Shard {
    /// A shard; `None` unless `number` is from 1 to `count`, and `count` at most [`SHARDS_MAX`].
    pub(crate) fn new(number: u32, count: u32) -> Option<Self> {
        (number >= 1 && number <= count && count <= SHARDS_MAX).then_some(Self { number, count })
    }

    /// All shards of a sweep, in order; none if `count` is 0 or above [`SHARDS_MAX`].
    pub(crate) fn all(count: u32) -> impl Iterator<Item = Self> {
        (1..=count).filter_map(move |number| Self::new(number, count))
    }

    /// From 1.
    pub(crate) fn number(&self) -> u32 {
        self.number
    }

    pub(crate) fn count(&self) -> u32 {
        self.count
    }

    /// Its rows of `rows`: neighbours, so that the parts one after the other are the table in order. Shards differ by one row
    /// at most.
    pub(crate) fn rows(&self, rows: u64) -> Range<u64> {
        let end = |shards: u32| {
            let end = u128::from(rows) * u128::from(shards) / u128::from(self.count);
            // At most `rows`.
            u64::try_from(end).unwrap_or(rows)
        };
        end(self.number - 1)..end(self.number)
    }

    pub(crate) fn file_name(&self) -> String {
        format!("part-{:05}-of-{:05}.csv", self.number, self.count)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.count)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let expected = "expected I/N, shard I of N, such as 3/100";
        let (number, count) = text.split_once('/').ok_or_else(|| expected.to_owned())?;
        let whole = |part: &str| {
            part.trim().parse::<u32>().map_err(|_| format!("\"{part}\" is not a whole number; {expected}"))
        };
        let (number, count) = (whole(number)?, whole(count)?);
        Self::new(number, count).ok_or_else(|| match (number, count) {
            (_, 0) => format!("a sweep has at least one shard; {expected}"),
            (0, _) => {
                format!("shards count from 1 to {count}: let the job array count from 1 to {count} too")
            }
            _ if count > SHARDS_MAX => format!("at most {SHARDS_MAX} shards"),
            _ => format!("there is no shard {number} of {count}; shards count from 1 to {count}"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_have_every_row_once_and_in_order_and_differ_by_one_row_at_most() {
        for (rows, count) in [(0, 3), (1, 4), (7, 7), (10, 3), (10_000_001, 99_999), (u64::MAX, 7)] {
            let mut next = 0;
            let (mut least, mut most) = (u64::MAX, 0);
            for shard in Shard::all(count) {
                let own = shard.rows(rows);
                assert_eq!(own.start, next, "{shard} of {rows} rows");
                (least, most) = (least.min(own.end - own.start), most.max(own.end - own.start));
                next = own.end;
            }
            assert_eq!(next, rows);
            assert!(most - least <= 1, "{rows} rows in {count}: {least} to {most}");
        }
    }

    #[test]
    fn words_that_name_no_shard_are_refused_with_what_does() {
        assert_eq!("3/100".parse(), Ok(Shard { number: 3, count: 100 }));
        for (word, reported) in [
            ("3", "expected I/N"),
            ("a/4", "\"a\" is not a whole number"),
            ("-1/4", "\"-1\" is not a whole number"),
            ("0/4", "job array count from 1 to 4"),
            ("5/4", "there is no shard 5 of 4"),
            ("0/0", "at least one shard"),
            ("1/100001", "at most 100000"),
        ] {
            let refused = word.parse::<Shard>().expect_err(word);
            assert!(refused.contains(reported), "{word}: {refused}");
        }
    }
}
