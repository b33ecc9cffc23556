//! One joint of a stream: speed, acceleration and jerk are bounded, and the joint can stop at any time.
//!
//! In each tick the jerk towards the goal is as large as possible. The limit: after the tick the joint must still be able to stop within its
//! bounds and before its goal. A stop has up to three pieces of constant jerk, in closed form.

/// Position, velocity and acceleration of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointState {
    pub q_rad: f64,
    pub qd_rad_s: f64,
    pub qdd_rad_s2: f64,
}

impl JointState {
    /// After `t_s` with a constant jerk.
    fn after(self, jerk_rad_s3: f64, t_s: f64) -> Self {
        let Self { q_rad: q, qd_rad_s: v, qdd_rad_s2: a } = self;
        let j = jerk_rad_s3;
        Self {
            q_rad: q + t_s * (v + t_s * (a / 2.0 + t_s * j / 6.0)),
            qd_rad_s: v + t_s * (a + t_s * j / 2.0),
            qdd_rad_s2: a + t_s * j,
        }
    }

    /// The speed when the acceleration has come to zero, with the jerk `j_rad_s3`.
    fn coming_speed(self, j_rad_s3: f64) -> f64 {
        self.qd_rad_s + self.qdd_rad_s2 * self.qdd_rad_s2.abs() / (2.0 * j_rad_s3)
    }

    /// Least and largest speed from now to `t_s` with a constant jerk; the present speed does not count.
    fn speeds(self, jerk_rad_s3: f64, t_s: f64) -> (f64, f64) {
        let end = self.after(jerk_rad_s3, t_s);
        let has_peak = self.qdd_rad_s2 * end.qdd_rad_s2 < 0.0;
        let peak = if has_peak { self.coming_speed(jerk_rad_s3.abs()) } else { end.qd_rad_s };
        (end.qd_rad_s.min(peak), end.qd_rad_s.max(peak))
    }

    fn mirrored(self) -> Self {
        Self { q_rad: -self.q_rad, qd_rad_s: -self.qd_rad_s, qdd_rad_s2: -self.qdd_rad_s2 }
    }
}

/// What a joint keeps to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bounds {
    pub q_min_rad: f64,
    pub q_max_rad: f64,
    pub v_rad_s: f64,
    pub a_rad_s2: f64,
    pub j_rad_s3: f64,
}

/// Where a joint is to be, or how fast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointGoal {
    /// Rest at this angle, rad.
    Position(f64),
    /// This speed, rad/s.
    Speed(f64),
}

impl Default for JointGoal {
    /// Rest.
    fn default() -> Self {
        Self::Speed(0.0)
    }
}

impl JointGoal {
    fn mirrored(self) -> Self {
        match self {
            Self::Position(q_rad) => Self::Position(-q_rad),
            Self::Speed(qd_rad_s) => Self::Speed(-qd_rad_s),
        }
    }
}

/// Halvings when a jerk is looked for: 2⁻³⁰ of the whole range.
const HALVINGS: u32 = 30;
/// Share of a bound that is put down to rounding.
const ROUNDING: f64 = 1e-9;

/// The way to rest with the full jerk: pieces of constant jerk, some of length zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stop {
    from: JointState,
    /// Duration, s, and jerk, rad/s³.
    pieces: [(f64, f64); 3],
}

