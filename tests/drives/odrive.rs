//! ODrives: found, configured, held, led along a plan; and each of their faults with its number and within its time.

use firmware::fault::Cause;
use firmware::group::DriveGroup;
use firmware::groups::odrive::{Home, Mismatch, Parameter};
use firmware::orders::Order as Wish;
use firmware::state::StateKind;
use hil_sim::drive::odrive::OdriveOptions;
use protocol::odrive::{AxisState, ControlMode, InputMode, Order, Report, Request, Version};
use protocol::{Duration, Frame, Instant, Node as _};

use crate::odrive_rig::{GEAR, PERIOD_US, Rig, TIME_OUT_US, axis, endpoints, node, settings};
use crate::rig::joint;
use crate::six::{JOINTS, stands_rad};

const PERIOD: Duration = Duration::from_micros(PERIOD_US);
/// Longest search: four waits for a heartbeat, the proof of 50 ms, rest.
const FIND_MS: u64 = 1_500;
/// Heartbeats come so often.
const BEAT_PERIODS: u64 = 100_000 / PERIOD_US + 2;

/// Healthy axes stand where they stopped, with torque.
fn others_are_held(rig: &mut Rig, lost: usize) {
    let before = rig.shafts();
    rig.run_us(500_000);
    let after = rig.shafts();
    for i in (0..JOINTS).filter(|i| *i != lost) {
        assert_eq!(rig.drive(i, |axis, _| axis.state()), AxisState::ClosedLoop, "joint {i}");
        assert!((after[i] - before[i]).abs() < 1e-3, "joint {i}: {} {}", before[i], after[i]);
    }
}

#[test]
fn axes_of_both_versions_and_both_shafts_are_found_without_a_motion() {
    for (version, home) in [
        (Version::V05, Home::Motor),
        (Version::V06, Home::Motor),
        (Version::V05, Home::Joint),
        (Version::V06, Home::Joint),
    ] {
        for requests_feed in [false, true] {
            let change = |_: usize, options: &mut OdriveOptions| options.requests_feed = requests_feed;
            let mut rig = Rig::with(&settings(), version, home, None, change);
            rig.run_to(FIND_MS, StateKind::Idle);
            for i in 0..JOINTS {
                assert_eq!(rig.drive(i, |axis, _| axis.state()), AxisState::ClosedLoop);
                let orders = rig.orders(i, Instant::ZERO);
                let last = |wanted: Order| orders.iter().rposition(|(_, order)| *order == wanted).unwrap();
                let mode = last(Order::Mode(ControlMode::Position, InputMode::Direct));
                let closed = last(Order::State(AxisState::ClosedLoop));
                let input =
                    orders.iter().position(|(_, order)| matches!(order, Order::Position { .. })).unwrap();
                assert!(mode < input && input < closed, "{version:?}: {mode} {input} {closed}");
            }
            let moved = rig.track.iter().flat_map(|(_, q)| (0..JOINTS).map(|i| (q[i] - stands_rad(i)).abs()));
            assert!(moved.fold(0.0, f64::max) < 1e-4, "{version:?} {home:?}");
        }
    }
}

#[test]
fn parameters_with_numbers_are_written_and_read_back_and_others_are_refused() {
    // As shipped: estimates come every 10 ms, the watchdog is off.
    let shipped = |_: usize, options: &mut OdriveOptions| {
        (options.estimates, options.watchdog) = (Some(Duration::from_millis(10)), None);
    };
    let new = |fixed: Option<usize>| {
        let mut rig = Rig::with(&settings(), Version::V06, Home::Joint, Some(endpoints()), shipped);
        if let Some(i) = fixed {
            rig.drive(i, |axis, _| axis.faults_mut().parameters_are_fixed = true);
        }
        rig
    };
    let mut rig = new(None);
    rig.run_to(FIND_MS, StateKind::Idle);
    let options = rig.drive(2, |axis, _| *axis.options());
    assert_eq!(options.estimates, None);
    assert_eq!(options.watchdog, Some(Duration::from_micros(TIME_OUT_US.into())));
    let mut rig = new(Some(4));
    rig.refused(Cause::DriveSettingsDiffer, 4);
    let (at, mismatch) = *rig.controller().group().mismatch().unwrap();
    let ten = 10_u32.to_le_bytes();
    let found =
        Mismatch::Parameter { parameter: Parameter::EstimatesPeriod, found: Some(ten), expected: [0; 4] };
    assert_eq!((at, mismatch), (joint(4), found));
    let said = "axis0.config.can.encoder_msg_rate_ms holds 0xa, the settings need 0x0";
    assert_eq!(mismatch.to_string(), said);
    // Numbers of another firmware are not used.
    let mut other = endpoints();
    other.firmware = [0, 6, 9];
    let mut rig = Rig::with(&settings(), Version::V06, Home::Joint, Some(other), |_, _| {});
    rig.refused(Cause::DriveSettingsDiffer, 0);
    let is_sdo = |(_, order): &(Instant, Order)| matches!(order, Order::Sdo(_));
    assert!(!(0..JOINTS).any(|i| rig.orders(i, Instant::ZERO).iter().any(is_sdo)));
}

