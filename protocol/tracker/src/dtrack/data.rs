//! The datagram: lines of text, one kind of data per line.

use std::fmt::Write as _;

use protocol::{Duration, Instant};

use super::clock::DayClock;
use crate::pose::{NotARotation, TrackedPose, quaternion_of_columns};

/// Longest datagram that is read, in bytes.
pub const MAX_DATAGRAM_BYTES: usize = 32_768;
/// Longest number that is read, in characters.
const MAX_NUMBER_CHARS: usize = 32;
/// Largest magnitude of a number that is read.
const MAX_NUMBER: f64 = 1e12;

/// `ts2`: Unix time of the flash, and the latency so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnixStamp {
    /// Seconds since 1970.
    pub s: u64,
    /// Microseconds in the second.
    pub us: u32,
    /// From the flash to the sending of the data, microseconds.
    pub latency_us: u64,
}

/// A body with a unique arrangement of markers (`6d`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Number, from 0.
    pub id: u32,
    /// 1.0 if tracked; carries no further meaning.
    pub quality: f64,
    /// Origin of the body in the room, mm.
    pub position_mm: [f64; 3],
    /// Angles with `R = Rx(rx) Ry(ry) Rz(rz)`, degrees; newer controllers may leave them out.
    pub angles_deg: Option<[f64; 3]>,
    /// Rotation matrix body to room, column by column.
    pub rotation: [f64; 9],
}

/// A single marker (`3d`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Marker {
    /// Number, from 1; a new one after every loss.
    pub id: u32,
    /// 1.0.
    pub quality: f64,
    pub position_mm: [f64; 3],
}

/// What a hybrid body's pose rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HybridState {
    /// Nothing: position and rotation are not valid.
    Lost,
    Inertial,
    /// Cameras only.
    Optical,
    Both,
}

/// A body with cameras and an inertial sensor (`6di`); lost ones are listed too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hybrid {
    /// Number, from 0.
    pub id: u32,
    /// What the pose rests on.
    pub state: HybridState,
    /// Error of the inertial sensor, degrees.
    pub error_deg: f64,
    /// Origin of the body in the room, mm.
    pub position_mm: [f64; 3],
    /// Rotation matrix body to room, column by column.
    pub rotation: [f64; 9],
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct DataFrame {
    /// Frame counter; counts at camera rate.
    pub frame: u64,
    /// Seconds since midnight UTC of the flash (`ts`).
    pub ts_s: Option<f64>,
    /// Unix time of the flash (`ts2`).
    pub ts2: Option<UnixStamp>,
    /// Number of calibrated bodies (`6dcal`).
    pub calibrated: Option<u32>,
    /// Tracked bodies; `None` if the line is missing, empty if no body is tracked.
    pub bodies: Option<Vec<Body>>,
    pub hybrids: Option<Vec<Hybrid>>,
    pub markers: Option<Vec<Marker>>,
    /// Lines of a kind that is not read (`6df2`, `6dmt2`, `gl`, ...).
    pub skipped_lines: usize,
}

/// A datagram is refused: where, and why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct DataError {
    /// Line of the datagram, from 1.
    pub line: usize,
    /// What is wrong there.
    pub problem: DataProblem,
}

/// What is wrong with a datagram.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DataProblem {
    /// More bytes than are read.
    #[error("datagram of {0} bytes; at most {MAX_DATAGRAM_BYTES} are read")]
    TooLong(usize),
    /// The line is not ASCII text.
    #[error("not ASCII text")]
    NotText,
    /// The first line is not the frame counter.
    #[error("the first line is not the frame counter 'fr'")]
    NoFrameCounter,
    /// A kind of line occurs twice.
    #[error("second line '{0}'")]
    Twice(&'static str),
    /// A value is missing or is not what it should be.
    #[error("{what} missing or not {expected}")]
    Value {
        /// Name of the value.
        what: &'static str,
        /// What it should be.
        expected: &'static str,
    },
    /// Text after the last value.
    #[error("text after the last value")]
    Rest,
}

