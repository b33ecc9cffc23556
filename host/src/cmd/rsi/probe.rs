//! `cubectl doctor` and `cubectl status` on RSI: hold the robot for a second and say what its telegrams tell.

use std::time::Instant as WallTime;

use can_link::{Granted, RsiSpec};
use hil_sim::krc::KrcScenario;
use operator::rsi::cycles::{Cycle, cycles};
use operator::rsi::live::Exchange;
use operator::rsi::log::{Entry, Line};
use operator::rsi::program::{Lag, leading};
use planner::follow::limits::Arm;
use rsi_protocol::{Internal, Root, Source, Telegram};

use super::{Watch, serve_at};
use crate::cmd::finding::{Finding, Level, finding};
use crate::cmd::print_json;
use crate::error::ExpectedError;
use crate::exit;

/// Telegrams that are looked at.
const TELEGRAMS: u64 = 100;
/// A robot that is not there by then is missing.
const WAIT: std::time::Duration = std::time::Duration::from_secs(30);
/// Distance of the start pose from the described one that is told, deg: one step of one decimal.
const SAME_DEG: f64 = 0.1;
/// Decimals below which noise of the readings is told.
const DECIMALS: usize = 3;

/// What was seen.
struct Seen {
    lines: Vec<Line>,
    cycles: Vec<Cycle>,
    exchange: Exchange,
    granted: Option<Granted>,
}

fn hold(spec: &RsiSpec, described: &KrcScenario, arm: &Arm, quiet: bool) -> Result<Seen, ExpectedError> {
    let mut station =
        leading(described, arm, Lag::of(described), &[]).map_err(|error| ExpectedError::bad_input(&error))?;
    let begun = WallTime::now();
    let mut each = |_, station: &mut operator::rsi::station::Station| {
        let answers = station.counts().answers;
        answers < TELEGRAMS && (answers > 0 || begun.elapsed() < WAIT)
    };
    let mut watch = Watch::new(format!("rsi:{spec}"), None, quiet, &mut each);
    let (exchange, granted) = serve_at(spec, described, &mut station, &mut watch)?;
    if watch.was_interrupted() {
        return Err(ExpectedError::new(exit::INTERRUPTED, "interrupted; the robot was only held"));
    }
    let krc = &described.options;
    let cycles = cycles(&watch.lines, &described.config, &krc.outputs_name, krc.sensor_name.as_deref());
    Ok(Seen { lines: std::mem::take(&mut watch.lines), cycles, exchange, granted })
}

/// Says where the axes are.
///
/// # Errors
/// The address cannot be had, or no robot connects.
pub fn status(spec: &RsiSpec, described: &KrcScenario, arm: &Arm, json: bool) -> Result<(), ExpectedError> {
    let seen = hold(spec, described, arm, json)?;
    let Some(last) = seen.cycles.last() else {
        return Err(ExpectedError::new(exit::BUS, no_robot(spec)));
    };
    if json {
        print_json(&serde_json::json!({
            "bus": format!("rsi:{spec}"),
            "robot": described.robot,
            "ipoc": last.ipoc,
            "actual_deg": last.actual_deg,
            "start_deg": last.start_deg,
            "fingers_open": last.fingers_open,
            "late_answers": last.late,
            "answer_us": { "median": seen.exchange.answer_time_us(0.5), "max": seen.exchange.answer_time_us(1.0) },
        }));
        return Ok(());
    }
    console::line!("axis  actual_deg   start_deg   range_deg");
    for (axis, joint) in arm.joints().iter().enumerate() {
        console::line!(
            "A{}    {:>10.4}  {:>10.4}   {:.0} to {:.0}",
            axis + 1,
            last.actual_deg[axis],
            last.start_deg[axis],
            joint.limits.q_min_rad.to_degrees(),
            joint.limits.q_max_rad.to_degrees()
        );
    }
    let fingers = match last.fingers_open {
        Some(true) => "open",
        Some(false) => "closed",
        None => "not told",
    };
    console::line!("fingers: {fingers}; telegram {}; late answers: {}", last.ipoc, last.late);
    Ok(())
}

