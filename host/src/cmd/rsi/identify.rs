//! `cubectl arm identify` for an industrial robot: lag and smoothing of its axes, delay of its gripper.

use std::cell::Cell;
use std::path::Path;

use can_link::BusSpec;
use hil_sim::krc::KrcScenario;
use operator::bus::BusArgs;
use operator::rsi::cell;
use operator::rsi::cycles::{Cycle, cycles};
use operator::rsi::identify::{MeasuredGripper, MeasuredLag, Unclear, gripper, lag, wiggle, with_measured};
use operator::rsi::program::exploring;
use operator::rsi::station::{Stage, Station};
use planner::follow::limits::{Arm, Axes};
use protocol::{Duration, Instant};

use super::{CONFIG, Watch, description, serve_at};
use crate::cmd::print_json;
use crate::error::ExpectedError;
use crate::exit;

/// Time between two orders to the gripper.
const GRIPPER_EVERY: Duration = Duration::from_millis(250);
/// Orders to the gripper: open and closed in turn.
const GRIPPER_ORDERS: u32 = 80;

/// Opens and closes the gripper once the arm stands after its motion.
struct Fingers {
    next: Cell<Option<Instant>>,
    given: Cell<u32>,
}

impl Fingers {
    /// With each telegram; false when all is done.
    fn step(&self, now: Instant, station: &mut Station) -> bool {
        if !matches!(station.stage(), Stage::Finished { .. }) {
            return true;
        }
        let due = self.next.get().unwrap_or(now);
        if now < due {
            return true;
        }
        let given = self.given.get();
        if given >= GRIPPER_ORDERS {
            return false;
        }
        // Orders do not come at the same place of every cycle.
        let jitter = Duration::from_micros(u64::from(given) * 7_331 % 40_000);
        self.next.set(Some(now + GRIPPER_EVERY + jitter));
        self.given.set(given + 1);
        station.set_gripper(now, given.is_multiple_of(2)).is_ok()
    }
}

/// What to measure, and where to write it.
pub struct RobotIdentification<'a> {
    /// Where the robot connects, and what is known of it.
    pub bus: &'a BusArgs,
    /// Largest swing of the axes, rad.
    pub swing_rad: f64,
    /// File for the description of the robot with what was measured.
    pub out: Option<&'a Path>,
    /// Print the result as JSON.
    pub json: bool,
}

