//! The counter of late answers.

use std::collections::VecDeque;

use super::options::LateOptions;

/// What one more answer, in time or late, means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LateVerdict {
    pub over_limit: bool,
    /// The share of late answers has just come over the limit in percent.
    pub over_percent: bool,
}

/// Counts late answers: all or in a row, and as a share of the last ones.
#[derive(Clone, Debug)]
pub struct LateCounter {
    options: LateOptions,
    total: u64,
    in_a_row: u64,
    recent: VecDeque<bool>,
    recent_late: usize,
    warned: bool,
}

impl LateCounter {
    /// At zero.
    pub fn new(options: LateOptions) -> Self {
        Self { options, total: 0, in_a_row: 0, recent: VecDeque::new(), recent_late: 0, warned: false }
    }

    /// The value that telegrams carry (`Delay`).
    pub fn value(&self) -> u64 {
        if self.options.consecutive { self.in_a_row } else { self.total }
    }

    /// Late answers in all.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// Counts the end of one window.
    pub fn count(&mut self, late: bool) -> LateVerdict {
        if late {
            self.total += 1;
            self.in_a_row += 1;
        } else {
            self.in_a_row = 0;
        }
        let over_percent = self.count_share(late);
        LateVerdict { over_limit: self.value() > self.options.limit, over_percent }
    }

    /// Whether the share comes over its limit now. It is judged once the window is full.
    fn count_share(&mut self, late: bool) -> bool {
        let window = self.options.field_of_view.max(1);
        self.recent.push_back(late);
        self.recent_late += usize::from(late);
        if self.recent.len() > window && self.recent.pop_front() == Some(true) {
            self.recent_late -= 1;
        }
        let over = self.recent.len() == window
            && self.recent_late as f64 * 100.0 > self.options.percent * window as f64;
        let crossed = over && !self.warned;
        self.warned = over;
        crossed
    }
}
