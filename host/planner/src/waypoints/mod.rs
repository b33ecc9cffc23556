//! Waypoints from elsewhere: comma-separated values, or the message `trajectory_msgs/JointTrajectory` as JSON or YAML.
//!
//! | form | columns or fields |
//! |---|---|
//! | CSV | a header; a column for each joint, by its name, in any order: `joint1` or `q_joint1_rad` in rad, `joint1_deg` in degrees; `t_s` and `qd_joint1_rad_s` if there are times and speeds; lines that begin with `#` are comments |
//! | CSV of the hand | `x_m`, `y_m`, `z_m` in the frame of the base, and `roll_deg`, `pitch_deg`, `yaw_deg` if it is to turn; without times |
//! | JSON, YAML | `joint_names`, `points` with `positions` (rad), and `velocities` (rad/s) and `time_from_start` if there are any |
//!
//! Times are in all rows or in no row, and so are speeds. Accelerations and efforts are ignored: the motion between
//! the points follows from positions, times and speeds.

mod hand;
mod yaml;

pub use hand::{is_of_hand, read_hand};

use serde::Deserialize;

/// Waypoints of all joints of an arm, base first.
#[derive(Debug, Clone, PartialEq)]
pub struct Waypoints {
    /// At least one.
    pub rows: Vec<Waypoint>,
    /// Every row has a time.
    pub timed: bool,
}

/// One of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Waypoint {
    /// s, where given.
    pub t_s: Option<f64>,
    /// rad.
    pub q_rad: Vec<f64>,
    /// rad/s, where given.
    pub qd_rad_s: Option<Vec<f64>>,
}

/// Most rows of a file.
pub const ROWS_MAX: usize = 1_000_000;

/// A file is refused. Lines and points count from 1.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WaypointError {
    #[error("it is neither a table with a column for each joint nor a JointTrajectory: {why}")]
    Form { why: String },
    #[error("line {line}: {why}")]
    Line { line: u64, why: String },
    #[error("joint \"{joint}\" of the arm has no column; it needs one named {joint} (rad) or {joint}_deg")]
    NoJoint { joint: String, known: Vec<String> },
    #[error("\"{name}\" is no joint of this arm")]
    NoSuchJoint { name: String, known: Vec<String> },
    #[error("\"{name}\" stands there twice")]
    Twice { name: String },
    #[error("point {point}: {found} {what}, there are {wanted} joints")]
    Length { point: usize, what: &'static str, found: usize, wanted: usize },
    #[error("point {point}: no {what}, but other points have them")]
    Uneven { point: usize, what: &'static str },
    #[error("it has no points")]
    Empty,
    #[error("it has more than {ROWS_MAX} points")]
    TooLong,
}

impl WaypointError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::NoJoint { known, .. } => format!("name the columns {}", known.join(",")),
            Self::NoSuchJoint { known, .. } => format!("name them {}", known.join(",")),
            Self::Uneven { .. } => "give them in all points or leave them out".to_owned(),
            _ => return None,
        })
    }
}

/// Reads waypoints for an arm with these joints.
///
/// # Errors
/// [`WaypointError`].
pub fn read(text: &str, joints: &[&str]) -> Result<Waypoints, WaypointError> {
    let body = text.trim_start_matches('\u{feff}');
    let rows = match body.trim_start().chars().next() {
        Some('{') => {
            let message =
                serde_json::from_str(body).map_err(|e| WaypointError::Form { why: e.to_string() })?;
            of_message(message, joints)?
        }
        None => return Err(WaypointError::Empty),
        _ if is_yaml(body) => {
            let refused = |why: String| WaypointError::Form { why };
            let value = yaml::read(body).map_err(refused)?;
            let message = serde_json::from_value(value).map_err(|e| refused(e.to_string()))?;
            of_message(message, joints)?
        }
        _ => of_table(body, joints)?,
    };
    let timed = all_or_none(&rows, "time", |row| row.t_s.is_some())?;
    all_or_none(&rows, "speeds", |row| row.qd_rad_s.is_some())?;
    Ok(Waypoints { rows, timed })
}

