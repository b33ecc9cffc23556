//! Who is on the bus and in which state: the questions behind `scan`, `status` and `doctor`.

use protocol::ModuleId;
use protocol::powercube::{Config, CubeState, FirmwareVersion, Parameter, Reply, Request, Setup, Value};

use super::ask::AskError;
use crate::bus::session::Session;
use crate::node::drive_client::Policy;

/// Attempts for a module that may not be there: a second of silence for all 31 addresses.
const SCAN_TRIES: u8 = 3;

/// Data of one module; `None` for what its firmware does not have or it did not answer.
#[derive(Clone, Debug, PartialEq)]
pub struct ModuleReport {
    /// Address.
    pub module: ModuleId,
    pub version: FirmwareVersion,
    pub serial: Option<u32>,
    /// Configuration word.
    pub config: Option<Config>,
    /// Set-up word.
    pub setup: Option<Setup>,
    pub state: Option<CubeState>,
    /// Position, rad (linear modules: m).
    pub position_rad: Option<f64>,
    pub current_a: Option<f64>,
    pub motor_v: Option<f64>,
    pub logic_v: Option<f64>,
    /// Temperature, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Questions that its firmware has but it left unanswered.
    pub unanswered: Vec<Parameter>,
}

impl ModuleReport {
    /// Rotary or linear, by the configuration.
    pub fn kind(&self) -> &'static str {
        match self.config {
            Some(config) if config.contains(Config::LINEAR) => "linear",
            Some(_) => "rotary",
            None => "?",
        }
    }

    /// Knows its position at power on and needs no homing.
    pub fn is_absolute(&self) -> bool {
        self.setup.is_some_and(Setup::is_absolute)
    }

    /// Homed, as far as known.
    pub fn is_homed(&self) -> bool {
        self.state.is_some_and(|state| state.contains(CubeState::HOME_OK))
    }

    /// Error or halt.
    pub fn is_stopped(&self) -> bool {
        self.state.is_some_and(|state| state.intersects(CubeState::ERROR | CubeState::HALTED))
    }

    /// The state in a few words.
    pub fn condition(&self) -> String {
        condition(self.state)
    }
}

/// A state word in a few words.
#[must_use]
pub fn condition(state: Option<CubeState>) -> String {
    let Some(state) = state else { return "state unknown".to_owned() };
    let mut words = Vec::new();
    if state.contains(CubeState::ERROR) {
        let causes = state.bits() & CubeState::CAUSES.bits();
        words.push(format!("error {}", CubeState::from_bits(causes)));
    }
    if state.contains(CubeState::HALTED) {
        words.push("halted".to_owned());
    }
    words.push(if state.contains(CubeState::HOME_OK) { "homed" } else { "not homed" }.to_owned());
    if state.contains(CubeState::MOTION) {
        words.push("moving".to_owned());
    }
    words.join(", ")
}

/// Progress of a survey: what is done, done and all.
pub type OnSurveyProgress<'a> = &'a mut dyn FnMut(&'static str, usize, usize);

/// Finds the modules among `candidates` by requests for their version, then requests the other data from each one found.
pub fn survey(
    session: &mut Session,
    candidates: impl IntoIterator<Item = ModuleId>,
    progress: OnSurveyProgress<'_>,
) -> Result<Vec<ModuleReport>, AskError> {
    let linger = session.host_node().drives.policy().linger;
    session.host_node().drives.set_policy(Policy { linger, tries: SCAN_TRIES, ..Policy::default() });
    let questions: Vec<_> =
        candidates.into_iter().map(|module| (module, Request::Get(Parameter::DefVersion))).collect();
    let answers =
        session.ask_all_with(&questions, &mut |done, all| progress("looking for modules", done, all))?;
    let mut found = Vec::new();
    for ((module, _), answer) in questions.iter().zip(answers) {
        if let Ok(Reply::Value(_, Value::U16(version))) = answer {
            found.push((*module, FirmwareVersion(version)));
        }
    }
    const DETAILS: [Parameter; 9] = [
        Parameter::DefSerialNo,
        Parameter::Config,
        Parameter::DefSetup,
        Parameter::CubeState,
        Parameter::ActPos,
        Parameter::Cur,
        Parameter::MotorSupply,
        Parameter::LogicSupply,
        Parameter::Temperature,
    ];
    let mut details = Vec::new();
    for (module, version) in &found {
        let readable = DETAILS.into_iter().filter(|parameter| parameter.info().readable(*version));
        details.extend(readable.map(|parameter| (*module, Request::Get(parameter))));
    }
    // A module that has answered is there.
    session.host_node().drives.set_policy(Policy { linger, ..Policy::PATIENT });
    let answers = session.ask_all_with(&details, &mut |done, all| progress("asking them", done, all))?;
    let mut reports: Vec<ModuleReport> = found
        .into_iter()
        .map(|(module, version)| ModuleReport {
            module,
            version,
            serial: None,
            config: None,
            setup: None,
            state: None,
            position_rad: None,
            current_a: None,
            motor_v: None,
            logic_v: None,
            temperature_c: None,
            unanswered: Vec::new(),
        })
        .collect();
    for ((module, request), answer) in details.iter().zip(answers) {
        let Some(report) = reports.iter_mut().find(|report| report.module == *module) else { continue };
        match answer {
            Ok(Reply::Value(parameter, value)) => enter(report, parameter, value),
            _ => {
                if let Request::Get(parameter) = request {
                    report.unanswered.push(*parameter);
                }
            }
        }
    }
    Ok(reports)
}

fn enter(report: &mut ModuleReport, parameter: Parameter, value: Value) {
    let number = value.as_f64();
    match (parameter, value) {
        (Parameter::DefSerialNo, Value::U32(serial)) => report.serial = Some(serial),
        (Parameter::Config, Value::U32(bits)) => report.config = Some(Config::from_bits(bits)),
        (Parameter::DefSetup, Value::U32(bits)) => report.setup = Some(Setup::from_bits(bits)),
        (Parameter::CubeState, Value::U32(bits)) => report.state = Some(CubeState::from_bits(bits)),
        (Parameter::ActPos, _) => report.position_rad = number,
        (Parameter::Cur, _) => report.current_a = number,
        (Parameter::MotorSupply, _) => report.motor_v = number,
        (Parameter::LogicSupply, _) => report.logic_v = number,
        (Parameter::Temperature, _) => report.temperature_c = number,
        _ => {}
    }
}
