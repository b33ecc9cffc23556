//! Registers of a controller: settings by name, written and read back.

use firmware::registers::{self, Number, RegisterInfo};
use firmware::settings::Settings;
use protocol::cyphal::bits::Decode;
use protocol::cyphal::client::Policy;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use protocol::cyphal::uavcan::register::{
    ACCESS, AccessRequest, AccessResponse, LIST, ListRequest, ListResponse,
};
use protocol::cyphal::uavcan::value::{Value, ValueBuf, ValueType};

use super::operator::OperatorError;
use crate::bus::session::Session;
use crate::drives::family_registers;

/// More registers than any controller has.
const REGISTERS_MAX: u16 = 1_000;

/// Numbers of a register, one per joint or one for the group.
#[derive(Clone, Debug, PartialEq)]
pub enum Numbers {
    Real(Vec<f32>),
    /// Naturals of any width.
    Natural(Vec<u64>),
    /// Truth values.
    Bit(Vec<bool>),
    /// A text; no text register can be written.
    Text(String),
}

/// A register as its controller reports it.
#[derive(Clone, Debug, PartialEq)]
pub struct RegisterEntry {
    pub name: String,
    /// What it holds.
    pub value: Numbers,
    /// It may be written.
    pub mutable: bool,
}

impl Numbers {
    fn of(value: &Value<'_>) -> Option<Self> {
        let each = 0..value.len();
        match value.kind() {
            ValueType::Bit => each.map(|at| value.bool(at)).collect::<Option<_>>().map(Self::Bit),
            ValueType::Real64 | ValueType::Real32 | ValueType::Real16 => {
                each.map(|at| value.f32(at)).collect::<Option<_>>().map(Self::Real)
            }
            ValueType::String => value.text().map(|text| Self::Text(text.to_owned())),
            // A value of this kind is never returned: a key.
            ValueType::Unstructured => Some(Self::Text(String::new())),
            _ => each.map(|at| value.u64(at)).collect::<Option<_>>().map(Self::Natural),
        }
    }

    /// Form on the wire; `None` for numbers that no register of a controller holds.
    fn to_value(&self) -> Option<ValueBuf> {
        match self {
            Self::Real(numbers) => ValueBuf::try_from(numbers.as_slice()).ok(),
            Self::Natural(numbers) => {
                let narrow: Option<Vec<u32>> = numbers.iter().map(|n| u32::try_from(*n).ok()).collect();
                ValueBuf::try_from(narrow?.as_slice()).ok()
            }
            Self::Bit(values) => ValueBuf::bits(values).ok(),
            Self::Text(_) => None,
        }
    }

    /// As `cubectl controller registers set` takes them.
    #[must_use]
    pub fn list(&self) -> String {
        self.to_string().trim_matches(['[', ']']).replace(", ", ",")
    }
}

/// Numbers as the controller's table of registers holds them.
pub(crate) fn to_controller(numbers: &Numbers) -> Vec<Number> {
    match numbers {
        Numbers::Real(all) => all.iter().map(|x| Number::Real32(*x)).collect(),
        Numbers::Natural(all) => {
            // A number that is too large for a register is refused by its range.
            all.iter().map(|x| Number::Natural32(u32::try_from(*x).unwrap_or(u32::MAX))).collect()
        }
        Numbers::Bit(all) => all.iter().map(|x| Number::Bit(*x)).collect(),
        // No register holds one; the controller refuses no numbers.
        Numbers::Text(_) => Vec::new(),
    }
}

/// As they are for people and for the wire.
pub(crate) fn to_host(numbers: &[Number]) -> Numbers {
    let real = |number: &Number| if let Number::Real32(x) = number { Some(*x) } else { None };
    let natural =
        |number: &Number| if let Number::Natural32(x) = number { Some(u64::from(*x)) } else { None };
    let bit = |number: &Number| if let Number::Bit(x) = number { Some(*x) } else { None };
    match numbers.first() {
        Some(Number::Real32(_)) => Numbers::Real(numbers.iter().filter_map(real).collect()),
        Some(Number::Bit(_)) => Numbers::Bit(numbers.iter().filter_map(bit).collect()),
        _ => Numbers::Natural(numbers.iter().filter_map(natural).collect()),
    }
}

/// Registers of controllers, and what each is: those of every controller, then those of one family of drives.
pub fn known() -> impl Iterator<Item = (&'static RegisterInfo, &'static str)> {
    let of_families = family_registers().flat_map(|list| list.table.iter().zip(list.meanings));
    registers::TABLE
        .iter()
        .zip(registers::MEANINGS)
        .chain(of_families)
        .map(|(info, meaning)| (info, *meaning))
}

/// Name of register `number` of a controller; `None` if it depends on the family of its drives.
pub(super) fn name_of(number: usize) -> Option<&'static str> {
    let after = number.checked_sub(registers::TABLE.len());
    let mut of_families = family_registers().filter_map(|list| list.table.get(after?));
    let found = registers::TABLE.get(number).or_else(|| of_families.next())?;
    of_families.next().is_none().then_some(found.name)
}

