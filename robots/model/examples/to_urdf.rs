//! Prints a robot as URDF: `cargo run -p robot-model --example to_urdf -- powercube6`.

use std::process::ExitCode;

use robot_model::{AnyRobot, for_any_robot};

fn main() -> ExitCode {
    let Some(robot) = std::env::args().nth(1) else {
        eprintln!("usage: to_urdf ROBOT   (a built-in name or a robot file)");
        return ExitCode::from(2);
    };
    let robot = match AnyRobot::load(&robot) {
        Ok(robot) => robot,
        Err(e) => {
            eprintln!("{e}");
            return ExitCode::FAILURE;
        }
    };
    let urdf = for_any_robot!(&robot, arm => arm.to_urdf());
    print!("{urdf}");
    ExitCode::SUCCESS
}
