//! `cubectl modules dump|diff|restore|show`

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use protocol::powercube::{Parameter, Reply, Request, SimpleCommand, Value, ValueKind};
use protocol::{Duration, ModuleId};
use serde::{Deserialize, Serialize};

use super::survey::{Modules, modules_on, require_powercubes};
use super::{counted, modules_show};
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::{BusArgs, Session};
use operator::dialogue::survey::ModuleReport;

const SCHEMA_VERSION: u32 = 1;

/// Parameters that are no settings although they can be written: motions, lines, commands in disguise; and tick forms
/// of what is saved in radians anyway.
const NO_SETTING: &[Parameter] = &[
    Parameter::DioData,
    Parameter::TargetPosInc,
    Parameter::TargetVelInc,
    Parameter::TargetAccInc,
    Parameter::CurInc,
    Parameter::HomeOffsetInc,
    Parameter::MaxDeltaPosInc,
    Parameter::MinPosInc,
    Parameter::MaxPosInc,
    Parameter::MaxVelInc,
    Parameter::MaxAccInc,
    Parameter::HomeVelInc,
];
/// Written last, and never by a restore: who a module is and how it is reached.
const IDENTITY: &[Parameter] =
    &[Parameter::DefAddress, Parameter::DefSerialNo, Parameter::DefCanBaud, Parameter::DefRsBaud];