/// The first line with content begins a mapping.
fn is_yaml(text: &str) -> bool {
    let first = text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#'));
    first.is_some_and(|line| line == "---" || line.split(',').next().is_some_and(|word| word.contains(':')))
}

fn all_or_none(
    rows: &[Waypoint],
    what: &'static str,
    has: impl Fn(&Waypoint) -> bool,
) -> Result<bool, WaypointError> {
    let count = rows.iter().filter(|row| has(row)).count();
    if count == 0 || count == rows.len() {
        return Ok(count > 0);
    }
    let point = rows.iter().position(|row| !has(row)).unwrap_or(0) + 1;
    Err(WaypointError::Uneven { point, what })
}

// trajectory_msgs/JointTrajectory

#[derive(Deserialize)]
struct Message {
    joint_names: Vec<String>,
    points: Vec<MessagePoint>,
}

#[derive(Deserialize)]
struct MessagePoint {
    positions: Vec<f64>,
    #[serde(default)]
    velocities: Vec<f64>,
    time_from_start: Option<Since>,
}

/// `builtin_interfaces/Duration` of ROS 2, that of ROS 1, or seconds.
#[derive(Deserialize)]
#[serde(untagged)]
enum Since {
    Seconds(f64),
    Two { sec: f64, nanosec: f64 },
    One { secs: f64, nsecs: f64 },
}

impl Since {
    fn seconds(&self) -> f64 {
        match self {
            Self::Seconds(s) => *s,
            Self::Two { sec: s, nanosec: ns } | Self::One { secs: s, nsecs: ns } => s + 1e-9 * ns,
        }
    }
}

fn of_message(message: Message, joints: &[&str]) -> Result<Vec<Waypoint>, WaypointError> {
    let known = || joints.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let mut place = vec![None; joints.len()];
    for (column, name) in message.joint_names.iter().enumerate() {
        let Some(joint) = joints.iter().position(|joint| joint == name) else {
            return Err(WaypointError::NoSuchJoint { name: name.clone(), known: known() });
        };
        if place[joint].replace(column).is_some() {
            return Err(WaypointError::Twice { name: name.clone() });
        }
    }
    let missing = |joint: usize| WaypointError::NoJoint { joint: joints[joint].to_owned(), known: known() };
    let order: Vec<usize> = place
        .iter()
        .enumerate()
        .map(|(joint, column)| column.ok_or_else(|| missing(joint)))
        .collect::<Result<_, _>>()?;
    check_count(message.points.len())?;
    let sorted = |values: &[f64]| order.iter().map(|column| values[*column]).collect::<Vec<_>>();
    let of_point = |(i, point): (usize, MessagePoint)| {
        let fits = |values: &[f64], what| {
            let (found, wanted) = (values.len(), joints.len());
            if found == wanted {
                Ok(())
            } else {
                Err(WaypointError::Length { point: i + 1, what, found, wanted })
            }
        };
        fits(&point.positions, "positions")?;
        let speeds = (!point.velocities.is_empty()).then_some(&point.velocities);
        speeds.map_or(Ok(()), |v| fits(v, "velocities"))?;
        Ok(Waypoint {
            t_s: point.time_from_start.as_ref().map(Since::seconds),
            q_rad: sorted(&point.positions),
            qd_rad_s: speeds.map(|v| sorted(v)),
        })
    };
    message.points.into_iter().enumerate().map(of_point).collect()
}

fn check_count(rows: usize) -> Result<(), WaypointError> {
    match rows {
        0 => Err(WaypointError::Empty),
        rows if rows > ROWS_MAX => Err(WaypointError::TooLong),
        _ => Ok(()),
    }
}

// Tables

