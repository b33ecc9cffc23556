//! Which telegram is new, which is old, and which may begin another program run (pure).
//!
//! | telegram | is |
//! |---|---|
//! | the same number again | doubled: no second answer |
//! | a lower number, once or twice | overtaken on the way: no answer, its positions are old |
//! | lower numbers that ascend, three in a row | a break |
//! | without positions, with a new number | a break (the first of a KR C2) |
//! | another start pose, another socket | a break |
//! | the first one after a second of silence | a break |
//!
//! After a break nothing is known of the correction in force: `doubt` finds it out. A count of late answers that falls is no
//! break: some robots count late answers in a row.

use protocol::{Duration, Instant};

use super::packet::Telegram;
use crate::joints::PerJoint;

/// Ascending lower numbers that make a new run.
const LOWER_ROW: u8 = 3;
/// Longer silence ends a run.
const SILENCE: Duration = Duration::from_secs(1);
/// Start poses nearer than this are one, rad: half a step of one decimal of a degree, the coarsest that is sent.
const SAME_POSE_RAD: f32 = 1e-3;

/// Whether two start poses are one. NaN is no pose.
pub(super) fn is_same_pose(PerJoint(a): &PerJoint<f32>, PerJoint(b): &PerJoint<f32>) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= SAME_POSE_RAD)
}

/// What a telegram is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// The next of the run.
    Next,
    /// Perhaps the first of another run.
    Break,
    /// Not to be answered.
    Old,
}

/// Order of the telegrams of a run.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Order {
    last: Option<(u64, Instant)>,
    /// Number of a telegram without positions.
    empty: Option<u64>,
    /// Last of the lower numbers in a row, and how many.
    lower: Option<(u64, u8)>,
    start_rad: Option<PerJoint<f32>>,
}

impl Order {
    /// Says what a telegram is, and takes it into account.
    pub(super) fn judge(&mut self, now: Instant, telegram: &Telegram) -> Kind {
        let kind = self.kind(now, telegram);
        match kind {
            Kind::Old => return kind,
            Kind::Break => *self = Self { empty: self.empty, ..Self::default() },
            Kind::Next => {}
        }
        if telegram.q_rad.is_none() {
            self.empty = Some(telegram.ipoc);
        }
        self.last = Some((telegram.ipoc, now));
        self.lower = None;
        self.start_rad = telegram.start_rad.or(self.start_rad);
        kind
    }

    fn kind(&mut self, now: Instant, telegram: &Telegram) -> Kind {
        let Some((last, at)) = self.last else { return Kind::Break };
        if telegram.new_connection || now.saturating_since(at) >= SILENCE {
            return Kind::Break;
        }
        if telegram.ipoc == last || (telegram.q_rad.is_none() && self.empty == Some(telegram.ipoc)) {
            return Kind::Old;
        }
        if telegram.q_rad.is_none() {
            return Kind::Break;
        }
        let moved = matches!((self.start_rad, telegram.start_rad), (Some(old), Some(new)) if !is_same_pose(&old, &new));
        if moved {
            return Kind::Break;
        }
        if telegram.ipoc < last {
            let row = match self.lower {
                Some((before, row)) if telegram.ipoc > before => row.saturating_add(1),
                _ => 1,
            };
            self.lower = Some((telegram.ipoc, row));
            return if row >= LOWER_ROW { Kind::Break } else { Kind::Old };
        }
        Kind::Next
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn telegram(ipoc: u64) -> Telegram {
        let pose = Some(PerJoint::splat(0.5));
        Telegram { ipoc, q_rad: pose, start_rad: pose, late: Some(0), new_connection: false }
    }

    fn order_at(last: u64) -> Order {
        let mut order = Order::default();
        assert_eq!(order.judge(Instant::from_micros(0), &telegram(last)), Kind::Break);
        order
    }

    fn judge(order: &mut Order, at_ms: u64, telegram: &Telegram) -> Kind {
        order.judge(Instant::from_micros(1_000 * at_ms), telegram)
    }

    #[test]
    fn doubled_and_overtaken_telegrams_are_old_and_do_not_end_the_run() {
        let mut order = order_at(100);
        assert_eq!(judge(&mut order, 12, &telegram(102)), Kind::Next);
        assert_eq!(judge(&mut order, 13, &telegram(101)), Kind::Old);
        assert_eq!(judge(&mut order, 14, &telegram(102)), Kind::Old);
        assert_eq!(judge(&mut order, 24, &telegram(103)), Kind::Next);
    }

    #[test]
    fn each_sign_of_a_new_run_is_a_break_and_fewer_late_answers_are_not() {
        let pose = Some(PerJoint::splat(0.6));
        let base = telegram(101);
        for (name, sign) in [
            ("no positions", Telegram { q_rad: None, start_rad: None, late: None, ..telegram(4710) }),
            ("start pose", Telegram { start_rad: pose, ..base }),
            ("socket", Telegram { new_connection: true, ..base }),
        ] {
            assert_eq!(judge(&mut order_at(100), 12, &sign), Kind::Break, "{name}");
        }
        let mut order = order_at(100);
        assert_eq!(judge(&mut order, 12, &Telegram { late: Some(4), ..base }), Kind::Next);
        assert_eq!(judge(&mut order, 24, &Telegram { late: Some(0), ..telegram(102) }), Kind::Next);
        assert_eq!(judge(&mut order_at(100), 1_001, &base), Kind::Break, "silence");
        let mut order = order_at(100);
        let kinds = [5, 6, 7].map(|ipoc| judge(&mut order, 12, &telegram(ipoc)));
        assert_eq!(kinds, [Kind::Old, Kind::Old, Kind::Break]);
        let mut order = order_at(100);
        let kinds = [99, 98, 97, 96].map(|ipoc| judge(&mut order, 12, &telegram(ipoc)));
        assert_eq!(kinds, [Kind::Old; 4], "descending numbers are no run");
    }
}
