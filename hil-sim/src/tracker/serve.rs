//! The tracker behind sockets: data over UDP, commands over TCP.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::os::fd::AsFd;

use can_link::Clock;
use protocol::{Duration, Instant};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::server::{Connection, Tracker};

/// Longest sleep, so that an interrupt is seen.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// Why the tracker cannot serve.
#[derive(Debug, thiserror::Error)]
#[error("{address}: {error}")]
pub struct ServeError {
    /// The address that cannot be used.
    pub address: SocketAddr,
    pub error: io::Error,
}

impl ServeError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some("choose a port that is free".to_owned())
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Served {
    pub datagrams: u64,
    /// Datagrams that the system did not take.
    pub unsent: u64,
    pub connections: u64,
}

#[derive(Debug)]
pub struct Sockets {
    listener: TcpListener,
    data: UdpSocket,
    streams: Vec<(Connection, TcpStream)>,
    served: Served,
}

impl Sockets {
    /// Listens for commands at `command`; data leave from any port.
    pub fn bind(command: SocketAddr) -> Result<Self, ServeError> {
        let bind = || {
            let listener = TcpListener::bind(command)?;
            listener.set_nonblocking(true)?;
            let any: SocketAddr =
                if command.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0_u16; 8], 0).into() };
            let data = UdpSocket::bind(any)?;
            data.set_nonblocking(true)?;
            Ok(Self { listener, data, streams: Vec::new(), served: Served::default() })
        };
        bind().map_err(|error| ServeError { address: command, error })
    }

    pub fn command_address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// What was served so far.
    pub fn served(&self) -> Served {
        self.served
    }

    /// Serves in real time until `goes_on` returns false or `until` has come.
    pub fn run(&mut self, tracker: &mut Tracker, until: Instant, goes_on: &dyn Fn() -> bool) {
        let clock = Clock::start();
        while goes_on() && clock.now() < until {
            let now = clock.now();
            self.accept(tracker);
            self.read(tracker, now);
            while tracker.poll_timeout().is_some_and(|due| due <= now) {
                tracker.handle_timeout(now);
                self.send(tracker, now);
            }
            self.answer(tracker);
            let next = tracker.poll_timeout().unwrap_or(Instant::FAR_FUTURE).min(until);
            self.sleep(clock.remaining(next.min(now + LONGEST_SLEEP)));
        }
    }

    fn accept(&mut self, tracker: &mut Tracker) {
        while let Ok((stream, peer)) = self.listener.accept() {
            let ready = stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true));
            if ready.is_err() {
                continue;
            }
            // One too many is closed at once.
            if let Some(connection) = tracker.connect(peer.ip()) {
                self.served.connections += 1;
                self.streams.push((connection, stream));
            }
        }
    }

    fn read(&mut self, tracker: &mut Tracker, now: Instant) {
        let mut buffer = [0; 4096];
        self.streams.retain_mut(|(connection, stream)| match stream.read(&mut buffer) {
            Ok(count @ 1..) => {
                tracker.handle_command(now, *connection, buffer.get(..count).unwrap_or_default());
                true
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => true,
            Ok(0) | Err(_) => {
                tracker.disconnect(*connection);
                false
            }
        });
    }

    fn send(&mut self, tracker: &mut Tracker, now: Instant) {
        while let Some((to, bytes)) = tracker.poll_data(now) {
            match self.data.send_to(&bytes, to) {
                Ok(_) => self.served.datagrams += 1,
                Err(_) => self.served.unsent += 1,
            }
        }
    }

    fn answer(&mut self, tracker: &mut Tracker) {
        while let Some((connection, bytes)) = tracker.poll_answer() {
            let stream = self.streams.iter_mut().find(|(other, _)| *other == connection);
            // A client that does not read its answers is closed: an answer has 200 bytes at most.
            if stream.is_some_and(|(_, stream)| stream.write_all(&bytes).is_err()) {
                tracker.disconnect(connection);
                self.streams.retain(|(other, _)| *other != connection);
            }
        }
    }

    fn sleep(&self, limit: std::time::Duration) {
        let mut set = vec![PollFd::from_borrowed_fd(self.listener.as_fd(), PollFlags::IN)];
        set.extend(self.streams.iter().map(|(_, s)| PollFd::from_borrowed_fd(s.as_fd(), PollFlags::IN)));
        let timeout = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: limit.subsec_nanos().into() };
        // Interrupted or not: the caller checks everything anyway.
        let _ = poll(&mut set, Some(&timeout));
    }
}
