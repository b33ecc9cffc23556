//! The command channel: ASCII messages over TCP, each ended by one NUL, one answer per command.

use std::fmt;

/// Longest message, in bytes.
pub const MAX_MESSAGE_BYTES: usize = 200;

/// Where the data of a channel go.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    /// UDP to a host name or address; `my_ip` is the address of the command connection.
    Udp {
        host: String,
        port: u16,
    },
    None,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    TrackingStart,
    /// End of the measurement.
    TrackingStop,
    /// Requests the access of this connection: `full` or `none`.
    GetAccess,
    /// Requests the next message.
    GetMessage,
    /// Requests the status of the tracker: `none`, `mea`, `cal`, `wait` or `err`.
    GetStatus,
    /// Sets where a channel (1 to 5) sends to.
    SetOutput {
        channel: u8,
        to: Output,
    },
    /// Switches a kind of data of a channel on or off; `all` is every kind.
    SetOutputActive {
        channel: u8,
        kind: String,
        on: bool,
    },
    /// Requests the active configuration.
    GetConfig,
    SetConfig(String),
    /// Anything else, without `dtrack2`.
    Other(String),
}

impl Command {
    /// Reads a message without its NUL; `None` if it does not begin with `dtrack2`.
    #[must_use]
    pub fn parse(message: &str) -> Option<Self> {
        let rest = message.strip_prefix("dtrack2 ")?;
        let other = || Self::Other(rest.to_owned());
        let words: Vec<&str> = rest.split(' ').collect();
        Some(match words.as_slice() {
            ["tracking", "start"] => Self::TrackingStart,
            ["tracking", "stop"] => Self::TrackingStop,
            ["get", "system", "access"] => Self::GetAccess,
            ["getmsg"] => Self::GetMessage,
            ["get", "status", "active"] => Self::GetStatus,
            ["get", "config", "active_config"] => Self::GetConfig,
            ["set", "config", "active_config", id] if !id.is_empty() => Self::SetConfig((*id).to_owned()),
            ["set", "output", "net", channel, "none"] => channel_of(channel)
                .map_or_else(other, |channel| Self::SetOutput { channel, to: Output::None }),
            ["set", "output", "net", channel, "udp", host, port] if !host.is_empty() => {
                let port = port.parse().ok().filter(|port| *port > 0);
                match (channel_of(channel), port) {
                    (Some(channel), Some(port)) => {
                        Self::SetOutput { channel, to: Output::Udp { host: (*host).to_owned(), port } }
                    }
                    _ => other(),
                }
            }
            ["set", "output", "active", channel, kind, on @ ("yes" | "no")] if !kind.is_empty() => {
                channel_of(channel).map_or_else(other, |channel| Self::SetOutputActive {
                    channel,
                    kind: (*kind).to_owned(),
                    on: *on == "yes",
                })
            }
            _ => other(),
        })
    }
}

fn channel_of(word: &str) -> Option<u8> {
    match word {
        "ch01" => Some(1),
        "ch02" => Some(2),
        "ch03" => Some(3),
        "ch04" => Some(4),
        "ch05" => Some(5),
        _ => None,
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("dtrack2 ")?;
        match self {
            Self::TrackingStart => f.write_str("tracking start"),
            Self::TrackingStop => f.write_str("tracking stop"),
            Self::GetAccess => f.write_str("get system access"),
            Self::GetMessage => f.write_str("getmsg"),
            Self::GetStatus => f.write_str("get status active"),
            Self::SetOutput { channel, to: Output::None } => write!(f, "set output net ch{channel:02} none"),
            Self::SetOutput { channel, to: Output::Udp { host, port } } => {
                write!(f, "set output net ch{channel:02} udp {host} {port}")
            }
            Self::SetOutputActive { channel, kind, on } => {
                write!(f, "set output active ch{channel:02} {kind} {}", if *on { "yes" } else { "no" })
            }
            Self::GetConfig => f.write_str("get config active_config"),
            Self::SetConfig(id) => write!(f, "set config active_config {id}"),
            Self::Other(rest) => f.write_str(rest),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Done; to `getmsg`: no message waits.
    Ok,
    Err {
        /// Number of the reason.
        code: i32,
        text: String,
    },
    /// Parameter and value, as asked for.
    Set(String),
    Message {
        /// Part of the tracker it comes from.
        origin: String,
        /// `error`, `warning`, `info` and the like.
        status: String,
        frame: u64,
        /// Number of the message.
        id: u32,
        text: String,
    },
}

impl Answer {
    /// Reads an answer without its NUL; `None` if it is not an answer.
    #[must_use]
    pub fn parse(message: &str) -> Option<Self> {
        let rest = message.strip_prefix("dtrack2 ")?;
        if rest == "ok" {
            return Some(Self::Ok);
        }
        if let Some(rest) = rest.strip_prefix("err ") {
            let (code, text) = rest.split_once(' ')?;
            return Some(Self::Err { code: code.parse().ok()?, text: quoted(text)?.to_owned() });
        }
        if let Some(rest) = rest.strip_prefix("set ") {
            return rest.contains(' ').then(|| Self::Set(rest.to_owned()));
        }
        let mut words = rest.strip_prefix("msg ")?.splitn(5, ' ');
        let (origin, status) = (words.next()?, words.next()?);
        let (frame, id) = (words.next()?.parse().ok()?, parse_id(words.next()?)?);
        let text = quoted(words.next()?)?.to_owned();
        Some(Self::Message { origin: origin.to_owned(), status: status.to_owned(), frame, id, text })
    }

    #[must_use]
    pub fn value_of(&self, parameter: &str) -> Option<&str> {
        match self {
            Self::Set(text) => text.strip_prefix(parameter)?.strip_prefix(' '),
            _ => None,
        }
    }
}

/// Decimal, or hexadecimal after `0x`.
fn parse_id(word: &str) -> Option<u32> {
    match word.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16).ok(),
        None => word.parse().ok(),
    }
}

fn quoted(text: &str) -> Option<&str> {
    text.strip_prefix('"')?.strip_suffix('"')
}

impl fmt::Display for Answer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("dtrack2 ")?;
        match self {
            Self::Ok => f.write_str("ok"),
            Self::Err { code, text } => write!(f, "err {code} \"{text}\""),
            Self::Set(text) => write!(f, "set {text}"),
            Self::Message { origin, status, frame, id, text } => {
                write!(f, "msg {origin} {status} {frame} {id} \"{text}\"")
            }
        }
    }
}

/// Cuts the byte stream of the channel into messages.
#[derive(Clone, Debug, Default)]
pub struct Messages {
    pending: Vec<u8>,
    too_long: bool,
}

impl Messages {
    /// Takes bytes as they arrive; returns each whole message, or `None` for one that is too long or not ASCII.
    pub fn push(&mut self, bytes: &[u8]) -> Vec<Option<String>> {
        let mut messages = Vec::new();
        for &byte in bytes {
            if byte != 0 {
                if self.pending.len() < MAX_MESSAGE_BYTES {
                    self.pending.push(byte);
                } else {
                    self.too_long = true;
                }
                continue;
            }
            let whole = std::mem::take(&mut self.pending);
            let too_long = std::mem::take(&mut self.too_long);
            let text = String::from_utf8(whole).ok();
            messages.push(text.filter(|text| !too_long && text.bytes().all(|b| (b' '..=b'~').contains(&b))));
        }
        messages
    }

    /// A message with its NUL.
    #[must_use]
    pub fn frame(message: &impl fmt::Display) -> Vec<u8> {
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        bytes
    }
}
