//! Who may give which order: sessions of nodes, gains and limits, certificates, and keyed orders. Each defect that
//! was found by misuse is a test here, in the core and over the wire.

mod content;
mod edges;
mod keyed;
mod widening;

use crate::bench::*;
use firmware::authority::{Peer, Seed};
use firmware::fault::{Cause, Refusal};
use firmware::groups::powercube::PowerCubes;
use firmware::orders::{Done, Order};
use firmware::registers::Number;
use firmware::settings::Settings;
use firmware::state::StateKind;
use firmware::store::{FileName, RamStorage};
use firmware::trace::TraceEvent;
use firmware::{Controller, registers};
use proptest::prelude::*;
use protocol::Duration;

const FIRST: Peer = HOST;
const SECOND: Peer = Peer::new(43);
const VALID: Duration = Duration::from_secs(5);

fn cause<T: core::fmt::Debug>(outcome: Result<T, Refusal>) -> Cause {
    outcome.unwrap_err().cause
}

fn offer(bench: &mut Bench, peer: Peer, name: FileName) -> u32 {
    match bench.order_of(peer, Order::ArmPrepare { crc64: name.crc64, valid: VALID }) {
        Ok(Done::Offer { token, .. }) => token,
        other => panic!("{other:?}"),
    }
}

/// Ready at the start of the throw, the throw committed by the first node.
fn committed() -> (Bench, FileName) {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let name = bench.upload(&throw_file(3_000, false));
    (bench, name)
}

fn write(bench: &mut Bench, peer: Peer, name: &str, numbers: &[Number]) -> Result<(), Refusal> {
    let now = bench.instant();
    bench.controller.write_register(now, peer, name, numbers)
}

fn fault_of(bench: &Bench) -> Option<Cause> {
    bench.controller.state().fault().map(|fault| fault.cause)
}

fn hear(bench: &mut Bench, peer: Peer) {
    let now = bench.instant();
    bench.controller.host_heartbeat(now, peer);
}

#[test]
fn a_second_node_can_neither_confirm_the_offer_of_the_first_nor_take_its_place() {
    let (mut bench, name) = committed();
    let token = offer(&mut bench, FIRST, name);
    hear(&mut bench, SECOND);
    for order in [
        Order::ArmConfirm { token, valid: VALID },
        Order::ArmPrepare { crc64: name.crc64, valid: VALID },
        Order::Commit(name),
        Order::Home { mask: 1 },
        Order::SaveSettings,
    ] {
        assert_eq!(cause(bench.order_of(SECOND, order)), Cause::OtherHost, "{order:?}");
    }
    let now = bench.instant();
    assert_eq!(cause(bench.controller.upload(now, SECOND, 0, &[1; 8])), Cause::BankBusy);
    assert_eq!(bench.kind(), StateKind::Ready);
    // The first node continues as if nothing had happened; no other node can.
    bench.run_for(60_000);
    bench.order_of(FIRST, Order::ArmConfirm { token, valid: VALID }).unwrap();
    assert_eq!(cause(bench.order_of(SECOND, Order::Run(name))), Cause::OtherHost);
    assert_eq!(cause(bench.order_of(SECOND, Order::ArmConfirm { token, valid: VALID })), Cause::OtherHost);
    bench.order_of(FIRST, Order::Run(name)).unwrap();
    assert_eq!(bench.kind(), StateKind::Running);
}

#[test]
fn the_first_node_can_always_disarm_and_so_can_any_other() {
    for by in [FIRST, SECOND] {
        let (mut bench, name) = committed();
        let token = offer(&mut bench, FIRST, name);
        bench.run_for(60_000);
        let _ = bench.order_of(SECOND, Order::ArmConfirm { token, valid: VALID });
        bench.order_of(FIRST, Order::ArmConfirm { token, valid: VALID }).unwrap();
        let _ = bench.order_of(SECOND, Order::ArmPrepare { crc64: name.crc64, valid: VALID });
        bench.order_of(by, Order::Disarm).unwrap();
        assert_eq!(bench.kind(), StateKind::Ready);
        // The same holds for an offer.
        let token = offer(&mut bench, FIRST, name);
        bench.order_of(by, Order::Disarm).unwrap();
        assert_eq!(
            cause(bench.order_of(FIRST, Order::ArmConfirm { token, valid: VALID })),
            Cause::TokenWrong
        );
    }
}

