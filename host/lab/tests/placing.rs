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

/// A catcher that stands 0.4 m too low gets faster balls. The search raises it, and the balls that judge it are others.
#[test]
fn an_arm_that_stands_too_low_is_raised_until_about_as_many_balls_have_a_place_as_in_the_built_in_cell() {
    let cell = TwoArmOptions::two_arms().unwrap();
    let low = Placement { height_m: -0.4, ..Placement::default() }.of(&cell);
    let search = Search { throws: 60, tries: 25, yaw_deg: 0.0, height_m: 0.5, one_way: true, seed: 11 };
    let mut shares = Vec::new();
    let found = find_place(&low, &options(), &search, |_, _, share| shares.push(share)).unwrap();
    assert!(shares.len() > 1 && shares.is_sorted(), "{shares:?}");
    assert!(found.height_m > 0.2 && found.yaw_deg == [0.0; 2], "{found:?}");

    let share = |cell: &TwoArmOptions| judge(cell, &options(), &search, 12).unwrap()[0].with_place;
    let (too_low, built_in, raised) = (share(&low), share(&cell), share(&found.of(&low)));
    // The balls are not the same ones: 60 of them do not tell one ball more from one less.
    assert!(raised.value() >= built_in.wilson().0, "{built_in:?} {raised:?}");
    assert!(raised.wilson().0 > too_low.value(), "{too_low:?} {raised:?}");
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
