//! The analysis with logs whose truth is known: one made by hand from closed forms, and one of the simulated cell
//! with a record of its own state.

use std::path::{Path, PathBuf};

use firmware::events::PlanEvents;
use firmware::joints::PerJoint;
use firmware::settings::Settings;
use firmware::spline::Knot;
use firmware::trajectory_format::{FILE_LEN_MAX, Header, encode};
use hil_sim::CellOptions;
use operator::analysis::{self, AnalysisError, PlanClock, Run, bus, start::StartFrom};
use operator::bus::{BusArgs, Session};
use operator::log::candump::{Line, read};
use operator::samples::{BitTimes, Samples};
use planner::plan::Arm;
use planner::plan::file::PlanFile;
use protocol::cyphal::cubecell::command;
use protocol::cyphal::cubecell::group_state::{self, GroupState, State};
use protocol::cyphal::id::{NodeId, Priority, Route, TransferId};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::powercube::{
    Dio, MotionCommand, MotionKind, MotionPosition, MotionRequest, Parameter, Reply, Request, ShortState,
    Value,
};
use protocol::units::Radians;
use protocol::{Duration, Frame, Instant, JointIndex, ModuleId, bits};

use crate::common::plan;

// ---- By hand ----

/// Start of the plan in the log, and what the controller's clock is behind the log's.
const START_US: u64 = 9_000_000;
const BEHIND_US: u64 = 7_500_000;
const AMPLITUDE_RAD: f64 = 0.01;
const OMEGA_RAD_S: f64 = 12.0;
const CYCLE_US: u64 = 3_000;
/// From the end of a request to the end of its answer.
const LATENCY_US: u64 = 310;

/// Error that the log is made with.
fn error(t_s: f64, joint: usize) -> (f64, f64) {
    let phase = OMEGA_RAD_S * t_s + joint as f64;
    (AMPLITUDE_RAD * phase.sin(), AMPLITUDE_RAD * OMEGA_RAD_S * phase.cos())
}

#[derive(Default)]
struct Maker {
    lines: Vec<Line>,
    tx: TxQueue<32, 64>,
    transfer: u8,
}

impl Maker {
    fn frame(&mut self, at_us: u64, frame: Frame) {
        let at = Instant::from_micros(at_us);
        self.lines.push(Line { number: 0, at, frame, sent: None });
    }

    /// A state message that is sent at `at_us` and waits `held_us` before its first frame is on the bus.
    fn group(&mut self, at_us: u64, held_us: u64, state: State) {
        let along = at_us.saturating_sub(START_US);
        let message = GroupState {
            uptime_us: at_us - BEHIND_US,
            state,
            cycle_us: CYCLE_US as u16,
            cycles_saturated: (along / 100_000) as u16,
            trajectory_time_us: if state == State::Running { along as u32 } else { 0 },
            ..GroupState::default()
        };
        let meta = TxMeta {
            route: Route::Message { subject: group_state::SUBJECT, source: NodeId::from_low_bits(10) },
            priority: Priority::Nominal,
            transfer_id: TransferId::from_low_bits(self.transfer),
            deadline: Instant::FAR_FUTURE,
        };
        self.transfer = (self.transfer + 1) % 32;
        self.tx.push(&meta, &message).unwrap();
        let mut at_us = at_us + held_us;
        while let Some(frame) = self.tx.pop() {
            at_us += u64::from(bits::length(&frame).with_interframe_space());
            self.frame(at_us, frame);
        }
    }
}

