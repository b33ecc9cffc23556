//! The station behind a socket: datagrams or a stream, by the clock or in step with a simulated robot.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::time::Instant as WallTime;

use protocol::{Duration, Instant};
use rsi_protocol::{Framer, StreamItem};

use super::log::Line;
use super::station::{Stage, Station};

/// Longest datagram that is read, bytes; longer ones are cut and then unreadable.
const LONGEST: usize = rsi_protocol::MAX_READ_BYTES;
/// Longest wait without a look at `goes_on`.
const LOOK: std::time::Duration = std::time::Duration::from_millis(20);
/// Time between two looks for a connection.
const ACCEPT: std::time::Duration = std::time::Duration::from_millis(1);
/// Answer times that are kept.
const ANSWER_TIMES_MAX: usize = 1_000_000;
/// Telegrams that are drained in one go; more waiting ones are drained in the next.
const DRAINED: usize = 64;
/// After the end of the throw telegrams are answered for so long, then the robot's program is asked to end.
const AFTER: Duration = Duration::from_millis(500);
/// Longest wait for an arm that was ordered to stop.
const STOPPING: Duration = Duration::from_secs(3);
/// A robot that was asked to end is heard for so long.
const LEAVING: std::time::Duration = std::time::Duration::from_millis(200);
/// In step with the robot: a robot that is silent for so long by the clock has ended.
const SILENT: std::time::Duration = std::time::Duration::from_secs(10);

/// Whose time counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Time {
    /// The clock's.
    Clock,
    /// The robot's: each telegram is one such period. For a simulated robot that waits for every answer.
    Robot(Duration),
}

/// How the exchange went.
#[derive(Clone, Debug, Default)]
pub struct Exchange {
    /// From the arrival of a telegram to its answer, us, of the first million answers.
    pub answer_us: Vec<u32>,
    /// Robots (sockets) that were heard.
    pub connections: u32,
}

impl Exchange {
    /// The answer time that the given share of all answers does not exceed, us.
    #[must_use]
    pub fn answer_time_us(&self, share: f64) -> Option<u32> {
        let mut times = self.answer_us.clone();
        times.sort_unstable();
        let last = times.len().checked_sub(1)?;
        times.get((share.clamp(0.0, 1.0) * last as f64).round() as usize).copied()
    }
}

/// Where robots connect to.
#[derive(Debug)]
pub enum Port {
    /// Datagrams: the answer goes to where the telegram came from.
    Udp(UdpSocket),
    /// A stream: the robot connects once per program run.
    Tcp {
        /// Waits for robots.
        listener: TcpListener,
        /// The robot, with what was read of its stream.
        stream: Option<(TcpStream, SocketAddr, Framer)>,
    },
}

/// Documents that waited, and who sent the newest.
struct Arrived {
    documents: Vec<Vec<u8>>,
    from: SocketAddr,
}

