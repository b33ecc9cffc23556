//! Scenario files of the simulated tracker, in TOML.
//!
//! ```toml
//! schema_version = 1
//! seed = 1
//!
//! [tracker]
//! rate_hz = 60
//! latency_s = 0.015
//! noise_mm = 0.1
//!
//! [[body]]
//! id = 0
//! position_mm = [2500, 0, 600]
//! rpy_deg = [0, 0, 90]             # Rz(yaw) Ry(pitch) Rx(roll)
//! velocity_mm_s = [0, 0, 0]
//!
//! [[fault]]
//! kind = "moved"                   # lost, unrecognised, bias, false-markers, frames-lost, delayed, restart
//! body = 0
//! by_mm = [0, 100, 0]
//! start_s = 5.0
//! length_s = 1.0                   # to the end if left out
//! ```

use std::path::Path;

use protocol::{Duration, Instant};
use robot_model::Pose;
use toml_reader::{DESCRIPTION_MAX_BYTES, DocumentError, Problem, Section, Source, Value, read_text};
use tracker_protocol::pose::quaternion_of_columns;

use super::options::{BodyMotion, BodyOptions, TrackerFault, TrackerFaultKind, TrackerOptions};
use crate::scenario::values::{period, seconds};

/// Version of these files that this program reads.
pub const SCHEMA_VERSION: i64 = 1;

const MAX_S: f64 = 1e6;
const MAX_MM: f64 = 1e5;

/// A file was refused: where, and why.
pub type TrackerScenarioError = DocumentError<Problem>;

/// Everything that a run depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackerScenario {
    pub options: TrackerOptions,
    /// Feeds all random streams.
    pub seed: u64,
}

impl TrackerScenario {
    /// Reads a file.
    pub fn load(path: &Path) -> Result<Self, TrackerScenarioError> {
        let file = path.display().to_string();
        match read_text(path, DESCRIPTION_MAX_BYTES) {
            Ok(text) => Self::from_toml(&file, &text),
            Err(error) => Err(DocumentError::of_file(&file, Problem::unreadable(&error))),
        }
    }

    /// Reads a text; `file` is its name in errors.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, TrackerScenarioError> {
        let source = Source { file, text };
        let document = source.parse()?;
        let root: Section<'_> = source.root(&document);
        root.schema("schema_version", SCHEMA_VERSION)?;
        let mut options = match root.optional("tracker", Value::section)? {
            Some(table) => tracker(&table)?,
            None => TrackerOptions::default(),
        };
        for table in root.sections("body")? {
            let body = body(&table)?;
            if options.bodies.iter().any(|other| other.id == body.id) {
                return Err(table.error("id", Problem::Invalid(format!("body {} is there already", body.id))));
            }
            options.bodies.push(body);
        }
        for table in root.sections("fault")? {
            let fault = tracker_fault(&table, &options.bodies)?;
            options.faults.push(fault);
        }
        let scenario = Self { options, seed: root.or("seed", 0, Value::count)? };
        root.finish()?;
        Ok(scenario)
    }
}

pub(crate) fn tracker(table: &Section<'_>) -> Result<TrackerOptions, TrackerScenarioError> {
    let d = TrackerOptions::default();
    let configurations = table.optional("configurations", |value| {
        let names: Vec<String> =
            value.items()?.iter().map(|item| item.text().map(str::to_owned)).collect::<Result<_, _>>()?;
        // Words of the command channel are separated by one blank.
        match names.iter().find(|name| name.is_empty() || !name.bytes().all(|byte| byte.is_ascii_graphic())) {
            Some(name) => Err(value.error(Problem::Invalid(format!("'{name}' is not one word of ASCII")))),
            None => Ok(names),
        }
    })?;
    let rate = |value: &Value<'_>| Ok(Duration::from_secs_f64(1.0 / value.number_in(0.1, 1000.0)?));
    let options = TrackerOptions {
        period: table.or("rate_hz", d.period, rate)?,
        latency: table.or("latency_s", d.latency, |v| seconds(v, 10.0))?,
        jitter: table.or("jitter_s", d.jitter, |v| seconds(v, 10.0))?,
        noise_mm: table.or("noise_mm", d.noise_mm, |v| v.number_in(0.0, 1000.0))?,
        noise_deg: table.or("noise_deg", d.noise_deg, |v| v.number_in(0.0, 90.0))?,
        first_frame: table.or("first_frame", d.first_frame, Value::count)?,
        unix_us: table.or("unix_us", d.unix_us, |v| Ok(v.integer(0..=4_000_000_000_000_000)? as u64))?,
        send_ts: table.or("send_ts", d.send_ts, Value::boolean)?,
        send_ts2: table.or("send_ts2", d.send_ts2, Value::boolean)?,
        send_markers: table.or("send_markers", d.send_markers, Value::boolean)?,
        divisor: table.or("divisor", d.divisor, |v| Ok(v.integer(1..=10)? as u64))?,
        running: table.or("running", d.running, Value::boolean)?,
        configurations: configurations.unwrap_or(d.configurations),
        bodies: Vec::new(),
        faults: Vec::new(),
    };
    table.finish()?;
    Ok(options)
}