fn log_by_hand(arm: &Arm, plan: &PlanFile) -> Vec<Line> {
    let mut maker = Maker::default();
    let drives = arm.drives().unwrap();
    let end_us = (plan.end_time_s * 1e6) as u64;
    for k in 0..(end_us + 600_000) / CYCLE_US {
        let cycle_us = START_US - 300_000 + k * CYCLE_US;
        for (j, drive) in drives.iter().enumerate() {
            let module = ModuleId::new(drive.address).unwrap();
            let asked_us = cycle_us + 400 * j as u64;
            let target = Radians::new(0.0);
            let request = Request::Move(MotionRequest::extended(MotionCommand::Ramp { target }));
            maker.frame(asked_us, request.encode(module));
            let answered_us = asked_us + LATENCY_US;
            let reply_at = |q_rad: f64| {
                let position = MotionPosition::Radians(Radians::new(q_rad as f32));
                let (kind, short_state, dio) = (MotionKind::Ramp, ShortState::EMPTY, Dio(0));
                Reply::MotionExtended { kind, position, short_state, dio }.encode(module)
            };
            // A few stuff bits more or less do not matter here: 5 µs at 2 rad/s are 0.01 mrad.
            let took_us = u64::from(bits::length(&reply_at(1.0)).frame());
            let t_s = (answered_us - took_us) as f64 * 1e-6 - START_US as f64 * 1e-6;
            let q_rad = motion(plan).at(t_s).q[j] - error(t_s, j).0;
            maker.frame(answered_us, reply_at(q_rad));
        }
        if k % 33 == 0 {
            let (at_us, held_us) = (cycle_us + 2_500, if k % 66 == 0 { 0 } else { 900 });
            let state = match at_us {
                us if us < START_US - 6_000 => State::Armed,
                us if us < START_US + end_us + 200_000 => State::Running,
                _ => State::Ready,
            };
            maker.group(at_us, held_us, state);
        }
        // One current of a constant ampere per joint number, another drive each cycle.
        let module = ModuleId::new(drives[k as usize % 6].address).unwrap();
        let value = Value::F32(-((k % 6 + 1) as f32));
        maker.frame(cycle_us + 2_400, Reply::Value(Parameter::Cur, value).encode(module));
    }
    maker.lines.sort_by_key(|line| line.at);
    maker.lines
}

/// Samples of a log, its drives as in the robot file.
fn samples(lines: &[Line], arm: &Arm) -> Samples {
    Samples::of_log(lines.to_vec(), analysis::drives_of(arm).unwrap(), arm, 1_000_000)
}

/// A whole run, its start to be found.
fn whole<'a>(
    samples: &'a Samples,
    plan: &'a PlanFile,
    motion: &'a planner::motion::Motion,
    arm: &'a Arm,
) -> Run<'a> {
    Run { samples, motion, throw: Some(plan), arm, start: None, gripper_opening: None, certified: None }
}

#[test]
fn a_motion_that_throws_nothing_has_the_same_tracking_and_no_release() {
    let (arm, plan) = plan();
    let samples = samples(&log_by_hand(&arm, &plan), &arm);
    let motion = motion(&plan);
    let thrown = whole(&samples, &plan, &motion, &arm);
    let moved = analysis::analyse(&Run { throw: None, ..thrown }).unwrap();
    let thrown = analysis::analyse(&thrown).unwrap();
    assert!(thrown.release.is_some() && moved.release.is_none() && moved.release_t_s.is_none());
    for (a, b) in thrown.joints.iter().zip(&moved.joints) {
        assert_eq!((a.position_error_rad.max, &a.samples), (b.position_error_rad.max, &b.samples));
        assert!(a.position_error_rad.at_release.is_some() && b.position_error_rad.at_release.is_none());
    }
}

#[test]
fn a_log_made_from_closed_forms_gives_them_back() {
    let (arm, plan) = plan();
    let lines = log_by_hand(&arm, &plan);
    let samples = samples(&lines, &arm);
    let analysis = analysis::analyse(&whole(&samples, &plan, &motion(&plan), &arm)).unwrap();

    assert_eq!(analysis.start_from, StartFrom::Telemetry);
    let start_off_s = analysis.start_log_s - START_US as f64 * 1e-6;
    assert!(start_off_s.abs() < 2e-5, "the fastest message ties the clocks: off by {start_off_s} s");
    assert!(analysis.completed);

    for (j, joint) in analysis.joints.iter().enumerate() {
        let position = &joint.position_error_rad;
        let speed = &joint.speed_error_rad_s;
        let near = |got: f64, wanted: f64, within: f64, what: &str| {
            assert!((got - wanted).abs() < within, "joint {j}: {what} {got}, wanted {wanted}");
        };
        near(position.max, AMPLITUDE_RAD, 2e-4, "largest position error");
        near(speed.max, AMPLITUDE_RAD * OMEGA_RAD_S, 3e-3, "largest speed error");
        let (e, de) = error(plan.release_time_s, j);
        near(position.at_release.unwrap(), e, 1.5e-4, "position error at the release");
        near(speed.at_release.unwrap(), de, 3e-3, "speed error at the release");
        // Mean of sin² over the plan, integrated.
        let (a, b) = (j as f64, OMEGA_RAD_S * plan.end_time_s + j as f64);
        let mean = 0.5 - ((2.0 * b).sin() - (2.0 * a).sin()) / (4.0 * (b - a));
        near(position.rms, AMPLITUDE_RAD * mean.sqrt(), 1e-4, "rms position error");
    }

    let cycles = analysis.cycles.period_s.unwrap();
    assert!((cycles.median - 3e-3).abs() < 1e-9 && analysis.cycles.deviation_s.unwrap().max < 1e-9);
    let answers = analysis.answers.as_ref().unwrap();
    let latency = answers.latency_s.unwrap();
    assert!((latency.median - LATENCY_US as f64 * 1e-6).abs() < 1e-9 && latency.max - latency.min < 1e-9);
    assert_eq!((answers.unanswered, answers.by_module.len()), (0, 6));
    // No requests for the currents of this log: one answer per cycle; those of the first 20 ms may answer earlier requests.
    let currents = ((plan.end_time_s - 0.02) / 3e-3) as usize;
    assert!((currents - 2..=currents + 2).contains(&answers.unasked), "{}", answers.unasked);

    // The first supply feeds joints 1 to 3, the second the others: 1 + 2 + 3 and 4 + 5 + 6 A.
    let peaks: Vec<f64> = analysis.supplies.iter().map(|s| s.measured_peak_a.unwrap()).collect();
    assert!((peaks[0] - 6.0).abs() < 1e-9 && (peaks[1] - 15.0).abs() < 1e-9, "{peaks:?}");
    for (supply, planned) in analysis.supplies.iter().zip(&plan.currents.supply_peak) {
        assert!((supply.predicted_peak_a - planned.peak_a).abs() < 0.02 * planned.peak_a);
    }

    // The controller's own count, one per tenth of a second.
    let whole = (plan.end_time_s * 10.0) as u16;
    assert!((whole..=whole + 4).contains(&analysis.counts.cycles_saturated));
}

