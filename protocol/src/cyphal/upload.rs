//! File transfer by `file.Write`: the receiving bank, and the sending sequence.
//!
//! Both ends are idempotent, so a lost answer costs only a repetition.

use core::fmt;

use super::crc::Crc64;
use super::uavcan::file::{FileError, PIECE_LEN_MAX, WriteRequest};

/// A file of at most `SIZE` bytes that is being received.
///
/// | write | answer |
/// |---|---|
/// | bytes that are already there, unchanged | accepted, nothing happens |
/// | bytes at or before the present end | stored; what was behind them is forgotten |
/// | bytes after the end: a piece is missing | refused, `INVALID_VALUE` |
/// | bytes beyond `SIZE` | refused, `FILE_TOO_LARGE` |
/// | no bytes, at or before the end | the file ends here: complete |
/// | no bytes, after the end | refused, `INVALID_VALUE` |
///
/// A piece that changes something makes a complete file incomplete again, so a half-written new file never counts
/// as the old one.
#[derive(Clone, Debug)]
pub struct UploadBank<const SIZE: usize> {
    bytes: [u8; SIZE],
    len: usize,
    /// CRC-64/WE, once the file is complete.
    crc64: Option<u64>,
}

impl<const SIZE: usize> Default for UploadBank<SIZE> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const SIZE: usize> UploadBank<SIZE> {
    /// Empty and incomplete.
    pub const fn new() -> Self {
        Self { bytes: [0; SIZE], len: 0, crc64: None }
    }

    /// Takes one `file.Write`.
    pub fn write(&mut self, offset: u64, data: &[u8]) -> Result<(), FileError> {
        let at = usize::try_from(offset).map_err(|_| FileError::FILE_TOO_LARGE)?;
        if at > self.len {
            return Err(FileError::INVALID_VALUE);
        }
        if data.is_empty() {
            if self.len != at || self.crc64.is_none() {
                self.len = at;
                self.crc64 = Some(Crc64::of(self.contents()));
            }
            return Ok(());
        }
        let end = at.saturating_add(data.len());
        let place = self.bytes.get_mut(at..end).ok_or(FileError::FILE_TOO_LARGE)?;
        if end <= self.len && place == data {
            return Ok(());
        }
        for (to, from) in place.iter_mut().zip(data) {
            *to = *from;
        }
        self.len = end;
        self.crc64 = None;
        Ok(())
    }

    /// Copies what is there from `offset` on; returns the number of bytes.
    pub fn read(&self, offset: u64, data: &mut [u8]) -> usize {
        let from = usize::try_from(offset).ok().and_then(|at| self.contents().get(at..)).unwrap_or(&[]);
        for (to, from) in data.iter_mut().zip(from) {
            *to = *from;
        }
        from.len().min(data.len())
    }

    /// The bytes received so far, without gaps.
    pub fn contents(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or(&[])
    }

    /// CRC-64/WE of the file if it is complete.
    pub const fn complete(&self) -> Option<u64> {
        self.crc64
    }

    /// Forgets everything.
    pub const fn clear(&mut self) {
        self.len = 0;
        self.crc64 = None;
    }
}

/// The server refused a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UploadError {
    /// First byte of the piece.
    pub offset: usize,
    /// Error of the server.
    pub error: FileError,
}

impl fmt::Display for UploadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the server refused the piece at byte {} with file error {}", self.offset, self.error.0)
    }
}

impl core::error::Error for UploadError {}

/// Sequence of `file.Write` requests that stores a file: one at a time, each repeated until it is answered.
#[derive(Clone, Copy, Debug)]
pub struct Upload<'a> {
    path: &'a [u8],
    data: &'a [u8],
    offset: usize,
    finished: bool,
}

impl<'a> Upload<'a> {
    /// Upload of `data` to `path`.
    pub const fn new(path: &'a [u8], data: &'a [u8]) -> Self {
        Self { path, data, offset: 0, finished: false }
    }

