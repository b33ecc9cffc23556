//! Where the arm is to go, as it stands on the command line.

use nalgebra::Vector3;
use planner::way::Goal;
use robot_model::Pose;

/// An angle in rad: `0.3`, `0.3rad` or `17deg`.
pub(super) fn angle(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let (number, factor) = match (text.strip_suffix("deg"), text.strip_suffix("rad")) {
        (Some(number), _) => (number, 1_f64.to_radians()),
        (None, Some(number)) => (number, 1.0),
        (None, None) => (text, 1.0),
    };
    match number.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value * factor),
        _ => Err(format!("\"{text}\" is not an angle; write 0.3 (rad) or 17deg")),
    }
}

/// Angles of all joints, rad, base first.
#[derive(Debug, Clone, PartialEq)]
pub struct Angles(pub Vec<f64>);

impl std::str::FromStr for Angles {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.split(',').map(angle).collect::<Result<_, _>>().map(Self)
    }
}

/// A joint, from 1, and by how much it turns, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    pub joint: usize,
    pub by_rad: f64,
}

impl std::str::FromStr for Difference {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form = || format!("\"{text}\" is not JOINT=ANGLE, for example 3=+10deg");
        let (joint, by) = text.split_once('=').ok_or_else(form)?;
        let joint = joint.trim().parse().ok().filter(|joint| (1..=protocol::JOINTS_MAX).contains(joint));
        Ok(Self { joint: joint.ok_or_else(form)?, by_rad: angle(by)? })
    }
}

/// A place of the hand: `x,y,z` in m, or a pose with roll, pitch and yaw behind it (about x, y, z of the base, in this order).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hand(pub Goal);

impl std::str::FromStr for Hand {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<&str> = text.split(',').collect();
        if ![3, 6].contains(&parts.len()) {
            return Err("must be x,y,z or x,y,z,roll,pitch,yaw".to_owned());
        }
        let metres = |part: &&str| match part.trim().parse::<f64>() {
            Ok(value) if value.abs() <= 100.0 => Ok(value),
            Ok(value) if value.is_finite() => {
                Err(format!("{value} m is far beyond any arm; are these millimetres?"))
            }
            _ => Err(format!("\"{part}\" is not a number of metres")),
        };
        let at: Vec<f64> = parts[..3].iter().map(metres).collect::<Result<_, _>>()?;
        let at = Vector3::from_column_slice(&at);
        if parts.len() == 3 {
            return Ok(Self(Goal::Point(at)));
        }
        let rpy: Vec<f64> = parts[3..].iter().map(|part| angle(part)).collect::<Result<_, _>>()?;
        Ok(Self(Goal::Pose(Pose::from_rpy([rpy[0], rpy[1], rpy[2]], at))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_rad_unless_they_say_deg() {
        let found: Angles = "0.3,-17deg, 1rad,0".parse().unwrap();
        assert_eq!(found.0, [0.3, -17_f64.to_radians(), 1.0, 0.0]);
        for wrong in ["", "1,,2", "x", "nan", "1 turn"] {
            assert!(wrong.parse::<Angles>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn difference_names_a_joint_from_one() {
        let found: Difference = "3=+10deg".parse().unwrap();
        assert_eq!(found, Difference { joint: 3, by_rad: 10_f64.to_radians() });
        for wrong in ["3", "0=1", "9=1", "a=1", "3=x"] {
            assert!(wrong.parse::<Difference>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn hand_is_a_point_or_a_pose_in_metres() {
        assert_eq!("0.4,0,0.5".parse(), Ok(Hand(Goal::Point(Vector3::new(0.4, 0.0, 0.5)))));
        let Hand(Goal::Pose(pose)) = "0.4,0,0.5,0,90deg,0".parse().unwrap() else { panic!("a pose") };
        assert!((pose.rpy_rad()[1] - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
        assert!("400,0,500".parse::<Hand>().unwrap_err().contains("millimetres"));
        assert!("1,2".parse::<Hand>().is_err());
    }
}
