//! The same throw by two operators: a controller on a CAN bus, and one in this program. The simulated cell of each
//! reports where the ball landed.

use firmware::authority::Key;
use firmware::groups::powercube::settings::REGISTERS;
use firmware::settings::Settings;
use hil_sim::scenario::fault_from_line;
use nalgebra::Vector3;
use operator::bus::args::{Cell, CellArgs};
use operator::bus::period::settings_with_gains;
use operator::bus::{BusArgs, Session};
use operator::dialogue::operator::OperatorError;
use operator::dialogue::registers::Numbers;
use operator::job::cell::take_plan;
use operator::job::{Answer, JobError, Judge, Order, Outcome, Program, Record, Step, perform};
use operator::port::{BallSeen, InProcess, OnBus, Operator};
use planner::motion::{Knot, Motion};
use planner::plan::file::PlanFile;
use planner::plan::{Arm, Joints};
use planner::store::fingerprint_of;
use planner::way::Travel;
use protocol::Duration;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;

use crate::common::plan;

/// The cell of the throw, with one fault if there is one.
fn cell(plan: &PlanFile, fault: Option<&str>) -> Cell {
    let mut cell = BusArgs::default().cell.load().unwrap();
    cell.setup.cell.drive.starts_homed = true;
    cell.setup.cell.gripper.jitter = Duration::ZERO;
    take_plan(&mut cell.setup.cell, plan);
    cell.setup.faults.extend(fault.map(|line| fault_from_line(line, 0).unwrap()));
    cell
}

/// What became of a throw.
struct Thrown {
    record: Record,
    /// Truth of the cell.
    ball: BallSeen,
}

fn throw(operator: &mut dyn Operator, arm: &Arm, plan: &PlanFile) -> Record {
    perform(operator, &Order::throw(arm, plan, Travel::default()), &mut |_| Answer::Yes)
}

fn on_a_bus(arm: &Arm, plan: &PlanFile, fault: Option<&str>) -> Thrown {
    let cell = cell(plan, fault);
    let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    let mut session = BusArgs::default().open_cell(&cell, Some(&settings)).unwrap();
    let record = throw(&mut OnBus::new(&mut session, None), arm, plan);
    let ball = BallSeen::of(session.sim().unwrap().cell());
    Thrown { record, ball }
}

fn in_process(arm: &Arm, plan: &PlanFile, fault: Option<&str>) -> Thrown {
    let cell = cell(plan, fault);
    let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    let mut operator = InProcess::new(&cell.robot, &cell.setup, cell.seed, &settings).unwrap();
    let record = throw(&mut operator, arm, plan);
    let ball = BallSeen::of(operator.cell());
    Thrown { record, ball }
}

fn miss_m(ball: &BallSeen, plan: &PlanFile) -> f64 {
    (ball.landing.unwrap().1 - Vector3::from(plan.target.position_m)).norm()
}

#[test]
fn the_same_job_lands_the_ball_by_either_operator_and_its_samples_give_the_same_report() {
    let (arm, plan) = plan();
    let (bus, local) = (on_a_bus(&arm, &plan, None), in_process(&arm, &plan, None));
    for thrown in [&bus, &local] {
        assert!(thrown.record.ended.is_none(), "{:?}", thrown.record.ended);
        assert_eq!(thrown.record.verdict.outcome, Outcome::Landed, "{}", thrown.record.verdict.text);
        let reported_m = thrown.record.landing.unwrap().error_m;
        assert!((reported_m - miss_m(&thrown.ball, &plan)).abs() < 1e-12);
    }
    assert_eq!((bus.record.node.map(NodeId::get), local.record.node), (Some(10), None));

    let (of_bus, of_local) = (bus.record.analysis.unwrap(), local.record.analysis.unwrap());
    assert!(of_bus.completed && of_local.completed);
    assert!(of_bus.bus.is_some() && of_bus.answers.is_some() && of_bus.joints[0].module.is_some());
    assert!(of_local.bus.is_none() && of_local.answers.is_none() && of_local.joints[0].module.is_none());
    for (a, b) in of_bus.joints.iter().zip(&of_local.joints) {
        let (more, less) =
            (a.samples_in_plan.max(b.samples_in_plan), a.samples_in_plan.min(b.samples_in_plan));
        assert!(more - less <= 3, "{}: {more} {less}", a.name);
        let apart_rad = (a.position_error_rad.rms - b.position_error_rad.rms).abs();
        // The host link shares the bus of one of them, so their cycles differ; a step of a drive is 0.35 mrad.
        println!("{}: rms errors {:.2e} rad, {apart_rad:.1e} rad apart", a.name, a.position_error_rad.rms);
        assert!(apart_rad < 3.5e-4, "{}: {apart_rad}", a.name);
    }
    let landings = [of_bus.release.unwrap(), of_local.release.unwrap()].map(|release| {
        assert!(release.gripper_ordered_t_s.is_some());
        Vector3::from(release.landing_m.unwrap())
    });
    for (landing, thrown) in landings.iter().zip([&bus.ball, &local.ball]) {
        // The bound of the measured motion against the cell, as for a log: half a step of each drive, and the gripper's clock.
        let off_m = (landing - thrown.landing.unwrap().1).xy().norm();
        println!("measured motion sends the ball {:.1} mm beside where it landed", 1e3 * off_m);
        assert!(off_m < 0.012, "{off_m}");
    }
}

