//! Cases beyond the fault table: sequences, paths to rest, and defects found by random runs or by people.

use crate::bench::*;
use firmware::fault::{Cause, Refusal};
use firmware::groups::powercube::settings::{GRIPPER_ADDRESS, GRIPPER_LINE};
use firmware::orders::{Done, Order};
use firmware::registers::Number;
use firmware::settings::Settings;
use firmware::state::{State, StateKind};
use firmware::store::FileName;
use protocol::powercube::{AddressedRequest, Broadcast, Parameter, Request, SimpleCommand, Value};
use protocol::{Duration, Frame, ModuleId};

const PERIOD_US: u64 = 3_000;

/// Arm on the throw, `into_us` after the start of the plan.
fn thrown(into_us: u64) -> Bench {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    bench.start(&throw_file(3_000, true));
    bench.run_for(2 * PERIOD_US + into_us);
    assert_eq!(bench.kind(), StateKind::Running);
    bench
}

fn fault_of(bench: &Bench) -> Option<Cause> {
    bench.controller.state().fault().map(|fault| fault.cause)
}

fn speed_max(bench: &Bench) -> f64 {
    bench.drives.iter().map(|drive| drive.v.abs()).fold(0.0, f64::max)
}

#[test]
fn stop_order_and_lost_host_keep_the_path_to_rest_and_the_ball() {
    for (is_order, into_us) in
        [(true, 400_000), (false, 50_000), (false, 300_000), (false, 500_000), (false, 700_000)]
    {
        let mut bench = thrown(into_us);
        let end = if is_order {
            bench.order(Order::Stop).unwrap();
            StateKind::Stopped
        } else {
            bench.heartbeat = false;
            StateKind::Fault
        };
        bench.run_until(400_000, |bench| bench.kind() == StateKind::Stopping);
        assert!(speed_max(&bench) > 0.3);
        bench.run_until(1_500_000, |bench| bench.kind() == end);
        assert_eq!(bench.kind(), end);
        bench.run_for(50_000);
        let (speed, away) = (speed_max(&bench), bench.distance_from_path());
        assert!(speed < 0.02, "halted with {speed} rad/s");
        assert!(away < 3e-3, "{away} rad beside the path, {into_us} us into");
        assert!(bench.drives[5].dio == 0 || into_us > 440_000, "the ball is kept");
        assert_eq!(bench.controller.freeze_frame().is_none(), is_order, "a stop is no fault");
    }
}

/// Found by random runs: the gripper opened 0.9 ms after the halt broadcast of another node.
#[test]
fn halt_broadcast_of_another_node_ends_the_run_at_once_and_the_ball_is_kept() {
    // The gripper's output switches 0.536 s after the start of the plan.
    for before_release_us in (3_500..9_500).step_by(300) {
        let mut bench = thrown(536_000 - before_release_us);
        assert_eq!(bench.drives[5].dio, 0);
        bench.foreign(Broadcast::Halt.encode());
        // The frame waits for a gap: all others of a cycle have lower identifiers.
        bench.run_until(3_500, |bench| bench.kind() != StateKind::Running);
        assert_eq!((bench.kind(), fault_of(&bench)), (StateKind::Fault, Some(Cause::HaltedByOther)));
        bench.run_for(500_000);
        let halted = bench.sent_after(0, is_halt).expect("the controller halts too");
        assert!(bench.sent_after(halted.as_micros(), is_motion).is_none(), "no motion after the halt");
        assert_eq!(bench.drives[5].dio, 0, "the ball is kept, {before_release_us} us before its release");
        assert!(speed_max(&bench) < 0.02);
    }
}

/// `cubectl stop` sends both: when its broadcast comes, the controller may have halted the drives already.
#[test]
fn halt_broadcast_after_the_halt_of_the_controller_itself_is_no_fault() {
    for later_us in (0..120_000).step_by(1_300) {
        let mut bench = thrown(350_000);
        bench.controller.stop_now(protocol::Instant::from_micros(bench.now));
        bench.run_until(10_000, |bench| bench.kind() != StateKind::Running);
        bench.run_for(later_us);
        bench.foreign(Broadcast::Halt.encode());
        bench.run_until(1_000_000, |bench| !matches!(bench.kind(), StateKind::Stopping));
        assert_eq!(
            (bench.kind(), fault_of(&bench)),
            (StateKind::Stopped, Some(Cause::StopMessage)),
            "{later_us} us after it"
        );
    }
}

