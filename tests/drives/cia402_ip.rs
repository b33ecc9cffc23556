//! Modules that interpolate (mode 7), as SCHUNK's: found while they look for their commutation, led along a plan, and stopped by each fault
//! of their own.

use firmware::fault::Cause;
use firmware::orders::Order;
use firmware::state::StateKind;
use hil_sim::drive::cia402::{Interpolating, ServoOptions};
use hil_sim::fault::{IdFilter, WireFault};
use protocol::canopen::cia402::State;
use protocol::canopen::{Function, Object, nmt};
use protocol::{Duration, Id, Instant, StandardId};

use crate::cia402::others_are_held;
use crate::cia402_rig::{PERIOD_US, Rig, node, settings};
use crate::rig::joint;
use crate::six::{JOINTS, stands_rad};

/// Search with a commutation of 5 s, twice the exchanges of a servo at most.
const FIND_MS: u64 = 7_000;

/// Objects that SCHUNK's DCF of 2013 does not name.
const ABSENT: [(u16, u8); 10] = [
    (0x1029, 1),
    (0x6007, 0),
    (0x603F, 0),
    (0x605A, 0),
    (0x605E, 0),
    (0x6066, 0),
    (0x6076, 0),
    (0x6085, 0),
    (0x608F, 1),
    (0x6091, 1),
];

fn module(options: &mut ServoOptions, change: impl Fn(&mut Interpolating)) {
    options.interpolating.iter_mut().for_each(change);
}

/// The commutation is found at once.
pub(crate) fn short(_: usize, options: &mut ServoOptions) {
    module(options, |own| own.commutation = Duration::from_millis(50));
}

#[test]
fn modules_are_found_after_the_search_for_their_commutation_and_interpolate_at_rest() {
    let mut rig = Rig::interpolating(|_, _| {});
    rig.run_us(5_000_000);
    assert_eq!(rig.drive(0, |servo, _| servo.state()), State::SwitchedOn, "it looks for its commutation");
    rig.run_to(FIND_MS, StateKind::Idle);
    for i in 0..JOINTS {
        assert_eq!(rig.drive(i, |servo, _| servo.state()), State::OperationEnabled);
        let mut object = |index, sub| rig.drive(i, |servo, _| servo.object(index, sub)).unwrap();
        assert_eq!(object(0x6061, 0), [7]);
        assert_eq!(object(0x60C0, 0), [0, 0]);
        assert_eq!([object(0x60C2, 1), object(0x60C2, 2)], [vec![2], vec![(-3_i8) as u8]]);
        assert_eq!(object(0x1600, 2), 0x60C1_0120_u32.to_le_bytes());
        assert_eq!(object(0x2050, 0), [3, 0]);
        assert_ne!(object(0x6041, 0)[1] & 1 << 4, 0, "it interpolates");
        assert!(ABSENT.iter().all(|(index, sub)| rig.drive(i, |s, _| s.object(*index, *sub)).is_none()));
        // Without a heartbeat of the controller the node gives no process data, until it is started again.
        let starts = rig.frames(Instant::ZERO, |frame| *frame == nmt::Command::Start.encode(Some(node(i))));
        let [_, again] = starts[..] else { panic!("{starts:?}") };
        let answers = rig.frames_of(Function::Tpdo(1, node(i)), Instant::ZERO);
        let last = answers.iter().map(|(at, _)| *at).filter(|at| *at < again.0).max().unwrap();
        let gap_us = again.0.saturating_since(last).as_micros();
        assert!((PERIOD_US..20 * PERIOD_US).contains(&gap_us), "{gap_us}");
        // Bit 4 comes with torque only; each position is that of the shaft.
        let words = rig.frames_of(Function::Rpdo(1, node(i)), Instant::ZERO);
        let words: Vec<_> =
            words.iter().map(|(_, frame)| *frame.data().first_chunk::<6>().unwrap()).collect();
        assert_eq!(words.last().unwrap()[0], 0x1F);
        for [control, _, counts @ ..] in words {
            assert!(matches!(control, 0x00 | 0x06 | 0x07 | 0x0F | 0x1F | 0x80), "{control:x}");
            let q_rad = f64::from(i32::from_le_bytes(counts)) * std::f64::consts::TAU / 360_000.0;
            assert!((q_rad - stands_rad(i)).abs() < 1e-4, "{q_rad}");
        }
    }
    let moved = rig.track.iter().flat_map(|(_, q)| (0..JOINTS).map(|i| (q[i] - stands_rad(i)).abs()));
    assert!(moved.fold(0.0, f64::max) < 1e-4);
}