#[test]
fn another_version_unasked_estimates_and_a_speed_beyond_the_field_are_refused_before_torque() {
    type Case = (Rig, usize, fn(&Mismatch) -> bool);
    let is = |i: usize, change: fn(&mut OdriveOptions)| {
        move |own: usize, options: &mut OdriveOptions| {
            if own == i {
                change(options);
            }
        }
    };
    let cases: [Case; 3] = [
        (
            Rig::with(&settings(), Version::V06, Home::Joint, None, is(1, |o| o.version = Version::V05)),
            1,
            |mismatch| matches!(mismatch, Mismatch::Firmware { found: None, expected: Version::V06 }),
        ),
        (
            Rig::with(&settings(), Version::V05, Home::Joint, None, is(2, |o| o.version = Version::V06)),
            2,
            |mismatch| matches!(mismatch, Mismatch::Firmware { found: Some([0, 6, 10]), .. }),
        ),
        (
            Rig::with(
                &settings(),
                Version::V06,
                Home::Joint,
                None,
                is(3, |o| o.estimates = Some(Duration::from_millis(10))),
            ),
            3,
            |mismatch| *mismatch == Mismatch::UnaskedEstimates,
        ),
    ];
    for (mut rig, i, is_meant) in cases {
        rig.refused(Cause::DriveSettingsDiffer, i);
        let (at, mismatch) = *rig.controller().group().mismatch().unwrap();
        assert!(at == joint(i) && is_meant(&mismatch), "{mismatch}");
        assert_eq!(rig.drive(i, |axis, _| axis.state()), AxisState::Idle);
    }
    // 10 rad/s are 12.7 turns/s behind a gear of 8, and 38.2 behind one of 24.
    let mut fast = settings();
    fast.joint.at_mut(joint(5)).v_max_rad_s = 10.0;
    fast.gains_certificate_crc32 = firmware::registers::certificate_crc32(&fast);
    let mut axes = core::array::from_fn(|i| axis(i, Version::V06, Home::Motor));
    let mut rig = Rig::of_axes(&fast, axes, None, |_, _| {});
    rig.run_to(FIND_MS, StateKind::Idle);
    axes[5].gear = 24.0;
    let mut rig = Rig::of_axes(&fast, axes, None, |_, _| {});
    rig.refused(Cause::DriveSettingsDiffer, 5);
    let (_, mismatch) = *rig.controller().group().mismatch().unwrap();
    assert!(mismatch.to_string().contains("38.2 turns/s"), "{mismatch}");
}

#[test]
fn a_silent_axis_a_watchdog_that_is_off_and_one_that_was_left_on_are_refused() {
    let mut rig = Rig::new();
    rig.drive(5, |axis, _| axis.faults_mut().is_silent = true);
    rig.refused(Cause::DriveMissing, 5);
    rig.drive(5, |axis, _| axis.faults_mut().is_silent = false);
    rig.clear();
    rig.run_to(FIND_MS, StateKind::Idle);
    let off = |i: usize, options: &mut OdriveOptions| {
        if i == 1 {
            options.watchdog = None;
        }
    };
    let mut rig = Rig::with(&settings(), Version::V06, Home::Joint, None, off);
    rig.refused(Cause::WatchdogUnproven, 1);
    // Another program has left it on; with its watchdog it starves.
    for (is_dead, kind) in [(true, StateKind::Fault), (false, StateKind::Idle)] {
        let mut rig = Rig::new();
        rig.drive(2, |axis, now| {
            axis.faults_mut().watchdog_is_dead = is_dead;
            let (frame, _) = Order::State(AxisState::ClosedLoop).encode(node(2), Version::V06).unwrap();
            axis.handle_frame(now, &frame);
        });
        rig.run_to(FIND_MS, kind);
        if is_dead {
            assert_eq!(rig.fault().unwrap().cause, Cause::WatchdogUnproven);
        }
    }
    // One that starts is waited for.
    let mut rig = Rig::new();
    rig.drive(3, |axis, _| axis.fail(0x1));
    rig.run_us(600_000);
    assert_eq!(rig.kind(), StateKind::Boot);
    rig.drive(3, |axis, now| axis.set_power(now, true));
    rig.run_to(FIND_MS, StateKind::Idle);
    // An axis in another error from before.
    let mut rig = Rig::new();
    rig.drive(4, |axis, _| axis.fail(0x4000));
    rig.refused(Cause::DrivePowerFault, 4);
    rig.clear();
    rig.run_to(FIND_MS, StateKind::Idle);
}

