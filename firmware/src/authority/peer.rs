//! Names of the nodes that give orders.

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
    /// The bytes that an authentication code covers: the order as it came over the link. Empty: the link carries no
    /// codes, and a controller with a key refuses.
    pub content: &'a [u8],
}

impl From<Peer> for Source<'_> {
    fn from(peer: Peer) -> Self {
        Self { peer, content: &[] }
    }
}
