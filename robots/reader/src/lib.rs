//! Reads TOML with positions: every refusal names file, line, key path and reason.
//!
//! Deserialising into structs loses the key path of type errors and the line of range errors. Therefore the
//! document is read with its spans: each key is requested together with the condition on its value, and
//! [`Section::finish`] refuses keys that were not requested.
//!
//! ```
//! use toml_reader::{DocumentError, Problem, Source, Value};
//!
//! fn read(text: &str) -> Result<(f64, Option<bool>), DocumentError<Problem>> {
//!     let source = Source { file: "arm.toml", text };
//!     let document = source.parse()?;
//!     let root = source.root(&document);
//!     let joint = root.required("joint", Value::section)?;
//!     let v_max_rad_s = joint.required("v_max_rad_s", Value::positive)?;
//!     let brake = joint.optional("brake", Value::boolean)?;
//!     joint.finish()?;
//!     root.finish()?;
//!     Ok((v_max_rad_s, brake))
//! }
//!
//! assert_eq!(read("[joint]\nv_max_rad_s = 2.6"), Ok((2.6, None)));
//! let refusal = read("[joint]\nv_max_deg_s = 149").unwrap_err();
//! assert_eq!(refusal.to_string(), "arm.toml:1: joint.v_max_rad_s: missing");
//! ```
//!
//! # Map
//!
//! | file | holds |
//! |---|---|
//! | `bounded` | [`read_text`], [`read_bytes`]: files of bounded size; [`next_of_file`]: the next step if the system refuses one |
//! | `document_error` | [`DocumentError`]: where and why; [`Problem`]: problems of any document |
//! | `document` | [`Source`], [`Section`], [`Value`]: text, tables and values, each with its place |
//! | `section` | reading the keys of a table, and which of them were requested |
//! | `value` | reading a value with its condition |
//! | `write` | [`quoted`]: text as TOML |
//!
//! A reader with problems of its own wraps [`Problem`] in a type `P: From<Problem>`; all refusals are then
//! [`DocumentError<P>`].

#![warn(missing_docs)]

mod bounded;
mod document;
mod document_error;
mod section;
mod value;
mod write;

pub use bounded::{DESCRIPTION_MAX_BYTES, next_of_file, read_bytes, read_text};
pub use document::{Section, Source, Value};
pub use document_error::{DocumentError, Problem};
pub use write::quoted;
