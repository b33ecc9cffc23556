//! The socket of the controller, and what is seen on it.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use rsi_protocol::{Framer, Protocol, Root, StreamItem, Telegram};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

/// Time for a TCP connection.
const CONNECT_LIMIT: Duration = Duration::from_secs(3);
/// Largest datagram that is read.
const MAX_BYTES: usize = 65_536;

#[derive(Debug)]
enum Socket {
    Udp(UdpSocket),
    Tcp(TcpStream),
}

/// Result of one read of the socket.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Received {
    /// Nothing waits.
    Nothing,
    /// Whole documents, and the number of bytes outside of documents; empty for a piece of a document.
    Items(Vec<StreamItem>),
    /// The client closed the connection.
    Closed,
}

/// One socket for one program run.
#[derive(Debug)]
pub(super) struct Port {
    socket: Socket,
    framer: Framer,
    buffer: Vec<u8>,
}

impl Port {
    /// Opens the socket: a datagram socket with a new source port, or a connection.
    pub(super) fn open(protocol: Protocol, pc: SocketAddr) -> io::Result<Self> {
        let socket = match protocol {
            Protocol::Udp => {
                let any: SocketAddr =
                    if pc.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0_u16; 8], 0).into() };
                let socket = UdpSocket::bind(any)?;
                socket.connect(pc)?;
                socket.set_nonblocking(true)?;
                Socket::Udp(socket)
            }
            Protocol::Tcp => {
                let stream = TcpStream::connect_timeout(&pc, CONNECT_LIMIT)?;
                stream.set_nodelay(true)?;
                stream.set_nonblocking(true)?;
                Socket::Tcp(stream)
            }
        };
        Ok(Self { socket, framer: Framer::new(), buffer: vec![0; MAX_BYTES] })
    }

    /// Sends a telegram; `false` if the connection has failed. Datagrams are lost silently, as on a wire.
    pub(super) fn send(&mut self, bytes: &[u8]) -> bool {
        match &mut self.socket {
            Socket::Udp(socket) => {
                let _ = socket.send(bytes);
                true
            }
            // A telegram has at most 1 kB: a send buffer that has no room for it belongs to a client that has not read
            // for thousands of cycles.
            Socket::Tcp(stream) => stream.write_all(bytes).is_ok(),
        }
    }

    /// What has arrived, without waiting.
    pub(super) fn receive(&mut self) -> Received {
        let read = match &mut self.socket {
            Socket::Udp(socket) => socket.recv(&mut self.buffer),
            Socket::Tcp(stream) => match stream.read(&mut self.buffer) {
                Ok(0) => return Received::Closed,
                read => read,
            },
        };
        match (read, &self.socket) {
            (Ok(count), socket) => {
                let bytes = self.buffer.get(..count).unwrap_or_default();
                Received::Items(match socket {
                    Socket::Udp(_) => vec![StreamItem::Document(bytes.to_vec())],
                    Socket::Tcp(_) => self.framer.push(bytes),
                })
            }
            (Err(error), _) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
                Received::Nothing
            }
            // No client listens on that port (yet).
            (Err(_), Socket::Udp(_)) => Received::Nothing,
            (Err(_), Socket::Tcp(_)) => Received::Closed,
        }
    }

    /// Sleeps until something can be read or `limit` has passed.
    pub(super) fn wait(&self, limit: Duration) {
        let timeout = Timespec {
            tv_sec: i64::try_from(limit.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: limit.subsec_nanos().into(),
        };
        let mut set = [PollFd::from_borrowed_fd(self.fd(), PollFlags::IN)];
        match poll(&mut set, Some(&timeout)) {
            Ok(_) | Err(Errno::INTR) => {}
            // No memory for a poll: try again a little later.
            Err(_) => std::thread::sleep(Duration::from_micros(100)),
        }
    }

    fn fd(&self) -> BorrowedFd<'_> {
        match &self.socket {
            Socket::Udp(socket) => socket.as_fd(),
            Socket::Tcp(stream) => stream.as_fd(),
        }
    }
}

/// Number of the answer; `None` for a document that is not an answer.
pub(super) fn number_of(document: &[u8]) -> Option<u64> {
    Telegram::parse(document, Root::Sen).ok().map(|answer| answer.ipoc.value())
}