#[test]
fn six_joints_follow_a_plan_at_3_ms_and_the_bus_is_not_full() {
    for home in [Home::Joint, Home::Motor] {
        let mut rig = Rig::with(&settings(), Version::V06, home, None, |_, _| {}).made_ready(FIND_MS);
        let start = rig.start();
        let from = rig.now();
        rig.run_us(1_000_000);
        let load = rig.load(from);
        rig.run_to(1_500, StateKind::Ready);
        let away = rig.away_rad(start);
        println!("away {away:?} rad, load {load}");
        assert!(away.iter().all(|away| (1e-5..4e-3).contains(away)), "{away:?}");
        assert_eq!(rig.controller().counters().cycles_late, 0);
        assert_eq!(rig.controller().counters().replies_missed, 0);
        assert!((0.5..0.75).contains(&load), "{load}");
    }
}

#[test]
fn a_silent_axis_stops_all_within_three_periods_and_gets_the_order_to_stop() {
    let mut rig = Rig::moving();
    let cut = rig.now();
    rig.drive(2, |axis, _| axis.faults_mut().is_silent = true);
    rig.ends_with(cut, 4, Cause::DriveSilent, 2);
    assert!(rig.orders(2, cut).iter().any(|(_, order)| *order == Order::Estop));
    for i in (0..JOINTS).filter(|i| *i != 2) {
        // From the next set point on each joint is slower than before.
        let points = rig.orders(i, cut + PERIOD * 4).into_iter();
        let speeds: Vec<f32> = points
            .filter_map(
                |(_, order)| if let Order::Position { rev_s, .. } = order { Some(rev_s.abs()) } else { None },
            )
            .collect();
        assert!(speeds[0] > 0.05 && speeds.windows(2).all(|pair| pair[1] <= pair[0] + 2e-3), "joint {i}");
        assert_eq!(speeds.last(), Some(&0.0));
    }
    others_are_held(&mut rig, 2);
}

#[test]
fn an_error_and_a_fall_to_idle_without_an_error_end_the_motion_and_a_person_clears_them() {
    for (error, cause) in [
        (0, Cause::DriveError),
        (0x200, Cause::DriveSupply),
        (0x1000, Cause::OverCurrent),
        (0x2000, Cause::DrivePowerFault),
        (0x200_0000, Cause::DriveError),
    ] {
        let mut rig = Rig::moving();
        // Joint 5 moves slowest: its heartbeat comes before it is too far away.
        let since = rig.now();
        rig.drive(5, |axis, _| if error == 0 { axis.fall_idle() } else { axis.fail(error) });
        rig.ends_with(since, BEAT_PERIODS, cause, 5);
        others_are_held(&mut rig, 5);
        rig.clear();
        rig.run_to(FIND_MS, StateKind::Idle);
        others_are_held(&mut rig, JOINTS);
    }
}

