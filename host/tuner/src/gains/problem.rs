//! Input of a gain design, checked once: a value of the type exists only if the checks passed.

use crate::model::{DriveLag, Estimator, STATES, Sampled, sampled, steady_state};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// Closed interval low..=high.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    pub fn centre(&self) -> f64 {
        0.5 * (self.low + self.high)
    }
}

/// A stretch of the motion with its own largest reference acceleration, as given.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseInput {
    /// Length in s; `None` for the last one, which has no end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration_s: Option<f64>,
    /// Largest |reference acceleration| of the joint in it, rad/s2, >= 0 (0: hold still).
    pub reference_max_rad_s2: f64,
}

/// Data of one joint as given by robot model, plan and command line.
#[derive(Clone, Debug, PartialEq)]
pub struct JointInput {
    /// Joint number from 1, for messages.
    pub joint: usize,
    /// Command period, s.
    pub period_s: f64,
    /// Relative period jitter: the period lies within (1 - jitter, 1 + jitter) period_s. 0 <= jitter < 0.5.
    pub period_jitter: f64,
    /// From the drive's position sample to the instant the command computed from it acts, s:
    /// smallest and largest. At most one period.
    pub delay_s: (f64, f64),
    /// The drive's position loop.
    pub drive: DriveLag,
    /// The controller's estimator.
    pub estimator: Estimator,
    /// Acceleration for control (paper eq. 11), rad/s2: what the command may reach in all.
    pub acceleration_max_rad_s2: f64,
    /// Reference acceleration over the motion (paper eq. 12, symmetrised), at least one phase.
    pub phases: Vec<PhaseInput>,
    /// Semi-axis of the ellipsoid of initial errors along position, rad, > 0.
    pub error_position_rad: f64,
    /// Semi-axis along velocity, rad/s, > 0.
    pub error_velocity_rad_s: f64,
}

/// Why data were refused: the datum and, where there is one, the way out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("joint {joint}: {what}")]
pub struct ProblemError {
    joint: usize,
    what: String,
}

/// One phase: the least acceleration the reference leaves to the controller, and how long.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// Bound of the correcting acceleration, rad/s2, > 0 (paper eq. 12, symmetrised).
    pub u_max_rad_s2: f64,
    /// Length, s; `None`: without end.
    pub duration_s: Option<f64>,
}

/// Checked data of one joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    joint: usize,
    period_s: f64,
    jitter: f64,
    delay: Interval,
    drive: DriveLag,
    estimator: Estimator,
    acceleration_max_rad_s2: f64,
    phases: Vec<Phase>,
    error_position_rad: f64,
    error_velocity_rad_s: f64,
    horizon_share_max: f64,
}

