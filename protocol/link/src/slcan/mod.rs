//! SLCAN over serial lines and TCP: the host's side, and an adapter in front of a bus of this program.
//!
//! [`protocol::text::slcan`] has the texts; this module has their sequence.

mod adapter;
mod host;

pub use adapter::Adapter;
pub use host::Host;
