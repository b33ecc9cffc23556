//! The step to and from XML.

use roxmltree::{Document, ParsingOptions};

use crate::error::{ReadError, WriteError};

/// Longest name of an element or attribute that is written, in bytes.
const MAX_NAME_BYTES: usize = 64;

/// What surrounds a document on the wire and is not part of it.
fn trimmed(bytes: &[u8]) -> &[u8] {
    let outside = |byte: &u8| byte.is_ascii_whitespace() || *byte == 0;
    let start = bytes.iter().position(|byte| !outside(byte)).unwrap_or(bytes.len());
    let end = bytes.iter().rposition(|byte| !outside(byte)).map_or(start, |last| last + 1);
    bytes.get(start..end).unwrap_or_default()
}

/// The text of a document of at most `max` bytes, without white space and NUL around it.
pub(crate) fn text(bytes: &[u8], max: usize) -> Result<&str, ReadError> {
    let bytes = trimmed(bytes);
    if bytes.len() > max {
        return Err(ReadError::TooLong { len: bytes.len(), max });
    }
    std::str::from_utf8(bytes).map_err(|error| ReadError::NotText { at: error.valid_up_to() })
}

/// Parses a document of at most `max_nodes` nodes; a document type declaration is refused.
pub(crate) fn document(text: &str, max_nodes: usize) -> Result<Document<'_>, ReadError> {
    let nodes_limit = u32::try_from(max_nodes).unwrap_or(u32::MAX);
    let options = ParsingOptions { allow_dtd: false, nodes_limit, ..ParsingOptions::default() };
    Document::parse_with_options(text, options).map_err(|error| ReadError::NotXml(error.to_string()))
}

/// Whether `name` can be written as the name of an element or attribute: ASCII letters, digits, `_`, `-`, no prefix.
pub(crate) fn is_name(name: &str) -> bool {
    let first = name.bytes().next().is_some_and(|byte| byte.is_ascii_alphabetic() || byte == b'_');
    let rest = name.bytes().all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-'));
    first && rest && name.len() <= MAX_NAME_BYTES
}

pub(crate) fn push_name(out: &mut String, name: &str) -> Result<(), WriteError> {
    if !is_name(name) {
        return Err(WriteError::NotXml { place: "name", text: name.to_owned() });
    }
    out.push_str(name);
    Ok(())
}

/// Appends text or an attribute value with the characters that XML reserves escaped.
pub(crate) fn push_escaped(out: &mut String, text: &str) -> Result<(), WriteError> {
    for c in text.chars() {
        match c {
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '&' => out.push_str("&amp;"),
            '"' => out.push_str("&quot;"),
            // A reader would turn the plain characters into blanks or drop them.
            '\t' => out.push_str("&#9;"),
            '\n' => out.push_str("&#10;"),
            '\r' => out.push_str("&#13;"),
            '\u{0}'..='\u{1f}' | '\u{fffe}' | '\u{ffff}' => {
                return Err(WriteError::NotXml { place: "text", text: text.escape_debug().to_string() });
            }
            c => out.push(c),
        }
    }
    Ok(())
}
