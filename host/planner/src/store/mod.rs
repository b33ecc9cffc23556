//! Tables of stored throws: starts for near targets.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`record`] | one stored throw and its bytes |
//! | [`mod@file`] | a whole table as bytes |
//! | [`index`] | the records in memory, by range and height of the target |
//!
//! The problem is symmetric about the base axis except for the range of joint 1, so records are kept in the frame
//! in which the target is on the x axis: (range, height) is the whole key. The paper keeps its database for the
//! same reason: a start near a (partially) valid throw is worth many random ones.

pub mod file;
pub mod index;
pub mod record;

pub use index::Index;
pub use record::{Record, fingerprint_of, robot_fingerprint};
