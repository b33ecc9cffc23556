//! Arming and starting at the edges of their times.

use crate::bench::*;
use firmware::fault::{Cause, Refusal};
use firmware::orders::{Done, Order};
use firmware::state::StateKind;
use firmware::store::FileName;
use protocol::powercube::{AddressedRequest, Parameter, Request};
use protocol::{Duration, Frame};

fn uploaded() -> (Bench, FileName) {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let name = bench.upload(&throw_file(3_000, true));
    (bench, name)
}

fn armed() -> (Bench, FileName) {
    let (mut bench, name) = uploaded();
    bench.arm(name);
    (bench, name)
}

fn run_in(bench: &mut Bench, name: FileName, us: u64) -> Result<Done, Cause> {
    let start = bench.instant() + Duration::from_micros(us);
    bench.order(Order::RunAt { name, start }).map_err(|refusal| refusal.cause)
}

fn start_left(bench: &mut Bench) -> Option<Duration> {
    let at = bench.instant();
    bench.controller.take_sample(at).start_left
}

/// No deadline of the controller falls on these times.
#[test]
fn offer_holds_until_just_before_its_end() {
    const VALID_US: u64 = 1_003_217;
    for (after_us, outcome) in [(VALID_US - 1, Ok(Done::Taken)), (VALID_US, Err(Cause::TokenWrong))] {
        let (mut bench, name) = uploaded();
        let valid = Duration::from_micros(VALID_US);
        let Ok(Done::Offer { token, .. }) = bench.order(Order::ArmPrepare { crc64: name.crc64, valid })
        else {
            panic!("no offer")
        };
        bench.run_for(after_us);
        let confirmed = bench.order(Order::ArmConfirm { token, valid }).map_err(|refusal| refusal.cause);
        assert_eq!(confirmed, outcome, "after {after_us} us");
    }
}

#[test]
fn start_may_be_thirty_seconds_ahead_and_no_more() {
    let (mut bench, name) = armed();
    assert_eq!(run_in(&mut bench, name, 30_000_001), Err(Cause::StartTooFar));
    assert_eq!(run_in(&mut bench, name, 30_000_000), Ok(Done::Taken));
}

/// The drives get their speed limits before the run: its first cycle has no time for it.
#[test]
fn speed_limits_are_written_once_to_each_drive_while_armed_and_not_while_ready() {
    let is_limit = |frame: &Frame| {
        AddressedRequest::decode(frame)
            .is_ok_and(|decoded| matches!(decoded.request, Request::Set(Parameter::TargetVel, _)))
    };
    let (mut bench, name) = uploaded();
    bench.run_for(500_000);
    assert_eq!((bench.kind(), bench.count_sent(is_limit)), (StateKind::Ready, 0));
    bench.arm(name);
    bench.run_for(500_000);
    assert_eq!((bench.kind(), bench.count_sent(is_limit)), (StateKind::Armed, 6));
}

/// Two cycles of lead and two monitor periods before the plan begins.
#[test]
fn run_begins_to_lead_the_drives_twenty_six_milliseconds_before_its_start() {
    for (in_us, state) in [(26_000, StateKind::Running), (26_001, StateKind::Armed)] {
        let (mut bench, name) = armed();
        run_in(&mut bench, name, in_us).unwrap();
        assert_eq!(bench.kind(), state, "{in_us} us ahead");
    }
}

#[test]
fn time_left_until_the_start_counts_down_while_armed_with_a_start_and_shows_nowhere_else() {
    let (mut bench, name) = armed();
    assert_eq!(start_left(&mut bench), None, "no start is ordered");
    run_in(&mut bench, name, 400_000).unwrap();
    assert_eq!(start_left(&mut bench), Some(Duration::from_micros(400_000)));
    bench.run_for(150_000);
    assert_eq!(start_left(&mut bench), Some(Duration::from_micros(250_000)));
    bench.run_until(400_000, |bench| bench.kind() == StateKind::Running);
    assert_eq!(start_left(&mut bench), None, "it runs");
}

#[test]
fn arming_takes_joints_within_the_start_tolerance_and_no_others() {
    let tolerance_rad = f64::from(Options::default().settings.joint.at(joint(3)).start_tolerance_rad);
    // Positions come in steps of the encoder, 0.35 mrad.
    for (away_rad, arms) in [(0.5e-3, false), (-0.5e-3, true)] {
        for (index, sign) in [(0, 1.0), (3, -1.0), (5, 1.0)] {
            let mut q_rad = throw_start();
            q_rad[index] += sign * (tolerance_rad + away_rad);
            let mut bench = Bench::ready(Options::default(), &q_rad);
            let name = bench.upload(&throw_file(3_000, true));
            let valid = Duration::from_secs(1);
            let Ok(Done::Offer { token, .. }) = bench.order(Order::ArmPrepare { crc64: name.crc64, valid })
            else {
                panic!("no offer")
            };
            let outcome = bench.order(Order::ArmConfirm { token, valid });
            let expected =
                if arms { Ok(Done::Taken) } else { Err(Refusal::at(Cause::NotAtStart, joint(index))) };
            assert_eq!(outcome, expected, "joint {index} {away_rad} rad beyond its tolerance");
        }
    }
}

#[test]
fn offer_to_arm_ends_with_every_stop_in_every_state() {
    type Stop = fn(&mut Bench);
    let stops: [Stop; 2] = [|bench| bench.stop_now(), |bench| _ = bench.order(Order::Stop).unwrap()];
    for stopped_before in [false, true] {
        for stop in stops {
            let (mut bench, name) = uploaded();
            if stopped_before {
                bench.stop_now();
                bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Stopped);
            }
            let valid = Duration::from_secs(10);
            let prepared = bench.order(Order::ArmPrepare { crc64: name.crc64, valid });
            let Ok(Done::Offer { token, .. }) = prepared else { panic!("{prepared:?}") };
            stop(&mut bench);
            let confirmed = bench.order(Order::ArmConfirm { token, valid }).map_err(|refusal| refusal.cause);
            assert_eq!(confirmed, Err(Cause::TokenWrong), "stopped before: {stopped_before}");
        }
    }
}
