//! A cursor over a TOML document that knows where it is: file, line and key of whatever it refuses.

use std::cell::RefCell;
use std::fmt;

use protocol::text::candump::Record;
use protocol::{Duration, Frame};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A scenario was refused: where, and why. Reads `file:line: key: reason`, so that an editor can jump to it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct ScenarioError {
    /// File name as given.
    pub file: String,
    /// Line, from 1; `None` if the file could not be read at all.
    pub line: Option<usize>,
    /// Key path, as in `fault[2].probability`; empty for the file as a whole.
    pub key: String,
    /// The reason, and what would be right.
    pub problem: Problem,
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if !self.key.is_empty() {
            write!(f, ": {}", self.key)?;
        }
        write!(f, ": {}", self.problem)
    }
}

/// Why a scenario is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Problem {
    /// The file could not be read.
    #[error("cannot read the file: {0}")]
    Unreadable(String),
    /// Not TOML.
    #[error("not valid TOML: {0}")]
    Syntax(String),
    /// Written for another version of the schema.
    #[error("schema version {found}; this program reads version {supported}")]
    Schema {
        /// In the file.
        found: i64,
        /// Understood here.
        supported: i64,
    },
    /// The key is not part of the schema here.
    #[error("unknown key; known here: {}", .known.join(", "))]
    UnknownKey {
        /// All keys known here.
        known: Vec<&'static str>,
    },
    /// The key must be there.
    #[error("missing")]
    Missing,
    /// The value has another type.
    #[error("expected {expected}, found {found}")]
    WrongType {
        /// What the schema asks for.
        expected: &'static str,
        /// What the file has.
        found: &'static str,
    },
    /// The number is outside its range.
    #[error("{found} is not within {range}")]
    OutOfRange {
        /// As a number.
        found: String,
        /// As people write it.
        range: String,
    },
    /// The word is none of those known.
    #[error("'{found}' is none of: {}", .known.join(", "))]
    UnknownWord {
        /// As written.
        found: String,
        /// The words known.
        known: Vec<&'static str>,
    },
    /// Anything else; says what would be right.
    #[error("{0}")]
    Invalid(String),
}

/// One table of the document. Each getter remembers its key; [`Table::finish`] refuses what nobody asked for.
#[derive(Debug)]
pub struct Table<'a> {
    file: &'a str,
    text: &'a str,
    path: String,
    start: usize,
    table: &'a DeTable<'a>,
    asked: RefCell<Vec<&'static str>>,
}

/// Parses a document.
pub fn parse<'a>(file: &str, text: &'a str) -> Result<Spanned<DeTable<'a>>, ScenarioError> {
    DeTable::parse(text).map_err(|error| {
        let line = error.span().map(|span| line_of(text, span.start));
        let problem = Problem::Syntax(error.message().to_owned());
        ScenarioError { file: file.to_owned(), line, key: String::new(), problem }
    })
}

fn line_of(text: &str, at: usize) -> usize {
    1 + text.as_bytes().iter().take(at).filter(|byte| **byte == b'\n').count()
}

impl<'a> Table<'a> {
    /// The document itself.
    pub fn root(file: &'a str, text: &'a str, document: &'a Spanned<DeTable<'a>>) -> Self {
        Self {
            file,
            text,
            path: String::new(),
            start: 0,
            table: document.get_ref(),
            asked: RefCell::default(),
        }
    }

    fn child(&self, path: String, start: usize, table: &'a DeTable<'a>) -> Self {
        Self { file: self.file, text: self.text, path, start, table, asked: RefCell::default() }
    }

