//! A board of one's own, on a PC: `cargo run -p board-example`.
//!
//! | file | what it is on your board |
//! |---|---|
//! | `main.rs` | the program: start-up, the loop, sleep |
//! | `parts.rs` | the drivers: CAN, clock, pins. **This is what a port replaces** |
//! | `lab.rs` | the world around the board: six simulated drives, an arm, and a pendant that jogs joint 6 |
//!
//! Time is virtual: the run is the same on every machine.

mod lab;
mod parts;

use std::error::Error;

use firmware::authority::Seed;
use firmware::groups::powercube::PowerCubes;
use firmware::host_link::Identity;
use firmware::runner::{Clock as _, Pins};
use firmware::settings::Settings;
use firmware::store::RamStorage;
use firmware::{ControllerNode, Runner};
use protocol::Instant;

use lab::Lab;
use parts::{LabCan, LabClock, LabPin};

/// Result of a run.
#[derive(Debug)]
struct Outcome {
    /// How far joint 6 of the simulated arm has turned, rad.
    moved_rad: f64,
    /// Levels that the enable pin had, in order.
    enable: Vec<bool>,
    /// Largest number of frames that waited in the receive queue.
    waiting_max: usize,
}

fn run(end: Instant) -> Result<Outcome, Box<dyn Error>> {
    let lab = Lab::start()?;
    let from_rad = lab.borrow().joint_6_rad();

    // Start-up of the board.
    let mut clock = LabClock(lab.clone());
    let (gripper, enable, lamp) = (LabPin::new("gripper"), LabPin::new("enable"), LabPin::new("lamp"));
    // A board takes both from the chip: its number, and 32 random bytes.
    let (identity, seed) = (Identity::default(), Seed::FORESEEABLE);
    let (storage, settings) = (RamStorage::new(), Settings::powercube6());
    let mut node = ControllerNode::<_, _, PowerCubes>::new(clock.now(), storage, &settings, identity, seed);
    let pins = Pins { gripper, enable: enable.clone(), lamp };
    let mut runner = Runner::new(LabCan(lab.clone()), clock, pins);

    // The loop. A board feeds its watchdog where `healthy` is read.
    while runner.now() < end {
        let turn = runner.turn(&mut node);
        if !turn.healthy {
            return Err("a deadline was served late".into());
        }
        if let Some(until) = turn.idle_until {
            lab.borrow_mut().sleep_until(until.min(end))?;
        }
    }

    let counters = runner.counters();
    if counters != Default::default() {
        return Err(format!("errors of the board: {counters:?}").into());
    }
    let lab = lab.borrow();
    Ok(Outcome {
        moved_rad: lab.joint_6_rad() - from_rad,
        enable: enable.levels(),
        waiting_max: lab.waiting_max(),
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let outcome = run(Instant::from_micros(4_000_000))?;
    println!("joint 6 has turned by {:.4} rad", outcome.moved_rad);
    println!("at most {} frames waited for the board", outcome.waiting_max);
    let jogged = (0.15..0.25).contains(&outcome.moved_rad) && outcome.enable == [false, true, false];
    if jogged { Ok(()) } else { Err("the pendant jogs at 0.2 rad/s for one second: about 0.2 rad".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_jog_of_the_pendant_turns_the_simulated_joint_while_enable_is_high() {
        let outcome = run(Instant::from_micros(4_000_000)).unwrap();
        assert!((0.15..0.25).contains(&outcome.moved_rad), "{outcome:?}");
        assert_eq!(outcome.enable, [false, true, false]);
        assert!(outcome.waiting_max <= 8, "{outcome:?}");
    }

    #[test]
    fn without_a_jog_nothing_moves() {
        let outcome = run(Instant::from_micros(1_400_000)).unwrap();
        assert!(outcome.moved_rad.abs() < 1e-3, "{outcome:?}");
        assert_eq!(outcome.enable, [false]);
    }
}
