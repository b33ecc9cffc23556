//! What the witness of a disc saw, for people and for programs.

use planner::disc::witness::Verdict;
use serde_json::{Value, json};

/// Numbers with `digits` after the point and commas between.
pub(super) fn list(values: impl IntoIterator<Item = f64>, digits: usize) -> String {
    let texts: Vec<String> = values.into_iter().map(|v| format!("{v:.digits$}")).collect();
    texts.join(", ")
}

/// Contact, place of the disc in the hand, and rates.
pub(super) fn seen_json(verdict: &Verdict) -> Value {
    let seen = verdict.caught.map(|c| c.1).or(verdict.nearest);
    json!({
        "caught": verdict.caught.is_some(),
        "touched": verdict.touched.as_ref().map(|t| json!({"t_s": t.t_s, "body": t.body})),
        "seen": seen.map(|s| json!({
            "t_s": s.t_s, "depth_m": s.depth_m, "tip_to_axis_m": s.tip_to_axis_m, "height_m": s.height_m,
            "lateral_m": s.lateral_m, "tilt_rad": s.tilt_rad,
        })),
        "clearance_m": verdict.clearance_m,
        "speed_rad_s": verdict.speed_rad_s.as_slice(),
        "acceleration_rad_s2": verdict.acceleration_rad_s2.as_slice(),
    })
}
