//! What all parts of a sweep say together.

use super::add_bytes;
use super::folder::Folder;
use super::shard::Shard;
use crate::error::ExpectedError;

/// Counts and sums over the parts that are there.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Summary {
    /// Targets of the whole sweep, and shards.
    pub(crate) targets: u64,
    pub(crate) shards: u32,
    /// Shards that are not there, by number.
    pub(crate) missing: Vec<u32>,
    /// Rows by outcome.
    pub(crate) thrown: u64,
    pub(crate) relaxed: u64,
    pub(crate) refused: u64,
    /// Smallest, mean and largest objective of the throws; none without a throw.
    pub(crate) objective: Option<[f64; 3]>,
    /// Balls drawn that landed, and of them hits, over all throws; none if none were drawn.
    pub(crate) landed: Option<u64>,
    pub(crate) hits: Option<u64>,
    /// Root mean square miss of all balls that landed, in m.
    pub(crate) miss_rms_m: Option<f64>,
    /// CRC-32 of the parts that are there, one after the other.
    pub(crate) crc32: u32,
}

/// Sums of the balls drawn.
#[derive(Default)]
struct Drawn {
    any: bool,
    landed: f64,
    hits: Option<f64>,
    squares_m2: f64,
}

impl Summary {
    /// Reads all parts of a folder, one after the other.
    ///
    /// # Errors
    /// A part cannot be read or is of another sweep.
    pub(crate) fn of(folder: &Folder) -> Result<Self, ExpectedError> {
        let study = folder.study();
        let mut summary = Self {
            targets: study.targets(),
            shards: study.shards(),
            missing: Vec::new(),
            thrown: 0,
            relaxed: 0,
            refused: 0,
            objective: None,
            landed: None,
            hits: None,
            miss_rms_m: None,
            crc32: 0,
        };
        let (mut crc, mut sum, mut drawn) = (crc32fast::Hasher::new(), 0.0, Drawn::default());
        for shard in Shard::all(study.shards()) {
            if folder.has(shard)? {
                summary.add(folder, shard, &mut sum, &mut drawn)?;
                add_bytes(&folder.part(shard), &mut crc)?;
            } else {
                summary.missing.push(shard.number());
            }
        }
        let throws = summary.thrown + summary.relaxed;
        if let Some([_, mean, _]) = &mut summary.objective {
            *mean = sum / throws as f64;
        }
        if drawn.any {
            // Counts are whole numbers far below 2^53.
            summary.landed = Some(drawn.landed as u64);
            summary.hits = drawn.hits.map(|hits| hits as u64);
            summary.miss_rms_m = (drawn.landed > 0.0).then(|| (drawn.squares_m2 / drawn.landed).sqrt());
        }
        summary.crc32 = crc.finalize();
        Ok(summary)
    }

    fn add(
        &mut self,
        folder: &Folder,
        shard: Shard,
        sum: &mut f64,
        drawn: &mut Drawn,
    ) -> Result<(), ExpectedError> {
        folder.read(shard, |column| {
            *match column("outcome") {
                "thrown" => &mut self.thrown,
                "relaxed" => &mut self.relaxed,
                _ => &mut self.refused,
            } += 1;
            let number = |name| column(name).parse::<f64>().ok();
            if let Some(value) = number("objective") {
                *sum += value;
                let [least, _, most] = self.objective.unwrap_or([value; 3]);
                self.objective = Some([least.min(value), 0.0, most.max(value)]);
            }
            if let Some(landed) = number("draws_landed") {
                drawn.any = true;
                drawn.landed += landed;
                drawn.squares_m2 += landed * number("draws_miss_rms_m").unwrap_or(0.0).powi(2);
                if let Some(hits) = number("draws_hit") {
                    drawn.hits = Some(drawn.hits.unwrap_or(0.0) + hits);
                }
            }
        })
    }
}
