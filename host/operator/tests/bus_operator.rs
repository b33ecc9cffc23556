//! Orders to the soft controller over the wire: boot, home, upload, commit, arm, run, follow.

use firmware::authority::Key;
use firmware::fault::Cause;
use firmware::joints::PerJoint;
use firmware::settings::Settings;
use firmware::trajectory_format::{FILE_LEN_MAX, Header, encode, rest};
use operator::bus::settings::settings_of;
use operator::bus::{BusArgs, Session};
use operator::dialogue::history::describe;
use operator::dialogue::operator::OperatorError;
use operator::dialogue::registers::Numbers;
use protocol::cyphal::cubecell::command::{RUN, STOP};
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::uavcan::diagnostic::Severity;
use protocol::{Duration, JointIndex};

use crate::common::homed;

/// Stands where the arm stands, for half a second.
fn standing(session: &mut Session, offset_rad: f32) -> Vec<u8> {
    let settings = Settings::powercube6();
    let mut q_rad = PerJoint::<f32>::default();
    for (joint, heard) in JointIndex::first(6).zip(session.host_node().heard().values()) {
        *q_rad.at_mut(joint) = heard.position_rad.unwrap() + offset_rad;
    }
    let header = Header {
        joints: 6,
        period_us: settings.cycle_period_us,
        robot_crc32: settings.robot_crc32,
        ..Header::default()
    };
    let mut bytes = vec![0; FILE_LEN_MAX];
    let len = encode(&header, &rest(q_rad, 500_000), &mut bytes).unwrap();
    bytes.truncate(len);
    bytes
}

#[test]
fn a_trajectory_is_uploaded_committed_armed_run_and_followed_to_its_end() {
    let (mut session, node) = homed();
    let file = standing(&mut session, 0.0);
    let mut pieces = 0;
    let name = session.upload(node, &file, &mut |_, _| pieces += 1).unwrap();
    assert!(pieces >= 1);
    session.arm(node, &name).unwrap();
    let mut states = Vec::new();
    let end = session
        .run_trajectory_at(node, &name, None, Duration::from_secs(5), &[], &mut |_, group| {
            states.push(group.state);
        })
        .unwrap();
    assert_eq!(end.state, State::Ready);
    assert!(states.contains(&State::Running), "{states:?}");
}

#[test]
fn a_plan_that_begins_elsewhere_and_a_damaged_file_are_refused_with_cause_and_next_step() {
    let (mut session, node) = homed();
    let mut file = standing(&mut session, 0.2);
    let name = session.upload(node, &file, &mut |_, _| {}).unwrap();
    let refused = session.arm(node, &name).and_then(|()| {
        session.run_trajectory_at(node, &name, None, Duration::from_secs(5), &[], &mut |_, _| {}).map(drop)
    });
    let error = refused.unwrap_err();
    assert!(error.to_string().contains("is not where the plan begins"), "{error}");
    assert!(error.next().unwrap().starts_with("move there first: `cubectl throw --plan`"), "{error}");
    file[30] ^= 1;
    let text = session.upload(node, &file, &mut |_, _| {}).unwrap_err().to_string();
    assert!(text.contains("checksum") && text.contains("(fault 602)"), "{text}");
}

#[test]
fn a_run_that_is_stopped_in_its_first_moments_ends_with_its_fault_which_can_be_cleared() {
    let (mut session, node) = homed();
    let file = standing(&mut session, 0.0);
    let name = session.upload(node, &file, &mut |_, _| {}).unwrap();
    session.arm(node, &name).unwrap();
    let mut silent =
        hil_sim::scenario::fault_from_line("kind = \"silent\", target = \"module 3\", length_s = 0.5", 0)
            .unwrap();
    silent.start = session.now();
    session.sim().unwrap().world().add_fault(silent).unwrap();
    let begun = session.now();
    let error = session
        .run_trajectory_at(node, &name, None, Duration::from_secs(60), &[], &mut |_, _| {})
        .unwrap_err();
    let OperatorError::Stopped { state: State::Fault, cause, .. } = error else { panic!("{error}") };
    assert!(session.now().saturating_since(begun) < Duration::from_secs(2));

    let other = session.clear_fault(node, cause + 1).unwrap_err();
    assert!(matches!(other, OperatorError::Refused { .. }), "{other}");
    session.pass(Duration::from_secs(1)).unwrap();
    session.clear_fault(node, cause).unwrap();
    assert_eq!(session.group().unwrap().state, State::Ready);
    assert_eq!(session.group().unwrap().fault_cause, 0);
}

