//! Virtual time: order of events, delivery, faults on the wire, contract breaches, determinism.

use crate::common::nodes::{Beacon, Fountain, Responder, Stuck, TwoAtOnce};
use crate::common::{frame_bits, standard};
use hil_sim::bus::{BusConfig, Confinement};
use hil_sim::fault::{Fault, FaultKind, IdFilter, Target, WireFault, WrongPart};
use hil_sim::participants::Solo;
use hil_sim::record::{CandumpLog, Trace};
use hil_sim::world::{RunError, World};
use hil_sim::{BusConnection, Participants};
use protocol::text::BusName;
use protocol::{Duration, Frame, Instant, ModuleId, Node};

/// The poller sends a request to each drive once per cycle; a cycle has room for all of them.
const CYCLE_US: u64 = 2_000;

const fn us(us: u64) -> Instant {
    Instant::from_micros(us)
}

const fn cycles(count: u64) -> Instant {
    Instant::from_micros(count * CYCLE_US)
}

/// Six responders with wire addresses 1 to 6, and one node that polls each of them once per cycle.
#[derive(Debug)]
struct Cell {
    poller: Vec<Beacon>,
    drives: Vec<Responder>,
    off: Option<usize>,
}

impl Cell {
    fn new() -> Self {
        let poller = (1..=6)
            .map(|m| Beacon::new(standard(0x0C0 + m, &[0x0A, 0x62]), 250 * u64::from(m), CYCLE_US))
            .collect();
        let drives = (1..=6)
            .map(|m| {
                Responder::new(0x0C0 + u32::from(m), standard(0x0A0 + m, &[0x0A, 0x62, 1, 2, 3, 4, 5, 6]), 50)
            })
            .collect();
        Self { poller, drives, off: None }
    }
}

impl Participants for Cell {
    fn len(&self) -> usize {
        12
    }
    fn node(&mut self, index: usize) -> &mut dyn Node {
        if index < 6 { &mut self.drives[index] } else { &mut self.poller[index - 6] }
    }
    fn name(&self, index: usize) -> std::borrow::Cow<'_, str> {
        if index < 6 { format!("drive {}", index + 1).into() } else { format!("poller {}", index - 5).into() }
    }
    fn connection(&self, index: usize) -> BusConnection {
        if self.off == Some(index) { BusConnection::Off } else { BusConnection::On }
    }
    fn module(&self, index: usize) -> Option<ModuleId> {
        ModuleId::new(index as u8 + 1).ok().filter(|_| index < 6)
    }
}

fn fault(kind: WireFault, target: Target) -> Fault {
    Fault {
        label: kind.name().to_owned(),
        kind: FaultKind::Wire(kind),
        target,
        filter: None,
        start: cycles(10),
        at: None,
        length: Some(Duration::from_micros(20 * CYCLE_US)),
        every: None,
        probability: 1.0,
    }
}

fn module(id: u8) -> Target {
    Target::Module(ModuleId::new(id).unwrap())
}

fn log_of(seed: u64, plan: Vec<Fault>, end: Instant) -> (String, World<Cell>) {
    let mut world = World::new(Cell::new(), BusConfig::default(), seed, plan).unwrap();
    let mut log = CandumpLog::new(Vec::new(), BusName::new("can0").unwrap());
    world.run_until(end, &mut log).unwrap();
    (String::from_utf8(log.finish().unwrap()).unwrap(), world)
}

/// Frames of an id from one cycle on and before another.
fn count(log: &str, id: &str, from: u64, to: u64) -> usize {
    log.lines()
        .filter(|line| {
            let t: f64 = line[1..18].parse().unwrap();
            line.contains(&format!(" {id}#"))
                && ((from * CYCLE_US) as f64..(to * CYCLE_US) as f64).contains(&(t * 1e6))
        })
        .count()
}

#[test]
fn request_and_answer_come_at_the_times_worked_by_hand() {
    let request = standard(0x0C1, &[0x0A, 0x62]);
    let answer = standard(0x0A1, &[1, 2, 3]);
    let participants = (
        Solo::new("poller", Beacon::new(request, 100, 1_000_000)),
        Solo::new("drive", Responder::new(0x0C1, answer, 50)),
    );
    let mut world = World::new(participants, BusConfig::default(), 0, vec![]).unwrap();
    world.run_until(us(2_000), &mut ()).unwrap();
    // Queued at 100, valid for the receiver one bit before its end; 50 us later the answer starts, the bus being idle.
    let request_seen = 100 + u64::from(frame_bits(&request)) - 1;
    let answer_seen = request_seen + 50 + u64::from(frame_bits(&answer)) - 1;
    assert_eq!(world.participants().0.node.heard, [(us(answer_seen), answer)]);
}

