//! `uavcan.file.Write.1.1` and `Read.1.1`: files of a node in pieces of at most 256 bytes; `List.0.2`: their names.
//!
//! *Writing.* Pieces in rising order, then one empty piece at the offset that is the size of the
//! file: the server cuts the file there. *Reading.* Pieces from offset 0 on; one shorter than 256
//! bytes is the last. A client repeats what was not answered, so both are idempotent.

use super::super::bits::{Decode, DecodeError, Encode, Reader, Writer};
use super::super::id::ServiceId;

/// Fixed service of [`ListRequest`] and [`ListResponse`].
pub const LIST: ServiceId = ServiceId::from_low_bits(406);
/// Fixed service of [`ReadRequest`] and [`ReadResponse`].
pub const READ: ServiceId = ServiceId::from_low_bits(408);
/// Fixed service of [`WriteRequest`] and [`WriteResponse`].
pub const WRITE: ServiceId = ServiceId::from_low_bits(409);
/// Most bytes of a path.
pub const PATH_LEN_MAX: usize = 255;
/// Most bytes of a piece.
pub const PIECE_LEN_MAX: usize = 256;
/// Bytes of a request for a name.
pub const LIST_REQUEST_EXTENT: u16 = 8 + 1 + PATH_LEN_MAX as u16;
/// Bytes of its response.
pub const LIST_RESPONSE_EXTENT: u16 = 4 + 1 + PATH_LEN_MAX as u16;
/// Bytes of a read request.
pub const READ_REQUEST_EXTENT: u16 = 5 + 1 + PATH_LEN_MAX as u16;
/// Bytes of a read response.
pub const READ_RESPONSE_EXTENT: u16 = 2 + 2 + PIECE_LEN_MAX as u16;
/// Bytes of a write request.
pub const WRITE_REQUEST_EXTENT: u16 = 5 + 1 + PATH_LEN_MAX as u16 + 2 + PIECE_LEN_MAX as u16;
/// Bytes of a write response.
pub const WRITE_RESPONSE_EXTENT: u16 = 2;

/// Why a file could not be read or written (`uavcan.file.Error.1.0`); 0 is "no error", and numbers
/// without a name are possible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileError(pub u16);

impl FileError {
    /// No such file.
    pub const NOT_FOUND: Self = Self(2);
    /// The medium failed.
    pub const IO_ERROR: Self = Self(5);
    /// Not allowed, or not now.
    pub const ACCESS_DENIED: Self = Self(13);
    /// The path is a folder.
    pub const IS_DIRECTORY: Self = Self(21);
    /// Path or offset that is not possible.
    pub const INVALID_VALUE: Self = Self(22);
    /// Beyond the largest file.
    pub const FILE_TOO_LARGE: Self = Self(27);
    /// The medium is full.
    pub const OUT_OF_SPACE: Self = Self(28);
    /// Not for this file.
    pub const NOT_SUPPORTED: Self = Self(38);
    /// Anything else.
    pub const UNKNOWN: Self = Self(65535);
}

/// Request for the name of a file in a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ListRequest<'a> {
    /// Which file, from 0 without gaps.
    pub index: u32,
    /// Path of the folder; empty or `/` = the root. At most [`PATH_LEN_MAX`] bytes (the rest is not sent).
    pub folder: &'a [u8],
}

/// Name of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ListResponse<'a> {
    /// Name within the folder; empty = there is no file with this index, or no such folder.
    pub name: &'a [u8],
}

/// Request for a piece of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadRequest<'a> {
    /// First byte, 40 bits.
    pub offset: u64,
    /// UTF-8, separated by `/`, at most [`PATH_LEN_MAX`] bytes (the rest of a longer one is not
    /// sent).
    pub path: &'a [u8],
}

/// Piece of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadResponse<'a> {
    /// Whether it worked.
    pub result: Result<(), FileError>,
    /// At most [`PIECE_LEN_MAX`] bytes; fewer than that = end of the file.
    pub data: &'a [u8],
}

/// Store a piece of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteRequest<'a> {
    /// First byte, 40 bits.
    pub offset: u64,
    /// As in [`ReadRequest::path`].
    pub path: &'a [u8],
    /// At most [`PIECE_LEN_MAX`] bytes (the rest is not sent); empty = the file ends at `offset`.
    pub data: &'a [u8],
}

/// Whether the piece was stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteResponse {
    /// Whether it worked.
    pub result: Result<(), FileError>,
}

fn encode_path(path: &[u8], out: &mut Writer<'_>) {
    let path = path.get(..PATH_LEN_MAX).unwrap_or(path);
    out.u8(path.len() as u8);
    out.bytes(path);
}

fn encode_place(offset: u64, path: &[u8], out: &mut Writer<'_>) {
    out.uint(offset, 40);
    encode_path(path, out);
}

fn encode_piece(data: &[u8], out: &mut Writer<'_>) {
    let data = data.get(..PIECE_LEN_MAX).unwrap_or(data);
    out.u16(data.len() as u16);
    out.bytes(data);
}

fn encode_result(result: Result<(), FileError>, out: &mut Writer<'_>) {
    out.u16(result.map_or_else(|error| error.0, |()| 0));
}

fn decode_result(input: &mut Reader<'_>) -> Result<(), FileError> {
    match input.u16() {
        0 => Ok(()),
        error => Err(FileError(error)),
    }
}

impl Encode for ListRequest<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.uint(u64::from(self.index), 32);
        out.void(32);
        encode_path(self.folder, out);
    }
}

impl<'a> Decode<'a> for ListRequest<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        let index = input.uint(32) as u32;
        let _ = input.uint(32);
        Ok(Self { index, folder: input.byte_array(8, PATH_LEN_MAX)? })
    }
}

impl Encode for ListResponse<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.void(32);
        encode_path(self.name, out);
    }
}

impl<'a> Decode<'a> for ListResponse<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        let _ = input.uint(32);
        Ok(Self { name: input.byte_array(8, PATH_LEN_MAX)? })
    }
}

impl Encode for ReadRequest<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        encode_place(self.offset, self.path, out);
    }
}

impl<'a> Decode<'a> for ReadRequest<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Ok(Self { offset: input.uint(40), path: input.byte_array(8, PATH_LEN_MAX)? })
    }
}

impl Encode for ReadResponse<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        encode_result(self.result, out);
        encode_piece(self.data, out);
    }
}

impl<'a> Decode<'a> for ReadResponse<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Ok(Self { result: decode_result(input), data: input.byte_array(16, PIECE_LEN_MAX)? })
    }
}

impl Encode for WriteRequest<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        encode_place(self.offset, self.path, out);
        encode_piece(self.data, out);
    }
}

impl<'a> Decode<'a> for WriteRequest<'a> {
    fn decode(input: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Ok(Self {
            offset: input.uint(40),
            path: input.byte_array(8, PATH_LEN_MAX)?,
            data: input.byte_array(16, PIECE_LEN_MAX)?,
        })
    }
}

impl Encode for WriteResponse {
    fn encode(&self, out: &mut Writer<'_>) {
        encode_result(self.result, out);
    }
}

impl Decode<'_> for WriteResponse {
    fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self { result: decode_result(input) })
    }
}
