//! Files of two-arm cells, in TOML: see `two_arms.toml`, which is built in.

use std::path::Path;

use nalgebra::Vector3;
use robot_model::{Pose, RobotModel};
use toml_reader::{DESCRIPTION_MAX_BYTES, DocumentError, Problem, Section, Source, Value, read_text};

use super::{ArmPlace, CupOptions, TwoArmOptions};
use crate::mechanics::{BallOptions, Cup, Surface};
use crate::tracker::scenario::{TrackerScenarioError, tracker, tracker_fault};

/// Version of these files that this program reads.
pub const SCHEMA_VERSION: i64 = 1;
pub const TWO_ARMS: &str = include_str!("two_arms.toml");

/// A file was refused: where, and why.
pub type TwoArmError = TrackerScenarioError;

impl TwoArmOptions {
    /// The built-in cell.
    ///
    /// # Errors
    /// Never, as its test shows.
    pub fn two_arms() -> Result<Self, TwoArmError> {
        Self::from_toml("two_arms.toml", TWO_ARMS)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read, or says something that no cell can.
    pub fn load(path: &Path) -> Result<Self, TwoArmError> {
        let file = path.display().to_string();
        match read_text(path, DESCRIPTION_MAX_BYTES) {
            Ok(text) => Self::from_toml(&file, &text),
            Err(error) => Err(DocumentError::of_file(&file, Problem::unreadable(&error))),
        }
    }

    /// Reads a text; `file` is what errors call it.
    ///
    /// # Errors
    /// The text says something that no cell can.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, TwoArmError> {
        let source = Source { file, text };
        let document = source.parse()?;
        let root: Section<'_> = source.root(&document);
        root.schema("schema_version", SCHEMA_VERSION)?;
        let seed = root.or("seed", 0, Value::count)?;
        let arms = root.sections("arm")?.iter().map(arm).collect::<Result<Vec<_>, _>>()?;
        let Ok(arms) = <[ArmPlace; 2]>::try_from(arms) else {
            return Err(root.error("arm", Problem::Invalid("a cell has two [[arm]] tables".to_owned())));
        };
        let ball = ball(&root.required("ball", Value::section)?)?;
        let cup = cup(&root.required("cup", Value::section)?, ball.radius_m)?;
        let table = root.required("ground", Value::section)?;
        let ground = surface(&table)?;
        table.finish()?;
        let mut tracker = tracker(&root.required("tracker", Value::section)?)?;
        for table in root.sections("fault")? {
            tracker.faults.push(tracker_fault(&table, &[])?);
        }
        root.finish()?;
        Ok(Self { arms, alone: false, ball, cup, ground, tracker, seed })
    }
}

fn arm(table: &Section<'_>) -> Result<ArmPlace, TwoArmError> {
    let name = table.required("robot", Value::text)?;
    let refused = |why: String| table.error("robot", Problem::Invalid(why));
    let model = RobotModel::load(name).map_err(|error| {
        table.error("robot", Problem::Named { what: error.to_string(), next: error.problem.next() })
    })?;
    if model.n() != 6 {
        return Err(refused(format!("robot {name} has {} joints; a cell has arms of six", model.n())));
    }
    let position = Vector3::from(table.required("base_m", Value::numbers::<3>)?);
    let rpy_deg: [f64; 3] = table.or("base_rpy_deg", [0.0; 3], Value::numbers)?;
    table.finish()?;
    Ok(ArmPlace { model, x_wb: Pose::from_rpy(rpy_deg.map(f64::to_radians), position) })
}

fn ball(table: &Section<'_>) -> Result<BallOptions, TwoArmError> {
    let d = BallOptions::default();
    let ball = BallOptions {
        radius_m: table.or("radius_m", d.radius_m, |v| v.number_in(0.005, 0.2))?,
        drag_1_m: table.or("drag_1_m", d.drag_1_m, |v| v.number_in(0.0, 1.0))?,
        lift: table.or("lift", d.lift, |v| v.number_in(-0.1, 0.1))?,
        inertia: table.or("inertia", d.inertia, |v| v.number_in(0.1, 1.0))?,
    };
    table.finish()?;
    Ok(ball)
}

fn surface(table: &Section<'_>) -> Result<Surface, TwoArmError> {
    Ok(Surface {
        restitution: table.required("restitution", |v| v.number_in(0.0, 1.0))?,
        friction: table.required("friction", |v| v.number_in(0.0, 2.0))?,
        rolling: table.or("rolling", 0.0, |v| v.number_in(0.0, 1.0))?,
        rest_m_s: table.required("rest_m_s", |v| v.number_in(0.0, 1.0))?,
    })
}

fn cup(table: &Section<'_>, ball_radius_m: f64) -> Result<CupOptions, TwoArmError> {
    let shape = Cup {
        inner_radius_m: table.required("inner_radius_m", |v| v.number_in(0.01, 0.5))?,
        depth_m: table.required("depth_m", |v| v.number_in(0.01, 0.5))?,
        wall_m: table.required("wall_m", |v| v.number_in(0.002, 0.05))?,
    };
    if shape.inner_radius_m <= ball_radius_m {
        let why = format!("the ball with its radius of {ball_radius_m} m does not fit in");
        return Err(table.error("inner_radius_m", Problem::Invalid(why)));
    }
    let cup = CupOptions {
        mouth_from_ee_m: table.required("mouth_from_ee_m", |v| v.number_in(-0.5, 0.5))?,
        shape,
        replaces: table
            .optional("replaces", |value| {
                value
                    .items()?
                    .iter()
                    .map(|item| item.text().map(str::to_owned))
                    .collect::<Result<Vec<_>, _>>()
            })?
            .unwrap_or_default(),
        surface: surface(table)?,
    };
    table.finish()?;
    Ok(cup)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_built_in_cell_is_read_and_its_arms_face_each_other() {
        let cell = TwoArmOptions::two_arms().unwrap();
        let ahead = |arm: &ArmPlace| arm.x_wb.rot.column(0).into_owned();
        assert!((ahead(&cell.arms[0]) + ahead(&cell.arms[1])).norm() < 1e-12);
        assert_eq!(cell.tracker.period.as_micros(), 8333);
    }

    #[test]
    fn a_cell_that_cannot_be_is_refused_with_the_key() {
        for (from, to, key) in [
            ("inner_radius_m = 0.07", "inner_radius_m = 0.02", "inner_radius_m"),
            ("robot = \"powercube6\"", "robot = \"pincher4\"", "robot"),
            ("restitution = 0.15", "restitution = 1.5", "restitution"),
            ("friction = 0.5", "friction = 0.5\nsand = 1", "sand"),
        ] {
            let text = TWO_ARMS.replace(from, to);
            let error = TwoArmOptions::from_toml("x.toml", &text).unwrap_err().to_string();
            assert!(error.contains(key) && error.contains("x.toml"), "{error}");
        }
        let one = TWO_ARMS.replacen("[[arm]]", "[[fault]]", 1);
        assert!(TwoArmOptions::from_toml("x.toml", &one).is_err());
    }
}
