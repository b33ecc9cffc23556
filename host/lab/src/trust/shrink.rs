//! From a scenario that breaks a rule to the smallest one that still does.
//!
//! Delta debugging over faults and actions, then one by one whatever can be simpler: lengths, repetitions, chances,
//! filters, starts, deviations of the arm. A step is kept only if the smaller scenario breaks the same rule.

use hil_sim::fault::{Fault, FaultKind, PhysicalFault, WireFault};
use hil_sim::mechanics::Scatter;
use hil_sim::scenario::Scenario;
use protocol::{Duration, Instant};

use super::swarm::canonical;

const LENGTH_MIN: Duration = Duration::from_millis(1);

/// Shrinks `scenario`. `fails` runs a candidate and returns whether it still breaks the rule; it is called at most
/// `runs_max` times.
pub fn shrink(scenario: &Scenario, runs_max: usize, fails: &mut dyn FnMut(&Scenario) -> bool) -> Scenario {
    let mut search = Search { best: scenario.clone(), left: runs_max, fails };
    loop {
        let before = search.left;
        let mut smaller = search.remove_faults();
        smaller |= search.remove_actions();
        smaller |= search.simplify_cell();
        for index in 0..search.best.faults.len() {
            smaller |= search.simplify_fault(index);
        }
        for index in 0..search.best.actions.len() {
            smaller |= search.simplify_action(index);
        }
        if !smaller || search.left == 0 || search.left == before {
            return search.best;
        }
    }
}

struct Search<'a> {
    best: Scenario,
    left: usize,
    fails: &'a mut dyn FnMut(&Scenario) -> bool,
}

impl Search<'_> {
    /// Takes the change if the scenario is another one then and still fails.
    fn attempt(&mut self, change: impl FnOnce(&mut Scenario)) -> bool {
        let mut candidate = self.best.clone();
        change(&mut candidate);
        let Ok(candidate) = canonical(&candidate) else { return false };
        if self.left == 0 || candidate == self.best {
            return false;
        }
        self.left -= 1;
        let fails = (self.fails)(&candidate);
        if fails {
            self.best = candidate;
        }
        fails
    }

    fn remove_faults(&mut self) -> bool {
        self.remove(|scenario| scenario.faults.len(), |scenario, range| drop(scenario.faults.drain(range)))
    }

    fn remove_actions(&mut self) -> bool {
        self.remove(|scenario| scenario.actions.len(), |scenario, range| drop(scenario.actions.drain(range)))
    }

    /// Halves first, then smaller parts, down to single entries.
    fn remove(
        &mut self,
        len: fn(&Scenario) -> usize,
        take_out: fn(&mut Scenario, std::ops::Range<usize>),
    ) -> bool {
        let mut smaller = false;
        let mut chunk = len(&self.best);
        while chunk > 0 {
            let mut from = 0;
            while from < len(&self.best) {
                let to = (from + chunk).min(len(&self.best));
                if self.attempt(|scenario| take_out(scenario, from..to)) {
                    smaller = true;
                } else {
                    from = to;
                }
            }
            chunk /= 2;
        }
        smaller
    }

    fn simplify_cell(&mut self) -> bool {
        let plain = Scenario::default().cell;
        let mut smaller = self.attempt(|scenario| {
            scenario.cell.scatter = Scatter::default();
            scenario.cell.drive.processing_delay = plain.drive.processing_delay;
            scenario.cell.drive.processing_jitter = plain.drive.processing_jitter;
            scenario.cell.gripper = plain.gripper;
            scenario.cell.logic_on_motor_supply = plain.logic_on_motor_supply;
        });
        smaller |= self.attempt(|scenario| scenario.cell.scatter = Scatter::default());
        smaller |= self.attempt(|scenario| scenario.cell.gripper = plain.gripper);
        smaller |= self.attempt(|scenario| scenario.cell.logic_on_motor_supply = plain.logic_on_motor_supply);
        smaller |= self.attempt(|scenario| {
            scenario.cell.drive.processing_delay = plain.drive.processing_delay;
            scenario.cell.drive.processing_jitter = plain.drive.processing_jitter;
        });
        smaller |= self.attempt(|scenario| scenario.cell.scatter.mass_share = 0.0);
        smaller |= self.attempt(|scenario| scenario.cell.scatter.com_m = 0.0);
        smaller |= self.attempt(|scenario| scenario.cell.scatter.friction_share = 0.0);
        smaller |= self.attempt(|scenario| scenario.cell.scatter.rotor_share = 0.0);
        smaller |= self.attempt(|scenario| scenario.cell.scatter.current_share = 0.0);
        smaller |= self.attempt(|scenario| scenario.cell.scatter.delay_share = 0.0);
        smaller |= self.attempt(|scenario| scenario.cell.scatter.home_rad = 0.0);
        smaller |= self.attempt(|scenario| scenario.seed = 1);
        smaller
    }

    fn simplify_fault(&mut self, index: usize) -> bool {
        let mut smaller = self.change_fault(index, |fault| fault.every = None);
        smaller |= self.change_fault(index, |fault| fault.probability = 1.0);
        smaller |= self.change_fault(index, |fault| fault.filter = None);
        while self.change_fault(index, halve_length) {
            smaller = true;
        }
        while self.change_fault(index, halve_size) {
            smaller = true;
        }
        for grid_us in [10_000, 1_000] {
            if self.change_fault(index, |fault| fault.start = rounded(fault.start, grid_us)) {
                smaller = true;
                break;
            }
        }
        smaller
    }

    fn change_fault(&mut self, index: usize, change: impl FnOnce(&mut Fault)) -> bool {
        self.attempt(|scenario| {
            if let Some(fault) = scenario.faults.get_mut(index) {
                change(fault);
            }
        })
    }

    fn simplify_action(&mut self, index: usize) -> bool {
        let once = |scenario: &mut Scenario| {
            if let Some(action) = scenario.actions.get_mut(index) {
                (action.every, action.count) = (None, None);
            }
        };
        let mut smaller = self.attempt(once);
        smaller |= self.attempt(|scenario| {
            if let Some(action) = scenario.actions.get_mut(index) {
                action.at = rounded(action.at, 1_000);
            }
        });
        smaller
    }
}

