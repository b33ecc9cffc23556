//! SLCAN over serial lines and TCP: the host's side, and an adapter in front of a bus of ours.
//!
//! The text itself is [`protocol::text::slcan`]; here is who says what when.

mod adapter;
mod host;

pub use adapter::Adapter;
pub use host::Host;