#[test]
fn six_modules_follow_a_plan_as_servos_of_mode_8_do() {
    let mut rig = Rig::interpolating(short).made_ready(2_000);
    let start = rig.start();
    rig.run_us(1_000_000);
    rig.run_to(1_500, StateKind::Ready);
    let worst = rig.away_rad(start);
    println!("away {worst:?} rad");
    assert!(worst.iter().all(|away| (1e-5..3e-3).contains(away)), "{worst:?}");
    assert_eq!(rig.controller().counters().cycles_late, 0);
    assert_eq!(rig.controller().counters().replies_missed, 0);
}

#[test]
fn an_interpolation_that_ends_by_itself_stops_the_group_and_comes_back_when_a_person_clears_it() {
    let mut rig = Rig::interpolating(short).made_ready(2_000).moved_on();
    let since = rig.now();
    rig.drive(2, |servo, _| servo.faults_mut().interpolation_is_off = true);
    rig.ends_with(since, 2, Cause::DriveError, 2);
    others_are_held(&mut rig, 2);
    // It has torque, and does not interpolate: not found again.
    rig.clear();
    rig.run_us(1_000);
    rig.run_until(20_000, |rig| rig.kind() == StateKind::Fault);
    assert_eq!(rig.fault().unwrap().cause, Cause::DriveError);
    rig.drive(2, |servo, _| servo.faults_mut().interpolation_is_off = false);
    rig.clear();
    rig.run_to(FIND_MS, StateKind::Idle);
    others_are_held(&mut rig, JOINTS);
}

#[test]
fn a_commutation_that_is_not_found_a_queue_of_positions_and_a_servo_without_mode_7_are_refused() {
    let mut rig = Rig::interpolating(|i, options| {
        short(i, options);
        if i == 4 {
            module(options, |own| own.commutation = Duration::from_millis(60_000));
        }
    });
    rig.run_until(15_000, |rig| rig.kind() == StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::DriveError, Some(joint(4))));
    assert!((8_000_000..10_000_000).contains(&rig.now().as_micros()), "{:?}", rig.now());
    type Change = fn(&mut ServoOptions);
    let cases: [(Change, Object); 2] = [
        (|options| options.modes = ServoOptions::MODES, Object::new(0x6502, 0)),
        (|options| module(options, |own| own.queue = 8), Object::new(0x60C4, 2)),
    ];
    for (change, object) in cases {
        let mut rig = Rig::interpolating(|i, options| {
            if i == 1 {
                change(options);
            }
        });
        rig.refused(Cause::DriveSettingsDiffer, 1);
        let (_, mismatch) = *rig.controller().group().mismatch().unwrap();
        assert_eq!(mismatch.object, object, "{mismatch}");
    }
}

#[test]
fn a_module_that_keeps_its_torque_without_a_heartbeat_is_refused_however_its_node_behaves() {
    let mut rig = Rig::interpolating(short);
    rig.drive(1, |servo, _| servo.faults_mut().supervision_is_dead = true);
    rig.refused(Cause::WatchdogUnproven, 1);
    // Its node goes pre-operational, its drive goes on.
    let reacts = |on_lost_link| {
        Rig::interpolating(move |i, options| {
            short(i, options);
            module(options, |own| own.on_lost_link = if i == 3 { on_lost_link } else { 1 });
        })
    };
    reacts(0).refused(Cause::WatchdogUnproven, 3);
    // Off, and a quick stop that ends without torque.
    for on_lost_link in [2, 3] {
        let mut rig = reacts(on_lost_link);
        rig.run_to(FIND_MS, StateKind::Idle);
        others_are_held(&mut rig, JOINTS);
    }
}

