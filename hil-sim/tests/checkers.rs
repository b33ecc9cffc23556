//! Each checker with short hand-made conversations: no violation in a good one, a violation in a bad one.

use hil_sim::Observer;
use hil_sim::checker::{Checkers, ModuleLimits};
use hil_sim::scenario::{Expect, parse_frame};
use protocol::{Duration, Instant, ModuleId};

fn limits() -> Vec<ModuleLimits> {
    vec![ModuleLimits {
        module: ModuleId::new(1).unwrap(),
        q_min_rad: -1.0,
        q_max_rad: 1.0,
        v_max_rad_s: 2.0,
        a_max_rad_s2: 10.0,
        current_max_a: 30.0,
    }]
}

/// Violations after a conversation of (milliseconds, frame).
fn violations(expect: &Expect, frames: &[(u64, &str)]) -> Vec<String> {
    let mut checkers = Checkers::new(expect, &limits(), &hil_sim::bus::BusConfig::default());
    for (ms, frame) in frames {
        checkers.on_frame(Instant::from_micros(ms * 1_000), None, &parse_frame(frame).unwrap());
    }
    let results = checkers.finish(Instant::from_micros(1_000_000), expect);
    results.iter().flat_map(|result| result.first.iter().map(ToString::to_string)).collect()
}

fn f32_hex(value: f32) -> String {
    value.to_le_bytes().iter().map(|byte| format!("{byte:02X}")).collect()
}

#[test]
fn answers_in_time_are_fine_and_unknown_modules_are_ignored() {
    let expect = Expect { answers_within: Some(Duration::from_millis(5)), ..Expect::default() };
    let talk = [
        (0, "0C1#0A3C"),
        (1, "0A1#0A3C0000803F"),
        (2, "0E1#084F0000803E"),
        (3, "0A1#084F64"),
        (4, "0E1#0B0E0000803F"),
        (5, "0A1#0B0E000000003000"),
        (6, "0C9#0A3C"),
        (7, "061#00000000"),
        (8, "100#0F"),
    ];
    assert_eq!(violations(&expect, &talk), [""; 0]);
}

#[test]
fn missing_late_foreign_and_unreadable_answers_are_found() {
    let expect = Expect { answers_within: Some(Duration::from_millis(5)), ..Expect::default() };
    for (talk, message) in [
        (vec![(0, "0C1#0A3C")], "no answer to Get"),
        (vec![(0, "0C1#0A3C"), (9, "0A1#0A3C0000803F")], "no answer to Get"),
        (vec![(0, "0C1#0A3C"), (1, "0A1#0A410000803F")], "answers nothing that was asked"),
        (vec![(0, "0A1#00")], "answers nothing that was asked"),
        (vec![(0, "0C1#0A3C"), (1, "0A1#0A3C0000")], "is no answer of this protocol"),
        (vec![(0, "0C1#0A3C"), (1, "0A1#0A3C0000803F"), (2, "0A1#0A3C0000803F")], "answers nothing"),
    ] {
        let found = violations(&expect, &talk);
        assert!(found.iter().any(|v| v.contains(message)), "{talk:?}: {found:?}");
    }
}

#[test]
fn commands_at_the_limit_pass_and_beyond_it_or_without_number_do_not() {
    let expect = Expect { limits: true, ..Expect::default() };
    for (bytes, value, ok) in [
        ("084F", 2.0, true),
        ("084F", 2.001, false),
        ("084F", -0.1, false),
        ("0850", 10.0, true),
        ("0850", 10.1, false),
        ("0B04", 1.0, true),
        ("0B0E", -1.0, true),
        ("0B0E", 1.01, false),
        ("0B11", -2.0, true),
        ("0B11", -2.1, false),
        ("0B12", 30.0, true),
        ("0B12", 30.1, false),
        ("0B0E", f32::NAN, false),
        ("0850", f32::INFINITY, false),
    ] {
        let frame = format!("0E1#{bytes}{}", f32_hex(value));
        assert_eq!(violations(&expect, &[(0, &frame)]).is_empty(), ok, "{frame} ({value})");
    }
}

#[test]
fn motion_before_the_reference_is_reported_and_after_it_not() {
    let expect = Expect { homing: true, ..Expect::default() };
    let ramp = "0E1#0B0E0000803F";
    assert_eq!(violations(&expect, &[(0, ramp)]).len(), 1);
    // State word with HOME_OK; then a short state without NOT_OK.
    assert!(violations(&expect, &[(0, "0A1#0A2702000000"), (1, ramp)]).is_empty());
    assert!(violations(&expect, &[(0, "0A1#0A62000000000000"), (1, ramp)]).is_empty());
    assert_eq!(violations(&expect, &[(0, "0A1#0A62000000000100"), (1, ramp)]).len(), 1);
    // HOME makes it unknown again, for one module and for all.
    for home in ["0E1#01", "100#01", "100#0100"] {
        assert_eq!(violations(&expect, &[(0, "0A1#0A2702000000"), (1, home), (2, ramp)]).len(), 1, "{home}");
    }
}

#[test]
fn axis_that_moves_on_after_a_halt_is_reported() {
    let expect = Expect { stop_within: Some(Duration::from_millis(100)), ..Expect::default() };
    let at = |q: f32| format!("0A1#0A3C{}", f32_hex(q));
    let (here, there) = (at(0.5), at(0.6));
    for halt in ["0E1#02", "100#02", "100#0200"] {
        assert!(
            violations(&expect, &[(0, halt), (50, &here), (99, &there), (150, &there), (200, &there)])
                .is_empty()
        );
        let found = violations(&expect, &[(0, halt), (150, &here), (200, &there)]);
        assert!(found[0].contains("moved from 0.500000 to 0.600000 rad although halted"), "{found:?}");
        // RESET ends it.
        assert!(violations(&expect, &[(0, halt), (150, &here), (160, "0E1#00"), (200, &there)]).is_empty());
    }
}

#[test]
fn amount_of_traffic_is_bounded_from_both_sides() {
    let least = Expect { frames_min: Some(3), ..Expect::default() };
    assert_eq!(violations(&least, &[(0, "001#"), (1, "001#")]).len(), 1);
    assert!(violations(&least, &[(0, "001#"), (1, "001#"), (2, "001#")]).is_empty());
    let most = Expect { utilisation_max: Some(0.000_05), ..Expect::default() };
    // One second at 1 Mbit/s; two frames of at least 47 bits are above fifty bits.
    assert!(violations(&most, &[]).is_empty());
    assert_eq!(violations(&most, &[(0, "001#"), (1, "001#")]).len(), 1);
}
