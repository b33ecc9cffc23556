//! Prints a robot as URDF: `cargo run -p robot-model --example to_urdf -- powercube6`.

use std::process::ExitCode;

use robot_model::RobotModel;

fn main() -> ExitCode {
    let Some(robot) = std::env::args().nth(1) else {
        eprintln!("usage: to_urdf ROBOT   (a built-in name or a robot file)");
        return ExitCode::from(2);
    };
    let robot = match RobotModel::load(&robot) {
        Ok(robot) => robot,
        Err(e) => {
            eprintln!("{e}");
            return ExitCode::FAILURE;
        }
    };
    print!("{}", robot.to_urdf());
    ExitCode::SUCCESS
}
