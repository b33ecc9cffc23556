//! Who may give which order: the node that an order comes from, its session, unpredictable tokens, and codes made with a key.
//!
//! `session` binds a motion to a node, `tokens` draws numbers, `key` checks codes. Nothing here
//! knows a protocol: the link gives each node a number.

mod key;
mod session;
mod tokens;

pub use key::{CHALLENGE_VALID, code_of, sha256};
pub(crate) use key::{Keyring, Verdict};
pub(crate) use session::Session;
pub(crate) use tokens::Tokens;
pub use tokens::{SEED_LEN, Seed};

pub use crate::credentials::{CODE_LEN, Code, Digest, KEY_LEN, Key, NONCE_LEN, Nonce, Peer, Source};
