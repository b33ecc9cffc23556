//! Place of the tracker's room relative to the robot: a rigid transform from four or more points that both know.
//!
//! Three points determine a transform and check nothing: a point that is wrong across their plane, or a mirrored
//! room, fits as well. So the other points must predict each point.
//!
//! Least squares over rotation and translation (Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976).

use std::fmt::Write as _;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use toml_reader::{DESCRIPTION_MAX_BYTES, DocumentError, Problem, Section, Source, Value, quoted, read_text};

/// Version of the files that this program reads and writes.
pub const SCHEMA_VERSION: i64 = 1;
/// Points nearer to a line than this do not fix the rotation about it, and nearer to a plane do not show a mirrored room, m.
const SPREAD_MIN_M: f64 = 0.05;
/// Largest root mean square distance after the transform that a good calibration leaves, m.
const RESIDUAL_MAX_M: f64 = 0.003;
/// Largest distance of a point from where the others put it, m.
const FORETOLD_MAX_M: f64 = 0.010;
/// Lengths in both frames agree within this share; inches, feet and millimetres do not.
const SCALE_MAX: f64 = 0.02;

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

#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// The transform.
    pub x_wr: RoomToRobot,
    /// Root mean square distance of the points after the transform, m.
    pub residual_rms_m: f64,
    /// Distance of each pair, m.
    pub residuals_m: Vec<f64>,
    /// Distance of each pair from where the transform of the others puts it, m.
    pub foretold_m: Vec<f64>,
}

impl Solved {
    /// Whether the points agree.
    ///
    /// # Errors
    /// [`Unsolved::Disagree`].
    pub fn agree(&self) -> Result<(), Unsolved> {
        let worst = (0..).zip(&self.foretold_m).max_by(|a, b| a.1.total_cmp(b.1));
        let (worst, by_m) = worst.map_or((0, f64::NAN), |(k, by_m)| (k, *by_m));
        // Written so that NaN disagrees.
        let agree = self.residual_rms_m <= RESIDUAL_MAX_M && by_m <= FORETOLD_MAX_M;
        if agree {
            return Ok(());
        }
        Err(Unsolved::Disagree { rms_mm: 1e3 * self.residual_rms_m, point: worst + 1, by_mm: 1e3 * by_m })
    }
}

/// Pairs that give no transform.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unsolved {
    /// Too few.
    #[error(
        "{0} points; four are needed that do not lie in a plane: with three a wrong point and a mirrored room fit too"
    )]
    TooFew(usize),
    /// On a line, or in one place.
    #[error("the points lie within {spread_mm:.0} mm of a line; the rotation about it is open")]
    OnALine {
        /// How far the farthest is from the line.
        spread_mm: f64,
    },
    #[error("the points lie within {spread_mm:.0} mm of a plane; a mirrored room would fit as well")]
    InAPlane { spread_mm: f64 },
    #[error("a metre of the tracker is {ratio:.4} m of the robot")]
    OtherUnits { ratio: f64 },
    #[error("one of the frames is mirrored: the points fit as in a mirror, within {rms_mm:.1} mm")]
    Mirrored { rms_mm: f64 },
    #[error(
        "the points disagree by {rms_mm:.1} mm; point {point} is {by_mm:.1} mm from where the others put it"
    )]
    Disagree {
        rms_mm: f64,
        /// From 1.
        point: usize,
        by_mm: f64,
    },
}

impl Unsolved {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::TooFew(..) => "bring the tool to another place and add it".to_owned(),
            Self::OnALine { .. } => "add a point at least 50 mm, better half a metre, beside it".to_owned(),
            Self::InAPlane { .. } => "add a point at least 50 mm, better half a metre, above or below it".to_owned(),
            Self::OtherUnits { .. } => "give --tool-at in metres, and check the units of the tracker's output (DTrack sends mm, VRPN m) and its room calibration".to_owned(),
            Self::Mirrored { .. } => "check the signs and the order of x, y, z of --tool-at, and that the tracker's room is right-handed".to_owned(),
            Self::Disagree { .. } => "take the worst point out of the file, or measure it again".to_owned(),
        })
    }
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

