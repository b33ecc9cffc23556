//! Present motion of a module: the set-point as a function of time.
//!
//! A program starts at an instant and is evaluated for any later one in closed form; [`SetpointGenerator::roll`]
//! continues with the buffered step. All positions are the module's own (measured) coordinates.

use protocol::{Duration, Instant};

use super::options::StepPath;
use super::ramp::{Ramp, RampPhase, Setpoint};

/// Seconds from `from` to `to`, negative if `to` is earlier.
pub(super) fn seconds(from: Instant, to: Instant) -> f64 {
    if to >= from {
        to.saturating_since(from).as_secs_f64()
    } else {
        -from.saturating_since(to).as_secs_f64()
    }
}

/// A position to be reached in a given time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step {
    start: Setpoint,
    target_rad: f64,
    duration: Duration,
    path: StepPath,
}

impl Step {
    /// From `start` to `target_rad` in `duration`, or in the shortest time that `v_max_rad_s` allows on average.
    pub(super) fn new(
        start: Setpoint,
        target_rad: f64,
        duration: Duration,
        v_max_rad_s: f64,
        path: StepPath,
    ) -> Self {
        let fastest = Duration::from_secs_f64((target_rad - start.q_rad).abs() / v_max_rad_s.max(1e-9));
        Self { start, target_rad, duration: duration.max(fastest).max(Duration::from_micros(1)), path }
    }

