//! `cubectl doctor` and `cubectl status` on RSI: hold the robot for a second and report what its telegrams contain.

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
/// Distance of the start pose from the described one above which it is a finding, deg: one step of one decimal.
const SAME_DEG: f64 = 0.1;
/// Drift, noise and distance from the start pose that are reported.
const DRIFT_DEG_S: f64 = 0.05;
const NOISE_DEG: f64 = 0.01;
const OFF_START_DEG: f64 = 0.2;
/// Decimals below which noise of the readings is reported.
const DECIMALS: usize = 3;

struct Seen {
    lines: Vec<Line>,
    cycles: Vec<Cycle>,
    exchange: Exchange,
    granted: Option<Granted>,
    /// What was heard, in words.
    heard: String,
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
    let lines = watch.take_lines();
    let cycles = cycles(&lines, &described.config, &krc.outputs_name, krc.sensor_name.as_deref());
    Ok(Seen { lines, cycles, exchange, granted, heard: station.heard() })
}

/// Says where the axes are.
///
/// # Errors
/// The address cannot be had, or no robot connects.
pub fn status(spec: &RsiSpec, described: &KrcScenario, arm: &Arm, json: bool) -> Result<(), ExpectedError> {
    let seen = hold(spec, described, arm, json)?;
    let Some(last) = seen.cycles.last() else {
        let (what, next) = no_robot(spec, &seen);
        return Err(ExpectedError::new(exit::BUS, what).next(next));
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
        None => "not reported",
    };
    console::line!("fingers: {fingers}; telegram {}; late answers: {}", last.ipoc, last.late);
    Ok(())
}

