//! Drives whose answers are wrong, and drives that do not execute their commands: found in a stated number of
//! cycles, stopped within a stated way, named. Judged by the true position of the bench's drive, which no answer
//! shows.

use crate::bench::*;
use firmware::fault::{Cause, Fault};
use firmware::orders::Order;
use firmware::settings::Settings;
use firmware::state::StateKind;
use protocol::Duration;
use protocol::powercube::CubeState;

/// Arm on the throw, `into_us` after the start of the plan.
fn thrown(settings: Settings, into_us: u64, seed: u64) -> Bench {
    let mut bench = Bench::ready(Options { settings, seed, ..Options::default() }, &throw_start());
    bench.start(&throw_file(settings.cycle_period_us, true));
    bench.run_for(2 * u64::from(settings.cycle_period_us) + into_us);
    assert_eq!(bench.kind(), StateKind::Running);
    bench
}

/// Result for a faulty drive.
struct Found {
    cause: Option<Fault>,
    /// Cycles until the group stopped.
    cycles: u64,
    /// From where the joint was when its drive went wrong to the farthest point until rest, rad.
    excursion_rad: f64,
    speed_max_rad_s: f64,
    /// The joint's speed at the begin of the fault, rad/s.
    v_rad_s: f64,
}

fn struck(mut bench: Bench, index: usize, wrong: Wrong) -> Found {
    let period_us = u64::from(bench.controller.settings().cycle_period_us);
    let (q0, v_rad_s) = (bench.drives[index].q, bench.drives[index].speed());
    let from = bench.now;
    bench.drives[index].wrong = Some(wrong);
    let mut found = Found { cause: None, cycles: 0, excursion_rad: 0.0, speed_max_rad_s: 0.0, v_rad_s };
    let mut stopped_at = None;
    while bench.now < from + 3_000_000 && !(bench.kind() == StateKind::Fault && bench.now > from + 1_500_000)
    {
        bench.run_for(250);
        if stopped_at.is_none() && matches!(bench.kind(), StateKind::Stopping | StateKind::Fault) {
            stopped_at = Some(bench.now);
        }
        let drive = &bench.drives[index];
        found.excursion_rad = found.excursion_rad.max((drive.q - q0).abs());
        found.speed_max_rad_s = found.speed_max_rad_s.max(drive.speed().abs());
    }
    found.cause = bench.controller.state().fault();
    found.cycles = (stopped_at.unwrap_or(bench.now) - from).div_ceil(period_us);
    let speed = bench.drives.iter().map(|drive| drive.speed().abs()).fold(0.0, f64::max);
    assert!(speed < 0.01, "{wrong:?} at joint {index}: {speed} rad/s in the end");
    found
}

