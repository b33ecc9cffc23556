//! A byte stream that never blocks, with a bounded output queue.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::net::sockopt;

/// Bytes of output that wait for a slow reader: about 1 100 frames in socketcand's text.
pub(crate) const OUTPUT_QUEUE_BYTES: usize = 64 * 1024;

/// A connection on which nothing came for this long is probed, in this interval, and given up after this many
/// probes without an answer: 11 s after the last data from the far side.
const PROBE_AFTER: Duration = Duration::from_secs(5);
const PROBE_EVERY: Duration = Duration::from_secs(2);
const PROBES: u32 = 3;

/// What carries the bytes.
pub(crate) enum Medium {
    Tcp(TcpStream),
    /// A serial device or the near end of a pseudo-terminal, opened without blocking.
    Serial {
        file: File,
        /// The far end of a pseudo-terminal: while it is open, the near end works even if no program uses the far
        /// end.
        _far_end: Option<OwnedFd>,
    },
}

impl AsFd for Medium {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Tcp(stream) => stream.as_fd(),
            Self::Serial { file, .. } => file.as_fd(),
        }
    }
}

/// Result of one read.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Chunk {
    /// This many bytes are in the buffer.
    Bytes(usize),
    /// Nothing there now.
    Empty,
    /// The far side has closed.
    Closed,
}

/// Reads and writes without blocking; whole messages are queued when the medium is full.
pub(crate) struct Stream {
    medium: Medium,
    /// Bytes `sent..` still have to go.
    queue: Vec<u8>,
    sent: Cell<usize>,
}

impl Stream {
    /// `medium` must be set to non-blocking already.
    pub(crate) const fn new(medium: Medium) -> Self {
        Self { medium, queue: Vec::new(), sent: Cell::new(0) }
    }

    /// A TCP connection without Nagle's delay: an answer leaves at once and on its own. A far side that has failed
    /// silently (no power, no network) is noticed: its system no longer answers the probes.
    pub(crate) fn tcp(stream: TcpStream) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        stream.set_nodelay(true)?;
        sockopt::set_socket_keepalive(&stream, true)?;
        sockopt::set_tcp_keepidle(&stream, PROBE_AFTER)?;
        sockopt::set_tcp_keepintvl(&stream, PROBE_EVERY)?;
        sockopt::set_tcp_keepcnt(&stream, PROBES)?;
        Ok(Self::new(Medium::Tcp(stream)))
    }

    pub(crate) fn read(&mut self, buffer: &mut [u8]) -> io::Result<Chunk> {
        loop {
            let result = match &mut self.medium {
                Medium::Tcp(stream) => stream.read(buffer),
                Medium::Serial { file, .. } => file.read(buffer),
            };
            return match result {
                Ok(0) => Ok(Chunk::Closed),
                Ok(count) => Ok(Chunk::Bytes(count)),
                Err(error) => match error.kind() {
                    ErrorKind::Interrupted => continue,
                    ErrorKind::WouldBlock => Ok(Chunk::Empty),
                    ErrorKind::ConnectionReset | ErrorKind::BrokenPipe => Ok(Chunk::Closed),
                    _ => Err(error),
                },
            };
        }
    }

    /// Appends a whole message to the queue; false, and nothing is queued, if it does not fit.
    pub(crate) fn queue(&mut self, message: &[u8]) -> bool {
        if self.pending() == 0 {
            self.discard_output();
        }
        let fits = self.pending() + message.len() <= OUTPUT_QUEUE_BYTES;
        if fits {
            self.queue.extend_from_slice(message);
        }
        fits
    }

    /// Bytes that wait to be written.
    pub(crate) fn pending(&self) -> usize {
        self.queue.len() - self.sent.get()
    }

    /// False for a serial line, on which a closed far end cannot be detected.
    pub(crate) const fn can_hang_up(&self) -> bool {
        matches!(self.medium, Medium::Tcp(_))
    }

    /// Drops what waits to be written.
    pub(crate) fn discard_output(&mut self) {
        self.queue.clear();
        self.sent.set(0);
    }

    /// Writes the queue and `message` together; blocks while the medium is full.
    pub(crate) fn write_now(&self, message: &[u8]) -> io::Result<()> {
        let message = [self.queue.get(self.sent.get()..).unwrap_or(&[]), message].concat();
        self.sent.set(self.queue.len());
        let mut sent = 0;
        while sent < message.len() {
            let result = match &self.medium {
                Medium::Tcp(stream) => (&mut &*stream).write(message.get(sent..).unwrap_or(&[])),
                Medium::Serial { file, .. } => (&mut &*file).write(message.get(sent..).unwrap_or(&[])),
            };
            match result {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => sent += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => self.wait_for_room()?,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Writes all that waits; blocks while the medium is full.
    pub(crate) fn flush_all(&mut self) -> io::Result<()> {
        self.flush()?;
        while self.pending() > 0 {
            self.wait_for_room()?;
            self.flush()?;
        }
        Ok(())
    }

    fn wait_for_room(&self) -> io::Result<()> {
        match poll(&mut [PollFd::from_borrowed_fd(self.as_fd(), PollFlags::OUT)], None) {
            Ok(_) | Err(Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Writes as much as the medium accepts now; true if anything was written.
    pub(crate) fn flush(&mut self) -> io::Result<bool> {
        let before = self.sent.get();
        while let Some(rest) = self.queue.get(self.sent.get()..).filter(|rest| !rest.is_empty()) {
            let result = match &mut self.medium {
                Medium::Tcp(stream) => stream.write(rest),
                Medium::Serial { file, .. } => file.write(rest),
            };
            match result {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => self.sent.set(self.sent.get() + count),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) => return Err(error),
            }
        }
        let sent = self.sent.get();
        // Copying the rest down costs less than a ring as long as it happens once per half queue.
        if sent == self.queue.len() {
            self.discard_output();
        } else if sent > OUTPUT_QUEUE_BYTES / 2 {
            self.queue.drain(..sent);
            self.sent.set(0);
        }
        Ok(sent > before)
    }
}

impl AsFd for Stream {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.medium.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    /// The system does the probing; a test on one machine can only check that it was requested.
    #[test]
    fn connection_whose_far_side_vanishes_is_probed_and_given_up_within_11_s() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let far = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let stream = Stream::tcp(far).unwrap();
        assert!(sockopt::socket_keepalive(&stream).unwrap());
        let (idle, every) =
            (sockopt::tcp_keepidle(&stream).unwrap(), sockopt::tcp_keepintvl(&stream).unwrap());
        let given_up = idle + every * sockopt::tcp_keepcnt(&stream).unwrap();
        assert_eq!(given_up, Duration::from_secs(11));
    }
}
