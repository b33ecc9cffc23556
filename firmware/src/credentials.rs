//! Nodes that give orders, and the secrets with which they prove who they are.

pub use protocol::cyphal::cubecell::authorization::{CODE_LEN, DIGEST_LEN, KEY_LEN, NONCE_LEN};

/// A node that speaks to the controller. The number is the link's: a node-ID on Cyphal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peer(u8);

impl Peer {
    /// The program that the controller runs in.
    pub const LOCAL: Self = Self(u8::MAX);

    /// Node with this number on the link; 255 is [`Self::LOCAL`].
    pub const fn new(number: u8) -> Self {
        Self(number)
    }

    /// The number.
    pub const fn number(self) -> u8 {
        self.0
    }
}

/// Where an order or a register write comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source<'a> {
    /// The node.
    pub peer: Peer,
    /// The bytes that an authentication code covers: the order as the link received it. Empty: the link carries no
    /// codes, and a controller with a key refuses the order.
    pub content: &'a [u8],
}

impl From<Peer> for Source<'_> {
    fn from(peer: Peer) -> Self {
        Self { peer, content: &[] }
    }
}

/// A shared secret.
#[derive(Clone)]
pub struct Key([u8; KEY_LEN]);

/// Number of a challenge.
pub type Nonce = [u8; NONCE_LEN];
/// SHA-256 of a file, a segment or a run.
pub type Digest = [u8; DIGEST_LEN];
/// Truncated authentication code.
pub type Code = [u8; CODE_LEN];

impl Key {
    /// Key of random bytes.
    pub const fn new(bytes: [u8; KEY_LEN]) -> Self {
        Self(bytes)
    }

    /// The bytes, to store them.
    pub(crate) const fn bytes(&self) -> &[u8; KEY_LEN] {
        &self.0
    }
}

/// Does not print the bytes.
impl core::fmt::Debug for Key {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Key")
    }
}
