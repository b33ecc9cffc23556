//! Which stored throws to try first: the price that each is expected to have at a target near its own.

use nalgebra::Vector2;

use crate::store::{Index, Record};

/// Cells of the index that are looked through, at most, in every direction.
pub(super) const RINGS: i32 = 6;
/// What distance adds to an expected price, per m²: 2 % at 5 cm, where slopes begin to be wrong.
const DISTANCE_CHARGE: f64 = 8.0;
/// How much a refutation counts on the way to where it was found, as a power of the share of the way.
const REFUTED_POWER: f64 = 0.7;
/// Throws stored for points nearer than this are for the same point, in m.
const SAME_POINT_M: f64 = 1e-3;

/// A stored throw with its expected price at the target.
pub(crate) type WarmStart<'i> = (f64, &'i Record);

/// Stored throws around a target (range and height in m), the cheapest first; at most `most`.
///
/// The expected price of a throw is its own, carried to the target by its own slope, and a charge for the distance.
/// That is far too low if the price has a cliff (between a ball that is dropped and one that is thrown) between the
/// two. So it is compared with the throws stored on the other side: if a known best price is above the expectation
/// at that point, the expectation is wrong there, and by part of that already at the target.
pub(crate) fn warm_starts<'i>(
    index: &'i Index,
    kind: u32,
    range_m: f64,
    height_m: f64,
    most: usize,
) -> Vec<WarmStart<'i>> {
    let mut near = Vec::new();
    index.near(kind, range_m, height_m, RINGS, &mut near);
    let target = Vector2::new(range_m, height_m);
    let known = best_known(&near);
    let mut order: Vec<WarmStart<'i>> = near
        .iter()
        .map(|record| {
            let way = target - place(record);
            let price = carried(record, &target) + refutation(record, &way, &known);
            (price * (1.0 + DISTANCE_CHARGE * way.norm_squared()), *record)
        })
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    order.truncate(most);
    order
}

fn place(record: &Record) -> Vector2<f64> {
    Vector2::new(record.range_m, record.height_m)
}

/// The price of a record carried to a point by its slope.
fn carried(record: &Record, point: &Vector2<f64>) -> f64 {
    let way = point - place(record);
    let price = record.objective + Vector2::from(record.slope_per_m).dot(&way);
    // No throw is cheaper than the cheapest of all; slopes end somewhere.
    price.max(0.5 * record.objective)
}

/// The cheapest record of every point.
fn best_known<'i>(near: &[&'i Record]) -> Vec<&'i Record> {
    let mut known: Vec<&Record> = Vec::with_capacity(near.len());
    for record in near {
        match known.iter_mut().find(|k| (place(k) - place(record)).norm() < SAME_POINT_M) {
            Some(same) if record.objective < same.objective => *same = record,
            Some(_) => {}
            None => known.push(record),
        }
    }
    known
}

/// Error of a record's expected price at distance `way` from it, from the known prices beyond the target.
fn refutation(record: &Record, way: &Vector2<f64>, known: &[&Record]) -> f64 {
    let distance = way.norm();
    let mut worst = 0.0_f64;
    for other in known {
        let there = place(other);
        let too_good = other.objective - carried(record, &there);
        let beyond = there - place(record);
        let along = way.dot(&beyond);
        if too_good <= 0.0 || along <= 0.0 {
            continue;
        }
        let share = distance / (distance + (beyond - way).norm());
        let cos = along / (distance * beyond.norm());
        worst = worst.max(too_good * share.powf(REFUTED_POWER) * cos * cos);
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(range_m: f64, objective: f64, slope: f64) -> Record {
        Record { objective, slope_per_m: [slope, 0.0], ..Record::example(range_m) }
    }

    #[test]
    fn an_expected_price_across_a_cliff_is_corrected_by_the_throw_beyond() {
        // A plateau up to 1.0 m, then a steep rise.
        let index = Index::new(vec![record(1.0, 12.4, 0.0), record(1.1, 25.0, 150.0)]);
        let first = |range_m| warm_starts(&index, 0, range_m, 0.0, 2)[0].1.range_m;
        assert_eq!(first(1.07), 1.1);
        assert_eq!(first(0.99), 1.0);
    }

    #[test]
    fn an_even_slope_is_believed_from_both_sides() {
        let index = Index::new(vec![record(1.0, 20.0, 50.0), record(1.1, 25.0, 50.0)]);
        for (price, _) in warm_starts(&index, 0, 1.05, 0.0, 2) {
            assert!((price - 22.5).abs() < 0.5, "{price}");
        }
    }
}
