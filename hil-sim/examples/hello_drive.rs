//! A node of one's own moves a simulated drive: `cargo run -p hil-sim --example hello_drive`.

use std::collections::VecDeque;
use std::error::Error;

use hil_sim::bus::BusConfig;
use hil_sim::participants::Solo;
use hil_sim::{Cell, CellOptions, World};
use protocol::powercube::{MotionCommand, MotionRequest, Parameter, Reply, Request, Value};
use protocol::units::Radians;
use protocol::{Duration, Frame, Instant, ModuleId, Node};
use robot_model::AnyRobot;

/// Orders one ramp, then asks the drive for its position every 100 ms.
struct Hello {
    module: ModuleId,
    /// Where to; taken when the ramp is ordered.
    target: Option<Radians>,
    ask_at: Instant,
    out: VecDeque<Frame>,
    position_rad: Option<f32>,
}

impl Node for Hello {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        if let Ok((module, Reply::Value(Parameter::ActPos, Value::F32(rad)))) = Reply::decode(frame)
            && module == self.module
        {
            println!("{:.3} s: module {module} is at {rad:.4} rad", now.as_secs_f64());
            self.position_rad = Some(rad);
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        if now >= self.ask_at {
            if let Some(target) = self.target.take() {
                let ramp = MotionRequest::extended(MotionCommand::Ramp { target });
                self.out.push_back(Request::Move(ramp).encode(self.module));
            }
            self.out.push_back(Request::Get(Parameter::ActPos).encode(self.module));
            self.ask_at = now + Duration::from_millis(100);
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.ask_at)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    let cell = Cell::new(&AnyRobot::load("powercube6")?, &options, 1)?;

    // Module 6 turns the hand. Its drive has started up after half a second.
    let (module, target_rad) = (ModuleId::new(6)?, 1.0);
    let hello = Hello {
        module,
        target: Some(Radians::new(target_rad)),
        ask_at: Instant::from_micros(500_000),
        out: VecDeque::new(),
        position_rad: None,
    };

    let mut world = World::new((cell, Solo::new("hello", hello)), BusConfig::default(), 1, Vec::new())?;
    world.run_until(Instant::from_micros(2_500_000), &mut ())?;

    // The plant knows where the axis is, whatever the drive says.
    let (cell, hello) = world.participants();
    let q_rad = cell.plant().axis(5).q_rad;
    println!("the axis stands at {q_rad:.4} rad");
    let told_rad = hello.node.position_rad.ok_or("the drive did not answer")?;
    if (f64::from(told_rad) - q_rad).abs() > 1e-3 || (f64::from(target_rad) - q_rad).abs() > 1e-2 {
        return Err(format!("the drive tells {told_rad} rad and the target is {target_rad} rad").into());
    }
    Ok(())
}