impl DataFrame {
    /// Reads one datagram. Lines end with CR, LF, NUL or the datagram.
    ///
    /// # Errors
    /// A line of a known kind is not as documented. The whole datagram is then refused.
    pub fn parse(datagram: &[u8]) -> Result<Self, DataError> {
        let at = |line| move |problem| DataError { line, problem };
        if datagram.len() > MAX_DATAGRAM_BYTES {
            return Err(at(1)(DataProblem::TooLong(datagram.len())));
        }
        let mut frame = Self::default();
        let mut counted = false;
        let lines = datagram.split(|byte| matches!(byte, b'\r' | b'\n' | 0)).filter(|line| !line.is_empty());
        for (number, line) in (1..).zip(lines) {
            let text = std::str::from_utf8(line).ok().filter(|text| text.is_ascii());
            let text = text.ok_or_else(|| at(number)(DataProblem::NotText))?;
            frame.line(text, &mut counted).map_err(at(number))?;
        }
        if counted { Ok(frame) } else { Err(at(1)(DataProblem::NoFrameCounter)) }
    }

    fn line(&mut self, text: &str, counted: &mut bool) -> Result<(), DataProblem> {
        let mut scan = Scan { rest: text };
        let kind = scan.word().unwrap_or_default();
        if !*counted {
            if kind != "fr" {
                return Err(DataProblem::NoFrameCounter);
            }
            self.frame = scan.integer("frame counter")?;
            *counted = true;
            return scan.end();
        }
        match kind {
            "fr" => return Err(DataProblem::Twice("fr")),
            "ts" => once(&mut self.ts_s, "ts", scan.day_seconds()?)?,
            "ts2" => once(&mut self.ts2, "ts2", scan.unix_stamp()?)?,
            "6dcal" => once(&mut self.calibrated, "6dcal", scan.integer("number of bodies")?)?,
            "6d" => once(&mut self.bodies, "6d", scan.list(Scan::body)?)?,
            "6di" => once(&mut self.hybrids, "6di", scan.list(Scan::hybrid)?)?,
            "3d" => once(&mut self.markers, "3d", scan.list(Scan::marker)?)?,
            _ => {
                self.skipped_lines += 1;
                return Ok(());
            }
        }
        scan.end()
    }

    /// Writes the datagram with the usual decimals, lines ended by CR LF.
    ///
    /// Numbers must be finite; others are written as zero.
    #[must_use]
    pub fn write(&self) -> Vec<u8> {
        let mut out = String::with_capacity(256);
        // Writing to a string cannot fail.
        let _ = write!(out, "fr {}\r\n", self.frame);
        if let Some(ts_s) = self.ts_s {
            let _ = write!(out, "ts {:.6}\r\n", finite(ts_s));
        }
        if let Some(ts2) = self.ts2 {
            let _ = write!(out, "ts2 {} {} {}\r\n", ts2.s, ts2.us, ts2.latency_us);
        }
        if let Some(count) = self.calibrated {
            let _ = write!(out, "6dcal {count}\r\n");
        }
        if let Some(bodies) = &self.bodies {
            let _ = write!(out, "6d {}", bodies.len());
            for body in bodies {
                let _ = write!(out, " [{} {:.3}]", body.id, finite(body.quality));
                let angles = body.angles_deg.unwrap_or_default();
                let groups: [(&[f64], usize); 2] =
                    [(&body.position_mm, 3), (if body.angles_deg.is_some() { &angles } else { &[] }, 4)];
                push_bracket(&mut out, &groups);
                push_bracket(&mut out, &[(&body.rotation, 6)]);
            }
            out.push_str("\r\n");
        }
        if let Some(hybrids) = &self.hybrids {
            let _ = write!(out, "6di {}", hybrids.len());
            for hybrid in hybrids {
                let _ =
                    write!(out, " [{} {} {:.3}]", hybrid.id, hybrid.state as u8, finite(hybrid.error_deg));
                push_bracket(&mut out, &[(&hybrid.position_mm, 3)]);
                push_bracket(&mut out, &[(&hybrid.rotation, 6)]);
            }
            out.push_str("\r\n");
        }
        if let Some(markers) = &self.markers {
            let _ = write!(out, "3d {}", markers.len());
            for marker in markers {
                let _ = write!(out, " [{} {:.3}]", marker.id, finite(marker.quality));
                push_bracket(&mut out, &[(&marker.position_mm, 3)]);
            }
            out.push_str("\r\n");
        }
        out.into_bytes()
    }