#[test]
fn same_seed_gives_the_same_log_and_another_seed_another() {
    let plan = || {
        let mut drop = fault(WireFault::Corrupt, Target::Bus);
        drop.probability = 0.3;
        vec![drop]
    };
    let end = cycles(100);
    let first = log_of(1, plan(), end).0;
    assert!(first == log_of(1, plan(), end).0);
    assert!(first != log_of(2, plan(), end).0);
}

#[test]
fn one_run_in_many_pieces_is_the_same_as_in_one() {
    let mut plan = vec![
        fault(WireFault::Corrupt, Target::Bus),
        fault(WireFault::Delay(Duration::from_micros(333)), module(2)),
    ];
    plan[0].probability = 0.3;
    let whole = log_of(5, plan.clone(), cycles(60)).0;
    let mut world = World::new(Cell::new(), BusConfig::default(), 5, plan).unwrap();
    let mut log = CandumpLog::new(Vec::new(), BusName::new("can0").unwrap());
    for end in (0..=60 * CYCLE_US).step_by(7).chain([60 * CYCLE_US]) {
        world.run_until(us(end), &mut log).unwrap();
    }
    assert!(String::from_utf8(log.finish().unwrap()).unwrap() == whole);
}

#[test]
fn a_further_fault_leaves_the_draws_of_the_others_alone() {
    let mut drop = fault(WireFault::Drop, module(1));
    drop.probability = 0.5;
    let dropped = |plan| log_of(9, plan, cycles(40)).1.faults().counts()[0].frames;
    // Silencing module 4 changes the traffic but not what happens to the frames module 1 receives from its poller.
    drop.filter = Some(IdFilter { id: standard(0x0C1, &[]).id(), mask: 0x7FF });
    let alone = dropped(vec![drop.clone()]);
    let with_other = dropped(vec![drop.clone(), fault(WireFault::Silent, module(4))]);
    assert_eq!(alone, with_other);
    assert!((3..=17).contains(&alone), "{alone} of 20");
}

#[test]
fn silent_module_sends_nothing_and_answers_again_afterwards() {
    let (log, world) = log_of(1, vec![fault(WireFault::Silent, module(3))], cycles(50));
    assert_eq!(count(&log, "0A3", 10, 30), 0);
    assert_eq!(count(&log, "0A3", 30, 50), 20);
    assert_eq!(count(&log, "0A2", 10, 30), 20);
    // It still acknowledges and receives.
    assert!(world.bus().port_stats(2).received > 500);
}

#[test]
fn dropped_request_gets_no_answer_although_it_was_on_the_bus() {
    let (log, world) = log_of(1, vec![fault(WireFault::Drop, module(3))], cycles(50));
    assert_eq!(count(&log, "0C3", 10, 30), 20);
    assert_eq!(count(&log, "0A3", 10, 30), 0);
    assert!(world.stats().lost > 0);
}

#[test]
fn drop_on_the_bus_with_an_id_filter_hides_one_answer_from_everybody() {
    let mut drop = fault(WireFault::Drop, Target::Bus);
    drop.filter = Some(IdFilter { id: standard(0x0A3, &[]).id(), mask: 0x7FF });
    let (log, world) = log_of(1, vec![drop], cycles(50));
    assert_eq!(count(&log, "0A3", 10, 30), 20);
    let heard =
        |p: usize| world.participants().poller[p].heard.iter().filter(|(_, f)| f.id().raw() == 0x0A3).count();
    assert_eq!(heard(0), 30);
}

#[test]
fn delayed_request_is_answered_later_by_exactly_that() {
    let normal = log_of(1, vec![], cycles(40)).0;
    let (late, world) =
        log_of(1, vec![fault(WireFault::Delay(Duration::from_micros(40)), module(6))], cycles(40));
    assert_eq!(world.stats().lost, 0);
    let times = |log: &str| -> Vec<u64> {
        log.lines()
            .filter(|l| l.contains(" 0A6#"))
            .map(|l| (l[1..18].parse::<f64>().unwrap() * 1e6).round() as u64)
            .collect()
    };
    let shift: Vec<u64> = times(&late).iter().zip(times(&normal)).map(|(a, b)| a - b).collect();
    assert_eq!(shift[..10], [0; 10]);
    assert!(shift[10..30].iter().all(|s| *s == 40), "{shift:?}");
}

#[test]
fn duplicate_fault_puts_each_frame_of_the_module_twice_on_the_bus() {
    let (log, _) = log_of(1, vec![fault(WireFault::Duplicate, module(2))], cycles(30));
    // With probability 1 each repetition is repeated again, until the sender's counter ends it.
    assert!(count(&log, "0A2", 10, 30) > 40);
    assert_eq!(count(&log, "0A1", 0, 10), 10);
}

