//! Where the room of the tracker is, seen from the robot: a rigid transform from three or more points that both know.
//!
//! Least squares over rotation and translation (Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976).

use std::fmt::Write as _;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use toml_reader::{DESCRIPTION_MAX_BYTES, DocumentError, Problem, Section, Source, Value, quoted, read_text};

/// Version of the files that this program reads and writes.
pub const SCHEMA_VERSION: i64 = 1;
/// Points nearer to a line than this do not fix the rotation about it, m.
const SPREAD_MIN_M: f64 = 0.05;
/// Largest difference of the points of one pair from the transform that a good calibration leaves, m.
pub const RESIDUAL_MAX_M: f64 = 0.003;

/// A file was refused: where, and why.
pub type FileError = DocumentError<Problem>;

/// One point as both see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// In the robot's base frame, m.
    pub robot_m: [f64; 3],
    /// In the tracker's room, m.
    pub room_m: [f64; 3],
    /// Scatter of the frames, m.
    pub scatter_m: f64,
}

/// From room to robot: `p_robot = rotation p_room + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoomToRobot {
    pub rotation: Matrix3<f64>,
    pub translation_m: Vector3<f64>,
}

/// A solved calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// The transform.
    pub x_wr: RoomToRobot,
    /// Root mean square distance of the points after the transform, m.
    pub residual_rms_m: f64,
    /// Distance of each pair, m.
    pub residuals_m: Vec<f64>,
}

/// Pairs that give no transform.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unsolved {
    /// Too few.
    #[error(
        "{0} points; three are needed that do not lie on a line\n  next: bring the tool to another place and add it"
    )]
    TooFew(usize),
    /// On a line, or in one place.
    #[error(
        "the points lie within {spread_mm:.0} mm of a line; the rotation about it is open\n  next: add a point at least 50 mm, better half a metre, beside it"
    )]
    OnALine {
        /// How far the farthest is from the line.
        spread_mm: f64,
    },
}

impl RoomToRobot {
    /// The robot's frame is the room's.
    #[must_use]
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation_m: Vector3::zeros() }
    }

    /// A point of the room in the robot's frame, m.
    #[must_use]
    pub fn apply(&self, room_m: &[f64; 3]) -> [f64; 3] {
        (self.rotation * Vector3::from(*room_m) + self.translation_m).into()
    }
}

/// The transform with the smallest sum of squared distances.
///
/// # Errors
/// [`Unsolved`].
pub fn solve(pairs: &[Pair]) -> Result<Solved, Unsolved> {
    if pairs.len() < 3 {
        return Err(Unsolved::TooFew(pairs.len()));
    }
    let mean = |of: fn(&Pair) -> [f64; 3]| {
        pairs.iter().map(|pair| Vector3::from(of(pair))).sum::<Vector3<f64>>() / pairs.len() as f64
    };
    let (robot_mean, room_mean) = (mean(|pair| pair.robot_m), mean(|pair| pair.room_m));
    let (mut cross, mut own) = (Matrix3::zeros(), Matrix3::zeros());
    for pair in pairs {
        let robot = Vector3::from(pair.robot_m) - robot_mean;
        let room = Vector3::from(pair.room_m) - room_mean;
        cross += robot * room.transpose();
        own += room * room.transpose();
    }
    // The second largest spread: zero for points on a line.
    let mut spreads: Vec<f64> = own.symmetric_eigenvalues().iter().copied().collect();
    spreads.sort_by(f64::total_cmp);
    let spread_m = spreads[1].max(0.0).sqrt();
    // Written so that NaN is refused.
    let spread_out = spread_m >= SPREAD_MIN_M;
    if !spread_out {
        return Err(Unsolved::OnALine { spread_mm: 1e3 * spread_m });
    }
    let svd = cross.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Err(Unsolved::OnALine { spread_mm: 0.0 }) };
    // No reflection.
    let sign = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    let x_wr = RoomToRobot { rotation, translation_m: robot_mean - rotation * room_mean };
    let residuals_m: Vec<f64> = pairs
        .iter()
        .map(|pair| (Vector3::from(x_wr.apply(&pair.room_m)) - Vector3::from(pair.robot_m)).norm())
        .collect();
    let squares: f64 = residuals_m.iter().map(|r| r * r).sum();
    Ok(Solved { x_wr, residual_rms_m: (squares / pairs.len() as f64).sqrt(), residuals_m })
}

/// A calibration file: points, what they give, and where they come from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Calibration {
    /// Robot whose frame it is.
    pub robot: String,
    /// Tracker and body.
    pub source: String,
    /// When the last point was added, as text.
    pub changed: String,
    /// The points.
    pub pairs: Vec<Pair>,
}

