//! The `--bus` string.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use protocol::text::BusName;
use protocol::text::slcan::Bitrate;
use protocol::text::socketcand::DEFAULT_PORT;

use crate::clock::Clock;

/// Longest name of a Linux network interface (`IFNAMSIZ` without the end mark).
const INTERFACE_NAME_MAX: usize = 15;

/// Which bus to use, as people write it.
///
/// | text | meaning |
/// |---|---|
/// | `sim` | the cell simulated inside the program |
/// | `can0`, `vcan0` | Linux SocketCAN interface |
/// | `socketcand://host:port/bus` | socketcand protocol over TCP; without a host 127.0.0.1, without a port 29536, without a bus `can0` |
/// | `lockstep://host:port/bus` | the same in virtual time, with a simulated cell that was started in lock step; a server accepts `?clients=2`: time stands while fewer are connected |
/// | `slcan:/dev/ttyACM0` | SLCAN adapter at a serial device |
/// | `slcan://host:port` | SLCAN over TCP |
/// | `rsi:udp://host:port`, `rsi:tcp://host:port` | not a CAN bus: an industrial robot that connects to that address of this machine (KUKA RSI) |
///
/// RSI accepts `?lockstep`: the time is the robot's cycle count, with a simulated robot that was started in lock step.
/// SLCAN accepts `?bitrate=500000` (bit rate of the bus, default 1 Mbit/s) and, at a device, `?baud=115200` (speed
/// of a real serial line; USB adapters ignore it), joined with `&`.
///
/// Printing a spec gives a text that parses to the same spec.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum BusSpec {
    /// The simulated cell, embedded.
    #[default]
    Sim,
    /// A SocketCAN interface by name.
    SocketCan {
        /// `can0`
        interface: String,
    },
    /// A bus of a socketcand server.
    Socketcand {
        /// Name or address; IPv6 without brackets.
        host: String,
        /// TCP port; 0 only makes sense for a server, which then takes any free one.
        port: u16,
        /// Name of the bus at the server; a [`BusName`].
        bus: String,
    },
    /// A bus of a socketcand server in virtual time that all programs share: `hil-sim serve` or `cubectl sim`. The
    /// load of the machine changes nothing in the result.
    Lockstep {
        /// Name or address; IPv6 without brackets.
        host: String,
        /// As of [`Self::Socketcand`].
        port: u16,
        /// As of [`Self::Socketcand`].
        bus: String,
        /// For a server: time stands while fewer clients are connected.
        clients: usize,
    },
    Slcan {
        port: SlcanPort,
        /// Bit rate of the bus.
        bitrate: Bitrate,
    },
    /// An industrial robot behind its sensor interface. It connects to this machine; no CAN frames pass.
    Rsi(RsiSpec),
}

/// Where an industrial robot connects to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RsiSpec {
    /// A stream (KR C2 only) instead of datagrams.
    pub tcp: bool,
    /// Address of this machine on which to listen; IPv6 without brackets.
    pub host: String,
    pub port: u16,
    /// The time is the robot's cycle count: the robot is a simulated one that waits for each answer.
    pub lockstep: bool,
}

impl FromStr for RsiSpec {
    type Err = String;

    /// `udp://host:port` or `tcp://host:port`, with `?lockstep` behind it or not.
    fn from_str(text: &str) -> Result<Self, String> {
        let (place, query) = text.split_once('?').unwrap_or((text, ""));
        let (tcp, authority) = match place.split_once("://") {
            Some(("udp", authority)) => (false, authority),
            Some(("tcp", authority)) => (true, authority),
            _ => return Err(format!("'{place}' is neither udp://host:port nor tcp://host:port")),
        };
        let lockstep = match query {
            "" => false,
            "lockstep" => true,
            _ => return Err(format!("'{query}' is no option of RSI (lockstep)")),
        };
        let (host, port) = parse_host_port(authority)?;
        Ok(Self { tcp, host, port: port.ok_or("the port is missing")?, lockstep })
    }
}

