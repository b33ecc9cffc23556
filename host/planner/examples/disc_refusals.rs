//! Refusals of discs compared with a slow search: random discs; the refused ones are searched with more
//! populations and generations, from another seed.
//!
//!     cargo run -p planner --release --example disc_refusals -- [DISCS] [SEED] [POPULATIONS GENERATIONS]
//!
//! A refusal is wrong if the slow search finds a catch that the observer of disc and gripper accepts within the joint limits.

use std::time::Instant as Clock;

use nalgebra::Vector3;
use planner::disc::arm::{DiscArm, READY_RAD};
use planner::disc::flight::Path;
use planner::disc::intercept::local::{Effort, search};
use planner::disc::intercept::{self, Plan, Settings};
use planner::disc::paper::Throw;
use planner::disc::witness::{Gripper, Rule, judge, moments};
use planner::motion_law::State;
use planner::plan::rng::SplitMix64;
use rayon::prelude::*;
use robot_model::RobotModel;

/// A disc that passes within 0.7 m of the axis.
fn throw(rng: &mut SplitMix64) -> Throw {
    use std::f64::consts::PI;
    loop {
        let mut between = |low: f64, high: f64| low + (high - low) * rng.unit();
        let (angle, rho) = (between(-PI, PI), 0.7 * between(0.0, 1.0).sqrt());
        let p = Vector3::new(rho * angle.cos(), rho * angle.sin(), between(0.25, 0.7));
        let (heading, speed) = (between(-PI, PI), between(1.0, 4.0));
        let v = Vector3::new(speed * heading.cos(), speed * heading.sin(), between(-3.0, 0.0));
        let (t_s, g) = (between(0.4, 0.9), Vector3::z() * 9.81);
        let throw = Throw { start_m: p - v * t_s - g * (0.5 * t_s * t_s), velocity_m_s: v + g * t_s };
        if throw.start_m.z > 0.1 && throw.start_m.norm() > 1.1 {
            return throw;
        }
    }
}

fn accepted(arm: &DiscArm, path: &Path, plan: &Plan) -> bool {
    let moments = moments(|t_s| plan.motion.q(t_s), path, plan.motion.end_s());
    let verdict = judge(arm, &Gripper::default(), &Rule::default(), &moments);
    verdict.caught.is_some() && verdict.within_limits(arm) && verdict.clearance_m > 0.0
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let discs: usize = words.next().map_or(Ok(200), |word| word.parse())?;
    let seed: u64 = words.next().map_or(Ok(1), |word| word.parse())?;
    let arm = DiscArm::new(RobotModel::load("pincher4")?)?;
    let ready = READY_RAD.map(State::rest);
    let number = |word: Option<String>, or: usize| word.map_or(Ok(or), |word| word.parse());
    let populations = number(words.next(), Effort::PLAN.populations)?;
    let generations = number(words.next(), Effort::PLAN.generations)?;
    let settings = Settings { between: Effort { populations, generations, seed: 1 }, ..Settings::default() };
    let slow = Settings {
        between: Effort { populations: 2 * populations, generations: 2 * generations, seed: !seed },
        ..settings
    };
    let mut rng = SplitMix64::new(seed);
    let throws: Vec<Throw> = (0..discs).map(|_| throw(&mut rng)).collect();
    // Time of a plan (ms); caught and accepted, if it is not refused; the refusal is wrong, if it is.
    let judged: Vec<(f64, Result<bool, bool>)> = throws
        .par_iter()
        .map(|throw| {
            let path = Path::parabola(throw, 1.5);
            let clock = Clock::now();
            let plan = intercept::plan(&arm, &path, &ready, &settings);
            let took_ms = clock.elapsed().as_secs_f64() * 1e3;
            let outcome = plan.map(|plan| accepted(&arm, &path, &plan)).map_err(|why| {
                let slow = search(&arm, &path, &ready, &slow).ok().filter(|plan| accepted(&arm, &path, plan));
                println!("{throw:?} refused, {why}: {:?}", slow.as_ref().map(|plan| plan.choice));
                slow.is_some()
            });
            (took_ms, outcome)
        })
        .collect();
    let mut times: Vec<f64> = judged.iter().map(|j| j.0).collect();
    times.sort_by(f64::total_cmp);
    let count = |what: Result<bool, bool>| judged.iter().filter(|(_, outcome)| *outcome == what).count();
    let (refuted, wrong, right) = (count(Ok(false)), count(Err(true)), count(Err(false)));
    println!(
        "{} of {discs} caught ({refuted} of them not accepted by the observer), {} refused, {wrong} of these wrong; a plan takes {:.1} ms (50 %), {:.1} ms (99 %)",
        discs - wrong - right,
        wrong + right,
        times[discs / 2],
        times[(discs * 99 / 100).min(discs - 1)]
    );
    Ok(())
}
