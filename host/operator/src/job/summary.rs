//! A record in numbers: `summary.json`. Units are in the names of the keys. `null`: the link or the judge does not know it.

use protocol::Duration;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use serde_json::{Value, json};

use super::order::{Judge, Order};
use super::record::{Record, Step};
use crate::analysis::RunAnalysis;
use crate::analysis::tracking::ErrorSize;
use crate::bus::cycle_timing::CycleTiming;
use crate::bus::soft::SoftReport;
use crate::drives::difference_text;
use planner::plan::file::VERSION as PLAN_VERSION;
use tuner::gains::choose::GainsFrom;

pub const VERSION: u32 = 3;

/// Text for a run whose timing cannot be judged.
pub const NOT_COMPARED: &str = "the timing is not compared with a certificate: none is known for the gains of this controller, or the run was not heard";

/// What only the caller knows.
#[derive(Clone, Debug, Default)]
pub struct Circumstances<'a> {
    pub bus: &'a str,
    /// What supplied the time: `virtual time` or `real time`.
    pub time: &'a str,
    /// `soft`, `node`, or `led` for a robot that is led.
    pub controller: &'a str,
    /// Seed of planner and cell, if one was used.
    pub seed: Option<u64>,
    pub exit_code: u8,
    /// What ended the job early, as people read it.
    pub cause: Option<String>,
    /// What to do then.
    pub next: Vec<String>,
    pub bus_errors: usize,
    /// Time of each step by the wall, in the order of the record.
    pub wall_s: &'a [f64],
    /// Time of planning by the wall, s.
    pub plan_s: f64,
    /// Where the gains come from.
    pub gains_from: GainsFrom,
    /// Checksum of the gains file as written; `None` if there is no gains file.
    pub gains_crc32: Option<u32>,
    /// The soft controller's thread.
    pub soft: Option<&'a SoftReport>,
    /// Why the control period is what it is: `measured`, `given`, `virtual time`, `the controller's`.
    pub period_why: &'a str,
    /// What machine and bus held before the run.
    pub timing: Option<&'a CycleTiming>,
    /// Rights of the thread that answered a robot.
    pub answering: Option<String>,
}

#[must_use]
pub fn summary(order: &Order<'_>, record: &Record, about: &Circumstances<'_>) -> Value {
    let (verdict, landing) = (&record.verdict, record.landing);
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
    let (target_m, throw) = match &order.judge {
        Judge::Throw { plan, .. } => (Some(plan.target.position_m), Some(*plan)),
        Judge::Follow { plan, .. } => (Some(plan.target_m), None),
        Judge::Reach => (None, None),
    };
    let mut value = json!({
        "format": "cubectl-job",
        "version": VERSION,
        "outcome": verdict.outcome.json_name(),
        "outcome_text": verdict.text,
        "exit_code": about.exit_code,
        "cause": about.cause,
        "next": about.next,
        "tolerance_m": order.judge.tolerance_m(),
        "ball": record.ball.json_name(),
        "ended_in_step": record.at_work.map(|(step, _)| step.name()),
        "bus": about.bus,
        "time": about.time,
        "controller": { "kind": about.controller, "node_id": record.node.map(NodeId::get) },
        "robot": order.arm.name(),
        "target_m": target_m,
        "landing_error_m": landing.map(|landed| landed.error_m),
        "landing": landing.map(|landed| json!({
            "source": landed.source.json_name(),
            "observed": landed.source.is_observed(),
            "error_m": landed.error_m,
            "uncertainty_m": landed.uncertainty_m,
            "position_m": [landed.position_m.x, landed.position_m.y, landed.position_m.z],
            "release_late_s": landed.release_late_s,
            "touched_arm_after_s": landed.touch_after_s,
            "predicted_mean_m": throw.map(|plan| plan.landing.mean_m),
            "predicted_covariance_m2": throw.map(|plan| plan.landing.covariance_m2),
        })),
        "drives": record.drives,
        "gripper_opening_us": record.gripper_opening.map(Duration::as_micros),
        "tracking": record.analysis.as_ref().map(|analysis| json!({
            "error_max_rad": of_joints(analysis, |error| error.max),
            "error_rms_rad": of_joints(analysis, |error| error.rms),
        })),
        "analysis": record.analysis,
        "reached": record.reached,
        "certified_timing": record.certified,
        "timing": timing(record),
        "cycle": cycle(record, about),
        "bus_load": load(record),
        "bus_errors": about.bus_errors,
        "frames_during_throw": record.frames,
        "plan": throw.map(|plan| json!({
            "form": plan.search.form,
            "duration_s": plan.end_time_s,
            "release_s": plan.release_time_s,
            "flight_s": plan.landing.flight_s,
            "objective": plan.objective.value,
            "took_s": about.plan_s,
        })),
        "gains_from": about.gains_from.json_name(),
        "approach_s": record.approach_s,
        "steps": steps,
        "seed": about.seed,
        "versions": { "cubectl": env!("CARGO_PKG_VERSION"), "plan": PLAN_VERSION, "trajectory": firmware::trajectory_format::VERSION },
        "hashes": {
            "robot_fingerprint": throw.map(|plan| &plan.robot.fingerprint),
            "trajectory_crc64": record.trajectory.map(|name| format!("{:016x}", name.trajectory_crc64)),
            "gains_crc32": about.gains_crc32.map(|crc| format!("{crc:08x}")),
            "certificate_crc32": format!("{:08x}", record.certificate_crc32),
        },
        "fault": fault(record),
    });
    for part in [of_run(record), of_led(order, record, about)] {
        if let (Value::Object(part), Some(all)) = (part, value.as_object_mut()) {
            all.extend(part);
        }
    }
    value
}

