//! A catch over the wire: what went wrong, and what came of it, for people and for programs.

use operator::ball_catch::controller_arm::NoArm;
use operator::ball_catch::on_bus::Caught;
use operator::ball_catch::wire::WireError;
use serde_json::{Value, json};

use super::outcome::{mode_word, reported_text};
use crate::error::ExpectedError;
use crate::exit;
use crate::report::ball_catch::decision_word;

/// A catch that ended before its time, with its exit code.
pub fn failed(why: WireError) -> ExpectedError {
    match why {
        WireError::Bus(why) => why.into(),
        WireError::Operator(why) => (*why).into(),
        WireError::Settings(_) | WireError::Period(_) | WireError::Trajectory(_) => {
            ExpectedError::bad_input(&why)
        }
        WireError::Tracker { .. } | WireError::Silent { .. } => ExpectedError::of(exit::BUS, &why),
        WireError::NoWay(_) => ExpectedError::of(exit::NO_THROW, &why),
        WireError::NotReady => ExpectedError::of(exit::DRIVE, &why),
        WireError::Arm(why) => match *why {
            NoArm::Operator(why) => why.into(),
            NoArm::Bus(why) => why.into(),
            why => ExpectedError::of(exit::DRIVE, &WireError::from(why)),
        },
    }
}

/// The catch that was tried, answers of the controller and clocks as text; times count from `release_s` of the trial, at
/// which `began` happens.
#[must_use]
pub fn clocks_text(caught: &Caught, release_s: f64, began: &str) -> String {
    let mut out = String::new();
    if let Some(choice) = &caught.choice {
        out += &format!(
            "  {} catch {:.3} s after {began}, predicted probability {:.2}\n",
            mode_word(choice.mode),
            choice.t_s - release_s,
            choice.probability
        );
    }
    let tracker = &caught.tracker;
    out += &format!(
        "  end states: {} taken, {} refused; {} decisions, the longest {:.1} ms\n  tracker: {} datagrams, read {:.1} ms after the exposure (median; at most {:.1} ms); this machine less its clock {:.4} s; catcher's controller known to {:.1} ms{}\n",
        caught.answered.0,
        caught.answered.1,
        caught.log.len(),
        caught.longest_decision_s * 1e3,
        tracker.datagrams,
        tracker.age_s.0 * 1e3,
        tracker.age_s.1 * 1e3,
        tracker.offset_s,
        caught.clock_off_s * 1e3,
        match caught.clock_held {
            Some(true) => "",
            Some(false) => "; its clock has jumped",
            None => "; its clock was not readable at the end",
        }
    );
    out
}

/// A path as columns; times count from `release_s` of the trial.
pub fn path_json<T>(path: &[(f64, T)], release_s: f64, name: &str, numbers: impl Fn(&T) -> &[f64]) -> Value {
    json!({
        "t_s": path.iter().map(|(t_s, _)| t_s - release_s).collect::<Vec<_>>(),
        name: path.iter().map(|(_, at)| numbers(at)).collect::<Vec<_>>(),
    })
}

/// The catch as JSON; times count from `release_s` of the trial.
#[must_use]
pub fn as_json(caught: &Caught, release_s: f64) -> Value {
    let tracker = &caught.tracker;
    json!({
        "reported": reported_text(caught.reported),
        "lies_e_m": caught.lies_e_m.map(|lies| json!(lies.as_slice())),
        "choice": caught.choice.as_ref().map(|choice| json!({
            "mode": mode_word(choice.mode), "after_release_s": choice.t_s - release_s, "probability": choice.probability,
        })),
        "end_states": {"taken": caught.answered.0, "refused": caught.answered.1},
        "refusals": caught.refusals.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "decisions": caught.log.iter().map(|logged| json!({
            "after_release_s": logged.at_s - release_s, "decision": decision_word(&logged.decision),
            "probability": logged.probability, "sigma_m": logged.sigma_m, "off_m": logged.off_m,
        })).collect::<Vec<_>>(),
        "longest_decision_s": caught.longest_decision_s,
        "clocks": {
            "tracker_offset_s": tracker.offset_s,
            "datagrams": tracker.datagrams,
            "datagram_age_s": {"median": tracker.age_s.0, "max": tracker.age_s.1},
            "catcher_off_s": caught.clock_off_s,
            "catcher_held": caught.clock_held,
        },
        "trace": {
            "catcher": path_json(&caught.joints, release_s, "q_rad", |q| &q[..]),
            "ball": path_json(&caught.ball, release_s, "p_m", |p| p.as_slice()),
        },
    })
}
