//! Joint-group controller (in work).
#![cfg_attr(not(test), no_std)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing
    )
)]

pub mod crc;
pub mod fault;
pub mod feedback;
pub mod joints;
pub mod ramp;
pub mod registers;
pub mod settings;
pub mod spline;
pub mod store;
pub mod trajectory_format;