#[test]
fn a_controller_that_homes_bears_answers_that_get_lost_now_and_then() {
    let bus = BusArgs::default();
    let mut cell = bus.cell.load().unwrap();
    let lossy = "kind = \"silent\", target = \"module 3\", probability = 0.05";
    cell.setup.faults.push(hil_sim::scenario::fault_from_line(lossy, 0).unwrap());
    let settings = settings_of(&cell.robot).unwrap();
    let mut session = bus.open_cell(&cell, Some(&settings)).unwrap();
    let node = session.find_controller(None).unwrap();
    session.wait_for(Duration::from_secs(10), &|state| state != State::Boot).unwrap();
    session.home_group(node, 0x3F, Duration::from_secs(120)).unwrap();
    assert_eq!(session.group().unwrap().state, State::Ready);
    assert!(session.group().unwrap().replies_missed > 0, "nothing was lost");
}

#[test]
fn without_a_controller_the_error_names_the_verbs_that_bring_their_own() {
    let mut session = BusArgs::default().open().unwrap();
    let error = session.find_controller(None).unwrap_err();
    assert!(matches!(error, OperatorError::NoController));
    assert!(error.next().unwrap().contains("use one in this program"));
}

#[test]
fn a_host_that_is_late_hears_the_warning_of_the_controller_and_its_run_goes_on() {
    let (mut session, node) = homed();
    let file = standing(&mut session, 0.0);
    let name = session.upload(node, &file, &mut |_, _| {}).unwrap();
    session.arm(node, &name).unwrap();
    session.order(node, "to run", RUN, &name).unwrap();
    session.pass(Duration::from_millis(150)).unwrap();
    assert!(session.take_said().is_empty(), "a host in time is not warned");
    // Two heartbeats of 30 ms are left out: more than half of 100 ms, and less than all of it.
    session.host_node().listen_only();
    session.pass(Duration::from_millis(50)).unwrap();
    session.host_node().speak();
    session.pass(Duration::from_millis(100)).unwrap();
    assert_eq!(session.group().unwrap().state, State::Running);
    let said = session.take_said();
    assert_eq!(said.len(), 1, "{said:?}");
    assert_eq!(
        (said[0].1.severity, said[0].1.text.as_str()),
        (Severity::Warning, "host late: over half of host.timeout_us")
    );
    session.wait_for(Duration::from_secs(5), &|state| state == State::Ready).unwrap();
}

/// The cause with which the controller refused.
fn cause<T: std::fmt::Debug>(outcome: Result<T, OperatorError>) -> Cause {
    match outcome {
        Err(OperatorError::Refused { refusal: Some(refusal), .. }) => {
            Cause::from_code(refusal.cause).unwrap()
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_controller_with_a_key_runs_for_the_session_with_the_key_and_for_no_other() {
    let (mut session, node) = homed();
    let file = standing(&mut session, 0.0);
    let key = [0x42; 32];
    assert!(!session.is_keyed(node).unwrap());
    session.write_key(node, &key).unwrap();
    assert!(session.is_keyed(node).unwrap());

    assert_eq!(cause(session.upload(node, &file, &mut |_, _| {})), Cause::CodeMissing);
    session.set_key(Some(Key::new([0x43; 32])));
    assert_eq!(cause(session.upload(node, &file, &mut |_, _| {})), Cause::CodeWrong);
    let narrow = Numbers::Real(vec![1.0; 6]);
    let refused = session.set_register(node, "joint.v_max_rad_s", &narrow);
    assert!(matches!(refused, Err(OperatorError::RegisterRefused { .. })), "{refused:?}");
    session.write_key(node, &[]).unwrap();
    assert!(session.is_keyed(node).unwrap(), "a wrong key removes nothing");

    session.set_key(Some(Key::new(key)));
    let name = session.upload(node, &file, &mut |_, _| {}).unwrap();
    session.arm(node, &name).unwrap();
    let end =
        session.run_trajectory_at(node, &name, None, Duration::from_secs(5), &[], &mut |_, _| {}).unwrap();
    assert_eq!(end.state, State::Ready);
    session.set_register(node, "joint.v_max_rad_s", &narrow).unwrap();
    session.write_key(node, &[]).unwrap();
    assert!(!session.is_keyed(node).unwrap());
    // A code for a controller without a key: not silently without one.
    assert_eq!(cause(session.arm(node, &name)), Cause::NoTrajectory, "the limit changed");
    assert_eq!(cause(session.upload(node, &file, &mut |_, _| {})), Cause::NoKey);
}

#[test]
fn the_trace_of_a_stop_is_shown_in_words() {
    let (mut session, node) = homed();
    assert_eq!(session.freeze_frame(node).unwrap(), None);
    session.order(node, "a stop", STOP, &()).unwrap();
    session.pass(Duration::from_millis(300)).unwrap();
    assert_eq!(session.freeze_frame(node).unwrap(), None, "a plain stop is no fault");
    let words: Vec<String> = session.trace(node).unwrap().iter().map(describe).collect();
    for part in
        ["boot -> idle", "order taken: home", "homing -> ready", "order taken: stop", "halt broadcast"]
    {
        assert!(words.iter().any(|words| words.contains(part)), "{part}: {words:#?}");
    }
}
