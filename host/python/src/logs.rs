//! Logs as columns.

use std::path::PathBuf;

use host::error::ExpectedError;
use operator::log::candump::{Line, read_file};
use operator::log::facts::{Decoder, Fact, position};
use protocol::powercube::{Parameter, Reply, Value};
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyDict};

use crate::arrays::array;
use crate::calls::interruptible;
use crate::errors::refused;

/// Frames, what drives and controller say, as columns: doubles and bytes are arrays, words are lists.
#[pyfunction]
pub(crate) fn read_log(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyDict>> {
    let read = interruptible(py, move |_| {
        let recording = read_file(&path).map_err(ExpectedError::from)?;
        Ok((recording.tear.map(|tear| tear.to_string()), Columns::of(&recording.lines)))
    })?;
    let (torn, columns) = read.map_err(|error: ExpectedError| refused(&error))?;
    let all = columns.into_dict(py)?;
    all.set_item("torn", torn)?;
    Ok(all)
}

impl Columns {
    /// Doubles and bytes as arrays, words as lists.
    pub(crate) fn into_dict(self, py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
        let all = PyDict::new(py);
        for (table, names) in TABLES {
            let rows = &self.tables[*table as usize];
            for (column, name) in names.iter().enumerate() {
                let values: Vec<f64> = rows.iter().skip(column).step_by(names.len()).copied().collect();
                all.set_item(format!("{}.{name}", table.name()), array(py, &values))?;
            }
        }
        all.set_item("frames.data", PyByteArray::new(py, &self.data))?;
        all.set_item("group.state", self.states)?;
        all.set_item("records.severity", self.severities)?;
        all.set_item("records.text", self.texts)?;
        Ok(all)
    }
}

#[derive(Clone, Copy)]
enum Table {
    Frames,
    Positions,
    Currents,
    Joints,
    Group,
    Records,
}

impl Table {
    fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Positions => "positions",
            Self::Currents => "currents",
            Self::Joints => "joints",
            Self::Group => "group",
            Self::Records => "records",
        }
    }
}

/// Tables with the names of their columns of numbers. Flags are 0 and 1.
const TABLES: &[(Table, &[&str])] = &[
    (Table::Frames, &["t_s", "id", "extended", "sent", "length"]),
    (Table::Positions, &["t_s", "module", "position_rad"]),
    (Table::Currents, &["t_s", "module", "current_a"]),
    (Table::Joints, &["t_s", "joint", "q_rad", "qd_rad_s", "error_q_rad"]),
    (Table::Group, &["t_s", "fault_cause", "plan_s", "bus_load"]),
    (Table::Records, &["t_s"]),
];

/// Frames, and what drives and controller say.
#[derive(Default)]
pub(crate) struct Columns {
    /// Rows of numbers, one after the other, for each of [`TABLES`].
    tables: [Vec<f64>; TABLES.len()],
    /// Eight bytes for each frame, zeros behind the last one.
    data: Vec<u8>,
    /// State of the group, for each row of its table.
    states: Vec<String>,
    /// Severity and text, for each row of the records.
    severities: Vec<String>,
    texts: Vec<String>,
}

impl Columns {
    pub(crate) fn of(lines: &[Line]) -> Self {
        let mut columns = Self::default();
        let mut decoder = Decoder::default();
        for line in lines {
            columns.take_frame(line);
            if let Some(fact) = decoder.take(line.at, &line.frame) {
                columns.take_fact(line.at.as_secs_f64(), fact);
            }
        }
        columns
    }

    fn put<const N: usize>(&mut self, table: Table, row: [f64; N]) {
        self.tables[table as usize].extend(row);
    }

    fn take_frame(&mut self, line: &Line) {
        let frame = &line.frame;
        let flag = |set: bool| f64::from(u8::from(set));
        let sent = flag(line.sent == Some(true));
        let (id, data) = (f64::from(frame.id().raw()), frame.data());
        self.put(
            Table::Frames,
            [line.at.as_secs_f64(), id, flag(frame.is_extended()), sent, data.len() as f64],
        );
        let mut eight = [0; 8];
        eight[..data.len()].copy_from_slice(data);
        self.data.extend(eight);
    }

    fn take_fact(&mut self, t_s: f64, fact: Fact) {
        match fact {
            Fact::Reply { module, reply } => {
                let module = f64::from(module.get());
                if let Some((q_rad, _)) = position(&reply) {
                    self.put(Table::Positions, [t_s, module, q_rad]);
                } else if let Reply::Value(Parameter::Cur, Value::F32(a)) = reply {
                    self.put(Table::Currents, [t_s, module, a.into()]);
                }
            }
            Fact::Joints { joints, .. } => {
                for (joint, reported) in joints {
                    let [q, qd, error] =
                        [reported.q_rad, reported.qd_rad_s, reported.error_q_rad].map(f64::from);
                    self.put(Table::Joints, [t_s, f64::from(joint), q, qd, error]);
                }
            }
            Fact::Group { state, .. } => {
                let plan_s = f64::from(state.trajectory_time_us) * 1e-6;
                let load = f64::from(state.bus_load_permille) * 1e-3;
                self.put(Table::Group, [t_s, state.fault_cause.into(), plan_s, load]);
                self.states.push(state.state.to_string());
            }
            Fact::Record { severity, text, .. } => {
                self.put(Table::Records, [t_s]);
                self.severities.push(format!("{severity:?}").to_lowercase());
                self.texts.push(text);
            }
            _ => {}
        }
    }
}
