//! Robot to computer.

use crate::config::{Config, Internal, Source};
use crate::error::{ReadError, WriteError};
use crate::ipoc::Ipoc;
use crate::names::{AXIS_NAMES, CARTESIAN_NAMES, EXTERNAL_NAMES};
use crate::telegram::{Element, Root, Telegram};
use crate::value::{Value, ValueType, decimal};

/// What a client reads from a robot telegram.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotState {
    /// Actual pose of the tool, mm and degrees.
    pub rist_mm_deg: Option<[f64; 6]>,
    /// Programmed pose of the tool: it stays where the correction started.
    pub rsol_mm_deg: Option<[f64; 6]>,
    /// Actual axes, degrees.
    pub aipos_deg: Option<[f64; 6]>,
    /// Programmed axes: they stay where the correction started.
    pub aspos_deg: Option<[f64; 6]>,
    /// External axes, actual.
    pub eipos: Option<[f64; 6]>,
    /// External axes, programmed.
    pub espos: Option<[f64; 6]>,
    /// Motor currents of the axes.
    pub macur: Option<[f64; 6]>,
    /// Motor currents of the external axes.
    pub mecur: Option<[f64; 6]>,
    /// Number of late answers.
    pub delay: Option<u64>,
}

impl RobotState {
    /// Reads the elements with fixed names; others are skipped.
    ///
    /// # Errors
    /// An attribute is missing or is not a number.
    pub fn read(telegram: &Telegram) -> Result<Self, ReadError> {
        let six = |name: &str, names| telegram.element(name).map(|element| element.six(names)).transpose();
        Ok(Self {
            rist_mm_deg: six("RIst", &CARTESIAN_NAMES)?,
            rsol_mm_deg: six("RSol", &CARTESIAN_NAMES)?,
            aipos_deg: six("AIPos", &AXIS_NAMES)?,
            aspos_deg: six("ASPos", &AXIS_NAMES)?,
            eipos: six("EIPos", &EXTERNAL_NAMES)?,
            espos: six("ESPos", &EXTERNAL_NAMES)?,
            macur: six("MACur", &AXIS_NAMES)?,
            mecur: six("MECur", &EXTERNAL_NAMES)?,
            delay: telegram.element("Delay").map(delay).transpose()?,
        })
    }
}

fn delay(element: &Element) -> Result<u64, ReadError> {
    let text = element
        .attribute("D")
        .ok_or_else(|| ReadError::Missing { element: element.name.clone(), attribute: "D".to_owned() })?;
    text.trim().parse().map_err(|_| ReadError::bad_value("Delay.D", text, "a count"))
}

/// What a controller puts into a telegram.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotData {
    /// Actual pose of the tool, mm and degrees.
    pub rist_mm_deg: [f64; 6],
    /// Programmed pose of the tool.
    pub rsol_mm_deg: [f64; 6],
    /// Actual axes, degrees.
    pub aipos_deg: [f64; 6],
    /// Programmed axes.
    pub aspos_deg: [f64; 6],
    /// Motor currents.
    pub macur: [f64; 6],
    /// Number of late answers.
    pub delay: u64,
}

/// Writes robot telegrams in the order of a configuration file.
#[derive(Clone, Debug)]
pub struct RobotWriter<'c> {
    config: &'c Config,
    decimals: u8,
}

impl<'c> RobotWriter<'c> {
    /// For the `SEND` part of `config`, with this number of decimals.
    #[must_use]
    pub fn new(config: &'c Config, decimals: u8) -> Self {
        Self { config, decimals }
    }

    /// The first telegram of a KR C2: `IPOC` only.
    ///
    /// # Errors
    /// Never fails for a number; the signature is the same for all writers.
    pub fn first(ipoc: Ipoc) -> Result<Vec<u8>, WriteError> {
        Self::telegram(Vec::new(), ipoc).write()
    }

    /// The telegram of one cycle; `object` gives the value of object input n (1 to 64), `None` sends zero.
    ///
    /// External axes are sent as zeros: the simulated robot has none. Parameters of function generators and internals
    /// that this package does not know are left out.
    ///
    /// # Errors
    /// A value cannot be written, or the document is too long.
    pub fn write(
        &self,
        ipoc: Ipoc,
        data: &RobotData,
        object: impl Fn(u8) -> Option<Value>,
    ) -> Result<Vec<u8>, WriteError> {
        let mut elements: Vec<Element> = Vec::new();
        for entry in &self.config.send {
            match &entry.source {
                Source::Internal(internal) => elements.extend(self.internal(*internal, data)?),
                Source::Object(index) => {
                    let value = object(*index).unwrap_or_else(|| entry.kind.zero());
                    let text = value.text(&entry.tag.to_string(), entry.kind, self.decimals)?;
                    entry.tag.put(&mut elements, text);
                }
            }
        }
        Self::telegram(elements, ipoc).write()
    }

    fn internal(&self, internal: Internal, data: &RobotData) -> Result<Option<Element>, WriteError> {
        let six = |name: &'static str, names: &[&str; 6], values: &[f64; 6]| self.six(name, names, values);
        Ok(Some(match internal {
            Internal::RIst => six("RIst", &CARTESIAN_NAMES, &data.rist_mm_deg)?,
            Internal::RSol => six("RSol", &CARTESIAN_NAMES, &data.rsol_mm_deg)?,
            Internal::AIPos => six("AIPos", &AXIS_NAMES, &data.aipos_deg)?,
            Internal::ASPos => six("ASPos", &AXIS_NAMES, &data.aspos_deg)?,
            Internal::EIPos => six("EIPos", &EXTERNAL_NAMES, &[0.0; 6])?,
            Internal::ESPos => six("ESPos", &EXTERNAL_NAMES, &[0.0; 6])?,
            Internal::MACur => six("MACur", &AXIS_NAMES, &data.macur)?,
            Internal::MECur => six("MECur", &EXTERNAL_NAMES, &[0.0; 6])?,
            Internal::Delay => {
                let text = Value::Long(i32::try_from(data.delay).unwrap_or(i32::MAX));
                let text = text.text("Delay.D", ValueType::Long, 0)?;
                Element {
                    name: "Delay".to_owned(),
                    attributes: vec![("D".to_owned(), text)],
                    text: String::new(),
                }
            }
            Internal::Technology | Internal::MessageText | Internal::Other => return Ok(None),
        }))
    }

    fn six(&self, name: &'static str, names: &[&str; 6], values: &[f64; 6]) -> Result<Element, WriteError> {
        let attributes = names
            .iter()
            .zip(values)
            .map(|(key, value)| Ok(((*key).to_owned(), decimal(name, *value, self.decimals)?)))
            .collect::<Result<_, _>>()?;
        Ok(Element { name: name.to_owned(), attributes, text: String::new() })
    }

    fn telegram(elements: Vec<Element>, ipoc: Ipoc) -> Telegram {
        Telegram { root: Root::Rob, kind: Some("KUKA".to_owned()), elements, ipoc }
    }
}