    /// When the cameras saw this frame: `ts2` if it is there, else `ts` continued over midnight.
    pub fn stamp(&self, clock: &mut DayClock) -> Option<Instant> {
        match (self.ts2, self.ts_s) {
            (Some(ts2), _) => {
                let us = ts2.s.saturating_mul(1_000_000).saturating_add(u64::from(ts2.us));
                Some(Instant::from_micros(us))
            }
            (None, Some(ts_s)) => Some(clock.unwrap_day(ts_s)),
            (None, None) => None,
        }
    }

    /// The pose of a body; `None` if it is not tracked or the frame has no time stamp.
    ///
    /// # Errors
    /// Its matrix is not a rotation.
    pub fn pose(&self, body: u32, clock: &mut DayClock) -> Result<Option<TrackedPose>, NotARotation> {
        let stamp = self.stamp(clock);
        let seen = self.bodies.iter().flatten().find(|seen| seen.id == body && seen.quality >= 0.0);
        let (Some(stamp), Some(seen)) = (stamp, seen) else { return Ok(None) };
        Ok(Some(TrackedPose {
            stamp,
            body,
            position_m: seen.position_mm.map(|mm| mm / 1000.0),
            rotation_wxyz: quaternion_of_columns(&seen.rotation)?,
            tracked: true,
            age: Duration::from_micros(self.ts2.map_or(0, |ts2| ts2.latency_us)),
        }))
    }
}

fn once<T>(slot: &mut Option<T>, kind: &'static str, value: T) -> Result<(), DataProblem> {
    match slot.replace(value) {
        None => Ok(()),
        Some(_) => Err(DataProblem::Twice(kind)),
    }
}

fn finite(x: f64) -> f64 {
    // The sum turns minus zero into zero.
    if x.is_finite() { x + 0.0 } else { 0.0 }
}

/// `[a b c]`; each group of numbers has its decimals.
fn push_bracket(out: &mut String, groups: &[(&[f64], usize)]) {
    let mut separator = '[';
    for (numbers, decimals) in groups {
        for x in *numbers {
            out.push(separator);
            separator = ' ';
            let start = out.len();
            let _ = write!(out, "{:.*}", decimals, finite(*x));
            let zero =
                out.get(start + 1..).is_some_and(|digits| digits.bytes().all(|b| matches!(b, b'0' | b'.')));
            if zero && out.get(start..).is_some_and(|text| text.starts_with('-')) {
                out.remove(start);
            }
        }
    }
    out.push(']');
}

/// The rest of a line.
struct Scan<'a> {
    rest: &'a str,
}

