//! Objects of the servo: type, access, range, value.

use protocol::canopen::Function;
use protocol::canopen::Object;
use protocol::canopen::cia402 as drive;
use protocol::canopen::pdo::{Entry, Map};
use protocol::canopen::sdo::AbortCode;

use super::options::{Interpolating, ServoOptions};

/// Process data in each direction.
pub(super) const PDOS: u8 = 4;
const MAP_ENTRIES: u8 = 8;
/// Errors that object 1003 keeps.
const ERRORS_MAX: usize = 8;
/// Device type: profile 402, servo drive.
const DEVICE_TYPE: i64 = 0x0002_0192;
/// Text of the electronic data sheet, which a servo gives as object 1021.
const SHEET: &str = include_str!("simulated_servo.eds");
const NOT_VALID: i64 = 1 << 31;
/// Limit of the demand of the velocity loop, turns of the motor per minute.
pub(super) const SPEED_MAX: u16 = 0x6080;
/// SYNCs without a position until the module brakes.
pub(super) const CYCLES_WITHOUT_DATA: u16 = 0x200E;
/// Bit 0: the commutation is found; bit 1: the absolute position is verified.
pub(super) const COMMUTATION: u16 = 0x2050;

/// Objects that a module that interpolates does not show, as SCHUNK's public DCF of 2013 does not name them. The module still acts on
/// their values, which [`of_drive`] has: reactions 6007 = 1, 605A = 2, 605E = 2 and the change to pre-operational (1029 = 0) are the defaults of CiA
/// 402-2 and CiA 301. The time of 6066 and the braking of 6085 are the maker's and not published: those of the servo in mode 8 are assumed.
const HIDDEN_IN_MODULES: [u16; 11] =
    [0x1029, 0x6007, 0x603F, 0x605A, 0x605E, 0x6066, 0x6076, SPEED_MAX, 0x6085, 0x608F, 0x6091];

/// Where an object may stand in process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mapped {
    No,
    /// To the node.
    Receive,
    /// From the node.
    Transmit,
}

#[derive(Clone, Copy, Debug)]
struct Row {
    bytes: u8,
    signed: bool,
    writable: bool,
    mapped: Mapped,
    range: (i64, i64),
    value: i64,
}

const fn row(bytes: u8, signed: bool, value: i64) -> Row {
    let bits = 8 * bytes as u32;
    let range = if signed { (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) } else { (0, (1 << bits) - 1) };
    Row { bytes, signed, writable: false, mapped: Mapped::No, range, value }
}

impl Row {
    const fn writable(self) -> Self {
        Self { writable: true, ..self }
    }

    const fn within(self, low: i64, high: i64) -> Self {
        Self { range: (low, high), ..self }
    }

    const fn mapped(self, mapped: Mapped) -> Self {
        Self { mapped, ..self }
    }

    fn encode(&self) -> Vec<u8> {
        self.value.to_le_bytes()[..usize::from(self.bytes)].to_vec()
    }

    fn decode(&self, bytes: &[u8]) -> i64 {
        let negative = self.signed && bytes.last().is_some_and(|byte| byte & 0x80 != 0);
        let mut all = if negative { [0xFF; 8] } else { [0; 8] };
        all[..bytes.len()].copy_from_slice(bytes);
        i64::from_le_bytes(all)
    }
}

/// What a write may depend on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Situation {
    /// Process data run.
    pub(super) is_operational: bool,
    pub(super) maps_are_fixed: bool,
}

/// See the [module](self).
#[derive(Clone, Debug)]
pub(super) struct Dictionary {
    /// Sorted. They have a list of their own, because they are searched many times in each period.
    objects: Vec<Object>,
    /// Entry k is the place of the first object with an index of 16 k or more.
    first: Box<[u16; 0x1000]>,
    /// In the order of `objects`.
    rows: Vec<Row>,
    /// Objects that are not shown.
    hidden: &'static [u16],
    name: &'static str,
    errors: Vec<u16>,
}

fn common(options: &ServoOptions) -> Vec<(u16, u8, Row)> {
    let node = options.node;
    let emergency = i64::from(Function::Emergency(node).id());
    vec![
        (0x1000, 0, row(4, false, DEVICE_TYPE)),
        (0x1001, 0, row(1, false, 0).mapped(Mapped::Transmit)),
        (0x1005, 0, row(4, false, 0x80)),
        (0x1006, 0, row(4, false, 0).writable()),
        (0x1014, 0, row(4, false, emergency)),
        (0x1016, 0, row(1, false, 1)),
        (0x1016, 1, row(4, false, 0).writable()),
        (0x1017, 0, row(2, false, 0).writable()),
        (0x1018, 0, row(1, false, 4)),
        (0x1018, 1, row(4, false, options.vendor.into())),
        (0x1018, 2, row(4, false, options.product.into())),
        (0x1018, 3, row(4, false, 0x0001_0001)),
        (0x1018, 4, row(4, false, 1_000 + i64::from(node.get()))),
        (0x1029, 0, row(1, false, 1)),
        (0x1029, 1, row(1, false, 0).writable().within(0, 2)),
    ]
}