    fn path_of(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    /// Error at a key of this table; at the table itself for an absent or empty key.
    pub fn error(&self, key: &str, problem: Problem) -> ScenarioError {
        let at = self.table.get(key).map_or(self.start, |value| value.span().start);
        let key = if key.is_empty() { self.path.clone() } else { self.path_of(key) };
        self.error_at(at, key, problem)
    }

    fn error_at(&self, at: usize, key: String, problem: Problem) -> ScenarioError {
        ScenarioError { file: self.file.to_owned(), line: Some(line_of(self.text, at)), key, problem }
    }

    fn get(&self, key: &'static str) -> Option<&'a DeValue<'a>> {
        let mut asked = self.asked.borrow_mut();
        if !asked.contains(&key) {
            asked.push(key);
        }
        self.table.get(key).map(Spanned::get_ref)
    }

    fn required<T>(&self, key: &'static str, value: Option<T>) -> Result<T, ScenarioError> {
        value.ok_or_else(|| self.error(key, Problem::Missing))
    }

    /// True if the key is there; does not count as asked for.
    pub fn has(&self, key: &str) -> bool {
        self.table.contains_key(key)
    }

    /// A finite number within `low..=high`.
    pub fn number(&self, key: &'static str, low: f64, high: f64) -> Result<Option<f64>, ScenarioError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        number(value, low, high).map(Some).map_err(|problem| self.error(key, problem))
    }

    /// A list of numbers, each within `low..=high`.
    pub fn numbers(&self, key: &'static str, low: f64, high: f64) -> Result<Option<Vec<f64>>, ScenarioError> {
        let items = match self.get(key) {
            None => return Ok(None),
            Some(DeValue::Array(items)) => items,
            Some(other) => return Err(self.error(key, wrong_type("a list of numbers", other))),
        };
        let mut numbers = Vec::with_capacity(items.len());
        for (index, item) in items.iter().enumerate() {
            let number = number(item.get_ref(), low, high).map_err(|problem| {
                self.error_at(item.span().start, format!("{}[{index}]", self.path_of(key)), problem)
            })?;
            numbers.push(number);
        }
        Ok(Some(numbers))
    }

    /// A number that must be there.
    pub fn required_number(&self, key: &'static str, low: f64, high: f64) -> Result<f64, ScenarioError> {
        let number = self.number(key, low, high)?;
        self.required(key, number)
    }

    /// A whole number within `low..=high`.
    pub fn integer(&self, key: &'static str, low: i64, high: i64) -> Result<Option<i64>, ScenarioError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let DeValue::Integer(integer) = value else {
            return Err(self.error(key, wrong_type("a whole number", value)));
        };
        match i64::from_str_radix(integer.as_str(), integer.radix()) {
            Ok(found) if (low..=high).contains(&found) => Ok(Some(found)),
            _ => {
                let problem = Problem::OutOfRange {
                    found: integer.as_str().to_owned(),
                    range: format!("{low} to {high}"),
                };
                Err(self.error(key, problem))
            }
        }
    }

    /// True or false.
    pub fn boolean(&self, key: &'static str) -> Result<Option<bool>, ScenarioError> {
        match self.get(key) {
            None => Ok(None),
            Some(DeValue::Boolean(value)) => Ok(Some(*value)),
            Some(other) => Err(self.error(key, wrong_type("true or false", other))),
        }
    }

