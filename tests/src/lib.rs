//! What the integration suites share.

pub mod published_throw;
