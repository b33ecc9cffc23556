//! What the integration suites share.

pub mod page;
pub mod published_throw;
