//! A small node that moves a simulated drive: `cargo run -p hil-sim --example hello_drive`.

use hil_sim::bus::BusConfig;
use hil_sim::participants::Solo;
use hil_sim::{Cell, CellOptions, World};
use protocol::powercube::{MotionCommand, MotionRequest, Parameter, Reply, Request};
use protocol::units::Radians;
use protocol::{Duration, Frame, Instant, ModuleId, Node};

/// Sends a request to a module, then requests its position every 100 ms, and prints the answers.
struct Hello {
    module: ModuleId,
    request: Request,
    due: Instant,
    out: Option<Frame>,
}

impl Node for Hello {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        if let Ok((module, reply)) = Reply::decode(frame) {
            println!("{:.4} s: module {module} answers {reply:?}", now.as_secs_f64());
        }
    }
    fn handle_timeout(&mut self, now: Instant) {
        if now >= self.due {
            self.out = Some(self.request.encode(self.module));
            (self.request, self.due) = (Request::Get(Parameter::ActPos), now + Duration::from_millis(100));
        }
    }
    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.take()
    }
    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.due)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    let cell = Cell::new(&robot_model::RobotModel::load("powercube6")?, &options, 1)?;
    // Module 6 turns the hand, to 1 rad. Its drive has started up after half a second.
    let ramp = MotionRequest::extended(MotionCommand::Ramp { target: Radians::new(1.0) });
    let (module, request, due) = (ModuleId::new(6)?, Request::Move(ramp), Instant::from_micros(500_000));
    let hello = Solo::new("hello", Hello { module, request, due, out: None });
    let mut world = World::new((cell, hello), BusConfig::default(), 1, Vec::new())?;
    world.run_until(Instant::from_micros(2_500_000), &mut ())?;
    let q_rad = world.participants().0.plant().axis(5).q_rad;
    println!("the axis stands at {q_rad:.4} rad");
    if (q_rad - 1.0).abs() < 1e-2 { Ok(()) } else { Err("the axis is not at its target".into()) }
}