/// The transform with the smallest sum of squared distances. The points may still disagree, see [`Solved::agree`].
///
/// # Errors
/// [`Unsolved`]: the points do not fix a transform, do not check each other, or belong to no rigid transform.
pub fn solve(pairs: &[Pair]) -> Result<Solved, Unsolved> {
    if pairs.len() < 4 {
        return Err(Unsolved::TooFew(pairs.len()));
    }
    let fit = Fit::of(pairs);
    let [plane_mm, line_mm] = [0, 1].map(|k| 1e3 * fit.spreads_m[k]);
    // Written so that NaN is refused.
    let within = |ratio: f64| (ratio - 1.0).abs() <= SCALE_MAX;
    if !within(fit.scale) {
        return Err(Unsolved::OtherUnits { ratio: fit.scale });
    }
    if line_mm < 1e3 * SPREAD_MIN_M {
        return Err(Unsolved::OnALine { spread_mm: line_mm });
    }
    if plane_mm < 1e3 * SPREAD_MIN_M {
        return Err(Unsolved::InAPlane { spread_mm: plane_mm });
    }
    let x_wr = fit.transform(1.0);
    let (residuals_m, residual_rms_m) = residuals(pairs, &x_wr);
    let mirrored_rms_m = residuals(pairs, &fit.transform(-1.0)).1;
    if residual_rms_m > RESIDUAL_MAX_M && mirrored_rms_m < 0.5 * residual_rms_m {
        return Err(Unsolved::Mirrored { rms_mm: 1e3 * mirrored_rms_m });
    }
    // The others are never nearer to a line than all points to a plane: the plane through the line and the point left out.
    let foretold_m = (0..pairs.len()).map(|k| {
        let others = Fit::of(&[&pairs[..k], &pairs[k + 1..]].concat());
        residuals(&pairs[k..=k], &others.transform(1.0)).1
    });
    Ok(Solved { x_wr, residual_rms_m, residuals_m, foretold_m: foretold_m.collect() })
}

/// Distance of each pair after a transform, and their root mean square, m.
fn residuals(pairs: &[Pair], x_wr: &RoomToRobot) -> (Vec<f64>, f64) {
    let residuals_m: Vec<f64> = pairs
        .iter()
        .map(|pair| (Vector3::from(x_wr.apply(&pair.room_m)) - Vector3::from(pair.robot_m)).norm())
        .collect();
    let squares: f64 = residuals_m.iter().map(|r| r * r).sum();
    let rms_m = (squares / pairs.len() as f64).sqrt();
    (residuals_m, rms_m)
}

/// What fits two sets of points to each other.
struct Fit {
    robot_mean: Vector3<f64>,
    room_mean: Vector3<f64>,
    u: Matrix3<f64>,
    v_t: Matrix3<f64>,
    /// How far the room's points are from a plane, from a line, and from one place, m.
    spreads_m: [f64; 3],
    /// Lengths of the robot's points over those of the room's.
    scale: f64,
}

impl Fit {
    fn of(pairs: &[Pair]) -> Self {
        let mean = |of: fn(&Pair) -> [f64; 3]| {
            pairs.iter().map(|pair| Vector3::from(of(pair))).sum::<Vector3<f64>>() / pairs.len() as f64
        };
        let (robot_mean, room_mean) = (mean(|pair| pair.robot_m), mean(|pair| pair.room_m));
        let (mut cross, mut own, mut robot_squares) = (Matrix3::zeros(), Matrix3::zeros(), 0.0);
        for pair in pairs {
            let robot = Vector3::from(pair.robot_m) - robot_mean;
            let room = Vector3::from(pair.room_m) - room_mean;
            cross += robot * room.transpose();
            own += room * room.transpose();
            robot_squares += robot.norm_squared();
        }
        let mut spreads = own.symmetric_eigenvalues();
        spreads.as_mut_slice().sort_by(f64::total_cmp);
        let svd = cross.svd(true, true);
        let [u, v_t] = [svd.u, svd.v_t].map(|part| part.unwrap_or_else(Matrix3::identity));
        let scale = (robot_squares / own.trace()).sqrt();
        Self { robot_mean, room_mean, u, v_t, spreads_m: spreads.map(|s| s.max(0.0).sqrt()).into(), scale }
    }

