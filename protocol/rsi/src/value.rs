//! Typed values and plain decimals.

use std::fmt::Write as _;

use crate::error::{ReadError, WriteError};

/// Largest magnitude of a decimal that is read or written.
const MAX_DECIMAL: f64 = 1e9;
/// Longest text of a decimal that is read.
const MAX_DECIMAL_CHARS: usize = 40;
/// Most decimals that are written.
pub(crate) const MAX_DECIMALS: u8 = 9;

/// Type of an entry in the configuration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ValueType {
    /// `BOOL`: 0 or 1 on the wire; `true` and `false` are read too.
    Bool,
    /// `LONG`: a signed 32-bit integer.
    Long,
    /// `DOUBLE`: a plain decimal.
    Double,
    /// `STRING`.
    Text,
}

impl ValueType {
    /// Word of the configuration file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bool => "BOOL",
            Self::Long => "LONG",
            Self::Double => "DOUBLE",
            Self::Text => "STRING",
        }
    }

    pub(crate) fn from_name(name: &str) -> Option<Self> {
        [Self::Bool, Self::Long, Self::Double, Self::Text].into_iter().find(|kind| kind.name() == name)
    }

    /// What a controller puts in for a value that is not held.
    #[must_use]
    pub fn zero(self) -> Value {
        match self {
            Self::Bool => Value::Bool(false),
            Self::Long => Value::Long(0),
            Self::Double => Value::Double(0.0),
            Self::Text => Value::Text(String::new()),
        }
    }

    /// Reads a value of this type; `place` names it in an error.
    ///
    /// # Errors
    /// The text is not of this type.
    pub fn read(self, place: &str, text: &str) -> Result<Value, ReadError> {
        let trimmed = text.trim();
        let refuse = |expected| ReadError::bad_value(place, text, expected);
        match self {
            Self::Bool => match trimmed {
                "0" | "false" | "FALSE" => Ok(Value::Bool(false)),
                "1" | "true" | "TRUE" => Ok(Value::Bool(true)),
                _ => Err(refuse("0 or 1")),
            },
            Self::Long => trimmed.parse().map(Value::Long).map_err(|_| refuse("a 32-bit integer")),
            Self::Double => parse_decimal(trimmed).map(Value::Double).ok_or_else(|| refuse(DECIMAL)),
            Self::Text => Ok(Value::Text(text.to_owned())),
        }
    }
}

/// Form of a decimal, for messages.
pub(crate) const DECIMAL: &str = "a decimal with a point, below 1e9";

#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// `BOOL`.
    Bool(bool),
    /// `LONG`.
    Long(i32),
    /// `DOUBLE`.
    Double(f64),
    /// `STRING`.
    Text(String),
}

impl Value {
    /// The number of a `DOUBLE`, `LONG` or `BOOL`.
    #[must_use]
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Bool(bit) => Some(f64::from(u8::from(*bit))),
            Self::Long(n) => Some(f64::from(*n)),
            Self::Double(x) => Some(*x),
            Self::Text(_) => None,
        }
    }

    /// Text on the wire for an entry of type `kind`.
    pub(crate) fn text(&self, tag: &str, kind: ValueType, decimals: u8) -> Result<String, WriteError> {
        match (self, kind) {
            (Self::Bool(bit), ValueType::Bool) => Ok(u8::from(*bit).to_string()),
            (Self::Long(n), ValueType::Long) => Ok(n.to_string()),
            (Self::Double(x), ValueType::Double) => decimal(tag, *x, decimals),
            (Self::Text(text), ValueType::Text) => Ok(text.clone()),
            _ => Err(WriteError::WrongType { tag: tag.to_owned(), expected: kind.name() }),
        }
    }
}

/// Reads `-12.5`, `3`, `+.5`, `-7.1e-05`; no NaN, no infinity, magnitude below 1e9. This package writes no
/// exponents, but some controllers send small numbers with one.
#[must_use]
pub fn parse_decimal(text: &str) -> Option<f64> {
    let number = text.bytes().all(|byte| byte.is_ascii_digit() || b".+-eE".contains(&byte));
    if !number || text.len() > MAX_DECIMAL_CHARS {
        return None;
    }
    text.parse::<f64>().ok().filter(|x| x.abs() < MAX_DECIMAL)
}

/// Writes a decimal with a point; minus zero becomes zero.
pub(crate) fn decimal(place: &str, x: f64, decimals: u8) -> Result<String, WriteError> {
    let refuse = || WriteError::NotADecimal { place: place.to_owned(), value: x.to_string() };
    if x.is_nan() || x.abs() >= MAX_DECIMAL {
        return Err(refuse());
    }
    let mut text = String::with_capacity(16);
    // Writing to a string cannot fail.
    let _ = write!(text, "{:.*}", usize::from(decimals.min(MAX_DECIMALS)), x);
    if let Some(digits) = text.strip_prefix('-')
        && digits.bytes().all(|byte| matches!(byte, b'0' | b'.'))
    {
        text.remove(0);
    }
    // Rounding may have carried into a tenth digit.
    if parse_decimal(&text).is_none() { Err(refuse()) } else { Ok(text) }
}
