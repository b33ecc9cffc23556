//! VRPN as a client, over TCP only: the poses of one tracker.
//!
//! Both sides send a cookie of 24 bytes first. Then messages follow: a header of 24 bytes (length, time stamp, sender,
//! type, sequence number; all big-endian 32-bit numbers) and a body padded to 8 bytes. The length counts header and body
//! without the padding. Senders and types are numbered by the server; their names come in messages of the types -1 and -2.
//! A pose has the sensor number, four bytes without meaning, the position in m and the quaternion x, y, z, w.

use std::collections::BTreeMap;

use protocol::{Duration, Instant};

use crate::pose::TrackedPose;

pub const PORT: u16 = 3883;

const COOKIE_BYTES: usize = 24;
const HEADER_BYTES: usize = 24;
const COOKIE: &[u8] = b"vrpn: ver. 07.35  0";
/// Only the major version must match.
const COOKIE_MATCHES: &[u8] = b"vrpn: ver. 07.";
const POSE_TYPE: &str = "vrpn_Tracker Pos_Quat";
const POSE_BYTES: usize = 64;
const SENDER_DESCRIPTION: i32 = -1;
const TYPE_DESCRIPTION: i32 = -2;
/// Longest message that is read: image servers send larger ones, trackers do not.
const MAX_MESSAGE_BYTES: usize = 65_536;
const MAX_NAME_BYTES: usize = 256;
/// Most senders, and most types.
const MAX_NAMES: usize = 2048;
/// Largest deviation of a quaternion's norm from 1.
const NORM_TOLERANCE: f64 = 1e-3;

/// The stream cannot be read any further.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VrpnError {
    /// The server does not begin with a cookie of version 7.
    #[error("the server does not speak VRPN 7: it begins with '{0}'")]
    Cookie(String),
    #[error("message of {0} bytes; 24 to {MAX_MESSAGE_BYTES} are read")]
    Length(u32),
    /// The server names more senders or types than are kept.
    #[error("more than {MAX_NAMES} senders or types")]
    TooManyNames,
}

/// What the stream holds.
#[derive(Clone, Debug, PartialEq)]
pub enum VrpnItem {
    Pose(TrackedPose),
    /// A pose with NaN, or with a quaternion that is not of unit length.
    NotAPose {
        /// Number of the body.
        sensor: i32,
    },
}

/// Reads the stream of a server.
#[derive(Clone, Debug)]
pub struct VrpnClient {
    tracker: String,
    buffer: Vec<u8>,
    greeted: bool,
    failed: Option<VrpnError>,
    senders: BTreeMap<i32, String>,
    types: BTreeMap<i32, String>,
}

impl VrpnClient {
    /// For the tracker with this name on the server (`Tracker0` is usual).
    #[must_use]
    pub fn new(tracker: &str) -> Self {
        Self {
            tracker: tracker.to_owned(),
            buffer: Vec::new(),
            greeted: false,
            failed: None,
            senders: BTreeMap::new(),
            types: BTreeMap::new(),
        }
    }

    /// The cookie that a client sends first; it sends nothing else.
    #[must_use]
    pub fn greeting() -> [u8; COOKIE_BYTES] {
        let mut cookie = [0; COOKIE_BYTES];
        for (place, byte) in cookie.iter_mut().zip(COOKIE) {
            *place = *byte;
        }
        cookie
    }

    /// Names of the senders that the server has reported: its trackers and other devices.
    pub fn senders(&self) -> impl Iterator<Item = &str> {
        self.senders.values().map(String::as_str)
    }

    /// Takes bytes as they arrive and returns the items that they complete.
    ///
    /// # Errors
    /// The stream cannot be read any further; every later call gives the same error.
    pub fn push(&mut self, bytes: &[u8]) -> Result<Vec<VrpnItem>, VrpnError> {
        if let Some(error) = &self.failed {
            return Err(error.clone());
        }
        self.buffer.extend_from_slice(bytes);
        let mut items = Vec::new();
        let mut used = 0;
        let outcome = loop {
            match self.next(used, &mut items) {
                Ok(0) => break Ok(()),
                Ok(taken) => used += taken,
                Err(error) => break Err(error),
            }
        };
        self.buffer.drain(..used.min(self.buffer.len()));
        if let Err(error) = outcome {
            self.failed = Some(error);
            self.buffer.clear();
            // Poses before the error are valid; the next call returns the error.
            if items.is_empty() {
                return self.push(&[]);
            }
        }
        Ok(items)
    }

