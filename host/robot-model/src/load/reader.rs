//! A cursor over a TOML document that knows where it is.
//!
//! Every refusal must name file, line, key path and reason. Deserialising into structs loses the key path of
//! type errors and the line of range errors, so the document is walked with its spans instead: each getter
//! checks type and range at once, remembers the key, and [`Section::finish`] refuses what nobody asked for.

use std::cell::RefCell;
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::error::{LoadError, Problem};

/// The text being read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Source<'a> {
    pub(crate) file: &'a str,
    pub(crate) text: &'a str,
}

impl Source<'_> {
    pub(crate) fn line_of(&self, at: usize) -> usize {
        1 + self.text.as_bytes().iter().take(at).filter(|b| **b == b'\n').count()
    }

    pub(crate) fn error(&self, at: usize, key: String, problem: Problem) -> LoadError {
        LoadError { file: self.file.to_owned(), line: Some(self.line_of(at)), key, problem }
    }
}

/// One table of the document.
#[derive(Debug)]
pub(crate) struct Section<'a> {
    source: Source<'a>,
    path: String,
    start: usize,
    table: &'a DeTable<'a>,
    asked: RefCell<Vec<&'static str>>,
}

impl<'a> Section<'a> {
    pub(crate) fn root(source: Source<'a>, document: &'a Spanned<DeTable<'a>>) -> Self {
        Self::new(source, String::new(), 0, document.get_ref())
    }

    fn new(source: Source<'a>, path: String, start: usize, table: &'a DeTable<'a>) -> Self {
        Self { source, path, start, table, asked: RefCell::default() }
    }

    fn path_of(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    fn get(&self, key: &'static str) -> Option<&'a Spanned<DeValue<'a>>> {
        self.asked.borrow_mut().push(key);
        self.table.get(key)
    }

    fn require(&self, key: &'static str) -> Result<&'a Spanned<DeValue<'a>>, LoadError> {
        self.get(key).ok_or_else(|| self.error(key, Problem::Missing))
    }

    /// Error at `key` of this section, or at the section if the key is absent or empty.
    pub(crate) fn error(&self, key: &str, problem: Problem) -> LoadError {
        let at = self.table.get(key).map_or(self.start, |v| v.span().start);
        let path = if key.is_empty() { self.path.clone() } else { self.path_of(key) };
        self.source.error(at, path, problem)
    }

    pub(crate) fn has(&self, key: &'static str) -> bool {
        self.table.contains_key(key)
    }

    pub(crate) fn f64(&self, key: &'static str) -> Result<f64, LoadError> {
        let value = self.require(key)?;
        number(value.get_ref()).map_err(|p| self.error(key, p))
    }

    pub(crate) fn f64_or(&self, key: &'static str, default: f64) -> Result<f64, LoadError> {
        if self.has(key) {
            self.f64(key)
        } else {
            self.asked.borrow_mut().push(key);
            Ok(default)
        }
    }

    pub(crate) fn positive(&self, key: &'static str) -> Result<f64, LoadError> {
        let value = self.f64(key)?;
        if value > 0.0 { Ok(value) } else { Err(self.error(key, Problem::NotPositive(value))) }
    }

    pub(crate) fn positive_if_given(&self, key: &'static str) -> Result<Option<f64>, LoadError> {
        if self.has(key) {
            self.positive(key).map(Some)
        } else {
            self.asked.borrow_mut().push(key);
            Ok(None)
        }
    }

    pub(crate) fn non_negative(&self, key: &'static str) -> Result<f64, LoadError> {
        let value = self.f64(key)?;
        if value >= 0.0 { Ok(value) } else { Err(self.error(key, Problem::Negative(value))) }
    }

    pub(crate) fn integer(&self, key: &'static str, range: Range<i64>) -> Result<i64, LoadError> {
        let value = self.any_integer(key)?;
        if range.contains(&value) {
            Ok(value)
        } else {
            let (value, min, max) = (value as f64, range.start as f64, (range.end - 1) as f64);
            Err(self.error(key, Problem::OutOfRange { value, min, max }))
        }
    }

    pub(crate) fn any_integer(&self, key: &'static str) -> Result<i64, LoadError> {
        let value = self.require(key)?;
        match value.get_ref() {
            DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).map_err(|_| {
                self.error(key, Problem::WrongType { expected: "a 64-bit integer", found: "a larger one" })
            }),
            other => Err(self.error(key, wrong_type("an integer", other))),
        }
    }

    pub(crate) fn text(&self, key: &'static str) -> Result<&'a str, LoadError> {
        let value = self.require(key)?;
        match value.get_ref() {
            DeValue::String(s) => Ok(s.as_ref()),
            other => Err(self.error(key, wrong_type("a string", other))),
        }
    }

    pub(crate) fn text_or(&self, key: &'static str, default: &'a str) -> Result<&'a str, LoadError> {
        if self.has(key) {
            self.text(key)
        } else {
            self.asked.borrow_mut().push(key);
            Ok(default)
        }
    }

