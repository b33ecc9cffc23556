//! Objects of CANopen nodes, read beside no other master.

use protocol::canopen::client::Failure;
use protocol::canopen::{NodeId, Object};
use protocol::{Duration, Instant};

use super::ask::AskError;
use crate::bus::session::{Ended, Session};
use crate::node::host_node::OBJECT_MAX;

/// Longest data sheet that is read, bytes. Sheets of makers have some hundred thousand bytes.
pub const SHEET_MAX: u32 = 4 << 20;
/// Time for each answer.
const PATIENCE: Duration = Duration::from_millis(100);
/// A node may boot for so long.
const BOOT_MAX: Duration = Duration::from_millis(3_000);
/// In which a master is heard: its SYNC comes in each period, its heartbeat watch asks sooner.
const LISTEN: Duration = Duration::from_millis(200);

/// Why a node gives no sheet.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoSheet {
    #[error("it stores its sheet in the form {0:?} (object 1022), which is no text")]
    Form(Vec<u8>),
    #[error("its sheet (object 1021): {0}")]
    NotRead(Failure),
}

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
        self.read(node, object, OBJECT_MAX)
    }

    /// Reads the electronic data sheet that a node stores (object 1021), in blocks; inside, why there is none. It may take some seconds.
    ///
    /// # Errors
    /// [`AskError::Bus`], [`AskError::Interrupted`].
    pub fn read_sheet(&mut self, node: NodeId) -> Result<Result<Vec<u8>, NoSheet>, AskError> {
        // The form of the sheet; 0: text.
        if let Ok(form) = self.read_object(node, Object::new(0x1022, 0))?
            && form != [0]
        {
            return Ok(Err(NoSheet::Form(form)));
        }
        Ok(self.read(node, Object::new(0x1021, 0), SHEET_MAX)?.map_err(NoSheet::NotRead))
    }

    fn read(
        &mut self,
        node: NodeId,
        object: Object,
        size_max: u32,
    ) -> Result<Result<Vec<u8>, Failure>, AskError> {
        self.host_node().read_object(node, object, PATIENCE, size_max);
        // There is a time-out for each answer, and at most so many bytes.
        match self.run(Instant::FAR_FUTURE, &mut |host_node| host_node.object().is_some())? {
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
