//! What a doctor hears beside a controller or another host that speaks to the modules: nothing is asked, because a motion
//! may be running and our questions would destroy its frames.

use firmware::fault::Cause;
use protocol::powercube::CubeState;

use super::{errors, state_finding};
use crate::cmd::finding::{Finding, Level, finding, grouped, of_modules};
use crate::cmd::survey::{Beside, Wanted};
use operator::bus::Session;

/// The controller with its fault, the modules that are heard and those that are not, and their states.
pub(super) fn find(session: &Session, beside: &Beside, wanted: &Wanted) -> Vec<Finding> {
    let mut findings = vec![controller(beside)];
    let heard: Vec<String> = beside.modules.iter().map(|(module, _)| module.to_string()).collect();
    if !heard.is_empty() {
        let what = format!("{} heard: {}", heard.len(), heard.join(", "));
        findings.push(finding(Level::Ok, "modules", what, ""));
    }
    let is_heard = |module| beside.modules.iter().any(|(heard, _)| *heard == module);
    for module in wanted.modules.iter().filter(|module| !is_heard(**module)) {
        let next = wanted.next_for_missing();
        findings.push(of_modules(Level::Problem, "modules", &[*module], "not heard", next));
    }
    findings.extend(errors(session, false));
    for (module, heard) in &beside.modules {
        let Some(state) = heard.state else { continue };
        findings.extend(state_finding(*module, state));
        if !state.contains(CubeState::HOME_OK) {
            findings.push(of_modules(Level::Note, "homing", &[*module], "not homed", "`cubectl home`"));
        }
    }
    grouped(findings)
}

fn controller(beside: &Beside) -> Finding {
    const NAME: &str = "controller";
    let line = beside.line();
    let (Some(_), Some(group)) = (beside.presence.controller, beside.group()) else {
        let next =
            "find out which program it is; end it for the other checks, or add --beside while nothing moves";
        return finding(Level::Problem, NAME, line, next);
    };
    match Cause::from_code(group.fault_cause) {
        Some(_) => {
            let next = format!(
                "`cubectl explain {}`, `cubectl explain --last`; remove the cause, then `cubectl controller clear`",
                group.fault_cause
            );
            finding(Level::Problem, NAME, line, next)
        }
        None => finding(Level::Ok, NAME, line, ""),
    }
}