impl Stop {
    /// From a state within the bounds.
    #[must_use]
    pub fn new(from: JointState, bounds: &Bounds) -> Self {
        let (j, most) = (bounds.j_rad_s3, bounds.a_rad_s2);
        let coming = from.coming_speed(j);
        let side = if coming < 0.0 { -1.0 } else { 1.0 };
        let (v, a) = (side * from.qd_rad_s, side * from.qdd_rad_s2);
        // The acceleration goes to -peak, stays there if the peak is bounded, and comes back to zero with the speed.
        let peak = (j * v + 0.5 * a * a).max(0.0).sqrt();
        let (peak, hold_s) =
            if peak > most { (most, (v + (0.5 * a * a - most * most) / j) / most) } else { (peak, 0.0) };
        let pieces = [((a + peak).max(0.0) / j, -side * j), (hold_s.max(0.0), 0.0), (peak / j, side * j)];
        Self { from, pieces }
    }

    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.pieces.iter().map(|(t_s, _)| t_s).sum()
    }

    /// State `t_s` after the begin; rest after the end.
    #[must_use]
    pub fn at(&self, t_s: f64) -> JointState {
        let (mut state, mut left_s) = (self.from, t_s);
        for (length_s, jerk) in self.pieces {
            state = state.after(jerk, length_s.min(left_s.max(0.0)));
            left_s -= length_s;
        }
        if left_s >= 0.0 { JointState { q_rad: state.q_rad, ..JointState::default() } } else { state }
    }

    /// Where the joint rests, rad.
    #[must_use]
    pub fn rest_rad(&self) -> f64 {
        self.at(f64::INFINITY).q_rad
    }

    /// Where the joint turns on its way to rest, if it does: it moves one way and its acceleration is that of the other.
    fn turn(&self) -> Option<(f64, f64)> {
        let (v, coming) = (self.from.qd_rad_s, self.from.coming_speed(self.pieces[2].1.abs()));
        if v * coming >= 0.0 {
            return None;
        }
        // The speed changes its sign while the acceleration still has it: in the first piece.
        let (length_s, jerk) = self.pieces[0];
        let mut span = (0.0, length_s);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (span.0 + span.1);
            if self.from.after(jerk, middle).qd_rad_s * v > 0.0 { span.0 = middle } else { span.1 = middle }
        }
        Some((span.1, self.from.after(jerk, span.1).q_rad))
    }

    /// Least and largest angle on the way, rad.
    #[must_use]
    pub fn extent_rad(&self) -> (f64, f64) {
        let (from, rest) = (self.from.q_rad, self.rest_rad());
        let turn = self.turn().map_or(from, |(_, q_rad)| q_rad);
        (from.min(rest).min(turn), from.max(rest).max(turn))
    }

    /// Way between two times, rad; turning counts both ways.
    #[must_use]
    pub fn travel_rad(&self, t0_s: f64, t1_s: f64) -> f64 {
        let (q0, q1) = (self.at(t0_s).q_rad, self.at(t1_s).q_rad);
        match self.turn() {
            Some((t_s, q_rad)) if t0_s < t_s && t_s < t1_s => (q_rad - q0).abs() + (q1 - q_rad).abs(),
            _ => (q1 - q0).abs(),
        }
    }
}

/// The state after a tick of `dt_s` on the way to `goal`. If the joint can stop within its bounds before the tick, it can do so after it.
///
/// The speed keeps its bound also between the ticks. The angle keeps its range at the ticks; between them it is at most `j·dt³/3` beyond.
pub(super) fn next(state: JointState, goal: JointGoal, bounds: &Bounds, dt_s: f64) -> JointState {
    let goal = before_the_end(&state, goal, bounds, dt_s);
    if let Some(there) = arrived(&state, goal, bounds, dt_s) {
        return there;
    }
    let upwards = match goal {
        JointGoal::Position(q_rad) => Stop::new(state, bounds).rest_rad() <= q_rad,
        JointGoal::Speed(qd_rad_s) => state.coming_speed(bounds.j_rad_s3) <= qd_rad_s,
    };
    if upwards {
        return highest(state, goal, bounds, dt_s);
    }
    let mirrored = Bounds { q_min_rad: -bounds.q_max_rad, q_max_rad: -bounds.q_min_rad, ..*bounds };
    highest(state.mirrored(), goal.mirrored(), &mirrored, dt_s).mirrored()
}

/// Near an end of the range, a speed towards that end becomes a position: the end.
fn before_the_end(state: &JointState, goal: JointGoal, bounds: &Bounds, dt_s: f64) -> JointGoal {
    let JointGoal::Speed(speed) = goal else { return goal };
    let (low, high) = Stop::new(*state, bounds).extent_rad();
    let near = bounds.j_rad_s3 * dt_s.powi(3);
    if speed > 0.0 && bounds.q_max_rad - high < near {
        JointGoal::Position(bounds.q_max_rad)
    } else if speed < 0.0 && low - bounds.q_min_rad < near {
        JointGoal::Position(bounds.q_min_rad)
    } else {
        goal
    }
}

