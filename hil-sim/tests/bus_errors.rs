//! Rules of CAN Specification 2.0 part A section 8 for attempts that fail. Rules 7 to 11 alone: `counters.rs`.

use crate::common::{BIT_NS, EVERYBODY, Script, bus, frame_bits, frames, run, standard};
use hil_sim::bus::{Bus, BusConfig, BusEvent, Confinement, Disturbance, ErrorKind, Recovery};
use protocol::Frame;

fn frame() -> Frame {
    standard(0x555, &[0x55, 0x55])
}

/// Port 0 sends one frame, the script acts.
fn one_frame(ports: usize, script: &mut Script, until_bits: u64) -> (Bus, Vec<BusEvent>) {
    let mut bus = bus(ports);
    bus.send(0, frame(), 0);
    let events = run(&mut bus, script, until_bits);
    (bus, events)
}

/// Time in bits, port and kind of each error flag.
fn errors(events: &[BusEvent]) -> Vec<(u64, usize, ErrorKind)> {
    let errors = events.iter().filter_map(|event| match *event {
        BusEvent::Error { at_ns, port, kind } => Some((at_ns / BIT_NS, port, kind)),
        _ => None,
    });
    errors.collect()
}

#[test]
fn rule_1_and_3_a_disturbance_for_all_costs_the_sender_eight_and_each_receiver_one() {
    let (bus, events) = one_frame(3, &mut Script::once(25, EVERYBODY), 40);
    let expected = [(26, 0, ErrorKind::Bit), (26, 1, ErrorKind::Stuff), (26, 2, ErrorKind::Stuff)];
    assert_eq!(errors(&events), expected);
    assert_eq!([0, 1, 2].map(|port| bus.error_counters(port)), [(8, 0), (0, 1), (0, 1)]);
}

#[test]
fn rule_7_and_8_the_frame_is_repeated_after_flags_delimiter_and_intermission_and_counts_down_by_one() {
    let mut script = Script::once(25, EVERYBODY);
    let (bus, events) = one_frame(3, &mut script, 1_000);
    // Two flags one after the other, delimiter, intermission.
    let again = 26 + 12 + 8 + 3;
    let ends: Vec<u64> = frames(&events).iter().map(|(end, ..)| *end).collect();
    assert_eq!(ends, [again + u64::from(frame_bits(&frame())) - 1]);
    assert_eq!([0, 1, 2].map(|port| bus.error_counters(port)), [(7, 0), (0, 0), (0, 0)]);
    assert_eq!((bus.ids().sorted()[0].failed_attempts, script.seen), (1, 2));
    assert_eq!(bus.error_ns(), again * BIT_NS);
}

#[test]
fn rule_2_the_receiver_that_flags_first_after_the_acknowledge_delimiter_pays_eight_more() {
    let (bus, events) = one_frame(3, &mut Script::once(21, 1 << 1), 110);
    let found = u64::from(frame_bits(&frame())) - 7;
    assert_eq!(errors(&events)[1], (found, 1, ErrorKind::Crc));
    assert_eq!([0, 1, 2].map(|port| bus.error_counters(port)), [(8, 0), (0, 1 + 8), (0, 1)]);
}

#[test]
fn rule_3_exception_1_a_lone_node_becomes_passive_and_never_bus_off() {
    let (bus, events) = one_frame(1, &mut Script::default(), 100_000);
    assert_eq!(bus.error_counters(0), (128, 0));
    assert_eq!(bus.confinement(0), Confinement::Passive);
    assert_eq!(bus.port_stats(0).became_passive, 1);
    let errors = errors(&events);
    assert!(errors.iter().all(|(.., kind)| *kind == ErrorKind::Ack) && errors.len() > 1_000);
    // Up to the acknowledge slot, six bits of flag, eight of delimiter, three of intermission; eight of suspension once passive.
    let active = u64::from(frame_bits(&frame())) - 8 + 6 + 8 + 3;
    assert_eq!(errors[1].0 - errors[0].0, active);
    assert_eq!(errors[errors.len() - 1].0 - errors[errors.len() - 2].0, active + 8);
}

#[test]
fn rule_6_a_line_held_dominant_counts_eight_per_eight_bits() {
    // Worked by hand for an idle receiver; bit 0 is the first dominant bit:
    // bit 5 stuff error (+1), flag in bits 6..=11, bit 12 first after the flag (+8, rule 2), bit 19 is
    // the 14th dominant bit since the flag began (+8), then every eight bits (+8).
    for (held_bits, expected) in [(5, 0), (6, 1), (12, 1), (13, 9), (19, 9), (20, 17), (28, 25), (36, 33)] {
        let mut bus = bus(2);
        bus.hold_dominant(true);
        run(&mut bus, &mut Script::default(), held_bits);
        assert_eq!(bus.error_counters(1), (0, expected), "{held_bits} bits");
    }
}