fn no_robot(spec: &RsiSpec) -> String {
    format!(
        "rsi:{spec}: no telegram with axes within {} s\n  next: start the robot's program after this one; check IP_NUMBER, PORT \
         and PROTOCOL of its configuration file, and the firewall (`cubectl sim --robot kr16_2 --rsi {spec}` plays the robot)",
        WAIT.as_secs()
    )
}

/// Looks at the exchange and the description, and says what is wrong and what to do. Nothing moves.
///
/// # Errors
/// The address cannot be had, or something is wrong.
pub fn doctor(spec: &RsiSpec, described: &KrcScenario, arm: &Arm, json: bool) -> Result<(), ExpectedError> {
    let seen = hold(spec, described, arm, json)?;
    let findings = examine(&seen, spec, described, arm);
    if json {
        let rows: Vec<_> = findings
            .iter()
            .map(|f| serde_json::json!({ "level": f.level.word(), "check": f.check, "what": f.what, "next": f.next }))
            .collect();
        print_json(&serde_json::json!({ "bus": format!("rsi:{spec}"), "findings": rows }));
    } else {
        for f in &findings {
            console::line!("{:<7}  {}: {}", f.level.word(), f.check, f.what);
            if !f.next.is_empty() {
                console::line!("         next: {}", f.next);
            }
        }
    }
    let problems = findings.iter().filter(|f| f.level == Level::Problem).count();
    if problems == 0 {
        return Ok(());
    }
    Err(ExpectedError::new(
        exit::FINDINGS,
        format!("{problems} of {} checks found a problem", findings.len()),
    ))
}

fn examine(seen: &Seen, spec: &RsiSpec, described: &KrcScenario, arm: &Arm) -> Vec<Finding> {
    let (Some(first), Some(last)) = (seen.cycles.first(), seen.cycles.last()) else {
        let text = no_robot(spec);
        let (what, next) = text.split_once("\n  next: ").unwrap_or((&text, ""));
        return vec![finding(Level::Problem, "telegrams", what, next)];
    };
    let krc = &described.options;
    let mut all = vec![finding(
        Level::Ok,
        "telegrams",
        format!("{} with axes, numbers {} to {}", seen.cycles.len(), first.ipoc, last.ipoc),
        "",
    )];
    let step = krc.generation.ipoc_step(krc.cycle.as_micros() / 1000);
    let odd = seen.cycles.windows(2).filter(|pair| pair[1].ipoc != pair[0].ipoc + step).count();
    all.push(if odd == 0 {
        finding(Level::Ok, "numbers", format!("each telegram counts {step} more"), "")
    } else {
        let wrong_step = odd == seen.cycles.len().saturating_sub(1);
        let level = if wrong_step { Level::Problem } else { Level::Note };
        let next = if wrong_step {
            "the description names another generation or cycle: give the right one with --rsi"
        } else {
            "telegrams are lost on the network: use a cable and a network card of its own"
        };
        finding(
            level,
            "numbers",
            format!("{odd} telegrams do not count {step} more than the one before"),
            next,
        )
    });
    if !spec.lockstep {
        all.extend(timing(seen, described));
    }
    all.push(match last.late - first.late {
        0 => finding(Level::Ok, "answers", "the robot took every answer in time", ""),
        late => finding(
            Level::Problem,
            "answers",
            format!("the robot counts {late} late answers"),
            "end other programs on this machine; let this one have a real-time priority (`rtprio` in limits.conf)",
        ),
    });
    let away = (0..6).map(|axis| (last.start_deg[axis] - krc.start_deg[axis]).abs()).fold(0.0, f64::max);
    all.push(if away <= SAME_DEG {
        finding(Level::Ok, "start pose", "as described", "")
    } else {
        finding(
            Level::Problem,
            "start pose",
            format!("{away:.2} deg from the described one"),
            "put the start pose of the robot's program into start_deg of the description, or the other way round",
        )
    });
    all.extend(names(seen, described));
    all.push(limits(described, arm));
    all
}

