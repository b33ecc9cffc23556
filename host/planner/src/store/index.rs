//! Records in memory, found by range and height.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use super::record::Record;

/// Edge of an index cell in m.
const CELL_M: f64 = 0.05;
/// With fewer records around a target it is unknown whether the target is inside the table.
const TELLING: usize = 6;

/// Records sorted into cells of (range, height).
#[derive(Debug, Clone, Default)]
pub struct Index {
    records: Vec<Record>,
    lender: Option<&'static str>,
    cells: HashMap<(i32, i32), Vec<u32>>,
}

fn cell(range_m: f64, height_m: f64) -> (i32, i32) {
    ((range_m / CELL_M).round() as i32, (height_m / CELL_M).round() as i32)
}

impl Index {
    /// From records.
    #[must_use]
    pub fn new(records: Vec<Record>) -> Self {
        let mut index = Self::default();
        for record in records {
            index.insert(record);
        }
        index
    }

    /// Index of the records of another robot. They are only starts: this robot may reach targets that they do not.
    #[must_use]
    pub fn lent(records: Vec<Record>, lender: &'static str) -> Self {
        Self { lender: Some(lender), ..Self::new(records) }
    }

    /// The robot that the records were made for, if it is another one.
    #[must_use]
    pub const fn lender(&self) -> Option<&'static str> {
        self.lender
    }

    /// Whether there are records of this very robot.
    #[must_use]
    pub fn is_own(&self) -> bool {
        self.lender.is_none() && !self.records.is_empty()
    }

    /// Adds a record.
    pub fn insert(&mut self, record: Record) {
        let at = u32::try_from(self.records.len()).unwrap_or(u32::MAX);
        self.cells.entry(cell(record.range_m, record.height_m)).or_default().push(at);
        self.records.push(record);
    }

    #[must_use]
    pub fn records(&self) -> &[Record] {
        &self.records
    }

    /// Records of a kind around a target, most promising first: near ones, among equally near ones the cheaper.
    ///
    /// Looks at the cell of the target and its neighbours, and farther out, up to `rings` cells, only while nothing is
    /// found.
    pub fn near<'a>(&'a self, kind: u32, range_m: f64, height_m: f64, rings: i32, out: &mut Vec<&'a Record>) {
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
        let key = |x: &Record| {
            let d = (x.range_m - range_m).hypot(x.height_m - height_m);
            x.objective * (1.0 + d)
        };
        out.sort_by(|a, b| key(a).total_cmp(&key(b)));
    }

    /// True if records of a kind are around a target on all sides, within `rings` cells, or if there are too few
    /// records to decide.
    ///
    /// The records of a kind end at the edge of the reach. Beyond it all records are on one side.
    #[must_use]
    pub fn surrounds(&self, kind: u32, range_m: f64, height_m: f64, rings: i32) -> bool {
        let (r, h) = cell(range_m, height_m);
        let mut angles_rad: Vec<f64> = (-rings..=rings)
            .flat_map(|dr| (-rings..=rings).filter_map(move |dh| self.cells.get(&(r + dr, h + dh))))
            .flatten()
            .map(|i| &self.records[*i as usize])
            .filter(|x| x.kind == kind)
            .map(|x| (x.height_m - height_m).atan2(x.range_m - range_m))
            .collect();
        if angles_rad.len() < TELLING {
            return true;
        }
        angles_rad.sort_by(f64::total_cmp);
        let over_the_cut = angles_rad[0] + TAU - angles_rad[angles_rad.len() - 1];
        angles_rad.windows(2).map(|pair| pair[1] - pair[0]).fold(over_the_cut, f64::max) < PI
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beyond_the_edge_of_a_table_its_records_lie_on_one_side() {
        let place = |k: u32| Record {
            height_m: 0.1 * f64::from(k % 4),
            ..Record::example(1.0 + 0.1 * f64::from(k / 4))
        };
        let index = Index::new((0..16).map(place).collect());
        assert!(index.surrounds(0, 1.15, 0.12, 6));
        assert!(!index.surrounds(0, 1.35, 0.12, 6));
        assert!(!index.surrounds(0, 1.15, -0.02, 6));
    }

    #[test]
    fn too_few_records_do_not_show_where_the_edge_is() {
        let index = Index::new(vec![Record::example(1.0), Record::example(1.1)]);
        assert!(index.surrounds(0, 1.2, 0.0, 6));
        assert!(index.surrounds(1, 1.05, 0.0, 6));
    }
}
