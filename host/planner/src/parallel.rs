//! Work on all cores.
//!
//! The search is compiled for each number of joints, and parallel iterators for each closure. Only `on_all_cores`
//! uses them, so that they are compiled once.

use std::sync::atomic::{AtomicBool, Ordering};
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

/// As [`each`] for work that can fail. After a failure no more work begins.
///
/// # Errors
/// The failure of the first item in order, of those that were worked on.
pub fn try_each<I: Sync, T: Send, E: Send>(
    items: &[I],
    work: impl Fn(&I) -> Result<T, E> + Sync,
) -> Result<Vec<T>, E> {
    let failed = AtomicBool::new(false);
    let made = each(items, |item| {
        (!failed.load(Ordering::Relaxed)).then(|| {
            let new = work(item);
            failed.fetch_or(new.is_err(), Ordering::Relaxed);
            new
        })
    });
    made.into_iter().flatten().collect()
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

    #[test]
    fn a_failure_is_returned_and_without_one_all_results_are() {
        let items: Vec<u64> = (0..1000).collect();
        let of = |bad: u64| try_each(&items, |k| if *k == bad { Err(*k) } else { Ok(2 * k) });
        assert_eq!(of(700), Err(700));
        assert_eq!(of(1000), Ok((0..1000).map(|k| 2 * k).collect()));
    }
}
