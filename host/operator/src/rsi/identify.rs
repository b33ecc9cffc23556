//! Lag, smoothing and gripper delay of a robot, from cycles in which it was led.
//!
//! Set points are joined by straight lines, averaged over some cycles, delayed by a dead time and passed through a
//! first-order lag (the model of `kuka-rsi` controllers; published measurements on a KR 16 are mostly a shift in
//! time):
//!
//! ```text
//! T dy/dt = m(t - dead) - y          m: mean of the last n set points
//! ```
//!
//! For each n the pair (dead time, T) with the least squared error is found on a grid that is made finer step by step.

use std::f64::consts::TAU;

use hil_sim::krc::KrcScenario;
use planner::follow::limits::{AXES, Axes};
use planner::motion::{Knot, Motion};
use protocol::Duration;

use super::cycles::{Cycle, is_set, numbers, without_gaps};
use super::lag_interval::{half_widths_s, polished};

/// Frequencies of the wiggle, Hz: slow ones fix the whole lag, fast ones its parts.
const WIGGLE_HZ: [f64; 3] = [0.5, 1.3, 2.9];
/// Time of the wiggle, s, and of each of its ends, in which it begins and fades.
const WIGGLE_S: f64 = 8.0;
const FADE_S: f64 = 1.0;
/// Time between two knots of the wiggle, s.
const KNOT_S: f64 = 0.04;
/// Largest dead time and time constant that are looked for, s.
const DEAD_MAX_S: f64 = 0.30;
const CONSTANT_MAX_S: f64 = 0.12;
/// Longest mean that is looked for, cycles.
const SMOOTHING_MAX: usize = 8;
/// Places of the grid in each direction, and how often it is made finer.
const GRID: u32 = 8;
const ROUNDS: usize = 12;
/// A longer mean must make the squared error smaller by this share to be believed.
const WORTH: f64 = 0.02;
/// Cycles with motion below which nothing is concluded.
const CYCLES_MIN: usize = 100;
/// Openings below which no gripper delay is concluded.
const OPENINGS_MIN: usize = 4;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredLag {
    /// Dead time, s.
    pub dead_s: f64,
    /// Time constant, s.
    pub constant_s: f64,
    /// Half widths of 95 % intervals of dead time, time constant and both together, s. The first two are longer:
    /// one can nearly replace the other.
    pub known_s: [f64; 3],
    /// Set points that are averaged; 1: no smoothing.
    pub smoothing_cycles: usize,
    /// Root mean square of what is left, deg.
    pub residual_deg: f64,
    /// Motion of the axes over the same cycles, root mean square about its mean, deg.
    pub motion_deg: f64,
    pub cycles: usize,
}

impl MeasuredLag {
    /// Dead time, half of the mean's length, and time constant together, s: the lag of a slow motion.
    #[must_use]
    pub fn total_s(&self, period_s: f64) -> f64 {
        self.dead_s + self.constant_s + 0.5 * (self.smoothing_cycles - 1) as f64 * period_s
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredGripper {
    /// From the output in force to open fingers, mean, s.
    pub delay_s: f64,
    /// Half of the spread, s. The sensor is read once per cycle, so values below half a cycle are not reported.
    pub jitter_s: f64,
    /// Uncertainty of the mean, s: half a cycle over the root of the number of openings, or half a cycle if all took the same
    /// time.
    pub known_s: f64,
    pub openings: usize,
}

/// Nothing can be concluded.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unclear {
    /// Too little.
    #[error("{0} cycles with motion; {CYCLES_MIN} are needed")]
    TooFew(usize),
    /// Telegrams are missing.
    #[error("{0} telegrams in a row are missing")]
    Gap(u64),
    /// The model does not fit.
    #[error(
        "the residual of the model ({residual_deg:.3} deg) is more than a tenth of the motion ({motion_deg:.3} deg)"
    )]
    NoFit {
        /// Left.
        residual_deg: f64,
        motion_deg: f64,
    },
    /// No edge of the sensor.
    #[error("the finger sensor reported {0} openings; {OPENINGS_MIN} are needed")]
    NoOpenings(usize),
}

impl Unclear {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::TooFew(..) => "let the robot move, with larger --wiggle-deg".to_owned(),
            Self::Gap(..) => "use a cable and a network card of its own, end other programs on this machine, then measure again".to_owned(),
            Self::NoFit { .. } => "widen the limits of the corrections in the robot's program if they clamp, see that no override slows the robot, then measure again".to_owned(),
            Self::NoOpenings(..) => "check its wiring and its name in the configuration file".to_owned(),
        })
    }
}