    /// The best transform: a rotation, or with `handedness` -1 a rotation and a mirror.
    fn transform(&self, handedness: f64) -> RoomToRobot {
        let sign = (self.u * self.v_t).determinant().signum() * handedness;
        let rotation = self.u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * self.v_t;
        RoomToRobot { rotation, translation_m: self.robot_mean - rotation * self.room_mean }
    }
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
    pub fn load(path: &Path) -> Result<Self, FileError> {
        let file = path.display().to_string();
        let text = read_text(path, DESCRIPTION_MAX_BYTES)
            .map_err(|error| DocumentError::of_file(&file, Problem::unreadable(&error)))?;
        Self::from_toml(&file, &text)
    }

    /// Reads a text; `file` is its name in errors. Results in the file are for people: they are computed again.
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
    fn mirrored_rooms_and_other_units_are_refused() {
        for axis in 0..3 {
            let mut pairs = pairs(2e-4);
            for pair in &mut pairs {
                pair.robot_m[axis] = -pair.robot_m[axis];
            }
            assert!(matches!(solve(&pairs), Err(Unsolved::Mirrored { rms_mm }) if rms_mm < 1.0), "{axis}");
        }
        for ratio in [1000.0, 1e-3, 0.0254, 1.03] {
            let mut pairs = pairs(0.0);
            for pair in &mut pairs {
                pair.robot_m = pair.robot_m.map(|x| ratio * x);
            }
            let refused = solve(&pairs).expect_err("other units");
            assert!(
                matches!(refused, Unsolved::OtherUnits { ratio: r } if (r / ratio - 1.0).abs() < 1e-9),
                "{refused}"
            );
        }
    }

    /// The point that is left out of each set fits any three others.
    #[test]
    fn one_point_that_is_30_mm_off_is_found_in_every_direction() {
        for (point, direction) in (0..4).flat_map(|point| (0..26).map(move |k| (point, k))) {
            let mut pairs = pairs(2e-4);
            let k = f64::from(direction);
            let off =
                Vector3::new((1.7 * k).sin(), (0.9 * k).cos(), (2.3 * k + 1.0).sin()).normalize() * 0.03;
            pairs[point].robot_m = (Vector3::from(pairs[point].robot_m) + off).into();
            let judged = solve(&pairs).and_then(|solved| solved.agree());
            assert!(matches!(judged, Err(Unsolved::Disagree { by_mm, .. }) if by_mm > 20.0), "{judged:?}");
        }
        assert_eq!(solve(&pairs(2e-4)).and_then(|solved| solved.agree()), Ok(()));
    }

    #[test]
    fn points_that_do_not_check_each_other_are_refused() {
        assert_eq!(solve(&pairs(0.0)[..3]), Err(Unsolved::TooFew(3)));
        let at = |rooms: &[[f64; 3]]| -> Vec<Pair> {
            let pair =
                |room_m: &[f64; 3]| Pair { robot_m: truth().apply(room_m), room_m: *room_m, scatter_m: 0.0 };
            rooms.iter().map(pair).collect()
        };
        let on_a_line = at(&[0.0, 0.2, 0.4, 0.6, 0.8].map(|y| [0.0, y, 1.0]));
        assert!(matches!(solve(&on_a_line), Err(Unsolved::OnALine { .. })));
        let in_a_plane = at(&[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.02], [1.0, 1.0, 1.0]]);
        assert!(matches!(solve(&in_a_plane), Err(Unsolved::InAPlane { .. })));
        // Three are near a line: the fourth alone would determine the rotation about it.
        let alone = at(&[[0.0, 0.0, 1.0], [0.5, 0.06, 1.0], [1.0, 0.0, 1.0], [0.5, 0.8, 1.9]]);
        assert!(matches!(solve(&alone), Err(Unsolved::InAPlane { .. })), "{:?}", solve(&alone));
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
