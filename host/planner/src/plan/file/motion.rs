//! The motion of a plan file, and what older files had in its place.

use robot_model::JointVec;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::VERSION;
use crate::motion::{GripperEvent, Knot, Motion};

/// Longest list of knots.
const KNOTS_MAX: usize = 1_000_000;
/// Breaks of two joints nearer than this are one, s.
const SAME_TIME_S: f64 = 1e-7;

/// Knots and events. Between two knots each joint follows the cubic that position and speed at both ends determine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MotionInfo {
    /// Names of the joints in the robot file, from the base on.
    pub joints: Vec<String>,
    /// At least two, times ascending from 0; at rest in the first and in the last.
    pub knots: Vec<KnotInfo>,
    /// What happens to the gripper, within the motion.
    pub events: Vec<EventInfo>,
}

/// State of all joints at one time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct KnotInfo {
    /// Time from the start of the motion in s.
    pub t_s: f64,
    /// Joint angles in rad.
    pub q_rad: Vec<f64>,
    /// Joint speeds in rad/s.
    pub qd_rad_s: Vec<f64>,
}

/// What happens at a time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EventInfo {
    /// Time from the start of the motion in s.
    pub t_s: f64,
    /// What.
    pub event: GripperEvent,
}

impl MotionInfo {
    /// A motion as the file has it.
    pub fn of(joints: impl IntoIterator<Item = String>, motion: &Motion) -> Self {
        let list = |numbers: &JointVec| numbers.iter().copied().collect();
        let knots = motion.knots.iter().map(|knot| KnotInfo {
            t_s: knot.t_s,
            q_rad: list(&knot.q_rad),
            qd_rad_s: list(&knot.qd_rad_s),
        });
        Self {
            joints: joints.into_iter().collect(),
            knots: knots.collect(),
            events: motion.events.iter().map(|(t_s, event)| EventInfo { t_s: *t_s, event: *event }).collect(),
        }
    }

    /// The motion.
    #[must_use]
    pub fn to_motion(&self) -> Motion {
        let joints =
            |list: &[f64]| JointVec::from_fn(self.joints.len(), |j| list.get(j).copied().unwrap_or(0.0));
        let knots = self.knots.iter().map(|knot| Knot {
            t_s: knot.t_s,
            q_rad: joints(&knot.q_rad),
            qd_rad_s: joints(&knot.qd_rad_s),
        });
        Motion {
            knots: knots.collect(),
            events: self.events.iter().map(|event| (event.t_s, event.event)).collect(),
        }
    }

    /// Time of the last knot, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.knots.last().map_or(0.0, |knot| knot.t_s)
    }

    /// Conditions that the types cannot express.
    ///
    /// # Errors
    /// What is wrong, with its place.
    pub fn sound(&self) -> Result<(), String> {
        let joints = self.joints.len();
        if !(1..=8).contains(&joints) {
            return Err(format!("motion.joints has {joints} names, expected one to eight"));
        }
        if !(2..=KNOTS_MAX).contains(&self.knots.len()) {
            return Err(format!("motion.knots has {} knots, expected 2 to {KNOTS_MAX}", self.knots.len()));
        }
        let mut last_s = None;
        for (index, knot) in self.knots.iter().enumerate() {
            let follows = last_s.map_or(knot.t_s == 0.0, |last_s| knot.t_s > last_s) && knot.t_s.is_finite();
            if !follows {
                return Err(format!(
                    "knot {index} at {} s does not follow the one before; the first is at 0",
                    knot.t_s
                ));
            }
            last_s = Some(knot.t_s);
            for (name, list) in [("q_rad", &knot.q_rad), ("qd_rad_s", &knot.qd_rad_s)] {
                if list.len() != joints || !list.iter().all(|number| number.is_finite()) {
                    return Err(format!(
                        "knot {index}: {name} has {} numbers, expected {joints} finite ones",
                        list.len()
                    ));
                }
            }
        }
        let inside = 0.0..=self.duration_s();
        match self.events.iter().find(|event| !inside.contains(&event.t_s)) {
            Some(event) => Err(format!("an event at {} s is not within the motion", event.t_s)),
            None => Ok(()),
        }
    }
}

/// A joint of files before version 6.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OldJoint {
    name: String,
    segments: Vec<OldSegment>,
}

/// `q(t) = c₀ t³ + c₁ t² + c₂ t + c₃` in rad, t in s from the start of the motion.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OldSegment {
    t_start_s: f64,
    t_end_s: f64,
    coefficients_rad: Vec<f64>,
}

impl OldJoint {
    fn sound(&self) -> Result<(), String> {
        let mut t_s = 0.0;
        for segment in &self.segments {
            let OldSegment { t_start_s, t_end_s, coefficients_rad } = segment;
            let follows = (t_start_s - t_s).abs() <= 1e-9 && t_end_s > t_start_s;
            if !follows {
                return Err(format!(
                    "{}: a segment from {t_start_s} to {t_end_s} s does not follow {t_s} s",
                    self.name
                ));
            }
            if !(1..=4).contains(&coefficients_rad.len()) {
                return Err(format!(
                    "{}: a segment has {} coefficients; motions are cubics (4)",
                    self.name,
                    coefficients_rad.len()
                ));
            }
            t_s = *t_end_s;
        }
        Ok(())
    }

    /// Angle and speed, by the segment that begins at `t_s` or holds it.
    fn state_at(&self, t_s: f64) -> (f64, f64) {
        let segment = self.segments.iter().rev().find(|s| s.t_start_s <= t_s + SAME_TIME_S);
        let Some(segment) = segment.or(self.segments.first()) else { return (0.0, 0.0) };
        // Horner, highest power first, with the derivative beside it.
        segment.coefficients_rad.iter().fold((0.0, 0.0), |(q, qd), c| (q * t_s + c, qd * t_s + q))
    }
}

/// Gives a throw of a version before 6 the knots and the event that follow from its polynomials and its release.
///
/// # Errors
/// What is wrong with the old fields.
pub(super) fn upgrade(value: &mut Value) -> Result<(), String> {
    let Some(fields) = value.as_object_mut() else { return Err("it is not an object".to_owned()) };
    let joints = fields.remove("joints").ok_or("it has no field \"joints\"")?;
    let joints: Vec<OldJoint> = serde_json::from_value(joints).map_err(|e| e.to_string())?;
    for joint in &joints {
        joint.sound()?;
    }
    let mut times: Vec<f64> = joints
        .iter()
        .flat_map(|joint| joint.segments.iter().flat_map(|s| [s.t_start_s, s.t_end_s]))
        .collect();
    times.sort_by(f64::total_cmp);
    times.dedup_by(|late, early| *late - *early <= SAME_TIME_S);
    let knots: Vec<Value> = times
        .iter()
        .map(|&t_s| {
            let (q_rad, qd_rad_s): (Vec<f64>, Vec<f64>) =
                joints.iter().map(|joint| joint.state_at(t_s)).unzip();
            json!({ "t_s": t_s, "q_rad": q_rad, "qd_rad_s": qd_rad_s })
        })
        .collect();
    let names: Vec<&str> = joints.iter().map(|joint| joint.name.as_str()).collect();
    let release_s = fields.get("release_time_s").cloned().unwrap_or(Value::Null);
    let motion = json!({
        "joints": names,
        "knots": knots,
        "events": [{ "t_s": release_s, "event": GripperEvent::Open }],
    });
    fields.insert("motion".to_owned(), motion);
    fields.insert("version".to_owned(), VERSION.into());
    Ok(())
}
