//! The station behind a socket: datagrams or a stream, by the clock or in step with a simulated robot.

use std::borrow::BorrowMut;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::time::Instant as WallTime;

use protocol::{Duration, Instant};
use rsi_protocol::{Framer, StreamItem};

use super::log::Line;
use super::station::{Stage, Station};

/// Longest datagram that is read, bytes; longer ones are cut and then unreadable.
const LONGEST: usize = rsi_protocol::MAX_READ_BYTES;
/// Longest wait without a call of `goes_on`.
const LOOK: std::time::Duration = std::time::Duration::from_millis(20);
/// Time between two looks for a connection.
const ACCEPT: std::time::Duration = std::time::Duration::from_millis(1);
/// Answer times that are kept.
const ANSWER_TIMES_MAX: usize = 1_000_000;
/// Telegrams that are drained in one go; more waiting ones are drained in the next.
const DRAINED: usize = 64;
/// Telegrams are answered for this long after the end of the throw, then the robot's program is ordered to end.
const AFTER: Duration = Duration::from_millis(500);
/// Longest wait for an arm that was ordered to stop.
const STOPPING: Duration = Duration::from_secs(3);
/// After the order to end, telegrams of the robot are read for this long.
const LEAVING: std::time::Duration = std::time::Duration::from_millis(200);
/// In step with the robot: a robot that is silent for this long by the clock has ended.
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
    /// Robots (sockets) that have sent telegrams.
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
    pub fn bind(tcp: bool, address: SocketAddr) -> io::Result<Self> {
        if !tcp {
            return UdpSocket::bind(address).map(Self::Udp);
        }
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self::Tcp { listener, stream: None })
    }

    /// Where it is.
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
                        // Another robot, or its new run: earlier data are void.
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
            // Time stands while the robot's telegram is on its way; for a robot that stays silent, time continues without it.
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

/// Work of the caller during the exchange.
pub trait Host {
    /// Returns false to end the exchange; the arm is stopped first.
    fn goes_on(&mut self, now: Instant, station: &mut Station) -> bool;
    /// True if the exchange continues after the last motion, until [`Host::goes_on`] returns false.
    fn stays(&self) -> bool {
        false
    }
    /// What went in and out since the last call.
    fn log(&mut self, lines: Vec<Line>);
}

/// A robot that is served through a port: the exchange continues while [`Live::step`] is called.
pub struct Live<P> {
    port: P,
    clock: Clock,
    exchange: Exchange,
    /// Who sent the last telegram.
    robot: Option<SocketAddr>,
    /// The robot's program was ordered to end, and has: the next one is not for this client.
    over: bool,
    leaving: bool,
    buffer: Vec<u8>,
}

impl<P: BorrowMut<Port>> Live<P> {
    pub fn new(port: P, time: Time) -> Self {
        let wall = WallTime::now();
        let clock = Clock { time, begun: wall, telegrams: 0, ahead: Duration::ZERO, heard: wall };
        let (exchange, buffer) = (Exchange::default(), vec![0; LONGEST]);
        Self { port, clock, exchange, robot: None, over: false, leaving: false, buffer }
    }

    #[must_use]
    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    #[must_use]
    pub const fn exchange(&self) -> &Exchange {
        &self.exchange
    }

    /// No telegram came for so long that no more are expected.
    #[must_use]
    pub fn is_silent(&self) -> bool {
        self.robot.is_none() || self.clock.heard.elapsed() >= SILENT
    }

    /// Waits some hundredths of a second for a telegram or a deadline of the station, and serves it.
    pub fn step(&mut self, station: &mut Station) -> io::Result<()> {
        let left = match station.poll_timeout().filter(|_| !self.leaving) {
            Some(due) => match self.clock.left(Some(due)) {
                Some(left) => left.min(LOOK),
                None => {
                    station.handle_timeout(self.clock.now());
                    return Ok(());
                }
            },
            None => LOOK,
        };
        let Some(arrived) = self.port.borrow_mut().receive(left, &mut self.buffer)? else { return Ok(()) };
        if self.clock.now() < self.listens_from(station) {
            return Ok(());
        }
        if self.leaving && self.robot != Some(arrived.from) {
            self.over = true;
            return Ok(());
        }
        let begun = WallTime::now();
        self.clock.arrived();
        if matches!(self.clock.time, Time::Robot(_)) {
            // Deadlines within the cycle that has passed.
            while let Some(due) = station.poll_timeout().filter(|due| *due <= self.clock.now()) {
                station.handle_timeout(due);
                if station.poll_timeout() == Some(due) {
                    break;
                }
            }
        }
        let new_connection = self.robot.is_some_and(|robot| robot != arrived.from);
        self.exchange.connections += u32::from(self.robot != Some(arrived.from));
        self.robot = Some(arrived.from);
        if let Some(answer) = station.handle(self.clock.now(), &arrived.documents, new_connection) {
            self.port.borrow_mut().answer(arrived.from, &answer)?;
            let took = begun.elapsed().as_micros();
            if self.exchange.answer_us.len() < ANSWER_TIMES_MAX {
                self.exchange.answer_us.push(u32::try_from(took).unwrap_or(u32::MAX));
            }
        }
        Ok(())
    }

    /// A program of this computer that ended just now may have answered the last telegram. A robot reports a missed
    /// answer, so its cycles are answered only after a whole one has passed. A stream ends with its program.
    fn listens_from(&self, station: &Station) -> Instant {
        let is_next_program = self.clock.time == Time::Clock && matches!(self.port.borrow(), Port::Udp(_));
        let cycle_us = station.settings().cycle_period().as_micros();
        Instant::from_micros(if is_next_program { cycle_us + cycle_us / 2 } else { 0 })
    }

    /// Stops what moves, then orders the robot's program to end and reads until it has; `log` gets the input and the output.
    pub fn leave(&mut self, station: &mut Station, log: &mut dyn FnMut(Vec<Line>)) -> io::Result<()> {
        let mut ends_at = self.now() + AFTER;
        if !station.stage().is_end() {
            let moves = matches!(station.stage(), Stage::Running { .. });
            station.stop(self.now());
            ends_at = self.now() + if moves { STOPPING } else { Duration::ZERO };
        }
        if self.robot.is_none() {
            log(station.take_log());
            return Ok(());
        }
        while self.now() < ends_at {
            if station.stage().is_end() {
                ends_at = ends_at.min(self.now() + AFTER);
            }
            self.step(station)?;
            log(station.take_log());
        }
        station.leave(self.now());
        self.leaving = true;
        let since = WallTime::now();
        while !self.over
            && since.elapsed() < 5 * LEAVING
            && (since.elapsed() < LEAVING || self.clock.heard.elapsed() < LEAVING)
        {
            self.step(station)?;
            log(station.take_log());
        }
        log(station.take_log());
        Ok(())
    }
}

/// Serves until the throw has ended, or the host returns false; then the arm is stopped first. At the end the
/// robot's program is ordered to end.
pub fn serve(
    port: &mut Port,
    station: &mut Station,
    time: Time,
    host: &mut dyn Host,
) -> io::Result<Exchange> {
    let mut live = Live::new(port, time);
    host.log(station.take_log());
    while host.goes_on(live.now(), station) && (host.stays() || !station.stage().is_end()) {
        live.step(station)?;
        host.log(station.take_log());
    }
    live.leave(station, &mut |lines| host.log(lines))?;
    Ok(live.exchange)
}