#[test]
fn silent_drive_stops_the_group_after_two_missed_replies_and_one_cycle() {
    for (silent, phase) in [(0, 0), (2, 1_000), (5, 2_500), (3, 1_700)] {
        let mut bench = thrown(350_000 + phase);
        bench.drives[silent].silent = true;
        let at = bench.now;
        bench.run_until(100_000, |bench| bench.kind() != StateKind::Running);
        let after = bench.now - at;
        println!("drive {} silent: group stops after {after} us", silent + 1);
        assert!(after <= 3 * PERIOD_US, "{after}");
        bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Fault);
        let fault = bench.controller.state().fault().unwrap();
        assert_eq!((fault.cause, fault.joint), (Cause::DriveSilent, Some(joint(silent))));
        bench.run_for(30_000);
        for (i, drive) in bench.drives.iter().enumerate().filter(|(i, _)| *i != silent) {
            assert!(drive.v.abs() < 0.02, "joint {i} at {} rad/s", drive.v);
        }
        // The silent drive got a halt of its own and the broadcast, and its watchdog is starved.
        assert!(bench.sent_after(at, is_halt).is_some());
        let module = ModuleId::new(silent as u8 + 1).unwrap();
        let own = Request::Simple(SimpleCommand::Halt).encode(module);
        let halted_at = bench.sent_after(at, |frame| *frame == own).expect("a halt of its own");
        println!("its own halt after {} us", halted_at.as_micros() - at);
        bench.run_for(200_000);
        let watchdog = Broadcast::Watchdog.encode();
        assert!(bench.sent_after(bench.now - 150_000, |frame| *frame == watchdog).is_none());
    }
}

/// Found by random throws with lost frames: the group was Ready, and a joint moved on for three radians.
#[test]
fn lost_park_command_is_repeated_until_the_joint_stands_at_its_end() {
    let mut bench = thrown(800_000);
    bench.run_until(300_000, |bench| {
        matches!(bench.controller.state(), State::Running { parking: Some(_), .. })
    });
    bench.drives[0].silent = true;
    bench.run_for(1_500);
    bench.drives[0].silent = false;
    bench.run_until(600_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready);
    assert_eq!(bench.controller.group().drive(joint(0)).counters.missed, 1);
    let (end, _) = throw_reference(0, 1.0);
    let target = bench.drives[0].target.unwrap_or(bench.drives[0].q_gen);
    assert!((target - end).abs() < 1e-3, "goes to {target} instead of {end}");
    bench.run_for(300_000);
    assert!(bench.drives[0].v.abs() < 0.01 && (bench.drives[0].q - end).abs() < 2e-3);
}

#[test]
fn nothing_moves_after_a_stop_until_armed_again_and_then_only_from_the_start_of_the_plan() {
    let mut bench = thrown(300_000);
    bench.order(Order::Stop).unwrap();
    bench.run_until(1_500_000, |bench| bench.kind() == StateKind::Stopped);
    let stopped = bench.now;
    let file = throw_file(3_000, true);
    let name = FileName { crc64: protocol::cyphal::crc::Crc64::of(&file), len: file.len() as u32 };
    assert_eq!(bench.order(Order::Run(name)).unwrap_err().cause, Cause::OrderNotNow);
    bench.run_for(100_000);
    let valid = Duration::from_secs(5);
    let Ok(Done::Offer { token, .. }) = bench.order(Order::ArmPrepare { crc64: name.crc64, valid }) else {
        panic!()
    };
    bench.run_for(250_000);
    let refused = bench.order(Order::ArmConfirm { token, valid }).unwrap_err();
    assert_eq!(refused.cause, Cause::NotAtStart);
    assert!(bench.sent_after(stopped, is_motion).is_none());
    // A person moves the arm back: this causes a fault, and the drives are searched again.
    for (drive, q) in bench.drives.iter_mut().zip(throw_start()) {
        drive.place(q);
    }
    bench.run_for(250_000);
    assert_eq!(fault_of(&bench), Some(Cause::MovesUnordered));
    bench.order(Order::ClearFault { code: Cause::MovesUnordered.code() }).unwrap();
    bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Ready);
    bench.run_for(100_000);
    bench.arm(name);
    bench.order(Order::Run(name)).unwrap();
    bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Ready);
    assert!(bench.distance_from_path() < 2e-3, "the throw was repeated");
}

