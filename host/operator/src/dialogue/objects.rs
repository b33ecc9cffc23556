//! Objects of CANopen nodes, read beside no other master.

use canopen_protocol::client::Failure;
use canopen_protocol::{NodeId, Object};
use protocol::Duration;

use super::ask::AskError;
use crate::bus::session::{Ended, Session};

/// Time for each answer.
const PATIENCE: Duration = Duration::from_millis(100);
/// A node may boot for so long.
const BOOT_MAX: Duration = Duration::from_millis(3_000);
/// In which a master is heard: its SYNC comes in each period, its heartbeat watch asks sooner.
const LISTEN: Duration = Duration::from_millis(200);

impl Session {
    /// True if another master of a CANopen network is heard: two that read objects of one node disturb each other.
    ///
    /// # Errors
    /// [`AskError::Bus`], [`AskError::Interrupted`].
    pub fn hears_canopen_master(&mut self) -> Result<bool, AskError> {
        let before = self.host_node().tally().of_master;
        let until = self.now() + LISTEN;
        match self.run(until, &mut |host_node| host_node.tally().of_master > before)? {
            Ended::Interrupted => Err(AskError::Interrupted),
            Ended::Done => Ok(true),
            Ended::TimedOut => Ok(false),
        }
    }

    /// Reads an object; inside, why the node did not give it.
    ///
    /// # Errors
    /// [`AskError::Bus`], [`AskError::Interrupted`].
    pub fn read_object(
        &mut self,
        node: NodeId,
        object: Object,
    ) -> Result<Result<Vec<u8>, Failure>, AskError> {
        self.host_node().read_object(node, object, PATIENCE);
        // The transfer has a time-out for each answer.
        let until = self.now() + BOOT_MAX;
        match self.run(until, &mut |host_node| host_node.object().is_some())? {
            Ended::Interrupted => Err(AskError::Interrupted),
            Ended::Done | Ended::TimedOut => Ok(self.host_node().object().unwrap_or(Err(Failure::TimeOut))),
        }
    }

    /// The type of a node (object 1000), which may still boot.
    pub fn find_node(&mut self, node: NodeId) -> Result<Result<Vec<u8>, Failure>, AskError> {
        let until = self.now() + BOOT_MAX;
        loop {
            let answer = self.read_object(node, Object::new(0x1000, 0))?;
            if answer != Err(Failure::TimeOut) || self.now() >= until {
                return Ok(answer);
            }
        }
    }
}