#[test]
fn a_stop_is_taken_from_any_node_while_another_one_runs() {
    let (mut bench, name) = committed();
    bench.arm(name);
    bench.order_of(FIRST, Order::Run(name)).unwrap();
    bench.run_for(200_000);
    bench.order_of(SECOND, Order::Stop).unwrap();
    assert_eq!(bench.kind(), StateKind::Stopping);
}

#[test]
fn only_heartbeats_of_the_node_that_armed_keep_a_motion_alive() {
    let (mut bench, name) = committed();
    bench.arm(name);
    bench.order_of(FIRST, Order::Run(name)).unwrap();
    bench.heartbeat = false;
    for _ in 0..10 {
        hear(&mut bench, SECOND);
        bench.run_for(20_000);
    }
    assert_eq!(fault_of(&bench), Some(Cause::HostLost));
}

#[test]
fn gains_limits_and_periods_cannot_be_written_while_armed_or_running() {
    let (mut bench, name) = committed();
    bench.arm(name);
    for kind in [StateKind::Armed, StateKind::Running] {
        assert_eq!(bench.kind(), kind);
        for info in registers::all(bench.controller.settings()).filter(|info| info.shapes_motion()) {
            let held = bench.controller.register_named(info.name).unwrap();
            assert_eq!(cause(write(&mut bench, FIRST, info.name, held.as_slice())), Cause::OrderNotNow);
            assert_eq!(cause(write(&mut bench, SECOND, info.name, held.as_slice())), Cause::OtherHost);
        }
        if kind == StateKind::Armed {
            bench.order_of(FIRST, Order::Run(name)).unwrap();
            bench.run_for(200_000);
        }
    }
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready);
    assert!(bench.distance_from_path() < 1e-3);
}

#[test]
fn another_nodes_offer_locks_the_registers_and_an_own_change_voids_the_own_offer() {
    let (mut bench, name) = committed();
    let token = offer(&mut bench, FIRST, name);
    let slower = [Number::Real32(1.0); 6];
    assert_eq!(cause(write(&mut bench, SECOND, "joint.v_max_rad_s", &slower)), Cause::OtherHost);
    write(&mut bench, FIRST, "gains.period_us", &[Number::Natural32(5_000)]).unwrap();
    assert_eq!(cause(bench.order_of(FIRST, Order::ArmConfirm { token, valid: VALID })), Cause::TokenWrong);
}

#[test]
fn a_changed_limit_voids_the_commit_until_the_trajectory_is_checked_again() {
    let (mut bench, name) = committed();
    let held: Vec<f32> = bench.controller.settings().joint.0[..6].iter().map(|j| j.error_max_rad).collect();
    let tighter: Vec<Number> = held.iter().map(|x| Number::Real32(0.5 * x)).collect();
    write(&mut bench, FIRST, "joint.error_max_rad", &tighter).unwrap();
    let prepare = Order::ArmPrepare { crc64: name.crc64, valid: VALID };
    assert_eq!(cause(bench.order_of(FIRST, prepare)), Cause::NoTrajectory);
    // The file is still there.
    bench.order_of(FIRST, Order::Commit(name)).unwrap();
    bench.order_of(FIRST, Order::Disarm).unwrap();
    // Limits that the plan breaks.
    write(&mut bench, FIRST, "joint.jog_v_rad_s", &[Number::Real32(0.05); 6]).unwrap();
    write(&mut bench, FIRST, "joint.home_v_rad_s", &[Number::Real32(-0.05); 6]).unwrap();
    write(&mut bench, FIRST, "joint.v_max_rad_s", &[Number::Real32(0.1); 6]).unwrap();
    assert_eq!(cause(bench.order_of(FIRST, Order::Commit(name))), Cause::PlanVelocity);
    assert_eq!(cause(bench.order_of(FIRST, prepare)), Cause::NoTrajectory);
}

