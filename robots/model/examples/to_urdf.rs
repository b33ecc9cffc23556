//! Prints a robot as URDF: `cargo run -p robot-model --example to_urdf -- powercube6`.

use std::process::ExitCode;

use robot_model::AnyRobot;

fn main() -> ExitCode {
    let Some(robot) = std::env::args().nth(1) else {
        eprintln!("usage: to_urdf ROBOT   (a built-in name or a robot file)");
        return ExitCode::from(2);
    };
    let urdf = match AnyRobot::load(&robot) {
        Ok(AnyRobot::Four(m)) => m.to_urdf(),
        Ok(AnyRobot::Five(m)) => m.to_urdf(),
        Ok(AnyRobot::Six(m)) => m.to_urdf(),
        Ok(AnyRobot::Seven(m)) => m.to_urdf(),
        Ok(other) => {
            eprintln!("{} has {} joints, which this program does not know", other.name(), other.joints());
            return ExitCode::FAILURE;
        }
        Err(e) => {
            eprintln!("{e}");
            return ExitCode::FAILURE;
        }
    };
    print!("{urdf}");
    ExitCode::SUCCESS
}