#[test]
fn a_drive_that_falls_silent_stops_the_throw_by_either_operator_with_the_same_cause() {
    let (arm, plan) = plan();
    let cell = cell(&plan, None);
    let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    // Found from a throw without a fault: the middle of the throw, by the time of each cell.
    let clean = in_process(&arm, &plan, None);
    let (_, begun, ended) =
        *clean.record.steps.iter().find(|(step, ..)| *step == Step::Throw).expect("it was thrown");
    let middle_s = 0.5 * (begun.as_secs_f64() + ended.as_secs_f64());
    assert!(settings.reply_missed_max >= 1);
    let silent = format!("kind = \"silent\", target = \"module 3\", start_s = {middle_s:.3}, length_s = 2.0");
    for thrown in [on_a_bus(&arm, &plan, Some(&silent)), in_process(&arm, &plan, Some(&silent))] {
        let Record { verdict, ended, .. } = &thrown.record;
        assert_eq!(verdict.outcome, Outcome::Stopped, "{}", verdict.text);
        let Some(JobError::Operator(OperatorError::Stopped { cause, joint, .. })) = *ended else {
            panic!("{}", verdict.text)
        };
        assert_eq!((cause, joint), (firmware::fault::Cause::DriveSilent.code(), 3));
        let fault = thrown.record.analysis.unwrap().fault.unwrap();
        assert_eq!((fault.code, fault.joint), (cause, Some(3)));
        assert_eq!(thrown.record.landing.is_some(), thrown.ball.landing.is_some());
    }
}

#[test]
fn registers_of_a_controller_in_process_are_read_written_and_refused_as_over_a_bus() {
    let (_, plan) = plan();
    let cell = cell(&plan, None);
    let mut operator = InProcess::new(&cell.robot, &cell.setup, cell.seed, &Settings::powercube6()).unwrap();
    operator.connect().unwrap();
    let period = Numbers::Natural(vec![50_000]);
    operator.set_register("telemetry.period_us", &period).unwrap();
    assert_eq!(operator.register("telemetry.period_us").unwrap(), period);
    let refused = operator.set_register("joint.v_max_rad_s", &Numbers::Real(vec![99.0; 6])).unwrap_err();
    assert!(matches!(refused, OperatorError::Refused { .. }), "{refused}");
    assert!(matches!(operator.register("no.such"), Err(OperatorError::NoRegister { .. })));
}

/// A path of half a minute with more points than a controller holds, from where the cell's arm stands.
fn long_path(start_rad: &Joints) -> Motion {
    let end_s = 30.0;
    let knot = |k: u32| {
        let t_s = 0.075 * f64::from(k);
        // Swings that begin and end at rest: sin² of the time as a whole.
        let (turn, whole) = (std::f64::consts::PI / end_s, 0.25);
        let shape = (turn * t_s).sin().powi(2);
        let slope = 2.0 * turn * (turn * t_s).sin() * (turn * t_s).cos();
        let wave = |j: usize| ((0.6 + 0.1 * j as f64) * t_s).sin();
        let wave_slope = |j: usize| (0.6 + 0.1 * j as f64) * ((0.6 + 0.1 * j as f64) * t_s).cos();
        Knot {
            t_s,
            q_rad: Joints::from_fn(6, |j| start_rad[j] + whole * shape * wave(j)),
            qd_rad_s: Joints::from_fn(6, |j| whole * (slope * wave(j) + shape * wave_slope(j))),
        }
    };
    Motion { knots: (0..=400).map(knot).collect(), events: Vec::new() }
}

/// What became of it, and where the arm stood before.
fn follow_long_path(operator: &mut dyn Operator, arm: &Arm, plan: &PlanFile) -> (Record, Joints) {
    operator.connect().unwrap();
    operator.wait_for(Duration::from_secs(20), &|state| state == State::Ready).unwrap();
    let start_rad = Joints::from_slice(&operator.pose().unwrap());
    let program = Program::Motion(long_path(&start_rad));
    (
        perform(operator, &Order::new(arm, &plan.robot.fingerprint, program, Judge::Reach), &mut |_| {
            Answer::Yes
        }),
        start_rad,
    )
}

/// Frames of the lowest priority, which segments and their answers have, are lost: of one segment in three at least one.
const LOSSY: &str =
    "kind = \"drop\", target = \"bus\", id = \"1C000000\", id_mask = 0x1C000000, probability = 0.01";

