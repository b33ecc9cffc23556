//! A bus that answers: each frame comes back with its data bytes inverted.
//!
//! `cargo run -p can-link --example echo_server -- socketcand://127.0.0.1:29536/can0` serves there (or at
//! `slcan://127.0.0.1:3333`, or with `slcan:/dev/ptmx` at a pseudo-terminal), prints the spec of its address, and
//! runs until it is killed. The interoperation suite connects python-can to it.

use can_link::{CanLink, Clock, LinkEvent, ServerOptions, serve, wait};
use protocol::Frame;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let spec = std::env::args().nth(1).unwrap_or_else(|| "socketcand://127.0.0.1:29536/can0".to_owned());
    let clock = Clock::start();
    let mut server = serve(&spec.parse()?, clock, ServerOptions::default())?;
    println!("{}", server.name());
    loop {
        while let Some(event) = server.receive()? {
            if let LinkEvent::Frame { frame, .. } = event {
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