impl Calibration {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or says something else.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        let file = path.display().to_string();
        let text = read_text(path, DESCRIPTION_MAX_BYTES)
            .map_err(|error| DocumentError::of_file(&file, Problem::Unreadable(error.to_string())))?;
        Self::from_toml(&file, &text)
    }

    /// Reads a text; `file` is what errors call it. Results in the file are for people: they are computed again.
    ///
    /// # Errors
    /// The text says something else.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, FileError> {
        let source = Source { file, text };
        let document = source.parse()?;
        let root: Section<'_> = source.root(&document);
        root.schema("schema_version", SCHEMA_VERSION)?;
        let (robot, from, changed) = (
            root.required("robot", Value::text)?.to_owned(),
            root.required("source", Value::text)?.to_owned(),
            root.required("changed", Value::text)?.to_owned(),
        );
        let mut pairs = Vec::new();
        for table in root.sections("point")? {
            pairs.push(Pair {
                robot_m: table.required("robot_m", Value::numbers)?,
                room_m: table.required("room_m", Value::numbers)?,
                scatter_m: table.required("scatter_m", Value::non_negative)?,
            });
            table.finish()?;
        }
        if let Some(result) = root.optional("result", Value::section)? {
            let _: [f64; 9] = result.required("rotation_rows", Value::numbers)?;
            let _: [f64; 3] = result.required("translation_m", Value::numbers)?;
            result.required("residual_rms_m", Value::non_negative)?;
            result.finish()?;
        }
        root.finish()?;
        Ok(Self { robot, source: from, changed, pairs })
    }

    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut text = format!(
            "# Where the room of a tracker is, seen from a robot. `cubectl tracker calibrate` adds points and solves.\n\
             schema_version = {SCHEMA_VERSION}\nrobot = {}\nsource = {}\nchanged = {}\n",
            quoted(&self.robot),
            quoted(&self.source),
            quoted(&self.changed)
        );
        for pair in &self.pairs {
            let _ = write!(
                text,
                "\n[[point]]\nrobot_m = {:?}\nroom_m = {:?}\nscatter_m = {:?}\n",
                pair.robot_m, pair.room_m, pair.scatter_m
            );
        }
        if let Ok(solved) = solve(&self.pairs) {
            let rows: [f64; 9] = std::array::from_fn(|k| solved.x_wr.rotation[(k / 3, k % 3)]);
            let translation: [f64; 3] = solved.x_wr.translation_m.into();
            let _ = write!(
                text,
                "\n# p_robot = rotation p_room + translation\n[result]\nrotation_rows = {rows:?}\ntranslation_m = {translation:?}\nresidual_rms_m = {:?}\n",
                solved.residual_rms_m
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    fn truth() -> RoomToRobot {
        let rotation = Rotation3::from_euler_angles(0.1, -0.2, 2.0).into_inner();
        RoomToRobot { rotation, translation_m: Vector3::new(-0.4, 1.2, 0.3) }
    }

    fn pairs(noise_m: f64) -> Vec<Pair> {
        let rooms = [[0.0, 0.0, 1.0], [1.0, 0.2, 0.8], [0.3, 0.9, 1.4], [1.1, 1.0, 0.2]];
        (0..)
            .zip(rooms)
            .map(|(k, room_m)| {
                let mut robot_m = truth().apply(&room_m);
                robot_m[k % 3] += noise_m;
                Pair { robot_m, room_m, scatter_m: 2e-4 }
            })
            .collect()
    }

    #[test]
    fn transform_of_exact_points_is_found_and_noise_shows_in_the_residual() {
        let solved = solve(&pairs(0.0)).unwrap();
        assert!((solved.x_wr.rotation - truth().rotation).amax() < 1e-12);
        assert!(solved.residual_rms_m < 1e-12);
        let noisy = solve(&pairs(1e-3)).unwrap();
        assert!((2e-4..1e-3).contains(&noisy.residual_rms_m), "{}", noisy.residual_rms_m);
        let away = Vector3::from(noisy.x_wr.apply(&[0.5, 0.5, 1.0]))
            - Vector3::from(truth().apply(&[0.5, 0.5, 1.0]));
        assert!(away.norm() < 2e-3, "{away:?}");
    }

    #[test]
    fn mirrored_points_give_a_rotation_and_a_large_residual() {
        let mut pairs = pairs(0.0);
        for pair in &mut pairs {
            pair.robot_m[2] = -pair.robot_m[2];
        }
        let solved = solve(&pairs).unwrap();
        assert!((solved.x_wr.rotation.determinant() - 1.0).abs() < 1e-9);
        assert!(solved.residual_rms_m > 0.05);
    }

    #[test]
    fn too_few_points_and_points_on_a_line_are_refused() {
        assert_eq!(solve(&pairs(0.0)[..2]), Err(Unsolved::TooFew(2)));
        let on_a_line: Vec<Pair> = (0..5)
            .map(|k| Pair {
                robot_m: [0.2 * f64::from(k), 0.0, 0.0],
                room_m: [0.0, 0.2 * f64::from(k), 1.0],
                scatter_m: 0.0,
            })
            .collect();
        assert!(matches!(solve(&on_a_line), Err(Unsolved::OnALine { .. })));
    }

    #[test]
    fn file_reads_back_and_wrong_files_are_refused() {
        let calibration = Calibration {
            robot: "kr16_2".to_owned(),
            source: "dtrack 0.0.0.0:5000 body 1".to_owned(),
            changed: "2026-11-22".to_owned(),
            pairs: pairs(1e-4),
        };
        let text = calibration.to_toml();
        assert_eq!(Calibration::from_toml("c.toml", &text), Ok(calibration));
        assert!(Calibration::from_toml("c.toml", &text.replace("room_m", "rom_m")).is_err());
        assert!(Calibration::from_toml("c.toml", "schema_version = 9\n").is_err());
    }
}
