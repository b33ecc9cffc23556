//! The published throw on the bench: how well it is followed, and how long a cycle takes on the bus.

use crate::bench::*;
use firmware::settings::Settings;
use firmware::state::StateKind;
use protocol::JointIndex;

/// Outcome of one throw.
#[derive(Debug, Default)]
struct Errors {
    position_max: [f64; 6],
    speed_max: [f64; 6],
    position_late_max: f64,
    at_release: (f64, f64),
    below_50_mrad_after: f64,
}

fn throw(settings: Settings, offset: f64, seed: u64) -> (Errors, Bench) {
    let mut settings = settings;
    for joint in JointIndex::first(6) {
        settings.joint.at_mut(joint).start_tolerance_rad = 0.15;
    }
    let start = throw_start().map(|q| q + offset);
    let options = Options { settings, seed, ..Options::default() };
    let mut bench = Bench::ready(options, &start);
    let file = throw_file(settings.cycle_period_us, false);
    bench.start(&file);
    let t0 = bench.now + 2 * u64::from(settings.cycle_period_us);
    let mut errors = Errors::default();
    while bench.kind() == StateKind::Running && bench.now < t0 + 920_000 {
        bench.run_for(500);
        let t = (bench.now as f64 - t0 as f64) * 1e-6;
        let mut worst = (0.0f64, 0.0f64);
        for (i, drive) in bench.drives.iter().enumerate() {
            let (q, qd) = throw_reference(i, t);
            let (e, de) = ((drive.q - q).abs(), (drive.v - qd).abs());
            errors.position_max[i] = errors.position_max[i].max(e);
            worst = (worst.0.max(e), worst.1.max(de));
            if t > 0.35 {
                errors.speed_max[i] = errors.speed_max[i].max(de);
            }
        }
        if t > 0.35 {
            errors.position_late_max = errors.position_late_max.max(worst.0);
        }
        if worst.0 > 0.05 {
            errors.below_50_mrad_after = t;
        }
        if (t - HA).abs() < 2.6e-4 {
            errors.at_release = worst;
        }
    }
    assert_eq!(
        bench.kind(),
        StateKind::Running,
        "{:?} {:?}",
        bench.controller.state(),
        bench.controller.freeze_frame()
    );
    (errors, bench)
}

#[test]
fn throw_from_rest_on_the_path_stays_close_to_it_at_both_periods() {
    for (name, settings, position, speed) in
        [("17 ms", Settings::powercube6_paper(), 5e-3, 0.05), ("3 ms", Settings::powercube6(), 2e-3, 0.03)]
    {
        let (errors, bench) = throw(settings, 0.0, 1);
        println!("{name}: {errors:?}");
        println!("{:?}", bench.controller.group().drive(joint(5)).counters);
        let worst = errors.position_max.iter().fold(0.0f64, |a, &b| a.max(b));
        assert!((1e-5..position).contains(&worst), "{name}: {worst}");
        assert!(errors.at_release.1 < speed, "{name}");
    }
}

#[test]
fn throw_from_a_tenth_of_a_radian_beside_the_path_comes_back_to_it() {
    for (name, settings) in [("17 ms", Settings::powercube6_paper()), ("3 ms", Settings::powercube6())] {
        let (errors, mut bench) = throw(settings, 0.1, 1);
        println!("{name}: {errors:?}");
        assert!((0.01..0.25).contains(&errors.below_50_mrad_after), "{name}");
        let at = bench.instant();
        let saturated = bench.controller.take_sample(at).counters.cycles_saturated;
        assert!(saturated > 3, "{name}: {saturated} cycles in which a joint had all of its acceleration");
    }
}

/// From the start of a control cycle to the end of its last motion's answer, µs, sorted.
fn cycle_spans(bench: &Bench, period_us: u64) -> Vec<u64> {
    use protocol::powercube::{Address, Channel, Command};
    let first = bench.log.iter().position(|l| l.by_controller && is_motion(&l.frame)).unwrap();
    // The cycle that sends the first motion began with the write before it.
    let run = bench.controller.trace().iter().find_map(|(at, event)| match event {
        firmware::trace::TraceEvent::State { to: StateKind::Running, .. } => Some(at.as_micros() + 1),
        _ => None,
    });
    let run = run.unwrap();
    let mut last_of_cycle = std::collections::BTreeMap::new();
    for l in &bench.log[first..] {
        let from_drive = matches!(Address::of(l.frame.id()), Some(Address::Module(Channel::Ack, _)));
        if from_drive && l.frame.data().first() == Some(&Command::SetMotion.code()) {
            let since = l.at.as_micros() - run;
            last_of_cycle.insert(since / period_us, since % period_us);
        }
    }
    let mut spans: Vec<u64> =
        last_of_cycle.into_iter().filter(|(k, _)| (3..290).contains(k)).map(|(_, s)| s).collect();
    spans.sort_unstable();
    spans
}

#[test]
fn full_commands_to_six_drives_fit_into_three_milliseconds_with_answers_of_100_to_300_us() {
    for seed in 1..6 {
        let (_, mut bench) = throw(Settings::powercube6(), 0.0, seed);
        let spans = cycle_spans(&bench, 3_000);
        let at = bench.instant();
        let counters = bench.controller.take_sample(at).counters;
        let (median, worst) = (spans[spans.len() / 2], spans[spans.len() - 1]);
        println!("seed {seed}: last answer after {median} us (median), {worst} us (worst), {counters:?}");
        assert!((2_300..3_000).contains(&median));
        assert!(counters.cycles_late < 10 && counters.replies_missed == 0);
    }
}
