//! What all parts of a sweep say together.

use std::fs::File;
use std::io::Read;

use crate::error::TableError;
use crate::folder::Folder;
use crate::part::{Values, read_columns};
use crate::row::Outcome;
use crate::shard::Shard;

/// Counts and sums over the parts that are there.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Targets of the whole sweep, and shards.
    pub targets: u64,
    pub shards: u32,
    /// Shards that are not there, by number.
    pub missing: Vec<u32>,
    /// Rows by outcome.
    pub thrown: u64,
    pub relaxed: u64,
    pub refused: u64,
    /// Smallest, mean and largest objective of the throws; none without a throw.
    pub objective: Option<[f64; 3]>,
    /// Balls drawn that landed, and of them hits, over all throws; none if none were drawn.
    pub landed: Option<u64>,
    pub hits: Option<u64>,
    /// Root mean square miss of all balls that landed, in m.
    pub miss_rms_m: Option<f64>,
    /// CRC-32 of the parts that are there, one after the other.
    pub crc32: u32,
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
    pub fn of(folder: &Folder) -> Result<Self, TableError> {
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
                add_bytes(folder, shard, &mut crc)?;
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
    ) -> Result<(), TableError> {
        let names = ["outcome", "objective", "draws_landed", "draws_hit", "draws_miss_rms_m"];
        read_columns(&folder.part(shard), names, |columns| {
            let [
                Values::Texts(outcomes),
                Values::Doubles(objectives),
                Values::Doubles(landed),
                Values::Doubles(hits),
                Values::Doubles(misses),
            ] = columns
            else {
                return;
            };
            for outcome in outcomes {
                *match outcome.as_str() {
                    name if name == Outcome::Thrown.name() => &mut self.thrown,
                    name if name == Outcome::Relaxed.name() => &mut self.relaxed,
                    _ => &mut self.refused,
                } += 1;
            }
            for value in objectives.into_iter().flatten() {
                *sum += value;
                let [least, _, most] = self.objective.unwrap_or([value; 3]);
                self.objective = Some([least.min(value), 0.0, most.max(value)]);
            }
            for ((landed, hits), miss_m) in landed.into_iter().zip(hits).zip(misses) {
                let Some(landed) = landed else { continue };
                drawn.any = true;
                drawn.landed += landed;
                drawn.squares_m2 += landed * miss_m.unwrap_or(0.0).powi(2);
                if let Some(hits) = hits {
                    drawn.hits = Some(drawn.hits.unwrap_or(0.0) + hits);
                }
            }
        })
    }
}

fn add_bytes(folder: &Folder, shard: Shard, crc: &mut crc32fast::Hasher) -> Result<(), TableError> {
    let path = folder.part(shard);
    let mut file = File::open(&path).map_err(TableError::reading(&path))?;
    let mut bytes = vec![0; 1 << 16];
    loop {
        match file.read(&mut bytes).map_err(TableError::reading(&path))? {
            0 => return Ok(()),
            count => crc.update(&bytes[..count]),
        }
    }
}
