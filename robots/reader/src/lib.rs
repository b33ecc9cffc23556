//! TOML walked with its places: every refusal names file, line, key path and reason.
//!
//! Deserialising into structs loses the key path of type errors and the line of range errors, so the document is
//! walked with its spans instead: each key is asked for together with what its value must be, and
//! [`Section::finish`] refuses what nobody asked for.
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
//! | `bounded` | [`read_text`], [`read_bytes`]: files of bounded size; [`next_of_file`]: what to do where the system refuses one |
//! | `document_error` | [`DocumentError`]: where and why; [`Problem`]: what can be wrong with any document |
//! | `document` | [`Source`], [`Section`], [`Value`]: text, tables and values, each with its place |
//! | `section` | reading the keys of a table, and which of them were asked for |
//! | `value` | reading a value: what it must be |
//! | `write` | [`quoted`]: text as TOML |
//!
//! A reader with problems of its own wraps [`Problem`] in its own type `P: From<Problem>`; all refusals are then
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