/// The goal itself, if the state is so near that one tick of jerk would move the joint beyond it, back and forth.
fn arrived(state: &JointState, goal: JointGoal, bounds: &Bounds, dt_s: f64) -> Option<JointState> {
    let step = bounds.j_rad_s3 * dt_s;
    let (q_rad, qd_rad_s) = match goal {
        JointGoal::Position(q_rad) => (q_rad, 0.0),
        JointGoal::Speed(speed) => (state.q_rad + 0.5 * (state.qd_rad_s + speed) * dt_s, speed),
    };
    let is_near = state.qdd_rad_s2.abs() <= step
        && (state.qd_rad_s - qd_rad_s).abs() <= step * dt_s / 8.0
        && (matches!(goal, JointGoal::Speed(_)) || (state.q_rad - q_rad).abs() <= step * dt_s * dt_s / 32.0);
    let in_range = (bounds.q_min_rad..=bounds.q_max_rad).contains(&q_rad) && qd_rad_s.abs() <= bounds.v_rad_s;
    let there = JointState { q_rad, qd_rad_s, qdd_rad_s2: 0.0 };
    let extent = Stop::new(there, bounds).extent_rad();
    let can_stop = extent.0 >= bounds.q_min_rad && extent.1 <= bounds.q_max_rad;
    (is_near && in_range && can_stop).then_some(there)
}

