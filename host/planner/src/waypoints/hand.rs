//! Places of the hand as a table: `x_m,y_m,z_m` in the frame of the base, and `roll_deg,pitch_deg,yaw_deg` if it is to turn.

use nalgebra::Vector3;
use robot_model::Pose;

use super::{WaypointError, check_count};
use crate::way::Goal;

/// Names of the columns and the factors to m and rad.
const COLUMNS: [(&str, usize, f64); 9] = [
    ("x_m", 0, 1.0),
    ("y_m", 1, 1.0),
    ("z_m", 2, 1.0),
    ("roll_rad", 3, 1.0),
    ("pitch_rad", 4, 1.0),
    ("yaw_rad", 5, 1.0),
    ("roll_deg", 3, std::f64::consts::PI / 180.0),
    ("pitch_deg", 4, std::f64::consts::PI / 180.0),
    ("yaw_deg", 5, std::f64::consts::PI / 180.0),
];

/// The lines with content, with their numbers from 1.
fn lines(text: &str) -> impl Iterator<Item = (&str, u64)> {
    let all = text.lines().zip(1_u64..).map(|(line, number)| (line.trim(), number));
    all.filter(|(line, _)| !line.is_empty() && !line.starts_with('#'))
}

/// Whether a text is a table of places of the hand: it has a column `x_m`.
#[must_use]
pub fn is_of_hand(text: &str) -> bool {
    lines(text).next().is_some_and(|(header, _)| header.split(',').any(|name| name.trim() == "x_m"))
}

/// Reads places of the hand: points, or poses where all three angles have a column.
///
/// # Errors
/// [`WaypointError::Form`] for other columns, [`WaypointError::Line`] for a row with other numbers than the header says.
pub fn read_hand(text: &str) -> Result<Vec<Goal>, WaypointError> {
    let mut lines = lines(text.trim_start_matches('\u{feff}'));
    let (header, _) = lines.next().ok_or(WaypointError::Empty)?;
    let mut columns = Vec::new();
    for name in header.split(',').map(str::trim) {
        let of = COLUMNS.iter().find(|(known, ..)| *known == name);
        let (_, place, factor) = of.copied().ok_or_else(|| WaypointError::Form {
            why: format!("the column \"{name}\" is not one of x_m, y_m, z_m, roll_deg, pitch_deg, yaw_deg"),
        })?;
        if columns.iter().any(|(other, _)| *other == place) {
            return Err(WaypointError::Twice { name: name.to_owned() });
        }
        columns.push((place, factor));
    }
    let has =
        |places: std::ops::Range<usize>| places.filter(|k| columns.iter().any(|(of, _)| of == k)).count();
    let turns = has(3..6);
    if has(0..3) != 3 || !matches!(turns, 0 | 3) {
        let why = "places of the hand need x_m, y_m and z_m, and either all three of roll, pitch and yaw or no angle";
        return Err(WaypointError::Form { why: why.to_owned() });
    }
    let mut goals = Vec::new();
    for (line, number) in lines {
        let refused = |why: String| WaypointError::Line { line: number, why };
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        if fields.len() != columns.len() {
            return Err(refused(format!("{} values for {} columns", fields.len(), columns.len())));
        }
        let mut values = [0.0; 6];
        for (field, (place, factor)) in fields.into_iter().zip(&columns) {
            let value = field.parse::<f64>().ok().filter(|value| value.is_finite());
            values[*place] = factor * value.ok_or_else(|| refused(format!("\"{field}\" is not a number")))?;
        }
        let [x, y, z, roll, pitch, yaw] = values;
        let place = Vector3::new(x, y, z);
        goals.push(match turns {
            0 => Goal::Point(place),
            _ => Goal::Pose(Pose::from_rpy([roll, pitch, yaw], place)),
        });
    }
    check_count(goals.len())?;
    Ok(goals)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_and_poses_are_read_in_any_order_of_columns() {
        let points = "# a corner\n z_m, x_m, y_m\n0.5,0.1,0.2\n";
        assert!(is_of_hand(points) && !is_of_hand("joint1,joint2\n0,1\n"));
        assert_eq!(read_hand(points), Ok(vec![Goal::Point(Vector3::new(0.1, 0.2, 0.5))]));
        let poses = read_hand("x_m,y_m,z_m,yaw_deg,roll_deg,pitch_deg\n1,2,3,90,0,0\n").unwrap();
        let [Goal::Pose(pose)] = poses[..] else { panic!("{poses:?}") };
        assert!((pose.rot * Vector3::x() - Vector3::y()).norm() < 1e-15);
    }

    #[test]
    fn tables_that_do_not_say_where_the_hand_is_are_refused_with_line_or_column() {
        let why = |text: &str| read_hand(text).unwrap_err().to_string();
        assert!(why("x_m,y_m\n0,0\n").contains("z_m"));
        assert!(why("x_m,y_m,z_m,yaw_deg\n0,0,0,0\n").contains("all three"));
        assert!(why("x_m,y_m,z_m,t_s\n").contains("t_s"));
        assert!(why("x_m,x_m,z_m\n").contains("x_m"));
        assert!(why("x_m,y_m,z_m\n0,0,0\n0,up,0\n").starts_with("line 3"));
        assert!(why("x_m,y_m,z_m\n0,0,nan\n").starts_with("line 2"));
        assert_eq!(read_hand("x_m,y_m,z_m\n"), Err(WaypointError::Empty));
    }
}
