//! How long a cycle of the published throw takes on the bus. How well it is followed: `tests/suites/controller`.

use crate::bench::*;
use firmware::state::StateKind;

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
        let mut bench = Bench::ready(Options { seed, ..Options::default() }, &throw_start());
        bench.start(&throw_file(3_000, false));
        bench.run_for(926_000);
        assert_eq!(bench.kind(), StateKind::Running, "{:?}", bench.controller.state());
        let spans = cycle_spans(&bench, 3_000);
        let at = bench.instant();
        let counters = bench.controller.take_sample(at).counters;
        let (median, worst) = (spans[spans.len() / 2], spans[spans.len() - 1]);
        println!("seed {seed}: last answer after {median} us (median), {worst} us (worst), {counters:?}");
        assert!((2_300..3_000).contains(&median));
        assert!(counters.cycles_late < 10 && counters.replies_missed == 0);
    }
}
