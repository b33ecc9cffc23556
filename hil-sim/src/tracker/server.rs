//! [`Tracker`]: measurement, outputs and command channel.

use std::collections::VecDeque;
use std::net::{IpAddr, SocketAddr};

use protocol::{Duration, Instant};
use tracker_protocol::dtrack::{Answer, Command, DataFrame, Messages, Output, UnixStamp};

use super::options::{TrackerFaultKind, TrackerOptions};
use super::scene::Scene;
use crate::rng::Rng;

/// Most command connections; further ones are closed at once.
pub const MAX_CONNECTIONS: usize = 8;
/// Most messages for `getmsg`; older ones are dropped.
const MAX_MESSAGES: usize = 64;
/// Most bytes of answers that wait for a client that does not read.
const MAX_WAITING: usize = 1024;
const CHANNELS: usize = 5;
const DAY_US: u64 = 86_400_000_000;

/// A command connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Connection(u64);

#[derive(Clone, Debug)]
struct Client {
    connection: Connection,
    ip: IpAddr,
    full_access: bool,
    messages: Messages,
}

#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    to: Option<SocketAddr>,
    active: bool,
}

#[derive(Clone, Debug)]
pub struct Tracker {
    options: TrackerOptions,
    scene: Scene,
    jitter: Rng,
    frame: u64,
    next_flash: Option<Instant>,
    restarts: Vec<Instant>,
    channels: [Channel; CHANNELS],
    clients: Vec<Client>,
    next_connection: u64,
    active_configuration: usize,
    messages: VecDeque<Answer>,
    answers: VecDeque<(Connection, Vec<u8>)>,
    under_way: Vec<(Instant, u64, SocketAddr, Vec<u8>)>,
    number: u64,
}

impl Tracker {
    /// At time zero, measuring only if the options require it.
    pub fn new(options: TrackerOptions, seed: u64) -> Self {
        let restart = |fault: &super::options::TrackerFault| {
            (fault.kind == TrackerFaultKind::Restart).then_some(fault.from)
        };
        let mut restarts: Vec<Instant> = options.faults.iter().filter_map(restart).collect();
        restarts.sort_by_key(|at| std::cmp::Reverse(*at));
        Self {
            scene: Scene::new(&options, seed),
            jitter: Rng::stream(seed, "tracker jitter"),
            frame: options.first_frame,
            next_flash: options.running.then_some(Instant::ZERO),
            restarts,
            channels: [Channel::default(); CHANNELS],
            clients: Vec::new(),
            next_connection: 0,
            active_configuration: 0,
            messages: VecDeque::new(),
            answers: VecDeque::new(),
            under_way: Vec::new(),
            number: 0,
            options,
        }
    }

    /// Sends the data of a channel (1 to 5) to an address, as its set-up dialog would.
    pub fn set_output(&mut self, channel: u8, to: Option<SocketAddr>) {
        if let Some(slot) = usize::from(channel).checked_sub(1).and_then(|at| self.channels.get_mut(at)) {
            *slot = Channel { to, active: to.is_some() };
        }
    }

    /// True position (mm) and rotation of a body.
    pub fn truth(&self, body: u32, at: Instant) -> Option<([f64; 3], [f64; 4])> {
        self.scene.truth(body, at)
    }

    /// Single markers that the next flash shows, mm in the room.
    pub fn place_markers(&mut self, at_mm: &[[f64; 3]]) {
        self.scene.place_markers(at_mm);
    }

    /// Time of the next flash; `None` while the measurement does not run.
    pub fn next_flash(&self) -> Option<Instant> {
        self.next_flash
    }

    /// Whether the measurement runs.
    pub fn is_measuring(&self) -> bool {
        self.next_flash.is_some()
    }

    /// A client connected to the command port; `None` if there are too many.
    pub fn connect(&mut self, ip: IpAddr) -> Option<Connection> {
        if self.clients.len() == MAX_CONNECTIONS {
            return None;
        }
        self.next_connection += 1;
        let connection = Connection(self.next_connection);
        let full_access = !self.clients.iter().any(|client| client.full_access);
        self.clients.push(Client { connection, ip, full_access, messages: Messages::default() });
        Some(connection)
    }

    /// A client left.
    pub fn disconnect(&mut self, connection: Connection) {
        self.clients.retain(|client| client.connection != connection);
        self.answers.retain(|(other, _)| *other != connection);
    }

    pub fn handle_command(&mut self, now: Instant, connection: Connection, bytes: &[u8]) {
        let Some(client) = self.clients.iter_mut().find(|client| client.connection == connection) else {
            return;
        };
        let (messages, full, ip) = (client.messages.push(bytes), client.full_access, client.ip);
        for message in messages {
            let answer = match message.as_deref().map(Command::parse) {
                None => refuse(2, "message too long or not ASCII"),
                Some(None) => refuse(1, "unknown command"),
                Some(Some(command)) => self.command(now, &command, full, ip),
            };
            if self.answers.len() < MAX_WAITING {
                self.answers.push_back((connection, Messages::frame(&answer)));
            }
        }
    }