/// A motion that shows the lag: all axes swing about the pose `q_rad` with up to `swing_rad`, each with its own
/// signs, and come to rest again.
#[must_use]
pub fn wiggle(q_rad: &Axes, swing_rad: f64) -> Motion {
    let count = (WIGGLE_S / KNOT_S).round() as usize;
    // Faster swings are smaller, so that each has the same acceleration.
    let shares = WIGGLE_HZ.map(|hz| (WIGGLE_HZ[0] / hz).powi(2));
    let whole: f64 = shares.iter().sum();
    let knot = |k: usize| {
        let t_s = KNOT_S * k as f64;
        let smooth = |x: f64| {
            if x <= 0.0 {
                (0.0, 0.0)
            } else if x >= 1.0 {
                (1.0, 0.0)
            } else {
                (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x))
            }
        };
        let (up, up_d) = smooth(t_s / FADE_S);
        let (down, down_d) = smooth((WIGGLE_S - t_s) / FADE_S);
        let (window, window_d) = (up * down, (up_d * down - up * down_d) / FADE_S);
        let mut state = Knot { t_s, q_rad: *q_rad, qd_rad_s: Axes::zeros(6) };
        for axis in 0..AXES {
            let (mut y, mut yd) = (0.0, 0.0);
            for (i, (hz, share)) in WIGGLE_HZ.into_iter().zip(shares).enumerate() {
                let sign = if (axis >> i) & 1 == 0 { 1.0 } else { -1.0 };
                let (sine, cosine) = (TAU * hz * t_s).sin_cos();
                y += sign * share * sine;
                yd += sign * share * TAU * hz * cosine;
            }
            let size = swing_rad / whole;
            state.q_rad[axis] += size * window * y;
            state.qd_rad_s[axis] = size * (window * yd + window_d * y);
        }
        state
    };
    Motion { knots: (0..=count).map(knot).collect(), events: Vec::new() }
}

/// Lost telegrams in a row that are made up for.
const GAP_MAX: u64 = 2;

/// The lag that fits best; `period_s` is the period of the cycles.
pub fn lag(cycles: &[Cycle], period_s: f64) -> Result<MeasuredLag, Unclear> {
    let cycles = &without_gaps(cycles, period_s, GAP_MAX);
    let reach = ((DEAD_MAX_S + 6.0 * CONSTANT_MAX_S) / period_s) as usize + SMOOTHING_MAX;
    let moves =
        |k: usize| (0..AXES).any(|axis| (cycles[k].set_deg[axis] - cycles[k - 1].set_deg[axis]).abs() > 1e-4);
    let first = (1..cycles.len()).find(|k| moves(*k)).unwrap_or(cycles.len());
    let last = (1..cycles.len()).rev().find(|k| moves(*k)).unwrap_or(0);
    let end = (last + reach).min(cycles.len());
    let used = end.saturating_sub(first);
    if last < first || last - first < CYCLES_MIN {
        return Err(Unclear::TooFew(last.saturating_sub(first)));
    }
    let window = &cycles[first.saturating_sub(1)..end];
    let gap = numbers(window, period_s).windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(1);
    if gap > 1 {
        return Err(Unclear::Gap(gap - 1));
    }
    let fit = |smoothing: usize| {
        let inputs = smoothed(window, smoothing);
        let mut best = (f64::INFINITY, 0.0, 0.0);
        let (mut dead, mut constant) = ((0.0, DEAD_MAX_S), (0.0, CONSTANT_MAX_S));
        for _ in 0..ROUNDS {
            let grid = |(low, high): (f64, f64)| {
                (0..=GRID).map(move |k| low + (high - low) * f64::from(k) / f64::from(GRID))
            };
            for dead_s in grid(dead) {
                for constant_s in grid(constant) {
                    let cost = squares(window, &inputs, period_s, dead_s, constant_s);
                    if cost < best.0 {
                        best = (cost, dead_s, constant_s);
                    }
                }
            }
            let around = |center: f64, (low, high): (f64, f64)| {
                // Dead time and time constant nearly stand for each other: the valley is long, so it is left slowly.
                let half = 0.3 * (high - low);
                ((center - half).max(0.0), center + half)
            };
            (dead, constant) = (around(best.1, dead), around(best.2, constant));
        }
        polished(window, &inputs, period_s, best)
    };
    let mut chosen = (1, fit(1));
    for smoothing in 2..=SMOOTHING_MAX {
        let fitted = fit(smoothing);
        if fitted.0 < (1.0 - WORTH) * chosen.1.0 {
            chosen = (smoothing, fitted);
        }
    }
    let (smoothing_cycles, (cost, dead_s, constant_s)) = chosen;
    let count = (window.len() * AXES) as f64;
    let residual_deg = (cost / count).sqrt();
    let mut spread = 0.0;
    for axis in 0..AXES {
        let mean = window.iter().map(|cycle| cycle.actual_deg[axis]).sum::<f64>() / window.len() as f64;
        spread += window.iter().map(|cycle| (cycle.actual_deg[axis] - mean).powi(2)).sum::<f64>();
    }
    let motion_deg = (spread / count).sqrt();
    // Written so that NaN does not fit.
    let fits = residual_deg <= 0.1 * motion_deg;
    if !fits {
        return Err(Unclear::NoFit { residual_deg, motion_deg });
    }
    let inputs = smoothed(window, smoothing_cycles);
    let known_s = half_widths_s(window, &inputs, period_s, (dead_s, constant_s));
    Ok(MeasuredLag { dead_s, constant_s, known_s, smoothing_cycles, residual_deg, motion_deg, cycles: used })
}