#[test]
fn a_log_without_a_run_or_without_a_drive_says_so() {
    let (arm, plan) = plan();
    let mut lines = log_by_hand(&arm, &plan);
    let analyse = |lines: &[Line], start| {
        let samples = samples(lines, &arm);
        analysis::analyse(&Run { start, ..whole(&samples, &plan, &motion(&plan), &arm) }).map(drop)
    };
    assert_eq!(analyse(&[], None), Err(AnalysisError::Empty));
    let third = arm.drives().unwrap()[2].address;
    lines.retain(|line| line.frame.id().raw() != 0x0A0 + u32::from(third));
    let joint = arm.joints()[2].name.clone();
    assert_eq!(analyse(&lines, None), Err(AnalysisError::Silent { joint, module: Some(third) }));
    lines.retain(|line| !line.frame.is_extended());
    assert_eq!(analyse(&lines, None), Err(AnalysisError::NoRun));
}

// ---- The simulated cell ----

fn motion(plan: &PlanFile) -> planner::motion::Motion {
    plan.motion.to_motion()
}

/// The plan as a controller's file: its knots are where its cubics meet.
fn trajectory(plan: &PlanFile) -> Vec<u8> {
    let settings = Settings::powercube6();
    let knots: Vec<Knot> = [0.0, plan.release_time_s, plan.end_time_s]
        .into_iter()
        .map(|t_s| {
            let sample = motion(plan).at(t_s);
            let mut state = PerJoint::default();
            for joint in JointIndex::first(6) {
                let qd = if t_s == plan.release_time_s { sample.qd[joint.get()] } else { 0.0 };
                state.set(joint, (sample.q[joint.get()] as f32, qd as f32));
            }
            Knot { t_us: (t_s * 1e6).round() as u32, state }
        })
        .collect();
    let header = Header {
        joints: 6,
        period_us: settings.cycle_period_us,
        events: PlanEvents::release(Some(knots[1].t_us)),
        robot_crc32: settings.robot_crc32,
        ..Header::default()
    };
    let mut bytes = vec![0; FILE_LEN_MAX];
    let len = encode(&header, &knots, &mut bytes).unwrap();
    bytes.truncate(len);
    bytes
}

/// The cell's own state at a grid point.
struct Truth {
    at: Instant,
    q_rad: [f64; 6],
    v_rad_s: [f64; 6],
}

