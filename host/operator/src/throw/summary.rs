//! A run in numbers: `summary.json`. Units are in the names of the keys.

use protocol::Duration;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use serde_json::{Value, json};

use super::outcome::Verdict;
use super::record::{Job, Record};
use crate::analysis::RunAnalysis;
use crate::analysis::tracking::ErrorSize;
use crate::bus::cycle_timing::CycleTiming;
use crate::bus::soft::SoftReport;
use planner::plan::file::VERSION as PLAN_VERSION;
use tuner::gains::choose::GainsFrom;

/// Version of the file.
pub const VERSION: u32 = 2;

/// Text for a run whose timing nobody can judge.
pub const NOT_COMPARED: &str = "the timing is not compared with a certificate: none is known for the gains of this controller, or the run was not heard";

/// What only the caller knows.
#[derive(Clone, Debug, Default)]
pub struct Circumstances<'a> {
    /// Bus as text.
    pub bus: &'a str,
    /// What supplied the time: `virtual time` or `real time`.
    pub time: &'a str,
    /// `soft`, or the number of a node.
    pub controller: &'a str,
    /// Seed of planner and cell.
    pub seed: u64,
    /// Exit code of the program.
    pub exit_code: u8,
    /// What ended the job early, as people read it.
    pub cause: Option<&'a str>,
    /// Errors that the bus reported.
    pub bus_errors: usize,
    /// Time of each step by the wall, in the order of the record.
    pub wall_s: &'a [f64],
    /// Time of planning by the wall, s.
    pub plan_s: f64,
    /// Where the gains come from.
    pub gains_from: GainsFrom,
    /// Checksum of the gains file as written; `None` if there is none.
    pub gains_crc32: Option<u32>,
    /// The soft controller's thread.
    pub soft: Option<&'a SoftReport>,
    /// Why the control period is what it is: `measured`, `given`, `virtual time`, `the controller's`.
    pub period_why: &'a str,
    /// What machine and bus held before the run.
    pub timing: Option<&'a CycleTiming>,
}

#[must_use]
pub fn summary(job: &Job<'_>, record: &Record, verdict: &Verdict, about: &Circumstances<'_>) -> Value {
    let plan = job.plan;
    let landing = record.landing;
    let steps: Vec<Value> = record
        .steps
        .iter()
        .enumerate()
        .map(|(i, (step, begun, ended))| {
            json!({
                "step": step.name(),
                "bus_time_s": ended.saturating_since(*begun).as_secs_f64(),
                "took_s": about.wall_s.get(i),
            })
        })
        .collect();
    json!({
        "format": "cubectl-throw",
        "version": VERSION,
        "outcome": verdict.outcome.json_name(),
        "outcome_text": verdict.text,
        "exit_code": about.exit_code,
        "cause": about.cause,
        "tolerance_m": verdict.tolerance_m,
        "ball": record.ball.json_name(),
        "ended_in_step": record.at_work.map(|(step, _)| step.name()),
        "bus": about.bus,
        "time": about.time,
        "controller": { "kind": about.controller, "node_id": record.node.map(NodeId::get) },
        "robot": plan.robot.name,
        "target_m": plan.target.position_m,
        "landing_error_m": landing.map(|landed| landed.error_m),
        "landing": landing.map(|landed| json!({
            "source": landed.source.json_name(),
            "observed": landed.source.is_observed(),
            "uncertainty_m": landed.uncertainty_m,
            "position_m": [landed.position_m.x, landed.position_m.y, landed.position_m.z],
            "release_late_s": landed.release_late_s,
            "touched_arm_after_s": landed.touch_after_s,
            "predicted_mean_m": plan.landing.mean_m,
            "predicted_covariance_m2": plan.landing.covariance_m2,
        })),
        "drives": record.drives,
        "gripper_opening_us": record.gripper_opening.map(Duration::as_micros),
        "tracking": record.analysis.as_ref().map(|analysis| json!({
            "error_max_rad": of_joints(analysis, |error| error.max),
            "error_rms_rad": of_joints(analysis, |error| error.rms),
        })),
        "analysis": record.analysis,
        "certified_timing": record.certified,
        "timing": timing(record),
        "cycle": cycle(record, about),
        "bus_load": load(record),
        "bus_errors": about.bus_errors,
        "frames_during_throw": record.frames,
        "plan": {
            "form": plan.search.form,
            "duration_s": plan.end_time_s,
            "release_s": plan.release_time_s,
            "flight_s": plan.landing.flight_s,
            "objective": plan.objective.value,
            "took_s": about.plan_s,
        },
        "gains_from": about.gains_from.json_name(),
        "approach_s": record.approach_s,
        "steps": steps,
        "seed": about.seed,
        "versions": { "cubectl": env!("CARGO_PKG_VERSION"), "plan": PLAN_VERSION, "trajectory": firmware::trajectory_format::VERSION },
        "hashes": {
            "robot_fingerprint": plan.robot.fingerprint,
            "trajectory_crc64": record.trajectory.map(|name| format!("{:016x}", name.trajectory_crc64)),
            "gains_crc32": about.gains_crc32.map(|crc| format!("{crc:08x}")),
            "certificate_crc32": format!("{:08x}", record.certificate_crc32),
        },
        "fault": fault(record),
    })
}

