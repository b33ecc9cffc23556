//! Process data (CiA 301, 7.2.2): mapped objects, their place in a frame, how a map is configured.

use super::Object;
use super::id::{Function, NodeId};
use super::sdo::Bytes;

/// Most objects in a PDO of whole bytes.
pub const ENTRIES_MAX: usize = 8;

/// An object in a PDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The object.
    pub object: Object,
    /// Its bytes, 1 to 4.
    pub bytes: u8,
}

impl Entry {
    /// An object of 1 to 4 bytes.
    #[must_use]
    pub const fn new(index: u16, sub: u8, bytes: u8) -> Self {
        Self { object: Object::new(index, sub), bytes }
    }

    /// As it stands in a map: index, sub-index, bits.
    #[must_use]
    pub const fn mapped(self) -> u32 {
        (self.object.index as u32) << 16 | (self.object.sub as u32) << 8 | (self.bytes as u32 * 8)
    }
}

/// What is in a PDO, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Map {
    entries: [Entry; ENTRIES_MAX],
    count: u8,
}

impl Map {
    /// `None` for more than eight bytes in all, or for an entry that has not 1 to 4 bytes.
    #[must_use]
    pub fn new(entries: &[Entry]) -> Option<Self> {
        let sound = entries.iter().all(|entry| (1..=4).contains(&entry.bytes));
        let bytes: usize = entries.iter().map(|entry| usize::from(entry.bytes)).sum();
        if !sound || bytes > 8 {
            return None;
        }
        let mut own = [Entry::new(0, 0, 0); ENTRIES_MAX];
        for (to, from) in own.iter_mut().zip(entries) {
            *to = *from;
        }
        Some(Self { entries: own, count: entries.len() as u8 })
    }

    /// The entries.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        self.entries.get(..usize::from(self.count)).unwrap_or_default()
    }

    /// Bytes in all.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries().iter().map(|entry| usize::from(entry.bytes)).sum()
    }

    /// Nothing is mapped.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The data of a frame: the lowest bytes of the values, in order. Missing values are zero.
    #[must_use]
    pub fn pack(&self, values: &[i32]) -> Bytes<8> {
        let mut data = [0; 8];
        let mut at = 0;
        for (k, entry) in self.entries().iter().enumerate() {
            let value = values.get(k).copied().unwrap_or(0).to_le_bytes();
            for byte in value.iter().take(usize::from(entry.bytes)) {
                if let Some(to) = data.get_mut(at) {
                    *to = *byte;
                }
                at += 1;
            }
        }
        Bytes::of(data.get(..at).unwrap_or_default())
    }

    /// The values in a frame, in order, with their signs; `None` for data of another length.
    #[must_use]
    pub fn unpack(&self, data: &[u8]) -> Option<[i32; ENTRIES_MAX]> {
        if data.len() != self.len() {
            return None;
        }
        let mut values = [0; ENTRIES_MAX];
        let mut rest = data;
        for (to, entry) in values.iter_mut().zip(self.entries()) {
            let (own, after) = rest.split_at_checked(usize::from(entry.bytes))?;
            rest = after;
            let negative = own.last().is_some_and(|byte| *byte & 0x80 != 0);
            let mut bytes = if negative { [0xFF; 4] } else { [0; 4] };
            for (to, from) in bytes.iter_mut().zip(own) {
                *to = *from;
            }
            *to = i32::from_le_bytes(bytes);
        }
        Some(values)
    }
}

/// Direction of a PDO as its node sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// From the node.
    Transmit,
    /// To the node.
    Receive,
}

/// When a PDO is sent or acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Transmission {
    /// With each n-th SYNC, 1 to 240.
    Sync(u8),
    /// When it comes, or when something changes.
    Event,
}

/// Not valid: bit 31 of the id of a PDO.
const NOT_VALID: u32 = 1 << 31;
/// Steps of a set-up at most.
const STEPS_MAX: usize = ENTRIES_MAX + 5;

/// How PDO `number` (1 to 4) of a node is configured: writes of service data, in order, while the node is pre-operational.
///
/// 1. it is not valid, 2. nothing is mapped, 3. each entry, 4. their count, 5. the transmission, 6. it is valid. Read back: some maps
///    are fixed.
pub fn set_up(
    node: NodeId,
    direction: Direction,
    number: u8,
    map: Map,
    transmission: Transmission,
) -> impl Iterator<Item = (Object, Bytes<4>)> {
    let number = number.clamp(1, 4);
    let (base, function) = match direction {
        Direction::Transmit => (0x1800, Function::Tpdo(number, node)),
        Direction::Receive => (0x1400, Function::Rpdo(number, node)),
    };
    let (communication, mapping) = (base + u16::from(number - 1), base + 0x200 + u16::from(number - 1));
    let id = u32::from(function.id());
    let kind = match transmission {
        Transmission::Sync(every) => every.clamp(1, 240),
        Transmission::Event => 255,
    };
    let count = map.count;
    (0..STEPS_MAX).filter_map(move |step| {
        let long = |sub, value: u32| Some((Object::new(communication, sub), Bytes::of(&value.to_le_bytes())));
        match step {
            0 => long(1, id | NOT_VALID),
            1 => Some((Object::new(mapping, 0), Bytes::of(&[0]))),
            entry @ 2..=9 => {
                let mapped = map.entries().get(entry - 2)?.mapped();
                Some((Object::new(mapping, entry as u8 - 1), Bytes::of(&mapped.to_le_bytes())))
            }
            10 => Some((Object::new(mapping, 0), Bytes::of(&[count]))),
            11 => Some((Object::new(communication, 2), Bytes::of(&[kind]))),
            _ => long(1, id),
        }
    })
}