/// Mean of the last `n` set points of each cycle.
fn smoothed(window: &[Cycle], n: usize) -> Vec<[f64; AXES]> {
    (0..window.len())
        .map(|k| {
            std::array::from_fn(|axis| {
                let sum: f64 = (0..n).map(|back| window[k.saturating_sub(back)].set_deg[axis]).sum();
                sum / n as f64
            })
        })
        .collect()
}

/// Sum of squared differences between the model and the measured axes.
pub(super) fn squares(
    window: &[Cycle],
    inputs: &[[f64; AXES]],
    period_s: f64,
    dead_s: f64,
    constant_s: f64,
) -> f64 {
    let mut sum = 0.0;
    differ(window, inputs, period_s, (dead_s, constant_s), |by| sum += by * by);
    sum
}

/// Differences between the measured axes and the model, axis by axis, each from the second cycle on, deg.
pub(super) fn residuals(
    window: &[Cycle],
    inputs: &[[f64; AXES]],
    period_s: f64,
    dead_s: f64,
    constant_s: f64,
) -> Vec<f64> {
    let mut all = Vec::new();
    differ(window, inputs, period_s, (dead_s, constant_s), |by| all.push(by));
    all
}

fn differ(
    window: &[Cycle],
    inputs: &[[f64; AXES]],
    period_s: f64,
    (dead_s, constant_s): (f64, f64),
    mut each: impl FnMut(f64),
) {
    let delay = dead_s / period_s;
    let (whole, part) = (delay as usize, delay.fract());
    let decay = if constant_s > 0.0 { (-period_s / constant_s).exp() } else { 0.0 };
    let input = |k: usize, back: usize, axis: usize| inputs[k.saturating_sub(back)][axis];
    let delayed =
        |k: usize, axis: usize| (1.0 - part) * input(k, whole, axis) + part * input(k, whole + 1, axis);
    let first = inputs.first().copied().unwrap_or_default();
    for (axis, begin) in first.into_iter().enumerate() {
        let mut y = begin;
        for (k, cycle) in window.iter().enumerate().skip(1) {
            let (from, to) = (delayed(k - 1, axis), delayed(k, axis));
            // The answer to a straight line over one cycle, in closed form.
            let rise = to - from;
            let lagging = rise * constant_s / period_s;
            y = to - lagging + (y - from + lagging) * decay;
            each(cycle.actual_deg[axis] - y);
        }
    }
}

/// The delay of the gripper, from the outputs and the finger sensor.
pub fn gripper(cycles: &[Cycle], period_s: f64, output_bit: u8) -> Result<MeasuredGripper, Unclear> {
    let numbers = numbers(cycles, period_s);
    let open = |cycle: &Cycle| is_set(cycle.outputs, output_bit);
    let mut delays = Vec::new();
    let mut ordered: Option<usize> = None;
    for (k, pair) in cycles.windows(2).enumerate() {
        if !open(&pair[0]) && open(&pair[1]) {
            ordered = Some(k + 1);
        }
        if pair[1].fingers_open == Some(true)
            && pair[0].fingers_open == Some(false)
            && let Some(from) = ordered.take()
        {
            // Open some time within the cycle before the reading.
            delays.push((numbers[k + 1] - numbers[from]) as f64 - 0.5);
        }
    }
    if delays.len() < OPENINGS_MIN {
        return Err(Unclear::NoOpenings(delays.len()));
    }
    let mean = delays.iter().sum::<f64>() / delays.len() as f64;
    let (least, most) =
        delays.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), d| (low.min(*d), high.max(*d)));
    let known = if most > least { 0.5 / (delays.len() as f64).sqrt() } else { 0.5 };
    Ok(MeasuredGripper {
        delay_s: mean * period_s,
        jitter_s: 0.5 * (most - least) * period_s,
        known_s: known * period_s,
        openings: delays.len(),
    })
}

/// The description with what was measured.
#[must_use]
pub fn with_measured(
    described: &KrcScenario,
    lag: &MeasuredLag,
    gripper: Option<&MeasuredGripper>,
) -> KrcScenario {
    let mut changed = described.clone();
    let us = |s: f64| Duration::from_micros((s.max(0.0) * 1e6).round() as u64);
    changed.options.lag.dead_time = us(lag.dead_s);
    changed.options.lag.time_constant = us(lag.constant_s);
    changed.options.lag.smoothing_cycles = lag.smoothing_cycles;
    if let Some(gripper) = gripper {
        changed.options.hand.gripper.delay = us(gripper.delay_s);
        changed.options.hand.gripper.jitter = us(gripper.jitter_s);
    }
    changed
}
