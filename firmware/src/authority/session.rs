//! The session: one node, the host, arms and moves the group, and only its heartbeats keep a motion alive.
//!
//! The host is the node that gave the last accepted order. While the session is held (an offer to arm is pending, the
//! group is armed or can move), no other node becomes the host; it may only stop and disarm.

use protocol::Instant;

use crate::credentials::Peer;

/// A node and its last sign of life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Seen {
    peer: Peer,
    at: Option<Instant>,
}

/// The host, and the other node that was heard last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Session {
    host: Option<Seen>,
    other: Option<Seen>,
}

impl Session {
    /// The node whose orders move the group.
    pub(crate) fn host(&self) -> Option<Peer> {
        self.host.map(|host| host.peer)
    }

    /// When the host was heard last.
    pub(crate) fn heard_at(&self) -> Option<Instant> {
        self.host.and_then(|host| host.at)
    }

    /// Sign of life of a node.
    pub(crate) fn hear(&mut self, now: Instant, peer: Peer) {
        match &mut self.host {
            Some(host) if host.peer == peer => host.at = Some(now),
            _ => self.other = Some(Seen { peer, at: Some(now) }),
        }
    }

    /// Makes `peer` the host, with what was heard of it.
    pub(crate) fn enter(&mut self, peer: Peer) {
        if self.host() == Some(peer) {
            return;
        }
        let heard = self.other.filter(|other| other.peer == peer);
        self.other = self.host;
        self.host = heard.or(Some(Seen { peer, at: None }));
    }

    /// The host has started again: its earlier orders are void.
    pub(crate) const fn forget_host(&mut self) {
        self.host = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_heartbeats_of_the_host_count_and_a_newcomer_brings_its_own_along() {
        let (a, b, c) = (Peer::new(1), Peer::new(2), Peer::new(3));
        let at = Instant::from_micros;
        let mut session = Session::default();
        session.hear(at(10), a);
        session.enter(a);
        assert_eq!((session.host(), session.heard_at()), (Some(a), Some(at(10))));
        session.hear(at(20), b);
        assert_eq!(session.heard_at(), Some(at(10)), "of another node");
        session.enter(b);
        assert_eq!((session.host(), session.heard_at()), (Some(b), Some(at(20))));
        session.enter(c);
        assert_eq!((session.host(), session.heard_at()), (Some(c), None), "never heard");
    }
}
