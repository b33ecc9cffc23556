//! Figures per identifier and per node.

use protocol::Id;
use serde::Serialize;

/// Why a node began an error flag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorKind {
    /// Bus level differs from the own output.
    Bit,
    /// Six equal bits in the stuffed part.
    Stuff,
    /// Checksum does not match.
    Crc,
    /// Dominant bit where the form demands recessive.
    Form,
    /// No node acknowledged the own frame.
    Ack,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ErrorCounts {
    pub bit: u64,
    pub stuff: u64,
    /// Checksum errors.
    pub crc: u64,
    pub form: u64,
    /// Missing acknowledges.
    pub ack: u64,
}

impl ErrorCounts {
    /// Counts one.
    pub fn add(&mut self, kind: ErrorKind) {
        match kind {
            ErrorKind::Bit => self.bit += 1,
            ErrorKind::Stuff => self.stuff += 1,
            ErrorKind::Crc => self.crc += 1,
            ErrorKind::Form => self.form += 1,
            ErrorKind::Ack => self.ack += 1,
        }
    }

    /// Sum of all kinds.
    pub fn total(&self) -> u64 {
        self.bit + self.stuff + self.crc + self.form + self.ack
    }
}

/// Figures of one identifier.
#[derive(Clone, Copy, Debug)]
pub struct IdStats {
    pub id: Id,
    /// Frames that were transmitted.
    pub frames: u64,
    /// Time of these frames, start of frame to end of frame plus three bits of intermission.
    pub busy_ns: u64,
    /// Attempts that ended in an error and were repeated.
    pub failed_attempts: u64,
    pub arbitrations_lost: u64,
    /// Sum over frames of the time from queueing to the start of the successful attempt.
    pub wait_sum_ns: u64,
    pub wait_max_ns: u64,
    /// Largest time from queueing to the end of the frame: the response time of the literature.
    pub response_max_ns: u64,
    /// Error flags begun by any node while a frame of this id was on the bus.
    pub errors: ErrorCounts,
}

impl IdStats {
    fn new(id: Id) -> Self {
        Self {
            id,
            frames: 0,
            busy_ns: 0,
            failed_attempts: 0,
            arbitrations_lost: 0,
            wait_sum_ns: 0,
            wait_max_ns: 0,
            response_max_ns: 0,
            errors: ErrorCounts::default(),
        }
    }

    /// Mean time from queueing to the start of the successful attempt, nanoseconds; 0 without frames.
    pub fn wait_mean_ns(&self) -> f64 {
        if self.frames == 0 { 0.0 } else { self.wait_sum_ns as f64 / self.frames as f64 }
    }
}

/// Figures of one node.
#[derive(Clone, Copy, Debug, Default)]
pub struct PortStats {
    pub sent: u64,
    /// Frames received (accepted by the controller).
    pub received: u64,
    /// Attempts that ended in an error.
    pub failed_attempts: u64,
    pub arbitrations_lost: u64,
    /// Error flags this node began, by cause.
    pub errors: ErrorCounts,
    /// Times it became error-passive.
    pub became_passive: u64,
    /// Times it went bus-off.
    pub became_bus_off: u64,
    /// Frames thrown away because the node lost power.
    pub flushed: u64,
}

/// Table of ids that never hashes: 11-bit ids index directly, 29-bit ids by binary search.
#[derive(Clone, Debug)]
pub struct IdTable {
    rows: Vec<IdStats>,
    standard: Box<[u16; 2048]>,
    /// Sorted (raw id, row).
    extended: Vec<(u32, u16)>,
    /// Ids beyond the capacity share the last row's place: they are counted here only.
    untracked: u64,
}

/// Most different ids with a row of their own.
const ROWS_MAX: usize = u16::MAX as usize - 1;
const NO_ROW: u16 = u16::MAX;

impl Default for IdTable {
    fn default() -> Self {
        Self { rows: Vec::new(), standard: Box::new([NO_ROW; 2048]), extended: Vec::new(), untracked: 0 }
    }
}

impl IdTable {
    /// The row of an id, made on first use; `None` if 65 534 others came first.
    pub fn row(&mut self, id: Id) -> Option<&mut IdStats> {
        let index = match id {
            Id::Standard(standard) => {
                let slot = &mut self.standard[usize::from(standard.get())];
                if *slot == NO_ROW {
                    if self.rows.len() >= ROWS_MAX {
                        self.untracked += 1;
                        return None;
                    }
                    *slot = self.rows.len() as u16;
                    self.rows.push(IdStats::new(id));
                }
                *slot
            }
            Id::Extended(extended) => {
                match self.extended.binary_search_by_key(&extended.get(), |(raw, _)| *raw) {
                    Ok(at) => self.extended[at].1,
                    Err(at) => {
                        if self.rows.len() >= ROWS_MAX {
                            self.untracked += 1;
                            return None;
                        }
                        let row = self.rows.len() as u16;
                        self.rows.push(IdStats::new(id));
                        self.extended.insert(at, (extended.get(), row));
                        row
                    }
                }
            }
        };
        self.rows.get_mut(usize::from(index))
    }

    /// All rows, by bus priority.
    pub fn sorted(&self) -> Vec<IdStats> {
        let mut rows = self.rows.clone();
        rows.sort_by_key(|row| row.id);
        rows
    }

    /// Events of ids without a row.
    pub fn untracked(&self) -> u64 {
        self.untracked
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{ExtendedId, StandardId};

    #[test]
    fn same_number_in_both_formats_gets_two_rows_and_sorting_is_by_priority() {
        let mut table = IdTable::default();
        let ids = [
            Id::Extended(ExtendedId::from_low_bits(0x700)),
            Id::Standard(StandardId::from_low_bits(0x700)),
            Id::Extended(ExtendedId::from_low_bits(0x3)),
        ];
        for id in ids.iter().chain(&ids) {
            table.row(*id).unwrap().frames += 1;
        }
        let sorted = table.sorted();
        assert_eq!(sorted.iter().map(|r| r.frames).collect::<Vec<_>>(), [2, 2, 2]);
        assert_eq!(sorted.iter().map(|r| r.id).collect::<Vec<_>>(), [ids[2], ids[0], ids[1]]);
    }
}