impl Port {
    /// Opens the port at an address of this machine.
    ///
    /// # Errors
    /// The address cannot be had.
    pub fn bind(tcp: bool, address: SocketAddr) -> io::Result<Self> {
        if !tcp {
            return UdpSocket::bind(address).map(Self::Udp);
        }
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self::Tcp { listener, stream: None })
    }

    /// Where it is.
    ///
    /// # Errors
    /// The system does not tell.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        match self {
            Self::Udp(socket) => socket.local_addr(),
            Self::Tcp { listener, .. } => listener.local_addr(),
        }
    }

    /// All that waits; waits for the first at most `limit`.
    fn receive(&mut self, limit: std::time::Duration, buffer: &mut [u8]) -> io::Result<Option<Arrived>> {
        match self {
            Self::Udp(socket) => {
                socket.set_read_timeout(Some(limit))?;
                let Some((first, mut from)) = datagram(socket, buffer)? else { return Ok(None) };
                let mut documents = vec![first];
                socket.set_nonblocking(true)?;
                while documents.len() < DRAINED
                    && let Some((bytes, newer_from)) = datagram(socket, buffer)?
                {
                    if newer_from != from {
                        // Another robot, or its new run: what the one before sent is void.
                        documents.clear();
                    }
                    from = newer_from;
                    documents.push(bytes);
                }
                socket.set_nonblocking(false)?;
                Ok(Some(Arrived { documents, from }))
            }
            Self::Tcp { listener, stream } => {
                match listener.accept() {
                    Ok((new, from)) => {
                        new.set_nodelay(true)?;
                        new.set_nonblocking(false)?;
                        *stream = Some((new, from, Framer::new()));
                    }
                    Err(error) if would_block(&error) => {}
                    Err(error) => return Err(error),
                }
                let Some((robot, from, framer)) = stream else {
                    std::thread::sleep(limit.min(ACCEPT));
                    return Ok(None);
                };
                robot.set_read_timeout(Some(limit))?;
                let (from, read) = (*from, robot.read(buffer));
                match read {
                    Ok(count @ 1..) => {
                        let items = framer.push(buffer.get(..count).unwrap_or_default());
                        let documents: Vec<Vec<u8>> = items
                            .into_iter()
                            .filter_map(|item| match item {
                                StreamItem::Document(document) => Some(document),
                                StreamItem::Dropped(_) => None,
                            })
                            .collect();
                        Ok((!documents.is_empty()).then_some(Arrived { documents, from }))
                    }
                    Err(error) if would_block(&error) => Ok(None),
                    // Closed or broken: the robot's program has ended. It connects again with the next one.
                    Ok(0) | Err(_) => {
                        *stream = None;
                        Ok(None)
                    }
                }
            }
        }
    }

    /// Answers. An answer that cannot be delivered is lost, as on the wire.
    fn answer(&mut self, to: SocketAddr, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Udp(socket) => match socket.send_to(bytes, to) {
                Ok(_) => Ok(()),
                Err(error) if is_gone(&error) => Ok(()),
                Err(error) => Err(error),
            },
            Self::Tcp { stream, .. } => {
                if let Some((robot, ..)) = stream
                    && robot.write_all(bytes).is_err()
                {
                    *stream = None;
                }
                Ok(())
            }
        }
    }
}

/// A datagram, if one is there in time. An unreachable peer, reported by its host, is a robot that has ended.
fn datagram(socket: &UdpSocket, buffer: &mut [u8]) -> io::Result<Option<(Vec<u8>, SocketAddr)>> {
    match socket.recv_from(buffer) {
        Ok((length, from)) => Ok(Some((buffer.get(..length).unwrap_or_default().to_vec(), from))),
        Err(error) if would_block(&error) || is_gone(&error) => Ok(None),
        Err(error) => Err(error),
    }
}

fn would_block(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

fn is_gone(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset)
}

/// The station's time.
struct Clock {
    time: Time,
    begun: WallTime,
    telegrams: u64,
    /// In step with the robot: deadlines that were reached while it was silent.
    ahead: Duration,
    heard: WallTime,
}

impl Clock {
    fn now(&self) -> Instant {
        match self.time {
            Time::Clock => {
                Instant::from_micros(u64::try_from(self.begun.elapsed().as_micros()).unwrap_or(u64::MAX))
            }
            Time::Robot(period) => Instant::ZERO + period * self.telegrams + self.ahead,
        }
    }

    fn arrived(&mut self) {
        self.telegrams += 1;
        self.heard = WallTime::now();
    }

    /// How long to wait for the robot until the deadline `due`; `None`: it has come.
    fn left(&mut self, due: Option<Instant>) -> Option<std::time::Duration> {
        let due = due?;
        match self.time {
            Time::Clock => {
                let left = std::time::Duration::from_micros(due.saturating_since(self.now()).as_micros());
                (!left.is_zero()).then_some(left)
            }
            // Time stands while the robot is on its way; one that stays silent is one whose time has run on without it.
            Time::Robot(_) => {
                if self.telegrams == 0 || self.heard.elapsed() < SILENT {
                    return Some(LOOK);
                }
                self.ahead += due.saturating_since(self.now());
                None
            }
        }
    }
}

