//! Many throws that are never the nominal one: masses, friction, motors, answer times and the start pose drawn from a seed,
//! and in most of them something happens. Invariants are judged from the bus and from the plant, not by the controller.
//!
//! `cargo test --release -p cell-tests --test controller -- --ignored --nocapture`; `SEEDS` sets how many.

use std::collections::BTreeMap;

use firmware::fault::Cause;
use firmware::orders::Order;
use firmware::settings::Settings;
use firmware::state::StateKind;
use hil_sim::fault::{Fault, FaultKind, Target, WireFault};
use hil_sim::mechanics::Scatter;
use planner::plan::rng::SplitMix64;
use protocol::{Duration, JointIndex, ModuleId};
use rayon::prelude::*;

use super::lab::{Lab, Situation};

/// What happens in a throw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum SwarmEvent {
    Nothing,
    /// One drive hears nothing for a third of a cycle.
    LostFrame,
    /// One drive hears nothing for four cycles.
    LostCycles,
    StopOrder,
    StopMessage,
    HostLost,
    SilentDrive,
}

const EVENTS: [SwarmEvent; 7] = [
    SwarmEvent::Nothing,
    SwarmEvent::LostFrame,
    SwarmEvent::LostCycles,
    SwarmEvent::StopOrder,
    SwarmEvent::StopMessage,
    SwarmEvent::HostLost,
    SwarmEvent::SilentDrive,
];

/// Control period of the settings.
const CYCLE_US: u64 = 3_000;
/// A host that was not heard for so long is lost.
const HOST_TIMEOUT_US: u64 = 103_000;

struct Rng(SplitMix64);

impl Rng {
    fn below(&mut self, n: u64) -> u64 {
        self.0.next_u64() % n
    }
}

struct Outcome {
    event: SwarmEvent,
    end: StateKind,
    cause: Option<Cause>,
    /// From the event to the halt broadcast, µs.
    halt_us: Option<u64>,
    /// From the event to the end of the run, µs.
    ended_us: Option<u64>,
    refused: bool,
    /// Mean answer time of the drives and its jitter, µs.
    answer_us: (u64, u64),
    wrong: Vec<String>,
}

fn throw(seed: u64) -> Outcome {
    let mut rng = Rng(SplitMix64::new(seed));
    let event = EVENTS[seed as usize % EVENTS.len()];
    let mut settings = Settings::powercube6();
    for joint in JointIndex::first(6) {
        settings.joint.at_mut(joint).start_tolerance_rad = 0.05;
    }
    let scatter = Scatter {
        mass_share: 0.2,
        com_m: 0.01,
        friction_share: 0.5,
        rotor_share: 0.2,
        current_share: 0.1,
        delay_share: 0.3,
        home_rad: 0.002,
        gripper_delay: Duration::from_millis(2),
    };
    let answer_us = (100 + rng.below(200), rng.below(100));
    let offset_rad = (rng.below(60) as f64 - 30.0) * 1e-3;
    let mut lab = Lab::new(&settings, &Situation { offset_rad, answer_us, scatter, seed });
    let mut outcome = Outcome {
        event,
        end: StateKind::Boot,
        cause: None,
        halt_us: None,
        ended_us: None,
        refused: false,
        answer_us,
        wrong: Vec::new(),
    };
    let started = lab.try_start();
    if let Err(refusal) = started {
        outcome.refused = true;
        if refusal.cause != Cause::CycleTooShort || lab.watch.motions > 0 {
            outcome.wrong.push(format!("refused: {refusal:?}, {} motions", lab.watch.motions));
        }
    } else {
        let drive = 1 + rng.below(6) as u8;
        let at_ms = 20 + rng.below(850);
        let mut struck = None;
        for ms in 0..2_500 {
            if ms == at_ms {
                struck = Some(lab.world.now());
                strike(&mut lab, event, drive);
            }
            lab.run(1_000);
            judge_plant(&lab, &settings, &mut outcome.wrong);
            if !lab.kind().may_move() {
                break;
            }
        }
        outcome.end = lab.kind();
        outcome.ended_us = struck.map(|from| lab.world.now().saturating_since(from).as_micros());
        outcome.cause = lab.controller().state().fault().map(|fault| fault.cause);
        // Whatever comes after the motion is none.
        lab.run(5_000);
        lab.watch.allowed = false;
        lab.run(600_000);
        let halt_at = lab.watch.halt_at;
        outcome.halt_us = struck.zip(halt_at).map(|(from, to)| to.saturating_since(from).as_micros());
        let cell = &lab.world.participants().0;
        for i in 0..6 {
            let v = cell.plant().axis(i).v_rad_s;
            if v.abs() > 0.02 {
                outcome.wrong.push(format!("axis {} at {v} rad/s in the end", i + 1));
            }
        }
    }
    judge_end(&mut outcome);
    outcome.wrong.extend(lab.findings());
    outcome
}