    fn command(&mut self, now: Instant, command: &Command, full: bool, ip: IpAddr) -> Answer {
        match command {
            Command::GetAccess => {
                return Answer::Set(format!("system access {}", if full { "full" } else { "none" }));
            }
            Command::GetStatus => {
                let status = if self.is_measuring() { "mea" } else { "none" };
                return Answer::Set(format!("status active {status}"));
            }
            _ if !full => return refuse(3, "no access: another client is connected"),
            _ => {}
        }
        match command {
            Command::TrackingStart if self.is_measuring() => refuse(4, "measurement is running"),
            Command::TrackingStart => {
                // The first flash comes with the next one of the synchronisation, at most one period later.
                self.next_flash = Some(now + self.options.period);
                Answer::Ok
            }
            Command::TrackingStop => {
                self.next_flash = None;
                Answer::Ok
            }
            Command::GetMessage => self.messages.pop_front().unwrap_or(Answer::Ok),
            Command::SetOutput { channel, to } => {
                let to = match to {
                    Output::None => None,
                    Output::Udp { host, port } if host == "my_ip" => Some(SocketAddr::new(ip, *port)),
                    Output::Udp { host, port } => match host.parse() {
                        Ok(ip) => Some(SocketAddr::new(ip, *port)),
                        Err(_) => return refuse(5, "not an address"),
                    },
                };
                let slot = usize::from(*channel).checked_sub(1).and_then(|at| self.channels.get_mut(at));
                slot.map_or_else(
                    || refuse(5, "no such channel"),
                    |slot| {
                        slot.to = to;
                        Answer::Ok
                    },
                )
            }
            Command::SetOutputActive { channel, kind, on } => {
                let slot = usize::from(*channel).checked_sub(1).and_then(|at| self.channels.get_mut(at));
                match slot.filter(|_| kind == "all") {
                    Some(slot) => {
                        slot.active = *on;
                        Answer::Ok
                    }
                    None => refuse(5, "only 'all' can be switched"),
                }
            }
            Command::GetConfig => {
                let name = self.options.configurations.get(self.active_configuration);
                Answer::Set(format!("config active_config {}", name.map_or("none", String::as_str)))
            }
            Command::SetConfig(id) => match self.options.configurations.iter().position(|name| name == id) {
                Some(place) => {
                    self.active_configuration = place;
                    Answer::Ok
                }
                None => refuse(6, "no such configuration"),
            },
            Command::Other(_) | Command::GetAccess | Command::GetStatus => refuse(1, "unknown command"),
        }
    }

    pub fn poll_answer(&mut self) -> Option<(Connection, Vec<u8>)> {
        self.answers.pop_front()
    }

    /// The next deadline: a flash, or a datagram that leaves.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let datagram = self.under_way.iter().map(|(due, ..)| *due).min();
        datagram.into_iter().chain(self.next_flash).min()
    }

    /// Flashes that are due, up to `now`; at most one per call and deadline.
    pub fn handle_timeout(&mut self, now: Instant) {
        let Some(at) = self.next_flash.filter(|at| *at <= now) else { return };
        self.next_flash = Some(at + self.options.period);
        while self.restarts.pop_if(|restart| *restart <= at).is_some() {
            self.frame = self.options.first_frame;
            self.report("warning", "controller started again");
        }
        let seen = self.scene.flash(at);
        let jitter = self.jitter.within(0, self.options.jitter.as_micros());
        let latency = self.options.latency + Duration::from_micros(jitter + seen.late_us);
        let unix_us = self.options.unix_us + at.as_micros();
        let data = DataFrame {
            frame: self.frame,
            ts_s: self.options.send_ts.then_some((unix_us % DAY_US) as f64 * 1e-6),
            ts2: self.options.send_ts2.then(|| UnixStamp {
                s: unix_us / 1_000_000,
                us: (unix_us % 1_000_000) as u32,
                latency_us: latency.as_micros(),
            }),
            calibrated: Some(u32::try_from(self.options.bodies.len()).unwrap_or(u32::MAX)),
            bodies: Some(seen.bodies),
            hybrids: None,
            markers: self.options.send_markers.then_some(seen.markers),
            skipped_lines: 0,
        };
        let sent = self.frame.is_multiple_of(self.options.divisor.max(1)) && !seen.lost;
        self.frame += 1;
        if !sent {
            return;
        }
        let bytes = data.write();
        for to in self.channels.iter().filter(|channel| channel.active).filter_map(|channel| channel.to) {
            self.number += 1;
            self.under_way.push((at + latency, self.number, to, bytes.clone()));
        }
    }

    /// A datagram that has left by `now`.
    pub fn poll_data(&mut self, now: Instant) -> Option<(SocketAddr, Vec<u8>)> {
        let next = self.under_way.iter().enumerate().min_by_key(|(_, (due, number, ..))| (*due, *number));
        let place = next.filter(|(_, (due, ..))| *due <= now).map(|(place, _)| place)?;
        let (_, _, to, bytes) = self.under_way.swap_remove(place);
        Some((to, bytes))
    }

    fn report(&mut self, status: &str, text: &str) {
        if self.messages.len() == MAX_MESSAGES {
            self.messages.pop_front();
        }
        self.messages.push_back(Answer::Message {
            origin: "system".to_owned(),
            status: status.to_owned(),
            frame: self.frame,
            id: 1,
            text: text.to_owned(),
        });
    }
}

fn refuse(code: i32, text: &str) -> Answer {
    Answer::Err { code, text: text.to_owned() }
}