#[test]
fn one_torn_position_is_left_out_two_in_a_row_stale_ones_and_no_numbers_stop_the_group() {
    let mut rig = Rig::moving();
    rig.drive(0, |axis, _| axis.faults_mut().torn_estimates = 1);
    rig.run_us(100_000);
    assert_eq!(rig.kind(), StateKind::Running);
    type Fault = fn(&mut hil_sim::drive::odrive::OdriveFaults);
    let cases: [(Fault, u64, Cause); 3] = [
        (|faults| faults.torn_estimates = 2, 4, Cause::ReplyImplausible),
        (|faults| faults.estimates_are_nan = true, 4, Cause::ReplyImplausible),
        (|faults| faults.estimates_are_stale = true, 8, Cause::PositionFrozen),
    ];
    for (fault, periods, cause) in cases {
        let mut rig = Rig::moving();
        let since = rig.now();
        rig.drive(4, |axis, _| fault(axis.faults_mut()));
        rig.ends_with(since, periods, cause, 4);
    }
}

#[test]
fn estimates_that_nobody_waits_for_change_nothing_and_lost_ones_are_bridged() {
    let mut rig = Rig::moving();
    let estimates =
        |i: usize| -> Frame { Report::Estimates { rev: 3.0, rev_s: 9.0 }.encode(node(i), Version::V06) };
    for _ in 0..20 {
        // All answers of the period have come; and again before the next request can have been answered.
        let first = Request::Estimates.encode(node(0));
        let burst = rig.frames(Instant::ZERO, |frame| *frame == first).last().unwrap().0;
        for us in [PERIOD_US - 300, PERIOD_US + 90] {
            let at = burst + Duration::from_micros(us);
            rig.run_us(at.saturating_since(rig.now()).as_micros());
            (0..JOINTS).for_each(|i| rig.forge(&estimates(i)));
        }
    }
    rig.run_us(700_000);
    rig.run_to(1_500, StateKind::Ready);
    let mut rig = Rig::ready();
    rig.drive(3, |axis, _| axis.faults_mut().answer_lost_every = 7);
    rig.start();
    rig.run_us(1_000_000);
    rig.run_to(1_500, StateKind::Ready);
    assert!(rig.controller().counters().replies_missed > 30);
}

#[test]
fn a_stop_holds_the_arm_and_the_next_motion_begins_from_there() {
    for along_the_path in [true, false] {
        let mut rig = Rig::moving();
        if along_the_path {
            rig.order(Wish::Stop);
        } else {
            rig.stop_now();
        }
        rig.run_to(1_500, StateKind::Stopped);
        others_are_held(&mut rig, JOINTS);
        let before = rig.shafts();
        rig.order(Wish::Jog { joint: joint(0), qd_rad_s: -0.2, hold: Duration::from_millis(200) });
        rig.run_to(1_000, StateKind::Ready);
        let after = rig.shafts();
        assert!((before[0] - after[0] - 0.04).abs() < 2e-3, "{} {}", before[0], after[0]);
        assert!((1..JOINTS).all(|i| (after[i] - before[i]).abs() < 1e-4));
    }
}

#[test]
fn a_joint_that_is_counted_at_its_motor_takes_the_nearest_whole_turn_as_its_zero() {
    let mut rig = Rig::with(&settings(), Version::V05, Home::Motor, None, |_, _| {});
    rig.run_to(FIND_MS, StateKind::Idle);
    // Two turns of the motor away, as it may be after a start elsewhere.
    let mut away = rig.drive(3, |axis, _| axis.rev());
    rig.drive(3, |axis, now| {
        let (frame, _) = Order::CountHere(8192 * 2).encode(node(3), Version::V05).unwrap();
        axis.handle_frame(now, &frame);
        away = axis.rev() - away;
    });
    rig.run_us(20_000);
    // Positions that leap so far are a fault; it is found again where it counts now.
    rig.run_until(2_000, |rig| rig.kind() == StateKind::Fault);
    rig.clear();
    rig.run_to(FIND_MS, StateKind::Idle);
    rig.order(Wish::Home { mask: 0x3F });
    rig.run_to(3_000, StateKind::Ready);
    let q_rad = rig.controller().group().position(joint(3)).unwrap().q_rad;
    let turn_rad = std::f64::consts::TAU / f64::from(GEAR);
    let rev = rig.drive(3, |axis, _| axis.rev());
    let expected = (rev - rev.round()) * turn_rad;
    assert!((f64::from(q_rad) - expected).abs() < 1e-3, "{q_rad} {expected}");
    let before = rig.shafts();
    rig.order(Wish::Jog { joint: joint(3), qd_rad_s: 0.2, hold: Duration::from_millis(200) });
    rig.run_to(1_000, StateKind::Ready);
    assert!((rig.shafts()[3] - before[3] - 0.04).abs() < 2e-3);
}