/// When the program ran, and the counts of its last cycle.
fn of_run(record: &Record) -> Value {
    let ran = record.steps.iter().find(|(step, ..)| matches!(step, Step::Throw | Step::Run));
    let last = record.states.last().map(|(_, group)| *group).unwrap_or_default();
    json!({
        "took_s": ran.map(|(_, begun, ended)| ended.saturating_since(*begun).as_secs_f64()),
        "start_controller_s": record.start.map(|start| start.at.as_secs_f64()),
        "start_known_to_s": record.start.map(|start| start.known_to.as_secs_f64()),
        "cycles_late": last.cycles_late,
        "replies_missed": last.replies_missed,
        "cycles_saturated": last.cycles_saturated,
    })
}

/// Data that only a robot that is led has.
fn of_led(order: &Order<'_>, record: &Record, about: &Circumstances<'_>) -> Value {
    let follow = match &order.judge {
        Judge::Follow { plan, gripper, lag, .. } => Some((plan, gripper, lag)),
        _ if record.led.is_some() => None,
        _ => return Value::Null,
    };
    let led = record.led.clone().unwrap_or_default();
    let (seen, started_s) = (led.seen.as_ref(), led.started_at.map(protocol::Instant::as_secs_f64));
    let released = seen.and_then(|seen| seen.released).map(|(at, hand)| {
        json!({
            "late_s": started_s.zip(follow).map(|(started_s, (plan, ..))| at.as_secs_f64() - started_s - plan.release_time_s),
            "position_m": [hand.p_m.x, hand.p_m.y, hand.p_m.z],
            "velocity_m_s": [hand.v_m_s.x, hand.v_m_s.y, hand.v_m_s.z],
        })
    });
    let answers = led.exchange.as_ref().map(|exchange| {
        let us = |share| exchange.answer_time_us(share);
        json!({
            "own_time_us": { "count": exchange.answer_us.len(), "median": us(0.5), "p99": us(0.99), "p999": us(0.999), "max": us(1.0) },
            "robots_heard": exchange.connections,
            "real_time_rights": about.answering,
        })
    });
    json!({
        "link": "RSI",
        "release": released,
        "plan_started_s": started_s,
        "followed_points": follow.map(|(plan, ..)| plan.followed_points),
        "lag": follow.map(|(_, _, lag)| json!({ "dead_time_s": lag.dead_time.as_secs_f64(), "time_constant_s": lag.time_constant.as_secs_f64() })),
        "gripper_delay_s": follow.map(|(_, gripper, _)| gripper.delay_s),
        "path_delay_s": led.path_delay_s,
        "answers": led.answers,
        "late_answers": seen.map(|seen| seen.late),
        "refused_answers": seen.map(|seen| seen.refused),
        "answer_times": answers,
        "robot_fault": seen.and_then(|seen| seen.fault).map(|fault| fault.to_string()),
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
            "differs": difference_text(group.differs),
            "plan_time_s": f64::from(group.trajectory_time_us) * 1e-6,
        })
    })
}
