//! `cubectl sim --rsi`: an industrial robot behind RSI, and an optical tracker that sees the target.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant as WallTime;

use can_link::{Role, RsiSpec, Urgent};
use hil_sim::krc::bench::RobotFaults;
use hil_sim::krc::serve::{Mode, ServeError, ServeOptions, Served, serve};
use hil_sim::krc::{Krc, KrcEvent, KrcScenario};
use hil_sim::tracker::serve::Sockets;
use hil_sim::tracker::{BodyMotion, BodyOptions, Tracker, TrackerOptions, TrackerScenario};
use nalgebra::Vector3;
use operator::interrupt::interrupt;
use protocol::{Duration, Instant};
use robot_model::Pose;
use rsi_protocol::Protocol;

use super::rsi::address_of;
use crate::error::ExpectedError;
use crate::exit;

const BOTTLE_M: f64 = 0.035;
/// Where the bottle stands by default, m.
const BOTTLE: [f64; 3] = [2.5, 0.0, 0.6];
/// Time between two tries to reach the client.
const AGAIN: std::time::Duration = std::time::Duration::from_millis(200);
/// After a run the operator starts the program again so much later.
const NEXT_RUN: std::time::Duration = std::time::Duration::from_millis(1_500);
/// In lock step: longest wait for an answer of a client that has begun.
const ANSWER_LIMIT: Duration = Duration::from_secs(60);

#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "An industrial robot (--rsi)")]
pub struct RobotArgs {
    /// Play an industrial robot that connects to a client there: udp://HOST:PORT or tcp://HOST:PORT; with ?lockstep behind it
    /// the robot waits for every answer, and its time is its cycle count.
    #[arg(long, value_name = "SPEC", conflicts_with = "bus")]
    pub rsi: Option<RsiSpec>,
    /// Play an optical tracker as well, which sends what it sees there.
    #[arg(long, value_name = "HOST:PORT", requires = "rsi")]
    pub tracker: Option<String>,
    /// Scenario of the tracker [default: one that sees the bottle].
    #[arg(long, value_name = "FILE", requires = "tracker")]
    pub tracker_scenario: Option<std::path::PathBuf>,
    /// Where the tracker takes commands.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:0", requires = "tracker")]
    pub tracker_commands: String,
    /// Where the bottle stands, m in the robot's frame.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = crate::cmd::values::numbers::<3>, requires = "rsi")]
    pub bottle: Option<[f64; 3]>,
    /// Pose of the tracker's room in the robot's frame: m, and degrees about the vertical.
    #[arg(long, value_name = "X,Y,Z,DEG", allow_hyphen_values = true, value_parser = super::values::numbers::<4>, requires = "tracker")]
    pub room: Option<[f64; 4]>,
    /// End after this many runs of the robot's program that a client answered.
    #[arg(long, value_name = "N", requires = "rsi")]
    pub runs: Option<u64>,
}

/// What to play, and for how long.
pub struct RobotRun<'a> {
    /// Options of the robot and its tracker.
    pub industrial: &'a RobotArgs,
    /// Robot instead of the scenario's.
    pub robot: Option<&'a str>,
    /// Description of robot and program.
    pub scenario: Option<&'a Path>,
    /// Seed instead of the scenario's.
    pub seed: Option<u64>,
    /// End after this many seconds.
    pub time_s: Option<f64>,
}