fn timing(seen: &Seen, described: &KrcScenario) -> Vec<Finding> {
    let period_s = described.options.cycle.as_secs_f64();
    let times: Vec<f64> = seen.cycles.iter().map(|cycle| cycle.at.as_secs_f64()).collect();
    let measured_s = match (times.first(), times.last()) {
        (Some(first), Some(last)) if times.len() > 1 => (last - first) / (times.len() - 1) as f64,
        _ => period_s,
    };
    let text = format!("every {:.2} ms on the mean, described {:.0} ms", 1e3 * measured_s, 1e3 * period_s);
    let mut all = vec![if (measured_s / period_s - 1.0).abs() < 0.2 {
        finding(Level::Ok, "cycle", text, "")
    } else {
        finding(
            Level::Problem,
            "cycle",
            text,
            "describe the cycle that the robot runs with (cycle_s), or give another --rsi",
        )
    }];
    let (median, largest) =
        (seen.exchange.answer_time_us(0.5).unwrap_or(0), seen.exchange.answer_time_us(1.0).unwrap_or(0));
    let window_us = described.options.window.as_micros();
    let text = format!("median {median} us, largest {largest} us; the robot waits {window_us} us");
    all.push(if u64::from(largest) * 2 < window_us {
        finding(Level::Ok, "answer time", text, "")
    } else {
        finding(Level::Note, "answer time", text, "end other programs on this machine before you throw")
    });
    if let Some(granted) = &seen.granted {
        all.push(finding(Level::Note, "real time", granted.to_string(), ""));
    }
    all
}

/// What the configuration sends and receives.
fn names(seen: &Seen, described: &KrcScenario) -> Vec<Finding> {
    let config = &described.config;
    let mut all = Vec::new();
    for (internal, name, why) in [
        (Internal::ASPos, "DEF_ASPos", "the start pose is then the measured one, with its noise"),
        (Internal::Delay, "DEF_Delay", "late answers are then not seen before the robot stops"),
    ] {
        if !config.send.iter().any(|entry| entry.source == Source::Internal(internal)) {
            all.push(finding(
                Level::Note,
                "names",
                format!("{name} is not sent: {why}"),
                format!("add {name} to SEND"),
            ));
        }
    }
    if config.scalar(&described.options.stop_name).is_none() {
        let what = format!(
            "{} is not received: the robot's program cannot be told to end",
            described.options.stop_name
        );
        all.push(finding(Level::Note, "names", what, "add it to RECEIVE and wire it to a stop object"));
    }
    let decimals = seen.lines.iter().rev().find_map(|line| match &line.entry {
        Entry::Telegram(bytes) => {
            let document = Telegram::parse(bytes, Root::Rob).ok()?;
            let text = document.element("AIPos")?.attribute("A1")?.to_owned();
            Some(text.split_once('.').map_or(0, |(_, digits)| digits.len()))
        }
        _ => None,
    });
    match decimals {
        Some(few) if few < DECIMALS => all.push(finding(
            Level::Note,
            "decimals",
            format!("axes come with {few} decimals of a degree"),
            "set the precision of the ETHERNET object to 4",
        )),
        Some(decimals) => all.push(finding(Level::Ok, "decimals", format!("{decimals}"), "")),
        None => {}
    }
    if let Some(sensor) = &described.options.sensor_name
        && seen.cycles.last().is_some_and(|cycle| cycle.fingers_open.is_none())
    {
        let what = format!("the telegrams have no {sensor}");
        all.push(finding(
            Level::Note,
            "names",
            what,
            "add it to SEND; without it identify cannot measure the gripper",
        ));
    }
    all
}

/// Whether corrections reach the ranges of the axes.
fn limits(described: &KrcScenario, arm: &Arm) -> Finding {
    let krc = &described.options;
    let mut narrow = Vec::new();
    for (axis, joint) in arm.joints().iter().enumerate().take(6) {
        let (low, high) = (joint.limits.q_min_rad.to_degrees(), joint.limits.q_max_rad.to_degrees());
        let least = krc.correction.lower[axis].max(-krc.correction.overall_axis_deg) + krc.start_deg[axis];
        let most = krc.correction.upper[axis].min(krc.correction.overall_axis_deg) + krc.start_deg[axis];
        if least > low + 1.0 || most < high - 1.0 {
            narrow.push(format!("A{} {least:.0} to {most:.0} of {low:.0} to {high:.0} deg", axis + 1));
        }
    }
    if narrow.is_empty() {
        finding(Level::Ok, "corrections", "reach the ranges of all axes", "")
    } else {
        finding(
            Level::Note,
            "corrections",
            format!("reach only {}", narrow.join(", ")),
            "throws outside are refused before anything moves; widen the limits in program and description if needed",
        )
    }
}
