//! What a value must be.

use std::ops::RangeInclusive;

use toml::de::DeValue;

use crate::document::{Section, Value};
use crate::document_error::{DocumentError, Problem};

/// Each of these refuses a value of another type or outside its range.
impl<'a, P: From<Problem>> Value<'a, P> {
    /// A finite number.
    ///
    /// # Errors
    /// The value is not a finite number.
    pub fn number(&self) -> Result<f64, DocumentError<P>> {
        let parsed = match self.value.get_ref() {
            DeValue::Float(float) => float.as_str().replace('_', "").parse::<f64>().ok(),
            DeValue::Integer(integer) => {
                i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|integer| integer as f64)
            }
            _ => return Err(self.wrong_type("a number")),
        };
        match parsed {
            Some(number) if number.is_finite() => Ok(number),
            other => Err(self.error(Problem::NotFinite(other.unwrap_or(f64::NAN)))),
        }
    }

    /// A finite number within `min..=max`.
    ///
    /// # Errors
    /// The value is not such a number.
    pub fn number_in(&self, min: f64, max: f64) -> Result<f64, DocumentError<P>> {
        let value = self.number()?;
        if (min..=max).contains(&value) {
            return Ok(value);
        }
        Err(self.error(Problem::OutOfRange { value, min, max }))
    }

    /// A finite number above zero.
    ///
    /// # Errors
    /// The value is not such a number.
    pub fn positive(&self) -> Result<f64, DocumentError<P>> {
        let value = self.number()?;
        if value > 0.0 { Ok(value) } else { Err(self.error(Problem::NotPositive(value))) }
    }

    /// A finite number, zero or above.
    ///
    /// # Errors
    /// The value is not such a number.
    pub fn non_negative(&self) -> Result<f64, DocumentError<P>> {
        let value = self.number()?;
        if value >= 0.0 { Ok(value) } else { Err(self.error(Problem::Negative(value))) }
    }

    /// A whole number.
    ///
    /// # Errors
    /// The value is not a whole number, or is beyond 64 bits.
    pub fn any_integer(&self) -> Result<i64, DocumentError<P>> {
        match self.value.get_ref() {
            DeValue::Integer(integer) => {
                i64::from_str_radix(integer.as_str(), integer.radix()).map_err(|_| {
                    self.error(Problem::WrongType { expected: "a 64-bit integer", found: "a larger one" })
                })
            }
            _ => Err(self.wrong_type("an integer")),
        }
    }

    /// A whole number within `range`.
    ///
    /// # Errors
    /// The value is not such a number.
    pub fn integer(&self, range: RangeInclusive<i64>) -> Result<i64, DocumentError<P>> {
        let value = self.any_integer()?;
        if range.contains(&value) {
            return Ok(value);
        }
        let (value, min, max) = (value as f64, *range.start() as f64, *range.end() as f64);
        Err(self.error(Problem::OutOfRange { value, min, max }))
    }

    /// A whole number, zero or above.
    ///
    /// # Errors
    /// The value is not such a number.
    pub fn count(&self) -> Result<u64, DocumentError<P>> {
        let value = self.any_integer()?;
        u64::try_from(value).map_err(|_| self.error(Problem::Negative(value as f64)))
    }

    /// True or false.
    ///
    /// # Errors
    /// The value has another type.
    pub fn boolean(&self) -> Result<bool, DocumentError<P>> {
        match self.value.get_ref() {
            DeValue::Boolean(value) => Ok(*value),
            _ => Err(self.wrong_type("a boolean")),
        }
    }

    /// A string.
    ///
    /// # Errors
    /// The value has another type.
    pub fn text(&self) -> Result<&'a str, DocumentError<P>> {
        match self.value.get_ref() {
            DeValue::String(text) => Ok(text.as_ref()),
            _ => Err(self.wrong_type("a string")),
        }
    }

    /// The meaning of one of a fixed set of words.
    ///
    /// # Errors
    /// The word is unknown, or the value is not a string.
    pub fn word<T: Copy>(&self, known: &[(&'static str, T)]) -> Result<T, DocumentError<P>> {
        let found = self.text()?;
        known.iter().find(|(word, _)| *word == found).map(|(_, meaning)| *meaning).ok_or_else(|| {
            let known = known.iter().map(|(word, _)| *word).collect();
            self.error(Problem::UnknownWord { found: found.to_owned(), known })
        })
    }

    /// A table.
    ///
    /// # Errors
    /// The value has another type.
    pub fn section(&self) -> Result<Section<'a, P>, DocumentError<P>> {
        match self.value.get_ref() {
            DeValue::Table(table) => {
                Ok(Section::new(self.source, self.path.clone(), self.value.span().start, table))
            }
            _ => Err(self.wrong_type("a table")),
        }
    }

    /// The values of a list, each with its place.
    ///
    /// # Errors
    /// The value is not a list.
    pub fn items(&self) -> Result<Vec<Self>, DocumentError<P>> {
        let DeValue::Array(items) = self.value.get_ref() else {
            return Err(self.wrong_type("a list"));
        };
        let place = |index| format!("{}[{index}]", self.path);
        Ok(items.iter().enumerate().map(|(i, item)| Self::new(self.source, place(i), item)).collect())
    }

    /// The values of a list, or the value itself where people left out the brackets.
    #[must_use]
    pub fn one_or_more(&self) -> Vec<Self> {
        self.items().unwrap_or_else(|_| vec![Self::new(self.source, self.path.clone(), self.value)])
    }

    /// A list of exactly `K` finite numbers.
    ///
    /// # Errors
    /// The list has another length, or an item is not a finite number.
    pub fn numbers<const K: usize>(&self) -> Result<[f64; K], DocumentError<P>> {
        let items = self.items()?;
        if items.len() != K {
            return Err(self.error(Problem::WrongLength { expected: K, found: items.len() }));
        }
        let mut numbers = [0.0; K];
        for (number, item) in numbers.iter_mut().zip(&items) {
            *number = item.number()?;
        }
        Ok(numbers)
    }

    /// Refuses a value of another type than `expected`.
    #[must_use]
    pub fn wrong_type(&self, expected: &'static str) -> DocumentError<P> {
        let found = match self.value.get_ref() {
            DeValue::String(_) => "a string",
            DeValue::Integer(_) => "an integer",
            DeValue::Float(_) => "a number",
            DeValue::Boolean(_) => "a boolean",
            DeValue::Datetime(_) => "a date",
            DeValue::Array(_) => "a list",
            DeValue::Table(_) => "a table",
        };
        self.error(Problem::WrongType { expected, found })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::Source;

    /// The refusal of `x = ...`, without file and line. Leaks the text, so that methods can be named as they are.
    fn refused<T: std::fmt::Debug>(
        value: &str,
        read: impl FnOnce(&Value<'static>) -> Result<T, DocumentError<Problem>>,
    ) -> String {
        let source = Source { file: "f", text: format!("x = {value}").leak() };
        let document = Box::leak(Box::new(source.parse::<Problem>().unwrap()));
        let refusal = source.root(document).required("x", read).unwrap_err();
        assert_eq!((refusal.line, refusal.file.as_str()), (Some(1), "f"));
        format!("{}: {}", refusal.key, refusal.problem)
    }

    #[test]
    fn each_kind_of_value_refuses_all_others_by_name() {
        assert_eq!(refused("true", Value::number), "x: expected a number, found a boolean");
        assert_eq!(refused("nan", Value::number), "x: NaN is not a finite number");
        assert_eq!(refused("0", Value::positive), "x: 0 must be greater than zero");
        assert_eq!(refused("-0.5", Value::non_negative), "x: -0.5 must not be negative");
        assert_eq!(refused("2", |v| v.number_in(0.0, 1.0)), "x: 2 is outside 0 to 1");
        assert_eq!(refused("1.0", Value::any_integer), "x: expected an integer, found a number");
        assert_eq!(
            refused("99999999999999999999", Value::any_integer),
            "x: expected a 64-bit integer, found a larger one"
        );
        assert_eq!(refused("0x20", |v| v.integer(1..=31)), "x: 32 is outside 1 to 31");
        assert_eq!(refused("-1", Value::count), "x: -1 must not be negative");
        assert_eq!(refused("1", Value::boolean), "x: expected a boolean, found an integer");
        assert_eq!(refused("[]", Value::text), "x: expected a string, found a list");
        assert_eq!(refused("'c'", |v| v.word(&[("a", 1), ("b", 2)])), "x: unknown value `c` (known: a, b)");
        assert_eq!(refused("1979-05-27", |v| v.section().map(|_| ())), "x: expected a table, found a date");
        assert_eq!(refused("[1, 2]", Value::numbers::<3>), "x: expected 3 values, found 2");
        assert_eq!(refused("[1, 'a', 3]", Value::numbers::<3>), "x[1]: expected a number, found a string");
    }

    #[test]
    fn numbers_are_read_in_every_notation() {
        for (text, number) in [("1_000.5", 1000.5), ("0x10", 16.0), ("-3", -3.0), ("1e-3", 1e-3)] {
            let text = format!("x = {text}");
            let source = Source { file: "f", text: &text };
            let document = source.parse::<Problem>().unwrap();
            assert_eq!(source.root::<Problem>(&document).required("x", Value::number), Ok(number));
        }
    }
}
