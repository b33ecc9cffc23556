//! Reading the keys of a table.

use crate::document::{Section, Value};
use crate::document_error::{DocumentError, Problem};

impl<'a, P: From<Problem>> Section<'a, P> {
    /// The value read by `read`, or `None` if the key is absent.
    ///
    /// # Errors
    /// The problem that `read` returns.
    pub fn optional<T>(
        &self,
        key: &'static str,
        read: impl FnOnce(&Value<'a, P>) -> Result<T, DocumentError<P>>,
    ) -> Result<Option<T>, DocumentError<P>> {
        self.get(key).map(|value| read(&value)).transpose()
    }

    /// The value read by `read`, or `default` if the key is absent.
    ///
    /// # Errors
    /// The problem that `read` returns.
    pub fn or<T>(
        &self,
        key: &'static str,
        default: T,
        read: impl FnOnce(&Value<'a, P>) -> Result<T, DocumentError<P>>,
    ) -> Result<T, DocumentError<P>> {
        Ok(self.optional(key, read)?.unwrap_or(default))
    }

    /// The value read by `read`.
    ///
    /// # Errors
    /// The problem that `read` returns, or an absent key.
    pub fn required<T>(
        &self,
        key: &'static str,
        read: impl FnOnce(&Value<'a, P>) -> Result<T, DocumentError<P>>,
    ) -> Result<T, DocumentError<P>> {
        self.optional(key, read)?.ok_or_else(|| self.error(key, Problem::Missing))
    }

    /// The tables of an array of tables (`[[key]]`); empty if the key is absent.
    ///
    /// # Errors
    /// The value has another type.
    pub fn sections(&self, key: &'static str) -> Result<Vec<Self>, DocumentError<P>> {
        self.or(key, Vec::new(), |value| {
            let items = value.items().map_err(|_| value.wrong_type("an array of tables ([[..]])"))?;
            items.iter().map(Value::section).collect()
        })
    }

    /// Refuses another version of the schema than `supported`.
    ///
    /// # Errors
    /// [`Problem::Schema`], or the key is absent or not a number.
    pub fn schema(&self, key: &'static str, supported: i64) -> Result<(), DocumentError<P>> {
        let found = self.required(key, Value::any_integer)?;
        if found == supported {
            return Ok(());
        }
        Err(self.error(key, Problem::Schema { found, supported }))
    }

    /// Refuses keys that were not requested.
    ///
    /// # Errors
    /// [`Problem::UnknownKey`] for the first such key.
    pub fn finish(&self) -> Result<(), DocumentError<P>> {
        let asked = self.asked.borrow();
        for key in self.table.keys() {
            let name = key.get_ref().as_ref();
            if !asked.contains(&name) {
                let same_quantity = asked.iter().copied().find(|known| quantity(known) == quantity(name));
                let problem = Problem::UnknownKey { same_quantity, known: asked.clone() };
                return Err(self.source.refusal(key.span().start, self.path_of(name), problem.into()));
            }
        }
        Ok(())
    }
}

/// Key without its unit: `range_deg` and `range_rad` are the same quantity.
fn quantity(key: &str) -> &str {
    const UNITS: [&str; 20] = [
        "_deg_s3", "_rad_s3", "_deg_s2", "_rad_s2", "_m_s2", "_deg_s", "_rad_s", "_kg_m2", "_deg", "_rad",
        "_mm", "_cm", "_kg", "_nm", "_ms", "_us", "_m", "_g", "_a", "_s",
    ];
    UNITS.iter().find_map(|unit| key.strip_suffix(unit)).unwrap_or(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::Source;

    #[test]
    fn a_key_is_the_same_quantity_in_another_unit_and_nothing_else() {
        for (a, b) in [("range_deg", "range_rad"), ("v_max_deg_s", "v_max_rad_s"), ("by_s", "by_ms")] {
            assert_eq!(quantity(a), quantity(b));
        }
        for (a, b) in [("range_deg", "range_deg_s"), ("mass_kg", "length_m"), ("joint", "joint_s")] {
            assert_ne!(quantity(a), b, "{a}");
        }
        assert_ne!(quantity("range_deg"), quantity("speed_deg"));
    }

    #[test]
    fn refusals_count_lines_from_one_and_name_nested_keys() {
        let source = Source { file: "x.toml", text: "a = 1\n[[b]]\n[[b]]\n[b.c]\nd_deg = 2\n" };
        let document = source.parse::<Problem>().unwrap();
        let root: Section<'_> = source.root(&document);
        let c = root.sections("b").unwrap()[1].required("c", Value::section).unwrap();
        assert_eq!(c.optional("d_rad", Value::number), Ok(None));
        let refusal = c.finish().unwrap_err();
        assert_eq!((refusal.line, refusal.key.as_str()), (Some(5), "b[1].c.d_deg"));
        assert!(refusal.to_string().ends_with("as `d_rad` (mind the unit)"), "{refusal}");
        // `b` was requested, `a` was not.
        assert_eq!(root.finish().unwrap_err().key, "a");
    }
}