#[test]
fn duplicate_with_low_probability_doubles_some_answers() {
    let mut duplicate = fault(WireFault::Duplicate, module(2));
    // Eight up per repetition, one down per frame: below 1 in 9 the counters stay low.
    duplicate.probability = 0.1;
    duplicate.length = None;
    let (log, world) = log_of(3, vec![duplicate], cycles(210));
    let answers = count(&log, "0A2", 10, 210) as u64;
    let hits = world.faults().counts()[0].frames;
    assert_eq!(answers, 200 + hits);
    assert!((8..40).contains(&hits), "{hits}");
}

#[test]
fn wrong_answer_changes_exactly_the_part_it_names() {
    for (part, check) in [
        (
            WrongPart::Value,
            (|d: &[u8]| d.len() == 8 && d[..2] == [0x0A, 0x62] && d[2..] != [1, 2, 3, 4, 5, 6])
                as fn(&[u8]) -> bool,
        ),
        (WrongPart::Parameter, |d| {
            d.len() == 8 && d[0] == 0x0A && d[1] != 0x62 && d[2..] == [1, 2, 3, 4, 5, 6]
        }),
        (WrongPart::Command, |d| d.len() == 8 && d[0] != 0x0A && d[1..] == [0x62, 1, 2, 3, 4, 5, 6]),
        (WrongPart::Length, |d| d == [0x0A, 0x62, 1, 2, 3, 4, 5]),
    ] {
        let mut world = World::new(
            Cell::new(),
            BusConfig::default(),
            1,
            vec![fault(WireFault::WrongAnswer(part), module(5))],
        )
        .unwrap();
        let mut trace = Trace::new(100_000);
        world.run_until(cycles(30), &mut trace).unwrap();
        let answers: Vec<&Frame> = trace
            .entries()
            .iter()
            .filter(|e| e.frame.id().raw() == 0x0A5 && (cycles(10)..cycles(30)).contains(&e.at))
            .map(|e| &e.frame)
            .collect();
        assert_eq!(answers.len(), 20);
        assert!(answers.iter().all(|f| check(f.data())), "{part:?}: {answers:?}");
    }
}

#[test]
fn corrupt_frames_are_repeated_and_no_node_loses_one() {
    let mut corrupt = fault(WireFault::Corrupt, Target::Bus);
    corrupt.probability = 0.2;
    let (log, world) = log_of(1, vec![corrupt], cycles(50));
    for m in 1..=6 {
        // A disturbed last bit of end of frame doubles a frame: that is CAN, and rare.
        let answers = count(&log, &format!("0A{m}"), 0, 50);
        assert!((50..=52).contains(&answers), "{answers}");
    }
    let resent: u64 = (0..12).map(|p| world.bus().port_stats(p).failed_attempts).sum();
    assert!((20..120).contains(&resent), "{resent}");
    assert!(world.bus().error_ns() > 0);
}

#[test]
fn bus_off_module_is_silent_for_the_recovery_and_then_answers_again() {
    let (log, world) = log_of(1, vec![fault(WireFault::BusOff, module(4))], cycles(50));
    assert_eq!(world.bus().port_stats(3).became_bus_off, 1);
    assert_eq!(world.bus().confinement(3), Confinement::Active);
    let answers = count(&log, "0A4", 10, 50);
    // 128 sequences of eleven bits: at least 1.4 ms, at most that with each frame in between costing one.
    assert!((36..=39).contains(&answers), "{answers}");
}

#[test]
fn intermittent_plug_loses_some_answers_and_never_the_bus() {
    let plug =
        WireFault::Intermittent { on_mean: Duration::from_millis(2), off_mean: Duration::from_millis(2) };
    let (log, world) = log_of(4, vec![fault(plug, module(4))], cycles(60));
    let answers = count(&log, "0A4", 10, 30);
    assert!((1..=18).contains(&answers), "{answers}");
    assert!(count(&log, "0A4", 40, 60) >= 19);
    assert_eq!(count(&log, "0A1", 10, 30), 20);
    assert!(world.bus().is_online(3));
}