impl fmt::Display for RsiSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let protocol = if self.tcp { "tcp" } else { "udp" };
        write!(f, "{protocol}://{}", host_port(&self.host, self.port))?;
        if self.lockstep { f.write_str("?lockstep") } else { Ok(()) }
    }
}

/// Where an SLCAN adapter is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SlcanPort {
    /// A serial device.
    Device {
        /// `/dev/ttyACM0`
        path: PathBuf,
        /// Speed of the line in bit/s; `None` leaves it as it is.
        baud: Option<u32>,
    },
    Tcp {
        /// Name or address; IPv6 without brackets.
        host: String,
        port: u16,
    },
}

/// Why a text is no [`BusSpec`]: what, and how to write it instead.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("--bus {text}: {problem}")]
pub struct SpecError {
    /// The text as given.
    pub text: String,
    /// What is wrong with it.
    pub problem: String,
    /// A text of the same kind that would be right.
    pub example: &'static str,
}

/// The kinds of CAN buses, for help texts.
pub const LIVE_BUSES: &str = "can0, socketcand://host:port/bus, slcan:/dev/ttyACM0 or slcan://host:port";

const ANY: &str =
    "sim, can0, socketcand://127.0.0.1:29536/can0, slcan:/dev/ttyACM0 or slcan://127.0.0.1:3333";
const SOCKETCAND: &str = "socketcand://127.0.0.1:29536/can0";
const LOCKSTEP: &str = "lockstep://127.0.0.1:29536/can0?clients=2";
const RSI: &str = "rsi:udp://127.0.0.1:49152";
const SLCAN_TCP: &str = "slcan://127.0.0.1:3333";
const SLCAN_DEVICE: &str = "slcan:/dev/ttyACM0";
const SLCAN_OPTIONS: &str = "slcan:/dev/ttyUSB0?bitrate=1000000&baud=115200";

impl SpecError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(format!("write {}", self.example))
    }
}

/// A bus of a command line: the error is printed with its next step.
///
/// # Errors
/// The text is not a [`BusSpec`].
pub fn bus_of_option(text: &str) -> Result<BusSpec, String> {
    text.parse().map_err(|error: SpecError| format!("{error}\n  next: write {}", error.example))
}

impl FromStr for BusSpec {
    type Err = SpecError;

    fn from_str(text: &str) -> Result<Self, SpecError> {
        let fail = |example, problem: String| SpecError { text: text.to_owned(), problem, example };
        match text.split_once(':') {
            None => interface(text).map_err(|problem| fail(ANY, problem)),
            Some(("socketcand", rest)) => {
                let rest = rest.strip_prefix("//").ok_or_else(|| {
                    fail(SOCKETCAND, "two slashes are missing after 'socketcand:'".to_owned())
                })?;
                socketcand(rest).map_err(|problem| fail(SOCKETCAND, problem))
            }
            Some(("lockstep", rest)) => {
                let rest = rest
                    .strip_prefix("//")
                    .ok_or_else(|| fail(LOCKSTEP, "two slashes are missing after 'lockstep:'".to_owned()))?;
                lockstep(rest).map_err(|problem| fail(LOCKSTEP, problem))
            }
            Some(("slcan", rest)) => {
                let (place, query) = rest.split_once('?').unwrap_or((rest, ""));
                let options = slcan_options(query).map_err(|problem| fail(SLCAN_OPTIONS, problem))?;
                if let Some(authority) = place.strip_prefix("//") {
                    if options.baud.is_some() {
                        return Err(fail(SLCAN_TCP, "a TCP connection has no baud rate".to_owned()));
                    }
                    let (host, port) =
                        parse_host_port(authority).map_err(|problem| fail(SLCAN_TCP, problem))?;
                    let port = port.ok_or_else(|| fail(SLCAN_TCP, "the port is missing".to_owned()))?;
                    Ok(Self::Slcan { port: SlcanPort::Tcp { host, port }, bitrate: options.bitrate })
                } else if place.is_empty() {
                    Err(fail(SLCAN_DEVICE, "the device is missing after 'slcan:'".to_owned()))
                } else {
                    let port = SlcanPort::Device { path: place.into(), baud: options.baud };
                    Ok(Self::Slcan { port, bitrate: options.bitrate })
                }
            }
            Some(("rsi", rest)) => rest.parse().map(Self::Rsi).map_err(|problem| fail(RSI, problem)),
            Some((scheme, _)) => Err(fail(ANY, format!("'{scheme}:' is no kind of bus this program knows"))),
        }
    }
}

