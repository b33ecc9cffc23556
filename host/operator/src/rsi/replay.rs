//! Runs a log again: the same telegrams at the same times, and whether the answers are the same.

use protocol::Instant;

use super::log::{Entry, Line};
use super::station::Station;
use crate::trajectory::Segment;

/// An answer that differs from the recorded one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// When the telegram came.
    pub at: Instant,
    /// The recorded answer, if there was one.
    pub recorded: Option<Vec<u8>>,
    /// What the station answers now.
    pub given: Option<Vec<u8>>,
}

/// What running a log again gave.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Replayed {
    /// Telegrams handed over.
    pub telegrams: usize,
    /// Answers that were the same, byte for byte.
    pub same: usize,
    pub difference: Option<Difference>,
}

/// Passes all input of a recorded station to `station`, at the same times, and compares the answers.
pub fn replay(lines: &[Line], station: &mut Station) -> Replayed {
    let mut replayed = Replayed::default();
    let (mut waiting, mut new_connection) = (Vec::new(), false);
    for (k, line) in lines.iter().enumerate() {
        match &line.entry {
            Entry::NewConnection => new_connection = true,
            Entry::Waited(bytes) => waiting.push(bytes.clone()),
            Entry::Telegram(bytes) => {
                waiting.push(bytes.clone());
                let given = station.handle(line.at, &waiting, new_connection);
                replayed.telegrams += waiting.len();
                waiting.clear();
                new_connection = false;
                let recorded = match lines.get(k + 1).map(|next| &next.entry) {
                    Some(Entry::Answer(bytes)) => Some(bytes.clone()),
                    _ => None,
                };
                if given != recorded {
                    replayed.difference = Some(Difference { at: line.at, recorded, given });
                    return replayed;
                }
                replayed.same += usize::from(given.is_some());
            }
            Entry::Answer(_) => {}
            Entry::File(file) => station.push(line.at, file.clone().into()),
            Entry::Segment(bytes) => {
                station.push_segment(line.at, Segment { bytes: bytes.clone(), room_us: 0 });
            }
            Entry::Target(bytes) => {
                let _ = station.retarget(line.at, bytes);
            }
            Entry::Timeout => station.handle_timeout(line.at),
            Entry::Stop => station.stop(line.at),
            Entry::Gripper(open) => {
                let _ = station.set_gripper(line.at, *open);
            }
            Entry::Hold => station.hold(line.at),
            Entry::Proceed => station.proceed_from_hold(line.at),
            Entry::Leave => station.leave(line.at),
        }
    }
    replayed
}