impl Problem {
    /// Checks `input`.
    pub fn new(input: &JointInput) -> Result<Self, ProblemError> {
        let joint = input.joint;
        let refused = |what: String| ProblemError { joint, what };
        let checked = |what: &str, value: f64, holds: bool, must: &str| {
            if !value.is_finite() {
                return Err(refused(format!("{what} is not a finite number")));
            }
            if holds { Ok(value) } else { Err(refused(format!("{what} is {value}, it must {must}"))) }
        };
        let positive = |what, value: f64| checked(what, value, value > 0.0, "be above zero");
        let not_negative = |what, value: f64| checked(what, value, value >= 0.0, "not be negative");
        let period_s = positive("period", input.period_s)?;
        let jitter = not_negative("period jitter", input.period_jitter)?;
        if jitter >= 0.5 {
            return Err(refused(format!(
                "period jitter {jitter} must be below 0.5 (a fraction of the period)"
            )));
        }
        // The largest first: the smallest may have been derived from it.
        let high = not_negative("largest delay", input.delay_s.1)?;
        let delay = Interval { low: not_negative("smallest delay", input.delay_s.0)?, high };
        if delay.low > high {
            return Err(refused(format!("smallest delay {} s is above the largest, {high} s", delay.low)));
        }
        if high > period_s * (1.0 + 1e-9) {
            return Err(refused(format!(
                "delay {high} s is longer than the period {period_s} s; lengthen the period to at least the delay, or \
                 shorten the answer time of the drive"
            )));
        }
        positive("natural frequency of the drive", input.drive.wn_rad_s)?;
        positive("damping of the drive", input.drive.zeta)?;
        for (what, value) in [
            ("weight alpha of the estimator", input.estimator.alpha),
            ("weight beta of the estimator", input.estimator.beta),
        ] {
            positive(what, value)?;
            checked(what, value, value <= 1.0, "be above 0 and at most 1")?;
        }
        let available = positive("acceleration for control", input.acceleration_max_rad_s2)?;
        let mut phases = Vec::new();
        for (i, phase) in input.phases.iter().enumerate() {
            let reference = not_negative("largest reference acceleration", phase.reference_max_rad_s2)?;
            if reference >= available {
                return Err(refused(format!(
                    "the reference uses {reference} rad/s2 of the {available} rad/s2 for control in phase {} and leaves \
                     nothing to correct errors with; plan with about 80 %, that is {:.2} rad/s2",
                    i + 1,
                    0.8 * available
                )));
            }
            if let Some(duration) = phase.duration_s {
                positive("duration of a phase", duration)?;
            }
            phases.push(Phase { u_max_rad_s2: available - reference, duration_s: phase.duration_s });
        }
        let open_ends = phases.iter().filter(|p| p.duration_s.is_none()).count();
        if open_ends != 1 || phases.last().is_none_or(|p| p.duration_s.is_some()) {
            return Err(refused("phases must end with exactly one that has no duration".to_owned()));
        }
        Ok(Self {
            joint,
            period_s,
            jitter,
            delay,
            drive: input.drive,
            estimator: input.estimator,
            acceleration_max_rad_s2: available,
            phases,
            error_position_rad: positive("initial position error", input.error_position_rad)?,
            error_velocity_rad_s: positive("initial velocity error", input.error_velocity_rad_s)?,
            horizon_share_max: f64::INFINITY,
        })
    }

    /// Joint number from 1.
    pub fn joint(&self) -> usize {
        self.joint
    }

    /// Nominal period, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Range of the period, s.
    pub fn period(&self) -> Interval {
        Interval { low: self.period_s * (1.0 - self.jitter), high: self.period_s * (1.0 + self.jitter) }
    }

    /// Range of the delay, s.
    pub fn delay(&self) -> Interval {
        self.delay
    }

    pub fn drive(&self) -> DriveLag {
        self.drive
    }

    pub fn estimator(&self) -> Estimator {
        self.estimator
    }

    /// The sampled loop at a period and a delay, s.
    pub fn sampled(&self, period_s: f64, delay_s: f64) -> Sampled {
        sampled(&self.drive, &self.estimator, period_s, delay_s)
    }

    /// Acceleration for control, rad/s2.
    pub fn acceleration_max_rad_s2(&self) -> f64 {
        self.acceleration_max_rad_s2
    }

    /// Phases in order, the last one without an end.
    pub fn phases(&self) -> &[Phase] {
        &self.phases
    }

    /// Semi-axes of the set of initial errors: rad, rad/s.
    pub fn error_set(&self) -> (f64, f64) {
        (self.error_position_rad, self.error_velocity_rad_s)
    }

    /// 7 x 2 matrix G: the initial states are G z with |z| <= 1 (drive in its steady state).
    pub fn error_generators(&self) -> DMatrix<f64> {
        let columns =
            [steady_state(self.error_position_rad, 0.0), steady_state(0.0, self.error_velocity_rad_s)];
        DMatrix::from_fn(STATES, 2, |i, j| columns[j][i])
    }

    /// The same problem with the error set scaled by `factor` (> 0).
    #[must_use]
    pub fn with_scaled_error_set(&self, factor: f64) -> Self {
        let mut scaled = self.clone();
        scaled.error_position_rad *= factor;
        scaled.error_velocity_rad_s *= factor;
        scaled
    }

    /// The same problem, certified for at least the errors in whose time unit delay and lag take this share.
    #[must_use]
    pub(super) fn with_horizon_share_max(&self, share: f64) -> Self {
        Self { horizon_share_max: share, ..self.clone() }
    }

    /// Largest share of the time unit of a certified set that delay and lag take.
    pub(super) fn horizon_share_max(&self) -> f64 {
        self.horizon_share_max
    }

    /// (period, delay) at the corners of the stated ranges; a delay never exceeds its period.
    pub fn corners(&self) -> Vec<(f64, f64)> {
        self.grid(2)
    }

