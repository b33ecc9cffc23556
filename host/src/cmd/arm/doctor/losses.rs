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

/// Asks every module [`ROUNDS`] times and reports which answers are missing.
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
    Ok(vec![of_counts(modules.iter().map(|report| report.module).zip(lost))])
}

/// One finding: modules that lose answers share what is wrong, or one of them has it alone.
fn of_counts(lost: impl Iterator<Item = (ModuleId, usize)>) -> Finding {
    const NAME: &str = "lost answers";
    let counts: Vec<(ModuleId, usize)> = lost.collect();
    let losing: Vec<(ModuleId, usize)> = counts.iter().copied().filter(|(_, lost)| *lost > 0).collect();
    let least = losing.iter().map(|(_, lost)| *lost).min();
    let most = losing.iter().map(|(_, lost)| *lost).max();
    let (Some(least), Some(most)) = (least, most) else {
        return finding(Level::Ok, NAME, format!("none of {ROUNDS} questions to each module"), "");
    };
    let percent = |lost: usize| 100.0 * lost as f64 / ROUNDS as f64;
    let share = if least == most {
        format!("{:.1} %", percent(most))
    } else {
        format!("{:.1} to {:.1} %", percent(least), percent(most))
    };
    let each: Vec<String> = losing.iter().map(|(_, lost)| lost.to_string()).collect();
    let what = format!("{} of {ROUNDS} questions unanswered ({share})", each.join(", "));
    let check = match losing.len() {
        _ if counts.len() == 1 => "check its plug, cable and supply, and the termination",
        1 => "the others lose nothing: check its plug, its cable and its supply",
        several if several == counts.len() => {
            "all modules lose frames: check what they share, which is the termination (60 ohm between CAN-H and CAN-L), \
             the cable up to the first module, the adapter and the supply"
        }
        _ => "the others lose nothing: check the cable, the plugs and the supply that these modules share",
    };
    let next = format!("{check}; the controller stops after two missed answers in a row");
    let modules: Vec<ModuleId> = losing.into_iter().map(|(module, _)| module).collect();
    of_modules(Level::Problem, NAME, &modules, what, next)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(counts: &[usize]) -> Finding {
        of_counts(ModuleId::all().zip(counts.iter().copied()))
    }

    #[test]
    fn one_lost_answer_is_a_problem_and_none_is_not() {
        assert_eq!(of(&[0, 0, 0]).level, Level::Ok);
        let one = of(&[0, 1, 0]);
        assert_eq!(one.level, Level::Problem);
        assert_eq!(one.text(), "module 2: 1 of 200 questions unanswered (0.5 %)");
    }

    #[test]
    fn losses_of_several_modules_are_one_finding_that_names_them() {
        let found = of(&[0, 30, 0, 40]);
        assert_eq!(found.text(), "modules 2, 4: 30, 40 of 200 questions unanswered (15.0 to 20.0 %)");
    }

    #[test]
    fn the_advice_tells_a_fault_of_one_module_from_one_that_all_share() {
        assert!(of(&[0, 40, 0]).next.contains("its plug"));
        assert!(of(&[30, 40, 50]).next.contains("termination"));
        assert!(of(&[30, 40, 0]).next.contains("these modules share"));
        assert!(of(&[30]).next.contains("termination"));
    }
}
