//! The tracker's datagrams in the virtual time of a cell in lock step: over a stream, with marks of time between them.
//!
//! ```text
//! cell:  both arms reach T ──► datagrams due by T, mark "these are all until T + 1 ms" ──► clients' turns until T + 1 ms
//! client: its turn at t     ──► reads until a mark is not before t
//! ```
//!
//! So what a client has heard of the tracker in a turn does not depend on how fast a machine hands it over. A record is a kind
//! (1 byte), a length (2 bytes, little endian) and as many bytes: a datagram, or the time of a mark in microseconds.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::time::Duration as WallSpan;

use protocol::{Duration, Instant};

/// The cell moves on by this much; the turns of all clients within it hear the same datagrams.
pub const STEP: Duration = Duration::from_millis(1);

const DATAGRAM: u8 = 0;
const MARK: u8 = 1;
/// The other side is held up or gone.
const PATIENCE: WallSpan = WallSpan::from_secs(30);

/// The cell's end.
#[derive(Debug)]
pub struct Trackers {
    listener: TcpListener,
    client: Option<TcpStream>,
    /// Datagrams that a client took, and those that nobody wanted.
    pub taken: u64,
    pub untaken: u64,
}

impl Trackers {
    /// Listens for one client.
    ///
    /// # Errors
    /// The address cannot be had.
    pub fn listen(address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, client: None, taken: 0, untaken: 0 })
    }

    /// All that is due until the end of the next step, which begins now. A client that connected in the last one hears it.
    pub fn put(&mut self, datagrams: &[Vec<u8>], step_ends: Instant) {
        if let Ok((client, _)) = self.listener.accept()
            && client.set_nonblocking(false).is_ok()
            && client.set_nodelay(true).is_ok()
            && client.set_write_timeout(Some(PATIENCE)).is_ok()
        {
            self.client = Some(client);
        }
        let Some(client) = &mut self.client else {
            self.untaken += datagrams.len() as u64;
            return;
        };
        let mut bytes = Vec::new();
        for datagram in datagrams {
            record(&mut bytes, DATAGRAM, datagram);
        }
        record(&mut bytes, MARK, &step_ends.as_micros().to_le_bytes());
        if client.write_all(&bytes).is_err() {
            self.client = None;
            self.untaken += datagrams.len() as u64;
        } else {
            self.taken += datagrams.len() as u64;
        }
    }
}

fn record(bytes: &mut Vec<u8>, kind: u8, content: &[u8]) {
    bytes.push(kind);
    bytes.extend(u16::try_from(content.len()).unwrap_or_default().to_le_bytes());
    bytes.extend(content);
}

/// A client's end.
#[derive(Debug)]
pub struct Follower {
    stream: TcpStream,
    /// All datagrams until then are here.
    until: Instant,
    waiting: VecDeque<Vec<u8>>,
}

impl Follower {
    /// Connects in a turn at `now`; the cell sends from its next step on.
    ///
    /// # Errors
    /// Nobody listens there.
    pub fn connect(address: &str, now: Instant) -> io::Result<Self> {
        let mut last = io::Error::new(io::ErrorKind::NotFound, "no address");
        for address in address.to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, PATIENCE) {
                Ok(stream) => {
                    stream.set_read_timeout(Some(PATIENCE))?;
                    // At the border of two steps the cell may have sent the mark of the second one already.
                    let steps = now.as_micros() / STEP.as_micros() + 1;
                    return Ok(Self {
                        stream,
                        until: Instant::ZERO + STEP * steps,
                        waiting: VecDeque::new(),
                    });
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    /// The next datagram that has come by `now`, the time of this turn.
    ///
    /// # Errors
    /// The cell is gone.
    pub fn next(&mut self, now: Instant) -> io::Result<Option<Vec<u8>>> {
        while self.until < now {
            let mut head = [0; 3];
            self.stream.read_exact(&mut head)?;
            let [kind, low, high] = head;
            let mut content = vec![0; usize::from(u16::from_le_bytes([low, high]))];
            self.stream.read_exact(&mut content)?;
            match (kind, <[u8; 8]>::try_from(content.as_slice())) {
                (MARK, Ok(us)) => self.until = Instant::from_micros(u64::from_le_bytes(us)),
                _ => self.waiting.push_back(content),
            }
        }
        Ok(self.waiting.pop_front())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datagrams_are_heard_in_the_turns_after_their_time_and_a_client_waits_for_no_mark_before_it_was_there()
    {
        let mut cell = Trackers::listen(([127, 0, 0, 1], 0).into()).unwrap();
        let address = cell.listener.local_addr().unwrap().to_string();
        let at = Instant::from_micros;
        cell.put(&[b"before".to_vec()], at(1_000));
        let mut client = Follower::connect(&address, at(1_200)).unwrap();
        assert_eq!(client.next(at(1_700)).unwrap(), None, "the step in which it connected");
        assert_eq!(client.next(at(2_000)).unwrap(), None);
        cell.put(&[b"one".to_vec(), b"two".to_vec()], at(3_000));
        cell.put(&[b"three".to_vec()], at(4_000));
        let heard = |client: &mut Follower, us| client.next(at(us)).unwrap();
        assert_eq!(heard(&mut client, 2_500), Some(b"one".to_vec()));
        assert_eq!(heard(&mut client, 2_500), Some(b"two".to_vec()));
        assert_eq!(heard(&mut client, 3_000), None, "the third one is of the next step");
        assert_eq!(heard(&mut client, 3_001), Some(b"three".to_vec()));
        assert_eq!((cell.taken, cell.untaken), (3, 1));
        drop(cell);
        assert!(client.next(at(9_000)).is_err());
    }

    #[test]
    fn a_client_that_connects_at_the_border_of_two_steps_waits_for_no_mark_of_the_one_that_begins_there() {
        let mut cell = Trackers::listen(([127, 0, 0, 1], 0).into()).unwrap();
        let address = cell.listener.local_addr().unwrap().to_string();
        let at = Instant::from_micros;
        cell.put(&[], at(2_000));
        let mut client = Follower::connect(&address, at(1_000)).unwrap();
        assert_eq!(client.next(at(1_900)).unwrap(), None);
        cell.put(&[b"one".to_vec()], at(3_000));
        assert_eq!(client.next(at(2_100)).unwrap(), Some(b"one".to_vec()));
    }
}
