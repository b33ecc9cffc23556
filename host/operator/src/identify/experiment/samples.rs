//! Measurements on a joint: currents at steady speeds and while holding, responses to steps of acceleration.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;

use protocol::powercube::{Parameter, Reply, Value};
use protocol::{Duration, Frame, Instant};

use super::{Experiment, ExperimentError, Look};
use crate::tap::{Tap, Way};
use tuner::identify::current::{HoldSample, SpeedSample};
use tuner::identify::lag::StepSample;
use tuner::identify::poses::{APPROACH_RAD, HOLDS, Sweep};
use tuner::identify::samples::{HOLD_READINGS, Speeds, Steps};

/// Speeds at which the current is measured, share of the fastest.
const SPEED_SHARES: [f64; 6] = [0.25, 0.4, 0.55, 0.7, 0.85, 1.0];
/// Longest stretch over which a current is averaged, rad, and the shortest that is worth it.
const WINDOW_RAD: (f64, f64) = (0.2, 1.0);
/// Way that a joint gets to settle on its speed, rad.
const SETTLE_RAD: f64 = 0.06;
/// Readings that a steady speed must have at least.
const SPEED_READINGS_MIN: usize = 20;
/// Time that a joint must stand after a ramp before its holding current counts.
const REST: Duration = Duration::from_millis(300);
/// Steps of acceleration for the lag.
const STEPS: usize = 8;
/// Time after a step that is looked at.
const STEP_TIME: Duration = Duration::from_millis(70);
/// Bits around the data of a frame with an 11-bit identifier (ISO 11898-1), and its share of stuff bits.
const FRAME_BITS: (f64, f64) = (47.0, 1.1);

/// A frame that passed.
#[derive(Clone, Copy, Debug)]
struct Passed {
    at: Instant,
    way: Way,
    frame: Frame,
}

/// Keeps frames while it is switched on.
#[derive(Default)]
pub(super) struct FrameLog {
    on: bool,
    frames: Vec<Passed>,
}

/// Puts what passes on the bus into the log.
pub(super) struct LogTap(pub(super) Rc<RefCell<FrameLog>>);

impl Tap for LogTap {
    fn frame(&mut self, at: Instant, way: Way, frame: &Frame) -> io::Result<()> {
        let mut log = self.0.borrow_mut();
        if log.on {
            log.frames.push(Passed { at, way, frame: *frame });
        }
        Ok(())
    }
}

