//! Why bytes are refused, and why a telegram cannot be written.

/// A received document is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReadError {
    /// More bytes than a document may have.
    #[error("document of {len} bytes; at most {max} are read")]
    TooLong { len: usize, max: usize },
    /// The bytes are not UTF-8.
    #[error("not UTF-8 text from byte {at} on")]
    NotText {
        /// First wrong byte.
        at: usize,
    },
    /// The text is not one XML document.
    #[error("not an XML document: {0}")]
    NotXml(String),
    /// The root element has another name.
    #[error("the root element is <{found}>, expected <{expected}>")]
    WrongRoot {
        found: String,
        /// The name asked for.
        expected: &'static str,
    },
    /// The document holds no `IPOC`.
    #[error("no element <IPOC>")]
    NoIpoc,
    /// An element occurs twice.
    #[error("element <{0}> occurs twice")]
    Twice(String),
    /// An element misses an attribute.
    #[error("element <{element}> has no attribute {attribute}")]
    Missing { element: String, attribute: String },
    /// A value cannot be read as its type.
    #[error("{place} is '{text}', expected {expected}")]
    BadValue {
        place: String,
        /// Received text, cut after 40 characters.
        text: String,
        /// What it should be.
        expected: &'static str,
    },
}

impl ReadError {
    pub(crate) fn bad_value(place: impl Into<String>, text: &str, expected: &'static str) -> Self {
        Self::BadValue { place: place.into(), text: text.chars().take(40).collect(), expected }
    }
}

/// A telegram cannot be written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WriteError {
    /// The document is longer than public programs can read.
    #[error("document of {len} bytes; receivers have buffers of 1024 bytes, so at most {max} are written", max = crate::MAX_WRITTEN_BYTES)]
    TooLong { len: usize },
    /// NaN, infinite or too large to be written as a plain decimal.
    #[error("{place} is {value}, which is not a decimal of at most nine digits before the point")]
    NotADecimal { place: String, value: String },
    /// A name is not an XML name, or a text holds a control character.
    #[error("{place}: '{text}' cannot be written in XML")]
    NotXml {
        /// What was to be written.
        place: &'static str,
        text: String,
    },
    /// The value has another type than the configuration file gives.
    #[error("{tag} is of type {expected} in the configuration file; the value given is of another type")]
    WrongType {
        /// Tag of the configuration file.
        tag: String,
        /// Type in the configuration file.
        expected: &'static str,
    },
}

/// A configuration file is refused: where, and why.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct ConfigError {
    /// Line of the file, from 1.
    pub line: u32,
    /// What is wrong there.
    pub problem: ConfigProblem,
}

/// What is wrong with a configuration file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigProblem {
    /// The file as a whole cannot be read.
    #[error(transparent)]
    Document(#[from] ReadError),
    /// An element that must be there is missing.
    #[error("no element <{0}>")]
    NoElement(&'static str),
    /// An attribute of `<ELEMENT>` is missing.
    #[error("<ELEMENT> has no attribute {0}")]
    NoAttribute(&'static str),
    #[error("{place} is '{text}', expected {expected}")]
    Value {
        place: &'static str,
        text: String,
        /// What it should be.
        expected: &'static str,
    },
    /// Two entries have the same tag.
    #[error("tag '{0}' is given twice")]
    TagTwice(String),
    /// One element holds both attributes and a scalar, so it cannot be written.
    #[error("'{0}' is both an element with attributes and a scalar")]
    Mixed(String),
    /// More entries than are read.
    #[error("more than {0} entries")]
    TooMany(usize),
}