    fn at(&self, t_s: f64) -> Setpoint {
        let total_s = self.duration.as_secs_f64();
        if t_s >= total_s {
            return Setpoint::standing(self.target_rad);
        }
        let Setpoint { q_rad: q0, v_rad_s: v0, .. } = self.start;
        if t_s < 0.0 {
            return Setpoint { q_rad: q0 + v0 * t_s, v_rad_s: v0, a_rad_s2: 0.0 };
        }
        let way = self.target_rad - q0;
        match self.path {
            StepPath::Linear => {
                let v = way / total_s;
                Setpoint { q_rad: q0 + v * t_s, v_rad_s: v, a_rad_s2: 0.0 }
            }
            StepPath::Cubic => {
                // q0 + v0 t + c t² + d t³ with q(T) = target, q̇(T) = 0.
                let c = (3.0 * way / total_s - 2.0 * v0) / total_s;
                let d = (v0 - 2.0 * way / total_s) / (total_s * total_s);
                Setpoint {
                    q_rad: q0 + t_s * (v0 + t_s * (c + t_s * d)),
                    v_rad_s: v0 + t_s * (2.0 * c + 3.0 * t_s * d),
                    a_rad_s2: 2.0 * c + 6.0 * t_s * d,
                }
            }
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LoopShape {
    /// `(1 - cos) / 2`.
    Cosine,
    /// Triangle: constant velocity there and back.
    Ramp,
}

/// What is being moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Program {
    /// Position loop open: brake on or motor off.
    Open,
    /// Standing.
    Hold(f64),
    /// Ramp to a position or velocity.
    Ramp(Ramp),
    Step(Step),
    /// Back and forth between two positions without end.
    Loop {
        shape: LoopShape,
        center_rad: f64,
        amplitude_rad: f64,
        period_s: f64,
    },
    /// Current, A; no position set-point.
    Current(f64),
}

/// The running program, when it started, and the step that waits.
#[derive(Clone, Debug)]
pub(super) struct SetpointGenerator {
    program: Program,
    started: Instant,
    buffered: Option<(f64, Duration)>,
    v_max_rad_s: f64,
    path: StepPath,
}

impl SetpointGenerator {
    pub(super) fn new(path: StepPath) -> Self {
        Self { program: Program::Open, started: Instant::ZERO, buffered: None, v_max_rad_s: 1.0, path }
    }

    pub(super) fn program(&self) -> &Program {
        &self.program
    }

    /// Replaces the running program; `start` may be in the future.
    pub(super) fn start(&mut self, start: Instant, program: Program) {
        self.program = program;
        self.started = start;
        self.buffered = None;
    }

    /// Starts a step, or buffers it behind a running one; one more than that replaces the buffered one.
    pub(super) fn step(&mut self, now: Instant, target_rad: f64, duration: Duration, v_max_rad_s: f64) {
        self.v_max_rad_s = v_max_rad_s;
        if self.in_progress(now) {
            self.buffered = Some((target_rad, duration));
        } else {
            let step = Step::new(self.at(now), target_rad, duration, v_max_rad_s, self.path);
            self.start(now, Program::Step(step));
        }
    }

    /// Starts the buffered step at the instant at which the running one ended.
    pub(super) fn roll(&mut self, now: Instant) {
        if let (Program::Step(step), Some((target_rad, duration))) = (self.program, self.buffered) {
            let end = self.started + step.duration;
            if now >= end {
                // Leaves with the velocity it arrived with, so that a stream of equal steps is even.
                let arrived = step.at(step.duration.as_secs_f64() * (1.0 - 1e-9));
                let start = Setpoint { q_rad: step.target_rad, ..arrived };
                self.start(
                    end,
                    Program::Step(Step::new(start, target_rad, duration, self.v_max_rad_s, self.path)),
                );
            }
        }
    }

    /// A step runs at `now`.
    pub(super) fn in_progress(&self, now: Instant) -> bool {
        matches!(self.program, Program::Step(step) if now < self.started + step.duration)
    }

    /// One more step waits.
    pub(super) fn buffer_full(&self) -> bool {
        self.buffered.is_some()
    }

    /// Set-point at `at`; an open loop and a current program have none and give zeros.
    pub(super) fn at(&self, at: Instant) -> Setpoint {
        let t_s = seconds(self.started, at);
        match &self.program {
            Program::Open | Program::Current(_) => Setpoint::default(),
            Program::Hold(q_rad) => Setpoint::standing(*q_rad),
            Program::Ramp(ramp) => ramp.at(t_s),
            Program::Step(step) => step.at(t_s),
            Program::Loop { shape, center_rad, amplitude_rad, period_s } => {
                swing(*shape, *center_rad, *amplitude_rad, *period_s, t_s.max(0.0))
            }
        }
    }

    /// Phase of a ramp; `None` for other programs.
    pub(super) fn ramp_phase(&self, at: Instant) -> Option<RampPhase> {
        match &self.program {
            Program::Ramp(ramp) => Some(ramp.phase(seconds(self.started, at))),
            _ => None,
        }
    }

    /// The set-point moves, or a current acts.
    pub(super) fn is_active(&self, at: Instant) -> bool {
        match &self.program {
            Program::Open | Program::Hold(_) => false,
            Program::Ramp(ramp) => ramp.phase(seconds(self.started, at)) != RampPhase::Ended,
            Program::Step(_) => self.in_progress(at) || self.buffer_full(),
            Program::Loop { .. } | Program::Current(_) => true,
        }
    }
}

/// From the centre minus the amplitude and back; starts there.
fn swing(shape: LoopShape, center_rad: f64, amplitude_rad: f64, period_s: f64, t_s: f64) -> Setpoint {
    let turn = (t_s / period_s).fract();
    match shape {
        LoopShape::Cosine => {
            let w = std::f64::consts::TAU / period_s;
            // `libm` rather than the platform's library: the same bits on every host.
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * turn);
            Setpoint {
                q_rad: center_rad - amplitude_rad * cos,
                v_rad_s: amplitude_rad * w * sin,
                a_rad_s2: amplitude_rad * w * w * cos,
            }
        }
        LoopShape::Ramp => {
            let v = 4.0 * amplitude_rad / period_s;
            if turn < 0.5 {
                Setpoint {
                    q_rad: center_rad - amplitude_rad + v * turn * period_s,
                    v_rad_s: v,
                    a_rad_s2: 0.0,
                }
            } else {
                Setpoint {
                    q_rad: center_rad + amplitude_rad - v * (turn - 0.5) * period_s,
                    v_rad_s: -v,
                    a_rad_s2: 0.0,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: fn(u64) -> Instant = |ms| Instant::from_micros(ms * 1000);

    #[test]
    fn one_step_is_buffered_and_starts_when_the_first_ends_whenever_that_is_noticed() {
        let mut generator = SetpointGenerator::new(StepPath::Linear);
        generator.start(MS(0), Program::Hold(0.0));
        generator.step(MS(0), 0.1, Duration::from_millis(100), 10.0);
        generator.step(MS(10), 0.2, Duration::from_millis(100), 10.0);
        assert!(generator.in_progress(MS(99)) && generator.buffer_full());
        // Noticed 7 ms late: the second step still runs from 100 to 200 ms.
        generator.roll(MS(107));
        assert!(
            !generator.buffer_full() && generator.in_progress(MS(199)) && !generator.in_progress(MS(200))
        );
        assert!((generator.at(MS(150)).q_rad - 0.15).abs() < 1e-12);
        assert_eq!(generator.at(MS(300)), Setpoint::standing(0.2));
    }

    #[test]
    fn cubic_step_leaves_with_the_present_velocity_and_arrives_at_rest() {
        let start = Setpoint { q_rad: 0.0, v_rad_s: 0.5, a_rad_s2: 0.0 };
        let step = Step::new(start, 0.3, Duration::from_millis(400), 10.0, StepPath::Cubic);
        assert_eq!((step.at(0.0).q_rad, step.at(0.0).v_rad_s), (0.0, 0.5));
        let last = step.at(0.4 - 1e-9);
        assert!((last.q_rad - 0.3).abs() < 1e-8 && last.v_rad_s.abs() < 1e-7);
    }

    #[test]
    fn step_that_asks_for_too_much_speed_takes_longer() {
        let step = Step::new(Setpoint::default(), 1.0, Duration::ZERO, 2.0, StepPath::Linear);
        assert_eq!(step.duration, Duration::from_millis(500));
    }

    #[test]
    fn loops_start_where_the_module_stands_and_turn_at_the_other_end() {
        for shape in [LoopShape::Cosine, LoopShape::Ramp] {
            assert_eq!(swing(shape, 0.5, 0.2, 2.0, 0.0).q_rad, 0.3);
            assert!((swing(shape, 0.5, 0.2, 2.0, 1.0).q_rad - 0.7).abs() < 1e-12);
            assert!((swing(shape, 0.5, 0.2, 2.0, 0.5).q_rad - 0.5).abs() < 1e-12);
        }
    }
}
