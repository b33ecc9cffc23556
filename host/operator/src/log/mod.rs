//! Recordings of a bus: a candump text log, which is also what `replay` reads, and an MCAP file for viewers.
//!
//! | module | holds |
//! |---|---|
//! | [`arm_view`] | the arm for viewers: joints, frames and bodies in public schemas |
//! | [`candump`] | text log: written line by line, read with line numbers in errors |
//! | [`facts`] | content of frames: requests, answers, messages, orders |
//! | [`keep`] | the frames of a session, kept in memory |
//! | [`mcap`] | the same frames, their content, and the arm at control rate, as protobuf channels |
//! | [`watch`] | events as text; freeze frames at faults |
//! | [`schema`] | the protobuf messages and their self-description |
//!
//! [`Recorder`] writes both at once. It passes everything to the operating system at each change of the
//! controller's state, and otherwise at most [`FLUSH_EVERY`] after it was seen, also if no more frames come. A
//! program that is killed loses no more than that; a loss of power also loses data that the operating system had
//! not written yet. The text log can then be read up to its last whole line, and the MCAP file by every reader that
//! recovers unfinished files.

pub mod arm_view;
pub mod candump;
pub mod facts;
pub mod keep;
pub mod mcap;
mod numbering;
pub mod schema;
pub mod watch;

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

use can_link::{BusError, BusSpec};
use protocol::{Duration, Frame, Instant};

use crate::machine::Machine;
use crate::tap::{Tap, Way};

/// Longest time that a frame waits in memory.
pub const FLUSH_EVERY: Duration = Duration::from_millis(200);

/// Writes both recordings.
pub struct Recorder {
    text: candump::Log<std::fs::File>,
    viewer: mcap::Log<std::fs::File>,
    flushed: Instant,
    /// Something was written since.
    waits: bool,
}

impl Recorder {
    /// Creates `path.log` and `path.mcap` for the bus `spec` with `machine` on it. Files that exist are not overwritten. `zero_unix`
    /// is the Unix time at the session's time zero; zero in virtual time.
    ///
    /// # Errors
    /// A file cannot be created; the path is in the text.
    pub fn create(
        path: &Path,
        spec: &BusSpec,
        zero_unix: Duration,
        machine: Option<Machine>,
    ) -> io::Result<Self> {
        let bus = match spec {
            BusSpec::Socketcand { bus, .. } | BusSpec::Lockstep { bus, .. } => bus.clone(),
            // The interface, or the kind of the bus.
            other => other.to_string().split(':').next().unwrap_or_default().to_owned(),
        };
        let [text, viewer] = files_of(path);
        Ok(Self {
            text: candump::Log::new(create_new(&text)?, bus, zero_unix),
            viewer: mcap::Log::new(create_new(&viewer)?, zero_unix, machine)?,
            flushed: Instant::ZERO,
            waits: false,
        })
    }

    fn flush_if_due(&mut self, at: Instant) -> io::Result<()> {
        if self.waits && at.saturating_since(self.flushed) >= FLUSH_EVERY { self.flush(at) } else { Ok(()) }
    }

    fn flush(&mut self, at: Instant) -> io::Result<()> {
        (self.flushed, self.waits) = (at, false);
        self.text.flush()?;
        self.viewer.flush()
    }
}

/// The two files of a recording. Tools that read candump text know it by the ending `.log`.
pub fn files_of(path: &Path) -> [PathBuf; 2] {
    ["log", "mcap"].map(|extension| {
        let mut name = OsString::from(path);
        name.push(".");
        name.push(extension);
        PathBuf::from(name)
    })
}

/// Name of the recording in the folder of a run.
pub const FOLDER_NAME: &str = "bus";

/// The text log in the folder of a run; folders of before 22 November 2026 have it under another name.
#[must_use]
pub fn text_in(folder: &Path) -> PathBuf {
    let [text, _] = files_of(&folder.join(FOLDER_NAME));
    let older = folder.join("log.candump");
    if older.exists() && !text.exists() { older } else { text }
}

/// A new file, or the existing one if it is a device or a pipe.
fn create_new(path: &Path) -> io::Result<std::fs::File> {
    let special = std::fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir());
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create_new(!special);
    options.open(path).map_err(|error| io::Error::new(error.kind(), format!("{}: {error}", path.display())))
}

impl Tap for Recorder {
    fn frame(&mut self, at: Instant, way: Way, frame: &Frame) -> io::Result<()> {
        self.text.frame(at, way, frame)?;
        self.waits = true;
        let state_changed = self.viewer.frame(at, way, frame)?;
        if state_changed { self.flush(at) } else { self.flush_if_due(at) }
    }

    fn bus_error(&mut self, at: Instant, error: &BusError) -> io::Result<()> {
        self.text.bus_error(at, error)?;
        self.waits = true;
        self.viewer.bus_error(at, error)?;
        self.flush_if_due(at)
    }

    fn time(&mut self, now: Instant) -> io::Result<()> {
        self.flush_if_due(now)
    }

    fn finish(&mut self) -> io::Result<()> {
        let text = self.text.flush();
        self.viewer.finish()?;
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::StandardId;

    #[test]
    fn both_files_carry_the_time_of_the_wall_clock_and_the_viewers_file_the_monotonic_one_too() {
        let folder = std::env::temp_dir().join(format!("cubectl-recorder-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let spec = "can0".parse().unwrap();
        let frame = Frame::from_array(StandardId::from_low_bits(0x0A5), [8]);
        for (name, zero_unix_s) in [("wall", 1_700_000_000), ("virtual", 0)] {
            let path = folder.join(name);
            let mut recorder =
                Recorder::create(&path, &spec, Duration::from_secs(zero_unix_s), None).unwrap();
            recorder.frame(Instant::from_micros(1_500_000), Way::Received, &frame).unwrap();
            recorder.finish().unwrap();
            let [text, viewer] = files_of(&path);
            let line = std::fs::read_to_string(&text).unwrap();
            assert!(line.starts_with(&format!("({:010}.500000) can0 0A5#08", zero_unix_s + 1)), "{line}");
            let read = candump::read_file(&text).unwrap();
            assert_eq!(read.lines[0].at.as_micros(), zero_unix_s * 1_000_000 + 1_500_000);
            let bytes = std::fs::read(viewer).unwrap();
            let messages: Vec<_> = ::mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
            assert_eq!(messages[0].log_time, zero_unix_s * 1_000_000_000 + 1_500_000_000);
            assert_eq!(messages[0].publish_time, 1_500_000_000);
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
