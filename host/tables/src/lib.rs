//! Tables of many throws: lists of targets, and results as Parquet part files.
//!
//! A sweep over many targets is cut into shards by row number. Each shard is made by any process on any machine and becomes one
//! file of a folder. The file appears complete or not at all, and its bytes follow from the sweep and the shard alone: not from
//! who made it, with how many threads, or after how many attempts. This package knows nothing of how a throw is planned.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`shard`] | which rows a shard has |
//! | [`row`] | one row of results |
//! | [`targets`] | lists of targets in CSV and Parquet, read row by row |
//! | [`part`] | one part file: its columns, written and read |
//! | [`folder`] | the folder of a sweep: what it is of, which parts it has, making one |
//! | [`summary`] | what all parts say together |

pub mod error;
pub mod folder;
pub mod part;
pub mod row;
pub mod shard;
pub mod summary;
pub mod targets;

pub use error::TableError;
pub use folder::{Folder, Study};
pub use row::{Landings, Outcome, Row, Thrown};
pub use shard::Shard;
pub use summary::Summary;
pub use targets::{TargetList, TargetRow};
