//! The twelve rules of CAN Specification 2.0 part A section 8, one or more cases each.
//!
//! The frame used throughout is `555#5555`, whose first stuff bit is far behind the places that are disturbed;
//! positions are bits from start of frame: id 1..=11, RTR 12, IDE 13, r0 14, DLC 15..=18, data from 19.

use crate::common::{BIT_NS, EVERYBODY, Script, bus, frames, run, standard};
use hil_sim::bus::Bus;
use hil_sim::bus::encode::{WireBits, frame_bits};
use hil_sim::bus::{BusConfig, BusEvent, Confinement, ErrorKind, Recovery};
use protocol::Frame;

fn frame() -> Frame {
    standard(0x555, &[0x55, 0x55])
}

/// Port 0 sends one frame, the script acts, everything settles.
fn one_frame(ports: usize, frame: Frame, script: &mut Script, until_bits: u64) -> (Bus, Vec<BusEvent>) {
    let mut bus = bus(ports);
    bus.send(0, frame, 0);
    let events = run(&mut bus, script, until_bits);
    (bus, events)
}

fn first_error(events: &[BusEvent], port: usize) -> Option<(u64, ErrorKind)> {
    events.iter().find_map(|event| match *event {
        BusEvent::Error { at_ns, port: p, kind } if p == port => Some((at_ns / BIT_NS, kind)),
        _ => None,
    })
}

#[test]
fn rule_1_and_3_a_disturbance_for_all_costs_the_sender_eight_and_each_receiver_one() {
    // Data bit 25 inverted for everybody: the sender sees a bit error at once and sends six dominant
    // bits, which the receivers take for a stuff error.
    let mut script = Script::once(25, 1, EVERYBODY);
    let (bus, events) = one_frame(3, frame(), &mut script, 100);
    assert_eq!(first_error(&events, 0), Some((26, ErrorKind::Bit)));
    assert_eq!(first_error(&events, 1).map(|(_, kind)| kind), Some(ErrorKind::Stuff));
    assert_eq!(bus.error_counters(0), (8, 0));
    assert_eq!(bus.error_counters(1), (0, 1));
    assert_eq!(bus.error_counters(2), (0, 1));
}

#[test]
fn rule_7_and_8_the_repeated_frame_counts_down_by_one() {
    let mut script = Script::once(25, 1, EVERYBODY);
    let (bus, events) = one_frame(3, frame(), &mut script, 1_000);
    assert_eq!(frames(&events).len(), 1);
    assert_eq!(bus.error_counters(0), (7, 0));
    assert_eq!(bus.error_counters(1), (0, 0));
    assert_eq!(bus.ids().sorted()[0].failed_attempts, 1);
    assert_eq!(script.seen, 2);
}

#[test]
fn rule_2_the_receiver_that_flags_first_pays_eight_more() {
    // Only port 1 reads bit 21 wrongly. 0x55 alternates, so it finds out by the checksum, after the
    // acknowledge delimiter; its flag meets the end of frame of the others, whose own flags then outlast it.
    let mut script = Script::once(21, 1, 1 << 1);
    let (bus, events) = one_frame(3, frame(), &mut script, 110);
    assert_eq!(first_error(&events, 1).map(|(_, kind)| kind), Some(ErrorKind::Crc));
    assert_eq!(first_error(&events, 2).map(|(_, kind)| kind), Some(ErrorKind::Form));
    assert_eq!(bus.error_counters(1), (0, 1 + 8));
    // Port 2 had acknowledged before (0 stays 0), then one for the form error.
    assert_eq!(bus.error_counters(2), (0, 1));
    assert_eq!(bus.error_counters(0), (8, 0));
}

#[test]
fn checksum_error_flag_starts_right_after_the_acknowledge_delimiter() {
    let mut script = Script::once(21, 1, 1 << 1);
    let (_, events) = one_frame(3, frame(), &mut script, 140);
    // Stuffed part, CRC delimiter, ACK slot, ACK delimiter; found at the end of that bit.
    let expected = u64::from(WireBits::new(&frame()).len()) + 3;
    assert_eq!(first_error(&events, 1), Some((expected, ErrorKind::Crc)));
    // Port 2 sees the first flag bit as a dominant bit in its end of frame.
    assert_eq!(first_error(&events, 2), Some((expected + 1, ErrorKind::Form)));
}