    /// One of a fixed set of words.
    pub(crate) fn choice<T: Copy>(
        &self,
        key: &'static str,
        known: &[(&'static str, T)],
    ) -> Result<T, LoadError> {
        let found = self.text(key)?;
        known.iter().find(|(word, _)| *word == found).map(|(_, value)| *value).ok_or_else(|| {
            let known = known.iter().map(|(word, _)| *word).collect();
            self.error(key, Problem::UnknownChoice { found: found.to_owned(), known })
        })
    }

    fn items(&self, key: &'static str) -> Result<&'a [Spanned<DeValue<'a>>], LoadError> {
        let value = self.require(key)?;
        match value.get_ref() {
            DeValue::Array(items) => Ok(items.as_ref()),
            other => Err(self.error(key, wrong_type("a list", other))),
        }
    }

    /// A list of exactly `K` finite numbers.
    pub(crate) fn numbers<const K: usize>(&self, key: &'static str) -> Result<[f64; K], LoadError> {
        let items = self.items(key)?;
        if items.len() != K {
            return Err(self.error(key, Problem::WrongLength { expected: K, found: items.len() }));
        }
        let mut out = [0.0; K];
        for (i, (slot, item)) in out.iter_mut().zip(items).enumerate() {
            *slot = number(item.get_ref()).map_err(|p| {
                self.source.error(item.span().start, format!("{}[{i}]", self.path_of(key)), p)
            })?;
        }
        Ok(out)
    }

    pub(crate) fn numbers_or<const K: usize>(
        &self,
        key: &'static str,
        default: [f64; K],
    ) -> Result<[f64; K], LoadError> {
        if self.has(key) {
            self.numbers(key)
        } else {
            self.asked.borrow_mut().push(key);
            Ok(default)
        }
    }

    /// A list of strings with, for each, a way to raise an error at its place.
    pub(crate) fn texts(&self, key: &'static str) -> Result<Vec<Item<'a>>, LoadError> {
        let items = self.items(key)?;
        let mut out = Vec::with_capacity(items.len());
        for (i, item) in items.iter().enumerate() {
            let path = format!("{}[{i}]", self.path_of(key));
            match item.get_ref() {
                DeValue::String(s) => {
                    out.push(Item { text: s.as_ref(), source: self.source, path, start: item.span().start });
                }
                other => {
                    return Err(self.source.error(item.span().start, path, wrong_type("a string", other)));
                }
            }
        }
        Ok(out)
    }

    pub(crate) fn section(&self, key: &'static str) -> Result<Section<'a>, LoadError> {
        let value = self.require(key)?;
        match value.get_ref() {
            DeValue::Table(t) => Ok(Section::new(self.source, self.path_of(key), value.span().start, t)),
            other => Err(self.error(key, wrong_type("a table", other))),
        }
    }

    pub(crate) fn section_if_given(&self, key: &'static str) -> Result<Option<Section<'a>>, LoadError> {
        if self.has(key) {
            self.section(key).map(Some)
        } else {
            self.asked.borrow_mut().push(key);
            Ok(None)
        }
    }

    /// The tables of an array of tables (`[[key]]`); none if the key is absent.
    pub(crate) fn sections(&self, key: &'static str) -> Result<Vec<Section<'a>>, LoadError> {
        if !self.has(key) {
            self.asked.borrow_mut().push(key);
            return Ok(Vec::new());
        }
        let mut out = Vec::new();
        for (i, item) in self.items(key)?.iter().enumerate() {
            let path = format!("{}[{i}]", self.path_of(key));
            match item.get_ref() {
                DeValue::Table(t) => out.push(Section::new(self.source, path, item.span().start, t)),
                other => {
                    return Err(self.source.error(item.span().start, path, wrong_type("a table", other)));
                }
            }
        }
        Ok(out)
    }

    /// Refuses keys that no getter has asked for.
    pub(crate) fn finish(&self) -> Result<(), LoadError> {
        let asked = self.asked.borrow();
        for key in self.table.keys() {
            let name = key.get_ref().as_ref();
            if !asked.contains(&name) {
                let expected = asked.clone();
                let same_quantity = asked.iter().copied().find(|known| quantity(known) == quantity(name));
                let problem = Problem::UnknownKey { same_quantity, expected };
                return Err(self.source.error(key.span().start, self.path_of(name), problem));
            }
        }
        Ok(())
    }
}

/// A string of a list, with its place.
#[derive(Debug)]
pub(crate) struct Item<'a> {
    pub(crate) text: &'a str,
    source: Source<'a>,
    path: String,
    start: usize,
}

impl Item<'_> {
    pub(crate) fn error(&self, problem: Problem) -> LoadError {
        self.source.error(self.start, self.path.clone(), problem)
    }
}

/// Key without its unit: `range_deg` and `range_rad` are the same quantity.
fn quantity(key: &str) -> &str {
    const UNITS: [&str; 17] = [
        "_deg_s3", "_rad_s3", "_deg_s2", "_rad_s2", "_m_s2", "_deg_s", "_rad_s", "_kg_m2", "_deg", "_rad",
        "_mm", "_cm", "_m", "_kg", "_g", "_nm", "_a",
    ];
    UNITS.iter().find_map(|unit| key.strip_suffix(unit)).unwrap_or(key)
}

fn number(value: &DeValue<'_>) -> Result<f64, Problem> {
    let parsed = match value {
        DeValue::Float(f) => f.as_str().replace('_', "").parse::<f64>().ok(),
        DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).ok().map(|i| i as f64),
        other => return Err(wrong_type("a number", other)),
    };
    match parsed {
        Some(v) if v.is_finite() => Ok(v),
        other => Err(Problem::NotFinite(other.unwrap_or(f64::NAN))),
    }
}

fn wrong_type(expected: &'static str, found: &DeValue<'_>) -> Problem {
    let found = match found {
        DeValue::String(_) => "a string",
        DeValue::Integer(_) => "an integer",
        DeValue::Float(_) => "a number",
        DeValue::Boolean(_) => "a boolean",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    };
    Problem::WrongType { expected, found }
}
