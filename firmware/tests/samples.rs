//! What a sample and a freeze frame report about a moving joint, compared with the drive itself.

use crate::bench::*;
use firmware::orders::{Done, Order};
use firmware::settings::Settings;
use firmware::state::StateKind;
use protocol::Duration;
use protocol::cyphal::cubecell::joint_state::JointFlags;
use protocol::powercube::CubeState;

const INTO_US: u64 = 30_000;

/// 30 ms into a throw that began `away_rad` beside its path.
fn beside(away_rad: f64) -> Bench {
    let mut settings = Settings::powercube6();
    for joint in settings.joints() {
        settings.joint.at_mut(joint).start_tolerance_rad = 0.15;
    }
    let start = throw_start().map(|q| q + away_rad);
    let mut bench = Bench::ready(Options { settings, ..Options::default() }, &start);
    bench.start(&throw_file(3_000, true));
    bench.run_for(6_000 + INTO_US);
    assert_eq!(bench.kind(), StateKind::Running);
    bench
}

fn has(bench: &Bench, index: usize, flag: JointFlags) -> bool {
    bench.controller.joint_sample(joint(index)).flags.has(flag)
}

#[test]
fn sample_reports_error_and_rate_as_they_are() {
    let bench = beside(0.1);
    for index in 0..6 {
        let sample = bench.controller.joint_sample(joint(index));
        let (q, qd) = throw_reference(index, INTO_US as f64 * 1e-6);
        let drive = &bench.drives[index];
        let (e, de) = (q - drive.q, qd - drive.v);
        // The sample is that of the last cycle, and the drive is behind its generator.
        assert!(
            (f64::from(sample.error_q_rad) - e).abs() < 0.01,
            "joint {index}: {} for {e}",
            sample.error_q_rad
        );
        assert!((f64::from(sample.error_qd_rad_s) - de).abs() < 0.15, "joint {index}: {sample:?} for {de}");
        assert!(e < -0.05 && de > 0.1, "joint {index} comes back: {e} rad, {de} rad/s");
    }
}

#[test]
fn sample_flags_a_saturated_joint_and_no_other() {
    let clipped = |away_rad: f64| {
        let mut bench = beside(away_rad);
        let mut cycles = 0;
        for _ in 0..100 {
            bench.run_for(3_000);
            cycles += u32::from(has(&bench, 5, JointFlags::ACCELERATION_CLIPPED));
        }
        cycles
    };
    assert_eq!(clipped(0.0), 0);
    let cycles = clipped(-0.14);
    assert!(cycles > 0, "{cycles}");
}

#[test]
fn missed_answer_shows_until_the_next_one() {
    let mut bench = beside(0.0);
    assert!(!has(&bench, 2, JointFlags::REPLY_MISSED));
    bench.drives[2].drop_replies = 1;
    bench.run_until(10_000, |bench| has(bench, 2, JointFlags::REPLY_MISSED));
    assert!(has(&bench, 2, JointFlags::REPLY_MISSED) && !has(&bench, 1, JointFlags::REPLY_MISSED));
    bench.run_for(6_000);
    assert!(!has(&bench, 2, JointFlags::REPLY_MISSED));
    assert_eq!(bench.kind(), StateKind::Running);
}

#[test]
fn freeze_frame_keeps_error_and_reference_of_the_moment() {
    let mut bench = beside(0.1);
    bench.drives[1].state = bench.drives[1].state.union(CubeState::ERROR);
    bench.run_until(10_000, |bench| bench.kind() != StateKind::Running);
    let freeze = *bench.controller.freeze_frame().unwrap();
    for index in 0..6 {
        let (q, qd) = throw_reference(index, freeze.path_us as f64 * 1e-6);
        let frozen = freeze.joints.get(joint(index));
        assert!((f64::from(frozen.qd_ref_rad_s) - qd).abs() < 0.1, "joint {index}: {frozen:?} for {qd}");
        let e = bench.drives[index].q - q;
        assert!((f64::from(frozen.e_rad) - e).abs() < 0.01, "joint {index}: {frozen:?} for {e}");
        assert!(frozen.e_rad > 0.05);
    }
}

#[test]
fn sample_reports_position_current_and_state_of_each_drive() {
    let mut bench = Bench::ready(Options::default(), &[0.3, -0.4, 0.5, -0.6, 0.7, -0.8]);
    bench.run_for(500_000);
    for index in 0..6 {
        let sample = bench.controller.joint_sample(joint(index));
        assert!((f64::from(sample.q_rad) - bench.drives[index].q).abs() < 1e-3, "joint {index}: {sample:?}");
        assert!(sample.current_a.is_finite(), "joint {index}: {sample:?}");
        assert_ne!(sample.drive_state_byte, 0, "joint {index}: {sample:?}");
        // Nothing is tracked.
        assert_eq!((sample.qd_rad_s, sample.error_q_rad), (0.0, 0.0));
        assert!(
            !has(&bench, index, JointFlags::SPEED_LIMITED)
                && !has(&bench, index, JointFlags::ACCELERATION_CLIPPED)
        );
    }
}

#[test]
fn sample_of_the_group_reports_homed_joints_path_and_what_was_counted() {
    let mut bench = Bench::new(Options { homed: false, ..Options::default() });
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Idle);
    bench.run_for(50_000);
    bench.order(Order::Home { mask: 0b10_0010 }).unwrap();
    bench.run_until(5_000_000, |bench| bench.kind() != StateKind::Homing);
    let now = bench.instant();
    let sample = bench.controller.take_sample(now);
    assert_eq!((sample.homed_mask, sample.path_us, sample.counters.motions), (0b10_0010, 0, 0));

    let mut bench = beside(0.0);
    let now = bench.instant();
    let sample = bench.controller.take_sample(now);
    assert_eq!(sample.homed_mask, 0x3F);
    assert!(sample.path_us.abs_diff(INTO_US as u32) < 1_000, "{} us", sample.path_us);
    assert_eq!(sample.counters.motions as usize, bench.count_sent(is_motion));
    let cycles = bench.controller.cycles();
    bench.run_for(30_000);
    assert_eq!(bench.controller.cycles(), cycles + 10);
}

#[test]
fn sample_reports_the_time_left_of_an_offer_and_of_an_arming() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let left_ms = |bench: &mut Bench| {
        let now = bench.instant();
        bench.controller.take_sample(now).arming_left.as_micros() / 1_000
    };
    assert_eq!(left_ms(&mut bench), 0);
    let name = bench.upload(&throw_file(3_000, true));
    let valid = Duration::from_millis(4_000);
    let Done::Offer { token, .. } = bench.order(Order::ArmPrepare { crc64: name.crc64, valid }).unwrap()
    else {
        panic!("no offer")
    };
    bench.run_for(1_000_000);
    assert_eq!(left_ms(&mut bench), 3_000);
    bench.order(Order::ArmConfirm { token, valid }).unwrap();
    bench.run_for(500_000);
    assert_eq!((bench.kind(), left_ms(&mut bench)), (StateKind::Armed, 3_500));
}
