//! Any frames at any time on a bus of each family that follows positions: the group stays on its own ids, its work is bounded, and nothing
//! is found by chance.

use firmware::group::{Command, DriveGroup, GroupEvent};
use firmware::groups::cia402::{self, Cia402, Servo};
use firmware::groups::odrive::{self, Axis, Odrive};
use firmware::settings::Settings;
use proptest::prelude::*;
use protocol::canopen::{Function, NodeId};
use protocol::{Duration, Frame, Id, Instant, JointIndex, StandardId};

const JOINTS: usize = 3;
/// A call: an event for each joint, their ends, and a few of the group.
const EVENTS_MAX: usize = 32;

fn joint(index: usize) -> JointIndex {
    JointIndex::new(index).unwrap()
}

fn servos() -> cia402::Options {
    let servo = |node| Servo {
        node: NodeId::new(node).unwrap(),
        counts_per_turn: 409_600,
        rated_mnm: 50_000,
        home: if node == 4 { cia402::Home::Here } else { cia402::Home::Absolute },
        follow: if node == 5 { cia402::Follow::Interpolated } else { cia402::Follow::Cyclic },
    };
    cia402::Options::new(&[servo(3), servo(4), servo(5)]).unwrap()
}

fn axes() -> odrive::Options {
    let axis = |node, version| Axis {
        node: protocol::odrive::NodeId::new(node).unwrap(),
        version,
        gear: 8.0,
        home: if node == 10 { odrive::Home::Motor } else { odrive::Home::Joint },
        current_max_a: 40.0,
        position_gain_1_s: 20.0,
        velocity_gain_nm_s: 1.0,
        integral_gain_nm: 0.0,
    };
    let [old, new] = [protocol::odrive::Version::V05, protocol::odrive::Version::V06];
    let options = odrive::Options::new(&[axis(9, new), axis(10, old), axis(11, new)]).unwrap();
    options.with_endpoints(odrive::Endpoints { firmware: [0, 6, 10], numbers: [1, 2, 3, 4, 5, 6, 7] })
}

#[derive(Clone, Debug)]
enum Act {
    Frame(Frame),
    Wait(u64),
    Order(Command),
}

/// Ids of the drives, and how the data of some of their frames begin.
type Family = (Vec<u16>, Vec<Vec<u8>>);

fn of_servos() -> Family {
    let ids = (3_u8..=5).flat_map(|node| {
        let node = NodeId::new(node).unwrap();
        let functions = [
            Function::Tpdo(1, node),
            Function::SdoFromNode(node),
            Function::Emergency(node),
            Function::Heartbeat(node),
            Function::SdoToNode(node),
        ];
        functions.map(Function::id)
    });
    let heads = vec![
        vec![0x27, 0x12],
        vec![0x40, 0x02],
        vec![0x60, 0x16, 0x10, 0x01],
        vec![0x43, 0x00, 0x10, 0x00, 0x92, 0x01, 0x02, 0x00],
        vec![0x05],
    ];
    (ids.collect(), heads)
}

fn of_axes() -> Family {
    // Heartbeat, version, parameter, estimates, and an order of somebody else.
    let ids =
        (9..=11).flat_map(|node: u16| [0x01, 0x00, 0x05, 0x09, 0x0C].map(|command| node << 5 | command));
    let heads = vec![
        vec![0, 0, 0, 0, 1, 0, 1, 0],
        vec![0, 0, 0, 1, 1, 0, 1, 0],
        vec![2, 4, 4, 58, 0, 6, 10, 0],
        vec![0, 1, 0, 0, 0, 0, 0, 0],
        vec![0, 0, 0xC0, 0x7F],
    ];
    (ids.collect(), heads)
}

fn acts((ids, heads): Family) -> impl Strategy<Value = Vec<Act>> {
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
    let id = prop_oneof![6 => proptest::sample::select(ids), 1 => 0_u16..=0x7FF];
    let head =
        prop_oneof![3 => proptest::sample::select(heads), 1 => proptest::collection::vec(any::<u8>(), 0..3)];
    let frame = (id, head, proptest::collection::vec(any::<u8>(), 0..=6)).prop_map(|(id, mut data, tail)| {
        data.extend(tail);
        data.truncate(8);
        Frame::new(Id::Standard(StandardId::from_low_bits(id)), &data).unwrap()
    });
    let act = prop_oneof![
        6 => frame.prop_map(Act::Frame),
        4 => (0_u64..9_000).prop_map(Act::Wait),
        1 => proptest::sample::select(commands.to_vec()).prop_map(Act::Order),
    ];
    proptest::collection::vec(act, 1..300)
}

/// What one group does with these acts.
fn play<G: DriveGroup<Packet = Frame>>(
    mut group: G,
    own: impl Iterator<Item = StandardId>,
    acts: Vec<Act>,
) -> Result<(), TestCaseError> {
    let mut settings = Settings::powercube6();
    settings.joints = JOINTS as u32;
    let own: Vec<u16> = own.map(StandardId::get).collect();
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
            prop_assert!(event != GroupEvent::Found, "no drive was set up");
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
    Ok(())
}

proptest! {
    #[test]
    fn nothing_on_the_bus_makes_a_group_of_servos_leave_its_ids_or_find_what_does_not_answer(
        acts in acts(of_servos()),
    ) {
        let options = servos();
        play(Cia402::new(options.clone()), options.ids(), acts)?;
    }

    #[test]
    fn nothing_on_the_bus_makes_a_group_of_odrives_leave_its_ids_or_find_what_does_not_answer(
        acts in acts(of_axes()),
    ) {
        let options = axes();
        play(Odrive::new(options.clone()), options.ids(), acts)?;
    }
}
