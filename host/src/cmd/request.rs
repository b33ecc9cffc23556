//! The request of a verb from data: its arguments are the type, the fields have the names of the options with `_` for `-`.
//!
//! Defaults, exclusions and parsers of values come from the definition of the command line. The name of a field for serde may begin with `+`
//! or `-`: `+` marks a group of fields, `-` a field that keeps its default and that data cannot set.

use std::cell::RefCell;

use clap::{Arg, ArgAction, Command};
use serde::de::value::{Error, SeqDeserializer};
use serde::de::{DeserializeOwned, DeserializeSeed, Deserializer, Error as _, MapAccess, Visitor};
use serde_json::{Map, Value};

use crate::error::ExpectedError;
use crate::exit;

/// The request of the verb `verb` from the text of a JSON object.
///
/// # Errors
/// With [`exit::USAGE`]: an unknown field by its name, a value with its field and what is expected, two fields that exclude each other.
pub(crate) fn read<A: clap::Args + DeserializeOwned>(
    verb: &'static str,
    text: &str,
) -> Result<A, ExpectedError> {
    let refused = |what: String| {
        ExpectedError::new(exit::USAGE, what)
            .next(format!("`cubectl {verb} --help` describes the option of each field"))
    };
    let mut data: Map<String, Value> =
        serde_json::from_str(text).map_err(|error| refused(error.to_string()))?;
    let mut command = A::augment_args(Command::new(verb));
    command.build();
    let known = names::<A>(&command);
    if let Some(name) = data.keys().find(|name| !known.contains(&name.as_str())) {
        return Err(ExpectedError::new(exit::USAGE, format!("there is no field `{name}`"))
            .next(format!("the fields are {}", known.join(", "))));
    }
    // What a command line would leave out.
    data.retain(|name, value| match value {
        Value::Null => false,
        Value::Bool(false) => option(&command, name).is_none_or(|arg| !is_switch(arg)),
        Value::Array(items) => !items.is_empty(),
        _ => true,
    });
    let given: Vec<&Arg> = data.keys().filter_map(|name| option(&command, name)).collect();
    for arg in &given {
        let excluded = command.get_arg_conflicts_with(arg);
        if let Some(other) =
            given.iter().find(|other| excluded.iter().any(|arg| arg.get_id() == other.get_id()))
        {
            let mut pair = [arg, other].map(|arg| name_of(arg));
            pair.sort();
            let [one, other] = pair;
            return Err(refused(format!("`{one}` and `{other}` exclude each other")));
        }
    }
    let fields = Fields { command: &command, data: &data, names: RefCell::default() };
    A::deserialize(&fields).map_err(|error| refused(error.to_string()))
}

/// The arguments of a group that data has no fields for.
pub(crate) fn usual<A: clap::Args>() -> A {
    let bare = A::augment_args(Command::new("")).no_binary_name(true).try_get_matches_from([""; 0]);
    bare.and_then(|matches| A::from_arg_matches(&matches))
        .unwrap_or_else(|error| unreachable!("every option of the group has a default: {error}"))
}

/// The text of a value, for the reader that the command line has for it: numbers and lists of them are written as there.
///
/// # Errors
/// Neither text nor number nor a list of them.
pub(crate) fn text_of<'de, D: Deserializer<'de>>(data: D) -> Result<String, D::Error> {
    fn text(value: &Value) -> Option<String> {
        match value {
            Value::String(text) => Some(text.clone()),
            Value::Number(number) => Some(number.to_string()),
            Value::Array(items) => {
                let between = if items.iter().any(Value::is_array) { ";" } else { "," };
                Some(items.iter().map(text).collect::<Option<Vec<_>>>()?.join(between))
            }
            _ => None,
        }
    }
    let value = <Value as serde::Deserialize>::deserialize(data)?;
    text(&value)
        .ok_or_else(|| D::Error::custom(format!("{value} is not a text, a number or a list of numbers")))
}

/// Makes functions for `deserialize_with` of serde. Each reads a value as the command line does; the field may be optional.
macro_rules! readers {
    ($($name:ident: $read:expr => $kind:ty;)*) => { $(
        fn $name<'de, D: serde::Deserializer<'de>, T: From<$kind>>(data: D) -> Result<T, D::Error> {
            let read: fn(&str) -> Result<$kind, _> = $read;
            let value = read(&$crate::cmd::request::text_of(data)?);
            value.map(T::from).map_err(serde::de::Error::custom)
        }
    )* };
}
pub(crate) use readers;

fn names<A: DeserializeOwned>(command: &Command) -> Vec<&'static str> {
    let fields = Fields { command, data: &Map::new(), names: RefCell::default() };
    // A field that must be there is missed when all are known.
    let _ = A::deserialize(&fields);
    fields.names.into_inner()
}

fn option<'c>(command: &'c Command, name: &str) -> Option<&'c Arg> {
    command.get_arguments().find(|arg| name_of(arg) == name)
}

fn name_of(arg: &Arg) -> String {
    arg.get_long().unwrap_or_default().replace('-', "_")
}