/// What the caller does while the exchange goes on.
pub trait Host {
    /// Says no to end the exchange; the arm is stopped first.
    fn goes_on(&mut self, now: Instant, station: &mut Station) -> bool;
    /// True: the exchange goes on after the last motion, until [`Host::goes_on`] says no.
    fn stays(&self) -> bool {
        false
    }
    /// What went in and out since the last call.
    fn log(&mut self, lines: Vec<Line>);
}

/// Serves until the throw has ended, or the host says no; then the arm is stopped first. At the end the robot's program is
/// asked to end.
///
/// # Errors
/// The socket fails.
pub fn serve(
    port: &mut Port,
    station: &mut Station,
    time: Time,
    host: &mut dyn Host,
) -> io::Result<Exchange> {
    let wall = WallTime::now();
    let mut clock = Clock { time, begun: wall, telegrams: 0, ahead: Duration::ZERO, heard: wall };
    let mut exchange = Exchange::default();
    let mut robot: Option<SocketAddr> = None;
    let (mut ends_at, mut stopping, mut leaving_since) = (None::<Instant>, false, None::<WallTime>);
    let mut buffer = vec![0; LONGEST];
    // A program that ended just now may have answered the last telegram. A robot that misses an answer says so: no cycle of its
    // is answered before a whole one has passed. A stream ends with the program that it belonged to.
    let is_next_program = time == Time::Clock && matches!(port, Port::Udp(_));
    let cycle_us = station.settings().cycle_period().as_micros();
    let listens_from = Instant::from_micros(if is_next_program { cycle_us + cycle_us / 2 } else { 0 });
    loop {
        host.log(station.take_log());
        let now = clock.now();
        if !stopping && !host.goes_on(now, station) {
            stopping = true;
            let moves = matches!(station.stage(), Stage::Running { .. });
            station.stop(now);
            ends_at = ends_at.or(Some(if moves { now + STOPPING } else { now }));
            if robot.is_none() {
                return Ok(exchange);
            }
        }
        if station.stage().is_end() && (stopping || !host.stays()) {
            ends_at = Some(ends_at.map_or(now + AFTER, |at| at.min(now + AFTER)));
        }
        if leaving_since.is_none() && ends_at.is_some_and(|at| at <= now) {
            station.leave(now);
            leaving_since = Some(WallTime::now());
        }
        let silent = clock.heard.elapsed() >= LEAVING;
        if leaving_since
            .is_some_and(|since| since.elapsed() >= LEAVING && silent || since.elapsed() >= 5 * LEAVING)
        {
            host.log(station.take_log());
            return Ok(exchange);
        }
        let left = match (station.poll_timeout(), leaving_since) {
            (Some(due), None) => match clock.left(Some(due)) {
                Some(left) => left.min(LOOK),
                None => {
                    station.handle_timeout(clock.now());
                    continue;
                }
            },
            _ => LOOK,
        };
        let Some(arrived) = port.receive(left, &mut buffer)? else { continue };
        if clock.now() < listens_from {
            continue;
        }
        if leaving_since.is_some() && robot != Some(arrived.from) {
            // The program that was asked to end has ended; the next one is for somebody else.
            host.log(station.take_log());
            return Ok(exchange);
        }
        let begun = WallTime::now();
        clock.arrived();
        if matches!(time, Time::Robot(_)) {
            // Deadlines within the cycle that has passed.
            while let Some(due) = station.poll_timeout().filter(|due| *due <= clock.now()) {
                station.handle_timeout(due);
                if station.poll_timeout() == Some(due) {
                    break;
                }
            }
        }
        let new_connection = robot.is_some_and(|robot| robot != arrived.from);
        exchange.connections += u32::from(robot != Some(arrived.from));
        robot = Some(arrived.from);
        if let Some(answer) = station.handle(clock.now(), &arrived.documents, new_connection) {
            port.answer(arrived.from, &answer)?;
            let took = begun.elapsed().as_micros();
            if exchange.answer_us.len() < ANSWER_TIMES_MAX {
                exchange.answer_us.push(u32::try_from(took).unwrap_or(u32::MAX));
            }
        }
    }
}
