//! Measured motion against the plan's polynomials.
//!
//! Speed is not differenced from positions, whose steps of 0.02° would make 0.1 rad/s of noise at a period of 3 ms.
//! The *error* is small and slow. Its slope is that of the least-squares line through the errors within
//! [`HALF_WINDOW_S`] on both sides, and the speed is the reference's speed less that slope. The estimate need not
//! be causal, so it does not lag; changes faster than the window are smoothed.

use serde::Serialize;

use super::collect::{Commanded, Heard, Reading};
use super::control::{Control, controls};
use super::{AFTER_S, AnalysisError, BEFORE_S, Run, TRANSIENT_S};
use crate::samples::drives::Drives;
use planner::motion::Motion;

/// Half of the time over which the slope of an error is taken, s: at 3 ms and 0.02° it leaves 2 mrad/s of noise.
pub const HALF_WINDOW_S: f64 = 0.025;
/// Fewest samples on each side of the middle.
pub(super) const SIDE_MIN: usize = 2;

/// One measured position and what belongs to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sample {
    /// Time of the plan, s.
    pub t_s: f64,
    /// Measured, rad.
    pub q_rad: f64,
    /// Estimated, rad/s.
    pub qd_rad_s: f64,
    pub q_ref_rad: f64,
    pub qd_ref_rad_s: f64,
    /// Reference minus measured, rad.
    pub error_rad: f64,
    /// Reference minus estimated, rad/s.
    pub error_rad_s: f64,
}

/// Largest, mean and release value of an error over the plan.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorSize {
    /// Largest magnitude from the start of the plan to its end.
    pub max: f64,
    /// Largest magnitude after the transient of [`TRANSIENT_S`].
    pub max_after_transient: f64,
    /// Root of the mean square from the start of the plan to its end.
    pub rms: f64,
    /// At the release, with its sign; `None` if nothing is thrown, or there are no measurements on both sides of it.
    pub at_release: Option<f64>,
}

#[derive(Clone, Debug, Serialize)]
pub struct JointTracking {
    /// Name in the robot file.
    pub name: String,
    /// Address of its drive; `None` if the link is not a bus.
    pub module: Option<u8>,
    /// Positions measured during the plan.
    pub samples_in_plan: usize,
    pub position_error_rad: ErrorSize,
    pub speed_error_rad_s: ErrorSize,
    /// Motion commands whose acceleration was at the joint's limit for control.
    pub commands_at_limit: usize,
    /// Largest current that its drive reported during the plan, in either direction, A; `None` if it reported no current.
    pub current_peak_a: Option<f64>,
    /// Largest temperature that its drive reported during the plan, degrees Celsius; `None` if it reported no temperature.
    pub temperature_peak_c: Option<f64>,
    /// From [`BEFORE_S`] before the plan to [`AFTER_S`] after it.
    #[serde(skip)]
    pub samples: Vec<Sample>,
    /// Ramps ordered in the same time.
    #[serde(skip)]
    pub commands: Vec<Commanded>,
    /// Accelerations that these amount to, during the plan.
    #[serde(skip)]
    pub controls: Vec<Control>,
}

