//! A throw planned from a program: `cargo run -p planner --example plan_throw -- 1.0 1.0 -1.0 plan.json`.

use std::error::Error;
use std::path::Path;

use nalgebra::Vector3;
use planner::plan::statistics::Noise;
use planner::plan::{Arm, Budget, Kept, Options, Watch, seeds};
use planner::request::{Request, Wanted};
use planner::verify;

fn main() -> Result<(), Box<dyn Error>> {
    // Target in the frame of the arm's base, m; z is up.
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, default: f64| arguments.get(i).map_or(Ok(default), |text| text.parse());
    let target = Vector3::new(number(0, 1.0)?, number(1, 1.0)?, number(2, -1.0)?);

    // A robot: a built-in name or the path of a robot file. Stored throws are good starts for the built-in arm.
    let arm = Arm::load("powercube6")?;
    let starts = seeds::built_in(&arm);

    let request = Request {
        target,
        options: &Options::best(),
        // All options are kept, even if a target is hard to reach.
        kept: Kept { shift_limits: true, nulling: true },
        quick: None,
        budget: Budget { starts: 8, all: false, time: None, seed: 1 },
    };
    let wanted = Wanted { robot: "powercube6", noise: &Noise::default(), region: None, draws: None };
    let planned = request.plan(&arm, &starts, &wanted, &Watch::default())?;
    let throw = &planned.answer.best.found.throw;
    println!("release after {:.3} s, flight of {:.3} s", throw.ha_s, throw.flight_s);

    // The plan as a file, and a second opinion that shares nothing with the planner.
    let file = planned.plan.ok_or("the ball does not land")?;
    println!("lands at {:.3?} m", file.landing.position_m);
    if let Some(wrong) = verify::check(&arm, &file).findings.into_iter().find(|f| f.enforced && !f.ok) {
        return Err(format!("the plan is refused: {wrong:?}").into());
    }
    if let Some(path) = arguments.get(3) {
        file.write(Path::new(path))?;
    }
    Ok(())
}