#[test]
fn rule_3_exception_1_a_lone_node_becomes_passive_and_never_bus_off() {
    let (bus, events) = one_frame(1, frame(), &mut Script::default(), 100_000);
    assert_eq!(first_error(&events, 0).map(|(_, kind)| kind), Some(ErrorKind::Ack));
    assert_eq!(bus.error_counters(0), (128, 0));
    assert_eq!(bus.confinement(0), Confinement::Passive);
    assert!(!events.iter().any(|event| matches!(event, BusEvent::BusOff { .. })));
    // It keeps trying. Passive attempts take: stuffed part + CRC delimiter + ACK slot, six bits of passive
    // flag, eight of delimiter, three of intermission, eight of suspension.
    let period = u64::from(WireBits::new(&frame()).len()) + 2 + 6 + 8 + 3 + 8;
    let errors: Vec<u64> = events
        .iter()
        .filter_map(|event| match event {
            BusEvent::Error { at_ns, .. } => Some(at_ns / BIT_NS),
            _ => None,
        })
        .collect();
    assert_eq!(errors[errors.len() - 1] - errors[errors.len() - 2], period);
    // Sixteen attempts lead to 128; the active ones do not suspend.
    assert_eq!(errors[1] - errors[0], period - 8);
    assert_eq!(bus.port_stats(0).became_passive, 1);
}

#[test]
fn rule_3_exception_1_ends_when_a_dominant_bit_meets_the_passive_flag() {
    let mut bus = bus(1);
    bus.send(0, frame(), 0);
    // Sixteen attempts make the node passive; the seventeenth has a dominant bit in its passive flag.
    let flag = WireBits::new(&frame()).len() + 2;
    let mut script = Script::default();
    script
        .attempts
        .push((16, hil_sim::bus::Disturbance { first_bit: flag + 2, bits: 1, seen_by: EVERYBODY }));
    run(&mut bus, &mut script, 16 * 100 - 200);
    while script.seen < 18 {
        let next = bus.now_ns() / BIT_NS + 1;
        run(&mut bus, &mut script, next);
    }
    assert_eq!(bus.error_counters(0).0, 128 + 8);
}

#[test]
fn rule_3_exception_2_an_overwritten_stuff_bit_in_the_own_id_costs_nothing() {
    // id 0: bits 1..=4 and the start of frame are dominant, bit 5 is a recessive stuff bit.
    let mut script = Script::once(5, 1, 1 << 0);
    let (bus, events) = one_frame(2, standard(0, &[]), &mut script, 30);
    assert_eq!(first_error(&events, 0), Some((6, ErrorKind::StuffInArbitration)));
    assert_eq!(bus.error_counters(0), (0, 0));
    // The same bit behind the arbitration field is an ordinary bit error: for id 0 without data the stuff
    // bits sit at 5, 11, 17, ...; the arbitration field with two of them ends at 14.
    let mut script = Script::once(17, 1, 1 << 0);
    let (bus, events) = one_frame(2, standard(0, &[]), &mut script, 40);
    assert_eq!(first_error(&events, 0), Some((18, ErrorKind::Bit)));
    assert_eq!(bus.error_counters(0), (8, 0));
}

