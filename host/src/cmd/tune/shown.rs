//! What is shown of a design: the table of its joints, JSON, and the page.

use std::fmt::Write as _;

use super::Work;
use super::trial::{self, Row};
use crate::error::ExpectedError;
use crate::report::tune::{self as report, Table};
use tuner::gains::design::Tuned;
use tuner::gains::machine::Demand;

/// The report.
pub(super) fn page(
    work: &Work,
    tuned: &[Tuned],
    short: Option<&ExpectedError>,
    rows: Option<&[Row]>,
) -> String {
    let joints = Table {
        head: HEAD.to_vec(),
        rows: tuned.iter().map(|joint| cells(joint).to_vec()).collect(),
        columns: &COLUMNS,
    };
    let mut tables = vec![("Gains and figures", joints)];
    tables.extend(rows.map(|rows| ("On the simulated cell", trial::table(rows))));
    let short = short.map(|short| (short.what.as_str(), short.next.first().map_or("", String::as_str)));
    let under = demanded(&work.demand);
    report::html(&work.machine.robot, &under, short, tuned, &tables)
}

pub(super) fn json(work: &Work, tuned: &[Tuned], tried: Option<&[Row]>) -> serde_json::Value {
    let joints = tuned.iter().map(|joint| {
        serde_json::json!({
            "number": joint.input.joint,
            "k_pos_1_s2": joint.gains[0],
            "k_vel_1_s": joint.gains[1],
            "k_last": joint.gains[2],
            "decay_1_s": joint.decay_1_s(),
            "overshoot": joint.evidence.map(|seen| seen.overshoot),
            "settles_s": joint.evidence.map(|seen| seen.settling_s),
            "delay_margin_s": joint.figures.delay_margin_s,
            "margin": joint.margin(),
        })
    });
    serde_json::json!({
        "robot": work.machine.robot,
        "period_s": work.demand.period_s,
        "period_jitter_ratio": work.demand.period_jitter,
        "delay_s": work.demand.delay_s,
        "error_position_rad": work.demand.error_position_rad,
        "error_velocity_rad_s": work.demand.error_velocity_rad_s,
        "joints": joints.collect::<Vec<_>>(),
        "rows": tried,
    })
}

/// Columns of the table of joints and what they mean.
const COLUMNS: [(&str, &str); 8] = [
    ("k_pos 1/s2", "gain on the position error, as the controller holds it"),
    ("k_vel 1/s", "on its rate; k_last is on the last command"),
    ("left rad/s2", "acceleration that the motion leaves to correct with: what is clipped to"),
    ("decay 1/s", "proven: errors fall at least so fast, clipped or not, at every period and delay above"),
    ("overshoot", "simulated from a pure position error, largest over periods and delays"),
    ("settles s", "simulated until the worst initial error stays below 2 % of its size"),
    ("more delay ms", "additional delay at which the loop becomes unstable"),
    ("margin", "smallest proven eigenvalue of the certificate; above 0 it holds"),
];

/// Headings of the table of joints.
const HEAD: [&str; 10] = [
    "joint",
    "k_pos 1/s2",
    "k_vel 1/s",
    "k_last",
    "left rad/s2",
    "decay 1/s",
    "overshoot",
    "settles s",
    "more delay ms",
    "margin",
];

fn cells(joint: &Tuned) -> [String; 10] {
    let left = joint.problem.phases().iter().map(|p| p.u_max_rad_s2).fold(f64::INFINITY, f64::min);
    let (overshoot, settling) = match &joint.evidence {
        Some(e) => (format!("{:.1} %", 100.0 * e.overshoot), format!("{:.3}", e.settling_s)),
        None => ("-".into(), "-".into()),
    };
    let [k_pos, k_vel, k_last] = joint.gains;
    [
        joint.input.joint.to_string(),
        format!("{k_pos:.2}"),
        format!("{k_vel:.3}"),
        format!("{k_last:.4}"),
        format!("{left:.2}"),
        format!("{:.2}", joint.decay_1_s()),
        overshoot,
        settling,
        format!("{:.1}", 1e3 * joint.figures.delay_margin_s),
        format!("{:.1e}", joint.margin()),
    ]
}

/// What was asked for.
fn demanded(demand: &Demand) -> String {
    format!(
        "period {} ms +-{:.0} %, delay {:.2} to {:.2} ms, initial errors {} rad and {} rad/s",
        demand.period_s * 1e3,
        demand.period_jitter * 1e2,
        demand.delay_s.0 * 1e3,
        demand.delay_s.1 * 1e3,
        demand.error_position_rad,
        (1e4 * demand.error_velocity_rad_s).round() / 1e4
    )
}

/// Table for the terminal, with a line for each column.
pub(super) fn table(robot: &str, demand: &Demand, tuned: &[Tuned]) -> String {
    let mut t = format!("{robot}, {}\n", demanded(demand));
    let mut line = |cells: &[&str]| {
        let padded: Vec<String> =
            HEAD.iter().zip(cells).map(|(head, cell)| format!("{cell:>0$}", head.len().max(8))).collect();
        let _ = writeln!(t, "{}", padded.join("  "));
    };
    line(&HEAD);
    for joint in tuned {
        line(&cells(joint).each_ref().map(String::as_str));
    }
    trial::explain(&mut t, &COLUMNS);
    t
}