/// What a column holds.
#[derive(Clone, Copy, PartialEq)]
enum Column {
    Time,
    /// Of a joint, with the factor to rad.
    Angle(usize, f64),
    Speed(usize),
    /// Read over.
    Acceleration,
}

fn column(name: &str, joints: &[&str]) -> Option<Column> {
    if name == "t_s" {
        return Some(Column::Time);
    }
    if name.strip_prefix("qdd_").is_some_and(|rest| rest.ends_with("_rad_s2")) {
        return Some(Column::Acceleration);
    }
    let degree = 1_f64.to_radians();
    joints.iter().enumerate().find_map(|(k, joint)| {
        let forms = [
            (joint.to_string(), Column::Angle(k, 1.0)),
            (format!("{joint}_rad"), Column::Angle(k, 1.0)),
            (format!("q_{joint}_rad"), Column::Angle(k, 1.0)),
            (format!("{joint}_deg"), Column::Angle(k, degree)),
            (format!("q_{joint}_deg"), Column::Angle(k, degree)),
            (format!("qd_{joint}_rad_s"), Column::Speed(k)),
        ];
        forms.into_iter().find(|(form, _)| form == name).map(|(_, column)| column)
    })
}

fn of_table(text: &str, joints: &[&str]) -> Result<Vec<Waypoint>, WaypointError> {
    let known = || joints.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let mut lines = text
        .lines()
        .zip(1_u64..)
        .map(|(line, number)| (line.trim(), number))
        .filter(|(line, _)| !line.is_empty() && !line.starts_with('#'));
    let (header, _) = lines.next().ok_or(WaypointError::Empty)?;
    let mut columns = Vec::new();
    for name in header.split(',').map(str::trim) {
        let found = column(name, joints)
            .ok_or_else(|| WaypointError::NoSuchJoint { name: name.to_owned(), known: known() })?;
        let same = |other: &Column| match (other, &found) {
            (Column::Angle(a, _), Column::Angle(b, _)) => a == b,
            (Column::Acceleration, _) => false,
            (other, found) => *other == *found,
        };
        if columns.iter().any(same) {
            return Err(WaypointError::Twice { name: name.to_owned() });
        }
        columns.push(found);
    }
    for (k, joint) in joints.iter().enumerate() {
        if !columns.iter().any(|column| matches!(column, Column::Angle(of, _) if *of == k)) {
            return Err(WaypointError::NoJoint { joint: (*joint).to_owned(), known: known() });
        }
    }
    let timed = columns.contains(&Column::Time);
    let speeds = columns.iter().filter(|column| matches!(column, Column::Speed(_))).count();
    if speeds != 0 && speeds != joints.len() {
        return Err(WaypointError::Length {
            point: 1,
            what: "columns of speeds",
            found: speeds,
            wanted: joints.len(),
        });
    }
    let mut rows = Vec::new();
    for (line, number) in lines {
        let refused = |why: String| WaypointError::Line { line: number, why };
        let mut row = Waypoint {
            t_s: timed.then_some(0.0),
            q_rad: vec![0.0; joints.len()],
            qd_rad_s: (speeds > 0).then(|| vec![0.0; joints.len()]),
        };
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        if fields.len() != columns.len() {
            return Err(refused(format!("{} values for {} columns", fields.len(), columns.len())));
        }
        for (field, column) in fields.into_iter().zip(&columns) {
            let value: f64 = field.parse().map_err(|_| refused(format!("\"{field}\" is not a number")))?;
            match column {
                Column::Time => row.t_s = Some(value),
                Column::Angle(k, factor) => row.q_rad[*k] = value * factor,
                Column::Speed(k) => row.qd_rad_s.iter_mut().for_each(|speeds| speeds[*k] = value),
                Column::Acceleration => {}
            }
        }
        rows.push(row);
        if rows.len() > ROWS_MAX {
            return Err(WaypointError::TooLong);
        }
    }
    check_count(rows.len())?;
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    const JOINTS: [&str; 2] = ["base", "elbow"];

    /// Time, angles and speeds of a row.
    type Numbers = (Option<f64>, Vec<f64>, Option<Vec<f64>>);

    fn rows(text: &str) -> Vec<Numbers> {
        let read = read(text, &JOINTS).unwrap();
        read.rows.into_iter().map(|row| (row.t_s, row.q_rad, row.qd_rad_s)).collect()
    }

    #[test]
    fn tables_are_read_by_column_names_in_any_order_and_unit() {
        let wanted = vec![(None, vec![0.5, 1.0], None), (None, vec![-0.5, 2.0], None)];
        assert_eq!(rows("base,elbow\n0.5,1\n-0.5,2\n"), wanted);
        assert_eq!(rows("\u{feff}# drawn\r\n elbow , base\r\n1,0.5\r\n\r\n2,-0.5\r\n"), wanted);
        let degrees = rows("t_s,base_deg,elbow\n0,90,0\n1,180,0.1\n");
        assert_eq!((degrees[1].0, degrees[1].1[0]), (Some(1.0), std::f64::consts::PI));
        let exported =
            rows("t_s,q_base_rad,q_elbow_rad,qd_base_rad_s,qd_elbow_rad_s,qdd_base_rad_s2\n0,1,2,3,4,5\n");
        assert_eq!(exported, [(Some(0.0), vec![1.0, 2.0], Some(vec![3.0, 4.0]))]);
    }

    #[test]
    fn joint_trajectories_are_read_as_json_and_yaml() {
        let json = r#"{"header": {}, "joint_names": ["elbow", "base"], "points": [
            {"positions": [1, 0.5], "velocities": [0, 0.25], "effort": [], "time_from_start": {"sec": 1, "nanosec": 500000000}}]}"#;
        let wanted = vec![(Some(1.5), vec![0.5, 1.0], Some(vec![0.25, 0.0]))];
        assert_eq!(rows(json), wanted);
        let yaml = "joint_names: [elbow, base]\npoints:\n- positions: [1, 0.5]\n  velocities: [0, 0.25]\n  time_from_start: {secs: 1, nsecs: 500000000}\n";
        assert_eq!(rows(yaml), wanted);
        assert_eq!(rows(&format!("---\n{yaml}")), wanted);
        let seconds = "joint_names: [base, elbow]\npoints:\n- positions: [0.5, 1]\n  time_from_start: 1.5\n";
        assert_eq!(rows(seconds), [(Some(1.5), vec![0.5, 1.0], None)]);
    }

    #[test]
    fn files_that_are_no_waypoints_are_refused_with_the_place() {
        let refused = |text: &str| read(text, &JOINTS).unwrap_err().to_string();
        for (text, part) in [
            ("", "no points"),
            ("base,elbow\n", "no points"),
            ("base\n1\n", "joint \"elbow\" of the arm has no column"),
            ("base,elbow,wrist\n1,2,3\n", "\"wrist\" is no joint"),
            ("base,elbow,base_deg\n1,2,3\n", "\"base_deg\" stands there twice"),
            ("base,elbow\n1,2\n1,x\n", "line 3: \"x\" is not a number"),
            ("base,elbow\n1,2,3\n", "line 2: 3 values for 2 columns"),
            ("base,elbow,qd_base_rad_s\n1,2,3\n", "columns of speeds"),
            (r#"{"joint_names": ["base"], "points": []}"#, "joint \"elbow\" of the arm has no column"),
            (r#"{"joint_names": ["base","elbow"], "points": [{"positions": [1]}]}"#, "point 1: 1 positions"),
            (
                r#"{"joint_names": ["base","elbow"], "points": [{"positions": [1,2], "time_from_start": 1.0}, {"positions": [1,2]}]}"#,
                "point 2: no time",
            ),
            ("{", "neither a table"),
            ("joint_names: 3\npoints: x\n", "neither a table"),
        ] {
            let found = refused(text);
            assert!(found.contains(part), "{text:?}: {found}");
        }
    }
}