#[test]
fn rule_4_and_5_a_disturbed_own_flag_costs_eight_more() {
    // Sender's bit error at 25, flag from 26; bit 27 is read recessive by the sender only.
    let mut script = Script::once(25, 3, 1 << 0);
    let (bus, _) = one_frame(2, frame(), &mut script, 80);
    // 8 for the error, then bits 26 and 27 of the flag each read wrongly: 8 + 8 (rule 4).
    assert_eq!(bus.error_counters(0), (24, 0));
    // A receiver reads two bits of end of frame wrongly: a form error (rule 1: 1), then the first bit of
    // its own flag (rule 5: 8, and no further 1). Its second flag coincides with those of the others.
    let mut script = Script::once(frame_bits(&frame()) - 4, 2, 1 << 1);
    let (bus, _) = one_frame(3, frame(), &mut script, 90);
    assert_eq!(bus.error_counters(1), (0, 1 + 8));
    assert_eq!(bus.error_counters(2), (0, 1));
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
fn rule_6_a_transmitter_on_a_dominant_line_goes_bus_off() {
    let mut bus = Bus::new(BusConfig { recovery: Recovery::OnRequest, ..BusConfig::default() }, 2).unwrap();
    bus.hold_dominant(true);
    bus.send(0, frame(), 0);
    let events = run(&mut bus, &mut Script::default(), 2_000);
    let off = events.iter().find_map(|event| match event {
        BusEvent::BusOff { at_ns, port: 0 } => Some(at_ns / BIT_NS),
        _ => None,
    });
    // Bit 1 of id 0x555 is recessive and is read dominant: lost arbitration, so the node is a receiver
    // and counts REC only. With id 0 and a recessive bit behind the arbitration field it is a transmitter.
    assert_eq!(off, None);
    assert!(bus.error_counters(0).1 >= 128);

    let mut bus = Bus::new(BusConfig { recovery: Recovery::OnRequest, ..BusConfig::default() }, 2).unwrap();
    bus.hold_dominant(true);
    bus.send(0, standard(0, &[]), 0);
    let events = run(&mut bus, &mut Script::default(), 2_000);
    // Bit 5: recessive stuff bit in the id read dominant, exception 2 (0). Flag 6..=11. Bits 12..=19: eight dominant
    // bits after the flag (+8), and so on: 32 times, the last at bit 19 + 31 * 8, over at its end.
    let off = events.iter().find_map(|event| match event {
        BusEvent::BusOff { at_ns, port: 0 } => Some(at_ns / BIT_NS),
        _ => None,
    });
    assert_eq!(off, Some(19 + 31 * 8 + 1));
    assert_eq!(bus.confinement(0), Confinement::BusOff);
}

#[test]
fn rule_9_the_error_that_makes_passive_still_sends_an_active_flag() {
    // The sixteenth error leads from 120 to 128; receivers must still see six dominant bits then, that is: they
    // count a stuff error. The seventeenth flag is passive and invisible.
    let mut bus = bus(2);
    bus.send(0, frame(), 0);
    // Only the sender reads data bit 25 wrongly.
    let mut script = Script::always(25, 1, 1 << 0);
    let mut receiver_errors = 0;
    let mut events = Vec::new();
    while script.seen < 18 {
        let next = bus.now_ns() / BIT_NS + 1;
        events.extend(run(&mut bus, &mut script, next));
    }
    for event in &events {
        if matches!(event, BusEvent::Error { port: 1, .. }) {
            receiver_errors += 1;
        }
    }
    // From the seventeenth on the receiver misses the rest of the frame: the passive sender goes silent,
    // which is again a stuff error, but one of recessive bits.
    assert_eq!(receiver_errors, 17);
    assert_eq!(bus.port_stats(0).became_passive, 1);
    assert_eq!(bus.error_counters(0).0, 17 * 8);
}

#[test]
fn rule_10_thirty_two_transmit_errors_end_in_bus_off() {
    let mut bus = Bus::new(BusConfig { recovery: Recovery::OnRequest, ..BusConfig::default() }, 3).unwrap();
    bus.send(0, frame(), 0);
    let mut script = Script::always(25, 1, EVERYBODY);
    let events = run(&mut bus, &mut script, 100_000);
    assert_eq!(script.seen, 32);
    assert_eq!(bus.error_counter_peaks(0).0, 256);
    assert_eq!(events.iter().filter(|event| matches!(event, BusEvent::BusOff { port: 0, .. })).count(), 1);
    assert_eq!(frames(&events), []);
    assert_eq!(bus.port_stats(0).became_bus_off, 1);
    // Held until a node asks.
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
    assert_eq!(bus.error_counters(0), (0, 0));
    assert_eq!(bus.confinement(0), Confinement::Active);
}

#[test]
fn rule_12_on_a_full_bus_each_frame_counts_one_sequence() {
    // Back-to-back frames leave exactly eleven recessive bits between them: ACK delimiter, end of frame, intermission.
    let mut bus = bus(3);
    bus.force_bus_off(2, 0);
    let mut sent = 0;
    let mut joined_after = None;
    let mut script = Script::default();
    for _ in 0..20_000 {
        if bus.queue(0).len() < 2 {
            bus.send(0, frame(), bus.now_ns());
        }
        let next = bus.now_ns() / BIT_NS + 10;
        for event in run(&mut bus, &mut script, next) {
            match event {
                BusEvent::Frame { .. } => sent += 1,
                BusEvent::Joined { port: 2, .. } => joined_after = Some(sent),
                _ => {}
            }
        }
        if joined_after.is_some() {
            break;
        }
    }
    // Idle bits before the first frame count too, but there are fewer than eleven.
    assert_eq!(joined_after, Some(128));
}

#[test]
fn rule_11_a_passive_sender_that_succeeds_becomes_active_and_stops_suspending() {
    let mut bus = bus(2);
    for _ in 0..3 {
        bus.send(0, frame(), 0);
    }
    // Sixteen disturbed attempts: TEC 128. Then good frames: 127 after the first.
    let mut script = Script::default();
    for attempt in 0..16 {
        script
            .attempts
            .push((attempt, hil_sim::bus::Disturbance { first_bit: 25, bits: 1, seen_by: EVERYBODY }));
    }
    let events = run(&mut bus, &mut script, 10_000);
    let good = frames(&events);
    assert_eq!(good.len(), 3);
    let length = u64::from(frame_bits(&frame()));
    // TEC is 128 before and 127 after the first good frame: active again, no suspension.
    assert_eq!(good[1].0 - good[0].0, length + 3);
    assert_eq!(bus.error_counters(0).0, 128 - 3);
}

#[test]
fn passive_sender_waits_eight_more_bits_and_lets_others_go_first() {
    let mut bus = bus(3);
    for _ in 0..2 {
        bus.send(0, standard(0x001, &[]), 0);
    }
    // Seventeen errors: TEC 136, so the node stays passive after its first good frame.
    let mut script = Script::default();
    for attempt in 0..17 {
        script
            .attempts
            .push((attempt, hil_sim::bus::Disturbance { first_bit: 20, bits: 1, seen_by: EVERYBODY }));
    }
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
fn dominant_last_bit_of_end_of_frame_duplicates_the_frame_at_the_receivers() {
    // The sender alone sees the last bit wrongly: receivers have accepted one bit earlier.
    let last = frame_bits(&frame()) - 1;
    let mut script = Script::once(last, 1, 1 << 0);
    let (bus, events) = one_frame(2, frame(), &mut script, 1_000);
    assert_eq!(frames(&events).len(), 2);
    assert_eq!(bus.port_stats(0).sent, 1);
    // The receiver takes the sender's flag for an overload, no error: rule 1 counts nothing.
    assert_eq!(bus.port_stats(1).overloads, 1);
    assert_eq!(bus.error_counters(1), (0, 0));
}

#[test]
fn dominant_last_bit_of_end_of_frame_at_a_receiver_is_an_overload_without_repetition() {
    let last = frame_bits(&frame()) - 1;
    let mut script = Script::once(last, 1, 1 << 1);
    let (bus, events) = one_frame(2, frame(), &mut script, 1_000);
    assert_eq!(frames(&events).len(), 1);
    assert_eq!(bus.port_stats(1).overloads, 1);
    assert_eq!(bus.error_counters(0), (0, 0));
}

#[test]
fn same_id_with_different_data_is_a_bit_error_for_the_recessive_one() {
    let mut bus = bus(3);
    bus.send(0, standard(0x123, &[0xF0]), 0);
    bus.send(1, standard(0x123, &[0xF1]), 0);
    let events = run(&mut bus, &mut Script::default(), 60);
    // Port 1 sends recessive in the last data bit and reads dominant.
    assert_eq!(first_error(&events, 1).map(|(_, kind)| kind), Some(ErrorKind::Bit));
    assert_eq!(bus.error_counters(1).0, 8);
    // Its flag destroys the frame of port 0 as well.
    assert_eq!(bus.error_counters(0).0, 8);
    // Both start again together: for ever, until counters or software end it.
    run(&mut bus, &mut Script::default(), 20_000);
    assert!(bus.port_stats(0).failed_attempts > 10);
}

#[test]
fn same_frame_from_two_nodes_is_sent_once_and_satisfies_both() {
    let mut bus = bus(3);
    bus.send(0, standard(0x123, &[0xF0]), 0);
    bus.send(1, standard(0x123, &[0xF0]), 0);
    let events = run(&mut bus, &mut Script::default(), 1_000);
    assert_eq!(frames(&events).len(), 1);
    assert_eq!((bus.port_stats(0).sent, bus.port_stats(1).sent), (1, 1));
}