#[test]
fn babbling_node_with_the_lowest_id_takes_the_bus_and_with_the_highest_only_the_rest() {
    let babble = |id: u16| {
        let kind = WireFault::Babble { frame: standard(id, &[]), period: Duration::from_micros(20) };
        log_of(1, vec![fault(kind, Target::Bus)], cycles(50))
    };
    let (log, world) = babble(0x000);
    assert_eq!(count(&log, "0A1", 10, 30), 0);
    assert!(count(&log, "0A1", 31, 50) > 15);
    // Its frames have 47 bits with their intermission, and 6 stuff bits: 34 zeros in a row. They follow each other without
    // a gap for 20 cycles; the one that was under way at the start may cost one of them.
    let babbled = count(&log, "000", 10, 30);
    assert!((40_000 / 53 - 1..=40_000 / 53).contains(&babbled), "{babbled}");
    // In the other 30 of 50 cycles the bus carries their frames, and what had to wait in the queues of the 20.
    let (_, quiet) = log_of(1, vec![], cycles(50));
    let busy_us = |world: &World<Cell>| world.bus().busy_ns() / 1_000;
    let (rest_us, all_us) = (busy_us(&world) - 53 * babbled as u64, busy_us(&quiet));
    assert!((all_us * 30 / 50..=all_us).contains(&rest_us), "{rest_us} {all_us}");
    let (log, _) = babble(0x7FF);
    assert_eq!(count(&log, "0A1", 10, 30), 20);
    assert!(count(&log, "7FF", 10, 30) > 50);
}

#[test]
fn line_held_dominant_stops_everything_and_the_bus_recovers() {
    let (log, world) = log_of(1, vec![fault(WireFault::StuckDominant, Target::Bus)], cycles(60));
    assert_eq!(log.lines().filter(|l| l.starts_with("(0000000000.02")).count(), 0);
    assert!(count(&log, "0A1", 40, 60) >= 19);
    assert!(world.bus().error_ns() >= 39_500_000);
}

#[test]
fn repeated_fault_happens_as_often_as_planned() {
    let mut silent = fault(WireFault::Silent, module(3));
    silent.length = Some(Duration::from_micros(2 * CYCLE_US));
    silent.every = Some(Duration::from_micros(10 * CYCLE_US));
    let (log, world) = log_of(1, vec![silent], cycles(60));
    assert_eq!(world.faults().counts()[0].occurrences, 5 + 1);
    assert_eq!(count(&log, "0A3", 10, 60), 50 - 2 * 5);
}

#[test]
fn unpowered_node_leaves_the_bus_and_comes_back_after_eleven_recessive_bits() {
    let mut world = World::new(Cell::new(), BusConfig::default(), 1, vec![]).unwrap();
    world.run_until(cycles(10), &mut ()).unwrap();
    world.with_participants(|cell, _| cell.off = Some(2)).unwrap();
    let mut trace = Trace::new(10_000);
    world.run_until(cycles(20), &mut trace).unwrap();
    assert!(!world.bus().is_online(2));
    assert!(trace.entries().iter().all(|e| e.frame.id().raw() != 0x0A3));
    world.with_participants(|cell, _| cell.off = None).unwrap();
    world.run_until(cycles(30), &mut trace).unwrap();
    assert!(world.bus().is_online(2));
    assert_eq!(trace.entries().iter().filter(|e| e.frame.id().raw() == 0x0A3).count(), 10);
}

#[test]
fn deadline_that_never_moves_is_reported_with_the_name() {
    let participants = (Solo::new("good", Beacon::new(standard(1, &[]), 0, 1_000)), Solo::new("bad", Stuck));
    let mut world = World::new(participants, BusConfig::default(), 0, vec![]).unwrap();
    let error = world.run_until(cycles(1), &mut ()).unwrap_err();
    assert_eq!(error, RunError::Livelock { node: "bad".into(), now: us(5), deadline: us(5) });
}

/// The live runner calls once: virtual time must require the same.
#[test]
fn node_that_serves_one_of_two_deadlines_in_a_call_is_reported() {
    let participants = Solo::new("forgetful", TwoAtOnce(2));
    let mut world = World::new(participants, BusConfig::default(), 0, vec![]).unwrap();
    let error = world.run_until(cycles(1), &mut ()).unwrap_err();
    assert_eq!(error, RunError::Livelock { node: "forgetful".into(), now: us(5), deadline: us(5) });
}

#[test]
fn node_without_end_of_frames_is_reported_with_the_name() {
    let participants = Solo::new("fountain", Fountain(standard(1, &[])));
    let mut world = World::new(participants, BusConfig::default(), 0, vec![]).unwrap();
    assert_eq!(
        world.run_until(cycles(1), &mut ()).unwrap_err(),
        RunError::Flood { node: "fountain".into(), now: us(0) }
    );
}

#[test]
fn fault_on_a_missing_module_is_refused_before_the_run() {
    let error = World::new(Cell::new(), BusConfig::default(), 1, vec![fault(WireFault::Silent, module(9))])
        .unwrap_err();
    assert_eq!(error.to_string(), "fault silent: no module 9 on this bus");
}