#[test]
fn limits_beyond_those_of_the_robot_need_an_unlock_that_names_it_and_ends() {
    let (mut bench, _) = committed();
    let wide = [
        ("joint.v_max_rad_s", 10.0),
        ("joint.a_max_rad_s2", 50.0),
        ("joint.q_max_rad", 9.5),
        ("joint.q_min_rad", -9.5),
        ("joint.current_max_a", 60.0),
        ("joint.error_max_rad", 1.0),
    ];
    let robot_crc32 = bench.controller.settings().limits_robot_crc32;
    let before = *bench.controller.settings();
    let unlock = |robot_crc32| Order::Unlock { robot_crc32, valid: Duration::from_secs(2) };
    let now = bench.instant();
    for (name, x) in wide {
        assert_eq!(
            cause(write(&mut bench, FIRST, name, &[Number::Real32(x); 6])),
            Cause::LimitCeiling,
            "{name}"
        );
    }
    assert_eq!(cause(bench.order_of(FIRST, unlock(robot_crc32 ^ 1))), Cause::WrongRobot);
    let long = Order::Unlock { robot_crc32, valid: Duration::from_secs(3_601) };
    assert_eq!(cause(bench.order_of(FIRST, long)), Cause::BadValue);
    assert!(!bench.controller.take_sample(now).limits_unlocked);
    bench.order_of(FIRST, unlock(robot_crc32)).unwrap();
    assert!(bench.controller.take_sample(now).limits_unlocked);
    let traced = |bench: &Bench, event| bench.controller.trace().iter().any(|(_, e)| e == event);
    assert!(traced(&bench, TraceEvent::Unlocked(FIRST)));
    for (name, x) in wide {
        assert_eq!(
            cause(write(&mut bench, SECOND, name, &[Number::Real32(x); 6])),
            Cause::LimitCeiling,
            "{name}"
        );
        write(&mut bench, FIRST, name, &[Number::Real32(x); 6]).unwrap();
    }
    assert!(!traced(&bench, TraceEvent::LimitsPutBack));
    bench.run_for(2_100_000);
    // The accelerations were changed for a while: the certificate has to be written again.
    let before = Settings { gains_certificate_crc32: 0, ..before };
    assert_eq!(*bench.controller.settings(), before, "the limits of the robot hold again");
    assert!(traced(&bench, TraceEvent::LimitsPutBack));
    let now = bench.instant();
    assert!(!bench.controller.take_sample(now).limits_unlocked);
}

#[test]
fn an_arming_with_unlocked_limits_ends_with_the_unlock_and_a_motion_is_not_disturbed() {
    let (mut bench, name) = committed();
    let robot_crc32 = bench.controller.settings().limits_robot_crc32;
    let before = *bench.controller.settings();
    for run in [false, true] {
        let unlock = Order::Unlock { robot_crc32, valid: Duration::from_millis(500) };
        bench.order_of(FIRST, unlock).unwrap();
        write(&mut bench, FIRST, "joint.error_max_rad", &[Number::Real32(0.5); 6]).unwrap();
        bench.order_of(FIRST, Order::Commit(name)).unwrap();
        bench.arm(name);
        if run {
            bench.order_of(FIRST, Order::Run(name)).unwrap();
        }
        bench.run_for(550_000);
        if run {
            assert_eq!(bench.kind(), StateKind::Running);
            assert_eq!(bench.controller.settings().joint.0[0].error_max_rad, 0.5);
            bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
            bench.run_for(50_000);
        }
        assert_eq!(bench.kind(), StateKind::Ready);
        assert_eq!(*bench.controller.settings(), before);
    }
}

#[test]
fn limits_saved_while_unlocked_do_not_survive_a_restart() {
    let (mut bench, _) = committed();
    let robot_crc32 = bench.controller.settings().limits_robot_crc32;
    bench.order_of(FIRST, Order::Unlock { robot_crc32, valid: VALID }).unwrap();
    write(&mut bench, FIRST, "joint.v_max_rad_s", &[Number::Real32(10.0); 6]).unwrap();
    write(&mut bench, FIRST, "telemetry.period_us", &[Number::Natural32(50_000)]).unwrap();
    bench.order_of(FIRST, Order::SaveSettings).unwrap();
    let storage = bench.controller.storage().clone();
    let again = Controller::<_, _, PowerCubes>::new(storage, &Settings::powercube6(), Seed::FORESEEABLE);
    assert_eq!(again.settings().telemetry_period_us, 50_000, "what was saved is found");
    assert_eq!(again.settings().joint, Settings::powercube6().joint);
    assert!(!again.is_unlocked());
}