fn interface(name: &str) -> Result<BusSpec, String> {
    match name {
        "" => return Err("the name is empty".to_owned()),
        "sim" => return Ok(BusSpec::Sim),
        "socketcand" | "slcan" | "rsi" => return Err(format!("'{name}' needs to know where")),
        _ => {}
    }
    if name.len() > INTERFACE_NAME_MAX {
        return Err(format!(
            "an interface name has at most {INTERFACE_NAME_MAX} characters, this has {}",
            name.len()
        ));
    }
    if let Some(found) = name.chars().find(|found| *found == '/' || !found.is_ascii_graphic()) {
        return Err(format!("an interface name cannot contain {found:?}"));
    }
    Ok(BusSpec::SocketCan { interface: name.to_owned() })
}

/// `host:port/bus`, every part optional.
fn socketcand(rest: &str) -> Result<BusSpec, String> {
    let (authority, bus) = rest.split_once('/').unwrap_or((rest, ""));
    let (host, port) = parse_host_port(authority)?;
    let bus = if bus.is_empty() { "can0" } else { bus };
    let bus = BusName::new(bus).map_err(|error| error.to_string())?;
    Ok(BusSpec::Socketcand { host, port: port.unwrap_or(DEFAULT_PORT), bus: bus.as_str().to_owned() })
}

/// As `socketcand`, with `?clients=2`.
fn lockstep(rest: &str) -> Result<BusSpec, String> {
    let (place, query) = rest.split_once('?').unwrap_or((rest, "clients=1"));
    let clients = query
        .strip_prefix("clients=")
        .and_then(|number| number.parse().ok())
        .filter(|clients| (1..=32).contains(clients))
        .ok_or_else(|| format!("'{query}' is no option of lock step (clients, from 1 to 32)"))?;
    match socketcand(place)? {
        BusSpec::Socketcand { host, port, bus } => Ok(BusSpec::Lockstep { host, port, bus, clients }),
        other => Ok(other),
    }
}

/// `host`, `host:port`, `[::1]:port`; an empty host is 127.0.0.1.
fn parse_host_port(authority: &str) -> Result<(String, Option<u16>), String> {
    let (host, port) = if let Some(rest) = authority.strip_prefix('[') {
        let (host, rest) =
            rest.split_once(']').ok_or_else(|| "the bracket of the address is not closed".to_owned())?;
        match rest.strip_prefix(':') {
            Some(port) => (host, Some(port)),
            None if rest.is_empty() => (host, None),
            None => return Err(format!("'{rest}' after the address is no port")),
        }
    } else {
        match authority.split_once(':') {
            Some((_, port)) if port.contains(':') => {
                return Err("an IPv6 address needs brackets, as in [::1]:29536".to_owned());
            }
            Some((host, port)) => (host, Some(port)),
            None => (authority, None),
        }
    };
    if let Some(found) = host.chars().find(|found| !found.is_ascii_graphic()) {
        return Err(format!("a host name cannot contain {found:?}"));
    }
    let port = match port {
        None => None,
        Some(port) => {
            Some(port.parse().map_err(|_| format!("'{port}' is no TCP port (a number from 1 to 65535)"))?)
        }
    };
    let host = if host.is_empty() { "127.0.0.1" } else { host };
    Ok((host.to_owned(), port))
}

struct SlcanOptions {
    bitrate: Bitrate,
    baud: Option<u32>,
}