fn periods() -> [(&'static str, Settings); 2] {
    [("3 ms", Settings::powercube6()), ("17 ms", Settings::powercube6_paper())]
}

#[test]
fn each_way_to_be_wrong_is_named_and_stopped_in_its_cycles() {
    for (name, settings) in periods() {
        for (wrong, causes, cycles_max) in [
            ("reversed", &[Cause::MotionReversed, Cause::ReplyImplausible][..], [4, 3]),
            ("creeping", &[Cause::MotionNotFollowed][..], [12, 6]),
            ("offset of 12 mrad", &[Cause::PositionJumped][..], [4, 4]),
            ("offset of 0.1 rad", &[Cause::ReplyImplausible, Cause::VelocityLimit][..], [4, 4]),
            ("deaf", &[Cause::MotionNotFollowed, Cause::PositionFrozen][..], [40, 12]),
        ] {
            let bench = thrown(settings, 350_000, 7);
            let q = bench.drives[1].q;
            let kind = match wrong {
                "reversed" => Wrong::Reversed(q),
                "creeping" => Wrong::Creeping(q, 0.6),
                "offset of 12 mrad" => Wrong::Offset(0.012),
                "offset of 0.1 rad" => Wrong::Offset(0.1),
                _ => Wrong::Deaf,
            };
            let found = struck(bench, 1, kind);
            println!(
                "{name}: {wrong} at {:.2} rad/s: {:?} after {} cycles, {:.3} rad",
                found.v_rad_s, found.cause, found.cycles, found.excursion_rad
            );
            let fault = found.cause.unwrap();
            assert!(
                causes.contains(&fault.cause) && fault.joint == Some(joint(1)),
                "{name} {wrong}: {fault:?}"
            );
            let most = cycles_max[usize::from(name == "17 ms")];
            assert!((1..=most).contains(&found.cycles), "{name} {wrong}: {} cycles", found.cycles);
        }
    }
}

/// Joint 4 hardly moves in the throw: it moves away by itself.
#[test]
fn drive_that_moves_while_it_is_commanded_to_rest_is_named() {
    for (name, settings) in periods() {
        for speed in [0.3, -1.0] {
            let mut bench = thrown(settings, 300_000, 3);
            bench.drives[3].slips_rad_s = speed;
            let from = bench.now;
            bench.run_until(300_000, |bench| bench.kind() != StateKind::Running);
            let ms = (bench.now - from) / 1_000;
            let fault = bench.controller.state().fault().unwrap();
            println!("{name}: moves with {speed} rad/s: {fault:?} after {ms} ms");
            assert_eq!(fault.joint, Some(joint(3)));
            assert!(
                matches!(
                    fault.cause,
                    Cause::MovesUnordered | Cause::MotionNotFollowed | Cause::MotionReversed
                ),
                "{fault:?}"
            );
            assert!((3..=60).contains(&ms), "{ms} ms");
        }
    }
}

#[test]
fn jogged_joint_that_does_not_move_as_ordered_stops() {
    for (wrong, cause) in [
        (Wrong::Frozen(0.0), Cause::PositionFrozen),
        (Wrong::Reversed(0.0), Cause::MotionReversed),
        (Wrong::Creeping(0.0, 0.4), Cause::MotionNotFollowed),
        (Wrong::Deaf, Cause::PositionFrozen),
    ] {
        let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
        bench.drives[2].wrong = Some(wrong);
        let jog = Order::Jog { joint: joint(2), qd_rad_s: 0.25, hold: Duration::from_millis(200) };
        let from = bench.now;
        while bench.now < from + 1_000_000 && bench.kind() != StateKind::Fault {
            if bench.order(jog).is_err() {
                break;
            }
            bench.run_for(50_000);
        }
        bench.run_for(1_000_000);
        println!("{wrong:?}: {:?}, {:.4} rad", bench.controller.state().fault(), bench.drives[2].q);
        assert_eq!(bench.controller.state().fault(), Some(Fault::at(cause, joint(2))), "{wrong:?}");
        // Way of a jog until the fault is detected, and its ramp to rest.
        assert!(bench.drives[2].q.abs() < 0.08, "{wrong:?}: {} rad", bench.drives[2].q);
    }
}

/// The stop must not use the position of the faulty drive: it uses the position to which the commands have led the joint.
#[test]
fn stop_of_a_group_with_a_wrong_position_is_computed_from_the_commands() {
    let bench = thrown(Settings::powercube6(), 350_000, 5);
    let (q0, v) = (bench.drives[1].q, bench.drives[1].speed());
    // Answers that are off by a third of a radian, one answer at a time too small to be implausible.
    let found = struck(bench, 1, Wrong::Reversed(q0));
    let straight = v.abs() * 0.012 + 0.5 * v * v / 10.4;
    assert!(
        (0.3 * straight..1.5 * straight).contains(&found.excursion_rad),
        "{} {straight}",
        found.excursion_rad
    );
}

/// One lost answer leaves two possible motions; neither is reported as a fault.
#[test]
fn lost_answers_do_not_make_the_gate_object() {
    for (name, settings) in periods() {
        for seed in 0..20u64 {
            let mut bench = thrown(settings, 20_000 + 3_700 * seed, seed);
            for turn in 0..8 {
                bench.drives[((seed + turn) % 6) as usize].drop_replies = 1;
                bench.run_for(90_000);
            }
            bench.run_until(2_000_000, |bench| bench.kind() != StateKind::Running);
            assert_eq!(bench.kind(), StateKind::Ready, "{name}, seed {seed}: {:?}", bench.controller.state());
            let missed: u16 = (0..6).map(|i| bench.controller.group().drive(joint(i)).counters.missed).sum();
            assert!((6..=8).contains(&missed), "{missed}");
        }
    }
}

/// The law commands all the acceleration that the joints have; the drives respond as modelled.
#[test]
fn starts_beside_the_path_do_not_make_the_gate_object() {
    for (name, mut settings) in periods() {
        for j in 0..6 {
            settings.joint.at_mut(joint(j)).start_tolerance_rad = 0.15;
        }
        for (offset, seed) in [(0.1, 1), (-0.1, 2), (0.03, 3)] {
            let start = throw_start().map(|q| q + offset);
            let mut bench = Bench::ready(Options { settings, seed, ..Options::default() }, &start);
            bench.start(&throw_file(settings.cycle_period_us, true));
            let mut worst = 0.0f32;
            for _ in 0..120 {
                bench.run_for(10_000);
                for index in 0..6 {
                    let model = bench.controller.group().drive_model(joint(index));
                    worst = worst.max(model.r_rad().abs() / model.r_max_rad());
                    worst = worst.max(model.drift_rad_s().abs() / model.drift_max_rad_s());
                }
            }
            bench.run_until(2_000_000, |bench| bench.kind() != StateKind::Running);
            assert_eq!(bench.kind(), StateKind::Ready, "{name}, {offset}: {:?}", bench.controller.state());
            println!(
                "{name}, {offset} rad beside the path: residual at most {:.0} % of the gate",
                100.0 * worst
            );
            assert!((0.01..0.7).contains(&worst), "{name}, {offset}: {worst}");
        }
    }
}

/// A processor that is busy for a while reads the answers late, so their times are unknown. This is not a fault of
/// a drive: the throw continues, or ends because cycles begin too late, or because the drives got no sign of life
/// for too long and stopped by themselves.
#[test]
fn a_controller_that_is_held_up_blames_no_drive() {
    for (name, settings) in periods() {
        for hold_us in [900, 1_800, 3_000, 5_100, 9_000, 17_000, 51_000] {
            let (mut ends, mut worst) = (std::collections::BTreeMap::<Option<Cause>, usize>::new(), 0.0f32);
            for seed in 0..12u64 {
                let mut bench = thrown(settings, 20_000 + 1_370 * seed, seed);
                let mut starved = false;
                while bench.kind() == StateKind::Running {
                    let between_us = 20_000 + bench.rng.below(60_000);
                    bench.hold_up(hold_us);
                    for _ in 0..between_us / 500 {
                        bench.run_for(500);
                        starved |=
                            bench.drives.iter().any(|drive| drive.state.contains(CubeState::COMM_ERROR));
                        for index in (0..6).filter(|_| bench.kind() == StateKind::Running && !starved) {
                            let model = bench.controller.group().drive_model(joint(index));
                            worst = worst.max(model.r_rad().abs() / model.r_max_rad());
                            worst = worst.max(model.drift_rad_s().abs() / model.drift_max_rad_s());
                        }
                    }
                }
                bench.run_for(500_000);
                let cause = bench.controller.state().fault().map(|fault| fault.cause);
                let is_true = match cause {
                    None => bench.kind() == StateKind::Ready,
                    Some(Cause::CycleOverrun) => true,
                    Some(_) => starved,
                };
                assert!(is_true, "{name}, {hold_us} us, seed {seed}: {:?}", bench.controller.state());
                *ends.entry(cause).or_default() += 1;
            }
            println!("{name}, held up for {hold_us} us: {ends:?}, residual at most {:.0} %", 100.0 * worst);
            assert!((0.02..0.67).contains(&worst), "{name}, {hold_us} us: {worst}");
            // A pause shorter than half the time-out of a watchdog does not let it expire.
            let own =
                ends.iter().filter(|(cause, _)| !matches!(cause, None | Some(Cause::CycleOverrun))).count();
            assert!(own == 0 || hold_us > 20_000, "{name}, {hold_us} us: {ends:?}");
        }
    }
}
