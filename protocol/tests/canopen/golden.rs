//! Frames that `canopen` 2.4.1, as master and as node, exchanged on a bus, and what they mean.

use protocol::canopen::Object;
use protocol::canopen::emcy::Emergency;
use protocol::canopen::id::{Function, NodeId};
use protocol::canopen::nmt::{self, Command, State};
use protocol::canopen::pdo::{Direction, Entry, Map, Transmission, set_up};
use protocol::canopen::sdo::{AbortCode, Answer, Bytes, Request, Segment, Start};
use protocol::{Frame, Id, StandardId};

pub(crate) fn node() -> NodeId {
    NodeId::new(3).unwrap()
}

pub(crate) fn frame(line: &str) -> Frame {
    let mut words = line.split_whitespace();
    let id = u16::from_str_radix(words.next().unwrap(), 16).unwrap();
    let data: Vec<u8> = words.map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
    Frame::new(Id::Standard(StandardId::new(id).unwrap()), &data).unwrap()
}

#[test]
fn service_data_are_the_frames_of_a_public_master_and_its_node() {
    let name = Object::new(0x1008, 0);
    let segment = |toggle, text: &str, last| Segment { toggle, bytes: Bytes::of(text.as_bytes()), last };
    for (line, request) in [
        (
            "603 2b 17 10 00 64 00 00 00",
            Request::Write(Object::new(0x1017, 0), Start::Expedited(Bytes::of(&[100, 0]))),
        ),
        ("603 40 00 10 00 00 00 00 00", Request::Read(Object::new(0x1000, 0))),
        ("603 60 00 00 00 00 00 00 00", Request::ReadSegment { toggle: false }),
        ("603 70 00 00 00 00 00 00 00", Request::ReadSegment { toggle: true }),
        ("603 21 08 10 00 12 00 00 00", Request::Write(name, Start::Segmented { size: Some(18) })),
        ("603 00 41 6e 6f 74 68 65 72", Request::WriteSegment(segment(false, "Another", false))),
        ("603 10 20 6e 61 6d 65 20 6f", Request::WriteSegment(segment(true, " name o", false))),
        ("603 07 66 20 69 74 00 00 00", Request::WriteSegment(segment(false, "f it", true))),
    ] {
        assert_eq!(Request::decode(&frame(line)), Some((node(), request)), "{line}");
        assert_eq!(request.encode(node()), frame(line));
        assert_eq!(Answer::decode(&frame(line)), None);
    }
    for (line, answer) in [
        ("583 60 17 10 00 00 00 00 00", Answer::Written(Object::new(0x1017, 0))),
        (
            "583 43 00 10 00 92 01 02 00",
            Answer::Read(Object::new(0x1000, 0), Start::Expedited(Bytes::of(&0x0002_0192_u32.to_le_bytes()))),
        ),
        ("583 41 08 10 00 13 00 00 00", Answer::Read(name, Start::Segmented { size: Some(19) })),
        ("583 00 53 69 6d 75 6c 61 74", Answer::Segment(segment(false, "Simulat", false))),
        ("583 10 65 64 20 73 65 72 76", Answer::Segment(segment(true, "ed serv", false))),
        ("583 05 6f 20 34 30 32 00 00", Answer::Segment(segment(false, "o 402", true))),
        ("583 20 00 00 00 00 00 00 00", Answer::SegmentWritten { toggle: false }),
        ("583 30 00 00 00 00 00 00 00", Answer::SegmentWritten { toggle: true }),
        ("583 80 00 20 00 00 00 02 06", Answer::Abort(Object::new(0x2000, 0), AbortCode::NO_OBJECT)),
    ] {
        assert_eq!(Answer::decode(&frame(line)), Some((node(), answer)), "{line}");
        assert_eq!(answer.encode(node()), frame(line));
        assert_eq!(Request::decode(&frame(line)), None);
    }
}

#[test]
fn management_and_emergencies_are_the_frames_of_a_public_master_and_its_node() {
    for (line, command, to) in
        [("000 01 03", Command::Start, Some(node())), ("000 80 00", Command::PreOperational, None)]
    {
        assert_eq!((command.encode(to), Command::decode(&frame(line))), (frame(line), Some((command, to))));
    }
    for (line, state) in
        [("703 00", State::BootUp), ("703 05", State::Operational), ("703 7f", State::PreOperational)]
    {
        assert_eq!((state.encode(node()), State::decode(&frame(line))), (frame(line), Some((node(), state))));
    }
    let emergency = Emergency { code: 0x8110, register: 0x11, maker: [1, 2, 3, 4, 5] };
    let line = frame("083 10 81 11 01 02 03 04 05");
    assert_eq!((emergency.encode(node()), Emergency::decode(&line)), (line, Some((node(), emergency))));
    assert_eq!(emergency.meaning(), "frames were lost: overrun");
    assert_eq!(nmt::sync(), frame("080"));
    assert_eq!(Function::of_frame(&nmt::sync()), Some(Function::Sync));
}

#[test]
fn every_function_has_one_id_and_every_id_at_most_one_function() {
    let mut found = 0;
    for id in 0..0x800 {
        if let Some(function) = Function::of(id) {
            assert_eq!(function.id(), id, "{function:?}");
            found += 1;
        }
    }
    // NMT, SYNC, time; 127 nodes with an emergency, eight PDOs, two ways of service data and a heartbeat.
    assert_eq!(found, 3 + 127 * 12);
    // A drive of 20 (hex) and more reports emergencies on ids of PowerCubes.
    assert_eq!(Function::Emergency(NodeId::new(0x20).unwrap()).id(), 0x0A0);
}

#[test]
fn a_map_is_set_in_the_order_in_which_nodes_take_it() {
    let map = Map::new(&[Entry::new(0x6040, 0, 2), Entry::new(0x607A, 0, 4)]).unwrap();
    let steps: Vec<String> = set_up(node(), Direction::Receive, 1, map, Transmission::Sync(1))
        .map(|(object, value)| format!("{object} {value:?}"))
        .collect();
    assert_eq!(
        steps,
        [
            "1400:01 [03, 02, 00, 80]",
            "1600:00 [00]",
            "1600:01 [10, 00, 40, 60]",
            "1600:02 [20, 00, 7a, 60]",
            "1600:00 [02]",
            "1400:02 [01]",
            "1400:01 [03, 02, 00, 00]",
        ]
    );
    // Enabled, to position 10000.
    assert_eq!(
        Function::Rpdo(1, node()).frame::<6>(map.pack(&[0x0F, 10_000]).get().try_into().unwrap()),
        frame("203 0F 00 10 27 00 00")
    );
    assert_eq!(
        map.unpack(&[0x37, 0x06, 0xF0, 0xD8, 0xFF, 0xFF]).map(|v| [v[0], v[1]]),
        Some([0x0637, -10_000])
    );
    assert_eq!(map.unpack(&[0x37, 0x06, 0xF0, 0xD8, 0xFF]), None);
    let nine = [Entry::new(0x6040, 0, 2), Entry::new(0x607A, 0, 4), Entry::new(0x60FF, 0, 4)];
    assert!(Map::new(&nine).is_none() && Map::new(&[Entry::new(0x6040, 0, 0)]).is_none());
    let events = set_up(node(), Direction::Transmit, 3, Map::new(&[]).unwrap(), Transmission::Event);
    assert_eq!(
        events.map(|(object, _)| object.index).collect::<Vec<_>>(),
        [0x1802, 0x1A02, 0x1A02, 0x1802, 0x1802]
    );
}