fn slcan_options(query: &str) -> Result<SlcanOptions, String> {
    let mut options = SlcanOptions { bitrate: Bitrate::M1, baud: None };
    for option in query.split('&').filter(|option| !option.is_empty()) {
        let (key, value) = option.split_once('=').ok_or_else(|| format!("'{option}' has no value"))?;
        let number: u32 = value.parse().map_err(|_| format!("{key}: '{value}' is no number"))?;
        match key {
            "bitrate" => {
                options.bitrate = Bitrate::from_bits_per_second(number).ok_or_else(|| {
                    let known = Bitrate::ALL.map(Bitrate::bits_per_second);
                    format!("SLCAN has no code for {number} bit/s (only {known:?})")
                })?;
            }
            "baud" if number > 0 => options.baud = Some(number),
            "baud" => return Err("a baud rate is above zero".to_owned()),
            _ => return Err(format!("'{key}' is no option of SLCAN (bitrate, baud)")),
        }
    }
    Ok(options)
}

impl BusSpec {
    /// The clock for programs on this bus: one that the bus moves, or the monotonic one, started now.
    pub fn clock(&self) -> Clock {
        if matches!(self, Self::Lockstep { .. }) { Clock::manual() } else { Clock::start() }
    }

    /// The host of the server that has the CAN interface; `None` of a bus without a server.
    pub fn server(&self) -> Option<&str> {
        match self {
            Self::Socketcand { host, .. } | Self::Lockstep { host, .. } => Some(host),
            Self::Sim | Self::SocketCan { .. } | Self::Slcan { .. } | Self::Rsi(_) => None,
        }
    }
}

/// `host:port`, with brackets around an IPv6 address.
pub(crate) fn host_port(host: &str, port: u16) -> String {
    if host.contains(':') { format!("[{host}]:{port}") } else { format!("{host}:{port}") }
}

