//! Text log in the form of `candump -L`: `(0000000001.000123) can0 0A5#084F64`.

use std::io::{self, Write};

use protocol::text::BusName;
use protocol::text::candump::Record;
use protocol::{Frame, Instant};

use crate::world::Observer;

/// Writes one line per good frame. Times are those of the run, from zero.
///
/// A write error is kept and returned by [`CandumpLog::finish`]; later frames are then left out, so that a full
/// disk does not stop a run whose end is of interest.
#[derive(Debug)]
pub struct CandumpLog<'a, W: Write> {
    out: W,
    bus: BusName<'a>,
    lines: u64,
    failed: Option<io::Error>,
}

impl<'a, W: Write> CandumpLog<'a, W> {
    /// Log with `bus` as the name of the interface in each line.
    pub fn new(out: W, bus: BusName<'a>) -> Self {
        Self { out, bus, lines: 0, failed: None }
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

impl<W: Write> Observer for CandumpLog<'_, W> {
    fn on_frame(&mut self, at: Instant, _from: Option<usize>, frame: &Frame) {
        if self.failed.is_some() {
            return;
        }
        let line = Record { at, bus: self.bus, frame: *frame, direction: None }.encode();
        let written = self.out.write_all(line.as_bytes()).and_then(|()| self.out.write_all(b"\n"));
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

    fn can0() -> BusName<'static> {
        BusName::new("can0").unwrap()
    }

    #[test]
    fn line_has_the_form_of_candump() {
        let mut log = CandumpLog::new(Vec::new(), can0());
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
        let mut log = CandumpLog::new(FullDisk, can0());
        let frame = Frame::from_array(StandardId::ZERO, []);
        log.on_frame(Instant::ZERO, None, &frame);
        log.on_frame(Instant::ZERO, None, &frame);
        assert_eq!(log.lines(), 0);
        assert_eq!(log.finish().unwrap_err().kind(), io::ErrorKind::StorageFull);
    }
}
