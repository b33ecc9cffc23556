//! Orders to the RSI group: which are refused, how it stops, homes and jogs, and when the gripper opens.

use crate::bench::{HA, HB, HOST, joint, throw_reference};
use crate::rsi_group::{AXES, CUT_OUT_RAD_S2, Cell, PERIOD_US, UNDER_WAY};
use firmware::fault::Cause;
use firmware::group::DriveGroup;
use firmware::groups::rsi::{Options, Packet, Rsi};
use firmware::orders::{Done, Order};
use firmware::settings::Settings;
use firmware::state::StateKind;
use protocol::Duration;

/// Largest difference between two poses, rad.
fn away(a: &[f64; AXES], b: &[f64; AXES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Ready, with an offer to arm; then `disturb` is called in each cycle. Returns why the confirmation is refused.
fn refused_to_arm(cycles: usize, disturb: fn(&mut Cell)) -> Cause {
    let (mut cell, name) = Cell::ready();
    let valid = Duration::from_secs(5);
    let Done::Offer { token, .. } = cell.order(Order::ArmPrepare { crc64: name.crc64, valid }) else {
        panic!("no offer")
    };
    for _ in 0..cycles {
        cell.step();
        disturb(&mut cell);
    }
    assert_eq!(cell.kind(), StateKind::Ready, "this is no fault yet");
    cell.controller.order(cell.at(), HOST, Order::ArmConfirm { token, valid }).unwrap_err().cause
}

#[test]
fn robot_that_is_silent_for_three_cycles_is_not_armed() {
    assert_eq!(refused_to_arm(5, |cell| cell.silent = true), Cause::DriveNotReady);
}

#[test]
fn axes_that_a_person_moves_are_not_armed() {
    // 80 mrad/s; the lag pulls back a part of it.
    assert_eq!(refused_to_arm(8, |cell| cell.robot.q[3] += 1e-3), Cause::DriveNotReady);
}

#[test]
fn group_whose_start_pose_is_not_known_has_no_zeros_and_is_fit_for_nothing() {
    let (settings, now) = (Settings::powercube6(), protocol::Instant::from_micros(5_000_000));
    let mut group = Rsi::new(Options::default());
    assert!(!group.is_homed(joint(0)));
    assert_eq!(group.check_drive(now, &settings, joint(0)).unwrap_err().cause, Cause::NotHomed);
    assert_eq!(group.check_group(now, &settings).unwrap_err().cause, Cause::DriveNotReady);
    let (cell, _) = Cell::ready();
    group.handle_packet(now, &settings, &Packet::Robot(cell.robot.telegram()));
    assert!(group.is_homed(joint(0)));
    assert!(group.check_group(now, &settings).is_ok());
    // One telegram is not enough to show rest.
    assert_eq!(group.check_drive(now, &settings, joint(0)).unwrap_err().cause, Cause::DriveNotReady);
}

#[test]
fn robot_that_starts_again_before_the_group_is_ready_is_no_fault() {
    let mut cell = Cell::new();
    for _ in 0..5 {
        cell.step();
    }
    assert_eq!(cell.kind(), StateKind::Boot);
    cell.robot.restart();
    cell.run_until(100, StateKind::Ready);
}

#[test]
fn stop_in_a_throw_brakes_all_axes_within_the_cut_out_and_ends_when_they_stand() {
    for under_way in [UNDER_WAY - 10, UNDER_WAY, UNDER_WAY + 10] {
        let (mut cell, _) = Cell::thrown();
        for _ in 0..under_way {
            cell.step();
        }
        let moving = cell.robot.q;
        cell.order(Order::Stop);
        cell.run_until(200, StateKind::Stopped);
        assert!(cell.robot.a_max <= CUT_OUT_RAD_S2, "{}", cell.robot.a_max);
        let reported = cell.robot.q;
        assert!(away(&reported, &moving) > 0.01, "the axes needed a way to stop");
        for _ in 0..50 {
            cell.step();
        }
        assert!(away(&cell.robot.q, &reported) < 2e-3, "{}", away(&cell.robot.q, &reported));
        let beside = (0..=2_000)
            .map(|k| f64::from(k) * (HA + HB) / 2_000.0)
            .map(|t| away(&cell.robot.q, &std::array::from_fn(|i| throw_reference(i, t).0)))
            .fold(f64::INFINITY, f64::min);
        assert!(beside < 1e-3, "{beside} rad beside the path");
        assert_eq!(cell.robot.open, None, "the ball is kept");
    }
}

/// The cycle in which the robot's gripper opens in a throw, with axes that follow later than the group expects.
fn opened(late_cycles: usize, stop_at: Option<u64>) -> Option<u64> {
    let (mut cell, _) = Cell::thrown();
    cell.robot.dead_cycles += late_cycles;
    for _ in 0..150 {
        if stop_at == Some(cell.next) {
            cell.order(Order::Stop);
        }
        cell.step();
    }
    cell.robot.open
}

#[test]
fn gripper_opens_later_by_as_much_as_the_axes_are_late() {
    let in_time = opened(0, None).unwrap();
    for late_cycles in [1, 2, 3] {
        let late = opened(late_cycles, None).unwrap();
        assert_eq!(late - in_time, late_cycles as u64 * PERIOD_US, "{late_cycles}");
    }
}

#[test]
fn stop_before_the_axes_pass_the_release_drops_the_order_to_open() {
    let late = opened(3, None).unwrap();
    assert_eq!(opened(3, Some(late - PERIOD_US)), None);
    assert_eq!(opened(3, Some(late + 2 * PERIOD_US)), Some(late));
}

#[test]
fn homing_takes_the_axes_as_they_are_and_moves_nothing() {
    let (mut cell, _) = Cell::ready();
    let set = *cell.robot.set.last().unwrap();
    cell.order(Order::Home { mask: 0b11_1111 });
    assert_eq!(cell.kind(), StateKind::Homing);
    cell.run_until(100, StateKind::Ready);
    assert_eq!(cell.robot.set.last(), Some(&set));
}

#[test]
fn jog_moves_its_axis_alone_and_ends_when_it_stands() {
    let (mut cell, _) = Cell::ready();
    let start = *cell.robot.set.last().unwrap();
    let hold = Duration::from_millis(100);
    for _ in 0..40 {
        let order = Order::Jog { joint: joint(1), qd_rad_s: 0.2, hold };
        assert!(cell.controller.order(cell.at(), HOST, order).is_ok());
        cell.step();
        assert_eq!(cell.kind(), StateKind::Jogging);
    }
    let limits = Settings::powercube6();
    let limits = limits.joint.at(joint(1));
    let set = *cell.robot.set.last().unwrap();
    // 40 cycles at 0.2 rad/s, less the way lost while speeding up.
    let way = 0.2 * 40.0 * PERIOD_US as f64 * 1e-6;
    assert!((0.7 * way..way).contains(&(set[1] - start[1])), "{}", set[1] - start[1]);
    assert!(cell.robot.v_max <= 0.2 + 1e-6 && cell.robot.a_max <= 1.01 * f64::from(limits.jog_a_rad_s2));
    cell.run_until(100, StateKind::Ready);
    let reported = cell.robot.q;
    assert!(cell.robot.a_max <= 1.01 * f64::from(limits.jog_a_rad_s2), "{}", cell.robot.a_max);
    for _ in 0..50 {
        cell.step();
    }
    assert!(away(&cell.robot.q, &reported) < 1e-3, "{}", away(&cell.robot.q, &reported));
    let end = *cell.robot.set.last().unwrap();
    // 100 ms of hold and the braking.
    assert!((0.015..0.06).contains(&(end[1] - set[1])), "{}", end[1] - set[1]);
    for i in [0, 2, 3, 4, 5] {
        assert_eq!(end[i], start[i], "axis {i}");
    }
}

#[test]
fn jog_ends_at_the_soft_limit_and_its_release_there_moves_nothing() {
    for way in [1.0f32, -1.0] {
        let (mut cell, _) = Cell::ready();
        let limits = *cell.controller.settings().joint.at(joint(1));
        let limit = f64::from(if way > 0.0 { limits.q_max_rad } else { limits.q_min_rad });
        for _ in 0..2_000 {
            let order =
                Order::Jog { joint: joint(1), qd_rad_s: 0.25 * way, hold: Duration::from_millis(100) };
            let _ = cell.controller.order(cell.at(), HOST, order);
            cell.step();
        }
        let set = cell.robot.set.last().unwrap()[1];
        assert!((set - limit).abs() < 2e-3 && (limit - set) * f64::from(way) > -1e-4, "{set}, limit {limit}");
        cell.run_until(100, StateKind::Ready);
        assert!((cell.robot.set.last().unwrap()[1] - set).abs() < 1e-6, "nothing moves on release");
        assert!(cell.robot.a_max <= 1.01 * f64::from(limits.jog_a_rad_s2), "{}", cell.robot.a_max);
    }
}

/// The stop of the program that runs the node.
#[test]
fn halt_in_a_throw_brakes_all_axes_together_on_the_tangent_of_their_path() {
    let (mut cell, _) = Cell::thrown();
    for _ in 0..UNDER_WAY {
        cell.step();
    }
    let dt_s = PERIOD_US as f64 * 1e-6;
    let speeds = |cell: &Cell| -> [f64; AXES] {
        let [.., before, last] = cell.robot.set.as_slice() else { panic!("two set points") };
        std::array::from_fn(|i| (last[i] - before[i]) / dt_s)
    };
    cell.controller.stop_now(cell.at());
    // The answer of the cycle before is already on its way.
    cell.step();
    let from = speeds(&cell);
    let fastest = from.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    assert!(fastest > 0.5, "{fastest}");
    let length_s = fastest / f64::from(Options::default().a_brake_rad_s2);
    for k in 1..60 {
        cell.robot.stopped = false;
        cell.step();
        let share = (1.0 - dt_s * f64::from(k) / length_s).max(0.0);
        for (i, v) in speeds(&cell).into_iter().enumerate() {
            assert!((v - share * from[i]).abs() < 1e-3, "cycle {k}, axis {i}: {v}, {share} of {}", from[i]);
        }
    }
    assert_eq!(cell.robot.open, None, "the ball is kept");
    assert!(matches!(cell.kind(), StateKind::Stopped), "{:?}", cell.kind());
}
