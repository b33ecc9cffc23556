//! Makes a sequence that breaks a rule as short as it gets, and prints it as a test.

use crate::families::Family;
use crate::play::play;
use crate::rules::{Rule, Violation};
use crate::steps::{self, Act, Step, Who};

/// Seeds of a rule that are shrunk; the shortest result is kept.
const TRIED: usize = 4;

struct Case<F> {
    family: std::marker::PhantomData<F>,
    rule: Rule,
    start: [i16; 2],
    seed: u64,
    steps: Vec<Step>,
}

impl<F: Family> Case<F> {
    fn breaks(&self, steps: &[Step]) -> Option<Violation> {
        play::<F>(self.start, self.seed, steps).0.into_iter().find(|found| found.rule == self.rule)
    }

    /// Takes a shorter or simpler sequence if it breaks the rule still.
    fn try_with(&mut self, steps: Vec<Step>) -> bool {
        let taken = self.breaks(&steps).is_some();
        if taken {
            self.steps = steps;
        }
        taken
    }

    /// Delta debugging: leaves out pieces of half the length, a quarter and so on. Their time stays or goes.
    fn leave_out(&mut self) {
        let mut piece = self.steps.len().div_ceil(2);
        while piece > 0 {
            let mut at = 0;
            while at < self.steps.len() {
                let end = (at + piece).min(self.steps.len());
                let wait: u16 = self.steps[at..end].iter().map(|(wait, _)| wait).sum();
                let mut later = self.steps.clone();
                later.drain(at..end);
                let sooner = later.clone();
                if let Some(next) = later.get_mut(at) {
                    next.0 += wait;
                }
                if !self.try_with(sooner) && !self.try_with(later) {
                    at = end;
                }
            }
            piece /= 2;
        }
    }

    /// Shorter times, and simpler values.
    fn simplify(&mut self) {
        for at in 0..self.steps.len() {
            for share in [0.0, 0.25, 0.5, 0.75] {
                let mut steps = self.steps.clone();
                steps[at].0 = (f64::from(steps[at].0) * share) as u16;
                if steps[at].0 < self.steps[at].0 && self.try_with(steps) {
                    break;
                }
            }
            for act in simpler(self.steps[at].1) {
                let mut steps = self.steps.clone();
                steps[at].1 = act;
                self.try_with(steps);
            }
        }
    }
}

fn simpler(act: Act) -> Vec<Act> {
    match act {
        Act::Stop(Who::Other) => vec![Act::Stop(Who::Host)],
        Act::StopMessage(Who::Other) => vec![Act::StopMessage(Who::Host)],
        Act::EmergencyStop(Who::Other) => vec![Act::EmergencyStop(Who::Host)],
        Act::Disarm(Who::Other) => vec![Act::Disarm(Who::Host)],
        Act::Late(ms) => vec![Act::Late(ms / 2), Act::Late(5)],
        Act::Upload { hand, .. } => vec![Act::Upload { mrad: [100, 0], ms: 1_000, hand }],
        _ => Vec::new(),
    }
}

/// Shrinks the first seeds that break a rule and prints the shortest sequence.
pub(crate) fn shortest<F: Family>(rule: Rule, seeds: &[u64], count: usize) -> String {
    let shrunk = seeds.iter().take(TRIED).map(|&seed| {
        let (start, steps) = steps::draw(seed, count);
        let mut case = Case::<F> { family: std::marker::PhantomData, rule, start, seed, steps };
        loop {
            let before = case.steps.clone();
            case.leave_out();
            case.simplify();
            if case.steps == before {
                break case;
            }
        }
    });
    let case = shrunk.min_by_key(|case| case.steps.len()).expect("a seed that breaks the rule");
    let found = case.breaks(&case.steps).expect("shrinking keeps the rule broken");
    let steps: String = case.steps.iter().map(|step| format!("        {step:?},\n")).collect();
    format!(
        "{rule:?} is broken by {} seeds of {seeds:?}; seed {}, {count} steps, shrunk to {}:\n{} s: {}\n    \
         keeps({:?}, {}, &[\n{steps}    ]);\n",
        seeds.len(),
        case.seed,
        case.steps.len(),
        found.at,
        found.what,
        case.start,
        case.seed,
    )
}
