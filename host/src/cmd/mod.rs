//! One verb of `cubectl` per file: arguments and `run`.

pub mod tune;
