//! Gains of an arm at a period, and how they follow a throw: `cargo run -p tuner --example certified_gains -- [ROBOT] [MS]`.

use robot_model::RobotModel;
use tuner::gains::choose::gains_for;
use tuner::gains::compare::tracking;
use tuner::gains::machine::Machine;
use tuner::gains::plant::Throw;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let robot = RobotModel::load(&args.next().unwrap_or_else(|| "powercube6".to_owned()))?;
    let period_s = args.next().map_or(Ok(3.0), |ms| ms.parse::<f64>())? * 1e-3;
    // Built-in gains, or a design that is proven before it is returned.
    let (gains, from) = gains_for(&robot, (period_s * 1e6).round() as u32)?;
    println!("{} at {:.0} ms, {}:", gains.robot, period_s * 1e3, from.json_name());
    for (joint, plant) in gains.joint.iter().zip(&Machine::from_robot(&robot)?.joints) {
        // Half of the acceleration for the reference; the other half is for the feedback.
        let (ha_s, hb_s) = (0.56, 0.36);
        let throw = Throw { release_rad_s: 0.25 * plant.acceleration_max_rad_s2 * hb_s, ha_s, hb_s };
        // Delay of one period; 20 mrad away at the start.
        let error = tracking(plant, &throw, joint.gains(), (period_s, period_s), 0.02, ha_s);
        println!(
            "joint {}: gains {:?}, error at the release {:.2} mrad and {:.1} mrad/s",
            joint.number,
            joint.gains(),
            1e3 * error.event_position_rad,
            1e3 * error.event_velocity_rad_s
        );
        if error.event_position_rad.is_nan() || error.event_position_rad > 2e-3 {
            return Err("the gains do not lead the joint back to its reference".into());
        }
    }
    Ok(())
}