/// With the largest jerk that does not lead beyond the goal.
fn highest(state: JointState, goal: JointGoal, bounds: &Bounds, dt_s: f64) -> JointState {
    let (j, a) = (bounds.j_rad_s3, bounds.a_rad_s2);
    let (q_goal, v_goal) = match goal {
        JointGoal::Position(q_rad) => (q_rad.min(bounds.q_max_rad), bounds.v_rad_s),
        JointGoal::Speed(qd_rad_s) => (f64::INFINITY, qd_rad_s.min(bounds.v_rad_s)),
    };
    let stop = Stop::new(state, bounds);
    // What is unavoidable already may be.
    let (v_goal, q_goal) = (v_goal.max(state.coming_speed(j)), q_goal.max(stop.extent_rad().1));
    // The speed also within the tick: it has a peak there if the acceleration changes its sign.
    let below = |jerk: f64| {
        let end = state.after(jerk, dt_s);
        end.coming_speed(j).max(state.speeds(jerk, dt_s).1) <= v_goal
            && Stop::new(end, bounds).extent_rad().1 <= q_goal.min(bounds.q_max_rad)
    };
    // Within the bounds in the other direction, too.
    let above = |jerk: f64| {
        let end = state.after(jerk, dt_s);
        end.coming_speed(j).min(state.speeds(jerk, dt_s).0) >= -bounds.v_rad_s * (1.0 + ROUNDING)
            && Stop::new(end, bounds).extent_rad().0 >= bounds.q_min_rad
    };
    let most = j.min((a - state.qdd_rad_s2) / dt_s);
    let least = (-j).max((-a - state.qdd_rad_s2) / dt_s);
    let best = if below(most) {
        Some(most)
    } else if below(least) {
        let mut span = (least, most);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (span.0 + span.1);
            if below(middle) { span.0 = middle } else { span.1 = middle }
        }
        Some(span.0)
    } else {
        None
    };
    best.filter(|jerk| above(*jerk)).map_or_else(|| stop.at(dt_s), |jerk| state.after(jerk, dt_s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DT_S: f64 = 0.02;
    const BOUNDS: Bounds =
        Bounds { q_min_rad: -1.5, q_max_rad: 2.0, v_rad_s: 1.2, a_rad_s2: 3.0, j_rad_s3: 25.0 };

    fn within(state: &JointState) {
        let slack = 1e-6;
        assert!(
            state.q_rad >= BOUNDS.q_min_rad - slack && state.q_rad <= BOUNDS.q_max_rad + slack,
            "{state:?}"
        );
        assert!(state.qd_rad_s.abs() <= BOUNDS.v_rad_s + slack, "{state:?}");
        assert!(state.qdd_rad_s2.abs() <= BOUNDS.a_rad_s2 + slack, "{state:?}");
    }

    /// Position, velocity and acceleration go on: a jerk within the bound explains each tick.
    fn explained(from: &JointState, to: &JointState) {
        let change = (to.qdd_rad_s2 - from.qdd_rad_s2).abs();
        assert!(change <= BOUNDS.j_rad_s3 * DT_S + 1e-9, "{from:?} to {to:?}");
        let mean = 0.5 * (from.qd_rad_s + to.qd_rad_s) * DT_S;
        let most = BOUNDS.j_rad_s3 * DT_S.powi(3) / 6.0;
        assert!((to.q_rad - from.q_rad - mean).abs() <= most, "{from:?} to {to:?}");
        if from.qdd_rad_s2 * to.qdd_rad_s2 < 0.0 {
            let (a0, a1) = (from.qdd_rad_s2, to.qdd_rad_s2);
            let peak = from.qd_rad_s + 0.5 * a0 * DT_S * a0 / (a0 - a1);
            assert!(peak.abs() <= BOUNDS.v_rad_s + 1e-6, "{peak} rad/s from {from:?} to {to:?}");
        }
    }

    #[test]
    fn a_position_is_reached_in_the_time_of_the_closed_form_plus_five_ticks_and_kept() {
        for goal in [1.7, -1.2, 0.03, -1e-4] {
            let (mut state, mut ticks) = (JointState::default(), 0);
            while (state.q_rad - goal).abs() > 1e-6 || state.qd_rad_s.abs() > 1e-6 {
                let to = next(state, JointGoal::Position(goal), &BOUNDS, DT_S);
                within(&to);
                explained(&state, &to);
                (state, ticks) = (to, ticks + 1);
                assert!(ticks < 1000, "{goal}: {state:?}");
            }
            let law =
                crate::timing::Straight::new(goal.abs(), BOUNDS.v_rad_s, BOUNDS.a_rad_s2, BOUNDS.j_rad_s3);
            let took_s = f64::from(ticks) * DT_S;
            assert!(took_s >= law.duration_s() - DT_S, "{goal}: {took_s} s");
            assert!(took_s <= law.duration_s() + 5.0 * DT_S, "{goal}: {took_s} s for {}", law.duration_s());
            for _ in 0..20 {
                state = next(state, JointGoal::Position(goal), &BOUNDS, DT_S);
                assert!((state.q_rad - goal).abs() < 2e-6, "{state:?}");
            }
        }
    }

    #[test]
    fn a_speed_is_reached_and_ends_at_rest_before_the_end_of_the_range() {
        let mut state = JointState::default();
        for _ in 0..40 {
            state = next(state, JointGoal::Speed(0.8), &BOUNDS, DT_S);
        }
        assert!((state.qd_rad_s - 0.8).abs() < 1e-6, "{state:?}");
        for _ in 0..400 {
            let to = next(state, JointGoal::Speed(0.8), &BOUNDS, DT_S);
            within(&to);
            explained(&state, &to);
            state = to;
        }
        assert!(state.qd_rad_s.abs() < 1e-3 && state.q_rad > BOUNDS.q_max_rad - 1e-3, "{state:?}");
    }

    #[test]
    fn speed_just_below_the_limit_is_not_passed_on_the_way_to_it() {
        let coming = JointState { q_rad: 0.0, qd_rad_s: 1.1982948, qdd_rad_s2: 0.291992 };
        for goal in [1.1999187, 1.1999332, 1.2, 1.19, 0.0] {
            for side in [1.0, -1.0] {
                let from = if side > 0.0 { coming } else { coming.mirrored() };
                let to = next(from, JointGoal::Speed(side * goal), &BOUNDS, DT_S);
                within(&to);
                explained(&from, &to);
            }
        }
    }

    proptest! {
        #[test]
        fn bounds_hold_whatever_is_asked_for(goals in proptest::collection::vec((any::<bool>(), -6.0f64..6.0, 1usize..30), 1..40)) {
            let mut state = JointState::default();
            for (speed, number, ticks) in goals {
                let goal = if speed { JointGoal::Speed(number) } else { JointGoal::Position(number) };
                for _ in 0..ticks {
                    let to = next(state, goal, &BOUNDS, DT_S);
                    within(&to);
                    explained(&state, &to);
                    let stop = Stop::new(to, &BOUNDS);
                    let rest = stop.at(stop.duration_s());
                    prop_assert!(rest.qd_rad_s.abs() < 1e-9 && (rest.q_rad - stop.rest_rad()).abs() < 1e-9);
                    let extent = stop.extent_rad();
                    for i in 0..=20 {
                        let along = stop.at(stop.duration_s() * f64::from(i) / 20.0);
                        within(&along);
                        prop_assert!(along.q_rad >= extent.0 - 1e-7 && along.q_rad <= extent.1 + 1e-7);
                    }
                    state = to;
                }
            }
        }
    }
}
