//! Corrections never leap, for any input. Judged by a robot that differences the corrections: an accepted
//! correction differs from the one in force by no more than the limits of speed and acceleration.

use crate::bench::{HOST, Rng, joint};
use crate::rsi_group::{AXES, Cell, UNDER_WAY, Wire};
use firmware::Controller;
use firmware::authority::Seed;
use firmware::fault::Cause;
use firmware::groups::rsi::{Options, Rsi};
use firmware::joints::PerJoint;
use firmware::orders::Order;
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::RamStorage;
use protocol::Duration;

/// Fault of the link or of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Injected {
    AnswersLate(u32),
    AnswersLost(u32),
    TelegramsLost(u32),
    Doubled,
    Overtaken,
    NumberFalls(u64),
    NumberRises(u64),
    OtherNumber,
    LateCountFalls,
    NoPositions,
    /// The program of the robot begins again where its set points stand.
    Restart,
    /// The program of the robot begins again after its arm went back to its start pose, this many cycles later; its numbers go on
    /// or begin again.
    BackAtStart(u32, bool),
    /// The controller begins again, this many cycles later.
    OtherController(u32),
    /// As before, and its first telegrams have no positions.
    OtherControllerWithoutPositions(u32),
}

/// Same limits as the cell's own.
fn other_controller(cell: &mut Cell) {
    let options =
        Options { lower_rad: PerJoint::splat(-6.0), upper_rad: PerJoint::splat(6.0), ..Options::default() };
    let settings = *cell.controller.settings();
    let group = Rsi::new(options);
    *cell.controller =
        Controller::with_group(RamStorage::new(), Spline::empty(), group, &settings, Seed::FORESEEABLE);
}

fn strike(cell: &mut Cell, injected: Injected) {
    let mut for_cycles = |cycles: u32, wire: Wire| {
        for _ in 0..cycles {
            cell.forced = Some(wire);
            step(cell);
        }
    };
    match injected {
        Injected::AnswersLate(cycles) => for_cycles(cycles, Wire::AnswerLate),
        Injected::AnswersLost(cycles) => for_cycles(cycles, Wire::AnswerLost),
        Injected::TelegramsLost(cycles) => for_cycles(cycles, Wire::TelegramLost),
        Injected::Doubled => for_cycles(1, Wire::Doubled),
        Injected::Overtaken => for_cycles(1, Wire::Overtaken),
        Injected::OtherNumber => for_cycles(1, Wire::OtherNumber),
        // Not in the cycle that would report a late answer.
        Injected::LateCountFalls => {
            for_cycles(1, Wire::Fine);
            for_cycles(1, Wire::NoLate);
        }
        Injected::NoPositions => for_cycles(1, Wire::NoPositions),
        Injected::NumberFalls(by) => cell.robot.ipoc -= by.min(cell.robot.ipoc),
        Injected::NumberRises(by) => cell.robot.ipoc += by,
        Injected::Restart => cell.robot.restart(),
        Injected::BackAtStart(cycles, numbers_go_on) => {
            for_cycles(cycles, Wire::TelegramLost);
            let ipoc = cell.robot.ipoc;
            cell.robot.return_to_start();
            cell.robot.ipoc = if numbers_go_on { ipoc } else { cell.robot.ipoc };
        }
        Injected::OtherController(cycles) => {
            for_cycles(cycles, Wire::TelegramLost);
            other_controller(cell);
        }
        Injected::OtherControllerWithoutPositions(cycles) => {
            for_cycles(cycles, Wire::TelegramLost);
            other_controller(cell);
            cell.forced = Some(Wire::NoPositions);
            step(cell);
        }
    }
}

/// One cycle of a robot whose stop signal is not wired.
fn step(cell: &mut Cell) {
    cell.robot.stopped = false;
    cell.step();
}

/// Where the corrections have led the set points, rad.
fn given_rad(cell: &Cell) -> f64 {
    (0..AXES).map(|i| cell.robot.correction[i].abs()).fold(0.0, f64::max)
}

fn assert_no_leap(cell: &Cell, what: &dyn std::fmt::Debug) {
    let [v, a] = cell.robot.leap;
    assert!(v <= 1.0 + 1e-3 && a <= 1.0 + 1e-3, "{what:?}: {v:.2} of the speed, {a:.2} of the acceleration");
}

/// A throw with a fault in it, observed for two seconds more.
fn thrown_with(cycle: u64, in_a_row: bool, injected: Injected) -> Cell {
    let (mut cell, _) = Cell::thrown();
    cell.robot.counts_in_a_row = in_a_row;
    for _ in 0..cycle {
        step(&mut cell);
    }
    strike(&mut cell, injected);
    for _ in 0..170 {
        step(&mut cell);
    }
    assert_no_leap(&cell, &(injected, cycle, in_a_row));
    cell
}

