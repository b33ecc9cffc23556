//! Hostile input: any frames at any time, in every state. The bench checks each frame of the controller against its
//! conditions (limits, states, bounded work, deadlines that move on).

use crate::bench::*;
use firmware::events::Action;
use firmware::fault::Cause;
use firmware::joints::PerJoint;
use firmware::orders::{Order, Target};
use firmware::retarget::EndState;
use firmware::state::StateKind;
use proptest::prelude::*;
use protocol::{Duration, Frame, Id, Instant, StandardId};

/// A frame that is as random as possible, with a weight on ids and bytes that have a meaning.
fn frames() -> impl Strategy<Value = Frame> {
    let id = prop_oneof![
        4 => (0xA1u16..=0xA6).boxed(),
        1 => (0x61u16..=0x66).boxed(),
        1 => (0xC0u16..=0x100).boxed(),
        1 => (0u16..=0x7FF).boxed(),
    ];
    let head = prop_oneof![
        3 => Just(vec![0x0B, 0x0E]),
        2 => Just(vec![0x08, 0x50]),
        1 => Just(vec![0x08, 0x4F]),
        1 => Just(vec![0x0A, 0x62]),
        1 => Just(vec![0x0A, 0x27]),
        1 => Just(vec![0x0A, 0x4D]),
        2 => proptest::collection::vec(any::<u8>(), 0..3),
    ];
    (id, head, proptest::collection::vec(any::<u8>(), 0..=6)).prop_map(|(id, mut data, tail)| {
        data.extend(tail);
        data.truncate(8);
        Frame::new(Id::Standard(StandardId::from_low_bits(id)), &data).unwrap()
    })
}

#[derive(Clone, Debug)]
enum Act {
    Frame(Frame),
    /// An earlier frame of the bus comes again.
    Echo(usize),
    Wait(u64),
    Order(u8, u64),
    Stop,
}

fn acts() -> impl Strategy<Value = Vec<Act>> {
    let act = prop_oneof![
        6 => frames().prop_map(Act::Frame),
        4 => (1usize..40).prop_map(Act::Echo),
        8 => (1u64..4_000).prop_map(Act::Wait),
        1 => (0u8..14, any::<u64>()).prop_map(|(kind, x)| Act::Order(kind, x)),
        1 => Just(Act::Stop),
    ];
    proptest::collection::vec(act, 1..80)
}

fn order(kind: u8, x: u64, bench: &Bench) -> Order {
    let valid = Duration::from_micros(x % 40_000_000);
    let name =
        bench.controller.download(0, &mut []).map(|_| firmware::store::FileName { crc64: x, len: x as u32 });
    let name = name.unwrap();
    match kind {
        0 => Order::ArmPrepare { crc64: x, valid },
        1 => Order::ArmConfirm { token: x as u32, valid },
        2 => Order::Disarm,
        3 => Order::Run(name),
        4 => Order::Stop,
        5 => Order::ClearFault { code: x as u16 % 800 },
        6 => match bench.controller.state().fault() {
            Some(fault) => Order::ClearFault { code: fault.cause.code() },
            None => Order::ClearFault { code: Cause::HostLost.code() },
        },
        7 => Order::Home { mask: x as u8 },
        8 | 9 => Order::Jog {
            joint: joint(x as usize % 8),
            qd_rad_s: f32::from_bits(x as u32),
            hold: Duration::from_micros(x % 600_000),
        },
        10 => Order::Gripper { open: x.is_multiple_of(2) },
        11 => Order::RunAt { name, start: Instant::from_micros(x) },
        12 => {
            let state =
                EndState { q_rad: f32::from_bits(x as u32), qd_rad_s: f32::from_bits((x >> 32) as u32) };
            let at = bench.instant() + Duration::from_micros(x % 1_000_000);
            let events = [Some((bench.instant(), Action::Open)).filter(|_| x.is_multiple_of(3)), None];
            Order::Retarget(Target { at, joints: 6, state: PerJoint::splat(state), events })
        }
        _ => Order::Commit(name),
    }
}

fn play(bench: &mut Bench, acts: &[Act]) {
    for act in acts {
        match act {
            Act::Frame(frame) => bench.inject(frame),
            Act::Echo(back) => {
                let earlier = bench.log.iter().rev().filter(|l| !l.by_controller).nth(*back).map(|l| l.frame);
                if let Some(frame) = earlier {
                    bench.inject(&frame);
                }
            }
            Act::Wait(us) => bench.run_for(*us),
            Act::Order(kind, x) => {
                let order = order(*kind, *x, bench);
                let _ = bench.order(order);
            }
            Act::Stop => bench.stop_now(),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(120))]

    #[test]
    fn no_frames_make_a_throw_leave_its_limits_or_the_controller_its_rules(acts in acts(), into_us in 0u64..900_000) {
        let mut bench = Bench::ready(Options::default(), &throw_start());
        bench.start(&throw_file(3_000, true));
        bench.run_for(into_us);
        play(&mut bench, &acts);
        bench.run_for(300_000);
        for (i, drive) in bench.drives.iter().enumerate() {
            let limits = bench.controller.settings().joint.0[i];
            let (low, high) = (f64::from(limits.q_min_rad) - 0.02, f64::from(limits.q_max_rad) + 0.02);
            prop_assert!((low..high).contains(&drive.q), "joint {} at {} rad", i + 1, drive.q);
        }
    }

    #[test]
    fn no_frames_or_orders_make_a_standing_arm_run(acts in acts(), booted: bool) {
        let mut bench = if booted {
            Bench::ready(Options::default(), &[0.0; 6])
        } else {
            Bench::new(Options { homed: false, ..Options::default() })
        };
        play(&mut bench, &acts);
        bench.run_for(100_000);
        prop_assert!(!matches!(bench.kind(), StateKind::Running | StateKind::Armed));
        for drive in &bench.drives {
            // Jogging may be among the orders; nothing else moves.
            prop_assert!(drive.v.abs() < 0.3);
        }
    }
}

#[test]
fn bus_full_of_foreign_frames_is_only_counted() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    for k in 0..2_000u16 {
        let id = Id::Standard(StandardId::from_low_bits(0xE1 + k % 6));
        bench.inject(&Frame::from_array(id, [0x0A, 0x3C]));
    }
    let now = bench.instant();
    assert_eq!(bench.controller.take_sample(now).counters.foreign_requests, 2_000);
    assert_eq!(bench.kind(), StateKind::Ready);
}