#[test]
fn path_with_more_points_than_the_controller_holds_is_followed_by_either_operator_also_if_frames_are_lost() {
    let (arm, plan) = plan();
    for fault in [None, Some(LOSSY)] {
        let cell = cell(&plan, fault);
        let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
        let mut session = BusArgs::default().open_cell(&cell, Some(&settings)).unwrap();
        let mut bus = OnBus::new(&mut session, None);
        let mut local = InProcess::new(&cell.robot, &cell.setup, cell.seed, &settings).unwrap();
        let records = [follow_long_path(&mut bus, &arm, &plan), follow_long_path(&mut local, &arm, &plan)];
        let stands_rad = [session.sim().unwrap().cell(), local.cell()]
            .map(|cell| Joints::from_fn(6, |joint| cell.plant().link_q_rad(joint)));
        for ((record, stood_rad), stands_rad) in records.iter().zip(stands_rad) {
            assert!(record.ended.is_none(), "{:?}", record.ended);
            let reached = record.reached.as_ref().unwrap();
            assert!(reached.samples > 50_000 && (1e-5..2e-3).contains(&reached.off_rad), "{reached:?}");
            // The path ends where it began; so does the arm of the simulated world.
            assert!((stands_rad - *stood_rad).amax() < 1e-3, "{stands_rad:?}");
        }
    }
}

#[test]
fn path_whose_segments_do_not_come_ends_with_its_cause_on_the_way() {
    let (arm, plan) = plan();
    let deaf = "kind = \"drop\", target = \"bus\", id = \"1C000000\", id_mask = 0x1C000000";
    let cell = cell(&plan, Some(deaf));
    let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    let mut session = BusArgs::default().open_cell(&cell, Some(&settings)).unwrap();
    let (record, _) = follow_long_path(&mut OnBus::new(&mut session, None), &arm, &plan);
    let Some(JobError::Operator(OperatorError::Stopped { cause, .. })) = record.ended else {
        panic!("{:?}", record.ended)
    };
    assert_eq!(cause, firmware::fault::Cause::PathRanDry.code());
    assert_eq!(record.verdict.outcome, Outcome::Stopped);
    // 255 pieces of 75 ms were there; it stopped within them.
    let reached_us = record.states.iter().map(|(_, group)| group.trajectory_time_us).max().unwrap();
    assert!((17_500_000..19_125_000).contains(&reached_us), "{reached_us}");
}

/// The armed file has the digests of all segments: they need no code of their own.
#[test]
fn long_path_is_followed_by_a_controller_with_a_key() {
    let (arm, plan) = plan();
    let cell = cell(&plan, None);
    let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    let mut session = BusArgs::default().open_cell(&cell, Some(&settings)).unwrap();
    lock(&mut session);
    let (record, _) = follow_long_path(&mut OnBus::new(&mut session, None), &arm, &plan);
    assert_eq!((record.verdict.outcome, record.ended.is_none()), (Outcome::Reached, true));
}

/// Host and controller compute the digest of a run over the same registers.
#[test]
fn an_arm_of_servos_has_no_register_of_powercubes_and_runs_with_a_key() {
    let args = BusArgs {
        cell: CellArgs {
            robot: Some(concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/canopen6.toml").to_owned()),
            ..CellArgs::default()
        },
        ..BusArgs::default()
    };
    let cell = args.cell.load().unwrap();
    let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    let mut session = args.open_cell(&cell, Some(&settings)).unwrap();
    let node = lock(&mut session);
    let names = session.register_names(node).unwrap();
    for register in REGISTERS.table {
        assert!(!names.iter().any(|name| name == register.name), "{}", register.name);
        assert_eq!(session.find_register(node, register.name).unwrap(), None);
    }
    assert!(names.iter().any(|name| name == "watchdog.timeout_us"));
    let mut operator = OnBus::new(&mut session, None);
    operator.connect().unwrap();
    let start_rad = Joints::from_slice(&operator.pose().unwrap());
    let program = Program::Motion(long_path(&start_rad));
    let mut order = Order::new(&cell.robot, &fingerprint_of(&cell.robot), program, Judge::Reach);
    order.homes = true;
    let record = perform(&mut operator, &order, &mut |_| Answer::Yes);
    assert_eq!(
        (record.verdict.outcome, record.ended.is_none()),
        (Outcome::Reached, true),
        "{:?}",
        record.ended
    );
}

/// Gives the controller a key that the session has.
fn lock(session: &mut Session) -> NodeId {
    let node = session.find_controller(None).unwrap();
    session.wait_for(Duration::from_secs(20), &|state| state != State::Boot).unwrap();
    session.write_key(node, &[0x42; 32]).unwrap();
    session.set_key(Some(Key::new([0x42; 32])));
    node
}