    /// Takes the cookie or one message at `from`; returns its length, or 0 if it is incomplete.
    fn next(&mut self, from: usize, items: &mut Vec<VrpnItem>) -> Result<usize, VrpnError> {
        let rest = self.buffer.get(from..).unwrap_or_default();
        if !self.greeted {
            let known = rest.len().min(COOKIE_MATCHES.len());
            if rest.get(..known) != COOKIE_MATCHES.get(..known) {
                let shown = rest.get(..rest.len().min(COOKIE_BYTES)).unwrap_or_default();
                return Err(VrpnError::Cookie(shown.escape_ascii().to_string()));
            }
            self.greeted = rest.len() >= COOKIE_BYTES;
            return Ok(if self.greeted { COOKIE_BYTES } else { 0 });
        }
        let Some(length) = u32_at(rest, 0) else { return Ok(0) };
        let bytes = length as usize;
        if !(HEADER_BYTES..=MAX_MESSAGE_BYTES).contains(&bytes) {
            return Err(VrpnError::Length(length));
        }
        let padded = bytes.next_multiple_of(8);
        let Some(message) = rest.get(..padded) else { return Ok(0) };
        let number = |at| u32_at(message, at).unwrap_or_default();
        let stamp_us = u64::from(number(4)) * 1_000_000 + u64::from(number(8));
        let (sender, kind) = (number(12).cast_signed(), number(16).cast_signed());
        let body = message.get(HEADER_BYTES..bytes).unwrap_or_default();
        match kind {
            SENDER_DESCRIPTION => keep(&mut self.senders, sender, body)?,
            TYPE_DESCRIPTION => keep(&mut self.types, sender, body)?,
            _ => {
                let ours = self.senders.get(&sender).is_some_and(|name| *name == self.tracker);
                let pose = self.types.get(&kind).is_some_and(|name| name == POSE_TYPE);
                if ours && pose && body.len() >= POSE_BYTES {
                    items.push(pose_of(Instant::from_micros(stamp_us), body));
                }
            }
        }
        Ok(padded)
    }
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn f64_at(bytes: &[u8], at: usize) -> f64 {
    bytes.get(at..).and_then(<[u8]>::first_chunk).map_or(f64::NAN, |chunk| f64::from_be_bytes(*chunk))
}

/// Keeps the name of a sender or type; the body holds its length with the NUL, then the name.
fn keep(names: &mut BTreeMap<i32, String>, id: i32, body: &[u8]) -> Result<(), VrpnError> {
    let length = u32_at(body, 0).unwrap_or_default() as usize;
    let text = body.get(4..).and_then(|text| text.get(..length.min(MAX_NAME_BYTES))).unwrap_or_default();
    let text = text.split(|byte| *byte == 0).next().unwrap_or_default();
    if names.len() == MAX_NAMES && !names.contains_key(&id) {
        return Err(VrpnError::TooManyNames);
    }
    names.insert(id, String::from_utf8_lossy(text).into_owned());
    Ok(())
}

fn pose_of(stamp: Instant, body: &[u8]) -> VrpnItem {
    let sensor = u32_at(body, 0).unwrap_or_default().cast_signed();
    let position_m: [f64; 3] = std::array::from_fn(|i| f64_at(body, 8 + 8 * i));
    let [x, y, z, w]: [f64; 4] = std::array::from_fn(|i| f64_at(body, 32 + 8 * i));
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    let good = position_m.iter().all(|p| p.is_finite()) && (norm - 1.0).abs() <= NORM_TOLERANCE;
    match u32::try_from(sensor) {
        Ok(body) if good => {
            let scale = if w < 0.0 { -1.0 / norm } else { 1.0 / norm };
            let rotation_wxyz = [w, x, y, z].map(|q| q * scale);
            let age = Duration::ZERO;
            VrpnItem::Pose(TrackedPose { stamp, body, position_m, rotation_wxyz, tracked: true, age })
        }
        _ => VrpnItem::NotAPose { sensor },
    }
}
