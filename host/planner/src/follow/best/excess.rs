//! How far a window with its ramps is beyond each limit.

use crate::follow::clear::{Clear, Scenes};
use crate::follow::limits::{AXES, Axes};
use crate::follow::motion::{FollowMotion, Ramps, differences};
use crate::follow::parabola::Parabola;
use crate::follow::posture::{Posture, Reach};
use crate::follow::setting::Setting;

use super::variables::{HandFreedom, Variables};

/// Limits are aimed at with this share of them to spare, so that rounding does not break them.
pub(super) const SPARE: f64 = 1e-3;
/// Instants of each ramp at which contacts are looked for.
const RAMP_TESTS: usize = 6;
/// Instants after the window at which the flying ball is tested.
const BALL_TESTS: usize = 10;

/// Evaluates windows of one setting.
pub(super) struct Excess<'a> {
    setting: &'a Setting<'a>,
    hand: HandFreedom,
    reach: Reach<'a>,
    clear: Clear<'a>,
    /// Time in which ramps change to and from rest, in s.
    fade_s: f64,
    /// Longest blend between ramp and window, in s.
    blend_max_s: f64,
}

/// The part of a motion on the parabola.
pub(super) struct Window {
    /// Joints in its middle.
    pub(super) q_center: Axes,
    flight: Parabola,
    postures: Vec<Posture>,
}

/// A window with its ramps.
struct Parts<'w> {
    flight: Parabola,
    window: &'w [Posture],
    start: Ramps,
    stop: Ramps,
}

impl<'a> Excess<'a> {
    pub(super) fn new(setting: &'a Setting<'a>, hand: HandFreedom, scenes: &'a Scenes) -> Self {
        let limits = &setting.limits;
        // The smoothest part of a fade has 1.5 times its mean jerk; short fades are kept to half of the jerk limit.
        let fade_s =
            (limits.ramp_rad_s2.component_div(&limits.j_max_rad_s3).amax() * 3.0).max(2.0 * setting.period_s);
        Self {
            setting,
            hand,
            reach: Reach::new(setting.arm),
            clear: Clear::new(setting.arm, scenes, setting.margins),
            fade_s,
            blend_max_s: blend_max_s(setting),
        }
    }

    /// A blend to start with: long enough for the jerk of the largest change.
    pub(super) fn blend_s(&self) -> f64 {
        0.25 * self.blend_max_s
    }

    /// Longest blend, in s.
    pub(super) fn blend_max_s(&self) -> f64 {
        self.blend_max_s
    }

    pub(super) fn setting(&self) -> &'a Setting<'a> {
        self.setting
    }

    pub(super) fn hand(&self) -> HandFreedom {
        self.hand
    }

