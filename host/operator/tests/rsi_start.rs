//! Robots that send telegrams but are never ready: the answers of the station, and the state that it reports.

use crate::rsi_common::arm;
use firmware::state::StateKind;
use hil_sim::krc::KrcScenario;
use operator::rsi::program::{Lag, leading};
use operator::rsi::station::Station;
use protocol::Instant;

fn station() -> Station {
    let described = KrcScenario::open("kr-c2").expect("built in");
    leading(&described, &arm(), Lag::of(&described), &[]).expect("a station")
}

fn axes(name: &str, a1: &str) -> String {
    format!("<{name} A1=\"{a1}\" A2=\"-90.0\" A3=\"90.0\" A4=\"0.0\" A5=\"90.0\" A6=\"0.0\"/>")
}

/// A telegram in which A1 is written so; the start pose is zero.
fn telegram(ipoc: u64, a1: &str) -> Vec<u8> {
    let (actual, start) = (axes("AIPos", a1), axes("ASPos", "0.0"));
    format!("<Rob Type=\"KUKA\">{actual}{start}<Delay D=\"0\"/><IPOC>{ipoc}</IPOC></Rob>").into_bytes()
}

/// Gets such telegrams for eleven seconds; returns the answers and the reported state.
fn heard(of: impl Fn(u64) -> Vec<u8>) -> (Station, usize, Option<String>) {
    let mut station = station();
    let mut answers = 0;
    let mut at = Instant::ZERO;
    for ipoc in 1..920 {
        at = Instant::from_micros(12_000 * ipoc);
        while station.poll_timeout().is_some_and(|due| due <= at) {
            station.handle_timeout(at);
        }
        answers += usize::from(station.handle(at, &[of(ipoc)], false).is_some());
    }
    let words = station.waits_in_vain(at);
    (station, answers, words)
}

#[test]
fn small_number_with_an_exponent_is_a_number() {
    let (station, answers, words) = heard(|ipoc| telegram(ipoc, "-7.1e-05"));
    assert_eq!((station.state(), answers, words), (StateKind::Ready, 919, None));
}

#[test]
fn wait_for_a_robot_without_axes_ends_with_what_was_heard() {
    let (_, _, words) = heard(|ipoc| format!("<Rob Type=\"KUKA\"><IPOC>{ipoc}</IPOC></Rob>").into_bytes());
    let words = words.expect("in vain");
    assert!(words.contains("0 telegrams with axes, 919 without"), "{words}");
}

#[test]
fn wait_for_telegrams_that_cannot_be_read_ends_with_why() {
    let (_, answers, words) = heard(|ipoc| telegram(ipoc, "1,5"));
    let words = words.expect("in vain");
    assert!(answers == 0 && words.contains("919 that cannot be read") && words.contains("1,5"), "{words}");
}

#[test]
fn robot_away_from_its_start_pose_is_given_nothing_and_the_wait_ends_with_its_axis() {
    let (station, answers, words) = heard(|ipoc| telegram(ipoc, "5.0"));
    let words = words.expect("in vain");
    assert_eq!((station.state(), answers), (StateKind::Boot, 0));
    assert!(words.contains("A1 is 5.00 deg from the start pose"), "{words}");
}

#[test]
fn start_pose_that_moves_with_the_axes_is_noticed() {
    let moving = |ipoc: u64| {
        let a1 = format!("{:.4}", 0.01 * ipoc as f64);
        let (actual, start) = (axes("AIPos", &a1), axes("ASPos", &a1));
        format!("<Rob Type=\"KUKA\">{actual}{start}<Delay D=\"0\"/><IPOC>{ipoc}</IPOC></Rob>").into_bytes()
    };
    let (station, _, _) = heard(moving);
    assert!(station.start_pose_moves() && station.heard().contains("ASPos"), "{}", station.heard());
}