fn is_switch(arg: &Arg) -> bool {
    matches!(arg.get_action(), ArgAction::SetTrue)
}

/// What the command line takes for an option that is not there.
fn default_of(arg: &Arg) -> Option<Value> {
    let value = |text: &str| {
        let listed = || serde_json::from_str(&format!("[{text}]"));
        serde_json::from_str(text).or_else(|_| listed()).unwrap_or_else(|_| Value::from(text))
    };
    let mut values = arg.get_default_values().iter().filter_map(|text| text.to_str()).map(value);
    match arg.get_action() {
        ArgAction::SetTrue => Some(Value::Bool(false)),
        ArgAction::Append => Some(values.collect()),
        _ => values.next(),
    }
}

struct Fields<'a> {
    command: &'a Command,
    data: &'a Map<String, Value>,
    names: RefCell<Vec<&'static str>>,
}

impl<'de> Deserializer<'de> for &Fields<'_> {
    type Error = Error;

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_map(Walk { of: self, fields: fields.iter(), field: ("", None) })
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    /// The ids of the options that are given.
    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let ids =
            self.data.keys().filter_map(|name| option(self.command, name)).map(|arg| arg.get_id().as_str());
        visitor.visit_seq(SeqDeserializer::new(ids))
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Error> {
        Err(Error::custom("a request has fields"))
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct tuple tuple_struct
        map enum identifier ignored_any
    }
}

