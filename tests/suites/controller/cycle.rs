//! How long a control cycle takes with faster and slower drives, what is left of its period, and that too little is
//! found before the throw, not in it.

use cell_tests::published_throw::{HA_S, HB_S};
use firmware::fault::{Cause, Refusal};
use firmware::groups::powercube::order::Order;
use firmware::groups::powercube::slots::Slots;
use firmware::settings::Settings;
use firmware::state::StateKind;
use hil_sim::fault::{Fault, FaultKind, PhysicalFault, Place, Target};
use protocol::{Duration, ModuleId};

use super::lab::{Lab, Situation};

/// What a throw with drives of one kind gave.
enum Cycles {
    Refused { period_us: u16 },
    Ran { worst_us: u32, late: u16, cycles: u32 },
}

fn throw(settings: &Settings, answer_us: (u64, u64), seed: u64) -> Cycles {
    let mut lab = Lab::new(settings, &Situation { answer_us, ..Situation::nominal(seed) });
    let period_us = settings.cycle_period_us;
    let head =
        format!("{:>4} +- {:3} us, period {:5.1} ms", answer_us.0, answer_us.1, f64::from(period_us) / 1e3);
    if let Err(refusal) = lab.try_start() {
        let Refusal { cause: Cause::CycleTooShort, joint: None, index } = refusal else {
            panic!("{refusal:?}")
        };
        println!("{head}: refused, {:.1} ms would do", f64::from(index) / 1e3);
        assert_eq!(lab.watch.motions, 0);
        return Cycles::Refused { period_us: index };
    }
    let controller = lab.controller();
    let (_, checked_us) = controller.group().cycle_times(controller.settings());
    let before = lab.world.bus_report();
    lab.run(900_000);
    assert_eq!(lab.kind(), StateKind::Running, "{head}: {:?}", lab.controller().state());
    let after = lab.world.bus_report();
    let busy = after.utilisation * after.elapsed_s - before.utilisation * before.elapsed_s;
    let utilisation = busy / (after.elapsed_s - before.elapsed_s);
    lab.run(500_000);
    let controller = lab.controller();
    let (times, _) = controller.group().cycle_times(controller.settings());
    let mean_us = times.sum_us / times.cycles.max(1);
    let slack = |us: u32| i64::from(period_us) - i64::from(us);
    let late = lab.controller().counters().cycles_late;
    println!(
        "{head}: bus {:4.1} %, timing check {} us, mean {mean_us} us, worst {} us; slack mean {} us, least {} us; \
         {late} of {} late",
        100.0 * utilisation,
        checked_us.unwrap_or(0),
        times.worst_us,
        slack(mean_us),
        slack(times.worst_us),
        times.cycles
    );
    assert_eq!(lab.kind(), StateKind::Ready, "{head}: {:?}", lab.controller().state());
    assert_eq!(lab.findings(), Vec::<String>::new(), "{head}");
    assert!((0.05..0.99).contains(&utilisation), "{head}");
    // The timing check gives what comes: a full bus, or slots further apart where the period has room.
    let checked_us = checked_us.unwrap_or(0);
    let expected =
        f64::from(checked_us.max(Slots::plan(settings, checked_us, &Order::BASE_FIRST).cycle_us()));
    assert!((0.85..1.35).contains(&(expected / f64::from(mean_us))), "{head}: {expected}");
    Cycles::Ran { worst_us: times.worst_us, late, cycles: times.cycles }
}

#[test]
fn default_period_holds_with_drives_that_answer_in_200_us_give_or_take_100() {
    for seed in 1..=3 {
        let Cycles::Ran { worst_us, late, cycles } = throw(&Settings::powercube6(), (200, 100), seed) else {
            panic!("refused")
        };
        assert!((2_000..3_000).contains(&worst_us), "{worst_us}");
        assert!(u32::from(late) * 50 <= cycles, "{late} of {cycles} late");
    }
}

/// A throw is refused with the period that would do, or it comes to its end; the slower the drives, the longer the cycle.
#[test]
fn slow_drives_are_refused_before_the_throw_and_never_stop_it() {
    let mut refused_us = Vec::new();
    for answer_us in
        [(50, 0), (100, 50), (300, 100), (400, 0), (400, 100), (500, 100), (700, 100), (1_000, 100)]
    {
        if let Cycles::Refused { period_us } = throw(&Settings::powercube6(), answer_us, 1) {
            refused_us.push(period_us);
        }
    }
    assert!(!refused_us.is_empty(), "a millisecond of thinking does not fit into three");
    assert!(
        refused_us.is_sorted() && refused_us.iter().all(|us| (3_000..12_000).contains(us)),
        "{refused_us:?}"
    );
}

#[test]
fn the_period_of_the_paper_holds_with_the_slowest_drives() {
    for answer_us in [(400, 100), (1_000, 200), (2_000, 200)] {
        assert!(matches!(throw(&Settings::powercube6_paper(), answer_us, 1), Cycles::Ran { late: 0, .. }));
    }
}

/// After the last command of a run nothing is answered in each cycle. So an answer that comes late to the last command is one
/// late cycle, and not one more in each cycle of the ramp to the end.
#[test]
fn late_answers_to_the_last_commands_of_a_run_stop_nothing() {
    let settings = Settings::powercube6();
    let module = ModuleId::new(6).unwrap();
    let mut late = 0;
    for before_end_us in (0..9_000).step_by(500) {
        let mut lab = Lab::new(&settings, &Situation::nominal(1));
        let start = lab.start();
        let end = start
            + Duration::from_micros(((HA_S + HB_S) * 1e6) as u64 + 2 * u64::from(settings.cycle_period_us));
        lab.run(end.saturating_since(lab.world.now()).as_micros() - before_end_us);
        let fault = Fault {
            label: "slow".to_owned(),
            kind: FaultKind::Physical(Place::Module(module), PhysicalFault::Slow(Duration::from_micros(900))),
            target: Target::Module(module),
            filter: None,
            start: lab.world.now(),
            at: None,
            length: Some(Duration::from_micros(5_500)),
            every: None,
            probability: 1.0,
        };
        lab.world.add_fault(fault).unwrap();
        lab.run(600_000);
        assert_eq!(lab.kind(), StateKind::Ready, "{before_end_us}: {:?}", lab.controller().state());
        late += u32::from(lab.controller().counters().cycles_late);
    }
    assert!((5..200).contains(&late), "the fault acts: {late}");
}
