//! How punctual a runner is here: a frame every millisecond on a socketcand port.
//!
//! `cargo run --release -p can-link --example metronome -- 5` runs for five seconds and prints how late
//! the deadlines were served.

use std::sync::atomic::AtomicBool;

use can_link::socketcand::{Server, ServerOptions};
use can_link::{Clock, Runner};
use protocol::{Duration, Frame, Instant, Node, StandardId};

const PERIOD: Duration = Duration::from_millis(1);

struct Metronome {
    due: Instant,
    frame: Option<Frame>,
}

impl Node for Metronome {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}

    fn handle_timeout(&mut self, now: Instant) {
        while self.due <= now {
            self.due += PERIOD;
            self.frame = Some(Frame::from_array(StandardId::ZERO, [0x55; 8]));
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.frame.take()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.due)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seconds = std::env::args().nth(1).map_or(Ok(5), |text| text.parse())?;
    let clock = Clock::start();
    let mut link = Server::listen("127.0.0.1", 0, "can0", clock, ServerOptions::default())?;
    let mut metronome = Metronome { due: clock.now() + PERIOD, frame: None };
    let mut runner = Runner::new(&mut link, clock);
    let until = clock.now() + Duration::from_secs(seconds);
    runner.run(&mut [&mut metronome], &AtomicBool::new(false), Some(until))?;
    println!("a frame every {PERIOD}: late {}", runner.stats().deadlines);
    Ok(())
}
