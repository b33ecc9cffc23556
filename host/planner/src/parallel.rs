//! Work on all cores.
//!
//! The search is compiled for each number of joints, and parallel iterators for each closure. Only `on_all_cores` touches them, so
//! that they are compiled once.

use std::sync::{Mutex, PoisonError};

use rayon::iter::{IntoParallelIterator, ParallelIterator};

/// What `work` makes of each item, in the order of the items.
pub fn each<I: Sync, T: Send>(items: &[I], work: impl Fn(&I) -> T + Sync) -> Vec<T> {
    let made: Vec<Mutex<Option<T>>> = items.iter().map(|_| Mutex::new(None)).collect();
    on_all_cores(items.len(), &|k| {
        let new = work(&items[k]);
        *made[k].lock().unwrap_or_else(PoisonError::into_inner) = Some(new);
    });
    made.into_iter().filter_map(|one| one.into_inner().unwrap_or_else(PoisonError::into_inner)).collect()
}

/// Calls `work` once with each number below `count`, in any order.
fn on_all_cores(count: usize, work: &(dyn Fn(usize) + Sync)) {
    (0..count).into_par_iter().for_each(work);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_have_the_order_of_the_items() {
        let items: Vec<u64> = (0..1000).collect();
        let found = each(&items, |k| (*k, k * k));
        assert_eq!(found, items.iter().map(|k| (*k, k * k)).collect::<Vec<_>>());
        assert!(each(&[] as &[u64], |k| *k).is_empty());
    }
}