#[test]
fn arming_needs_its_token_in_time_a_live_host_homed_joints_and_gains_for_the_period() {
    let valid = Duration::from_secs(1);
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let prepare = |crc64| Order::ArmPrepare { crc64, valid };
    let refused = |outcome: Result<Done, Refusal>| outcome.unwrap_err().cause;
    assert_eq!(refused(bench.order(prepare(0))), Cause::NoTrajectory);
    let name = bench.upload(&throw_file(3_000, false));
    assert_eq!(refused(bench.order(prepare(name.crc64 ^ 1))), Cause::OtherTrajectory);
    let Ok(Done::Offer { token, .. }) = bench.order(prepare(name.crc64)) else { panic!() };
    assert_eq!(refused(bench.order(Order::ArmConfirm { token: token ^ 1, valid })), Cause::TokenWrong);
    bench.run_for(1_100_000);
    assert_eq!(refused(bench.order(Order::ArmConfirm { token, valid })), Cause::TokenWrong, "expired");
    let Ok(Done::Offer { token: second, .. }) = bench.order(prepare(name.crc64)) else { panic!() };
    assert_ne!(token, second);
    // Gains change the certificate, and both void the offer.
    let write = |bench: &mut Bench, name: &str, number| {
        let now = bench.instant();
        bench.controller.write_register(now, HOST, name, &[Number::Natural32(number)]).unwrap();
    };
    let offer = |bench: &mut Bench| match bench.order(prepare(name.crc64)) {
        Ok(Done::Offer { token, .. }) => token,
        other => panic!("{other:?}"),
    };
    let certify = |bench: &mut Bench| {
        let crc32 = firmware::registers::certificate_crc32(bench.controller.settings());
        write(bench, "gains.certificate_crc32", crc32);
    };
    write(&mut bench, "gains.period_us", 17_000);
    assert_eq!(refused(bench.order(Order::ArmConfirm { token: second, valid })), Cause::TokenWrong);
    let token = offer(&mut bench);
    assert_eq!(refused(bench.order(Order::ArmConfirm { token, valid })), Cause::GainsUncertified);
    certify(&mut bench);
    let token = offer(&mut bench);
    assert_eq!(refused(bench.order(Order::ArmConfirm { token, valid })), Cause::GainPeriod);
    write(&mut bench, "gains.period_us", 3_000);
    certify(&mut bench);
    let second = offer(&mut bench);
    bench.order(Order::ArmConfirm { token: second, valid }).unwrap();
    bench.order(Order::ArmConfirm { token: second, valid }).unwrap();
    bench.run_for(1_100_000);
    assert_eq!(bench.kind(), StateKind::Ready, "arming expires");
    bench.heartbeat = false;
    bench.run_for(200_000);
    assert_eq!(refused(bench.order(prepare(name.crc64))), Cause::NoHost);
    assert_eq!(bench.count_sent(is_motion), 0);
}