/// One field after the other: what is given, or the default.
struct Walk<'a, 'f> {
    of: &'a Fields<'f>,
    fields: std::slice::Iter<'static, &'static str>,
    /// Its name, and its value; a group has none.
    field: (&'static str, Option<Value>),
}

impl<'de> MapAccess<'de> for Walk<'_, '_> {
    type Error = Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, Error> {
        for name in self.fields.by_ref() {
            let value = if name.starts_with('+') {
                None
            } else {
                let hidden = name.strip_prefix('-');
                if hidden.is_none() {
                    self.of.names.borrow_mut().push(name);
                }
                let given = self.of.data.get(*name).cloned();
                let usual = || default_of(option(self.of.command, hidden.unwrap_or(name))?);
                let Some(value) = given.or_else(usual) else { continue };
                Some(value)
            };
            self.field = (name, value);
            return seed.deserialize(serde::de::value::StrDeserializer::new(name)).map(Some);
        }
        Ok(None)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, Error> {
        let (name, value) = std::mem::take(&mut self.field);
        match value {
            None => seed.deserialize(self.of),
            Some(value) => seed.deserialize(value).map_err(|error| Error::custom(format!("{name}: {error}"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cmd::{catch, plan, throw, tune};
    use clap::error::ErrorKind;
    use serde_json::json;
    use std::fmt::Debug;

    fn by_words<A: clap::Args + Debug>(words: &[String]) -> Result<String, clap::Error> {
        let verb = A::augment_args(Command::new("verb").no_binary_name(true));
        let matches = verb.try_get_matches_from(words)?;
        A::from_arg_matches(&matches).map(|args| format!("{args:?}"))
    }

    /// Values of all kinds: as words and as data.
    fn values(arg: &Arg, file: &str) -> Vec<(String, Value)> {
        let mut values = vec![
            ("1", json!(1)),
            ("0", json!(0)),
            ("-1", json!(-1)),
            ("0.5", json!(0.5)),
            ("0.05", json!(0.05)),
            ("100000000", json!(100_000_000)),
            ("true", json!(true)),
            ("0.1,0.2", json!([0.1, 0.2])),
            ("1,2,3", json!([1, 2, 3])),
            ("1,2,3;4,5,6", json!([[1, 2, 3], [4, 5, 6]])),
            ("1,2,3,4,5,6", json!([1, 2, 3, 4, 5, 6])),
            ("2/3", json!("2/3")),
            ("4/3", json!("4/3")),
            ("tracker-dead:0.1", json!("tracker-dead:0.1")),
            ("word", json!("word")),
            (file, json!(file)),
        ]
        .into_iter()
        .map(|(word, value)| (word.to_owned(), value))
        .collect::<Vec<_>>();
        let named = arg.get_possible_values();
        values.extend(named.iter().map(|value| (value.get_name().to_owned(), json!(value.get_name()))));
        values
    }

    /// Each field of a request, set by words and by data: one is never taken where the other is refused, and the requests are equal.
    /// `bases` are fields that are there as well, `program` words without which the command line refuses, and what they leave.
    fn walk<A: clap::Args + DeserializeOwned + Debug>(
        bases: &[&[(&str, Value)]],
        program: (&[&str], &[(&str, &str)]),
    ) -> usize {
        let folder = std::env::temp_dir().join(format!("cubectl-request-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("delays.txt");
        std::fs::write(&file, "20 25 22 21 24 23 20 26".replace(' ', "\n")).unwrap();
        let mut command = A::augment_args(Command::new("verb"));
        command.build();
        let fields = names::<A>(&command);
        for name in &fields {
            let arg = option(&command, name).unwrap_or_else(|| panic!("{name} is not an option"));
            let long = arg.get_long().unwrap();
            let mut equal = 0;
            for base in bases.iter().filter(|base| base.iter().all(|(other, _)| other != name)) {
                let mut data: Map<String, Value> =
                    base.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
                let text = |value: &Value| text_of(value.clone()).unwrap();
                let mut words: Vec<String> =
                    base.iter().map(|(name, value)| format!("--{name}={}", text(value))).collect();
                words.extend(program.0.iter().map(|word| (*word).to_owned()));
                let reported = |words: &[String]| {
                    let left = |text: String| {
                        program.1.iter().fold(text, |text, (there, left)| text.replace(there, left))
                    };
                    by_words::<A>(words).map(left)
                };
                let usual = reported(&words).ok();
                for (word, value) in values(arg, file.to_str().unwrap()) {
                    let (word, value) = match arg.get_action() {
                        ArgAction::SetTrue => (format!("--{long}"), json!(true)),
                        ArgAction::Append => (format!("--{long}={word}"), json!([value])),
                        _ => (format!("--{long}={word}"), value),
                    };
                    let all: Vec<String> = words.iter().cloned().chain([word]).collect();
                    data.insert((*name).to_owned(), value.clone());
                    let read = read::<A>("verb", &Value::from(data.clone()).to_string());
                    match (reported(&all), read.map(|request| format!("{request:?}"))) {
                        (Ok(reported), Ok(read)) => {
                            assert_eq!(reported, read, "{all:?} {data:?}");
                            equal += usize::from(usual.as_ref() != Some(&reported));
                        }
                        (Err(why), Ok(read)) if why.kind() != ErrorKind::MissingRequiredArgument => {
                            panic!("{all:?}: {why}, but data gives {read}")
                        }
                        _ => {}
                    }
                }
            }
            assert!(equal > 0, "{name} is set by no value");
        }
        std::fs::remove_dir_all(&folder).unwrap();
        let error = read::<A>("verb", r#"{"no_such_field": 1}"#).unwrap_err();
        assert_eq!((error.code, error.what.as_str()), (exit::USAGE, "there is no field `no_such_field`"));
        assert!(fields.iter().all(|name| error.next[0].contains(name)), "{error}");
        fields.len()
    }

    #[test]
    fn each_field_of_a_request_is_the_same_by_words_and_by_data() {
        let alone = (&[][..], &[][..]);
        let target = [("target", json!([1, 2, 3]))];
        assert_eq!(walk::<plan::args::Args>(&[&target, &[]], alone), 50);
        let [x, z] = ["x", "z"].map(|name| (name, json!([0, 1, 1])));
        let [out, targets] = ["out", "targets"].map(|name| (name, json!("there")));
        let bases = [
            vec![x.clone(), z.clone(), out.clone()],
            vec![targets, out.clone()],
            vec![z.clone(), out.clone()],
            vec![x.clone(), out.clone()],
            vec![x, z],
            vec![out],
        ];
        let bases: Vec<&[_]> = bases.iter().map(Vec::as_slice).collect();
        assert_eq!(walk::<plan::sweep::Args>(&bases, alone), 44);
        let [disc, start, velocity] =
            [("disc", json!("flat")), ("start", json!([1, 2, 3])), ("velocity", json!([1, 2, 3]))];
        let ball = ("ball", json!([1, 2, 3, 4, 5, 6]));
        assert_eq!(walk::<catch::Args>(&[&[disc], &[start, velocity], &[ball], &[]], alone), 16);
        assert_eq!(walk::<tune::Args>(&[&[]], alone), 11);
        let left = [("plan: Some(\"p\")", "plan: None"), ("\"plan\", ", ""), (", \"plan\"", "")];
        assert_eq!(walk::<throw::Args>(&[&[]], (&["--plan=p"], &left)), 6);
    }

    #[test]
    fn a_refused_value_is_named_with_its_field_and_what_is_expected() {
        let read = |text: &str| read::<plan::args::Args>("plan throw", text).unwrap_err();
        for (text, what) in [
            (r#"{"target": [1, 2]}"#, "target: invalid length 2, expected an array of length 3"),
            (r#"{"seed": 1}"#, "missing field `target`"),
            (
                r#"{"target": [1, 2, 3], "starts": "many"}"#,
                "starts: invalid type: string \"many\", expected usize",
            ),
            (
                r#"{"target": [1, 2, 3], "form": "round"}"#,
                "form: unknown variant `round`, expected `paper` or `best`",
            ),
            (
                r#"{"target": [1, 2, 3], "target_course": true}"#,
                "target_course: true is not a text, a number or a list of numbers",
            ),
            (
                r#"{"target": [1, 2, 3], "hit_radius_m": 1, "hit_box": [1, 1]}"#,
                "`hit_box` and `hit_radius_m` exclude each other",
            ),
        ] {
            let error = read(text);
            assert_eq!((error.code, error.what.as_str()), (exit::USAGE, what));
            assert_eq!(error.next, ["`cubectl plan throw --help` describes the option of each field"]);
        }
    }
}