impl RobotIdentification<'_> {
    /// Measures, and writes a description of the robot with what was measured.
    ///
    /// # Errors
    /// The robot cannot be led, or nothing can be concluded.
    pub fn run(&self, arm: &Arm) -> Result<(), ExpectedError> {
        let truth = self.bus.cell.scenario.as_deref().map(KrcScenario::load).transpose();
        let truth = truth.map_err(|error| ExpectedError::bad_input(&error))?;
        let tcp = matches!(&self.bus.bus, BusSpec::Rsi(spec) if spec.tcp);
        let mut described = match (&self.bus.rsi, &truth) {
            (None, Some(truth)) => truth.clone(),
            (given, _) => description(given.as_deref().or(tcp.then_some("kr-c2-tcp")))?,
        };
        if let Some(robot) = &self.bus.cell.robot {
            described.robot.clone_from(robot);
        }
        let swing_rad = self.swing_rad;
        let start = Axes::from(described.options.start_deg.map(f64::to_radians));
        let motion = wiggle(&start, swing_rad);
        let mut station = exploring(&described, arm, std::slice::from_ref(&motion))
            .map_err(|error| ExpectedError::bad_input(&error))?;
        let fingers = Fingers { next: Cell::new(None), given: Cell::new(0) };
        let lines = match &self.bus.bus {
            BusSpec::Rsi(spec) => {
                let mut each = |now, station: &mut Station| fingers.step(now, station);
                let mut watch = Watch::new(self.bus.bus.to_string(), None, self.json, &mut each);
                watch.stays = true;
                serve_at(spec, &described, &mut station, &mut watch)?;
                if watch.was_interrupted() {
                    return Err(ExpectedError::new(
                        exit::INTERRUPTED,
                        "interrupted; the robot was stopped along its path",
                    ));
                }
                watch.require_ready()?;
                watch.take_lines()
            }
            BusSpec::Sim => {
                let mut scenario = truth.unwrap_or_else(|| described.clone());
                scenario.seed = self.bus.cell.seed.unwrap_or(scenario.seed);
                let mut each = |now, station: &mut Station| fingers.step(now, station);
                cell::run_with(&scenario, &mut station, &mut each)
                    .map_err(|error| ExpectedError::bad_input(&error))?;
                station.take_log()
            }
            other => {
                return Err(ExpectedError::bad_input(&format!(
                    "--bus {other} is a CAN bus; this robot is led over RSI"
                ))
                .next("--bus rsi:udp://0.0.0.0:49152, or leave it out"));
            }
        };
        if !matches!(station.stage(), Stage::Finished { .. }) {
            let why = station.failure(None).map_or_else(
                || ExpectedError::new(exit::DRIVE, "the robot was never ready"),
                |why| ExpectedError::of(exit::DRIVE, &why),
            );
            return Err(why.at("the robot was not led to the end"));
        }
        let krc = &described.options;
        let table = cycles(&lines, &described.config, &krc.outputs_name, krc.sensor_name.as_deref());
        self.conclude(&described, &table)
    }

    fn conclude(&self, described: &KrcScenario, table: &[Cycle]) -> Result<(), ExpectedError> {
        let krc = &described.options;
        let period_s = krc.cycle.as_secs_f64();
        let unclear = |error: Unclear| ExpectedError::of(exit::FINDINGS, &error);
        let lag = lag(table, period_s).map_err(unclear)?;
        let bit = krc.hand.output_bit.unwrap_or(0);
        let fingers = krc.sensor_name.as_ref().map(|_| gripper(table, period_s, bit));
        let measured_gripper = fingers.as_ref().and_then(|fingers| fingers.as_ref().ok());
        let changed = with_measured(described, &lag, measured_gripper);
        if let Some(out) = self.out {
            write(out, &changed, &lag, measured_gripper, period_s)?;
        }
        if self.json {
            print_json(&serde_json::json!({
                "dead_time_s": lag.dead_s,
                "time_constant_s": lag.constant_s,
                "smoothing_cycles": lag.smoothing_cycles,
                "total_lag_s": lag.total_s(period_s),
                "known_s": { "dead_time": lag.known_s[0], "time_constant": lag.known_s[1], "total_lag": lag.known_s[2] },
                "residual_deg": lag.residual_deg,
                "motion_deg": lag.motion_deg,
                "cycles": lag.cycles,
                "gripper": measured_gripper.map(|g| serde_json::json!({
                    "delay_s": g.delay_s, "jitter_s": g.jitter_s, "known_s": g.known_s, "openings": g.openings,
                })),
            }));
        } else {
            console::text!("{}", words(&lag, measured_gripper, period_s));
            if let Some(out) = self.out {
                console::line!("description: {}", out.display());
            }
        }
        match fingers {
            Some(Err(error)) => Err(unclear(error)),
            _ => Ok(()),
        }
    }
}

fn words(lag: &MeasuredLag, gripper: Option<&MeasuredGripper>, period_s: f64) -> String {
    let mut text = format!(
        "lag: dead time {:.2} ± {:.3} ms, time constant {:.2} ± {:.3} ms, mean over {} set points; {:.2} ± {:.3} ms in all (95 %)\n     left: {:.4} deg of {:.2} deg of motion, {} cycles\n",
        1e3 * lag.dead_s,
        1e3 * lag.known_s[0],
        1e3 * lag.constant_s,
        1e3 * lag.known_s[1],
        lag.smoothing_cycles,
        1e3 * lag.total_s(period_s),
        1e3 * lag.known_s[2],
        lag.residual_deg,
        lag.motion_deg,
        lag.cycles
    );
    text += &match gripper {
        Some(g) => format!(
            "gripper: open {:.1} ms after its output (known to {:.1} ms), varies by {:.1} ms; {} openings\n",
            1e3 * g.delay_s,
            1e3 * g.known_s,
            1e3 * g.jitter_s,
            g.openings
        ),
        None => "gripper: no finger sensor is described; its delay is kept\n".to_owned(),
    };
    text
}

fn write(
    out: &Path,
    changed: &KrcScenario,
    lag: &MeasuredLag,
    gripper: Option<&MeasuredGripper>,
    period_s: f64,
) -> Result<(), ExpectedError> {
    let head = format!(
        "[drives] and [gripper] as `cubectl arm identify` measured them:\n{}",
        words(lag, gripper, period_s)
    );
    let text = changed.description(head.trim_end(), CONFIG);
    let config = out.with_file_name(CONFIG);
    for (path, text) in [(out, &text), (&config, &changed.config_text)] {
        std::fs::write(path, text).map_err(|error| ExpectedError::output(path, &error))?;
    }
    Ok(())
}