/// Writes the certificate of the present settings.
fn certify(bench: &mut Bench) {
    let crc32 = registers::certificate_crc32(bench.controller.settings());
    write(bench, FIRST, "gains.certificate_crc32", &[Number::Natural32(crc32)]).unwrap();
}

#[test]
fn gains_without_a_certificate_or_of_another_robot_are_not_armed() {
    const ROBOT: u32 = 0x1234_5678;
    let mut settings = Settings::powercube6();
    (settings.robot_crc32, settings.gains_robot_crc32) = (ROBOT, ROBOT);
    let certificate = registers::certificate_crc32(&settings);
    settings.gains_certificate_crc32 = certificate;
    let mut bench = Bench::ready(Options { settings, ..Options::default() }, &throw_start());
    let name = bench.upload(&throw_file_of(ROBOT, 3_000, false));
    let confirm = |bench: &mut Bench| {
        let token = offer(bench, FIRST, name);
        bench.run_for(60_000);
        bench.order_of(FIRST, Order::ArmConfirm { token, valid: VALID })
    };
    let written_back = |bench: &mut Bench| {
        write(bench, FIRST, "gains.certificate_crc32", &[Number::Natural32(certificate)]).unwrap();
    };
    let rates: Vec<Number> = settings.joint.0[..6].iter().map(|j| Number::Real32(j.k_rate_1_s)).collect();
    // A gain set by hand: the old certificate does not cover it, and writing the old number back proves nothing.
    write(&mut bench, FIRST, "joint.k_rate_1_s", &[Number::Real32(-30.0); 6]).unwrap();
    assert_eq!(bench.controller.settings().gains_certificate_crc32, 0);
    assert_eq!(cause(confirm(&mut bench)), Cause::GainsUncertified);
    written_back(&mut bench);
    assert_eq!(cause(confirm(&mut bench)), Cause::GainsUncertified);
    write(&mut bench, FIRST, "joint.k_rate_1_s", &rates).unwrap();
    write(&mut bench, FIRST, "gains.robot_crc32", &[Number::Natural32(ROBOT ^ 1)]).unwrap();
    written_back(&mut bench);
    assert_eq!(cause(confirm(&mut bench)), Cause::GainsUncertified);
    certify(&mut bench);
    assert_eq!(cause(confirm(&mut bench)), Cause::GainsOtherRobot);
    write(&mut bench, FIRST, "gains.robot_crc32", &[Number::Natural32(ROBOT)]).unwrap();
    written_back(&mut bench);
    confirm(&mut bench).unwrap();
    assert_eq!(bench.count_sent(is_motion), 0);
}

#[test]
fn tokens_cannot_be_foreseen_from_the_clock() {
    let token = |seed: Seed| {
        let settings = Settings::powercube6();
        let controller = Controller::<_, _, PowerCubes>::new(RamStorage::new(), &settings, seed);
        let mut bench = Bench::with(controller, Options::default());
        for (drive, q) in bench.drives.iter_mut().zip(throw_start()) {
            drive.place(q);
        }
        bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
        let name = bench.upload(&throw_file(3_000, false));
        (0..3).map(|_| offer(&mut bench, FIRST, name)).collect::<Vec<u32>>()
    };
    // The same clock, the same history.
    let (one, two) = (token(Seed::from_entropy([1; 32])), token(Seed::from_entropy([2; 32])));
    assert!(one.iter().all(|token| !two.contains(token)), "{one:?} {two:?}");
    assert_eq!(token(Seed::from_entropy([1; 32])), one);
}

