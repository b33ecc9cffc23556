//! CAN FD on the bus: two rates, and controllers that do not know it.

use crate::common::{Script, standard};
use hil_sim::bus::{Bus, BusConfig, BusEvent, Confinement, ErrorKind};
use proptest::prelude::*;
use protocol::{ExtendedId, FdFlags, Frame, StandardId, bits};

/// 1 and 5 Mbit/s.
fn bus(ports: usize) -> Bus {
    Bus::new(BusConfig { data_bit_rate_bit_s: Some(5_000_000), ..BusConfig::default() }, ports).unwrap()
}

fn run(bus: &mut Bus, until_ns: u64) -> Vec<BusEvent> {
    std::iter::from_fn(|| bus.run_until(until_ns, &mut Script::default())).collect()
}

/// When each frame was valid, ns, and for whom.
fn frames(events: &[BusEvent]) -> Vec<(u64, u64)> {
    let frames = events.iter().filter_map(|event| match *event {
        BusEvent::Frame { at_ns, receivers, .. } => Some((at_ns, receivers)),
        _ => None,
    });
    frames.collect()
}

/// Enabling a motor: 17 bits and 2 stuff bits, 96 and 12 at the data rate, 10 bits (worked by hand with [`bits`]).
fn enable(brs: bool) -> Frame {
    standard(1, &[0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC]).with_fd(FdFlags { brs, esi: false })
}

#[test]
fn a_frame_with_bit_rate_switch_takes_its_bits_at_two_rates() {
    let mut bus = bus(2);
    bus.send(0, enable(true), 0);
    bus.send(0, enable(true), 0);
    let end_ns = 19_000 + 108 * 200 + 10_000;
    let events = run(&mut bus, 1_000_000);
    assert_eq!(frames(&events), [(end_ns - 1_000, 2), (end_ns + 3_000 + end_ns - 1_000, 2)]);
    assert_eq!(bus.busy_ns(), 2 * (end_ns + 3_000));
    assert_eq!((bus.error_ns(), bus.ids().sorted()[0].busy_ns), (0, bus.busy_ns()));
}

#[test]
fn a_frame_without_bit_rate_switch_takes_all_its_bits_at_the_nominal_rate() {
    let mut bus = bus(2);
    bus.send(0, enable(false), 0);
    // The zeros of res, BRS and ESI add no stuff bit before the one of the length code.
    let end_ns = 1_000 * u64::from(bits::length(&enable(false)).frame());
    assert_eq!(frames(&run(&mut bus, 1_000_000)), [(end_ns - 1_000, 2)]);
    assert!((133_000..140_000).contains(&end_ns), "{end_ns}");
}

#[test]
fn a_classical_controller_flags_can_fd_frames_until_it_is_passive() {
    let mut bus = bus(3);
    bus.set_classical(2);
    bus.send(0, enable(true), 0);
    let events = run(&mut bus, 30_000);
    // After ESI and length code: 19 bits at 1 Mbit/s and 5 at 5 Mbit/s.
    let expected = [(0, ErrorKind::Bit), (2, ErrorKind::Stuff), (1, ErrorKind::Stuff)];
    let errors: Vec<_> = events
        .iter()
        .map(|event| match *event {
            BusEvent::Error { at_ns: 20_000, port, kind } => (port, kind),
            _ => panic!("{event:?}"),
        })
        .collect();
    assert_eq!(errors, expected);
    assert_eq!([0, 1, 2].map(|port| bus.error_counters(port)), [(8, 0), (0, 1), (0, 9)]);
    // It becomes passive by its 15th error, and the 16th attempt passes for the other one.
    let events = run(&mut bus, 1_000_000);
    assert_eq!(frames(&events).iter().map(|(_, receivers)| *receivers).collect::<Vec<_>>(), [2]);
    assert_eq!((bus.confinement(2), bus.confinement(0)), (Confinement::Passive, Confinement::Active));
    assert_eq!(bus.ids().sorted()[0].failed_attempts, 15);
    assert_eq!(bus.error_counters(0).0, 15 * 8 - 1);
}

#[test]
fn a_classical_controller_takes_classical_frames_on_that_bus_and_sends_no_others() {
    let mut bus = bus(3);
    bus.set_classical(2);
    assert!(bus.send(0, standard(1, &[1]), 0) && bus.send(2, standard(2, &[2]), 0));
    assert!(!bus.send(2, enable(true), 0), "its controller cannot send it");
    assert_eq!(frames(&run(&mut bus, 1_000_000)).iter().map(|f| f.1).collect::<Vec<_>>(), [6, 3]);
    assert_eq!(bus.queue(2).dropped(), 1);
    let mut classical = Bus::new(BusConfig::default(), 2).unwrap();
    assert!(!classical.send(0, enable(true), 0));
}

#[test]
fn of_two_frames_with_one_id_the_classical_one_collides_with_the_other() {
    let mut bus = bus(3);
    bus.send(0, enable(true), 0);
    bus.send(1, standard(1, enable(true).data()), 0);
    let events = run(&mut bus, 60_000);
    assert!(matches!(events[0], BusEvent::Error { kind: ErrorKind::Bit, .. }), "{:?}", events[0]);
    assert_eq!((bus.error_counters(0).0, bus.error_counters(1).0), (8, 8));
}

#[test]
fn data_rates_that_no_bit_of_whole_nanoseconds_has_are_refused() {
    let of = |rate| BusConfig { data_bit_rate_bit_s: Some(rate), ..BusConfig::default() };
    for rate in [1_000_000, 2_000_000, 2_500_000, 4_000_000, 5_000_000, 8_000_000, 10_000_000] {
        assert!(Bus::new(of(rate), 2).is_ok(), "{rate}");
    }
    for rate in [0, 500_000, 3_200_000, 12_500_000] {
        assert!(Bus::new(of(rate), 2).is_err(), "{rate}");
    }
}

proptest! {
    #[test]
    fn the_time_of_a_burst_is_the_sum_of_its_frames(
        all in proptest::collection::vec((any::<u32>(), any::<bool>(), any::<Option<bool>>(), 0_usize..16), 1..20),
    ) {
        let lengths = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];
        let (mut bus, mut sum_ns) = (bus(2), 0);
        let mut expected = Vec::new();
        for (raw, long_id, brs, code) in all {
            let data = [raw as u8; 64];
            let id: protocol::Id = if long_id {
                ExtendedId::from_low_bits(raw).into()
            } else {
                StandardId::from_low_bits(raw as u16).into()
            };
            let frame = match brs {
                Some(brs) => Frame::new_fd(id, FdFlags { brs, esi: false }, &data[..lengths[code]]),
                None => Frame::new(id, &data[..code.min(8)]),
            }
            .unwrap();
            let length = bits::length(&frame);
            expected.push(sum_ns + length.time_ns(1_000, 200) - 4_000);
            sum_ns += length.time_ns(1_000, 200);
            bus.send(0, frame, 0);
        }
        let events = run(&mut bus, 100_000_000);
        prop_assert_eq!(frames(&events).iter().map(|f| f.0).collect::<Vec<_>>(), expected);
        prop_assert_eq!((bus.busy_ns(), bus.error_ns()), (sum_ns, 0));
    }
}