#[test]
fn late_count_that_falls_in_a_robot_that_counts_in_a_row_changes_nothing() {
    let cell = thrown_with(UNDER_WAY, true, Injected::AnswersLate(1));
    assert!(matches!(cell.kind(), StateKind::Ready), "{:?}", cell.controller.state());
    thrown_with(UNDER_WAY, false, Injected::LateCountFalls);
}

#[test]
fn number_that_falls_or_jumps_in_the_run_holds_the_axes_where_they_are() {
    for injected in [Injected::NumberFalls(30), Injected::NumberFalls(4_000), Injected::OtherNumber] {
        let cell = thrown_with(UNDER_WAY, false, injected);
        assert_eq!(cell.cause(), Some(Cause::RobotRestarted), "{injected:?}");
        assert!(given_rad(&cell) > 0.2, "{injected:?}: {}", given_rad(&cell));
    }
    let cell = thrown_with(UNDER_WAY, false, Injected::NumberRises(700));
    assert_eq!(cell.kind(), StateKind::Ready);
}

#[test]
fn telegram_without_positions_in_the_run_ends_it_where_the_axes_are() {
    let cell = thrown_with(UNDER_WAY, false, Injected::NoPositions);
    assert_eq!(cell.cause(), Some(Cause::RobotRestarted));
    assert!(given_rad(&cell) > 0.2, "{}", given_rad(&cell));
}

#[test]
fn outage_at_full_speed_ends_the_run_and_the_axes_are_held_where_the_robot_holds_them() {
    for cycles in [4, 9, 42, 92, 200, 420] {
        for injected in [Injected::TelegramsLost(cycles), Injected::AnswersLost(cycles)] {
            let (mut cell, _) = Cell::thrown();
            for _ in 0..UNDER_WAY {
                step(&mut cell);
            }
            strike(&mut cell, injected);
            let held = *cell.robot.set.last().unwrap();
            for _ in 0..200 {
                step(&mut cell);
            }
            assert_no_leap(&cell, &injected);
            let kind = cell.kind();
            assert!(matches!(kind, StateKind::Fault), "{injected:?}: {kind:?}");
            let set = cell.robot.set.last().unwrap();
            let away = (0..AXES).map(|i| (set[i] - held[i]).abs()).fold(0.0, f64::max);
            // If telegrams still come, the axes stop along their path.
            let is_silent = matches!(injected, Injected::TelegramsLost(_));
            assert!(away < if is_silent { 1e-6 } else { 0.4 }, "{injected:?}: {away}");
        }
    }
}

#[test]
fn controller_that_begins_again_in_a_run_gives_no_zeros_to_an_arm_away_from_its_start() {
    let cell = thrown_with(UNDER_WAY, false, Injected::OtherController(25));
    assert!(given_rad(&cell) > 0.2, "{}", given_rad(&cell));
    assert_eq!(cell.kind(), StateKind::Boot);
}

/// The axes follow a correction after 96 ms: an arm that still stands at its start pose may already have a correction.
#[test]
fn controller_that_begins_again_within_the_lag_waits_for_what_the_axes_were_given() {
    for in_a_row in [false, true] {
        for names_late in [true, false] {
            // From the first corrections of the throw until the arm clearly moves.
            for cycle in 1..UNDER_WAY {
                for gap in [1, 2, 5, 8, 12, 25] {
                    let (mut cell, _) = Cell::thrown();
                    (cell.robot.counts_in_a_row, cell.robot.names_late) = (in_a_row, names_late);
                    for _ in 0..cycle {
                        step(&mut cell);
                    }
                    strike(&mut cell, Injected::OtherController(gap));
                    for _ in 0..60 {
                        step(&mut cell);
                    }
                    assert_no_leap(&cell, &(cycle, gap, in_a_row, names_late));
                }
            }
        }
    }
}

#[test]
fn telegram_without_positions_has_no_answer_of_a_controller_that_begins_again() {
    for cycle in 1..UNDER_WAY {
        thrown_with(cycle, false, Injected::OtherControllerWithoutPositions(cycle as u32 % 9));
    }
}

#[test]
fn program_whose_first_telegram_has_no_positions_is_led_from_its_start() {
    for wire in [Wire::NoPositions, Wire::NoAxes] {
        let mut cell = Cell::new();
        cell.forced = Some(wire);
        cell.run_until(100, StateKind::Ready);
        assert!(given_rad(&cell) < 1e-9 && cell.robot.late <= 30, "{wire:?}: {}", cell.robot.late);
        assert_no_leap(&cell, &wire);
    }
}