#[test]
fn offers_and_armings_last_up_to_thirty_seconds_and_no_longer() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let crc64 = bench.upload(&throw_file(3_000, false)).crc64;
    let (bad, longest) = ([Duration::ZERO, Duration::from_micros(30_000_001)], Duration::from_secs(30));
    for valid in bad {
        let refused = bench.order(Order::ArmPrepare { crc64, valid }).unwrap_err();
        assert_eq!(refused.cause, Cause::BadValue, "{valid}");
    }
    let Ok(Done::Offer { token, .. }) = bench.order(Order::ArmPrepare { crc64, valid: longest }) else {
        panic!()
    };
    for valid in bad {
        let refused = bench.order(Order::ArmConfirm { token, valid }).unwrap_err();
        assert_eq!(refused.cause, Cause::BadValue, "{valid}");
    }
    bench.order(Order::ArmConfirm { token, valid: longest }).unwrap();
}

#[test]
fn homing_goes_from_the_hand_to_the_base_with_less_current_and_ends_ready() {
    let mut bench = Bench::new(Options { homed: false, ..Options::default() });
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Idle);
    bench.run_for(50_000);
    bench.order(Order::Home { mask: 0x3F }).unwrap();
    bench.order(Order::Home { mask: 0x3F }).unwrap();
    assert_eq!(bench.order(Order::Home { mask: 0x40 }).unwrap_err().cause, Cause::OrderNotNow);
    bench.run_for(100_000);
    assert_eq!(bench.drives[5].max_cur, 7.5);
    bench.run_until(10_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready);
    let order: Vec<u8> = bench
        .log
        .iter()
        .filter_map(|l| AddressedRequest::decode(&l.frame).ok())
        .filter(|request| request.request.command().code() == 0x01)
        .map(|request| request.module.get())
        .collect();
    assert_eq!(order, [6, 5, 4, 3, 2, 1]);
    assert_eq!(bench.drives[5].max_cur, 15.0);
    assert_eq!(bench.count_sent(is_motion), 0);
}

#[test]
fn homing_that_takes_too_long_halts() {
    let mut bench = Bench::new(Options { homed: false, ..Options::default() });
    bench.drives[3].home_takes_us = u64::MAX / 2;
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Idle);
    bench.run_for(50_000);
    bench.order(Order::Home { mask: 0b1000 }).unwrap();
    bench.run_until(20_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(fault_of(&bench), Some(Cause::HomingTimeout));
    bench.run_for(2_000);
    assert_eq!(bench.count_sent(is_halt), 1);
}

#[test]
fn jog_moves_while_it_is_repeated_slowly_and_stops_by_itself() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    let jog = Order::Jog { joint: joint(2), qd_rad_s: 5.0, hold: Duration::from_millis(200) };
    for _ in 0..10 {
        bench.order(jog).unwrap();
        bench.run_for(100_000);
    }
    assert_eq!(bench.kind(), StateKind::Jogging);
    let (v, q) = (bench.drives[2].v, bench.drives[2].q);
    assert!((0.2..0.27).contains(&v), "capped at the jog speed: {v}");
    bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready);
    let way = bench.drives[2].q - q;
    assert!((0.02..0.09).contains(&way), "{way} rad after the last order");
    assert_eq!(bench.drives[2].max_cur, 30.0);
    for (i, drive) in bench.drives.iter().enumerate().filter(|(i, _)| *i != 2) {
        assert_eq!(drive.q, 0.0, "joint {i}");
    }
}

#[test]
fn jog_is_refused_for_nonsense_and_stops_when_the_host_is_lost() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    let hold = Duration::from_millis(400);
    for (order, cause) in [
        (Order::Jog { joint: joint(7), qd_rad_s: 0.1, hold }, Cause::JointUnknown),
        (Order::Jog { joint: joint(1), qd_rad_s: f32::NAN, hold }, Cause::BadValue),
        (Order::Jog { joint: joint(1), qd_rad_s: 0.1, hold: Duration::from_secs(2) }, Cause::BadValue),
    ] {
        assert_eq!(bench.order(order).unwrap_err().cause, cause);
    }
    bench.order(Order::Jog { joint: joint(1), qd_rad_s: -0.2, hold }).unwrap();
    bench.run_for(100_000);
    bench.heartbeat = false;
    let at = bench.now;
    bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Fault);
    assert!(bench.now - at < 800_000);
    bench.run_for(50_000);
    assert_eq!(fault_of(&bench), Some(Cause::HostLost));
    assert!(speed_max(&bench) < 0.01);
}

