//! Throws from a program of one's own: a plan, a controller in this program, a simulated arm, and where the ball landed.
//!
//! ```sh
//! cargo run -p operator --example throw_in_process -- 1.0 1.0 -1.0
//! ```
//!
//! The job asks an [`Operator`](operator::port::Operator) only. Put [`OnBus`](operator::port::OnBus) with a session in the place
//! of [`InProcess`], and the same lines throw with the arm on a bus.

use std::error::Error;

use nalgebra::Vector3;
use operator::bus::period::settings_with_gains;
use operator::bus::sim::SimSetup;
use operator::job::cell::take_plan;
use operator::job::{Answer, Order, Outcome, perform};
use operator::port::{BallSeen, InProcess};
use planner::plan::statistics::Noise;
use planner::plan::{Arm, Budget, Kept, Options, Watch, seeds};
use planner::request::{Request, Wanted};
use planner::way::Travel;
use robot_model::RobotModel;

const SEED: u64 = 1;

fn main() -> Result<(), Box<dyn Error>> {
    let numbers: Vec<f64> = std::env::args().skip(1).map(|text| text.parse()).collect::<Result<_, _>>()?;
    let [x, y, z] = numbers.as_slice() else { return Err("give the target as three numbers, m".into()) };
    let target_m = Vector3::new(*x, *y, *z);

    let arm = Arm::load("powercube6")?;
    let request = Request {
        target: target_m,
        options: &Options::best(),
        kept: Kept { shift_limits: true, nulling: true },
        quick: None,
        budget: Budget { starts: 2, all: false, time: None, seed: SEED },
    };
    let wanted = Wanted { robot: "powercube6", noise: &Noise::default(), region: None, draws: None };
    let planned = request.plan(&arm, &seeds::built_in(&arm), &wanted, &Watch::default())?;
    let plan = planned.plan.ok_or("the ball does not come down on the plane of the target")?;

    let robot = RobotModel::load("powercube6")?;
    let mut setup = SimSetup::default();
    take_plan(&mut setup.cell, &plan);
    let mut operator = InProcess::new(&robot, &setup, SEED, &settings_with_gains(&robot, &setup)?)?;

    let throw = Order::throw(&arm, &plan, Travel { seed: SEED, ..Travel::default() });
    let verdict = perform(&mut operator, &throw, &mut |_| Answer::Yes).verdict;
    println!("{}", verdict.text);

    // The simulated cell is the witness.
    let landing = BallSeen::of(operator.cell()).landing.ok_or("no ball came down")?;
    let error_mm = 1e3 * (landing.1 - target_m).norm();
    println!("the ball came down {error_mm:.1} mm from the target");
    if verdict.outcome == Outcome::Landed { Ok(()) } else { Err(verdict.text.into()) }
}
