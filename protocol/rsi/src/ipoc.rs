//! The number that ties an answer to its telegram.

use std::fmt;
use std::hash::{Hash, Hasher};
use std::str::FromStr;

use crate::error::ReadError;

/// Longest number that is read, leading zeros included.
const MAX_DIGITS: usize = 20;

/// `IPOC` of a telegram: a number, and how many digits it was written with.
///
/// Two are equal if their numbers are: `4711` and `0000004711` name one cycle. [`fmt::Display`] writes the digits that
/// were received, leading zeros included, because an answer echoes them.
#[derive(Clone, Copy, Debug)]
pub struct Ipoc {
    value: u64,
    digits: u8,
}

impl Ipoc {
    /// A number without leading zeros.
    #[must_use]
    pub const fn new(value: u64) -> Self {
        Self { value, digits: 1 }
    }

    /// A number written with at least `digits` digits (up to 20).
    #[must_use]
    pub fn padded(value: u64, digits: u8) -> Self {
        Self { value, digits: digits.clamp(1, MAX_DIGITS as u8) }
    }

    #[must_use]
    pub const fn value(self) -> u64 {
        self.value
    }
}

impl PartialEq for Ipoc {
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value
    }
}

impl Eq for Ipoc {}

impl Hash for Ipoc {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.value.hash(state);
    }
}

impl fmt::Display for Ipoc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:0digits$}", self.value, digits = usize::from(self.digits))
    }
}

impl FromStr for Ipoc {
    type Err = ReadError;

    fn from_str(text: &str) -> Result<Self, ReadError> {
        let digits_only = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        let value = text.parse().ok().filter(|_| digits_only && text.len() <= MAX_DIGITS);
        match value {
            Some(value) => Ok(Self::padded(value, text.len() as u8)),
            None => Err(ReadError::bad_value(
                "<IPOC>",
                text,
                "a number of 1 to 20 digits below 18446744073709551616",
            )),
        }
    }
}
