//! Text log in the form of `candump -L`: `(0000000001.000123) can0 0A5#084F64`.

use std::io::{self, Write};

use protocol::{Frame, Instant};

use crate::world::Observer;

/// Writes one line per good frame. Times are those of the run, from zero.
///
/// A write error is kept and returned by [`CandumpLog::finish`]; later frames are then left out, so that a full
/// disk does not stop a run that people want to see the end of.
#[derive(Debug)]
pub struct CandumpLog<W: Write> {
    out: W,
    bus: String,
    lines: u64,
    failed: Option<io::Error>,
}

impl<W: Write> CandumpLog<W> {
    /// Log with `bus` as the name of the interface in each line.
    pub fn new(out: W, bus: impl Into<String>) -> Self {
        Self { out, bus: bus.into(), lines: 0, failed: None }
    }

    /// Lines written so far.
    pub fn lines(&self) -> u64 {
        self.lines
    }

    /// Flushes and gives the writer back.
    pub fn finish(mut self) -> io::Result<W> {
        match self.failed {
            Some(error) => Err(error),
            None => {
                self.out.flush()?;
                Ok(self.out)
            }
        }
    }
}

impl<W: Write> Observer for CandumpLog<W> {
    fn on_frame(&mut self, at: Instant, _from: Option<usize>, frame: &Frame) {
        if self.failed.is_some() {
            return;
        }
        let us = at.as_micros();
        let written =
            writeln!(self.out, "({:010}.{:06}) {} {frame}", us / 1_000_000, us % 1_000_000, self.bus);
        match written {
            Ok(()) => self.lines += 1,
            Err(error) => self.failed = Some(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::StandardId;

    #[test]
    fn line_has_the_form_of_candump() {
        let mut log = CandumpLog::new(Vec::new(), "can0");
        let frame = Frame::from_array(StandardId::new(0x0A5).unwrap(), [0x08, 0x4F, 0x64]);
        log.on_frame(Instant::from_micros(1_000_123), Some(0), &frame);
        assert_eq!(log.lines(), 1);
        assert_eq!(
            String::from_utf8(log.finish().unwrap()).unwrap(),
            "(0000000001.000123) can0 0A5#084F64\n"
        );
    }

    #[derive(Debug)]
    struct FullDisk;

    impl Write for FullDisk {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(io::ErrorKind::StorageFull.into())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn full_disk_is_reported_at_the_end() {
        let mut log = CandumpLog::new(FullDisk, "can0");
        let frame = Frame::from_array(StandardId::ZERO, []);
        log.on_frame(Instant::ZERO, None, &frame);
        log.on_frame(Instant::ZERO, None, &frame);
        assert_eq!(log.lines(), 0);
        assert_eq!(log.finish().unwrap_err().kind(), io::ErrorKind::StorageFull);
    }
}