/// Serves until Ctrl-C, `--for-s` or `--runs`.
pub fn run(args: &RobotRun<'_>, spec: &RsiSpec) -> Result<(), ExpectedError> {
    let mut scenario = match args.scenario {
        Some(path) => KrcScenario::load(path),
        None => KrcScenario::open(if spec.tcp { "kr-c2-tcp" } else { "kr-c2" }),
    }
    .map_err(|error| ExpectedError::bad_input(&error))?;
    if let Some(robot) = args.robot {
        robot.clone_into(&mut scenario.robot);
    }
    scenario.seed = args.seed.unwrap_or(scenario.seed);
    scenario.config.protocol = if spec.tcp { Protocol::Tcp } else { Protocol::Udp };
    scenario.network.in_order = spec.tcp;
    let bottle_m = args.industrial.bottle.unwrap_or(BOTTLE);
    scenario.options.hand.gripper.landing_z_m.get_or_insert(bottle_m[2]);
    let pc = address_of(&spec.host, spec.port).map_err(|error| {
        ExpectedError::new(exit::BUS, format!("rsi:{spec}: {error}")).next("name the address of the client")
    })?;
    let stop = interrupt();
    let begun = WallTime::now();
    let goes_on =
        || !stop.load(Ordering::Relaxed) && args.time_s.is_none_or(|s| begun.elapsed().as_secs_f64() < s);
    let over = AtomicBool::new(false);
    let mut eyes = tracker(args, bottle_m)?;
    let looks = || goes_on() && !over.load(Ordering::Relaxed);
    std::thread::scope(|scope| {
        let seeing = eyes
            .as_mut()
            .map(|(sockets, tracker)| scope.spawn(|| sockets.run(tracker, Instant::FAR_FUTURE, &looks)));
        let robot = Robot { args, spec, pc, bottle_m, goes_on: &goes_on };
        let served = robot.serve_runs(&mut scenario);
        over.store(true, Ordering::Relaxed);
        if let Some(seeing) = seeing {
            let _ = seeing.join();
        }
        served
    })
}

fn tracker(args: &RobotRun<'_>, bottle_m: [f64; 3]) -> Result<Option<(Sockets, Tracker)>, ExpectedError> {
    let Some(data) = &args.industrial.tracker else { return Ok(None) };
    let resolve = |text: &str| -> Result<SocketAddr, ExpectedError> {
        let failed = |what: &dyn std::fmt::Display| {
            ExpectedError::new(exit::BUS, format!("{text}: {what}"))
                .next("give HOST:PORT, for example 127.0.0.1:5000")
        };
        let (host, port) = text.rsplit_once(':').ok_or_else(|| failed(&"the port is missing"))?;
        let port = port.parse().map_err(|_| failed(&"the port is no number"))?;
        address_of(host, port).map_err(|error| failed(&error))
    };
    let mut scenario = match &args.industrial.tracker_scenario {
        Some(path) => TrackerScenario::load(path).map_err(|error| ExpectedError::bad_input(&error))?,
        None => {
            let [x, y, z, deg] = args.industrial.room.unwrap_or_default();
            let x_wr = Pose::translation(x, y, z) * Pose::rot_z(deg.to_radians());
            let room_m = x_wr.inverse_transform_point(&Vector3::from(bottle_m));
            let body = BodyOptions {
                id: 0,
                motion: BodyMotion::at_rest([room_m.x, room_m.y, room_m.z].map(|m| 1e3 * m)),
            };
            let options = TrackerOptions {
                noise_mm: 0.2,
                noise_deg: 0.1,
                bodies: vec![body],
                ..TrackerOptions::default()
            };
            TrackerScenario { options, seed: args.seed.unwrap_or(1) }
        }
    };
    scenario.options.running = true;
    let mut tracker = Tracker::new(scenario.options, scenario.seed);
    tracker.set_output(1, Some(resolve(data)?));
    let sockets = Sockets::bind(resolve(&args.industrial.tracker_commands)?)
        .map_err(|error| ExpectedError::of(exit::BUS, &error))?;
    let commands = sockets.command_address().map_err(|error| ExpectedError::of(exit::BUS, &error))?;
    console::line!("tracker: data to {data}, commands at {commands}");
    Ok(Some((sockets, tracker)))
}

struct Robot<'a> {
    args: &'a RobotRun<'a>,
    spec: &'a RsiSpec,
    pc: SocketAddr,
    bottle_m: [f64; 3],
    goes_on: &'a dyn Fn() -> bool,
}

