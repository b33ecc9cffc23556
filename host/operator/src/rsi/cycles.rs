//! Motion in the telegrams and answers of a log: set and measured axes by cycle.

use protocol::Duration;
use rsi_protocol::{Config, RobotState, Root, Telegram};

use super::log::{Entry, Line};
pub use crate::samples::Cycle;

/// The number of each cycle, from 0: a lost telegram has one too.
///
/// Computed from the numbers of the telegrams; if they disagree with the times by more than two cycles, from the times.
#[must_use]
pub fn numbers(cycles: &[Cycle], period_s: f64) -> Vec<u64> {
    let rise = |pair: &[Cycle]| pair[1].ipoc.saturating_sub(pair[0].ipoc);
    let step = cycles.windows(2).map(rise).filter(|rise| *rise > 0).min().unwrap_or(1);
    let mut number = 0;
    let next = cycles.windows(2).map(|pair| {
        let by_time = pair[1].at.saturating_since(pair[0].at).as_secs_f64() / period_s;
        let by_time = by_time.round().max(1.0) as u64;
        let by_number = rise(pair) / step;
        number += if by_number > 0 && by_number.abs_diff(by_time) <= 2 { by_number } else { by_time };
        number
    });
    std::iter::once(0).chain(next).take(cycles.len()).collect()
}

/// The cycles including those whose telegrams were lost: their set points are those of the next cycle, because the
/// robot has held them, and their axes are on a line between. Gaps of more than `most` cycles stay.
#[must_use]
pub fn without_gaps(cycles: &[Cycle], period_s: f64, most: u64) -> Vec<Cycle> {
    let numbers = numbers(cycles, period_s);
    let mut all: Vec<Cycle> = Vec::with_capacity(cycles.len());
    for (k, cycle) in cycles.iter().enumerate() {
        let gap = k.checked_sub(1).map_or(1, |before| numbers[k] - numbers[before]);
        if let Some(before) = all.last().filter(|_| (2..=most + 1).contains(&gap)).cloned() {
            for i in 1..gap {
                let share = i as f64 / gap as f64;
                let between = |axis: usize| {
                    before.actual_deg[axis] + share * (cycle.actual_deg[axis] - before.actual_deg[axis])
                };
                all.push(Cycle {
                    at: before.at
                        + Duration::from_micros(cycle.at.saturating_since(before.at).as_micros() * i / gap),
                    ipoc: before.ipoc + cycle.ipoc.saturating_sub(before.ipoc) / gap * i,
                    actual_deg: std::array::from_fn(between),
                    ..cycle.clone()
                });
            }
        }
        all.push(cycle.clone());
    }
    all
}

/// The outputs that the last answer of a log sets. Only the robot's next telegram would show whether it accepted the answer.
#[must_use]
pub fn last_outputs(lines: &[Line], output: &str) -> Option<f64> {
    lines.iter().rev().find_map(|line| match &line.entry {
        Entry::Answer(bytes) => {
            let document = Telegram::parse(bytes, Root::Sen).ok()?;
            document.element(output)?.text.trim().parse().ok()
        }
        _ => None,
    })
}

/// Whether bit `bit` of outputs is set.
#[must_use]
pub fn is_set(outputs: f64, bit: u8) -> bool {
    (outputs as i64) >> bit & 1 == 1
}

/// The cycles of a log. `output` and `sensor` are names of the configuration.
///
/// A correction is in force from the next telegram on, unless the robot counts that answer as late. A repeated
/// telegram is the same cycle: networks double datagrams, and a robot in lock step repeats its first telegram until
/// it is answered.
#[must_use]
pub fn cycles(lines: &[Line], config: &Config, output: &str, sensor: Option<&str>) -> Vec<Cycle> {
    let correction_name = config
        .axis_correction()
        .and_then(|places| config.receive.get(places[0]))
        .map(|entry| entry.tag.element.clone())
        .unwrap_or_default();
    let mut all: Vec<Cycle> = Vec::new();
    let (mut in_force, mut answered) = (([0.0; 6], 0.0), None::<([f64; 6], f64)>);
    for line in lines {
        match &line.entry {
            Entry::Telegram(bytes) => {
                let Ok(document) = Telegram::parse(bytes, Root::Rob) else { continue };
                let Ok(state) = RobotState::read(&document) else { continue };
                let Some(actual_deg) = state.aipos_deg else {
                    // A new run: corrections begin at zero.
                    (in_force, answered) = (([0.0; 6], 0.0), None);
                    continue;
                };
                let ipoc = document.ipoc.value();
                if all.last().is_some_and(|last| last.ipoc == ipoc) {
                    continue;
                }
                let late = state.delay.unwrap_or(0);
                let missed = all.last().is_some_and(|last| late > last.late);
                if let Some(answered) = answered.take().filter(|_| !missed) {
                    in_force = answered;
                }
                let start_deg =
                    state.aspos_deg.unwrap_or_else(|| all.last().map_or(actual_deg, |last| last.start_deg));
                let fingers_open = sensor.and_then(|name| {
                    let value = document.element(name)?.text.trim().parse::<f64>().ok()?;
                    Some(value != 0.0)
                });
                all.push(Cycle {
                    at: line.at,
                    ipoc,
                    start_deg,
                    set_deg: std::array::from_fn(|axis| start_deg[axis] + in_force.0[axis]),
                    actual_deg,
                    outputs: in_force.1,
                    fingers_open,
                    late,
                });
            }
            Entry::Answer(bytes) => {
                let Ok(document) = Telegram::parse(bytes, Root::Sen) else { continue };
                let six = ["A1", "A2", "A3", "A4", "A5", "A6"];
                let Some(Ok(deg)) = document.element(&correction_name).map(|element| element.six(&six))
                else {
                    continue;
                };
                let outputs = document.element(output).and_then(|element| element.text.trim().parse().ok());
                answered = Some((deg, outputs.unwrap_or(0.0)));
            }
            _ => {}
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use hil_sim::krc::KrcScenario;
    use protocol::Instant;

    #[test]
    fn telegram_that_comes_again_is_the_same_cycle() {
        let described = KrcScenario::open("kr-c2").expect("built in");
        let telegram = |ipoc: u64| {
            let six = "A1=\"0\" A2=\"-90\" A3=\"90\" A4=\"0\" A5=\"90\" A6=\"0\"";
            format!("<Rob TYPE=\"KUKA\"><AIPos {six}/><IPOC>{ipoc}</IPOC></Rob>").into_bytes()
        };
        let answer = |ipoc: u64| {
            let six = "A1=\"1\" A2=\"0\" A3=\"0\" A4=\"0\" A5=\"0\" A6=\"0\"";
            format!("<Sen Type=\"ImFree\"><AKorr {six}/><DiO>1</DiO><IPOC>{ipoc}</IPOC></Sen>").into_bytes()
        };
        let lines: Vec<Line> = [7, 7, 7, 8, 10]
            .into_iter()
            .flat_map(|ipoc| [Entry::Telegram(telegram(ipoc)), Entry::Answer(answer(ipoc))])
            .zip(0..)
            .map(|(entry, k)| Line { at: Instant::from_micros(k), entry })
            .collect();
        let table = cycles(&lines, &described.config, "DiO", None);
        assert_eq!(table.iter().map(|cycle| cycle.ipoc).collect::<Vec<_>>(), [7, 8, 10]);
        // The answer is in force from the next number on, not from the copy on.
        assert_eq!(table.iter().map(|cycle| cycle.set_deg[0]).collect::<Vec<_>>(), [0.0, 1.0, 1.0]);
    }
}