    /// (period, delay) on an n x n grid over the stated ranges, corners included; duplicates of a
    /// degenerate range are left out. n >= 1; n = 1 gives the nominal pair.
    pub fn grid(&self, n: usize) -> Vec<(f64, f64)> {
        let (t, d) = (self.period(), self.delay);
        if n <= 1 {
            return vec![(self.period_s, d.centre().min(self.period_s))];
        }
        let at = |r: Interval, i: usize, of: usize| r.low + (r.high - r.low) * i as f64 / (of - 1) as f64;
        let mut points: Vec<(f64, f64)> = Vec::new();
        for i in 0..n * n {
            let period = at(t, i / n, n);
            // A delay of a full period means "with the next command", whenever that is.
            let stretch = if d.high >= self.period_s { period / self.period_s } else { 1.0 };
            let delay = (at(d, i % n, n) * stretch).min(period);
            if !points.contains(&(period, delay)) {
                points.push((period, delay));
            }
        }
        points
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Joint 1 of the reference throw at the paper's period.
    pub(crate) fn joint_1(period_s: f64) -> JointInput {
        JointInput {
            joint: 1,
            period_s,
            period_jitter: 0.02,
            delay_s: (0.95 * period_s, period_s),
            drive: DriveLag::POWERCUBE,
            estimator: Estimator::usual(period_s),
            acceleration_max_rad_s2: 10.4,
            phases: vec![
                PhaseInput { duration_s: Some(0.71), reference_max_rad_s2: 4.79 },
                PhaseInput { duration_s: None, reference_max_rad_s2: 7.18 },
            ],
            error_position_rad: 0.1,
            error_velocity_rad_s: 0.1,
        }
    }

    #[test]
    fn sound_data_pass() {
        let p = Problem::new(&joint_1(0.017)).unwrap();
        assert!((p.phases()[0].u_max_rad_s2 - 5.61).abs() < 1e-12);
        assert!((p.phases()[1].u_max_rad_s2 - 3.22).abs() < 1e-12);
        assert_eq!(p.corners().len(), 4);
        assert!(p.grid(5).iter().all(|(t, d)| d <= t));
    }

    #[test]
    fn bad_data_are_refused_with_the_datum_named() {
        type Change = fn(&mut JointInput);
        let table: [(&str, Change, &str); 19] = [
            ("period 0", |i| i.period_s = 0.0, "period is 0"),
            ("period negative", |i| i.period_s = -0.017, "period is -0.017"),
            ("period NaN", |i| i.period_s = f64::NAN, "period is not a finite number"),
            ("delay too long", |i| i.delay_s = (0.0, 0.018), "longer than the period"),
            ("delay negative", |i| i.delay_s = (-0.001, 0.01), "smallest delay is -0.001"),
            ("delay reversed", |i| i.delay_s = (0.01, 0.005), "above the largest"),
            ("delay NaN", |i| i.delay_s = (0.0, f64::NAN), "largest delay is not"),
            ("weight zero", |i| i.estimator.beta = 0.0, "weight beta of the estimator is 0"),
            ("weight above one", |i| i.estimator.alpha = 1.1, "at most 1"),
            ("jitter half", |i| i.period_jitter = 0.5, "below 0.5"),
            ("jitter negative", |i| i.period_jitter = -0.1, "period jitter is -0.1"),
            ("bound negative", |i| i.acceleration_max_rad_s2 = -1.0, "acceleration for control is -1"),
            (
                "bound infinite",
                |i| i.acceleration_max_rad_s2 = f64::INFINITY,
                "acceleration for control is not",
            ),
            ("all used", |i| i.phases[1].reference_max_rad_s2 = 10.4, "leaves nothing"),
            ("reference negative", |i| i.phases[0].reference_max_rad_s2 = -1.0, "must not be negative"),
            ("no phase", |i| i.phases.clear(), "phases must end"),
            ("endless phase first", |i| i.phases[0].duration_s = None, "phases must end"),
            ("error set empty", |i| i.error_position_rad = 0.0, "initial position error is 0"),
            ("drive NaN", |i| i.drive.wn_rad_s = f64::NAN, "natural frequency of the drive is not"),
        ];
        for (name, change, want) in table {
            let mut input = joint_1(0.017);
            change(&mut input);
            let message = Problem::new(&input).unwrap_err().to_string();
            assert!(message.contains(want), "{name}: {message}");
            assert!(message.starts_with("joint 1:"), "{name}: {message}");
        }
    }
}