fn of_drive(options: &ServoOptions) -> Vec<(u16, u8, Row)> {
    use Mapped::{Receive, Transmit};
    let counts = f64::from(options.encoder_counts) * f64::from(options.gear);
    let on_lost_link = options.interpolating.map_or(1, |own| own.on_lost_link.into());
    let turns_per_minute = options.no_load_rad_s * f64::from(options.gear) * 60.0 / std::f64::consts::TAU;
    vec![
        (0x6007, 0, row(2, true, on_lost_link).writable().within(0, 3)),
        (0x603F, 0, row(2, false, 0).mapped(Transmit)),
        (drive::CONTROL, 0, row(2, false, 0).writable().mapped(Receive)),
        (drive::STATUS, 0, row(2, false, 0).mapped(Transmit)),
        (0x605A, 0, row(2, true, 2).writable().within(0, 6)),
        (0x605E, 0, row(2, true, 2).writable().within(0, 2)),
        (drive::MODE, 0, row(1, true, 0).writable().mapped(Receive)),
        (drive::MODE_DISPLAY, 0, row(1, true, 0).mapped(Transmit)),
        (drive::POSITION, 0, row(4, true, 0).mapped(Transmit)),
        (0x6065, 0, row(4, false, (counts / 100.0) as i64).writable()),
        (0x6066, 0, row(2, false, 10).writable()),
        (0x606C, 0, row(4, true, 0).mapped(Transmit)),
        (0x6076, 0, row(4, false, (options.rated_nm * 1e3).round() as i64)),
        (0x6077, 0, row(2, true, 0).mapped(Transmit)),
        (drive::TARGET_POSITION, 0, row(4, true, 0).writable().mapped(Receive)),
        (0x607C, 0, row(4, true, 0).writable()),
        (SPEED_MAX, 0, row(4, false, turns_per_minute.round() as i64).writable()),
        (0x6085, 0, row(4, false, counts as i64).writable().within(1, u32::MAX.into())),
        (0x608F, 0, row(1, false, 2)),
        (0x608F, 1, row(4, false, options.encoder_counts.into())),
        (0x608F, 2, row(4, false, 1)),
        (0x6091, 0, row(1, false, 2)),
        (0x6091, 1, row(4, false, options.gear.into())),
        (0x6091, 2, row(4, false, 1)),
        (0x6098, 0, row(1, true, 37).writable()),
        (0x6099, 0, row(1, false, 2)),
        (0x6099, 1, row(4, false, (counts / 36.0) as i64).writable()),
        (0x6099, 2, row(4, false, (counts / 360.0) as i64).writable()),
        (drive::TORQUE_OFFSET, 0, row(2, true, 0).writable().mapped(Receive)),
        (0x60C2, 0, row(1, false, 2)),
        (drive::INTERPOLATION_TIME, 1, row(1, false, 1).writable().within(1, 255)),
        (drive::INTERPOLATION_TIME, 2, row(1, true, -3).writable().within(-6, 0)),
        (0x60F4, 0, row(4, true, 0).mapped(Transmit)),
        (drive::OUTPUTS, 0, row(1, false, 2)),
        (drive::OUTPUTS, 1, row(4, false, 0).writable().mapped(Receive)),
        (drive::OUTPUTS, 2, row(4, false, 0).writable()),
        (drive::SUPPORTED_MODES, 0, row(4, false, options.modes.into())),
    ]
}

/// Objects of a module that interpolates.
fn of_interpolation(own: Interpolating) -> Vec<(u16, u8, Row)> {
    vec![
        (CYCLES_WITHOUT_DATA, 0, row(1, false, own.cycles_without_data.into()).writable()),
        (COMMUTATION, 0, row(2, false, 0).mapped(Mapped::Transmit)),
        (0x6042, 0, row(2, true, 0).writable().mapped(Mapped::Receive)),
        (drive::INTERPOLATION_SUBMODE, 0, row(2, true, 0).writable().within(0, 0)),
        (drive::INTERPOLATION_DATA, 0, row(1, false, 1)),
        (drive::INTERPOLATION_DATA, 1, row(4, true, 0).writable().mapped(Mapped::Receive)),
        (drive::INTERPOLATION_BUFFER, 0, row(1, false, 2)),
        (drive::INTERPOLATION_BUFFER, 1, row(4, false, own.queue.max(1).into())),
        (drive::INTERPOLATION_BUFFER, 2, row(4, false, own.queue.into())),
    ]
}

