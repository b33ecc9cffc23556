//! How surely each module answers: it is asked again and again, once each time.
//!
//! A CAN controller repeats a disturbed frame by itself, so on a sound bus every question is answered. A controller stops
//! its group after two missed answers in a row; what is lost here would stop it.

use operator::bus::Session;
use operator::dialogue::ask::AskError;
use operator::dialogue::survey::ModuleReport;
use operator::node::drive_client::Policy;
use protocol::powercube::{Parameter, Request};
use protocol::{Duration, ModuleId};

use crate::cmd::finding::{Finding, Level, finding, of_modules};

/// Questions for each module.
const ROUNDS: usize = 200;
/// Time between two rounds: a plug that loses contact for as long within the two seconds of all rounds is seen.
const ROUND: Duration = Duration::from_millis(10);
/// Longer than any answer takes, also through a slow adapter.
const DEADLINE: Duration = Duration::from_millis(100);

/// Asks every module [`ROUNDS`] times and tells which answers stayed away.
///
/// # Errors
/// The bus is gone, or Ctrl-C.
pub(super) fn find(session: &mut Session, modules: &[ModuleReport]) -> Result<Vec<Finding>, AskError> {
    if modules.is_empty() {
        return Ok(Vec::new());
    }
    let before = session.host_node().drives.policy();
    session.host_node().drives.set_policy(Policy { deadline: DEADLINE, tries: 1, ..before });
    let questions: Vec<_> =
        modules.iter().map(|report| (report.module, Request::Get(Parameter::CubeState))).collect();
    let mut lost = vec![0; modules.len()];
    for _ in 0..ROUNDS {
        let begun = session.now();
        for (lost, answer) in lost.iter_mut().zip(session.ask_all(&questions)?) {
            *lost += usize::from(answer.is_err());
        }
        session.sleep_until(begun + ROUND)?;
    }
    session.host_node().drives.set_policy(before);
    Ok(of_counts(modules.iter().map(|report| report.module).zip(lost)))
}

fn of_counts(lost: impl Iterator<Item = (ModuleId, usize)>) -> Vec<Finding> {
    const NAME: &str = "lost answers";
    let mut findings = Vec::new();
    for (module, lost) in lost.filter(|(_, lost)| *lost > 0) {
        let what =
            format!("{lost} of {ROUNDS} questions unanswered ({:.1} %)", 100.0 * lost as f64 / ROUNDS as f64);
        let next = "frames are lost: check its plug, cable, supply and the termination; the controller stops after two \
                    missed answers in a row";
        findings.push(of_modules(Level::Problem, NAME, &[module], what, next));
    }
    if findings.is_empty() {
        findings.push(finding(Level::Ok, NAME, format!("none of {ROUNDS} questions to each module"), ""));
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_lost_answer_is_a_problem_and_none_is_not() {
        let modules = || ModuleId::all().take(3);
        let good = of_counts(modules().zip([0, 0, 0]));
        assert_eq!((good.len(), good[0].level), (1, Level::Ok));
        let bad = of_counts(modules().zip([0, 1, 40]));
        assert!(bad.iter().all(|found| found.level == Level::Problem), "{bad:?}");
        let texts: Vec<String> = bad.iter().map(Finding::text).collect();
        assert_eq!(
            texts,
            [
                "module 2: 1 of 200 questions unanswered (0.5 %)",
                "module 3: 40 of 200 questions unanswered (20.0 %)"
            ]
        );
    }
}