impl Experiment<'_> {
    /// Reads the current while standing, several times, A.
    fn readings(&mut self, count: usize) -> Result<Vec<f64>, ExperimentError> {
        let module = self.drives[self.joint].module();
        let mut read = || self.session.get_f64(module, Parameter::Cur).map_err(ExperimentError::from);
        (0..count).map(|_| read()).collect()
    }

    /// Standard deviation of the current reading of the standing joint, A.
    pub fn scatter_a(&mut self) -> Result<f64, ExperimentError> {
        (self.progress)("noise of the current");
        let readings = self.readings(HOLD_READINGS)?;
        let mean = mean(&readings);
        let squares: f64 = readings.iter().map(|a| (a - mean).powi(2)).sum();
        Ok((squares / (readings.len() - 1) as f64).sqrt())
    }

    /// Steady speeds in both directions over the same stretch of `sweep`: the mean load is then the same in all runs
    /// and does not look like K_B.
    pub fn speeds(&mut self, sweep: &Sweep) -> Result<Speeds, ExperimentError> {
        let limits = self.model.joints()[self.joint].limits;
        let a = limits.a_control_max_rad_s2.min(limits.a_max_rad_s2);
        let needed = |v: f64| v * v / a + 2.0 * SETTLE_RAD + WINDOW_RAD.0;
        let fastest = self.bounds.speed_share * limits.v_max_rad_s;
        let room = ((sweep.length_rad() - 2.0 * SETTLE_RAD - WINDOW_RAD.0).max(0.0) * a).sqrt();
        let top_rad_s = fastest.min(room);
        if top_rad_s < 0.5 * fastest {
            let needed_rad = needed(fastest);
            let (low_rad, high_rad) = (sweep.low_rad, sweep.high_rad);
            return Err(ExperimentError::NoRoom { joint: self.joint + 1, low_rad, high_rad, needed_rad });
        }
        let window = (sweep.length_rad() - top_rad_s * top_rad_s / a - 2.0 * SETTLE_RAD).min(WINDOW_RAD.1);
        let half = 0.5 * (window + top_rad_s * top_rad_s / a) + SETTLE_RAD;
        let centre = sweep.centre_rad();
        self.travel(self.joint, centre - half)?;
        let mut runs: Vec<(f64, Vec<Look>)> = Vec::new();
        for share in SPEED_SHARES {
            for direction in [1.0, -1.0] {
                let v = share * top_rad_s;
                (self.progress)(&format!("current at {:+.2} rad/s", direction * v));
                let mut looks = Vec::new();
                self.ramp(self.joint, centre + direction * half, v, a, &mut |look| {
                    if (look.position_rad - centre).abs() < 0.5 * window {
                        looks.push(look);
                    }
                })?;
                runs.push((direction, looks));
            }
        }
        // As many readings for each run: then they are equally certain.
        let count = runs.iter().map(|(_, looks)| looks.len()).min().unwrap_or(0);
        if count < SPEED_READINGS_MIN {
            let (low_rad, high_rad) = (sweep.low_rad, sweep.high_rad);
            let needed_rad = needed(fastest) + WINDOW_RAD.1;
            return Err(ExperimentError::NoRoom { joint: self.joint + 1, low_rad, high_rad, needed_rad });
        }
        let samples = runs
            .iter()
            .map(|(direction, looks)| {
                let kept: Vec<f64> = (0..count).map(|i| looks[i * looks.len() / count].current_a).collect();
                SpeedSample { speed_rad_s: slope(looks), current_a: self.signed(mean(&kept), *direction) }
            })
            .collect();
        let stretch = Sweep { low_rad: centre - 0.5 * window, high_rad: centre + 0.5 * window };
        Ok(Speeds { samples, top_rad_s, stretch })
    }

    /// Holding currents at `holds_rad`, each approached from both sides; the other joints stand.
    pub fn holds(&mut self, holds_rad: &[f64]) -> Result<Vec<HoldSample>, ExperimentError> {
        let mut samples = Vec::new();
        for &hold in holds_rad {
            for approach in [1.0, -1.0] {
                (self.progress)(&format!("holding current at {hold:.2} rad"));
                self.travel(self.joint, hold - approach * APPROACH_RAD)?;
                self.travel(self.joint, hold)?;
                self.session.sleep_until(self.session.now() + REST)?;
                let q = self.positions()?;
                let torque_nm = self.model.gravity_torques(&q)[self.joint];
                let reading_a = mean(&self.readings(HOLD_READINGS)?);
                let current_a = self.signed(reading_a, torque_nm);
                samples.push(HoldSample { torque_nm, current_a, approach });
            }
        }
        Ok(samples)
    }

    /// Responses to steps of acceleration about the middle of `sweep`, up and down.
    pub fn steps(&mut self, sweep: &Sweep) -> Result<Steps, ExperimentError> {
        let limits = self.model.joints()[self.joint].limits;
        let a = (0.8 * limits.a_control_max_rad_s2).min(limits.a_max_rad_s2);
        // Far enough for the whole step at full acceleration, and back.
        let reach = (a * STEP_TIME.as_secs_f64().powi(2)).max(0.1);
        if sweep.length_rad() < reach {
            let (low_rad, high_rad) = (sweep.low_rad, sweep.high_rad);
            return Err(ExperimentError::NoRoom {
                joint: self.joint + 1,
                low_rad,
                high_rad,
                needed_rad: reach,
            });
        }
        let from = sweep.centre_rad() - 0.5 * reach;
        let mut steps = Steps { samples: Vec::new(), acceleration_rad_s2: a, answers_s: Vec::new() };
        self.travel(self.joint, from)?;
        for i in 0..STEPS {
            let direction = if i % 2 == 0 { 1.0 } else { -1.0 };
            (self.progress)(&format!("step of {:+.1} rad/s2", direction * a));
            self.session.sleep_until(self.session.now() + REST)?;
            let start = self.positions()?[self.joint];
            self.log.borrow_mut().on = true;
            let target = if direction > 0.0 { from + reach } else { from };
            let done = self.ramp(self.joint, target, limits.v_max_rad_s, a, &mut |_| {});
            let frames = {
                let mut log = self.log.borrow_mut();
                log.on = false;
                std::mem::take(&mut log.frames)
            };
            done?;
            self.take_step(&frames, start, direction, &mut steps);
        }
        Ok(steps)
    }

    /// Positions after the motion command, and how long answers took, from the frames of one step.
    fn take_step(&self, frames: &[Passed], start_rad: f64, direction: f64, steps: &mut Steps) {
        let module = self.drives[self.joint].module();
        let span_s = |frame: &Frame| {
            (FRAME_BITS.0 + 8.0 * frame.data().len() as f64) * FRAME_BITS.1 / self.bounds.bit_rate_bit_s
        };
        let (mut asked, mut moved) = (None, None);
        for passed in frames {
            match passed.way {
                Way::Sent => {
                    asked = Some(passed.at);
                    // The ramp is the only motion command of a step.
                    if passed.frame.data().first() == Some(&MOTION_BYTE) {
                        moved = moved.or(Some(passed.at));
                    }
                }
                Way::Received => {
                    let Ok((from, reply)) = Reply::decode(&passed.frame) else { continue };
                    if from != module {
                        continue;
                    }
                    let answered_s = passed.at.as_secs_f64() - span_s(&passed.frame);
                    if let Some(asked) = asked.take() {
                        steps.answers_s.push((answered_s - asked.as_secs_f64()).max(0.0));
                    }
                    if let (Some(moved), Reply::Value(Parameter::ActPos, Value::F32(rad))) = (moved, reply) {
                        let t_s = answered_s - moved.as_secs_f64();
                        if (0.0..STEP_TIME.as_secs_f64()).contains(&t_s) {
                            let position_rad =
                                direction * (self.joint_rad(self.joint, rad.into()) - start_rad);
                            steps.samples.push(StepSample { t_s, position_rad });
                        }
                    }
                }
            }
        }
    }

    /// A reading with the sign of its cause: drives of this kind report the amount. If a drive reports a sign, it
    /// is that of its own direction.
    fn signed(&self, reading_a: f64, cause: f64) -> f64 {
        let is_turned = self.drives[self.joint].inverted;
        if reading_a >= 0.0 {
            reading_a.copysign(cause)
        } else if is_turned {
            -reading_a
        } else {
            reading_a
        }
    }

    /// Number of progress reports of all parts, for a bar; `poses` joints change places twice.
    pub const fn parts(has_holds: bool, poses: usize) -> usize {
        let holds = if has_holds { 2 * HOLDS } else { 0 };
        1 + 2 * SPEED_SHARES.len() + STEPS + holds + 2 * poses
    }
}

/// First byte of a motion command on the wire (protocol: SET MOTION).
const MOTION_BYTE: u8 = 0x0B;

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Speed as the slope of the straight line through the positions, rad/s.
fn slope(looks: &[Look]) -> f64 {
    let t = |look: &Look| look.at.as_secs_f64();
    let n = looks.len() as f64;
    let (t_mean, q_mean) =
        (looks.iter().map(t).sum::<f64>() / n, looks.iter().map(|l| l.position_rad).sum::<f64>() / n);
    let (mut above, mut below) = (0.0, 0.0);
    for look in looks {
        let dt = t(look) - t_mean;
        above += dt * (look.position_rad - q_mean);
        below += dt * dt;
    }
    above / below
}