/// As delivered: the first pair runs by event, the others are not valid.
fn process_data(options: &ServoOptions) -> Vec<(u16, u8, Row)> {
    let (node, mut rows) = (options.node, Vec::new());
    let control = Entry::new(drive::CONTROL, 0, 2);
    let status = Entry::new(drive::STATUS, 0, 2);
    let (to_node, from_node) = match options.interpolating {
        None => (vec![control], vec![status]),
        Some(_) => (
            vec![control, Entry::new(0x6042, 0, 2), Entry::new(drive::INTERPOLATION_DATA, 1, 4)],
            vec![status, Entry::new(drive::MODE_DISPLAY, 0, 1)],
        ),
    };
    for pdo in 0..PDOS {
        let ways = [
            (0x1400, Function::Rpdo(pdo + 1, node), &to_node),
            (0x1800, Function::Tpdo(pdo + 1, node), &from_node),
        ];
        for (base, function, entries) in ways {
            let base = base + u16::from(pdo);
            let entries: &[Entry] = if pdo == 0 { entries } else { &[] };
            let (valid, count) = if pdo == 0 { (0, entries.len() as i64) } else { (NOT_VALID, 0) };
            rows.push((base, 0, row(1, false, 2)));
            rows.push((base, 1, row(4, false, valid | i64::from(function.id())).writable()));
            rows.push((base, 2, row(1, false, 255).writable()));
            rows.push((base + 0x200, 0, row(1, false, count).writable().within(0, MAP_ENTRIES.into())));
            for sub in 1..=MAP_ENTRIES {
                let mapped = entries.get(usize::from(sub) - 1).map_or(0, |entry| i64::from(entry.mapped()));
                rows.push((base + 0x200, sub, row(4, false, mapped).writable()));
            }
        }
    }
    rows
}

impl Dictionary {
    /// As the servo is delivered.
    pub(super) fn of(options: &ServoOptions) -> Self {
        let rows = common(options).into_iter().chain(of_drive(options)).chain(process_data(options));
        let own = options.interpolating.map(of_interpolation).unwrap_or_default();
        let hidden: &[u16] = if options.interpolating.is_some() { &HIDDEN_IN_MODULES } else { &[] };
        let mut rows: Vec<_> =
            rows.chain(own).map(|(index, sub, row)| (Object::new(index, sub), row)).collect();
        rows.sort_by_key(|(object, _)| *object);
        let (objects, rows): (Vec<Object>, _) = rows.into_iter().unzip();
        let mut first = Box::new([0; 0x1000]);
        for (place, block) in first.iter_mut().zip((0..=u16::MAX).step_by(16)) {
            *place = objects.partition_point(|own| own.index < block) as u16;
        }
        Self { objects, first, rows, hidden, name: options.name, errors: Vec::new() }
    }

    fn place(&self, object: Object) -> Option<usize> {
        let from = usize::from(self.first[usize::from(object.index >> 4)]);
        let behind = self.objects[from..].iter().take_while(|own| **own <= object);
        let place = from + behind.count();
        place.checked_sub(1).filter(|place| self.objects[*place] == object)
    }

    /// Value of an object that there is.
    pub(super) fn get(&self, index: u16, sub: u8) -> i64 {
        let place = self.place(Object::new(index, sub)).expect("the servo has it");
        self.rows[place].value
    }

    /// Sets an object that there is, from inside.
    pub(super) fn set(&mut self, index: u16, sub: u8, value: i64) {
        if let Some(place) = self.place(Object::new(index, sub)) {
            let row = &mut self.rows[place];
            row.value = value.clamp(row.range.0, row.range.1);
        }
    }

    pub(super) fn note_error(&mut self, code: u16) {
        self.errors.insert(0, code);
        self.errors.truncate(ERRORS_MAX);
    }

    pub(super) fn read(&self, object: Object) -> Result<Vec<u8>, AbortCode> {
        match (object.index, object.sub) {
            (0x1003, 0) => Ok(vec![self.errors.len() as u8]),
            (0x1003, sub) => match self.errors.get(usize::from(sub) - 1) {
                Some(code) => Ok(u32::from(*code).to_le_bytes().to_vec()),
                None => Err(AbortCode::NO_SUB_INDEX),
            },
            _ => match (self.text(object), self.shown(object)) {
                (Some(text), _) => Ok(text.to_vec()),
                (None, Some(row)) => Ok(row.encode()),
                (None, None) => Err(self.unknown(object)),
            },
        }
    }

