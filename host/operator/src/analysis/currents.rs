//! Measured currents against the robot model's, per supply (figure 2 and 3 of the throwing paper).
//!
//! The current of a drive is read from time to time, of another drive each time. Between two readings of a drive
//! its current is assumed to change linearly; a supply carries the sum of magnitudes, eq. (8).

use serde::Serialize;

use super::collect::{Heard, Reading};
use super::tracking::interpolate;
use super::{AFTER_S, BEFORE_S, Run};

/// Distance of the points of predicted curves, s.
const STEP_S: f64 = 0.005;

#[derive(Clone, Debug, Serialize)]
pub struct SupplyCurrents {
    /// Name in the robot file.
    pub name: String,
    pub joints: Vec<String>,
    pub limit_a: f64,
    /// Largest predicted current over the plan, A.
    pub predicted_peak_a: f64,
    /// Largest measured current during the plan, A; `None` if no current was read.
    pub measured_peak_a: Option<f64>,
    /// Root of the mean square of measured minus predicted current during the plan, A.
    pub difference_rms_a: Option<f64>,
    /// Readings behind it.
    pub readings: usize,
    /// Predicted by the model along the plan.
    #[serde(skip)]
    pub predicted: Vec<Reading>,
    /// Sum of the magnitudes read from the drives.
    #[serde(skip)]
    pub measured: Vec<Reading>,
}

/// Currents of all supplies; empty for a robot whose file has no drives or no supplies.
#[must_use]
pub fn supplies(run: &Run<'_>, heard: &Heard) -> Vec<SupplyCurrents> {
    let Run { motion, arm, .. } = *run;
    let (from_s, end_s) = (-BEFORE_S, motion.duration_s());
    let steps = ((end_s + AFTER_S - from_s) / STEP_S).ceil() as u32;
    let holding = run.throw.and_then(|plan| Some((arm.holding_ball()?, plan.release_time_s)));
    let motors: Option<Vec<(f64, _)>> = (0..=steps)
        .map(|i| {
            let t_s = from_s + STEP_S * f64::from(i);
            let s = motion.at(t_s);
            let held = holding.as_ref().filter(|(_, release_s)| t_s <= *release_s);
            let moved = held.map_or(arm, |(holding, _)| holding);
            arm.motor_currents(&s.qd, &moved.inverse_dynamics(&s.q, &s.qd, &s.qdd)).map(|i_a| (t_s, i_a))
        })
        .collect();
    let Some(motors) = motors else { return Vec::new() };
    arm.supplies()
        .iter()
        .map(|supply| {
            let fed: Vec<usize> = (0..arm.n()).filter(|j| supply.feeds[*j]).collect();
            let predicted: Vec<Reading> = motors
                .iter()
                .map(|(t_s, a)| Reading { t_s: *t_s, value: fed.iter().map(|j| a[*j]).sum() })
                .collect();
            let measured = sum_of_magnitudes(heard, &fed, from_s, end_s + AFTER_S);
            let in_plan = |r: &&Reading| (0.0..=end_s).contains(&r.t_s);
            let peak =
                |readings: &[Reading]| readings.iter().filter(in_plan).map(|r| r.value).reduce(f64::max);
            let differences: Vec<f64> = measured
                .iter()
                .filter(in_plan)
                .filter_map(|r| interpolate(&predicted, r.t_s, |p| p.t_s, |p| p.value).map(|p| r.value - p))
                .collect();
            let mean_square = differences.iter().map(|d| d * d).sum::<f64>() / differences.len() as f64;
            SupplyCurrents {
                name: supply.name.clone(),
                joints: fed.iter().map(|j| arm.joints()[*j].name.clone()).collect(),
                limit_a: supply.current_max_a,
                predicted_peak_a: peak(&predicted).unwrap_or(0.0),
                measured_peak_a: peak(&measured),
                difference_rms_a: (!differences.is_empty()).then(|| mean_square.sqrt()),
                readings: fed.iter().map(|j| heard.joints[*j].currents.iter().filter(in_plan).count()).sum(),
                predicted,
                measured,
            }
        })
        .collect()
}

/// At each time at which one of the drives was read, if all of them are known at that time.
fn sum_of_magnitudes(heard: &Heard, joints: &[usize], from_s: f64, to_s: f64) -> Vec<Reading> {
    let mut times: Vec<f64> = joints
        .iter()
        .flat_map(|j| heard.joints[*j].currents.iter().map(|r| r.t_s))
        .filter(|t_s| (from_s..=to_s).contains(t_s))
        .collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    times
        .into_iter()
        .filter_map(|t_s| {
            let parts = joints
                .iter()
                .map(|j| interpolate(&heard.joints[*j].currents, t_s, |r| r.t_s, |r| r.value.abs()));
            let sum: Option<f64> = parts.sum();
            sum.map(|value| Reading { t_s, value })
        })
        .collect()
}
