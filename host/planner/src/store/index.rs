//! Records in memory, found by range and height.

use crate::throw::JOINTS;
use std::collections::HashMap;

use super::record::Record;

/// Edge of an index cell in m.
const CELL_M: f64 = 0.05;

/// Records sorted into cells of (range, height).
#[derive(Debug, Clone, Default)]
pub struct Index<const N: usize = JOINTS> {
    records: Vec<Record<N>>,
    cells: HashMap<(i32, i32), Vec<u32>>,
}

fn cell(range_m: f64, height_m: f64) -> (i32, i32) {
    ((range_m / CELL_M).round() as i32, (height_m / CELL_M).round() as i32)
}

impl<const N: usize> Index<N> {
    /// From records.
    #[must_use]
    pub fn new(records: Vec<Record<N>>) -> Self {
        let mut index = Self::default();
        for record in records {
            index.insert(record);
        }
        index
    }

    /// Adds a record.
    pub fn insert(&mut self, record: Record<N>) {
        let at = u32::try_from(self.records.len()).unwrap_or(u32::MAX);
        self.cells.entry(cell(record.range_m, record.height_m)).or_default().push(at);
        self.records.push(record);
    }

    #[must_use]
    pub fn records(&self) -> &[Record<N>] {
        &self.records
    }

    /// Records of a kind around a target, most promising first: near ones, among equally near ones the cheaper.
    ///
    /// Looks at the cell of the target and its neighbours, and farther out, up to `rings` cells, only while nothing is
    /// found.
    pub fn near<'a>(
        &'a self,
        kind: u32,
        range_m: f64,
        height_m: f64,
        rings: i32,
        out: &mut Vec<&'a Record<N>>,
    ) {
        out.clear();
        let (r, h) = cell(range_m, height_m);
        for ring in 1..=rings.max(1) {
            for dr in -ring..=ring {
                for dh in -ring..=ring {
                    if ring > 1 && dr.abs() < ring && dh.abs() < ring {
                        continue;
                    }
                    let Some(at) = self.cells.get(&(r + dr, h + dh)) else { continue };
                    out.extend(at.iter().map(|i| &self.records[*i as usize]).filter(|x| x.kind == kind));
                }
            }
            if !out.is_empty() {
                break;
            }
        }
        // A metre of distance is worth as much as the objective.
        let key = |x: &Record<N>| {
            let d = (x.range_m - range_m).hypot(x.height_m - height_m);
            x.objective * (1.0 + d)
        };
        out.sort_by(|a, b| key(a).total_cmp(&key(b)));
    }
}