    /// What can only be read and does not change. SCHUNK's modules store no sheet.
    fn text(&self, object: Object) -> Option<&[u8]> {
        let has_sheet = self.hidden.is_empty();
        match (object.index, object.sub) {
            (0x1008, 0) => Some(self.name.as_bytes()),
            (0x1021, 0) if has_sheet => Some(SHEET.as_bytes()),
            // The form of the sheet: text.
            (0x1022, 0) if has_sheet => Some(&[0]),
            _ => None,
        }
    }

    fn shown(&self, object: Object) -> Option<&Row> {
        let place = self.place(object).filter(|_| !self.hidden.contains(&object.index))?;
        Some(&self.rows[place])
    }

    fn unknown(&self, object: Object) -> AbortCode {
        let is_known = self.text(Object::new(object.index, 0)).is_some()
            || self.objects.iter().any(|own| own.index == object.index && self.shown(*own).is_some());
        if is_known { AbortCode::NO_SUB_INDEX } else { AbortCode::NO_OBJECT }
    }

    pub(super) fn write(
        &mut self,
        object: Object,
        bytes: &[u8],
        situation: Situation,
    ) -> Result<(), AbortCode> {
        if object == Object::new(0x1003, 0) {
            return match bytes {
                [0] => {
                    self.errors.clear();
                    Ok(())
                }
                _ => Err(AbortCode::RANGE),
            };
        }
        let Some(row) = self.shown(object).copied() else {
            let is_read_only = object.index == 0x1003 || self.text(object).is_some();
            return Err(if is_read_only { AbortCode::READ_ONLY } else { self.unknown(object) });
        };
        if !row.writable {
            return Err(AbortCode::READ_ONLY);
        }
        if bytes.len() != usize::from(row.bytes) {
            return Err(AbortCode::LENGTH);
        }
        let value = row.decode(bytes);
        if value < row.range.0 || value > row.range.1 {
            return Err(AbortCode::RANGE);
        }
        if (0x1400..0x1C00).contains(&object.index) {
            self.check_process_data(object, value, situation)?;
        }
        self.set(object.index, object.sub, value);
        Ok(())
    }

    /// A map changes only while its PDO is not valid and its count is zero.
    fn check_process_data(&self, object: Object, value: i64, situation: Situation) -> Result<(), AbortCode> {
        if situation.is_operational {
            return Err(AbortCode::STATE);
        }
        let is_map = object.index & 0x200 != 0;
        if !is_map {
            let changes_id = object.sub == 1
                && self.get(object.index, 1) & NOT_VALID == 0
                && value & NOT_VALID == 0
                && value != self.get(object.index, 1);
            return if changes_id { Err(AbortCode::RANGE) } else { Ok(()) };
        }
        if situation.maps_are_fixed {
            return Err(AbortCode(0x0601_0000));
        }
        let is_valid = self.get(object.index - 0x200, 1) & NOT_VALID == 0;
        if is_valid || (object.sub > 0 && self.get(object.index, 0) != 0) {
            return Err(AbortCode::STATE);
        }
        if object.sub > 0 {
            return self.check_entry(object.index, value);
        }
        let map = self.map(object.index, value as u8);
        map.map(|_| ()).ok_or(AbortCode(0x0604_0042))
    }

    fn check_entry(&self, index: u16, value: i64) -> Result<(), AbortCode> {
        let (mapped, sub, bits) = ((value >> 16) as u16, (value >> 8) as u8, value as u8);
        let wanted = if index < 0x1800 { Mapped::Receive } else { Mapped::Transmit };
        let row = self.shown(Object::new(mapped, sub));
        let fits = row.is_some_and(|row| row.mapped == wanted && u32::from(row.bytes) * 8 == u32::from(bits));
        if fits { Ok(()) } else { Err(AbortCode(0x0604_0041)) }
    }

    fn map(&self, index: u16, count: u8) -> Option<Map> {
        let entry = |sub| {
            let value = self.get(index, sub);
            Entry::new((value >> 16) as u16, (value >> 8) as u8, value as u8 / 8)
        };
        Map::new(&(1..=count).map(entry).collect::<Vec<_>>())
    }

    /// Id, transmission type and map of a PDO (base 1400 or 1800); `None`: not valid, or its id and type are not `wanted`.
    pub(super) fn process_data(
        &self,
        base: u16,
        pdo: u8,
        wanted: impl Fn(u16, u8) -> bool,
    ) -> Option<(u16, u8, Map)> {
        let index = base + u16::from(pdo);
        let id = self.get(index, 1);
        let (own, kind) = (id as u16 & 0x7FF, self.get(index, 2) as u8);
        if id & NOT_VALID != 0 || !wanted(own, kind) {
            return None;
        }
        let map = self.map(index + 0x200, self.get(index + 0x200, 0) as u8)?;
        Some((own, kind, map))
    }
}
