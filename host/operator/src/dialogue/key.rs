//! Orders and register writes with a code made from the key of a controller.

use firmware::authority::{Digest, Key, Peer, code_of};
use firmware::registers::{RegisterInfo, run_digest};
use protocol::cyphal::bits::Decode;
use protocol::cyphal::client::Policy;
use protocol::cyphal::cubecell::authorization::{Content, KEY_REGISTER, KEYED_REGISTER, needs_code};
use protocol::cyphal::cubecell::command::{
    ARM_CONFIRM, AUTHORIZE, Authorization, CHALLENGE, COMMIT_TRAJECTORY, Challenge, Trajectory,
};
use protocol::cyphal::id::NodeId;
use protocol::cyphal::uavcan::register::{ACCESS, AccessRequest};
use protocol::cyphal::uavcan::value::Value;

use super::operator::OperatorError;
use super::registers::{Numbers, settings_of};
use crate::bus::session::Session;

impl Session {
    /// Orders from now on have codes of this key, if a controller requires codes.
    pub fn set_key(&mut self, key: Option<Key>) {
        self.key = key;
    }

    /// Writes the key of a controller, or removes it with no bytes. The answer does not show whether it was accepted.
    pub fn write_key(&mut self, node: NodeId, bytes: &[u8]) -> Result<(), OperatorError> {
        let value = Value::unstructured(bytes).map_err(|_| OperatorError::Unreadable { node })?;
        self.authorize_register(node, KEY_REGISTER, &value)?;
        let request = AccessRequest { name: KEY_REGISTER.as_bytes(), value };
        self.request(node, ACCESS, Policy::default(), &request).map(drop)
    }

    /// True if the controller has a key.
    pub fn is_keyed(&mut self, node: NodeId) -> Result<bool, OperatorError> {
        Ok(self.register(node, KEYED_REGISTER)? == Numbers::Bit(vec![true]))
    }

    /// Gives the code for a command, if there is a key and the command needs one.
    pub(super) fn authorize_command(
        &mut self,
        node: NodeId,
        number: u16,
        parameter: &[u8],
    ) -> Result<(), OperatorError> {
        if self.key.is_none() || !needs_code(number) {
            return Ok(());
        }
        let about = match number {
            COMMIT_TRAJECTORY => self.uploaded.map(|(_, file)| file),
            ARM_CONFIRM => self.armed,
            _ => None,
        };
        let content = Content::of_command(number, parameter)
            .and_then(|content| about.map_or(Ok(content), |digest| content.about(&digest)))
            .map_err(|_| OperatorError::Unreadable { node })?;
        self.authorize(node, &content)
    }

    /// Digest of the uploaded file with the settings that the controller reports, which must be the offered one.
    pub(super) fn signed_run(
        &mut self,
        node: NodeId,
        name: &Trajectory,
        offered: &Digest,
    ) -> Result<Digest, OperatorError> {
        let file = self.uploaded.filter(|(uploaded, _)| uploaded == name).map(|(_, file)| file);
        let file = file.ok_or(OperatorError::OtherContent)?;
        let settings = settings_of(RegisterInfo::is_in_digest, &mut |name| self.register(node, name))?;
        let digest = run_digest(&file, &settings);
        if digest == *offered { Ok(digest) } else { Err(OperatorError::OtherContent) }
    }

    /// Gives the code for a register write, if there is a key.
    ///
    /// # Errors
    /// The controller has no key; or another [`OperatorError`].
    pub fn authorize_register(
        &mut self,
        node: NodeId,
        name: &str,
        value: &Value<'_>,
    ) -> Result<(), OperatorError> {
        if self.key.is_none() {
            return Ok(());
        }
        let content =
            Content::of_register(name.as_bytes(), value).map_err(|_| OperatorError::Unreadable { node })?;
        self.authorize(node, &content)
    }

    fn authorize(&mut self, node: NodeId, content: &Content) -> Result<(), OperatorError> {
        let Some(key) = self.key.clone() else { return Ok(()) };
        let output = self.order_plain(node, "to give a challenge", CHALLENGE, &[])?;
        let Challenge { nonce, .. } =
            Challenge::from_bytes(&output).map_err(|_| OperatorError::Unreadable { node })?;
        let code = code_of(&key, &nonce, Peer::new(self.host_node().node_id().get()), content.as_slice());
        let mut bytes = [0; 64];
        let len = protocol::cyphal::bits::to_bytes(&Authorization { nonce, code }, &mut bytes)
            .map_err(|_| OperatorError::Unreadable { node })?;
        self.order_plain(node, "a code", AUTHORIZE, bytes.get(..len).unwrap_or_default()).map(drop)
    }
}
