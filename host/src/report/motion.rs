//! The motion of an industrial robot as a table: set and actual axes of every cycle.

use std::fmt::Write;
use std::path::Path;

use operator::rsi::cell::Seen;
use operator::rsi::cycles::Cycle;
use operator::samples::{At, JointSamples, Samples};
use protocol::{Duration, Instant};

use crate::error::ExpectedError;

/// One cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
    /// Time, s; of a table that was written: since the start of the plan.
    pub t_s: f64,
    /// Number of the telegram.
    pub ipoc: u64,
    /// Set point in force, deg.
    pub set_deg: [f64; 6],
    /// Actual axes, deg: true ones of a simulated robot, measured ones else.
    pub actual_deg: [f64; 6],
    /// Outputs in force.
    pub outputs: i64,
    pub late: u64,
}

/// The motion that the simulated robot reports.
pub fn of_robot(seen: &Seen) -> Vec<Row> {
    let row = |cycle: &hil_sim::krc::CycleRecord| Row {
        t_s: cycle.at.as_secs_f64(),
        ipoc: cycle.ipoc,
        set_deg: cycle.set_deg,
        actual_deg: cycle.actual_deg,
        outputs: cycle.outputs.into(),
        late: cycle.late,
    };
    seen.cycles.iter().map(row).collect()
}

/// The motion in telegrams and answers.
pub fn of_telegrams(cycles: &[Cycle]) -> Vec<Row> {
    let row = |cycle: &Cycle| Row {
        t_s: cycle.at.as_secs_f64(),
        ipoc: cycle.ipoc,
        set_deg: cycle.set_deg,
        actual_deg: cycle.actual_deg,
        outputs: cycle.outputs as i64,
        late: cycle.late,
    };
    cycles.iter().map(row).collect()
}

/// The table as text; time from the start of the plan, if it began.
pub fn csv(rows: &[Row], started_at: Option<Instant>) -> String {
    let start_s = started_at.map_or(0.0, Instant::as_secs_f64);
    let mut text = String::from("t_s,ipoc");
    for kind in ["set", "actual"] {
        for axis in 1..=6 {
            let _ = write!(text, ",{kind}_a{axis}_deg");
        }
    }
    text.push_str(",outputs,late\n");
    for row in rows {
        let _ = write!(text, "{:.6},{}", row.t_s - start_s, row.ipoc);
        for q_deg in row.set_deg.iter().chain(&row.actual_deg) {
            let _ = write!(text, ",{q_deg:.6}");
        }
        let _ = writeln!(text, ",{},{}", row.outputs, row.late);
    }
    text
}

/// The actual axes as samples. Time of the samples is that of the table, from its first row on.
#[must_use]
pub fn samples(rows: &[Row]) -> Samples {
    let first_s = rows.first().map_or(0.0, |row| row.t_s.min(0.0));
    let since_first = |t_s: f64| Instant::ZERO + Duration::from_secs_f64((t_s - first_s).max(0.0));
    let joint = |axis: usize| JointSamples {
        positions: rows
            .iter()
            .map(|row| At { at: since_first(row.t_s), value: row.actual_deg[axis].to_radians() })
            .collect(),
        ..JointSamples::default()
    };
    Samples { joints: (0..6).map(joint).collect(), begun: Some(since_first(0.0)), ..Samples::default() }
}

/// Reads a table that [`csv()`] wrote.
///
/// # Errors
/// A line has not 16 numbers.
pub fn read(path: &Path, text: &str) -> Result<Vec<Row>, ExpectedError> {
    let parse = |line: &str| {
        let numbers: Vec<f64> = line.split(',').map(str::parse).collect::<Result<_, _>>().ok()?;
        let numbers: [f64; 16] = numbers.try_into().ok()?;
        Some(Row {
            t_s: numbers[0],
            ipoc: numbers[1] as u64,
            set_deg: std::array::from_fn(|axis| numbers[2 + axis]),
            actual_deg: std::array::from_fn(|axis| numbers[8 + axis]),
            outputs: numbers[14] as i64,
            late: numbers[15] as u64,
        })
    };
    text.lines()
        .enumerate()
        .skip(1)
        .map(|(k, line)| {
            parse(line).ok_or_else(|| {
                ExpectedError::bad_input(&format!(
                    "{}, line {}: not a row of a motion",
                    path.display(),
                    k + 1
                ))
            })
        })
        .collect()
}