#[test]
fn frame_waits_while_the_line_is_held_dominant_and_eleven_recessive_bits_longer() {
    let mut bus = bus(2);
    bus.hold_dominant(true);
    bus.send(0, frame(), 0);
    run(&mut bus, &mut Script::default(), 2_000);
    assert_eq!((bus.confinement(1), bus.error_counters(1)), (Confinement::Passive, (0, 255)));
    bus.hold_dominant(false);
    let ends: Vec<u64> = frames(&run(&mut bus, &mut Script::default(), 5_000)).iter().map(|f| f.0).collect();
    assert_eq!(ends, [2_000 + 11 + u64::from(frame_bits(&frame())) - 1]);
    assert_eq!(bus.error_ns(), (2_000 + 8) * BIT_NS);
}

#[test]
fn rule_10_thirty_two_transmit_errors_end_in_bus_off() {
    let mut bus = Bus::new(BusConfig { recovery: Recovery::OnRequest, ..BusConfig::default() }, 3).unwrap();
    bus.send(0, frame(), 0);
    let mut script = Script::always(25, EVERYBODY);
    let events = run(&mut bus, &mut script, 100_000);
    assert_eq!((script.seen, bus.error_counter_peaks(0).0), (32, 256));
    assert_eq!(events.iter().filter(|event| matches!(event, BusEvent::BusOff { port: 0, .. })).count(), 1);
    assert_eq!(frames(&events), []);
    assert_eq!(bus.port_stats(0).became_bus_off, 1);
    // Held until a node requests recovery.
    assert!(run(&mut bus, &mut Script::default(), 200_000).is_empty());
    assert!(!bus.is_online(0));
}

#[test]
fn rule_12_recovery_on_an_idle_bus_takes_128_times_11_bits() {
    let mut bus = Bus::new(BusConfig { recovery: Recovery::OnRequest, ..BusConfig::default() }, 2).unwrap();
    run(&mut bus, &mut Script::default(), 500);
    bus.force_bus_off(0, 500 * BIT_NS);
    run(&mut bus, &mut Script::default(), 10_000);
    assert_eq!(bus.confinement(0), Confinement::BusOff);
    bus.request_recovery(0, 10_000 * BIT_NS);
    let events = run(&mut bus, &mut Script::default(), 20_000);
    assert_eq!(events, [BusEvent::Joined { at_ns: (10_000 + 128 * 11) * BIT_NS, port: 0 }]);
    assert_eq!((bus.error_counters(0), bus.confinement(0)), ((0, 0), Confinement::Active));
}

#[test]
fn rule_12_on_a_full_bus_each_frame_counts_one_sequence() {
    // Back-to-back frames leave exactly eleven recessive bits between them: ACK delimiter, end of frame, intermission.
    let mut bus = bus(3);
    bus.force_bus_off(2, 0);
    let mut sent = 0;
    let mut joined_after = None;
    while joined_after.is_none() && sent < 1_000 {
        if bus.queue(0).len() < 2 {
            bus.send(0, frame(), bus.now_ns());
        }
        let next = bus.now_ns() / BIT_NS + 10;
        for event in run(&mut bus, &mut Script::default(), next) {
            match event {
                BusEvent::Frame { .. } => sent += 1,
                BusEvent::Joined { port: 2, .. } => joined_after = Some(sent),
                _ => {}
            }
        }
    }
    // Idle bits before the first frame count too, but there are fewer than eleven.
    assert_eq!(joined_after, Some(128));
}

fn first_disturbed(attempts: usize) -> Script {
    let disturbance = Disturbance { bit: 20, seen_by: EVERYBODY };
    Script { attempts: (0..attempts).map(|attempt| (attempt, disturbance)).collect(), ..Script::default() }
}

#[test]
fn rule_11_a_passive_sender_that_succeeds_becomes_active_and_stops_suspending() {
    let mut bus = bus(2);
    for _ in 0..3 {
        bus.send(0, frame(), 0);
    }
    // Sixteen disturbed attempts: TEC 128. Then good frames: 127 after the first.
    let good = frames(&run(&mut bus, &mut first_disturbed(16), 10_000));
    assert_eq!(good.len(), 3);
    assert_eq!(good[1].0 - good[0].0, u64::from(frame_bits(&frame())) + 3);
    assert_eq!(bus.error_counters(0).0, 128 - 3);
}

