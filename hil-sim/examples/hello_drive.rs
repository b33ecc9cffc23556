//! A node of one's own moves a simulated drive: `cargo run -p hil-sim --example hello_drive`.

use hil_sim::bus::BusConfig;
use hil_sim::participants::Solo;
use hil_sim::{Cell, CellOptions, World};
use protocol::powercube::{MotionCommand, MotionRequest, Reply, Request};
use protocol::units::Radians;
use protocol::{Frame, Instant, ModuleId, Node};

/// Sends one frame when its time has come, and prints the answers.
struct Hello {
    /// The drives have started up by then.
    due: Option<Instant>,
    out: Option<Frame>,
}

impl Node for Hello {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        if let Ok((module, reply)) = Reply::decode(frame) {
            println!("{:.4} s: module {module} answers {reply:?}", now.as_secs_f64());
        }
    }
    fn handle_timeout(&mut self, now: Instant) {
        self.due = self.due.filter(|due| *due > now);
    }
    fn poll_frame(&mut self) -> Option<Frame> {
        if self.due.is_none() { self.out.take() } else { None }
    }
    fn poll_timeout(&self) -> Option<Instant> {
        self.due
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    let cell = Cell::new(&robot_model::AnyRobot::load("powercube6")?, &options, 1)?;
    // Module 6 turns the hand, to 1 rad.
    let ramp = MotionRequest::extended(MotionCommand::Ramp { target: Radians::new(1.0) });
    let out = Some(Request::Move(ramp).encode(ModuleId::new(6)?));
    let hello = Solo::new("hello", Hello { due: Some(Instant::from_micros(500_000)), out });
    let mut world = World::new((cell, hello), BusConfig::default(), 1, Vec::new())?;
    world.run_until(Instant::from_micros(2_500_000), &mut ())?;
    let q_rad = world.participants().0.plant().axis(5).q_rad;
    println!("the axis stands at {q_rad:.4} rad");
    if (q_rad - 1.0).abs() < 1e-2 { Ok(()) } else { Err("the axis is not at its target".into()) }
}
