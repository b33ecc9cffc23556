//! Electronic data sheets of CANopen nodes (EDS), and sheets with the values of one node (DCF), in the form of CiA 306.
//!
//! | file | is |
//! |---|---|
//! | `read` | the text: sections, numbers |
//! | [`compare`] | a sheet beside a node and beside what the controller needs of it |

pub mod compare;
mod read;

use std::collections::BTreeMap;

use protocol::canopen::{NodeId, Object};

/// A number of a sheet, that may depend on the node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Number {
    value: i64,
    adds_node: bool,
}

impl Number {
    #[must_use]
    pub fn of(self, node: NodeId) -> i64 {
        self.value.saturating_add(if self.adds_node { node.get().into() } else { 0 })
    }
}

/// An object, or one sub-index of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Entry {
    /// As the maker calls it.
    pub name: String,
    /// Number of the data type (CiA 301, table 44).
    pub data_type: u16,
    /// It can be written.
    pub is_writable: bool,
    /// It may stand in process data.
    pub is_mappable: bool,
    /// Smallest value.
    pub low: Option<Number>,
    /// Largest value.
    pub high: Option<Number>,
    /// Value as delivered.
    pub default: Option<Number>,
    /// Value of this node: the sheet is a DCF.
    pub configured: Option<Number>,
}

impl Entry {
    /// Bytes of its type; `None`: text, a domain, or a type of the maker.
    #[must_use]
    pub const fn bytes(&self) -> Option<usize> {
        Some(match self.data_type {
            0x01 | 0x02 | 0x05 => 1,
            0x03 | 0x06 => 2,
            0x10 | 0x16 => 3,
            0x04 | 0x07 | 0x08 => 4,
            0x12 | 0x18 => 5,
            0x13 | 0x19 => 6,
            0x14 | 0x1A => 7,
            0x11 | 0x15 | 0x1B => 8,
            _ => return None,
        })
    }

    #[must_use]
    pub const fn is_signed(&self) -> bool {
        matches!(self.data_type, 0x02..=0x04 | 0x10 | 0x12..=0x15)
    }
}

/// Whose sheet it is; `None`: the sheet does not say it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// Object 1018:1.
    pub vendor: Option<u32>,
    /// Object 1018:2.
    pub product: Option<u32>,
    /// Object 1018:3.
    pub revision: Option<u32>,
}

/// A sheet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Eds {
    /// See [`Identity`].
    pub identity: Identity,
    pub entries: BTreeMap<Object, Entry>,
}

/// Why a text is not a sheet.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct EdsError {
    /// From 1.
    pub line: usize,
    pub problem: String,
}
