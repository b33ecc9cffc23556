//! Order: which drive is asked first.
//!
//! # Why the slowest drive goes first
//!
//! In a control cycle the last motion leaves the least time for its answer. At 3 ms and six joints 0.8 ms are left, and the
//! answer may wait for two other frames. A drive that needs 0.4 ms to answer is late there in every fourth cycle; in the first place it has
//! 1.2 ms more. So the drive with the longest answers gets the first slot.
//!
//! # How answers are timed
//!
//! Six drives that are asked at the same time wait for each other on the bus: the last one seems slower by up to 0.4 ms. While nothing
//! moves, the order turns by one place with each look, so each drive is the first one at times, and its shortest time is that of
//! the drive ([`DriveRecord::answer_us`](crate::groups::powercube::drives::DriveRecord::answer_us)).

use protocol::{JOINTS_MAX, JointIndex};

use crate::joints::PerJoint;

/// A permutation of the joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Order([u8; JOINTS_MAX]);

impl Order {
    /// From the base to the hand.
    pub const BASE_FIRST: Self = Self([0, 1, 2, 3, 4, 5, 6, 7]);

    /// From the base to the hand, beginning at joint `first` modulo `joints`.
    pub fn turned(joints: usize, first: usize) -> Self {
        let mut order = Self::BASE_FIRST;
        for (place, joint) in order.0.iter_mut().take(joints).enumerate() {
            *joint = (place + first).checked_rem(joints).unwrap_or(place) as u8;
        }
        order
    }

    /// Slowest answers first; of drives that are equally fast, the one nearer to the base.
    pub fn slowest_first(joints: usize, answer_us: &PerJoint<u32>) -> Self {
        let mut order = Self::BASE_FIRST;
        let us = |joint: u8| answer_us.0.get(usize::from(joint)).copied().unwrap_or(0);
        if let Some(used) = order.0.get_mut(..joints) {
            // Insertion sort of at most eight: stable, and without a path that panics.
            for end in 1..used.len() {
                for place in (1..=end).rev() {
                    let pair = used.get(place - 1).zip(used.get(place)).map(|(a, b)| (*a, *b));
                    if pair.is_none_or(|(before, after)| us(before) >= us(after)) {
                        break;
                    }
                    used.swap(place - 1, place);
                }
            }
        }
        order
    }

    /// The joint in a place.
    pub fn joint_at(&self, place: JointIndex) -> JointIndex {
        self.0.get(place.get()).and_then(|joint| JointIndex::new(usize::from(*joint)).ok()).unwrap_or(place)
    }
}

impl Default for Order {
    fn default() -> Self {
        Self::BASE_FIRST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joints(order: &Order, n: usize) -> Vec<usize> {
        JointIndex::first(n).map(|place| order.joint_at(place).get()).collect()
    }

    #[test]
    fn the_slowest_drive_is_first_and_equal_ones_keep_their_order() {
        let order = Order::slowest_first(6, &PerJoint([300, 500, 300, 700, 100, 500, 9_000, 9_000]));
        assert_eq!(joints(&order, 6), [3, 1, 5, 0, 2, 4]);
    }

    #[test]
    fn turned_orders_put_each_joint_first_once() {
        for n in 1..=JOINTS_MAX {
            let firsts: Vec<usize> = (0..n).map(|turn| joints(&Order::turned(n, turn), n)[0]).collect();
            assert_eq!(firsts, (0..n).collect::<Vec<_>>());
            for turn in 0..3 * n {
                let mut all = joints(&Order::turned(n, turn), n);
                all.sort_unstable();
                assert_eq!(all, (0..n).collect::<Vec<_>>());
            }
        }
    }
}
