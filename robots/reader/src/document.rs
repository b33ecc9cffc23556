//! A document, its tables and its values, each with its place in the text.

use std::cell::RefCell;
use std::marker::PhantomData;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::document_error::{DocumentError, Problem};

/// The text being read.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// What refusals call it.
    pub file: &'a str,
    /// All of it.
    pub text: &'a str,
}

impl<'a> Source<'a> {
    /// Parses the text.
    ///
    /// # Errors
    /// [`Problem::Syntax`] with its line.
    pub fn parse<P: From<Problem>>(&self) -> Result<Spanned<DeTable<'a>>, DocumentError<P>> {
        DeTable::parse(self.text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            self.refusal(at, String::new(), Problem::Syntax(error.message().to_owned()).into())
        })
    }

    /// The document itself, as parsed from this text.
    pub fn root<P>(&self, document: &'a Spanned<DeTable<'a>>) -> Section<'a, P> {
        Section::new(*self, String::new(), 0, document.get_ref())
    }

    pub(crate) fn refusal<P>(&self, at: usize, key: String, problem: P) -> DocumentError<P> {
        let line = 1 + self.text.as_bytes().iter().take(at).filter(|byte| **byte == b'\n').count();
        DocumentError { file: self.file.to_owned(), line: Some(line), key, problem }
    }
}

/// One table of the document. It remembers which keys were requested.
#[derive(Debug)]
pub struct Section<'a, P = Problem> {
    pub(crate) source: Source<'a>,
    pub(crate) path: String,
    pub(crate) start: usize,
    pub(crate) table: &'a DeTable<'a>,
    pub(crate) asked: RefCell<Vec<&'static str>>,
    problem: PhantomData<P>,
}

impl<'a, P> Section<'a, P> {
    pub(crate) fn new(source: Source<'a>, path: String, start: usize, table: &'a DeTable<'a>) -> Self {
        Self { source, path, start, table, asked: RefCell::default(), problem: PhantomData }
    }

    pub(crate) fn path_of(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    pub(crate) fn get(&self, key: &'static str) -> Option<Value<'a, P>> {
        let mut asked = self.asked.borrow_mut();
        if !asked.contains(&key) {
            asked.push(key);
        }
        self.table.get(key).map(|value| Value::new(self.source, self.path_of(key), value))
    }

    /// Refusal at `key` of this table, or at the table if the key is absent or empty.
    pub fn error(&self, key: &str, problem: impl Into<P>) -> DocumentError<P> {
        let at = self.table.get(key).map_or(self.start, |value| value.span().start);
        let path = if key.is_empty() { self.path.clone() } else { self.path_of(key) };
        self.source.refusal(at, path, problem.into())
    }

    /// True if the key is there; this does not count as a request.
    #[must_use]
    pub fn has(&self, key: &str) -> bool {
        self.table.contains_key(key)
    }
}

/// A value of the document, with its place.
#[derive(Debug)]
pub struct Value<'a, P = Problem> {
    pub(crate) source: Source<'a>,
    pub(crate) path: String,
    pub(crate) value: &'a Spanned<DeValue<'a>>,
    problem: PhantomData<P>,
}

impl<'a, P> Value<'a, P> {
    pub(crate) fn new(source: Source<'a>, path: String, value: &'a Spanned<DeValue<'a>>) -> Self {
        Self { source, path, value, problem: PhantomData }
    }

    /// Refusal at this value.
    pub fn error(&self, problem: impl Into<P>) -> DocumentError<P> {
        self.source.refusal(self.value.span().start, self.path.clone(), problem.into())
    }
}