    pub(super) fn clear(&mut self) -> &mut Clear<'a> {
        &mut self.clear
    }

    /// The window of `x`. The joints in its middle are the solution nearest to `q_ref`. `None` if the arm does not reach a pose of the hand.
    pub(super) fn window(&self, x: &Variables, q_ref: &Axes, points: usize) -> Option<Window> {
        let state = x.hand().at(&x.flight(self.setting), 0.0);
        self.window_around(x, &self.reach.near(&state.x_wb, q_ref)?, points)
    }

    /// The window of `x`; `q_center` are the joints in its middle.
    pub(super) fn window_around(&self, x: &Variables, q_center: &Axes, points: usize) -> Option<Window> {
        let (flight, hand) = (x.flight(self.setting), x.hand());
        let period_s = self.setting.period_s;
        // Instants relative to the middle of the window.
        let time = |k: usize| (k as f64 - 0.5 * (points - 1) as f64) * period_s;
        let mut window: Vec<Option<Posture>> = vec![None; points];
        let middle = (points - 1) / 2;
        let mut q_ref = *q_center;
        for k in (middle..points).chain((0..middle).rev()) {
            if k + 1 == middle {
                q_ref = window[middle]?.q;
            }
            let state = hand.at(&flight, time(k));
            let posture = self.reach.rates(self.reach.near(&state.x_wb, &q_ref)?, &state)?;
            q_ref = posture.q;
            window[k] = Some(posture);
        }
        let postures = window.into_iter().collect::<Option<_>>()?;
        Some(Window { q_center: *q_center, flight: flight.from_time(time(0)), postures })
    }

    fn parts<'w>(&self, x: &Variables, window: &'w Window) -> Parts<'w> {
        let [start, stop] = x.ramps(self.fade_s);
        let (limits, postures) = (&self.setting.limits, &window.postures);
        Parts {
            flight: window.flight,
            start: Ramps::start(&postures[0], start, limits),
            stop: Ramps::stop(&postures[postures.len() - 1], stop, limits),
            window: postures,
        }
    }

    /// The motion, and its flight with t = 0 at the first step on the parabola.
    pub(super) fn motion(
        &self,
        x: &Variables,
        q_center: &Axes,
        points: usize,
    ) -> Option<(FollowMotion, Parabola)> {
        let window = self.window_around(x, q_center, points)?;
        let parts = self.parts(x, &window);
        let motion = FollowMotion::around(parts.window, &parts.start, &parts.stop, self.setting.period_s);
        Some((motion, parts.flight))
    }

    /// Whether every step is inside the joint ranges, and its command inside what may be commanded.
    pub(super) fn in_range(&self, motion: &FollowMotion) -> bool {
        let limits = &self.setting.limits;
        let commands = motion.commands(self.setting.lag_s);
        let steps = motion
            .states
            .iter()
            .all(|s| (0..AXES).all(|i| s.q[i] >= limits.q_min_rad[i] && s.q[i] <= limits.q_max_rad[i]));
        steps && commands.iter().all(|command| self.setting.commands.holds(command))
    }

    /// Residuals of `x` with its window, all less than [`SPARE`] inside the limits; their number depends only on the points
    /// of the window.
    pub(super) fn residuals(&mut self, x: &Variables, window: &Window) -> Vec<f64> {
        let parts = self.parts(x, window);
        let points = parts.window.len();
        let mut out = Vec::with_capacity(40 * (points + 30));
        self.rates(&parts, &mut out);
        self.ranges(&parts, &mut out);
        self.contacts(&parts, x.flight_s() + 0.5 * (points - 1) as f64 * self.setting.period_s, &mut out);
        self.turn(x, points, &mut out);
        out
    }

    /// Finite differences of what is commanded, in and around the window.
    fn rates(&self, parts: &Parts<'_>, out: &mut Vec<f64>) {
        let (limits, period_s, lag_s) = (&self.setting.limits, self.setting.period_s, self.setting.lag_s);
        let around = (self.blend_max_s / period_s).ceil() as usize + 4;
        let before = (1..=around).rev().map(|k| parts.start.at(k as f64 * period_s));
        let after = (1..=around).map(|k| parts.stop.at(k as f64 * period_s));
        let states = before.chain(parts.window.iter().copied()).chain(after);
        let commands: Vec<Axes> = states.map(|s| s.q + s.qd * lag_s).collect();
        for k in 1..commands.len() - 2 {
            let [v, a, j] = differences(&commands, k as isize, period_s);
            for i in 0..AXES {
                out.push(over(v[i].abs() / limits.v_max_rad_s[i]));
                out.push(over(a[i].abs() / limits.a_max_rad_s2[i]));
                out.push(over(j[i].abs() / limits.j_max_rad_s3[i]));
            }
        }
    }

    fn ranges(&self, parts: &Parts<'_>, out: &mut Vec<f64>) {
        let limits = &self.setting.limits;
        let mut test = |q: &Axes, qd: &Axes| {
            let command = q + qd * self.setting.lag_s;
            for i in 0..AXES {
                let outside = (q[i] - limits.q_max_rad[i])
                    .max(limits.q_min_rad[i] - q[i])
                    .max(self.setting.commands.outside_rad(i, &command));
                out.push((outside + SPARE).max(0.0));
            }
        };
        let at_rest = Axes::zeros(AXES);
        test(&parts.start.rest(), &at_rest);
        test(&parts.stop.rest(), &at_rest);
        for state in parts.window {
            test(&state.q, &state.qd);
        }
        for k in 1..RAMP_TESTS {
            let share = k as f64 / RAMP_TESTS as f64;
            for state in [
                parts.start.at(share * parts.start.duration_s()),
                parts.stop.at(share * parts.stop.duration_s()),
            ] {
                test(&state.q, &state.qd);
            }
        }
    }

    /// Floor, boxes, and the ball after the window; `flight_s` from the first step on the parabola to the target.
    fn contacts(&mut self, parts: &Parts<'_>, flight_s: f64, out: &mut Vec<f64>) {
        let period_s = self.setting.period_s;
        let window_s = (parts.window.len() - 1) as f64 * period_s;
        let (start_s, stop_s) = (parts.start.duration_s(), parts.stop.duration_s());
        let middle = parts.window[parts.window.len() / 2].q;
        let mut tests = vec![(middle, true)];
        for k in 0..=RAMP_TESTS {
            let share = k as f64 / RAMP_TESTS as f64;
            tests.push((parts.start.at(share * start_s).q, true));
            tests.push((parts.stop.at(share * stop_s).q, false));
        }
        let margins = *self.clear.margins();
        for (q, held) in tests {
            let frames = self.setting.arm.fk(&q);
            out.push(2.0 * (margins.floor_m + SPARE - self.clear.height_m(&frames)).max(0.0));
            let wanted_m = margins.boxes_m + SPARE;
            out.push(5.0 * (wanted_m - self.clear.distance_m(&frames, held, wanted_m)).max(0.0));
        }
        for k in 1..=BALL_TESTS {
            // Dense at first: there the ball is nearest to the hand.
            let s = (k as f64 / BALL_TESTS as f64).powi(2) * stop_s.min(flight_s - window_s).max(0.0);
            let frames = self.setting.arm.fk(&parts.stop.at(s).q);
            let center = parts.flight.position(window_s + s);
            out.push(10.0 * (1e-4 - self.clear.ball_spare_m(&frames, &center)).max(0.0));
        }
        // The target must not be reached inside the window.
        out.push((window_s + 0.05 - flight_s).max(0.0));
    }

    /// How far the hand is from being across the flight.
    fn turn(&self, x: &Variables, points: usize, out: &mut Vec<f64>) {
        let HandFreedom::Tilted(most_rad) = self.hand else { return };
        let half_s = 0.5 * (points - 1) as f64 * self.setting.period_s;
        let (flight, hand) = (x.flight(self.setting), x.hand());
        for t_s in [-half_s, 0.0, half_s] {
            out.push(2.0 * (hand.off_across_rad(&flight, t_s) + SPARE - most_rad).max(0.0));
        }
    }
}

/// Longest blend: four times the time of a smooth rise of the acceleration from zero to its limit within the jerk limit.
fn blend_max_s(setting: &Setting<'_>) -> f64 {
    let limits = &setting.limits;
    (6.0 * limits.a_max_rad_s2.component_div(&limits.j_max_rad_s3).amax()).min(1.0)
}

/// By how much the use of a limit is above one, less what is spared.
fn over(used: f64) -> f64 {
    (used - (1.0 - SPARE)).max(0.0)
}