/// Settings with the registers that `wanted` accepts, read by `read`, and the number of joints. The others are as built in.
///
/// # Errors
/// Errors of `read`; [`OperatorError::NoRegister`] for a register with a value that this program does not know.
pub fn settings_of(
    wanted: impl Fn(&RegisterInfo) -> bool,
    read: &mut dyn FnMut(&str) -> Result<Numbers, OperatorError>,
) -> Result<Settings, OperatorError> {
    let mut settings = Settings::BUILT_IN;
    for list in family_registers() {
        let Some(first) = list.table.iter().find(|info| wanted(info)) else { continue };
        match read(first.name) {
            Ok(_) => settings.take_family(list),
            Err(OperatorError::NoRegister { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    for (index, info) in registers::all(&settings).enumerate() {
        if (info.name == "group.joints" || wanted(info))
            && !registers::set_held(&mut settings, index, &to_controller(&read(info.name)?))
        {
            return Err(OperatorError::NoRegister { name: info.name.to_owned() });
        }
    }
    Ok(settings)
}

impl From<f32> for Numbers {
    fn from(number: f32) -> Self {
        Self::Real(vec![number])
    }
}

impl From<u32> for Numbers {
    fn from(number: u32) -> Self {
        Self::Natural(vec![number.into()])
    }
}

impl std::fmt::Display for Numbers {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Real(numbers) => write!(f, "{numbers:?}"),
            Self::Natural(numbers) => write!(f, "{numbers:?}"),
            Self::Bit(values) => write!(f, "{values:?}"),
            Self::Text(text) => write!(f, "{text:?}"),
        }
    }
}

impl Session {
    /// Value of a register of `node`.
    ///
    /// # Errors
    /// [`OperatorError::NoRegister`] for a name that the controller does not know; or another [`OperatorError`].
    pub fn register(&mut self, node: NodeId, name: &str) -> Result<Numbers, OperatorError> {
        self.access(node, name, Value::EMPTY).map(|reported| reported.value)
    }

    /// As [`Self::register`]; `None` if `node` does not have the register, as one that belongs to other drives.
    pub fn find_register(&mut self, node: NodeId, name: &str) -> Result<Option<Numbers>, OperatorError> {
        match self.register(node, name) {
            Err(OperatorError::NoRegister { .. }) => Ok(None),
            found => found.map(Some),
        }
    }

    pub fn reported_register(&mut self, node: NodeId, name: &str) -> Result<RegisterEntry, OperatorError> {
        self.access(node, name, Value::EMPTY)
    }

    /// Names of all registers of `node`, in its order.
    pub fn register_names(&mut self, node: NodeId) -> Result<Vec<String>, OperatorError> {
        let mut names = Vec::new();
        for index in 0..REGISTERS_MAX {
            let payload = self.request(node, LIST, Policy::default(), &ListRequest { index })?;
            let response =
                ListResponse::from_bytes(&payload).map_err(|_| OperatorError::Unreadable { node })?;
            if response.name.is_empty() {
                return Ok(names);
            }
            names.push(String::from_utf8_lossy(response.name).into_owned());
        }
        Ok(names)
    }

    /// The number of a register of the group.
    pub fn natural(&mut self, node: NodeId, name: &str) -> Result<u64, OperatorError> {
        match self.register(node, name)? {
            Numbers::Natural(numbers) if numbers.len() == 1 => Ok(numbers[0]),
            _ => Err(OperatorError::Unreadable { node }),
        }
    }

    /// Writes a register and checks whether the value was accepted. Nothing is sent if the register has it already.
    ///
    /// # Errors
    /// [`OperatorError::RegisterRefused`] if the controller keeps another value; or another [`OperatorError`].
    pub fn set_register(&mut self, node: NodeId, name: &str, wanted: &Numbers) -> Result<(), OperatorError> {
        if self.register(node, name)? == *wanted {
            return Ok(());
        }
        let value = wanted.to_value().ok_or(OperatorError::Unreadable { node })?;
        self.authorize_register(node, name, &value.as_value())?;
        let found = self.access(node, name, value.as_value())?.value;
        if found == *wanted {
            return Ok(());
        }
        let name = name.to_owned();
        if let Some(state) =
            self.group().map(|group| group.state).filter(|state| state.may_move() || *state == State::Armed)
        {
            return Err(OperatorError::InUse { state, name });
        }
        Err(OperatorError::RegisterRefused { name, wanted: wanted.to_string(), found: found.to_string() })
    }

    fn access(&mut self, node: NodeId, name: &str, value: Value<'_>) -> Result<RegisterEntry, OperatorError> {
        let request = AccessRequest { name: name.as_bytes(), value };
        let payload = self.request(node, ACCESS, Policy::default(), &request)?;
        let response =
            AccessResponse::from_bytes(&payload).map_err(|_| OperatorError::Unreadable { node })?;
        if response.value.kind() == ValueType::Empty {
            return Err(OperatorError::NoRegister { name: name.to_owned() });
        }
        let value = Numbers::of(&response.value).ok_or(OperatorError::Unreadable { node })?;
        Ok(RegisterEntry { name: name.to_owned(), value, mutable: response.mutable })
    }
}