fn of_joints(analysis: &RunAnalysis, number: impl Fn(&ErrorSize) -> f64) -> Vec<f64> {
    analysis.joints.iter().map(|joint| number(&joint.position_error_rad)).collect()
}

/// Whether the run stayed within what its gains are certified for.
fn timing(record: &Record) -> Value {
    let coverage = record.analysis.as_ref().and_then(|analysis| analysis.coverage.as_ref());
    match coverage {
        Some(coverage) => json!({
            "verdict": if coverage.inside { "inside the certificate" } else { "outside the certificate" },
            "intervals": coverage.intervals,
            "outside": coverage.outside,
            "worst": coverage.worst,
            "text": coverage.sentence(),
        }),
        None => json!({ "verdict": "not compared", "text": NOT_COMPARED }),
    }
}

fn cycle(record: &Record, about: &Circumstances<'_>) -> Value {
    let states = record.states.iter().filter(|(_, group)| group.state == State::Running);
    let last = record.states.last().map(|(_, group)| *group).unwrap_or_default();
    json!({
        "period_us": record.period_us,
        "period_why": about.period_why,
        "measured_before": about.timing.map(CycleTiming::to_json),
        "jitter_max_us": states.map(|(_, group)| group.cycle_jitter_us).max(),
        "late": last.cycles_late.saturating_sub(record.before.cycles_late),
        "replies_missed": last.replies_missed.saturating_sub(record.before.replies_missed),
        "saturated": last.cycles_saturated.saturating_sub(record.before.cycles_saturated),
        "thread": about.soft.map(|soft| json!({
            "real_time_priority": soft.granted.priority,
            "memory_locked": soft.granted.memory,
            "deadline_late_mean_us": soft.deadlines.mean().map(Duration::as_micros),
            "deadline_late_p99_us": soft.deadlines.percentile(0.99).map(Duration::as_micros),
            "deadline_late_max_us": soft.deadlines.max().map(Duration::as_micros),
            "frames_unseen": soft.unseen,
        })),
    })
}

/// Share of the bus in use while the plan ran, without stuff bits, as the controller counts it.
fn load(record: &Record) -> Value {
    // The first message of a run is about the time before it.
    let running = record.states.iter().filter(|(_, group)| group.state == State::Running).skip(1);
    let loads: Vec<f64> = running.map(|(_, group)| f64::from(group.bus_load_permille) * 1e-3).collect();
    if loads.is_empty() {
        return Value::Null;
    }
    json!({
        "mean": loads.iter().sum::<f64>() / loads.len() as f64,
        "max": loads.iter().copied().fold(0.0, f64::max),
    })
}

fn fault(record: &Record) -> Value {
    let found = record.states.iter().map(|(_, group)| group).find(|group| group.fault_cause != 0);
    found.map_or(Value::Null, |group| {
        let cause = firmware::fault::Cause::from_code(group.fault_cause);
        json!({
            "cause": group.fault_cause,
            "name": cause.map(firmware::fault::Cause::name),
            "joint": group.fault_joint,
            "plan_time_s": f64::from(group.trajectory_time_us) * 1e-6,
        })
    })
}
