//! `cubectl controller unlock`

use firmware::registers::{Kind, RegisterInfo};
use protocol::cyphal::cubecell::command::{UNLOCK, UNLOCK_VALID_S_MAX, Unlock};
use robot_model::RobotModel;

use crate::cmd::target::Target;
use crate::error::ExpectedError;
use operator::bus::settings::crc32_of;
use operator::dialogue::registers::{Numbers, known};

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl controller unlock powercube6 --for-s 600 --set joint.error_max_rad=0.4,0.4,0.4,0.4,0.4,0.4 --bus can0\n  cubectl controller unlock powercube6 --for-s 0 --bus can0               # the limits of the robot hold again, at once\n\nA controller takes limits up to those of the robot it was started for. Wider ones need this, and end with the time,\nor when the controller is switched off. Offset, direction and address of a joint, and a weaker supervision (watchdogs, missed
replies, late cycles), need it too: set those with `cubectl controller registers set` meanwhile. The trajectory has to be committed again
after any change of a limit."
)]
pub struct Args {
    /// Robot whose limits are to be exceeded: a built-in name or a file. It must be the one of the controller.
    #[arg(id = "unlock_robot", value_name = "ROBOT")]
    pub robot: String,
    /// For how long, s; 0 puts the limits of the robot back.
    #[arg(long = "for-s", alias = "for", value_name = "SECONDS", value_parser = clap::value_parser!(u16).range(..=i64::from(UNLOCK_VALID_S_MAX)))]
    pub valid_s: u16,
    /// Limit to set, and its values, one per joint.
    #[arg(long, value_name = "REGISTER=VALUE,...", value_parser = setting)]
    pub set: Vec<(&'static str, Vec<f32>)>,
    #[command(flatten)]
    pub target: Target,
}

/// `joint.v_max_rad_s=1,1,1`: a limit and its values.
fn setting(text: &str) -> Result<(&'static str, Vec<f32>), String> {
    let (name, values) = text.split_once('=').ok_or("must be REGISTER=VALUE,...")?;
    // Others than those of the joints: `cubectl controller registers set`.
    let is_real = |info: &RegisterInfo| info.is_limit() && info.per_joint && info.kind == Kind::Real32;
    let limits: Vec<_> = known().map(|(info, _)| info).filter(|info| is_real(info)).collect();
    let info = limits.iter().find(|info| info.name == name);
    let limits: Vec<&str> = limits.iter().map(|info| info.name).collect();
    let info = info.ok_or_else(|| format!("'{name}' is no limit; the limits are {}", limits.join(", ")))?;
    let values: Result<Vec<f32>, _> = values.split(',').map(|value| value.trim().parse::<f32>()).collect();
    let values = values.map_err(|error| format!("{name}: {error}"))?;
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(format!("{name}: {value} is not a finite number")),
        None => Ok((info.name, values)),
    }
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let robot = RobotModel::load(&args.robot).map_err(|error| ExpectedError::bad_input(&error))?;
    let robot_crc32 = crc32_of(&robot);
    let (mut session, node) = args.target.open()?;
    session.order(node, "to unlock the limits", UNLOCK, &Unlock { robot_crc32, valid_s: args.valid_s })?;
    for (name, values) in &args.set {
        session.set_register(node, name, &Numbers::Real(values.clone()))?;
    }
    session.finish()?;
    if args.valid_s == 0 {
        console::line!("controller {}: the limits of {} hold", node.get(), robot.name());
    } else {
        console::line!(
            "controller {}: limits beyond those of {} for {} s, {} set; commit the trajectory again",
            node.get(),
            robot.name(),
            args.valid_s,
            args.set.len()
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_limits_and_finite_numbers_can_be_set() {
        assert_eq!(setting("joint.v_max_rad_s=1,2.5"), Ok(("joint.v_max_rad_s", vec![1.0, 2.5])));
        for wrong in
            ["joint.v_max_rad_s", "joint.address=1", "joint.v_max_rad_s=1,x", "joint.v_max_rad_s=inf"]
        {
            assert!(setting(wrong).is_err(), "{wrong}");
        }
    }
}