/// Tracking of all joints.
///
/// # Errors
/// [`AnalysisError::Silent`].
pub fn joints(
    run: &Run<'_>,
    drives: Option<&Drives>,
    heard: &Heard,
) -> Result<Vec<JointTracking>, AnalysisError> {
    let Run { motion, arm, .. } = *run;
    let end = motion.duration_s();
    let release_s = run.throw.map(|plan| plan.release_time_s);
    let shown = |t_s: f64| (-BEFORE_S..=end + AFTER_S).contains(&t_s);
    let mut all = Vec::with_capacity(arm.n());
    for (j, drive) in heard.joints.iter().enumerate().take(arm.n()) {
        let name = arm.joints()[j].name.clone();
        // More than is shown, so that the windows of the first and last shown ones are whole.
        let margin = 4.0 * HALF_WINDOW_S;
        let kept = (-BEFORE_S - margin)..=(end + AFTER_S + margin);
        let positions: Vec<Reading> =
            drive.positions.iter().copied().filter(|p| kept.contains(&p.t_s)).collect();
        let mut samples = samples(motion, j, &positions);
        samples.retain(|sample| shown(sample.t_s));
        let in_plan = samples.iter().filter(|sample| (0.0..=end).contains(&sample.t_s)).count();
        let module = drives.map(|drives| drives.address[j]);
        let silent = AnalysisError::Silent { joint: name.clone(), module };
        let position =
            error_size(&samples, end, release_s, |sample| sample.error_rad).ok_or_else(|| silent.clone())?;
        let speed = error_size(&samples, end, release_s, |sample| sample.error_rad_s).ok_or(silent)?;
        let a_max = arm.joints()[j].limits.a_control_max_rad_s2;
        let at_limit =
            |c: &&Commanded| (0.0..=end).contains(&c.t_s) && c.a_rad_s2.is_some_and(|a| a >= 0.999 * a_max);
        let peak = |readings: &[Reading]| {
            let in_plan = readings.iter().filter(|r| (0.0..=end).contains(&r.t_s));
            in_plan.map(|r| r.value.abs()).reduce(f64::max)
        };
        all.push(JointTracking {
            name,
            module,
            current_peak_a: peak(&drive.currents),
            temperature_peak_c: peak(&drive.temperatures),
            samples_in_plan: in_plan,
            position_error_rad: position,
            speed_error_rad_s: speed,
            commands_at_limit: drive.commands.iter().filter(at_limit).count(),
            controls: {
                let mut controls = controls(motion, j, &drive.commands, &drive.positions);
                controls.retain(|control| (0.0..=end).contains(&control.t_s));
                controls
            },
            samples,
            commands: drive.commands.iter().copied().filter(|c| shown(c.t_s)).collect(),
        });
    }
    Ok(all)
}

/// Mean magnitude of the position errors in the first quarter of the plan, rad; infinite without errors. A run that
/// was stopped later still follows its plan there.
#[must_use]
pub fn unlike(motion: &Motion, heard: &Heard) -> f64 {
    let quarter_s = 0.25 * motion.duration_s();
    let (mut sum, mut count) = (0.0, 0_usize);
    for (j, drive) in heard.joints.iter().enumerate().take(motion.start_rad().len()) {
        for p in drive.positions.iter().filter(|p| (0.0..=quarter_s).contains(&p.t_s)) {
            sum += (motion.at(p.t_s).q[j] - p.value).abs();
            count += 1;
        }
    }
    if count > 0 { sum / count as f64 } else { f64::INFINITY }
}

fn samples(motion: &Motion, joint: usize, positions: &[Reading]) -> Vec<Sample> {
    let references: Vec<(f64, f64)> = positions
        .iter()
        .map(|p| {
            let reference = motion.at(p.t_s);
            (reference.q[joint], reference.qd[joint])
        })
        .collect();
    let errors: Vec<Reading> = positions
        .iter()
        .zip(&references)
        .map(|(p, (q_ref, _))| Reading { t_s: p.t_s, value: q_ref - p.value })
        .collect();
    positions
        .iter()
        .zip(&references)
        .enumerate()
        .filter_map(|(i, (p, (q_ref_rad, qd_ref_rad_s)))| {
            let error_rad_s = slope_at(&errors, i)?;
            Some(Sample {
                t_s: p.t_s,
                q_rad: p.value,
                qd_rad_s: qd_ref_rad_s - error_rad_s,
                q_ref_rad: *q_ref_rad,
                qd_ref_rad_s: *qd_ref_rad_s,
                error_rad: errors[i].value,
                error_rad_s,
            })
        })
        .collect()
}