fn strike(lab: &mut Lab, event: SwarmEvent, drive: u8) {
    // The watchdog test of start-up halted, too.
    lab.watch.halt_at = None;
    let mut plan = |wire, length_us: Option<u64>| {
        lab.world
            .add_fault(Fault {
                label: "struck".to_owned(),
                kind: FaultKind::Wire(wire),
                target: Target::Module(ModuleId::new(drive).unwrap()),
                filter: None,
                start: lab.world.now(),
                length: length_us.map(Duration::from_micros),
                every: None,
                probability: 1.0,
            })
            .unwrap();
    };
    match event {
        SwarmEvent::Nothing => {}
        SwarmEvent::LostFrame => plan(WireFault::Drop, Some(CYCLE_US / 3)),
        SwarmEvent::LostCycles => plan(WireFault::Drop, Some(4 * CYCLE_US)),
        SwarmEvent::SilentDrive => plan(WireFault::Silent, None),
        SwarmEvent::StopOrder => {
            lab.order(Order::Stop);
        }
        SwarmEvent::StopMessage => lab.stop_now(),
        SwarmEvent::HostLost => lab.heartbeat = false,
    }
}

/// Where the arm really is, and how fast.
fn judge_plant(lab: &Lab, settings: &Settings, wrong: &mut Vec<String>) {
    let cell = &lab.world.participants().0;
    for joint in JointIndex::first(6) {
        let limits = settings.joint.at(joint);
        let (q, v) = (cell.plant().link_q_rad(joint.get()), cell.plant().axis(joint.get()).v_rad_s);
        let (low, high) = (f64::from(limits.q_min_rad) - 0.02, f64::from(limits.q_max_rad) + 0.02);
        if !(low..=high).contains(&q) || v.abs() > 1.1 * f64::from(limits.v_max_rad_s) + 0.05 {
            wrong.push(format!("{}: joint {} at {q} rad, {v} rad/s", lab.world.now(), joint.get() + 1));
        }
    }
}

/// The end that the event leads to, in its time.
fn judge_end(outcome: &mut Outcome) {
    use StateKind::{Fault, Ready, Stopped};
    if outcome.refused {
        return;
    }
    // An event of the last moment may come too late to matter: only then the run may end as if nothing had happened.
    let too_late = |reaction_us: u64| outcome.ended_us.is_none_or(|us| us <= reaction_us);
    let (end, halt_max_us) = match outcome.event {
        SwarmEvent::Nothing | SwarmEvent::LostFrame => ((Ready, None), None),
        SwarmEvent::LostCycles => ((Fault, Some(Cause::DriveSilent)), Some(500_000)),
        SwarmEvent::StopOrder => ((Stopped, Some(Cause::StopOrdered)), Some(1_200_000)),
        SwarmEvent::StopMessage => ((Stopped, Some(Cause::StopMessage)), Some(1_000)),
        SwarmEvent::HostLost if outcome.end == Ready && too_late(HOST_TIMEOUT_US) => ((Ready, None), None),
        SwarmEvent::HostLost => ((Fault, Some(Cause::HostLost)), Some(1_303_000)),
        SwarmEvent::SilentDrive => ((Fault, Some(Cause::DriveSilent)), Some(500_000)),
    };
    if end != (outcome.end, outcome.cause) {
        outcome.wrong.push(format!("ended in {:?} by {:?}", outcome.end, outcome.cause));
    }
    let late = halt_max_us.is_some_and(|most| outcome.halt_us.is_some_and(|us| us > most));
    let missing = matches!(outcome.end, Fault | Stopped) && outcome.halt_us.is_none();
    if late || missing {
        outcome.wrong.push(format!("halt after {:?} us", outcome.halt_us));
    }
}

fn swarm(seeds: u64) {
    let outcomes: Vec<(u64, Outcome)> = (0..seeds).into_par_iter().map(|seed| (seed, throw(seed))).collect();
    let mut table: BTreeMap<SwarmEvent, (u32, u32, u64)> = BTreeMap::new();
    for (_, outcome) in &outcomes {
        let (count, refused, halt_us) = table.entry(outcome.event).or_default();
        *count += 1;
        *refused += u32::from(outcome.refused);
        *halt_us = (*halt_us).max(outcome.halt_us.unwrap_or(0));
    }
    for (event, (count, refused, halt_us)) in table {
        println!(
            "{event:?}: {count} throws, {refused} refused for slow answers, halt after at most {halt_us} us"
        );
    }
    let wrong: Vec<String> = outcomes
        .iter()
        .flat_map(|(seed, Outcome { event, answer_us, wrong, .. })| {
            let whose = format!("seed {seed} ({event:?}, answers after {answer_us:?} us)");
            wrong.iter().take(3).map(move |what| format!("{whose}: {what}"))
        })
        .collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
    let refused = outcomes.iter().filter(|(_, outcome)| outcome.refused).count() as u64;
    assert!(refused * 4 < seeds, "{refused} of {seeds} refused: the swarm shows little");
}

#[test]
fn perturbed_throws_keep_limits_and_states_whatever_happens() {
    swarm(14);
}

#[test]
#[ignore = "minutes: run in release"]
fn hundreds_of_perturbed_throws_keep_limits_and_states_whatever_happens() {
    swarm(std::env::var("SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(200));
}