fn position(value: &Value<'_>) -> Result<[f64; 3], TrackerScenarioError> {
    let numbers: [f64; 3] = value.numbers()?;
    if numbers.iter().all(|x| x.abs() <= MAX_MM) {
        Ok(numbers)
    } else {
        Err(value.error(Problem::Invalid(format!("each of -{MAX_MM} to {MAX_MM} mm"))))
    }
}

fn body(table: &Section<'_>) -> Result<BodyOptions, TrackerScenarioError> {
    let d = BodyMotion::at_rest([0.0; 3]);
    let rpy_deg: [f64; 3] = table.or("rpy_deg", [0.0; 3], Value::numbers)?;
    let matrix = Pose::from_rpy(rpy_deg.map(f64::to_radians), nalgebra::Vector3::zeros()).rot;
    let columns: [f64; 9] = std::array::from_fn(|i| matrix[(i % 3, i / 3)]);
    let rotation_wxyz = quaternion_of_columns(&columns)
        .map_err(|error| table.error("rpy_deg", Problem::Invalid(error.to_string())))?;
    let body = BodyOptions {
        id: table.required("id", |v| Ok(v.integer(0..=999)? as u32))?,
        motion: BodyMotion {
            position_mm: table.required("position_mm", position)?,
            rotation_wxyz,
            velocity_mm_s: table.or("velocity_mm_s", d.velocity_mm_s, position)?,
            swing_mm: table.or("swing_mm", d.swing_mm, position)?,
            swing_period: table.or("swing_period_s", d.swing_period, |v| period(v, MAX_S))?,
        },
    };
    table.finish()?;
    Ok(body)
}

#[derive(Clone, Copy)]
enum Kind {
    Lost,
    Unrecognised,
    Moved,
    Bias,
    FalseMarkers,
    FramesLost,
    Delayed,
    Restart,
}

pub(crate) fn tracker_fault(
    table: &Section<'_>,
    bodies: &[BodyOptions],
) -> Result<TrackerFault, TrackerScenarioError> {
    const KINDS: [(&str, Kind); 8] = [
        ("lost", Kind::Lost),
        ("unrecognised", Kind::Unrecognised),
        ("moved", Kind::Moved),
        ("bias", Kind::Bias),
        ("false-markers", Kind::FalseMarkers),
        ("frames-lost", Kind::FramesLost),
        ("delayed", Kind::Delayed),
        ("restart", Kind::Restart),
    ];
    let known = |value: &Value<'_>| {
        let id = value.integer(0..=999)? as u32;
        if bodies.iter().any(|body| body.id == id) {
            Ok(id)
        } else {
            Err(value.error(Problem::Invalid(format!("there is no body {id}"))))
        }
    };
    let body = || table.required("body", known);
    let by_mm = || table.required("by_mm", position);
    let kind = match table.required("kind", |v| v.word(&KINDS))? {
        Kind::Lost => TrackerFaultKind::Lost { body: body()? },
        Kind::Unrecognised => TrackerFaultKind::Unrecognised { body: body()? },
        Kind::Moved => TrackerFaultKind::Moved { body: body()?, by_mm: by_mm()? },
        Kind::Bias => TrackerFaultKind::Bias { by_mm: by_mm()? },
        Kind::FalseMarkers => TrackerFaultKind::FalseMarkers {
            count: table.or("count", 1, |v| Ok(v.integer(1..=100)? as u32))?,
        },
        Kind::FramesLost => TrackerFaultKind::FramesLost,
        Kind::Delayed => TrackerFaultKind::Delayed { by: table.required("by_s", |v| period(v, 60.0))? },
        Kind::Restart => TrackerFaultKind::Restart,
    };
    let from = Instant::ZERO + table.or("start_s", Duration::ZERO, |v| seconds(v, MAX_S))?;
    let length = table.optional("length_s", |v| period(v, MAX_S))?;
    let fault = TrackerFault {
        kind,
        from,
        until: length.map_or(Instant::FAR_FUTURE, |length| from + length),
        probability: table.or("probability", 1.0, |v| v.number_in(0.0, 1.0))?,
    };
    table.finish()?;
    Ok(fault)
}
