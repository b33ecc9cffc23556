//! When runs began, in time of the log.
//!
//! During a run, each state message of the controller contains its own clock and the time along the plan, so their
//! difference is the start in the controller's clock, to the microsecond. The message with the shortest delay
//! relates the two clocks: no message arrives before it was made, so the smallest difference between arrival time
//! and time stamp is the offset. Only messages near the run are used, because clocks drift (50 µs/s for a poor
//! crystal).

use protocol::Instant;
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use serde::Serialize;

use crate::samples::GroupTold;

/// How the start was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartFrom {
    /// The caller knew it.
    Given,
    /// From the state messages of the controller.
    Telemetry,
}

/// Messages this long before and after the run tie the clocks together, µs.
const NEAR_US: i64 = 2_000_000;
/// Starts nearer to each other than this are one: the shortest run is longer, µs.
const SAME_RUN_US: i64 = 1_000;
/// Starts of all runs, in order: the way to the start of a throw and the way back are runs too.
#[must_use]
pub fn find(group: &[GroupTold]) -> Vec<Instant> {
    let messages: Vec<(i64, GroupState)> =
        group.iter().map(|reported| (reported.made_by.as_micros() as i64, reported.state)).collect();
    let mut starts = Vec::new();
    let mut last_us = None;
    for (ran_us, run) in messages.iter().filter(|(_, group)| is_on_path(group)) {
        let start_us = run.uptime_us as i64 - i64::from(run.trajectory_time_us);
        if last_us.is_some_and(|last: i64| (start_us - last).abs() < SAME_RUN_US) {
            continue;
        }
        last_us = Some(start_us);
        let near = messages.iter().filter(|(at_us, _)| (at_us - ran_us).abs() <= NEAR_US);
        let offset_us = near.map(|(at_us, group)| at_us - group.uptime_us as i64).min();
        starts.extend(
            offset_us.and_then(|offset| u64::try_from(start_us + offset).ok()).map(Instant::from_micros),
        );
    }
    starts
}

/// The path runs as planned: in Stopping it is slowed down.
fn is_on_path(group: &GroupState) -> bool {
    group.state == State::Running && group.trajectory_time_us > 0
}
