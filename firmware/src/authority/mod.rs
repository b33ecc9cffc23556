//! Who may order what: the node that an order comes from, its session, unforeseeable tokens, and codes of a key.
//!
//! `peer` names nodes, `session` binds a motion to one of them, `tokens` draws numbers, `key` checks codes. Nothing here
//! knows a protocol: the link gives each node a number.

mod key;
mod peer;
mod session;
mod tokens;

pub use key::{CHALLENGE_VALID, CODE_LEN, Code, KEY_LEN, Key, NONCE_LEN, Nonce, code_of};
pub(crate) use key::{Keyring, Verdict};
pub use peer::{Peer, Source};
pub(crate) use session::Session;
pub(crate) use tokens::Tokens;
pub use tokens::{SEED_LEN, Seed};
