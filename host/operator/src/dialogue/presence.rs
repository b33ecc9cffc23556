//! Other nodes on a bus, found by listening alone; and the messages of controllers.

use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant};

use super::ask::{AskError, OTHERS_LISTEN};
use super::error::OperatorError;
use crate::bus::BusFailure;
use crate::bus::session::{Ended, Session};
use crate::node::host_node::HostNode;
use crate::node::inbox::Said;

/// A controller that is there has sent its state by then.
pub(crate) const PRESENCE: Duration = Duration::from_millis(1_500);
/// A host tool that is a node has sent a heartbeat by then: once a second.
const CLAIM: Duration = Duration::from_millis(1_200);

/// Who else is on the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Presence {
    pub controller: Option<NodeId>,
    /// Another node sends requests or orders to drives.
    pub drives_are_asked: bool,
    /// Another host tool is a node: a `cubectl` that uses a controller.
    pub tool: bool,
}

impl Session {
    /// Lines of text that controllers sent since the last call, oldest first. They are received after this session
    /// has listened to a controller or sent to one.
    pub fn take_said(&mut self) -> Vec<(Instant, Said)> {
        self.host_node().inbox().map_or_else(Vec::new, |inbox| inbox.records.drain(..).collect())
    }

    /// Makes this session a Cyphal node, once, with a node-ID that no other tool has. A cell inside this program
    /// has no other tools, so this does not listen there.
    ///
    /// # Errors
    /// [`OperatorError::Bus`], [`OperatorError::Interrupted`].
    pub(super) fn join(&mut self) -> Result<(), OperatorError> {
        if !self.joined
            && self.sim().is_none()
            && self.only_listen(OTHERS_LISTEN, &mut |_| false)? == Ended::Interrupted
        {
            return Err(OperatorError::Interrupted);
        }
        self.joined = true;
        self.host_node().link();
        Ok(())
    }

    /// Listens for at least [`OTHERS_LISTEN`] without sending, until `done` or for `span`. The first time it takes
    /// a node-ID that was not seen, before the session may send.
    fn only_listen(
        &mut self,
        span: Duration,
        done: &mut dyn FnMut(&mut HostNode) -> bool,
    ) -> Result<Ended, BusFailure> {
        let begun = self.now();
        self.host_node().listen_only();
        let ended = self.run(begun + span.max(OTHERS_LISTEN), &mut |node| {
            node.now() >= begun + OTHERS_LISTEN && done(node)
        });
        if !self.joined && !matches!(ended, Err(_) | Ok(Ended::Interrupted)) {
            self.host_node().take_free_node_id();
            self.joined = true;
        }
        self.host_node().speak();
        ended
    }

    /// Listens for 1.5 s at most: a controller on the bus has reported its state by then. Nothing is sent.
    ///
    /// # Errors
    /// [`AskError::Bus`], [`AskError::Interrupted`].
    pub fn listen(&mut self) -> Result<Presence, AskError> {
        self.listen_for(PRESENCE, true)
    }

    /// As [`Session::listen`]. If modules get requests and no controller was found, this session becomes a node, so
    /// that a `cubectl arm monitor` gives way, and listens once more.
    pub fn claim(&mut self) -> Result<Presence, AskError> {
        let present = self.listen()?;
        if present.controller.is_some() || present.tool || !present.drives_are_asked {
            return Ok(present);
        }
        self.sleep_until(self.now() + CLAIM)?;
        self.listen()
    }

    /// Listens for `span`, at least [`OTHERS_LISTEN`]. With `until_reported` it ends when a controller was found and had time to
    /// show its host. Nothing is sent; before it returns the session may send again.
    pub fn listen_for(&mut self, span: Duration, until_reported: bool) -> Result<Presence, AskError> {
        let (begun, before) = (self.now(), self.host_node().tally());
        let heard_since = |at: Instant| at > begun;
        let ended = self.only_listen(span, &mut |host_node| {
            // A host sends a heartbeat every 30 ms.
            until_reported
                && host_node.inbox().and_then(|inbox| inbox.group).is_some_and(|(at, ..)| heard_since(at))
        })?;
        if ended == Ended::Interrupted {
            return Err(AskError::Interrupted);
        }
        let host_node = self.host_node();
        let tally = host_node.tally();
        let controller = host_node.inbox().and_then(|inbox| inbox.group).filter(|(at, ..)| heard_since(*at));
        Ok(Presence {
            controller: controller.map(|(_, node, _)| node),
            drives_are_asked: tally.foreign_requests > before.foreign_requests,
            tool: tally.tools > before.tools,
        })
    }
}
