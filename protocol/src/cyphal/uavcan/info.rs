//! `uavcan.node.GetInfo.1.0`: what a node is.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::ServiceId;

/// Fixed service; the request is empty (`()`).
pub const SERVICE: ServiceId = ServiceId::from_low_bits(430);
/// Bytes of a request.
pub const REQUEST_EXTENT: u16 = 0;
/// Bytes of a response.
pub const RESPONSE_EXTENT: u16 = 313;
/// Most bytes of a node name.
pub const NAME_LEN_MAX: usize = 50;
/// Most bytes of a certificate of authenticity.
pub const CERTIFICATE_LEN_MAX: usize = 222;

/// Two-part version (`uavcan.node.Version.1.0`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version {
    /// Incompatible when different.
    pub major: u8,
    /// Compatible additions.
    pub minor: u8,
}

impl Version {
    /// Both parts.
    pub const fn new(major: u8, minor: u8) -> Self {
        Self { major, minor }
    }
}

/// Response of `uavcan.node.GetInfo`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodeInfo<'a> {
    /// Version of Cyphal: 1.0.
    pub protocol: Version,
    /// Version of the board.
    pub hardware: Version,
    /// Version of the program.
    pub software: Version,
    /// First 64 bits of the commit the program was built from; 0 = unknown.
    pub software_vcs_revision: u64,
    /// Unique identifier of this node; all zeros = no identifier.
    pub unique_id: [u8; 16],
    /// Kind of node in reverse domain notation, ASCII, at most [`NAME_LEN_MAX`] bytes (the rest of a
    /// longer name is not sent).
    pub name: &'a [u8],
    /// CRC-64/WE of the program image ([`Crc64`](crate::cyphal::crc::Crc64)).
    pub software_image_crc: Option<u64>,
    /// At most [`CERTIFICATE_LEN_MAX`] bytes (the rest of a longer one is not sent).
    pub certificate: &'a [u8],
}

impl Encode for NodeInfo<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        for version in [self.protocol, self.hardware, self.software] {
            out.u8(version.major);
            out.u8(version.minor);
        }
        out.uint(self.software_vcs_revision, 64);
        out.bytes(&self.unique_id);
        let name = self.name.get(..NAME_LEN_MAX).unwrap_or(self.name);
        out.u8(name.len() as u8);
        out.bytes(name);
        out.u8(u8::from(self.software_image_crc.is_some()));
        if let Some(crc) = self.software_image_crc {
            out.uint(crc, 64);
        }
        let certificate = self.certificate.get(..CERTIFICATE_LEN_MAX).unwrap_or(self.certificate);
        out.u8(certificate.len() as u8);
        out.bytes(certificate);
    }
}

impl<'a> Decode<'a> for NodeInfo<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        let [protocol, hardware, software] =
            [(); 3].map(|()| Version { major: input.u8(), minor: input.u8() });
        let software_vcs_revision = input.uint(64);
        let mut unique_id = [0; 16];
        for byte in &mut unique_id {
            *byte = input.u8();
        }
        let name = input.byte_array(8, NAME_LEN_MAX)?;
        let software_image_crc = match input.array_len(8, 1)? {
            0 => None,
            _ => Some(input.uint(64)),
        };
        let certificate = input.byte_array(8, CERTIFICATE_LEN_MAX)?;
        Ok(Self {
            protocol,
            hardware,
            software,
            software_vcs_revision,
            unique_id,
            name,
            software_image_crc,
            certificate,
        })
    }
}