#[test]
fn a_restarted_controller_knows_no_session_and_a_restarted_host_loses_its_own() {
    let (mut bench, name) = committed();
    bench.arm(name);
    let now = bench.instant();
    bench.controller.host_restarted(now, SECOND);
    assert_eq!(bench.kind(), StateKind::Armed, "another node");
    bench.controller.host_restarted(now, FIRST);
    assert_eq!(bench.kind(), StateKind::Ready);
    // Its next heartbeat.
    bench.run_for(30_000);
    bench.arm(name);
    bench.order_of(FIRST, Order::Run(name)).unwrap();
    bench.run_for(200_000);
    let now = bench.instant();
    bench.controller.host_restarted(now, FIRST);
    assert_eq!(fault_of(&bench), Some(Cause::HostLost));

    let (mut bench, name) = committed();
    let token = offer(&mut bench, FIRST, name);
    let storage = bench.controller.storage().clone();
    let again =
        Controller::<_, _, PowerCubes>::new(storage, &Settings::powercube6(), Seed::from_entropy([9; 32]));
    let mut bench = Bench::with(again, Options::default());
    for (drive, q) in bench.drives.iter_mut().zip(throw_start()) {
        drive.place(q);
    }
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
    bench.run_for(60_000);
    assert_eq!(cause(bench.order_of(FIRST, Order::ArmConfirm { token, valid: VALID })), Cause::TokenWrong);
    assert_eq!(cause(bench.order_of(FIRST, Order::Run(name))), Cause::OrderNotNow);
}

/// Any order of another node except those that end a motion, with plausible numbers.
fn strange(kind: u8, x: u64, name: FileName) -> Order {
    let valid = Duration::from_micros(x % 40_000_000);
    match kind {
        0 => Order::ArmPrepare { crc64: name.crc64, valid },
        1 => Order::ArmConfirm { token: x as u32, valid },
        2 => Order::Run(name),
        3 => Order::Home { mask: x as u8 },
        4 => Order::Jog { joint: joint(x as usize % 6), qd_rad_s: 0.2, hold: Duration::from_millis(300) },
        5 => Order::Commit(name),
        6 => Order::Gripper { open: x.is_multiple_of(2) },
        7 => Order::SaveSettings,
        8 => Order::Challenge,
        9 => Order::Authorize { nonce: x.to_le_bytes(), code: [x as u8; 16] },
        10 => Order::ClearFault { code: x as u16 % 800 },
        _ => Order::Unlock { robot_crc32: Settings::powercube6().limits_robot_crc32, valid },
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Orders, writes and uploads of other nodes between the steps of the first node change neither its settings
    /// nor its throw.
    #[test]
    fn strangers_change_nothing_between_the_offer_and_the_end_of_a_throw(
        acts in proptest::collection::vec((0u8..14, 43u8..46, any::<u64>()), 0..60),
    ) {
        let (mut bench, name) = committed();
        let before = *bench.controller.settings();
        let token = offer(&mut bench, FIRST, name);
        let steps = acts.chunks(acts.len() / 3 + 1).map(<[_]>::to_vec).chain([vec![], vec![], vec![]]);
        for (step, acts) in steps.take(3).enumerate() {
            for (kind, peer, x) in acts {
                let peer = Peer::new(peer);
                let now = bench.instant();
                match kind {
                    12 => {
                        let all: Vec<_> = registers::all(bench.controller.settings()).collect();
                        let info = all[x as usize % all.len()];
                        let number = match info.kind {
                            registers::Kind::Real32 => Number::Real32(f32::from_bits(x as u32)),
                            registers::Kind::Natural32 => Number::Natural32(x as u32),
                            registers::Kind::Bit => Number::Bit(x & 1 == 1),
                        };
                        let count = if info.per_joint { 6 } else { 1 };
                        let _ = bench.controller.write_register(now, peer, info.name, &vec![number; count]);
                    }
                    13 => {
                        let _ = bench.controller.upload(now, peer, x as usize % 64, &x.to_le_bytes());
                    }
                    kind => {
                        let _ = bench.order_of(peer, strange(kind, x, name));
                    }
                }
                bench.controller.host_heartbeat(now, peer);
                bench.run_for(x % 1_500);
            }
            match step {
                0 => {
                    bench.run_for(60_000);
                    bench.order_of(FIRST, Order::ArmConfirm { token, valid: VALID }).unwrap();
                }
                1 => {
                    bench.run_for(10_000);
                    bench.order_of(FIRST, Order::Run(name)).unwrap();
                }
                _ => bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready),
            }
        }
        prop_assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
        prop_assert_eq!(*bench.controller.settings(), before);
        prop_assert!(bench.distance_from_path() < 1e-3);
        let end: f64 = bench.drives.iter().enumerate().map(|(i, drive)| (drive.q - throw_reference(i, 9.0).0).abs()).fold(0.0, f64::max);
        prop_assert!(end < 2e-3, "{} rad beside the end of the plan", end);
    }
}
