//! A socketcand server whose bus answers: each frame comes back with its data bytes inverted.
//!
//! `cargo run -p can-link --example echo_server -- 127.0.0.1:29536` prints the address it listens at
//! and runs until it is killed. The interoperation suite lets python-can talk to it.

use can_link::socketcand::{Server, ServerOptions};
use can_link::{Clock, Event, Link, wait};
use protocol::Frame;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let address = std::env::args().nth(1).unwrap_or_else(|| "127.0.0.1:29536".to_owned());
    let (host, port) = address.rsplit_once(':').ok_or("give the address as HOST:PORT")?;
    let clock = Clock::start();
    let mut server = Server::listen(host, port.parse()?, "can0", clock, ServerOptions::default())?;
    println!("{}", server.name());
    loop {
        while let Some(event) = server.receive()? {
            if let Event::Frame { frame, .. } = event {
                let answer = if frame.is_remote() {
                    Frame::remote(frame.id(), frame.dlc())?
                } else {
                    let data: Vec<u8> = frame.data().iter().map(|byte| !byte).collect();
                    Frame::new(frame.id(), &data)?
                };
                server.send(&answer)?;
            }
        }
        wait(&[&server], &clock, None)?;
    }
}