impl Robot<'_> {
    /// Plays one program run after another, each from the start pose. Runs without an answer of a client are not reported.
    fn serve_runs(&self, scenario: &mut KrcScenario) -> Result<(), ExpectedError> {
        let spec = self.spec;
        console::line!(
            "robot {} ({:?}, {} ms) connects to rsi:{spec}, seed {}; Ctrl-C ends",
            scenario.robot,
            scenario.options.generation,
            scenario.options.cycle.as_micros() / 1000,
            scenario.seed
        );
        let urgent = (!spec.lockstep).then(|| Urgent::request(Role::Plant));
        if let Some(urgent) = &urgent {
            console::note!("robot in real time: {}", urgent.granted());
        }
        let mut runs = 0;
        while (self.goes_on)() {
            let mut krc = scenario.controller().map_err(|error| ExpectedError::bad_input(&error))?;
            match self.serve_run(scenario, &mut krc)? {
                Some(served) if !served.answer_times_us.is_empty() => {
                    runs += 1;
                    self.print(runs, &krc, &served);
                    if self.args.industrial.runs.is_some_and(|most| runs >= most) {
                        return Ok(());
                    }
                    // Another gripper delay and other noise for the next run.
                    scenario.seed += 1;
                    self.pause(NEXT_RUN);
                }
                _ => self.pause(AGAIN),
            }
        }
        Ok(())
    }

    fn pause(&self, span: std::time::Duration) {
        let begun = WallTime::now();
        while (self.goes_on)() && begun.elapsed() < span {
            std::thread::sleep(AGAIN.min(span));
        }
    }

    /// One run; `None`: nobody listens.
    fn serve_run(&self, scenario: &KrcScenario, krc: &mut Krc) -> Result<Option<Served>, ExpectedError> {
        let options = ServeOptions {
            pc: self.pc,
            mode: if self.spec.lockstep { Mode::LockStep } else { Mode::RealTime },
            cycles: None,
            answer_limit: ANSWER_LIMIT,
        };
        let mut faults = RobotFaults::new(&scenario.robot_faults);
        let mut observe = |_: &KrcEvent| {};
        match serve(krc, &mut scenario.link(), &mut faults, &options, self.goes_on, &mut observe) {
            Ok(served) => Ok(Some(served)),
            // A robot that is not heard starts its program again.
            Err(ServeError::Unreachable { .. }) => Ok(None),
            Err(ServeError::NoAnswer { .. }) if krc.released().is_none() => Ok(None),
            Err(error @ ServeError::NoAnswer { .. }) => Err(ExpectedError::of(exit::BUS, &error)),
            Err(error @ ServeError::Start(_)) => Err(ExpectedError::bad_input(&error)),
        }
    }

    fn print(&self, run: u64, krc: &Krc, served: &Served) {
        let us = |share| served.answer_time(share).map_or(0, Duration::as_micros);
        console::line!(
            "run {run}: {} telegrams, {} late answers, {} refused, {} cycles held up; answers: median {} us, 99 % {} us, 99.9 % {} us, \
             largest {} us",
            served.telegrams,
            served.late,
            served.refused,
            served.held_up,
            us(0.5),
            us(0.99),
            us(0.999),
            us(1.0)
        );
        if served.held_up > 0 {
            console::line!("  held up: this machine was busy, and the robot's time stood still meanwhile");
        }
        match krc.landing() {
            Some(landing) => {
                let p = landing.p_m;
                let off_m = (p - Vector3::from(self.bottle_m)).xy().norm();
                let word = if off_m <= BOTTLE_M { "hit" } else { "missed" };
                console::line!(
                    "  ball: at the height of the bottle at ({:.4}, {:.4}, {:.4}) m, {:.1} mm from it: bottle {word}",
                    p.x,
                    p.y,
                    p.z,
                    1e3 * off_m
                );
            }
            None if krc.released().is_some() => {
                console::line!("  ball: left the hand, never at the height of the bottle");
            }
            None => console::line!("  ball: in the hand"),
        }
        match served.fault {
            Some(fault) => console::line!("  robot: stopped by {fault}"),
            None => console::line!("  robot: program ended"),
        }
    }
}