#[test]
fn passive_sender_waits_eight_more_bits_and_lets_others_go_first() {
    let mut bus = bus(3);
    for _ in 0..2 {
        bus.send(0, standard(0x001, &[]), 0);
    }
    // Seventeen errors: TEC 136, so the node stays passive after its first good frame.
    let mut script = first_disturbed(17);
    loop {
        let next = bus.now_ns() / BIT_NS + 1;
        if !frames(&run(&mut bus, &mut script, next)).is_empty() {
            break;
        }
    }
    // In the end of the passive node's frame another node queues a frame of much lower priority.
    bus.send(1, standard(0x7F0, &[]), bus.now_ns());
    let until = bus.now_ns() / BIT_NS + 1_000;
    let events = run(&mut bus, &mut script, until);
    let order: Vec<u32> = frames(&events).iter().map(|(_, _, frame, _)| frame.id().raw()).collect();
    assert_eq!(order, [0x7F0, 0x001]);
}

#[test]
fn error_in_the_last_bit_at_the_sender_alone_duplicates_the_frame_and_in_the_one_before_at_one_receiver_too()
{
    // Receivers accept one bit before the end.
    let last = frame_bits(&frame()) - 1;
    let (bus, events) = one_frame(2, &mut Script::once(last, 1 << 0), 1_000);
    assert_eq!(frames(&events).len(), 2);
    assert_eq!(bus.port_stats(1).received, 2);
    // A receiver that reads it wrongly has the frame already.
    let (bus, events) = one_frame(2, &mut Script::once(last, 1 << 1), 1_000);
    assert_eq!((frames(&events).len(), bus.error_counters(0)), (1, (0, 0)));
    // Port 1 alone misses the frame, so it is repeated, and port 2 has it twice.
    let (_, events) = one_frame(3, &mut Script::once(last - 1, 1 << 1), 1_000);
    let receivers: Vec<u64> = frames(&events).iter().map(|(.., receivers)| *receivers).collect();
    assert_eq!(receivers, [0b100, 0b110]);
}

#[test]
fn passive_receiver_that_reads_a_bit_wrongly_misses_the_frame_alone() {
    let mut bus = bus(3);
    // Only port 1 reads wrongly: 9 per attempt. After fifteen attempts it is passive and its flags no longer end frames.
    bus.send(0, frame(), 0);
    let mut script = Script::always(21, 1 << 1);
    let events = run(&mut bus, &mut script, 10_000);
    let receivers: Vec<u64> = frames(&events).iter().map(|(.., receivers)| *receivers).collect();
    assert_eq!((receivers, script.seen), (vec![0b100], 16));
    assert_eq!(bus.error_counters(1), (0, 15 * 9 + 1));
}

#[test]
fn two_senders_of_one_id_with_other_data_destroy_each_other_until_one_is_passive() {
    let mut bus = bus(3);
    bus.send(0, standard(0x0A1, &[1]), 0);
    bus.send(1, standard(0x0A1, &[2]), 0);
    let events = run(&mut bus, &mut Script::default(), 10_000);
    let seen: Vec<(Option<usize>, u8)> = frames(&events).iter().map(|f| (f.1, f.2.data()[0])).collect();
    assert_eq!(seen, [(Some(0), 1), (Some(1), 2)]);
    assert_eq!(bus.error_counter_peaks(0).0, 128);
    assert_eq!(bus.error_counter_peaks(1).0, 136);
}

#[test]
fn frame_whose_sender_vanishes_is_a_stuff_error_for_the_others() {
    let mut bus = bus(3);
    bus.send(0, frame(), 0);
    run(&mut bus, &mut Script::default(), 20);
    bus.set_attached(0, false, 20 * BIT_NS);
    let events = run(&mut bus, &mut Script::default(), 1_000);
    assert_eq!(errors(&events), [(26, 1, ErrorKind::Stuff), (26, 2, ErrorKind::Stuff)]);
    assert_eq!((frames(&events).len(), bus.port_stats(0).flushed), (0, 1));
}

#[test]
fn frame_whose_only_receiver_vanishes_is_not_acknowledged() {
    let mut bus = bus(2);
    bus.send(0, frame(), 0);
    run(&mut bus, &mut Script::default(), 20);
    bus.set_attached(1, false, 20 * BIT_NS);
    let events = run(&mut bus, &mut Script::default(), 100);
    assert_eq!(errors(&events)[0], (u64::from(frame_bits(&frame())) - 8, 0, ErrorKind::Ack));
}
