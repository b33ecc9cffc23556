//! A Cyphal node on a bus of its own, behind a socketcand server: something for public tools to talk to.
//!
//! `cargo run -p can-link --example cyphal_node -- 127.0.0.1:29536 [LOSS [SEED]]` prints the address it
//! listens at and runs until it is killed. Node-ID 42. LOSS = 60 loses one frame in 60, both ways,
//! chosen by SEED; 0 (the default) loses none. The interop stage lets pycyphal and yakut use it.

#[path = "../../tests/common/cyphal_app.rs"]
mod app;

use std::cell::Cell;
use std::rc::Rc;

use app::DemoApp;
use can_link::socketcand::{Server, ServerOptions};
use can_link::{CanLink, Clock, LinkError, LinkEvent, LinkStats, PollSet, Runner, SendError};
use protocol::cyphal::id::NodeId;
use protocol::cyphal::server::{ControllerServer, NodeCore};
use protocol::{Frame, Instant};
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// A link that loses frames on purpose.
struct Lossy<L> {
    link: L,
    /// One in this many; 0 = none.
    loss: u64,
    dice: SplitMix64,
    lost: Rc<Cell<u32>>,
}

impl<L> Lossy<L> {
    /// True for a frame that is lost.
    fn loses(&mut self) -> bool {
        let lost = self.loss > 0 && self.dice.next_u64().is_multiple_of(self.loss);
        self.lost.set(self.lost.get() + u32::from(lost));
        lost
    }
}

impl<L: CanLink> CanLink for Lossy<L> {
    fn name(&self) -> &str {
        self.link.name()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        if self.loses() { Ok(()) } else { self.link.send(frame) }
    }

    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
        loop {
            match self.link.receive()? {
                Some(LinkEvent::Frame { .. }) if self.loses() => {}
                other => return Ok(other),
            }
        }
    }

    fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        self.link.register(set);
    }

    fn deadline(&self) -> Option<Instant> {
        self.link.deadline()
    }

    fn stats(&self) -> LinkStats {
        self.link.stats()
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments.next().unwrap_or_else(|| "127.0.0.1:29536".to_owned());
    let loss = arguments.next().map_or(Ok(0), |text| text.parse())?;
    let seed = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let (host, port) = address.rsplit_once(':').ok_or("give the address as HOST:PORT")?;

    let clock = Clock::start();
    let server = Server::listen(host, port.parse()?, "can0", clock, ServerOptions::default())?;
    println!("{}", server.name());
    let app = DemoApp::new();
    let mut link = Lossy {
        link: server,
        loss,
        dice: SplitMix64::seed_from_u64(seed),
        lost: Rc::clone(&app.frames_lost),
    };
    let mut node = ControllerServer { core: NodeCore::new(clock.now(), NodeId::new(42)?), app };
    let mut runner = Runner::new(&mut link, clock);
    loop {
        runner.step(&mut [&mut node], None)?;
    }
}