/// Slope of the least-squares line about reading `i`; `None` at the ends, where one side is missing.
fn slope_at(readings: &[Reading], i: usize) -> Option<f64> {
    let middle_s = readings.get(i)?.t_s;
    let near = |r: &&Reading| (r.t_s - middle_s).abs() <= HALF_WINDOW_S;
    let before = readings[..i].iter().rev().take_while(near).count().max(SIDE_MIN);
    let after = readings[i + 1..].iter().take_while(near).count().max(SIDE_MIN);
    // The same number on both sides: then the slope of the line is also that in the middle of a parabola.
    let side = before.min(after);
    let window = readings.get(i.checked_sub(side)?..=i + side)?;
    line(window).map(|(_, _, slope)| slope)
}

/// Least-squares line: mean time, mean value, slope; `None` if all are of one time.
pub(super) fn line(readings: &[Reading]) -> Option<(f64, f64, f64)> {
    let n = readings.len() as f64;
    let t_mean = readings.iter().map(|r| r.t_s).sum::<f64>() / n;
    let mean = readings.iter().map(|r| r.value).sum::<f64>() / n;
    let tt: f64 = readings.iter().map(|r| (r.t_s - t_mean).powi(2)).sum();
    let te: f64 = readings.iter().map(|r| (r.t_s - t_mean) * (r.value - mean)).sum();
    (tt > 0.0).then(|| (t_mean, mean, te / tt))
}

fn error_size(
    samples: &[Sample],
    end_s: f64,
    release_s: Option<f64>,
    error: impl Fn(&Sample) -> f64,
) -> Option<ErrorSize> {
    let (mut max, mut max_after, mut squares, mut count) = (0.0_f64, 0.0_f64, 0.0, 0_usize);
    for sample in samples.iter().filter(|s| (0.0..=end_s).contains(&s.t_s)) {
        let e = error(sample);
        max = max.max(e.abs());
        if sample.t_s >= TRANSIENT_S {
            max_after = max_after.max(e.abs());
        }
        squares += e * e;
        count += 1;
    }
    let at_release = release_s.and_then(|t_s| interpolate(samples, t_s, |s| s.t_s, error));
    (count > 0).then(|| ErrorSize {
        max,
        max_after_transient: max_after,
        rms: (squares / count as f64).sqrt(),
        at_release,
    })
}

/// Value at `t_s` on the straight line between its neighbours; `None` outside.
pub fn interpolate<T>(
    items: &[T],
    t_s: f64,
    time: impl Fn(&T) -> f64,
    value: impl Fn(&T) -> f64,
) -> Option<f64> {
    let after = items.partition_point(|item| time(item) < t_s);
    let b = items.get(after)?;
    let Some(a) = after.checked_sub(1).and_then(|before| items.get(before)) else {
        return (time(b) == t_s).then(|| value(b));
    };
    let share = (t_s - time(a)) / (time(b) - time(a));
    Some(value(a) + share * (value(b) - value(a)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_of_a_parabola_is_exact_in_the_middle_of_the_window() {
        let readings: Vec<Reading> = (0..40)
            .map(|i| {
                let t_s = 0.003 * f64::from(i);
                Reading { t_s, value: 0.1 - 0.4 * t_s + 3.0 * t_s * t_s }
            })
            .collect();
        let slope = slope_at(&readings, 20).unwrap();
        assert!((slope - (-0.4 + 6.0 * readings[20].t_s)).abs() < 1e-9, "{slope}");
        // One neighbour on a side is too few for a window of two.
        assert_eq!(slope_at(&readings, 1), None);
        assert!(slope_at(&readings, 2).is_some());
    }

    #[test]
    fn interpolation_knows_its_ends() {
        let items = [(0.0, 1.0), (2.0, 5.0)];
        let at = |t| interpolate(&items, t, |i| i.0, |i| i.1);
        assert_eq!((at(0.5), at(0.0), at(2.0)), (Some(2.0), Some(1.0), Some(5.0)));
        assert_eq!((at(-0.1), at(2.1)), (None, None));
    }
}