impl fmt::Display for BusSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rsi(spec) => write!(f, "rsi:{spec}"),
            Self::Sim => f.write_str("sim"),
            Self::SocketCan { interface } => f.write_str(interface),
            Self::Socketcand { host, port, bus } => {
                write!(f, "socketcand://{}/{bus}", host_port(host, *port))
            }
            Self::Lockstep { host, port, bus, clients } => {
                write!(f, "lockstep://{}/{bus}", host_port(host, *port))?;
                if *clients > 1 { write!(f, "?clients={clients}") } else { Ok(()) }
            }
            Self::Slcan { port: SlcanPort::Tcp { host, port }, bitrate } => {
                write!(f, "slcan://{}?bitrate={}", host_port(host, *port), bitrate.bits_per_second())
            }
            Self::Slcan { port: SlcanPort::Device { path, baud }, bitrate } => {
                write!(f, "slcan:{}?bitrate={}", path.display(), bitrate.bits_per_second())?;
                baud.map_or(Ok(()), |baud| write!(f, "&baud={baud}"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn socketcand(host: &str, port: u16, bus: &str) -> BusSpec {
        BusSpec::Socketcand { host: host.into(), port, bus: bus.into() }
    }

    fn lockstep(host: &str, port: u16, bus: &str, clients: usize) -> BusSpec {
        BusSpec::Lockstep { host: host.into(), port, bus: bus.into(), clients }
    }

    fn rsi(tcp: bool, port: u16, lockstep: bool) -> BusSpec {
        BusSpec::Rsi(RsiSpec { tcp, host: "127.0.0.1".into(), port, lockstep })
    }

    fn device(path: &str, bitrate: Bitrate, baud: Option<u32>) -> BusSpec {
        BusSpec::Slcan { port: SlcanPort::Device { path: path.into(), baud }, bitrate }
    }

    fn tcp(host: &str, port: u16, bitrate: Bitrate) -> BusSpec {
        BusSpec::Slcan { port: SlcanPort::Tcp { host: host.into(), port }, bitrate }
    }

    #[test]
    fn each_form_has_its_meaning_and_prints_to_itself() {
        for (text, spec) in [
            ("sim", BusSpec::Sim),
            ("can0", BusSpec::SocketCan { interface: "can0".into() }),
            ("vcan0", BusSpec::SocketCan { interface: "vcan0".into() }),
            ("slcan0", BusSpec::SocketCan { interface: "slcan0".into() }),
            ("socketcand://lab:1234/can1", socketcand("lab", 1234, "can1")),
            ("socketcand://lab", socketcand("lab", 29_536, "can0")),
            ("socketcand://:29999", socketcand("127.0.0.1", 29_999, "can0")),
            ("socketcand:///vcan3", socketcand("127.0.0.1", 29_536, "vcan3")),
            ("socketcand://[::1]:29536/can0", socketcand("::1", 29_536, "can0")),
            ("socketcand://[::1]/can0", socketcand("::1", 29_536, "can0")),
            ("lockstep://lab:1234/can1", lockstep("lab", 1234, "can1", 1)),
            ("lockstep:///can0?clients=2", lockstep("127.0.0.1", 29_536, "can0", 2)),
            ("rsi:udp://127.0.0.1:49152", rsi(false, 49_152, false)),
            ("rsi:tcp://:6008", rsi(true, 6_008, false)),
            ("rsi:udp://127.0.0.1:0?lockstep", rsi(false, 0, true)),
            ("slcan:/dev/ttyACM0", device("/dev/ttyACM0", Bitrate::M1, None)),
            (
                "slcan:/dev/ttyUSB0?baud=115200&bitrate=500000",
                device("/dev/ttyUSB0", Bitrate::K500, Some(115_200)),
            ),
            ("slcan://127.0.0.1:3333", tcp("127.0.0.1", 3333, Bitrate::M1)),
            ("slcan://lab:3333?bitrate=125000", tcp("lab", 3333, Bitrate::K125)),
        ] {
            assert_eq!(text.parse(), Ok(spec.clone()), "{text}");
            assert_eq!(spec.to_string().parse(), Ok(spec), "{text}");
        }
    }

    #[test]
    fn every_refusal_names_the_problem_and_a_right_form() {
        for (text, problem) in [
            ("", "the name is empty"),
            ("slcan", "needs to know where"),
            ("an_interface_name_too_long", "at most 15 characters, this has 26"),
            ("can 0", "cannot contain ' '"),
            ("/dev/ttyACM0", "cannot contain '/'"),
            ("tcp://lab:1", "'tcp:' is no kind of bus"),
            ("lab:29536", "'lab:' is no kind of bus"),
            ("socketcand:lab", "two slashes are missing"),
            ("socketcand://lab:port/can0", "'port' is no TCP port"),
            ("socketcand://lab:70000/can0", "'70000' is no TCP port"),
            ("socketcand://lab:1/a/b", "character 2 of the bus name is '/'"),
            ("socketcand://::1:29536/can0", "an IPv6 address needs brackets"),
            ("socketcand://[::1/can0", "not closed"),
            ("socketcand://[::1]x/can0", "'x' after the address"),
            ("lockstep:lab", "two slashes are missing"),
            ("lockstep://lab/can0?clients=0", "'clients=0' is no option"),
            ("lockstep://lab/can0?wait=2", "'wait=2' is no option"),
            ("rsi", "needs to know where"),
            ("rsi:49152", "neither udp://host:port nor tcp://host:port"),
            ("rsi:udp://127.0.0.1", "the port is missing"),
            ("rsi:udp://127.0.0.1:1?fast", "'fast' is no option"),
            ("slcan:", "the device is missing"),
            ("slcan://lab", "the port is missing"),
            ("slcan://lab:3333?baud=9600", "a TCP connection has no baud rate"),
            ("slcan:/dev/ttyACM0?bitrate=123", "SLCAN has no code for 123 bit/s"),
            ("slcan:/dev/ttyACM0?baud=fast", "'fast' is no number"),
            ("slcan:/dev/ttyACM0?baud=0", "above zero"),
            ("slcan:/dev/ttyACM0?speed=1", "'speed' is no option"),
            ("slcan:/dev/ttyACM0?baud", "'baud' has no value"),
        ] {
            let error = text.parse::<BusSpec>().unwrap_err();
            assert!(error.problem.contains(problem), "{text}: {error}");
            assert!(
                error.example.split(" or ").last().unwrap().parse::<BusSpec>().is_ok(),
                "{text}: {error}"
            );
            assert!(error.to_string().starts_with(&format!("--bus {text}: ")), "{error}");
        }
    }
}
