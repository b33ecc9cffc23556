//! An arm of motors with MIT frames in the simulated cell: its fingers, and faults of their motor.

use firmware::fault::Cause;
use operator::bus::BusArgs;
use operator::bus::BusFailure;
use operator::bus::args::{Cell, CellArgs};
use operator::bus::period::settings_with_gains;
use operator::bus::session::Session;
use operator::port::{BallSeen, OnBus, Operator};
use protocol::Duration;
use protocol::cyphal::cubecell::group_state::State;

fn cell() -> Cell {
    let robot = format!("{}/../../robots/openarm7.toml", env!("CARGO_MANIFEST_DIR"));
    CellArgs { robot: Some(robot), ..CellArgs::default() }.load().unwrap()
}

fn open(cell: &Cell) -> Session {
    let mut settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    operator::bus::period::set_period(&mut settings, 5_000);
    BusArgs::default().open_cell(cell, Some(&settings)).unwrap()
}

/// The motor of the fingers, which is the last one.
fn fingers<R>(session: &mut Session, act: impl FnOnce(&mut hil_sim::drive::mit::MitMotor) -> R) -> R {
    let world = session.sim().unwrap().world();
    world.with_participants(|all, _| act(all.0.0.0.motors_mut().last().unwrap())).unwrap()
}

/// The controller has found its drives.
fn found(session: &mut Session) {
    let mut operator = OnBus::new(session, None);
    operator.connect().unwrap();
    operator.wait_for(Duration::from_secs(5), &|state| state == State::Idle).unwrap();
}

fn order(session: &mut Session, open: bool) {
    let mut operator = OnBus::new(session, None);
    operator.connect().unwrap();
    operator.set_gripper(open).unwrap();
}

fn pass(session: &mut Session, ms: u64) {
    let until = session.now() + Duration::from_millis(ms);
    session.run(until, &mut |_| false).unwrap();
}

#[test]
fn fingers_stay_until_they_are_ordered_and_the_ball_is_free_when_the_settings_say() {
    let cell = cell();
    let gripper = cell.robot.mit_motors().unwrap().gripper.unwrap();
    let mut session = open(&cell);
    found(&mut session);
    pass(&mut session, 500);
    assert!(fingers(&mut session, |motor| motor.shaft_rad() - gripper.travel.closed_rad).abs() < 5e-3);
    assert!(BallSeen::of(session.sim().unwrap().cell()).landing.is_none());

    order(&mut session, true);
    let ordered_s = session.now().as_secs_f64();
    pass(&mut session, 2_000);
    assert!(fingers(&mut session, |motor| motor.shaft_rad() - gripper.travel.open_rad).abs() < 5e-3);
    let released_at = session.sim().unwrap().cell().throw().released_at.unwrap();
    let took_s = released_at.as_secs_f64() - ordered_s;
    // The answer to the order is on its way for some milliseconds; damping slows the fingers down.
    assert!((took_s - gripper.opening_s()).abs() < 4e-3, "{took_s} s");

    order(&mut session, false);
    pass(&mut session, 2_000);
    assert!(fingers(&mut session, |motor| motor.shaft_rad() - gripper.travel.closed_rad).abs() < 5e-3);
}

#[test]
fn a_gripper_motor_without_power_is_a_fault_of_the_gripper_and_the_joints_are_held() {
    let cell = cell();
    let mut session = open(&cell);
    found(&mut session);
    let mut operator = OnBus::new(&mut session, None);
    operator.connect().unwrap();
    operator.home(0x7F, Duration::from_secs(5)).unwrap();
    let held_rad = operator.pose().unwrap();
    fingers(&mut session, |motor| motor.set_power(false));
    let until = session.now() + Duration::from_secs(1);
    let Err(BusFailure::StoppedByOther(seen)) = session.run(until, &mut |_| false) else {
        panic!("the controller goes on without its gripper")
    };
    let group = seen.group.unwrap();
    assert_eq!((group.fault_cause, group.fault_joint), (Cause::GripperUnanswered.code(), 8));
    session.sim().unwrap().world().run_until(until, &mut ()).unwrap();
    let plant_rad: Vec<f64> =
        (0..7).map(|axis| session.sim().unwrap().cell().plant().link_q_rad(axis)).collect();
    for (plant, held) in plant_rad.iter().zip(&held_rad) {
        assert!((plant - held).abs() < 3e-3, "{plant} {held}");
    }
}