/// What to do with parameters of modules.
#[derive(Debug, clap::Subcommand)]
pub enum ModulesVerb {
    /// Write all settings of the modules to a TOML file.
    Dump(DumpArgs),
    /// Compare the modules with a file.
    Diff(FileArgs),
    /// Write the settings that differ from a file back to the modules.
    Restore(RestoreArgs),
    /// Compare CANopen servos with their electronic data sheet.
    Show(modules_show::ShowArgs),
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl modules dump arm.toml --bus can0")]
pub struct DumpArgs {
    /// Where to; `-` is standard output. A file that exists is not overwritten.
    pub file: PathBuf,
    #[command(flatten)]
    pub bus: BusArgs,
    /// These modules. Default: all that are there.
    #[arg(long)]
    pub modules: Option<Modules>,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl modules diff arm.toml --bus can0")]
pub struct FileArgs {
    /// File made by `config dump`.
    pub file: PathBuf,
    #[command(flatten)]
    pub bus: BusArgs,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl modules restore arm.toml --bus can0 --save")]
pub struct RestoreArgs {
    /// File made by `config dump`.
    pub file: PathBuf,
    #[command(flatten)]
    pub bus: BusArgs,
    /// Also write them to the permanent storage of the modules.
    #[arg(long)]
    pub save: bool,
    /// Write to modules whose serial numbers differ from the file's.
    #[arg(long)]
    pub other_serial: bool,
}

/// The file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConfigFile {
    /// Version of the file: 1.
    pub schema_version: u32,
    /// By address.
    pub module: Vec<ModuleConfig>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModuleConfig {
    pub address: u8,
    pub serial: u32,
    /// Firmware, four hexadecimal digits.
    pub firmware: String,
    /// Name of the parameter, with its unit, and value: that of a single-precision parameter as its shortest decimal.
    pub setting: BTreeMap<String, f64>,
}

/// `MaxVel_rad_per_s` and the like: name and unit of a setting.
fn key(parameter: Parameter) -> String {
    let unit = parameter.info().unit.symbol();
    if unit.is_empty() {
        parameter.name().to_owned()
    } else {
        format!("{}_{}", parameter.name(), unit.replace('/', "_per_"))
    }
}

fn settings_of(report: &ModuleReport) -> Vec<Parameter> {
    Parameter::TABLE
        .iter()
        .filter(|info| info.readable(report.version) && info.writable(report.version))
        .map(|info| info.parameter)
        .filter(|parameter| !NO_SETTING.contains(parameter) && !IDENTITY.contains(parameter))
        .collect()
}

pub fn run(verb: &ModulesVerb) -> Result<(), ExpectedError> {
    match verb {
        ModulesVerb::Dump(args) => dump(args),
        ModulesVerb::Diff(args) => diff(args),
        ModulesVerb::Restore(args) => restore(args),
        ModulesVerb::Show(args) => modules_show::run(args),
    }
}

fn read_all(session: &mut Session, found: &[ModuleReport]) -> Result<ConfigFile, ExpectedError> {
    let mut file = ConfigFile { schema_version: SCHEMA_VERSION, module: Vec::new() };
    for report in found {
        let parameters = settings_of(report);
        let questions: Vec<_> =
            parameters.iter().map(|parameter| (report.module, Request::Get(*parameter))).collect();
        let mut setting = BTreeMap::new();
        for answer in session.ask_all(&questions)? {
            if let Reply::Value(parameter, value) = answer.map_err(operator::dialogue::ask::AskError::from)?
                && let Some(number) = value.as_f64()
            {
                setting.insert(key(parameter), as_written(parameter, number));
            }
        }
        file.module.push(ModuleConfig {
            address: report.module.get(),
            serial: report.serial.unwrap_or(0),
            firmware: report.version.to_string(),
            setting,
        });
    }
    Ok(file)
}

fn dump(args: &DumpArgs) -> Result<(), ExpectedError> {
    let mut session = args.bus.open()?;
    require_powercubes(&mut session, &args.bus, &args.bus.cell.load()?.robot)?;
    let found =
        modules_on(&mut session, args.modules.as_ref().map(|modules| modules.0.as_slice()), args.bus.beside)?;
    let file = read_all(&mut session, &found)?;
    session.finish()?;
    let text = toml::to_string(&file)
        .map_err(|error| ExpectedError::new(exit::BUG, format!("settings do not fit into TOML: {error}")))?;
    if args.file == Path::new("-") {
        console::text!("{text}");
        return Ok(());
    }
    let failed = |error: std::io::Error| {
        ExpectedError::new(exit::OUTPUT, format!("{}: {error}", args.file.display()))
            .next("name a file that does not exist yet, in a folder that may be written")
    };
    let mut out = std::fs::File::create_new(&args.file).map_err(failed)?;
    std::io::Write::write_all(&mut out, text.as_bytes()).and_then(|()| out.sync_all()).map_err(failed)?;
    console::line!("{}: {}", args.file.display(), counted(file.module.len(), "module"));
    Ok(())
}

/// Reads and checks a file.
fn load(path: &Path) -> Result<ConfigFile, ExpectedError> {
    let text = toml_reader::read_text(path, toml_reader::DESCRIPTION_MAX_BYTES)
        .map_err(|error| ExpectedError::io(path, &error))?;
    let file: ConfigFile = toml::from_str(&text)
        .map_err(|error| ExpectedError::bad_input(&format!("{}: {error}", path.display())))?;
    if file.schema_version != SCHEMA_VERSION {
        return Err(ExpectedError::bad_input(&format!(
            "{}: schema_version {} is not {SCHEMA_VERSION}",
            path.display(),
            file.schema_version
        ))
        .next("use the cubectl that wrote it, or dump again"));
    }
    for module in &file.module {
        for (name, value) in &module.setting {
            let refused = match parameter_of(name) {
                None => format!("no setting is called {name}"),
                Some(parameter) if typed(parameter, *value).is_none() => {
                    format!(
                        "{name} = {value} is no value of this setting, which takes {}",
                        range_of(parameter)
                    )
                }
                Some(_) => continue,
            };
            return Err(ExpectedError::bad_input(&format!(
                "{}: module {}: {refused}",
                path.display(),
                module.address
            )));
        }
    }
    Ok(file)
}

fn parameter_of(name: &str) -> Option<Parameter> {
    Parameter::TABLE.iter().map(|info| info.parameter).find(|parameter| key(*parameter) == name)
}

/// Time for a module to store its settings.
const SAVING: Duration = Duration::from_millis(50);

/// One setting that differs: module, parameter, the module's value, the file's.
type Change = (ModuleId, Parameter, f64, f64);

/// The modules of a file beside those on the bus.
struct Compared {
    session: Session,
    wanted: ConfigFile,
    found: Vec<ModuleReport>,
    changes: Vec<Change>,
    /// Settings of the file that a module does not have.
    missing: Vec<(ModuleId, Parameter, f64)>,
}

/// Opens the bus and compares the modules of the file, all of which must answer.
fn compare(path: &Path, bus: &BusArgs) -> Result<Compared, ExpectedError> {
    let wanted = load(path)?;
    let mut ids = Vec::new();
    for module in &wanted.module {
        ids.push(
            ModuleId::new(module.address)
                .map_err(|error| ExpectedError::bad_input(&format!("{}: address {error}", path.display())))?,
        );
    }
    let mut session = bus.open()?;
    require_powercubes(&mut session, bus, &bus.cell.load()?.robot)?;
    let found = modules_on(&mut session, Some(&ids), bus.beside)?;
    let present = read_all(&mut session, &found)?;
    let (mut changes, mut missing) = (Vec::new(), Vec::new());
    for (module, id) in wanted.module.iter().zip(ids) {
        let Some(now) = present.module.iter().find(|now| now.address == module.address) else { continue };
        for (name, value) in &module.setting {
            let Some(parameter) = parameter_of(name) else { continue };
            match now.setting.get(name) {
                None => missing.push((id, parameter, *value)),
                Some(actual) if typed(parameter, *actual) != typed(parameter, *value) => {
                    changes.push((id, parameter, *actual, *value));
                }
                Some(_) => {}
            }
        }
    }
    Ok(Compared { session, wanted, found, changes, missing })
}

fn diff(args: &FileArgs) -> Result<(), ExpectedError> {
    let Compared { session, wanted, found, changes, missing } = compare(&args.file, &args.bus)?;
    session.finish()?;
    let mut differences = changes.len() + missing.len();
    for module in &wanted.module {
        let serial = found.iter().find(|report| report.module.get() == module.address).and_then(|r| r.serial);
        if serial.is_some_and(|serial| serial != module.serial) {
            console::line!(
                "module {}: serial {} (file: {})",
                module.address,
                serial.unwrap_or(0),
                module.serial
            );
            differences += 1;
        }
    }
    for (module, parameter, actual, file) in &changes {
        console::line!("module {module}: {} {actual} (file: {file})", key(*parameter));
    }
    for (module, parameter, file) in &missing {
        console::line!("module {module}: has no {} (file: {file})", key(*parameter));
    }
    if differences == 0 {
        console::line!("{}: {} as in the file", args.file.display(), counted(wanted.module.len(), "module"));
        return Ok(());
    }
    Err(ExpectedError::new(exit::FINDINGS, counted(differences, "difference"))
        .next(format!("`cubectl modules restore {}` writes the file's values", args.file.display())))
}

fn restore(args: &RestoreArgs) -> Result<(), ExpectedError> {
    let Compared { mut session, wanted, found, changes, missing } = compare(&args.file, &args.bus)?;
    if let Some((module, parameter, _)) = missing.first() {
        return Err(ExpectedError::bad_input(&format!(
            "module {module} has no {}; nothing was written",
            key(*parameter)
        ))
        .next("`cubectl modules diff` lists all of these; take them out of the file"));
    }
    for module in &wanted.module {
        let Some(report) = found.iter().find(|report| report.module.get() == module.address) else {
            continue;
        };
        if report.serial != Some(module.serial) && !args.other_serial {
            return Err(ExpectedError::bad_input(&format!(
                "module {}: serial {} is not the file's {}; nothing was written",
                module.address,
                report.serial.unwrap_or(0),
                module.serial
            ))
            .next("check that this is the right arm, then add --other-serial"));
        }
        if report.state.is_none_or(|state| state.contains(protocol::powercube::CubeState::MOTION)) {
            return Err(ExpectedError::new(
                exit::DRIVE,
                format!("module {} moves; nothing was written", module.address),
            )
            .next("`cubectl stop`"));
        }
    }
    for (module, parameter, _, value) in &changes {
        let Some(value) = typed(*parameter, *value) else { continue };
        session.ask(*module, Request::Set(*parameter, value))?;
    }
    let mut touched: Vec<ModuleId> = changes.iter().map(|change| change.0).collect();
    touched.dedup();
    for module in &touched {
        session.command(*module, SimpleCommand::Recalc)?;
    }
    let mut wrong = Vec::new();
    for (module, parameter, _, value) in &changes {
        let actual = session.get_f64(*module, *parameter)?;
        if typed(*parameter, actual) != typed(*parameter, *value) {
            let actual = as_written(*parameter, actual);
            wrong.push(format!("module {module}: {} is {actual}, not {value}", key(*parameter)));
        }
    }
    if wrong.is_empty() && args.save {
        // Also where the values were in force already: nobody knows whether they are stored.
        for report in &found {
            session.command(report.module, SimpleCommand::SaveParameters)?;
            session.sleep_until(session.now() + SAVING)?;
        }
    }
    session.finish()?;
    if !wrong.is_empty() {
        return Err(ExpectedError::new(
            exit::DRIVE,
            format!(
                "written, but not as in the file{}: {}",
                if args.save { ", and not saved" } else { "" },
                wrong.join("; ")
            ),
        )
        .next("the value is outside what the module allows"));
    }
    console::line!(
        "{} written to {}, read back{}",
        counted(changes.len(), "setting"),
        counted(touched.len(), "module"),
        if args.save { format!(", {} saved", counted(found.len(), "module")) } else { String::new() }
    );
    Ok(())
}

/// A number as a file has it: 3.1 for the single-precision number nearest to 3.1, not 3.0999999046325684. Read as the
/// parameter's type it is the same value again.
fn as_written(parameter: Parameter, value: f64) -> f64 {
    match parameter.kind() {
        ValueKind::F32 => (value as f32).to_string().parse().unwrap_or(value),
        _ => value,
    }
}

/// What a parameter takes, as text.
fn range_of(parameter: Parameter) -> &'static str {
    match parameter.kind() {
        ValueKind::F32 => "a finite number of single precision",
        ValueKind::I32 => "whole numbers of 32 bits with sign",
        ValueKind::U32 => "whole numbers from 0 to 4294967295",
        ValueKind::I16 => "whole numbers from -32768 to 32767",
        ValueKind::U16 => "whole numbers from 0 to 65535",
        ValueKind::U8 => "whole numbers from 0 to 255",
        ValueKind::PosStateDio => "nothing",
    }
}

/// A number as the parameter's type; `None` if it is none of its values.
fn typed(parameter: Parameter, value: f64) -> Option<Value> {
    let exact = |low: f64, high: f64| (value.fract() == 0.0 && (low..=high).contains(&value)).then_some(());
    Some(match parameter.kind() {
        ValueKind::F32 => Some(value as f32).filter(|single| single.is_finite()).map(Value::F32)?,
        ValueKind::I32 => exact(i32::MIN.into(), i32::MAX.into()).map(|()| Value::I32(value as i32))?,
        ValueKind::U32 => exact(0.0, u32::MAX.into()).map(|()| Value::U32(value as u32))?,
        ValueKind::I16 => exact(i16::MIN.into(), i16::MAX.into()).map(|()| Value::I16(value as i16))?,
        ValueKind::U16 => exact(0.0, u16::MAX.into()).map(|()| Value::U16(value as u16))?,
        ValueKind::U8 => exact(0.0, u8::MAX.into()).map(|()| Value::U8(value as u8))?,
        ValueKind::PosStateDio => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_precision_numbers_are_written_short_and_read_back_as_they_were() {
        for single in [3.1_f32, 0.1, -2.0, 1e-7, 16_777_216.0, f32::MIN_POSITIVE, f32::MAX] {
            let written = as_written(Parameter::MaxVel, single.into());
            assert_eq!(written.to_string(), single.to_string());
            assert_eq!(typed(Parameter::MaxVel, written), Some(Value::F32(single)));
        }
    }

    #[test]
    fn values_that_a_setting_cannot_have_are_none() {
        for value in [f64::NAN, f64::INFINITY, 1e39] {
            assert_eq!(typed(Parameter::MaxVel, value), None, "{value}");
        }
        let whole = Parameter::TABLE.iter().find(|info| info.kind == ValueKind::U8).unwrap().parameter;
        for value in [0.5, -1.0, 256.0, f64::NAN] {
            assert_eq!(typed(whole, value), None, "{value}");
        }
        assert_eq!(typed(whole, 255.0), Some(Value::U8(255)));
    }
}