/// What happened and what to do.
fn no_robot(spec: &RsiSpec, seen: &Seen) -> (String, String) {
    let what = format!("rsi:{spec}: no telegram with axes within {} s; {}", WAIT.as_secs(), seen.heard);
    let next = format!(
        "start the robot's program after this one; check IP_NUMBER, PORT and PROTOCOL of its configuration file, and the firewall \
         (`cubectl sim --robot kr16_2 --rsi {spec}` plays the robot)"
    );
    (what, next)
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
        let (what, next) = no_robot(spec, seen);
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
    // A robot that counts late answers in a row begins at zero again.
    let rise = |pair: &[Cycle]| pair[1].late.saturating_sub(pair[0].late);
    all.push(match seen.cycles.windows(2).map(rise).sum::<u64>() {
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
    all.extend(rest(seen, described));
    all.extend(names(seen, described));
    all.push(limits(described, arm));
    all
}

/// What the axes do while they are held.
fn rest(seen: &Seen, described: &KrcScenario) -> Vec<Finding> {
    let (Some(first), Some(last)) = (seen.cycles.first(), seen.cycles.last()) else { return Vec::new() };
    let described_deg = described.options.start_deg;
    let worst = |of: &dyn Fn(usize) -> f64| {
        (0..6).map(|axis| (of(axis), axis + 1)).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default()
    };
    let looks_like_radians = |axis: usize| (last.actual_deg[axis] - described_deg[axis].to_radians()).abs();
    if worst(&looks_like_radians).0 < SAME_DEG && worst(&|axis| described_deg[axis].abs()).0 > 10.0 {
        let what = "the axes are at the start pose if their numbers are radians";
        return vec![finding(Level::Problem, "axes", what, "let the robot send AIPos and ASPos in degrees")];
    }
    let mut all = Vec::new();
    let count = seen.cycles.len() as f64;
    let mean = |of: &dyn Fn(&Cycle) -> f64| seen.cycles.iter().map(of).sum::<f64>() / count;
    let times = |cycle: &Cycle| cycle.at.as_secs_f64();
    let mean_s = mean(&times);
    let spread_s2 = mean(&|cycle| (times(cycle) - mean_s).powi(2));
    let mean_deg: [f64; 6] = std::array::from_fn(|axis| mean(&|cycle| cycle.actual_deg[axis]));
    let drift_deg_s: [f64; 6] = std::array::from_fn(|axis| {
        let along = mean(&|cycle| (times(cycle) - mean_s) * (cycle.actual_deg[axis] - mean_deg[axis]));
        if spread_s2 > 0.0 { along / spread_s2 } else { 0.0 }
    });
    let noise = |axis: usize| {
        let left = |cycle: &Cycle| {
            cycle.actual_deg[axis] - mean_deg[axis] - drift_deg_s[axis] * (times(cycle) - mean_s)
        };
        mean(&|cycle| left(cycle).powi(2)).sqrt()
    };
    let (drift, axis) = worst(&|axis| drift_deg_s[axis].abs());
    all.push(if drift > DRIFT_DEG_S {
        let what = format!("A{axis} drifts by {drift:.2} deg/s while the robot is held");
        finding(
            Level::Problem,
            "rest",
            what,
            "let the robot's program hold its start pose; look for another sensor correction",
        )
    } else {
        finding(Level::Ok, "rest", format!("the axes drift by {drift:.3} deg/s at most"), "")
    });
    let (deg, axis) = worst(&noise);
    if deg > NOISE_DEG {
        let what = format!("the readings of A{axis} vary by {deg:.3} deg");
        all.push(finding(
            Level::Note,
            "noise",
            what,
            "raise the precision of the ETHERNET object; look at the controller of the axis",
        ));
    }
    let (deg, axis) = worst(&|axis| (mean_deg[axis] - last.start_deg[axis]).abs());
    if deg > OFF_START_DEG {
        let what = format!(
            "AIPos of A{axis} is {deg:.2} deg from ASPos: the robot is not at the start pose of its program"
        );
        all.push(finding(
            Level::Problem,
            "start pose",
            what,
            "end the robot's program and start it again at its start pose",
        ));
    }
    let (deg, axis) = worst(&|axis| (last.start_deg[axis] - first.start_deg[axis]).abs());
    if deg > 0.0 {
        let what = format!("ASPos of A{axis} moved by {deg:.4} deg: it is no start pose");
        all.push(finding(
            Level::Problem,
            "start pose",
            what,
            "send DEF_ASPos, the programmed axes without corrections, or leave it out",
        ));
    }
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
            "{} is not received: the robot's program cannot be ordered to end",
            described.options.stop_name
        );
        all.push(finding(Level::Note, "names", what, "add it to RECEIVE and wire it to a stop object"));
    }
    let decimals = seen.lines.iter().filter_map(|line| match &line.entry {
        Entry::Telegram(bytes) => {
            let document = Telegram::parse(bytes, Root::Rob).ok()?;
            let digits = |name| Some(document.element("AIPos")?.attribute(name)?.split_once('.')?.1.len());
            ["A1", "A2", "A3", "A4", "A5", "A6"].into_iter().filter_map(digits).max()
        }
        _ => None,
    });
    match decimals.max() {
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

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::Instant;

    /// What is found of axes that move so about a start pose, deg.
    fn found(start_deg: [f64; 6], actual: impl Fn(u64, usize) -> f64) -> Vec<(Level, String)> {
        let mut described = KrcScenario::open("kr-c2").expect("built in");
        described.options.start_deg = [0.0, -90.0, 90.0, 0.0, 90.0, 0.0];
        let cycle = |k: u64| Cycle {
            at: Instant::from_micros(12_000 * k),
            ipoc: k,
            start_deg,
            set_deg: start_deg,
            actual_deg: std::array::from_fn(|axis| actual(k, axis)),
            outputs: 0.0,
            fingers_open: None,
            late: 0,
        };
        let cycles = (0..100).map(cycle).collect();
        let seen = Seen {
            lines: Vec::new(),
            cycles,
            exchange: Exchange::default(),
            granted: None,
            heard: String::new(),
        };
        rest(&seen, &described).into_iter().map(|f| (f.level, f.what)).collect()
    }

    const START: [f64; 6] = [0.0, -90.0, 90.0, 0.0, 90.0, 0.0];

    fn is_reported(found: &[(Level, String)], level: Level, words: &str) -> bool {
        found.iter().any(|(of, what)| *of == level && what.contains(words))
    }

    #[test]
    fn axes_that_rest_at_the_start_pose_are_fine() {
        let found = found(START, |k, axis| START[axis] + 5e-4 * ((7 * k + axis as u64) % 3) as f64);
        assert!(found.iter().all(|(level, _)| *level == Level::Ok), "{found:?}");
    }

    #[test]
    fn axes_in_radians_are_a_problem() {
        let start = START.map(f64::to_radians);
        let found = found(start, |_, axis| start[axis]);
        assert!(is_reported(&found, Level::Problem, "radians"), "{found:?}");
    }

    #[test]
    fn axis_that_drifts_while_it_is_held_is_a_problem_with_its_speed() {
        let drift = |k: u64, axis: usize| if axis == 2 { 0.83 * 0.012 * k as f64 } else { 0.0 };
        let found = found(START, |k, axis| START[axis] + drift(k, axis));
        assert!(is_reported(&found, Level::Problem, "A3 drifts by 0.83 deg/s"), "{found:?}");
    }

    #[test]
    fn noisy_axis_is_noted_and_one_away_from_the_start_pose_is_a_problem() {
        let noisy = found(START, |k, axis| START[axis] + if axis == 5 { 0.04 * (k % 2) as f64 } else { 0.0 });
        assert!(is_reported(&noisy, Level::Note, "A6 vary"), "{noisy:?}");
        let away = found(START, |_, axis| START[axis] + if axis == 1 { 1.5 } else { 0.0 });
        assert!(is_reported(&away, Level::Problem, "A2 is 1.50 deg from ASPos"), "{away:?}");
    }
}