    /// The request to send now; `None` when the file is stored.
    pub fn request(&self) -> Option<WriteRequest<'a>> {
        if self.finished {
            return None;
        }
        let rest = self.data.get(self.offset..).unwrap_or(&[]);
        let data = rest.get(..PIECE_LEN_MAX).unwrap_or(rest);
        Some(WriteRequest { offset: self.offset as u64, path: self.path, data })
    }

    /// Takes the answer to the last request; a refusal leaves the sequence where it is.
    pub fn answered(&mut self, result: Result<(), FileError>) -> Result<(), UploadError> {
        result.map_err(|error| UploadError { offset: self.offset, error })?;
        match self.request() {
            Some(request) if !request.data.is_empty() => self.offset += request.data.len(),
            _ => self.finished = true,
        }
        Ok(())
    }

    /// Bytes stored, and bytes in all.
    pub const fn progress(&self) -> (usize, usize) {
        (self.offset, self.data.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_in_order_and_an_empty_one_make_a_file() {
        let mut bank = UploadBank::<10>::new();
        assert_eq!(bank.write(0, b"abc"), Ok(()));
        assert_eq!(bank.write(3, b"de"), Ok(()));
        assert_eq!(bank.complete(), None);
        assert_eq!(bank.write(5, b""), Ok(()));
        assert_eq!((bank.contents(), bank.complete()), (&b"abcde"[..], Some(Crc64::of(b"abcde"))));
    }

    #[test]
    fn repeated_pieces_change_nothing_at_any_time() {
        let mut bank = UploadBank::<10>::new();
        for _ in 0..2 {
            bank.write(0, b"abc").unwrap();
            bank.write(0, b"abc").unwrap();
            bank.write(3, b"de").unwrap();
            bank.write(3, b"de").unwrap();
            bank.write(5, b"").unwrap();
            bank.write(5, b"").unwrap();
            assert_eq!((bank.contents(), bank.complete().is_some()), (&b"abcde"[..], true));
        }
        bank.write(0, b"abc").unwrap();
        assert!(bank.complete().is_some(), "a late repetition does not open the file again");
    }

    #[test]
    fn missing_piece_and_too_long_file_are_refused_and_leave_the_file() {
        let mut bank = UploadBank::<4>::new();
        bank.write(0, b"ab").unwrap();
        assert_eq!(bank.write(3, b"d"), Err(FileError::INVALID_VALUE));
        assert_eq!(bank.write(3, b""), Err(FileError::INVALID_VALUE));
        assert_eq!(bank.write(2, b"cde"), Err(FileError::FILE_TOO_LARGE));
        assert_eq!(bank.write(1 << 40, b"x"), Err(FileError::INVALID_VALUE));
        assert_eq!(bank.contents(), b"ab");
        assert_eq!(bank.write(2, b"cd"), Ok(()));
    }

    #[test]
    fn new_file_over_an_old_one_is_incomplete_until_its_own_end() {
        let mut bank = UploadBank::<10>::new();
        bank.write(0, b"abcdef").unwrap();
        bank.write(6, b"").unwrap();
        // Same beginning, so nothing changes yet; then a difference.
        bank.write(0, b"abc").unwrap();
        bank.write(3, b"XY").unwrap();
        assert_eq!((bank.contents(), bank.complete()), (&b"abcXY"[..], None));
        bank.write(5, b"").unwrap();
        assert_eq!(bank.complete(), Some(Crc64::of(b"abcXY")));
        // A new file that is the beginning of the old one.
        bank.write(0, b"ab").unwrap();
        bank.write(2, b"").unwrap();
        assert_eq!((bank.contents(), bank.complete()), (&b"ab"[..], Some(Crc64::of(b"ab"))));
    }

    #[test]
    fn reading_stops_at_the_end() {
        let mut bank = UploadBank::<10>::new();
        bank.write(0, b"abcde").unwrap();
        let mut data = [0; 4];
        assert_eq!((bank.read(0, &mut data), data), (4, *b"abcd"));
        assert_eq!((bank.read(4, &mut data), data[0]), (1, b'e'));
        assert_eq!((bank.read(5, &mut data), bank.read(u64::MAX, &mut data)), (0, 0));
    }

    #[test]
    fn upload_asks_piece_by_piece_and_ends_with_an_empty_one() {
        for len in [0_usize, 1, 255, 256, 257, 512, 600] {
            let data: Vec<u8> = (0..len).map(|i| i as u8).collect();
            let mut bank = UploadBank::<600>::new();
            let mut upload = Upload::new(b"p", &data);
            let mut requests = 0;
            while let Some(request) = upload.request() {
                let result = bank.write(request.offset, request.data);
                upload.answered(result).unwrap();
                requests += 1;
            }
            assert_eq!(requests, len.div_ceil(256) + 1);
            assert_eq!((bank.contents(), upload.progress()), (&data[..], (len, len)));
            assert!(bank.complete().is_some());
        }
    }

    #[test]
    fn refusal_says_where_and_leaves_the_upload_there() {
        let mut upload = Upload::new(b"p", &[0; 300]);
        upload.answered(Ok(())).unwrap();
        let refused = upload.answered(Err(FileError::OUT_OF_SPACE));
        assert_eq!(refused, Err(UploadError { offset: 256, error: FileError::OUT_OF_SPACE }));
        assert_eq!(upload.request().map(|request| request.offset), Some(256));
    }
}
