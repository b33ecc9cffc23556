//! Records a whole catch as the catcher's controller sees it: homing, a plan that stands still, the way to the waiting pose, new end
//! states in flight until the simulated ball lies in the cup, the way back, and a halt on this way. The emulated board plays the
//! same calls and must send the same frames.
//!
//! `record_catch DIR` writes `DIR/script.bin` and `DIR/expected.bin` in the form of `firmware/examples/record_throw.rs`.

#[path = "../../../firmware/examples/lockstep/record.rs"]
mod record;

use std::cell::{Cell, RefCell};
use std::error::Error;
use std::path::PathBuf;
use std::rc::Rc;

use firmware::ControllerNode;
use firmware::authority::Seed;
use firmware::groups::powercube::PowerCubes;
use firmware::host_link::Identity;
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::store::RamStorage;
use hil_sim::participants::Solo;
use hil_sim::two_arms::TwoArmOptions;
use lab::rally::throws::{draw_throws, place_exists};
use operator::ball_catch::controller_arm::ControllerArm;
use operator::ball_catch::executor::Executor;
use operator::ball_catch::trial::{CatchOutcome, Pair, TrialOptions};
use operator::bus::BusArgs;
use operator::bus::sim::SwitchedNode;
use planner::catch::draw::Window;
use protocol::{Frame, Instant, Node};
use record::record;

/// Throws that are looked at until one has a place to catch it.
const DRAWN: usize = 20;
/// The halt comes this long after the way back has begun, s.
const HALT_AT_S: f64 = 1.5;

/// Calls and frames, 24 bytes each.
#[derive(Default)]
struct Records {
    at: Instant,
    calls: Vec<u8>,
    frames: Vec<u8>,
    targets_taken: u32,
}

/// A controller that writes down what it is called with and what it sends.
struct Recorded {
    node: ControllerNode<RamStorage, Spline, PowerCubes>,
    records: Rc<RefCell<Records>>,
}

impl Recorded {
    fn call(&mut self, now: Instant, frame: Option<&Frame>) {
        let before = self.node.controller().targets_taken();
        match frame {
            Some(frame) => self.node.handle_frame(now, frame),
            None => self.node.handle_timeout(now),
        }
        let mut records = self.records.borrow_mut();
        records.at = now;
        records.targets_taken += u32::from(self.node.controller().targets_taken() > before);
        records.calls.extend(record(now, frame));
    }
}

impl Node for Recorded {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.call(now, Some(frame));
    }
    fn handle_timeout(&mut self, now: Instant) {
        self.call(now, None);
    }
    fn poll_frame(&mut self) -> Option<Frame> {
        let frame = self.node.poll_frame()?;
        let mut records = self.records.borrow_mut();
        let at = records.at;
        records.frames.extend(record(at, Some(&frame)));
        Some(frame)
    }
    fn poll_timeout(&self) -> Option<Instant> {
        self.node.poll_timeout()
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let dir = PathBuf::from(std::env::args().nth(1).ok_or("usage: record_catch DIR")?);
    // The identity of the emulated board: it is asked for.
    let identity = Identity { unique_id: *b"emulated-board\0\0", hardware: (0, 1) };
    let (storage, settings) = (RamStorage::new(), Settings::POWERCUBE6);
    let node = ControllerNode::new(Instant::ZERO, storage, &settings, identity, Seed::FORESEEABLE);
    let records = Rc::new(RefCell::new(Records::default()));
    let controller = Recorded { node, records: Rc::clone(&records) };
    let node = SwitchedNode::new(Box::new(controller), Rc::new(Cell::new(false)));
    let args = BusArgs::default();
    let session = args.open_with_nodes(&args.cell.load()?, Box::new(vec![Solo::new("controller", node)]))?;

    let pair = Pair::new(TwoArmOptions::two_arms()?)?;
    let mut options = TrialOptions::default();
    options.settings.actuation_s = ControllerArm::ACTUATION_S;
    let window = Window { flight_s: (0.6, 0.9), ..Window::default() };
    let throws = draw_throws(&pair, &window, DRAWN, 5).ok_or("no throw reaches the catcher")?;
    let aimed = throws.iter().find(|aimed| place_exists(&pair, aimed, &options));
    let aimed = aimed.ok_or("no throw has a place to catch it")?;

    let mut arm = ControllerArm::on(session, &settings, &options.wait)?;
    let before = records.borrow().targets_taken;
    let outcome = pair.run_on(aimed, &options, 0, &mut arm, |observe| observe());
    let taken = records.borrow().targets_taken - before;
    if !outcome.caught || outcome.reported != CatchOutcome::Caught || taken < 3 {
        return Err(format!("no catch: reported {:?}, {taken} end states taken", outcome.reported).into());
    }
    arm.begin_way(&options.wait)?;
    arm.advance(HALT_AT_S);
    arm.stop()?;

    let records = records.borrow();
    std::fs::create_dir_all(&dir)?;
    std::fs::write(dir.join("script.bin"), &records.calls)?;
    std::fs::write(dir.join("expected.bin"), &records.frames)?;
    let (calls, frames) = (records.calls.len() / 24, records.frames.len() / 24);
    println!("{calls} calls, {frames} frames; ball caught after {taken} end states");
    Ok(())
}
