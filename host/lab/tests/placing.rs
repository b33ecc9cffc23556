//! `cubelab place`: the search for where the bases stand, judged with other balls, and the file that it writes.

use hil_sim::two_arms::TwoArmOptions;
use lab::rally::placing::{Placement, Search, find_place, judge};
use operator::ball_catch::trial::TrialOptions;
use planner::catch::task::{Allowed, Settings};
use serde_json::Value;

use crate::{cubelab, empty_folder};

fn options() -> TrialOptions {
    let settings = Settings { allowed: Allowed::Matched, ..Settings::default() };
    TrialOptions { settings, cooperative: true, ..TrialOptions::default() }
}

/// A catcher that stands 0.4 m too low gets faster balls. The judgement uses other balls than the search, and has 95 % intervals: of two equal
/// cells each has the larger share half of the time. With 400 balls the shares are 78 % (too low), 94 % (built in) and 93 % (raised).
#[test]
fn a_catcher_that_stands_too_low_is_raised_to_a_share_that_differs_from_the_built_in_cell_by_chance_only() {
    let cell = TwoArmOptions::two_arms().unwrap();
    let low = Placement { height_m: -0.4, ..Placement::default() }.of(&cell);
    let search = Search { throws: 60, tries: 25, yaw_deg: 0.0, height_m: 0.5, one_way: true, seed: 11 };
    let mut values = Vec::new();
    let found = find_place(&low, &options(), &search, |_, _, value| values.push(value)).unwrap();
    assert!(values.len() > 1 && values.is_sorted(), "{values:?}");
    assert!(found.height_m > 0.2 && found.yaw_deg == [0.0; 2], "{found:?}");

    let judging = Search { throws: 120, ..search };
    let share = |cell: &TwoArmOptions| judge(cell, &options(), &judging, 12).unwrap()[0].with_place;
    let (too_low, built_in, raised) = (share(&low), share(&cell), share(&found.of(&low)));
    assert!(raised.gain(&too_low).0 > 0.0, "{too_low:?} {raised:?}");
    assert!(raised.gain(&built_in).1 >= 0.0, "{built_in:?} {raised:?}");
}

#[test]
fn the_same_seed_finds_the_same_placement() {
    let cell = TwoArmOptions::two_arms().unwrap();
    let search = Search { throws: 8, tries: 4, yaw_deg: 20.0, height_m: 0.1, one_way: false, seed: 2 };
    let find = || find_place(&cell, &options(), &search, |_, _, _| ()).unwrap();
    assert_eq!(find(), find());
}

#[test]
fn the_file_has_the_bases_that_were_judged_and_is_read_as_a_cell() {
    let file = empty_folder("place").join("placed.toml");
    let words = "place --distance-m 2.2 --throws 6 --tries 3 --json --out";
    let output = cubelab(&format!("{words} {}", file.display()));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    let directions = result["judged"][0]["directions"].as_array().unwrap();
    assert_eq!((directions.len(), &directions[0]["with_place"]["of"]), (2, &6.into()), "{result}");
    let placed = TwoArmOptions::load(&file).unwrap();
    let apart_m = (placed.arms[1].x_wb.pos - placed.arms[0].x_wb.pos).norm();
    assert!((apart_m - 2.2).abs() < 1e-5, "{apart_m}");
}

#[test]
fn arms_that_cannot_throw_so_far_are_refused() {
    let output = cubelab("place --distance-m 9 --throws 1 --tries 0");
    assert_eq!(output.status.code(), Some(i32::from(host::exit::NO_THROW)), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("9 m away"), "{output:?}");
}
