//! YAML as the value that JSON would give. Read event by event, with a bound of its depth; anchors and aliases, with which a small file
//! becomes a large one, are refused.

use serde_json::{Map, Value};
use yaml_rust2::Event;
use yaml_rust2::parser::Parser;
use yaml_rust2::scanner::TScalarStyle;

/// Deepest nesting.
const DEPTH_MAX: usize = 16;

/// A list or a mapping that is being read, and the key of the next value.
enum Open {
    List(Vec<Value>),
    Fields(Map<String, Value>, Option<String>),
}

/// The first document of `text`.
///
/// # Errors
/// What is wrong, with its line.
pub(super) fn read(text: &str) -> Result<Value, String> {
    let mut parser = Parser::new_from_str(text);
    let mut open: Vec<Open> = Vec::new();
    loop {
        let (event, mark) = parser.next_token().map_err(|error| error.to_string())?;
        let refused = |why: &str| format!("line {}: {why}", mark.line());
        let value = match event {
            Event::SequenceStart(0, _) => {
                open.push(Open::List(Vec::new()));
                None
            }
            Event::MappingStart(0, _) => {
                open.push(Open::Fields(Map::new(), None));
                None
            }
            Event::SequenceStart(..) | Event::MappingStart(..) | Event::Alias(_) => {
                return Err(refused("anchors and aliases are not read"));
            }
            Event::SequenceEnd | Event::MappingEnd => open.pop().map(|ended| match ended {
                Open::List(items) => Value::Array(items),
                Open::Fields(fields, _) => Value::Object(fields),
            }),
            Event::Scalar(text, style, ..) => Some(scalar(text, style)),
            Event::StreamEnd | Event::DocumentEnd => return Err("it holds nothing".to_owned()),
            Event::Nothing | Event::StreamStart | Event::DocumentStart => None,
        };
        if open.len() > DEPTH_MAX {
            return Err(refused("lists within lists, too deep"));
        }
        let Some(value) = value else { continue };
        match open.last_mut() {
            None => return Ok(value),
            Some(Open::List(items)) => items.push(value),
            Some(Open::Fields(fields, key)) => match key.take() {
                None => *key = Some(value.as_str().map_or_else(|| value.to_string(), str::to_owned)),
                Some(key) => {
                    if fields.insert(key.clone(), value).is_some() {
                        return Err(refused(&format!("\"{key}\" stands there twice")));
                    }
                }
            },
        }
    }
}

/// A number where it is one and not quoted.
fn scalar(text: String, style: TScalarStyle) -> Value {
    if style == TScalarStyle::Plain {
        match text.as_str() {
            "" | "~" | "null" => return Value::Null,
            "true" => return Value::Bool(true),
            "false" => return Value::Bool(false),
            _ => {}
        }
        if let Some(number) = text.parse().ok().and_then(serde_json::Number::from_f64) {
            return Value::Number(number);
        }
    }
    Value::String(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nesting_is_bounded_and_aliases_are_refused() {
        let deep = "- ".repeat(100_000) + "1";
        assert!(read(&deep).unwrap_err().contains("too deep"));
        let flow = "[".repeat(200) + &"]".repeat(200);
        assert!(read(&flow).unwrap_err().contains("too deep"));
        assert!(read("a: &x [1, 2]\nb: *x\n").unwrap_err().contains("line 1: anchors"));
        assert!(read("a: 1\na: 2\n").unwrap_err().contains("\"a\" stands there twice"));
        assert!(read("").unwrap_err().contains("nothing"));
        assert_eq!(read("a: [1.5, '2', x]").unwrap(), serde_json::json!({"a": [1.5, "2", "x"]}));
    }
}
