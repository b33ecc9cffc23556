//! Supervision of a group that stands: how many answers may be missing, and the effect of a zero that is found or lost.

use crate::bench::*;
use firmware::fault::{Cause, Fault};
use firmware::state::StateKind;
use protocol::Frame;
use protocol::powercube::{AddressedRequest, CubeState};

#[test]
fn two_missed_answers_of_a_standing_drive_are_borne_and_a_third_in_a_row_is_a_fault() {
    for (drops, end) in [(1, StateKind::Ready), (2, StateKind::Ready), (3, StateKind::Fault)] {
        let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
        bench.drives[1].drop_replies = drops;
        bench.run_for(1_000_000);
        assert_eq!(bench.kind(), end, "{drops} missed in a row");
        let fault = bench.controller.state().fault();
        assert_eq!(fault, (drops == 3).then_some(Fault::at(Cause::DriveSilent, joint(1))));
    }
}

/// Another node has homed the arm, and a person moves a joint of it by hand.
#[test]
fn group_whose_joints_get_their_zeros_is_ready_once_all_of_them_stand() {
    let mut bench = Bench::new(Options { homed: false, ..Options::default() });
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Idle);
    for drive in &mut bench.drives {
        drive.state = drive.state.union(CubeState::HOME_OK).union(CubeState::BRAKEACTIVE);
    }
    bench.drives[2].slips_rad_s = 0.05;
    for _ in 0..50 {
        bench.run_for(10_000);
        assert_eq!(bench.kind(), StateKind::Idle, "joint 3 moves");
    }
    bench.drives[2].slips_rad_s = 0.0;
    bench.run_for(200_000);
    assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
}

#[test]
fn ready_group_that_loses_a_zero_is_idle_and_ready_again_when_it_comes_back() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    bench.drives[4].state = bench.drives[4].state.with(CubeState::HOME_OK, false);
    bench.run_for(60_000);
    assert_eq!(bench.kind(), StateKind::Idle);
    bench.drives[4].state = bench.drives[4].state.with(CubeState::HOME_OK, true);
    bench.run_for(60_000);
    assert_eq!(bench.kind(), StateKind::Ready);
}

#[test]
fn armed_group_that_loses_a_zero_faults_at_its_joint_and_keeps_it() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let name = bench.upload(&throw_file(3_000, true));
    bench.arm(name);
    bench.drives[4].state = bench.drives[4].state.with(CubeState::HOME_OK, false);
    bench.run_for(60_000);
    assert_eq!(bench.controller.state().fault(), Some(Fault::at(Cause::DriveLostHome, joint(4))));
    assert_eq!(bench.kind(), StateKind::Fault);
    bench.run_for(500_000);
    assert_eq!(bench.count_sent(is_motion), 0);
}

/// Requests to the drives in 200 ms.
fn requests(bench: &mut Bench) -> usize {
    let is_request = |frame: &Frame| AddressedRequest::decode(frame).is_ok();
    let before = bench.count_sent(is_request);
    bench.run_for(200_000);
    bench.count_sent(is_request) - before
}

/// A halt that is repeated changes neither: a group in Fault is read every 10 ms, a group that stops in each control cycle.
#[test]
fn repeated_halts_leave_the_looks_at_the_drives_as_they_were() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    bench.drives[3].creep_rad_s = 0.05;
    bench.drives[3].deaf_to_halts = u32::MAX;
    bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(bench.controller.state().fault(), Some(Fault::at(Cause::MovesUnordered, joint(3))));
    bench.run_for(300_000);
    let in_fault = requests(&mut bench);
    assert!((60..180).contains(&in_fault), "{in_fault} requests in 200 ms");

    let mut bench = Bench::ready(Options::default(), &throw_start());
    bench.start(&throw_file(3_000, true));
    bench.run_for(400_000);
    bench.drives[3].slips_rad_s = 0.05;
    bench.stop_now();
    bench.run_for(300_000);
    assert_eq!(bench.kind(), StateKind::Stopping);
    assert!(bench.count_sent(is_halt) >= 3, "{} halts", bench.count_sent(is_halt));
    let while_stopping = requests(&mut bench);
    assert!(while_stopping > 250, "{while_stopping} requests in 200 ms");
}
