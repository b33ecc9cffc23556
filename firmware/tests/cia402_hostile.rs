//! Any frames at any time on a bus of CANopen servos: the group uses only its own ids, its work is bounded, and random frames
//! do not count as drives.

use canopen_protocol::{Function, NodeId};
use firmware::group::{Command, DriveGroup, GroupEvent};
use firmware::groups::cia402::{Cia402, Home, Options, Servo};
use firmware::settings::Settings;
use proptest::prelude::*;
use protocol::{Duration, Frame, Id, Instant, JointIndex, StandardId};

const JOINTS: usize = 3;
/// A call: an event for each joint, their ends, and a few of the group.
const EVENTS_MAX: usize = 32;

fn joint(index: usize) -> JointIndex {
    JointIndex::new(index).unwrap()
}

fn options() -> Options {
    let servo = |node| Servo {
        node: NodeId::new(node).unwrap(),
        counts_per_turn: 409_600,
        rated_mnm: 50_000,
        home: if node == 4 { Home::Here } else { Home::Absolute },
    };
    Options::new(&[servo(3), servo(4), servo(5)]).unwrap()
}

#[derive(Clone, Debug)]
enum Act {
    Frame(Frame),
    Wait(u64),
    Order(Command),
}

fn frames() -> impl Strategy<Value = Frame> {
    let node = 3_u8..=5;
    let own = (node, 0_usize..5).prop_map(|(node, kind)| {
        let node = NodeId::new(node).unwrap();
        let functions = [
            Function::Tpdo(1, node),
            Function::SdoFromNode(node),
            Function::Emergency(node),
            Function::Heartbeat(node),
            Function::SdoToNode(node),
        ];
        functions[kind].id()
    });
    let id = prop_oneof![6 => own, 1 => 0_u16..=0x7FF];
    let head = prop_oneof![
        2 => Just(vec![0x27, 0x12]),
        1 => Just(vec![0x40, 0x02]),
        1 => Just(vec![0x60, 0x16, 0x10, 0x01]),
        1 => Just(vec![0x43, 0x00, 0x10, 0x00, 0x92, 0x01, 0x02, 0x00]),
        1 => Just(vec![0x05]),
        2 => proptest::collection::vec(any::<u8>(), 0..3),
    ];
    (id, head, proptest::collection::vec(any::<u8>(), 0..=6)).prop_map(|(id, mut data, tail)| {
        data.extend(tail);
        data.truncate(8);
        Frame::new(Id::Standard(StandardId::from_low_bits(id)), &data).unwrap()
    })
}

fn acts() -> impl Strategy<Value = Act> {
    let commands = [
        Command::Find { reset: false },
        Command::Find { reset: true },
        Command::Reset,
        Command::Stand { armed: true },
        Command::Abandon,
        Command::Home(joint(0)),
        Command::Home(joint(1)),
        Command::Track,
        Command::MoveTo { joint: joint(2), q_rad: 0.3 },
        Command::Halt,
        Command::HaltJoint(joint(1)),
        Command::Jog { joint: joint(0), qd_rad_s: 0.2, until: Instant::from_micros(u64::MAX / 2) },
    ];
    prop_oneof![
        6 => frames().prop_map(Act::Frame),
        4 => (0_u64..9_000).prop_map(Act::Wait),
        1 => proptest::sample::select(commands.to_vec()).prop_map(Act::Order),
    ]
}

proptest! {
    #[test]
    fn nothing_on_the_bus_makes_the_group_leave_its_ids_or_find_servos_that_do_not_answer(
        acts in proptest::collection::vec(acts(), 1..300),
    ) {
        let mut settings = Settings::powercube6();
        settings.joints = JOINTS as u32;
        let (options, mut group) = (options(), Cia402::new(options()));
        let own: Vec<u16> = options.ids().map(StandardId::get).collect();
        let mut now = Instant::from_micros(1);
        for act in acts {
            match act {
                Act::Frame(frame) => group.handle_packet(now, &settings, &frame),
                Act::Wait(us) => {
                    now += Duration::from_micros(us);
                    group.handle_timeout(now, &settings);
                    prop_assert!(group.poll_timeout(now, &settings) > Some(now), "a deadline stays in the past");
                }
                Act::Order(command) => group.command(now, &settings, command),
            }
            let mut events = 0;
            while let Some(event) = group.poll_event(now, &settings) {
                events += 1;
                prop_assert!(event != GroupEvent::Found, "no servo was set up");
            }
            prop_assert!(events <= EVENTS_MAX);
            group.flush(now, &settings);
            while let Some(frame) = group.poll_packet() {
                let Id::Standard(id) = frame.id() else { panic!("{frame:?}") };
                prop_assert!(own.contains(&id.get()), "{:#x}", id.get());
            }
            let due = group.poll_timeout(now, &settings);
            prop_assert!(due.is_some());
        }
    }
}