fn rounded(at: Instant, grid_us: u64) -> Instant {
    Instant::from_micros(at.as_micros() / grid_us * grid_us)
}

fn half(span: Duration) -> Duration {
    Duration::from_micros((span.as_micros() / 2_000).max(1) * 1_000)
}

fn halve_length(fault: &mut Fault) {
    // Without an end a fault is as long as a run; half a second is a first try.
    fault.length = match fault.length {
        None => Some(Duration::from_millis(500)),
        Some(length) => Some(half(length).max(LENGTH_MIN).min(length)),
    };
}

fn halve_size(fault: &mut Fault) {
    match &mut fault.kind {
        FaultKind::Wire(WireFault::Delay(by))
        | FaultKind::Physical(_, PhysicalFault::Slow(by) | PhysicalFault::LateRelease(by)) => {
            *by = half(*by).min(*by);
        }
        FaultKind::Physical(_, PhysicalFault::EncoderOffset { offset_rad }) => {
            // Whole degrees, down to one.
            let degrees = (offset_rad.to_degrees() / 2.0).round();
            if degrees != 0.0 {
                *offset_rad = degrees.to_radians();
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hil_sim::fault::{Place, Target};
    use hil_sim::swarm;
    use protocol::ModuleId;

    #[test]
    fn the_one_fault_that_matters_is_left_in_its_shortest_form() {
        let modules: Vec<ModuleId> = (1..=6).filter_map(|n| ModuleId::new(n).ok()).collect();
        let mut scenario = swarm::scenario(&Scenario::default(), 5, &modules);
        scenario.cell = Scenario::default().cell;
        scenario.cell.scatter.mass_share = 0.1;
        scenario.faults.clear();
        for (index, module) in modules.iter().enumerate() {
            scenario.faults.push(Fault {
                label: format!("fault {index}"),
                kind: FaultKind::Physical(Place::Module(*module), PhysicalFault::Frozen),
                target: Target::Module(*module),
                filter: None,
                start: Instant::from_micros(123_456),
                at: None,
                length: Some(Duration::from_millis(800)),
                every: Some(Duration::from_secs(3)),
                probability: 0.5,
            });
        }
        let mut runs = 0;
        let smallest = shrink(&scenario, 200, &mut |candidate| {
            runs += 1;
            candidate.faults.iter().any(|fault| {
                fault.target == Target::Module(modules[3])
                    && fault.length.is_none_or(|length| length >= Duration::from_millis(40))
            })
        });
        assert!((5..=200).contains(&runs), "{runs}");
        assert!(smallest.actions.is_empty());
        assert_eq!(smallest.cell, Scenario::default().cell);
        let [fault] = &smallest.faults[..] else { panic!("{:?}", smallest.faults) };
        assert_eq!((fault.every, fault.probability), (None, 1.0));
        assert_eq!(fault.start, Instant::from_micros(120_000));
        let length = fault.length.unwrap();
        assert!((40..80).contains(&(length.as_micros() / 1_000)), "{length}");
    }
}
