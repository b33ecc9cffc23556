//! Control cycles and answer times, from the frames alone.

use std::collections::BTreeMap;

use protocol::Frame;
use protocol::powercube::{Address, Channel, Command};
use serde::Serialize;

use super::PlanClock;
use super::collect::Heard;
use super::distribution::Distribution;
use crate::log::candump::Line;

/// Control cycles: time between two motion commands to the same drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Cycles {
    /// Period set in the controller, s; `None` if it is not known.
    pub nominal_s: Option<f64>,
    /// Measured, s, over all drives.
    pub period_s: Option<Distribution>,
    /// Distance of the measured ones from their median, s.
    pub deviation_s: Option<Distribution>,
}

/// Answers: time from the end of a request to the end of its answer, both on the bus.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Answers {
    /// Of all drives, s.
    pub latency_s: Option<Distribution>,
    /// By address of the drive, s.
    pub by_module: BTreeMap<u8, Distribution>,
    /// Requests that were not answered at all, or not before the same request was repeated.
    pub unanswered: usize,
    pub unasked: usize,
}

/// Cycles while the plan ran.
#[must_use]
pub fn cycles(heard: &Heard, end_t_s: f64) -> Cycles {
    let mut periods = Vec::new();
    for drive in &heard.joints {
        let times: Vec<f64> =
            drive.commands.iter().map(|c| c.t_s).filter(|t_s| (0.0..=end_t_s).contains(t_s)).collect();
        periods.extend(times.windows(2).map(|pair| pair[1] - pair[0]));
    }
    let period_s = Distribution::of(periods.iter().copied());
    let deviation_s =
        period_s.and_then(|p| Distribution::of(periods.iter().map(|period| (period - p.median).abs())));
    let reported = heard.group.iter().find(|(t_s, _)| *t_s > 0.0).or(heard.group.last());
    let nominal_s = reported.map(|(_, group)| f64::from(group.cycle_us) * 1e-6).filter(|s| *s > 0.0);
    Cycles { nominal_s, period_s, deviation_s }
}

/// What an answer repeats of its request: module, command, and the number that follows it.
type Key = (u8, u8, u8);

fn key(module: u8, frame: &Frame) -> Option<Key> {
    let command = *frame.data().first()?;
    let with_number = [Command::SetParameter, Command::GetParameter, Command::SetMotion].map(Command::code);
    let number = if with_number.contains(&command) { *frame.data().get(1)? } else { 0 };
    Some((module, command, number))
}

/// Answers while the plan ran.
#[must_use]
pub fn answers(frames: &[Line], clock: PlanClock, end_t_s: f64) -> Answers {
    let mut waiting: BTreeMap<Key, f64> = BTreeMap::new();
    let mut latencies: BTreeMap<u8, Vec<f64>> = BTreeMap::new();
    let mut answers = Answers::default();
    for line in frames {
        let t_s = clock.t_s(line.at);
        if t_s < 0.0 {
            continue;
        }
        let Some(Address::Module(channel, module)) = Address::of(line.frame.id()) else { continue };
        let Some(key) = key(module.get(), &line.frame) else { continue };
        match channel {
            Channel::Get | Channel::Put if t_s <= end_t_s => {
                answers.unanswered += usize::from(waiting.insert(key, t_s).is_some());
            }
            Channel::Ack => match waiting.remove(&key) {
                Some(asked_t_s) => latencies.entry(module.get()).or_default().push(t_s - asked_t_s),
                // The request may have been sent just before the plan began.
                None if t_s <= end_t_s => answers.unasked += usize::from(t_s > FIRST_S),
                None => {}
            },
            Channel::Get | Channel::Put | Channel::State => {}
        }
    }
    answers.unanswered += waiting.len();
    answers.latency_s = Distribution::of(latencies.values().flatten().copied());
    answers.by_module = latencies
        .into_iter()
        .filter_map(|(module, of_module)| Some((module, Distribution::of(of_module)?)))
        .collect();
    answers
}

/// Answers this soon after the start may belong to requests from before it, s.
const FIRST_S: f64 = 0.02;