impl<'a> Scan<'a> {
    fn word(&mut self) -> Option<&'a str> {
        let text = self.rest.trim_start_matches(' ');
        let end = text.find([' ', '[', ']']).unwrap_or(text.len());
        let (word, rest) = text.split_at(end);
        self.rest = rest;
        (!word.is_empty()).then_some(word)
    }

    fn end(&self) -> Result<(), DataProblem> {
        if self.rest.trim_matches(' ').is_empty() { Ok(()) } else { Err(DataProblem::Rest) }
    }

    fn integer<T: std::str::FromStr>(&mut self, what: &'static str) -> Result<T, DataProblem> {
        let refuse = DataProblem::Value { what, expected: "a count" };
        let word = self.word().filter(|word| word.bytes().all(|byte| byte.is_ascii_digit()));
        word.and_then(|word| word.parse().ok()).ok_or(refuse)
    }

    fn number(&mut self, what: &'static str) -> Result<f64, DataProblem> {
        let plain = |word: &&str| {
            let digits = word.strip_prefix(['-', '+']).unwrap_or(word);
            digits.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.') && word.len() <= MAX_NUMBER_CHARS
        };
        let number = self.word().filter(plain).and_then(|word| word.parse::<f64>().ok());
        let refuse = DataProblem::Value { what, expected: "a plain decimal" };
        number.filter(|x| x.abs() <= MAX_NUMBER).ok_or(refuse)
    }

    fn day_seconds(&mut self) -> Result<f64, DataProblem> {
        let seconds = self.number("time stamp")?;
        let refuse = DataProblem::Value { what: "time stamp", expected: "seconds of a day" };
        // A leap second may follow the day's last.
        if (0.0..=86_401.0).contains(&seconds) { Ok(seconds) } else { Err(refuse) }
    }

    fn unix_stamp(&mut self) -> Result<UnixStamp, DataProblem> {
        let stamp = UnixStamp {
            s: self.integer("seconds")?,
            us: self.integer("microseconds")?,
            latency_us: self.integer("latency")?,
        };
        if stamp.us < 1_000_000 {
            Ok(stamp)
        } else {
            Err(DataProblem::Value { what: "microseconds", expected: "below a million" })
        }
    }

    fn list<T>(&mut self, item: fn(&mut Self) -> Result<T, DataProblem>) -> Result<Vec<T>, DataProblem> {
        let count: usize = self.integer("number of items")?;
        // The text bounds the list: a wrong count ends at the first missing item.
        let mut items = Vec::new();
        for _ in 0..count {
            items.push(item(self)?);
        }
        Ok(items)
    }

    fn open(&mut self) -> Result<(), DataProblem> {
        let refuse = DataProblem::Value { what: "bracket", expected: "'['" };
        self.rest = self.rest.trim_start_matches(' ').strip_prefix('[').ok_or(refuse)?;
        Ok(())
    }

    fn closes(&mut self) -> bool {
        match self.rest.trim_start_matches(' ').strip_prefix(']') {
            Some(rest) => {
                self.rest = rest;
                true
            }
            None => false,
        }
    }

    fn close(&mut self) -> Result<(), DataProblem> {
        if self.closes() { Ok(()) } else { Err(DataProblem::Value { what: "bracket", expected: "']'" }) }
    }

    fn numbers<const K: usize>(&mut self, what: &'static str) -> Result<[f64; K], DataProblem> {
        let mut out = [0.0; K];
        for x in &mut out {
            *x = self.number(what)?;
        }
        Ok(out)
    }

    fn bracket<const K: usize>(&mut self, what: &'static str) -> Result<[f64; K], DataProblem> {
        self.open()?;
        let numbers = self.numbers(what)?;
        self.close()?;
        Ok(numbers)
    }

    fn body(&mut self) -> Result<Body, DataProblem> {
        self.open()?;
        let id = self.integer("body number")?;
        let quality = self.number("quality")?;
        self.close()?;
        self.open()?;
        let position_mm = self.numbers("position")?;
        let angles_deg = if self.closes() {
            None
        } else {
            let angles = self.numbers("angle")?;
            self.close()?;
            Some(angles)
        };
        Ok(Body { id, quality, position_mm, angles_deg, rotation: self.bracket("rotation")? })
    }

    fn hybrid(&mut self) -> Result<Hybrid, DataProblem> {
        self.open()?;
        let id = self.integer("body number")?;
        let state = match self.integer::<u8>("state")? {
            0 => HybridState::Lost,
            1 => HybridState::Inertial,
            2 => HybridState::Optical,
            3 => HybridState::Both,
            _ => return Err(DataProblem::Value { what: "state", expected: "0 to 3" }),
        };
        let error_deg = self.number("error")?;
        self.close()?;
        let position_mm = self.bracket("position")?;
        Ok(Hybrid { id, state, error_deg, position_mm, rotation: self.bracket("rotation")? })
    }

    fn marker(&mut self) -> Result<Marker, DataProblem> {
        self.open()?;
        let id = self.integer("marker number")?;
        let quality = self.number("quality")?;
        self.close()?;
        Ok(Marker { id, quality, position_mm: self.bracket("position")? })
    }
}
