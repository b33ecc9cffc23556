//! Values of registers as people, TOML and JSON have them.

use operator::dialogue::registers::Numbers;

/// As a person writes and reads it: `0.5,0.5,1.0`.
pub(super) fn text(value: &Numbers) -> String {
    match value {
        Numbers::Text(text) => text.clone(),
        _ => elements(value).join(","),
    }
}

/// As TOML: a number or truth value, or an array with one per joint.
pub(super) fn toml(value: &Numbers) -> String {
    let elements = elements(value);
    match elements.as_slice() {
        [one] => one.clone(),
        all => format!("[{}]", all.join(", ")),
    }
}

/// The numbers, shortest form that reads back to the same single-precision number.
fn elements(value: &Numbers) -> Vec<String> {
    match value {
        Numbers::Real(all) => all.iter().map(|x| format!("{x:?}")).collect(),
        Numbers::Natural(all) => all.iter().map(ToString::to_string).collect(),
        Numbers::Bit(all) => all.iter().map(ToString::to_string).collect(),
        Numbers::Text(text) => vec![format!("{text:?}")],
    }
}

/// As JSON, always an array where there is one per joint.
pub(super) fn json(value: &Numbers) -> serde_json::Value {
    // The shortest decimal form, so that 0.1 is not 0.10000000149.
    let real = |x: &f32| format!("{x:?}").parse::<f64>().map_or(serde_json::Value::Null, Into::into);
    let all: Vec<serde_json::Value> = match value {
        Numbers::Real(all) => all.iter().map(real).collect(),
        Numbers::Natural(all) => all.iter().map(|x| (*x).into()).collect(),
        Numbers::Bit(all) => all.iter().map(|x| (*x).into()).collect(),
        Numbers::Text(text) => vec![text.clone().into()],
    };
    match <[serde_json::Value; 1]>::try_from(all) {
        Ok([one]) => one,
        Err(all) => all.into(),
    }
}

pub(super) const fn kind(value: &Numbers) -> &'static str {
    match value {
        Numbers::Real(_) => "real",
        Numbers::Natural(_) => "natural",
        Numbers::Bit(_) => "bit",
        Numbers::Text(_) => "text",
    }
}

/// Reads values of the kind and number of `like`; one value stands for all joints.
pub(super) fn parse<'a>(like: &Numbers, parts: impl Iterator<Item = &'a str>) -> Result<Numbers, String> {
    let parts: Vec<&str> = parts.map(str::trim).collect();
    fn all<T: Clone>(
        parts: &[&str],
        count: usize,
        read: impl Fn(&str) -> Option<T>,
        what: &str,
    ) -> Result<Vec<T>, String> {
        let values: Result<Vec<T>, String> =
            parts.iter().map(|part| read(part).ok_or_else(|| format!("'{part}' is no {what}"))).collect();
        match values?.as_slice() {
            [one] => Ok(vec![one.clone(); count]),
            all if all.len() == count => Ok(all.to_vec()),
            all => Err(format!("{} values; it has {count}", all.len())),
        }
    }
    match like {
        Numbers::Real(old) => {
            let read = |part: &str| part.parse::<f32>().ok().filter(|x| x.is_finite());
            all(&parts, old.len(), read, "finite number").map(Numbers::Real)
        }
        Numbers::Natural(old) => {
            let read = |part: &str| part.parse::<u32>().ok().map(u64::from);
            all(&parts, old.len(), read, "natural number below 2^32").map(Numbers::Natural)
        }
        Numbers::Bit(old) => {
            let read = |part: &str| match part {
                "true" | "1" => Some(true),
                "false" | "0" => Some(false),
                _ => None,
            };
            all(&parts, old.len(), read, "truth value (true or false)").map(Numbers::Bit)
        }
        Numbers::Text(_) => Err("it cannot be written here".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_by_the_kind_and_number_of_the_register() {
        let real = Numbers::Real(vec![0.0; 3]);
        let read = |like: &Numbers, text: &str| parse(like, text.split(','));
        assert_eq!(read(&real, "0.1, 2,3e-2"), Ok(Numbers::Real(vec![0.1, 2.0, 0.03])));
        assert_eq!(read(&real, "0.5"), Ok(Numbers::Real(vec![0.5; 3])), "one for all joints");
        assert_eq!(read(&Numbers::Bit(vec![false]), "true"), Ok(Numbers::Bit(vec![true])));
        for (like, wrong) in [
            (&real, "1,2"),
            (&real, "1,2,nan"),
            (&real, "fast"),
            (&Numbers::Natural(vec![0]), "-1"),
            (&Numbers::Natural(vec![0]), "4294967296"),
            (&Numbers::Natural(vec![0]), "0.5"),
            (&Numbers::Bit(vec![false]), "yes"),
            (&Numbers::Text(String::new()), "x"),
        ] {
            assert!(read(like, wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_number_is_written_so_that_it_reads_back_as_the_same() {
        let value = Numbers::Real(vec![0.1, 3.1, 1e-7, -0.0, 16_777_216.0]);
        let parsed: toml::Table = toml::from_str(&format!("x = {}", toml(&value))).unwrap();
        let back: Vec<f32> =
            parsed["x"].as_array().unwrap().iter().map(|x| x.as_float().unwrap() as f32).collect();
        assert_eq!(Numbers::Real(back), value);
        assert_eq!(parse(&value, text(&value).split(',')), Ok(value.clone()));
        assert_eq!(json(&value)[0], 0.1);
    }
}
