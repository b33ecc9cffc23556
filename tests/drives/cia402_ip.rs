//! Modules that interpolate (mode 7), as SCHUNK's: found while they look for their commutation, led along a plan, and stopped by each fault
//! of their own.

use canopen_protocol::cia402::State;
use canopen_protocol::{Function, Object};
use firmware::fault::Cause;
use firmware::state::StateKind;
use hil_sim::drive::cia402::{Interpolating, ServoOptions};
use protocol::{Duration, Instant};

use crate::cia402::others_are_held;
use crate::cia402_rig::{Rig, node};
use crate::rig::joint;
use crate::six::{JOINTS, stands_rad};

/// Search with a commutation of 5 s, twice the exchanges of a servo at most.
const FIND_MS: u64 = 7_000;

/// The commutation is found at once.
pub(crate) fn short(_: usize, options: &mut ServoOptions) {
    let commutation = Duration::from_millis(50);
    options.interpolating = options.interpolating.map(|own| Interpolating { commutation, ..own });
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
        assert_eq!(rig.drive(i, |servo, _| servo.object(0x6091, 1)), None);
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
            let commutation = Duration::from_millis(60_000);
            options.interpolating = options.interpolating.map(|own| Interpolating { commutation, ..own });
        }
    });
    rig.run_until(15_000, |rig| rig.kind() == StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::DriveError, Some(joint(4))));
    assert!((8_000_000..10_000_000).contains(&rig.now().as_micros()), "{:?}", rig.now());
    type Change = fn(&mut ServoOptions);
    let cases: [(Change, Object); 2] = [
        (|options| options.modes = ServoOptions::MODES, Object::new(0x6502, 0)),
        (
            |options| {
                options.interpolating = options.interpolating.map(|own| Interpolating { queue: 8, ..own });
            },
            Object::new(0x60C4, 2),
        ),
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