#[test]
fn release_switches_the_boards_output_at_its_microsecond_with_the_opening_delay_taken_off() {
    for (settings, period) in [(Settings::powercube6(), 3_000), (Settings::powercube6_paper(), 17_000)] {
        let mut settings = settings;
        GRIPPER_ADDRESS.set(&mut settings, 0);
        settings.gripper_opening_us = 12_345;
        let mut bench = Bench::ready(Options { settings, ..Options::default() }, &throw_start());
        bench.start(&throw_file(period, true));
        let t0 = bench.now + 2 * u64::from(period);
        bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Ready);
        let release = (HA * 1e6).round() as u64;
        assert_eq!(bench.board_gripper, [(t0 + release - 12_345, true)]);
    }
}

#[test]
fn release_through_a_drives_output_is_on_the_bus_within_half_a_millisecond() {
    let mut settings = Settings::powercube6();
    GRIPPER_LINE.set(&mut settings, 1);
    settings.gripper_opening_us = 0;
    for seed in 0..5 {
        let mut bench = Bench::ready(Options { settings, seed, ..Options::default() }, &throw_start());
        bench.start(&throw_file(3_000, true));
        let wanted = bench.now + 6_000 + (HA * 1e6).round() as u64;
        bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Ready);
        let is_release = |frame: &Frame| {
            matches!(
                AddressedRequest::decode(frame),
                Ok(AddressedRequest { request: Request::Set(Parameter::DioData, Value::U32(0x20)), .. })
            )
        };
        let at = bench.sent_after(0, is_release).unwrap().as_micros();
        assert!((wanted..wanted + 900).contains(&at), "{} us late", at - wanted);
        assert_eq!(bench.drives[5].dio, 0x20);
    }
}

#[test]
fn trajectory_cannot_be_changed_once_armed() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let file = throw_file(3_000, false);
    let name = bench.upload(&file);
    bench.arm(name);
    let now = bench.instant();
    assert_eq!(bench.controller.upload(now, HOST, 0, &file[..10]).unwrap_err().cause, Cause::BankBusy);
    assert_eq!(bench.order(Order::Commit(name)).unwrap_err().cause, Cause::OrderNotNow);
}

/// Found by random orders of other nodes: an order to run that came while the drives were being read made the first
/// cycles late, three in a row.
#[test]
fn run_ordered_in_the_middle_of_a_look_at_the_drives_comes_to_its_end() {
    for offset_us in (0..30_000).step_by(130) {
        let mut bench = Bench::ready(Options::default(), &throw_start());
        bench.run_for(offset_us);
        bench.start(&throw_file(3_000, true));
        bench.run_until(3_000_000, |bench| bench.kind() != StateKind::Running);
        assert_eq!(bench.kind(), StateKind::Ready, "{offset_us} us: {:?}", bench.controller.state());
    }
}

/// Found in a review of the controller: the control step that noticed the late cycles still planned set points, and
/// they replaced the ramps to rest.
#[test]
fn stop_for_late_cycles_sends_ramps_to_rest_and_no_further_set_points() {
    let settings = Settings { cycle_late_max: 3, reply_missed_max: 10, ..Settings::powercube6() };
    let mut bench = Bench::ready(Options { settings, ..Options::default() }, &throw_start());
    bench.start(&throw_file(3_000, true));
    bench.run_for(2 * PERIOD_US + 430_000);
    assert_eq!(bench.kind(), StateKind::Running);
    // The runner sleeps past the beginning of three cycles, once the drives have answered.
    for _ in 0..3 {
        bench.run_until(10_000, |bench| !bench.controller.needs_wire());
        bench.now += 5_000;
        bench.run_until(100, |bench| bench.kind() != StateKind::Running);
    }
    assert_eq!(fault_of(&bench), Some(Cause::CycleOverrun));
    let at = bench.now;
    let q: Vec<f64> = bench.drives.iter().map(|drive| drive.q_gen).collect();
    let v: Vec<f64> = bench.drives.iter().map(|drive| drive.v_gen).collect();
    bench.run_for(20_000);
    for logged in bench.log.iter().filter(|l| l.by_controller && l.at.as_micros() > at) {
        let Ok(AddressedRequest { module, request: Request::Move(motion), .. }) =
            AddressedRequest::decode(&logged.frame)
        else {
            continue;
        };
        let protocol::powercube::MotionCommand::Ramp { target } = motion.command() else { panic!("a ramp") };
        let index = settings.joint_of(module).unwrap();
        let way = f64::from(settings.joint.at(index).to_joint_rad(target.get())) - q[index.get()];
        let braking = v[index.get()].powi(2) / (2.0 * f64::from(settings.joint.at(index).a_max_rad_s2));
        assert!(
            way.abs() < braking + 0.06,
            "joint {index} is sent {way} rad ahead, it needs {braking} rad to stop"
        );
    }
}