#[test]
fn program_that_begins_again_at_its_start_is_held_there() {
    for (cycles, numbers_go_on) in [(0, false), (0, true), (20, true), (100, false), (100, true)] {
        let mut cell = thrown_with(UNDER_WAY, false, Injected::BackAtStart(cycles, numbers_go_on));
        assert!(given_rad(&cell) < 1e-6, "{}", given_rad(&cell));
        let fault = cell.controller.state().fault().expect("a fault");
        cell.order(Order::ClearFault { code: fault.cause.code() });
        for _ in 0..100 {
            step(&mut cell);
        }
        assert_eq!(cell.kind(), StateKind::Ready, "it can be led again");
    }
}

#[test]
fn axis_that_does_not_follow_its_jog_is_reported() {
    let (mut cell, _) = Cell::ready();
    let stuck = cell.robot.q[1];
    for _ in 0..60 {
        let order = Order::Jog { joint: joint(1), qd_rad_s: 0.25, hold: Duration::from_millis(100) };
        let _ = cell.controller.order(cell.at(), HOST, order);
        cell.robot.q[1] = stuck;
        step(&mut cell);
    }
    assert_eq!(cell.cause(), Some(Cause::RobotLags));
}

#[test]
fn ball_is_released_near_its_path_or_not_at_all() {
    let released = |lost: Option<u64>| {
        let (mut cell, _) = Cell::thrown();
        let mut at_opening = None;
        for k in 0..100 {
            cell.forced = (Some(k) == lost).then_some(Wire::AnswerLost);
            step(&mut cell);
            at_opening = at_opening.or(cell.robot.open.map(|_| (k, cell.robot.q)));
        }
        let withheld = cell.controller.group().release_withheld_rad();
        assert_eq!(withheld.is_some(), at_opening.is_none(), "{lost:?}: what is withheld is reported");
        at_opening
    };
    let (cycle, nominal) = released(None).expect("released");
    let (mut far, mut near) = (0, 0);
    for lost in 1..cycle {
        match released(Some(lost)) {
            // An answer to open that is lost is repeated with the next one.
            Some((at, q)) if at <= cycle + 1 => {
                let moved = if at > cycle { 0.05 } else { 0.0 };
                let off = (0..AXES).map(|i| (q[i] - nominal[i]).abs()).fold(0.0, f64::max);
                assert!(off <= 5.1e-3 + moved, "{lost}: {off} rad off its path");
                near += 1;
            }
            Some((at, _)) => panic!("{lost}: opened {} cycles late", at - cycle),
            None => far += 1,
        }
    }
    assert!(far >= 10 && near >= 20, "{far} {near}");
}

fn drawn(rng: &mut Rng) -> Injected {
    match rng.below(16) {
        0 => Injected::AnswersLate(1 + rng.below(4) as u32),
        1 => Injected::AnswersLost(1 + rng.below(4) as u32),
        2 => Injected::TelegramsLost(1 + rng.below(4) as u32),
        3 => Injected::AnswersLost(8 + rng.below(400) as u32),
        4 => Injected::TelegramsLost(8 + rng.below(400) as u32),
        5 => Injected::Doubled,
        6 => Injected::Overtaken,
        7 => Injected::NumberFalls(1 + rng.below(5_000)),
        8 => Injected::NumberRises(1 + rng.below(5_000)),
        9 => Injected::OtherNumber,
        10 => Injected::LateCountFalls,
        11 => Injected::NoPositions,
        12 => Injected::Restart,
        // The arm needs time to move back.
        13 => Injected::BackAtStart(4 + rng.below(116) as u32, rng.below(2) == 0),
        14 => Injected::OtherController(1 + rng.below(40) as u32),
        _ => Injected::OtherControllerWithoutPositions(rng.below(40) as u32),
    }
}

#[test]
fn no_sequence_of_faults_makes_a_correction_leap() {
    let mut rng = Rng(32);
    for sequence in 0..1_000 {
        let (mut cell, _) = Cell::thrown();
        cell.robot.counts_in_a_row = sequence % 2 == 0;
        let mut drawn_so_far = Vec::new();
        for _ in 0..1 + rng.below(4) {
            for _ in 0..rng.below(60) {
                step(&mut cell);
            }
            let injected = drawn(&mut rng);
            drawn_so_far.push((cell.cycle, injected));
            strike(&mut cell, injected);
            assert_no_leap(&cell, &(sequence, &drawn_so_far));
        }
        for _ in 0..120 {
            step(&mut cell);
        }
        assert_no_leap(&cell, &(sequence, &drawn_so_far));
        // The fault is cleared and the arm is stopped: still nothing moves by itself.
        if let Some(fault) = cell.controller.state().fault() {
            let _ = cell.controller.order(cell.at(), HOST, Order::ClearFault { code: fault.cause.code() });
        }
        for _ in 0..60 {
            step(&mut cell);
        }
        assert_no_leap(&cell, &(sequence, &drawn_so_far));
    }
}