fn throw_in_the_cell(plan: &PlanFile, folder: &Path) -> (Session, Vec<Truth>) {
    let _ = std::fs::remove_dir_all(folder);
    std::fs::create_dir_all(folder).unwrap();
    plan.write(&folder.join("plan.json")).unwrap();
    let mut options = CellOptions::default();
    options.drive.starts_homed = true;
    options.gripper.jitter = Duration::ZERO;
    options.start_q_rad = Some(motion(plan).at(0.0).q.iter().copied().collect());
    let args = BusArgs { record: Some(folder.join("bus")), ..BusArgs::default() };
    let mut cell = args.cell.load().unwrap();
    cell.setup.cell = options;
    let mut session = args.open_cell(&cell, Some(&Settings::powercube6())).unwrap();
    let node = session.find_controller(None).unwrap();
    session.wait_for(Duration::from_secs(10), &|state| state == State::Ready).unwrap();
    let name = session.upload(node, &trajectory(plan), &mut |_, _| {}).unwrap();
    session.arm(node, &name).unwrap();
    session.order(node, "to run", command::RUN, &name).unwrap();
    let mut truth = Vec::new();
    let until = session.now() + Duration::from_secs_f64(plan.end_time_s + 1.0);
    while session.now() < until {
        session.pass(Duration::from_millis(1)).unwrap();
        let cell = session.sim().unwrap().cell();
        let (at, plant) = (cell.grid(), cell.plant());
        truth.push(Truth {
            at,
            q_rad: std::array::from_fn(|j| plant.link_q_rad(j)),
            v_rad_s: std::array::from_fn(|j| plant.axis(j).v_rad_s),
        });
    }
    (session, truth)
}

#[test]
fn a_throw_in_the_cell_is_measured_as_the_cell_itself_has_it() {
    let (arm, plan) = plan();
    // Kept: a picture of the report can be made from it.
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("analysed-throw");
    let (mut session, truth) = throw_in_the_cell(&plan, &folder);
    let sim = session.sim().unwrap();
    let landing = sim.cell().throw().landing.expect("released");
    let utilisation = sim.world().bus_report().utilisation;
    let until = sim.now();
    session.finish().unwrap();

    let log = std::fs::File::open(folder.join("bus.log")).unwrap();
    let lines = read(std::io::BufReader::new(log)).unwrap().lines;
    let samples = samples(&lines, &arm);
    let analysis = analysis::analyse(&whole(&samples, &plan, &motion(&plan), &arm)).unwrap();
    assert!(analysis.completed && analysis.fault.is_none(), "{:#?}", analysis.events);

    let (mut q_worst, mut v_worst) = (0.0_f64, 0.0_f64);
    // The order to run takes some milliseconds, during which the cell was not recorded.
    let seen_from_s = truth[0].at.as_secs_f64() - analysis.start_log_s;
    assert!(seen_from_s < 0.1 * plan.end_time_s, "{seen_from_s}");
    for (j, joint) in analysis.joints.iter().enumerate() {
        let per_cycle = (plan.end_time_s / 3e-3) as usize;
        assert!(joint.samples_in_plan > per_cycle - 10, "joint {j}: {}", joint.samples_in_plan);
        let seen = seen_from_s.max(0.0)..plan.end_time_s;
        for sample in joint.samples.iter().filter(|s| seen.contains(&s.t_s)) {
            let t_s = sample.t_s + analysis.start_log_s;
            let after = truth.partition_point(|x| x.at.as_secs_f64() < t_s);
            let (a, b) = (&truth[after - 1], &truth[after]);
            let share = (t_s - a.at.as_secs_f64()) / (b.at.as_secs_f64() - a.at.as_secs_f64());
            q_worst = q_worst.max((a.q_rad[j] + share * (b.q_rad[j] - a.q_rad[j]) - sample.q_rad).abs());
            let v = a.v_rad_s[j] + share * (b.v_rad_s[j] - a.v_rad_s[j]);
            v_worst = v_worst.max((v - sample.qd_rad_s).abs());
        }
    }
    let predicted = analysis.release.unwrap().landing_m.unwrap();
    let off_m = (predicted[0] - landing.p_m.x).hypot(predicted[1] - landing.p_m.y);
    println!(
        "positions within {q_worst:.2e} rad, speeds within {v_worst:.2e} rad/s, landing within {off_m:.1e} m"
    );
    // Half a step of 0.02° and 60 µs of the fastest joint; the window of the slope; both of them at the floor.
    assert!((1e-5..6e-4).contains(&q_worst), "{q_worst}");
    assert!((1e-3..0.06).contains(&v_worst), "{v_worst}");
    assert!(off_m < 0.012, "{off_m}");

    // The whole log's bits, against what the bus model counted itself.
    let frames = &samples.bus.as_ref().expect("a log of a bus").frames;
    let whole = bus::usage(
        frames,
        PlanClock::starting(Instant::ZERO),
        until.as_secs_f64(),
        BitTimes::of(1_000_000, None),
    );
    let ratio = whole.utilisation / utilisation;
    assert!((0.999..1.001).contains(&ratio), "{} against {utilisation}", whole.utilisation);
}