    /// A string.
    pub fn text(&self, key: &'static str) -> Result<Option<&'a str>, ScenarioError> {
        match self.get(key) {
            None => Ok(None),
            Some(DeValue::String(text)) => Ok(Some(text.as_ref())),
            Some(other) => Err(self.error(key, wrong_type("a string", other))),
        }
    }

    /// A string that must be there.
    pub fn required_text(&self, key: &'static str) -> Result<&'a str, ScenarioError> {
        let text = self.text(key)?;
        self.required(key, text)
    }

    /// A string or a list of strings.
    pub fn texts(&self, key: &'static str) -> Result<Option<Vec<&'a str>>, ScenarioError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let items = match value {
            DeValue::String(text) => return Ok(Some(vec![text.as_ref()])),
            DeValue::Array(items) => items,
            other => return Err(self.error(key, wrong_type("a string or a list of strings", other))),
        };
        let mut texts = Vec::with_capacity(items.len());
        for (index, item) in items.iter().enumerate() {
            match item.get_ref() {
                DeValue::String(text) => texts.push(text.as_ref()),
                other => {
                    let key = format!("{}[{index}]", self.path_of(key));
                    return Err(self.error_at(item.span().start, key, wrong_type("a string", other)));
                }
            }
        }
        Ok(Some(texts))
    }

    /// One of a fixed set of words.
    pub fn word<T: Copy>(
        &self,
        key: &'static str,
        known: &[(&'static str, T)],
    ) -> Result<Option<T>, ScenarioError> {
        let Some(found) = self.text(key)? else { return Ok(None) };
        match known.iter().find(|(word, _)| *word == found) {
            Some((_, value)) => Ok(Some(*value)),
            None => {
                let known = known.iter().map(|(word, _)| *word).collect();
                Err(self.error(key, Problem::UnknownWord { found: found.to_owned(), known }))
            }
        }
    }

    /// A span in seconds, 0 to `max_s`, rounded to a microsecond.
    pub fn seconds(&self, key: &'static str, max_s: f64) -> Result<Option<Duration>, ScenarioError> {
        Ok(self.number(key, 0.0, max_s)?.map(Duration::from_secs_f64))
    }

    /// Frames in the form of candump, `0E5#084F0000803E`: a string or a list of strings.
    pub fn frames(&self, key: &'static str) -> Result<Option<Vec<Frame>>, ScenarioError> {
        let Some(texts) = self.texts(key)? else { return Ok(None) };
        texts
            .iter()
            .map(|text| parse_frame(text).map_err(|problem| self.error(key, problem)))
            .collect::<Result<_, _>>()
            .map(Some)
    }

    /// A table; `None` if absent.
    pub fn table(&self, key: &'static str) -> Result<Option<Self>, ScenarioError> {
        match self.get(key) {
            None => Ok(None),
            Some(DeValue::Table(table)) => {
                let start = self.table.get(key).map_or(self.start, |value| value.span().start);
                Ok(Some(self.child(self.path_of(key), start, table)))
            }
            Some(other) => Err(self.error(key, wrong_type("a table", other))),
        }
    }

    /// An array of tables (`[[key]]`); empty if absent.
    pub fn tables(&self, key: &'static str) -> Result<Vec<Self>, ScenarioError> {
        let items = match self.get(key) {
            None => return Ok(Vec::new()),
            Some(DeValue::Array(items)) => items,
            Some(other) => return Err(self.error(key, wrong_type("an array of tables ([[..]])", other))),
        };
        let mut tables = Vec::with_capacity(items.len());
        for (index, item) in items.iter().enumerate() {
            let path = format!("{}[{index}]", self.path_of(key));
            match item.get_ref() {
                DeValue::Table(table) => tables.push(self.child(path, item.span().start, table)),
                other => return Err(self.error_at(item.span().start, path, wrong_type("a table", other))),
            }
        }
        Ok(tables)
    }

    /// Refuses keys that no getter has asked for.
    pub fn finish(&self) -> Result<(), ScenarioError> {
        let asked = self.asked.borrow();
        for key in self.table.keys() {
            let name = key.get_ref().as_ref();
            if !asked.contains(&name) {
                let problem = Problem::UnknownKey { known: asked.clone() };
                return Err(self.error_at(key.span().start, self.path_of(name), problem));
            }
        }
        Ok(())
    }
}

fn number(value: &DeValue<'_>, low: f64, high: f64) -> Result<f64, Problem> {
    let parsed = match value {
        DeValue::Float(float) => float.as_str().replace('_', "").parse().ok(),
        DeValue::Integer(integer) => {
            i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|value| value as f64)
        }
        other => return Err(wrong_type("a number", other)),
    };
    let found: f64 = parsed.unwrap_or(f64::NAN);
    if (low..=high).contains(&found) {
        return Ok(found);
    }
    let range = if high == f64::MAX { format!("{low} and up") } else { format!("{low} to {high}") };
    Err(Problem::OutOfRange { found: found.to_string(), range })
}

/// Reads `0E5#084F0000803E`, the frame field of a candump line.
pub fn parse_frame(text: &str) -> Result<Frame, Problem> {
    let line = format!("(0.0) can0 {text}");
    match Record::parse(line.as_bytes()) {
        Ok(record) => Ok(record.frame),
        Err(_) => Err(Problem::Invalid(format!("'{text}' is no frame; write it as 0E5#084F0000803E"))),
    }
}

fn wrong_type(expected: &'static str, found: &DeValue<'_>) -> Problem {
    let found = match found {
        DeValue::String(_) => "a string",
        DeValue::Integer(_) => "a whole number",
        DeValue::Float(_) => "a number",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    };
    Problem::WrongType { expected, found }
}
