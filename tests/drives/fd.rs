//! Seven motors on CAN FD, 1 and 5 Mbit/s.

use firmware::fault::Cause;
use firmware::groups::mit::Mismatch;
use firmware::settings::Settings;
use firmware::state::StateKind;
use hil_sim::bus::BusConfig;
use hil_sim::drive::mit::MitOptions;
use protocol::mit::{Register, RegisterValue, Status};
use protocol::{FdFlags, Instant};

use crate::rig::{JOINTS, Rig, joint, master, plan_file, settings};
use crate::track::away_rad;

/// Register 35 for 5 Mbit/s.
const FD_5_MBIT: u32 = 9;

fn settings_at(period_us: u32) -> Settings {
    let mut settings = settings();
    settings.cycle_period_us = period_us;
    settings.gains_period_us = period_us;
    (settings.gains_delay_min_us, settings.gains_delay_max_us) = (period_us, period_us);
    settings.gains_certificate_crc32 = firmware::registers::certificate_crc32(&settings);
    settings
}

fn bus() -> BusConfig {
    BusConfig { data_bit_rate_bit_s: Some(5_000_000), ..BusConfig::default() }
}

fn rig_at(period_us: u32, change: impl Fn(usize, &mut MitOptions)) -> Rig {
    Rig::on(bus(), &settings_at(period_us), |i, options| {
        options.bit_rate = FD_5_MBIT;
        change(i, options);
    })
}

/// The largest distance from the plan, rad, and the share of the bus while it ran.
fn moved_at(period_us: u32) -> (f64, f64) {
    let mut rig = rig_at(period_us, |_, _| {}).made_ready();
    let start = rig.start(&plan_file(JOINTS, period_us, |_| 0.0));
    let (from, before) = (rig.now(), rig.busy().0);
    rig.run_us(1_000_000);
    let share = (rig.busy().0 - before).as_secs_f64() / rig.now().saturating_since(from).as_secs_f64();
    rig.run_to(1_500, StateKind::Ready);
    let counters = rig.controller().counters();
    assert_eq!((counters.cycles_late, counters.replies_missed), (0, 0), "{period_us} us");
    assert!(rig.busy().1.is_zero());
    assert!(rig.frames(Instant::ZERO, |_| true).iter().all(|(_, frame)| frame.fd() == Some(FdFlags::BRS)));
    (away_rad(&rig, start).into_iter().fold(0.0, f64::max), share)
}

#[test]
fn seven_joints_follow_a_plan_at_2_ms_and_at_1_ms_and_the_bus_is_not_full() {
    // 14 frames of 49.2 to 56.6 us each.
    for (period_us, [low, high], away_max_rad) in [(2_000, [0.34, 0.40], 4e-3), (1_000, [0.69, 0.80], 4e-3)] {
        let (away_rad, share) = moved_at(period_us);
        println!("{period_us} us: {:.2} mrad, {:.1} % of the bus", 1e3 * away_rad, 1e2 * share);
        assert!((5e-4..away_max_rad).contains(&away_rad), "{period_us} us: {away_rad} rad");
        assert!((low..high).contains(&share), "{period_us} us: {share}");
    }
}

#[test]
fn a_motor_that_is_set_to_classical_can_or_another_data_rate_is_refused_with_its_register() {
    for found in [4, 10] {
        // On the bench a motor with another data rate still hears.
        let mut rig = rig_at(2_000, |i, options| {
            if i == 3 {
                options.bit_rate = found;
            }
        });
        rig.run_to(500, StateKind::Fault);
        let fault = rig.fault().unwrap();
        assert_eq!((fault.cause, fault.joint), (Cause::DriveSettingsDiffer, Some(joint(3))));
        let expected = Mismatch {
            register: Register::BitRate,
            found: RegisterValue::Whole(found),
            expected: RegisterValue::Whole(FD_5_MBIT),
        };
        assert_eq!(rig.controller().group().mismatch(), Some(&(joint(3), expected)));
        let answers = rig.frames(Instant::ZERO, |frame| frame.id() == master(3).into());
        assert!(answers.iter().all(|(_, frame)| frame.fd().is_some() == (found != 4)));
        assert!(answers.len() > 5);
        assert!((0..JOINTS).all(|i| rig.motor(i, |motor| motor.status()) == Status::Disabled));
    }
}

#[test]
fn motors_that_are_set_to_can_fd_do_not_answer_a_group_on_classical_can_and_the_first_is_named() {
    let mut rig = Rig::with(&settings(), |_, options| options.bit_rate = FD_5_MBIT);
    rig.run_to(2_000, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::DriveMissing, Some(joint(0))));
    assert!(rig.frames(Instant::ZERO, |_| true).iter().all(|(_, frame)| frame.fd().is_none()));
}