/// Found in a review of the controller: the first missed answer of a call ordered the stop, and the next ones
/// removed the ramps of their joints again.
#[test]
fn joints_whose_answers_are_missed_at_the_same_moment_all_get_their_ramp_to_rest() {
    for phase in [0, 700, 1_400, 2_100] {
        let mut bench = thrown(430_000 + phase);
        let first = (phase as usize / 700) % 3;
        bench.drives[first].drop_replies = 2;
        bench.run_until(10_000, |bench| bench.controller.group().drive(joint(first)).missed_in_row == 1);
        // In the next cycle all others miss one answer with it.
        bench.run_until(10_000, |bench| !bench.controller.needs_wire());
        for drive in bench.drives.iter_mut().filter(|drive| drive.drop_replies == 0) {
            drive.drop_replies = 1;
        }
        bench.run_until(30_000, |bench| bench.kind() != StateKind::Running);
        assert_eq!(bench.kind(), StateKind::Stopping, "{:?}", bench.controller.state());
        assert_eq!(fault_of(&bench), Some(Cause::DriveSilent));
        let v: Vec<f64> = bench.drives.iter().map(|drive| drive.v_gen).collect();
        // A read comes before each barred key: 15 ms at most until the ramp is in the drive.
        bench.run_for(60_000);
        // The first drive is halted too: it does not answer.
        for (i, drive) in bench.drives.iter().enumerate().filter(|(i, _)| *i != first) {
            let a = f64::from(bench.controller.settings().joint.at(joint(i)).a_max_rad_s2);
            let left = (v[i].abs() - 0.045 * a).max(0.0);
            assert!(drive.v_gen.abs() < left + 0.05, "joint {i} at {} rad/s, was {}", drive.v_gen, v[i]);
        }
    }
}

/// Frames of a host fill the gaps of a cycle one by one. In each of these cycles the last answer may wait for one of them.
#[test]
fn transfer_of_a_host_makes_cycles_late_and_stops_nothing() {
    let frame = Frame::new(protocol::ExtendedId::new(0x1063_EA2A).unwrap(), &[0x55; 8]).unwrap();
    let (mut longest, mut late) = (0, 0);
    for into_us in (10_000..880_000).step_by(9_700) {
        let mut bench = thrown(into_us);
        for _ in 0..8 {
            bench.foreign(frame);
        }
        bench.run_until(1_500_000, |bench| bench.kind() != StateKind::Running);
        assert_eq!(bench.kind(), StateKind::Ready, "{into_us} us: {:?}", bench.controller.state());
        let lates: Vec<u64> = bench
            .controller
            .core()
            .trace()
            .iter()
            .filter_map(|(at, event)| {
                matches!(event, firmware::trace::TraceEvent::LateCycle).then_some(at.as_micros())
            })
            .collect();
        late += lates.len();
        let mut row = 1;
        for pair in lates.windows(2) {
            row = if pair[1] - pair[0] < 2 * PERIOD_US { row + 1 } else { 1 };
            longest = longest.max(row);
        }
    }
    println!("{late} late cycles, at most {longest} in a row");
    assert!(late > 10, "{late}");
    assert!((2..=3).contains(&longest), "{longest}");
}