#[test]
fn modules_that_miss_the_heartbeat_in_a_motion_stop_the_arm_and_work_again_when_a_person_clears_it() {
    let exactly = |id| IdFilter { id: Id::Standard(StandardId::new(id).unwrap()), mask: 0x7FF };
    let lost = Duration::from_millis(60);
    // Without their emergencies, missing process data show it.
    for (emergencies_are_lost, cause) in [(false, Cause::DriveWatchdog), (true, Cause::DriveSilent)] {
        let mut rig = Rig::interpolating(short).made_ready(2_000).moved_on();
        let since = rig.now();
        rig.wire(WireFault::Drop, exactly(0x77F), lost, None);
        for i in (0..JOINTS).filter(|_| emergencies_are_lost) {
            rig.wire(WireFault::Drop, exactly(Function::Emergency(node(i)).id()), lost, None);
        }
        // 30 ms after the last heartbeat, and what is missing is noticed.
        rig.ends_with(since, 15 + 4, cause, 0);
        let before = rig.shafts();
        rig.run_us(300_000);
        let after = rig.shafts();
        // A shaft of the bench has no brake: it keeps the speed that is left, at most 0.01 rad/s.
        assert!((0..JOINTS).all(|i| (after[i] - before[i]).abs() < 3e-3), "{before:?} {after:?}");
        for i in 0..JOINTS {
            assert_eq!(rig.drive(i, |servo, _| servo.state()), State::Fault);
            // The group has given them up.
            assert_eq!(rig.drive(i, |servo, _| servo.network()), nmt::State::Stopped);
        }
        rig.clear();
        rig.run_to(FIND_MS, StateKind::Idle);
        others_are_held(&mut rig, JOINTS);
        rig.order(Order::Home { mask: 0x3F });
        rig.run_to(1_500, StateKind::Ready);
        let before = rig.shafts();
        rig.order(Order::Jog { joint: joint(0), qd_rad_s: -0.2, hold: Duration::from_millis(200) });
        rig.run_to(1_000, StateKind::Ready);
        assert!((before[0] - rig.shafts()[0] - 0.04).abs() < 2e-3);
    }
}

#[test]
fn a_module_makes_up_for_lost_set_points_within_its_limit_of_speed() {
    let exactly = |id| IdFilter { id: Id::Standard(StandardId::new(id).unwrap()), mask: 0x7FF };
    // The plan is at 1.5 rad/s.
    let v_max_rad_s = 1.6;
    let mut settings = settings();
    settings.joint.at_mut(joint(2)).v_max_rad_s = v_max_rad_s as f32;
    settings.gains_certificate_crc32 = firmware::registers::certificate_crc32(&settings);
    let mut rig = Rig::interpolating_with(&settings, short).made_ready(2_000);
    let start = rig.start();
    rig.run_us(500_000);
    let since = rig.now();
    for function in [Function::Rpdo(1, node(2)), Function::Tpdo(1, node(2))] {
        rig.wire(WireFault::Drop, exactly(function.id()), Duration::from_micros(PERIOD_US), None);
    }
    rig.run_to(1_500, StateKind::Ready);
    let track: Vec<_> = rig.track.iter().filter(|(at, _)| *at >= since).collect();
    let speed_rad_s = |pair: &[&(Instant, [f64; JOINTS])]| {
        let dt_s = pair[1].0.as_secs_f64() - pair[0].0.as_secs_f64();
        ((pair[1].1[2] - pair[0].1[2]) / dt_s).abs()
    };
    let fastest_rad_s = track.windows(2).map(speed_rad_s).fold(0.0, f64::max);
    let away_rad = rig.away_rad(start)[2];
    println!("{fastest_rad_s} of {v_max_rad_s} rad/s, {away_rad} rad beside the plan");
    assert!((1.5..1.03 * v_max_rad_s).contains(&fastest_rad_s), "{fastest_rad_s}");
    // It stands for two periods: 2 x 2 ms at 1.5 rad/s.
    assert!((3e-3..7e-3).contains(&away_rad), "{away_rad}");
}

#[test]
fn a_fault_from_before_is_named_by_the_history_of_errors() {
    // The controller before has ended: its heartbeat stayed away.
    let mut rig = Rig::interpolating(short);
    rig.run_us(201_000);
    (0..JOINTS).for_each(|i| rig.drive(i, |servo, now| servo.fail(now, 0x8130)));
    rig.run_to(FIND_MS, StateKind::Idle);
    let mut rig = Rig::interpolating(short);
    rig.run_us(201_000);
    rig.drive(4, |servo, now| servo.fail(now, 0x8130));
    rig.drive(4, |servo, now| servo.emergency(now, 0x4310));
    rig.refused(Cause::DrivePowerFault, 4);
    rig.clear();
    rig.run_to(FIND_MS, StateKind::Idle);
}
