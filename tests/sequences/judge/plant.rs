//! Rules that are judged from drives and joints, every millisecond.

use super::*;

impl Judge {
    /// Looks at the joints and the drives themselves, once per millisecond.
    pub(crate) fn look<F: Family>(&mut self, lab: &Lab<F>) {
        let now = lab.now();
        let excuse = self.excuse(now);
        self.plant = lab.plant();
        let mask = self.state.map_or(0, |state| state.homed_mask);
        self.homed = F::homed(lab.drives(), now)
            .unwrap_or_else(|| std::array::from_fn(|joint| mask >> joint & 1 == 1));
        if let Some((deadline, at)) = lab.stuck() {
            self.broken(
                Rule::Deadline,
                at,
                format!("asks for {deadline} s although it was served at {at} s"),
            );
        }
        if let Some((stop, due)) = self.halt_due.filter(|(_, due)| *due + excuse < now) {
            self.halt_due = None;
            self.broken(Rule::Stop, due, format!("no halt after the stop at {stop} s"));
        }
        for joint in 0..JOINTS {
            self.look_at(now, excuse, joint);
        }
        self.travel(now, excuse);
        self.look_at_drives(lab, now);
        let keep = |permit: &Permit| {
            permit.until == NEVER || permit.until + permit.brake + excuse + Duration::from_millis(100) > now
        };
        self.permits.retain(keep);
        if let Some((due, run)) = self.hand_due.filter(|(due, _)| *due + excuse <= now) {
            self.hand_due = None;
            let unbroken = self.permits.iter().any(|permit| permit.sent == run && permit.until == NEVER);
            let is_open = F::is_open(lab.drives()).unwrap_or(true);
            let heard = self.deaf_until + Duration::from_millis(500) < now;
            if unbroken && self.kind() == Some(State::Running) && heard && !is_open {
                self.broken(Rule::Start, now, format!("the gripper is closed at {due} s"));
            }
        }
    }

    fn look_at(&mut self, now: Instant, excuse: Duration, joint: usize) {
        let (q, v) = self.plant[joint];
        if v.abs() < STILL_RAD_S {
            return;
        }
        let covers = |permit: &&Permit| {
            permit.joints >> joint & 1 == 1
                && permit.from <= now
                && (permit.until == NEVER || now <= permit.until + permit.brake + excuse)
                && permit.v_rad_s * v >= 0.0
        };
        if !self.permits.iter().any(|permit| covers(&permit)) {
            let what = format!("joint {joint} at {q:.4} rad moves at {v:.4} rad/s: {:?}", self.permits);
            self.broken(Rule::Motion, now, what);
        }
        let outwards = (q > self.q_max + 6e-3 && v > 0.0) || (q < -0.606 && v < 0.0);
        if outwards && self.homed[joint] {
            let what = format!("joint {joint} at {q:.4} rad moves outwards at {v:.4} rad/s");
            self.broken(Rule::Limits, now, what);
        }
    }

    /// How far a joint goes on after it was let go.
    fn travel(&mut self, now: Instant, excuse: Duration) {
        let plant = self.plant;
        let mut far = None;
        for index in 0..self.permits.len() {
            let permit = self.permits[index];
            if permit.v_rad_s == 0.0 || permit.until > now {
                continue;
            }
            let joint = permit.joints.trailing_zeros() as usize;
            let others = self.permits.iter().enumerate().any(|(i, other)| {
                i != index
                    && other.joints >> joint & 1 == 1
                    && (other.until > permit.until || other.from > permit.until)
            });
            if others {
                // What the joint does by another order is not this one's.
                self.permits[index].let_go = None;
                continue;
            }
            let Some(from) = permit.let_go else {
                self.permits[index].let_go = Some(plant);
                continue;
            };
            let (q, v) = from[joint];
            // A drive that was sent on at the speed of the order may still gain it.
            let v = v.abs().max(permit.v_rad_s.abs());
            let most = 0.5 * v * v / JOG_A_RAD_S2 + 0.25 * (0.03 + excuse.as_secs_f64()) + 3e-3;
            let gone = (plant[joint].0 - q).abs();
            if gone > most {
                far = Some(format!(
                    "joint {joint} goes on by {gone:.4} rad after {v:.3} rad/s, {most:.4} allowed"
                ));
            }
        }
        if let Some(what) = far {
            self.broken(Rule::Motion, now, what);
        }
    }

    fn look_at_drives<F: Family>(&mut self, lab: &Lab<F>, now: Instant) {
        // A stop is known before the state that it leads to is published.
        let armed = matches!(self.kind(), Some(State::Armed | State::Running))
            && self.last_stop.is_none_or(|stop| stop < self.state_since);
        let settled = self.state_since + HELD_AFTER < now;
        let restarts = self.restarted_at.is_some_and(|at| at + Duration::from_millis(1_500) > now);
        // An order that is refused while armed is taken where a missed start has not been reported yet.
        let slow = |sent: &Sent| {
            matches!(sent.order, Order::Home(_) | Order::Jog { .. })
                && sent.done.is_some_and(|done| done + SLACK > now)
        };
        if !armed || !settled || restarts || self.sent.iter().rev().any(slow) {
            return;
        }
        // A drive whose controller is not called for longer than its time-out gives no torque; that is known a little later.
        if !F::IS_POWERCUBE && !self.excuse(now).is_zero() {
            return;
        }
        for joint in 0..JOINTS {
            if let Some(what) = F::held_wrong(lab.drives(), joint, self.current_a, self.watchdog) {
                self.broken(Rule::Held, now, what);
            }
        }
    }
}
