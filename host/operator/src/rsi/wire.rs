//! Telegrams and answers as XML, with the names of the user's configuration file.

use firmware::groups::rsi::{Answer, Telegram};
use firmware::joints::PerJoint;
use protocol::{JOINTS_MAX, JointIndex};
use rsi_protocol::{
    Config, Internal, Ipoc, ReadError, ReceiveEntry, RobotState, Root, SensorWriter, Source,
    Telegram as Document, Value, ValueType, WriteError,
};

/// Decimals of corrections: usually at most 6, and a millionth of a degree is below every resolution of the robot.
const DECIMALS: u8 = 6;

/// The configuration file does not describe a link that can lead a robot.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigUnfit {
    /// No six axis corrections.
    #[error("the RSI configuration receives no axis corrections A1 to A6")]
    NoAxes,
    /// A late answer would throw the arm back to its start in one cycle.
    #[error("{tag} has HOLDON=\"0\": after one late answer the robot would leap back to its start pose")]
    NoHold {
        /// Name of the XML element.
        tag: String,
    },
    /// Nothing opens the gripper.
    #[error("the RSI configuration receives no {name}")]
    NoOutput { name: String },
    /// The robot does not send its axes.
    #[error("the RSI configuration sends no actual axes")]
    NoPositions,
    /// The robot does not wait for answers.
    #[error("the RSI configuration says ONLYSEND: the robot takes no corrections")]
    OnlySend,
}

impl ConfigUnfit {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::NoAxes => "add six RECEIVE elements AKorr.A1 to AKorr.A6 with HOLDON=\"1\"".to_owned(),
            Self::NoHold { .. } => "set HOLDON=\"1\" for all axis corrections".to_owned(),
            Self::NoOutput { name, .. } => {
                format!("add a RECEIVE element {name} of TYPE LONG for the outputs, HOLDON=\"1\"")
            }
            Self::NoPositions => "add a SEND element DEF_AIPos".to_owned(),
            Self::OnlySend => "set ONLYSEND to FALSE".to_owned(),
        })
    }
}

/// Scalars of the configuration file, by the names that the user gave them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Names<'a> {
    /// Sets outputs.
    pub outputs: &'a str,
    /// Bit of it that opens the gripper.
    pub output_bit: u8,
    /// Ends the robot's program. A configuration without it is accepted; then the program must be ended at the robot.
    pub stop: &'a str,
}

/// Reads telegrams and writes answers.
#[derive(Clone, Debug)]
pub struct Wire {
    config: Config,
    axes: [usize; 6],
    output: usize,
    output_bit: u8,
    stop: Option<usize>,
}

impl Wire {
    /// For a configuration; `names` are the names of its scalars that are used here.
    pub fn new(config: &Config, names: &Names<'_>) -> Result<Self, ConfigUnfit> {
        if config.only_send {
            return Err(ConfigUnfit::OnlySend);
        }
        let axes = config.axis_correction().ok_or(ConfigUnfit::NoAxes)?;
        for entry in axes.iter().filter_map(|place| config.receive.get(*place)) {
            if !entry.hold {
                return Err(ConfigUnfit::NoHold { tag: entry.tag.to_string() });
            }
        }
        let no_output = || ConfigUnfit::NoOutput { name: names.outputs.to_owned() };
        let output = config.scalar(names.outputs).ok_or_else(no_output)?;
        let sends_axes = config.send.iter().any(|entry| entry.source == Source::Internal(Internal::AIPos));
        if !sends_axes {
            return Err(ConfigUnfit::NoPositions);
        }
        let stop = config.scalar(names.stop);
        Ok(Self { config: config.clone(), axes, output, output_bit: names.output_bit, stop })
    }

    /// Reads a telegram; `new_connection`: it came from another socket than the one before.
    pub fn read(&self, bytes: &[u8], new_connection: bool) -> Result<(Telegram, Ipoc), ReadError> {
        let document = Document::parse(bytes, Root::Rob)?;
        let state = RobotState::read(&document)?;
        let radians = |deg: [f64; 6]| {
            let mut pose = [0.0; JOINTS_MAX];
            for (to, from) in pose.iter_mut().zip(deg) {
                *to = from.to_radians() as f32;
            }
            PerJoint(pose)
        };
        let telegram = Telegram {
            ipoc: document.ipoc.value(),
            q_rad: state.aipos_deg.map(radians),
            start_rad: state.aspos_deg.map(radians),
            late: state.delay.map(|late| u32::try_from(late).unwrap_or(u32::MAX)),
            new_connection,
        };
        Ok((telegram, document.ipoc))
    }

    /// Writes an answer to a telegram with this number, with the digits that it had.
    pub fn write(&self, ipoc: Ipoc, answer: &Answer) -> Result<Vec<u8>, WriteError> {
        let place_of =
            |entry: &ReceiveEntry| self.config.receive.iter().position(|other| other.tag == entry.tag);
        let number = |kind: ValueType, value: bool, bit: u8| match kind {
            ValueType::Bool => Value::Bool(value),
            ValueType::Double => Value::Double(if value { f64::from(1_u32 << bit.min(30)) } else { 0.0 }),
            _ => Value::Long(if value { 1 << bit.min(30) } else { 0 }),
        };
        SensorWriter::new(&self.config, DECIMALS).write(ipoc, |entry| {
            let place = place_of(entry)?;
            if let Some(axis) = self.axes.iter().position(|other| *other == place) {
                let joint = JointIndex::new(axis).ok()?;
                let deg = f64::from(answer.correction_rad.get(joint)).to_degrees();
                return Some(Value::Double(deg));
            }
            if place == self.output {
                return Some(number(entry.kind, answer.open, self.output_bit));
            }
            (Some(place) == self.stop).then(|| number(entry.kind, answer.stop, 0))
        })
    }
}
