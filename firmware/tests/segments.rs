//! A plan that is longer than the controller holds, measured at the drives: it continues with segments, stops along
//! its path when a segment is missing, and accepts no segment of another plan.

use crate::bench::host::Host;
use crate::bench::*;
use firmware::authority::Peer;
use firmware::fault::{Cause, Refusal};
use firmware::joints::PerJoint;
use firmware::orders::Order;
use firmware::segment;
use firmware::settings::Settings;
use firmware::spline::{KNOTS_MAX, Knot};
use firmware::state::StateKind;
use firmware::store::FileName;
use firmware::trajectory_format::Header;
use protocol::cyphal::bits::{Decode, Encode, Writer};
use protocol::cyphal::crc::Crc64;
use protocol::cyphal::cubecell::command::{self, Room};
use protocol::cyphal::uavcan::command::Status;
use sha2::{Digest as _, Sha256};

/// Where the path is centred.
const CENTRE_RAD: [f64; 6] = [0.0, -0.8, -2.4, 0.1, -0.9, 0.0];
/// Time between two knots, µs.
const STEP_US: u32 = 25_000;

/// Position and speed of a joint on the path: each swings in its own time, and begins and ends slowly.
fn on_path(i: usize, t_s: f64, end_s: f64) -> (f64, f64) {
    const RAMP_S: f64 = 1.0;
    let (omega, radius) = (0.8 + 0.2 * i as f64, 0.2);
    let (wave, slope) = (radius * (omega * t_s).sin(), radius * omega * (omega * t_s).cos());
    // Smoothstep in at the begin, out at the end.
    let smooth = |x: f64| (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / RAMP_S);
    let (into, into_d) = smooth((t_s / RAMP_S).clamp(0.0, 1.0));
    let (out, out_d) = smooth(((end_s - t_s) / RAMP_S).clamp(0.0, 1.0));
    (CENTRE_RAD[i] + wave * into * out, slope * into * out + wave * (into_d * out - into * out_d))
}

fn knot(k: u32, end_s: f64) -> Knot {
    let t_us = k * STEP_US;
    let mut state = PerJoint::default();
    for i in 0..6 {
        let (q, qd) = on_path(i, f64::from(t_us) * 1e-6, end_s);
        state.set(joint(i), (q as f32, qd as f32));
    }
    Knot { t_us, state }
}

/// A path with `knots` knots: the file that begins it with `held` of them, and the segments.
fn path(knots: u32, held: usize) -> (Vec<u8>, Vec<Vec<u8>>) {
    let end_s = f64::from((knots - 1) * STEP_US) * 1e-6;
    let knots: Vec<Knot> = (0..knots).map(|k| knot(k, end_s)).collect();
    let (mut segments, mut next) = (Vec::new(), None);
    for piece in knots[held..].chunks(segment::knots_max(6)).rev() {
        let mut bytes = [0; segment::LEN_MAX];
        let len = segment::encode(next.as_ref(), piece, 6, &mut bytes).unwrap();
        next = Some(Sha256::digest(&bytes[..len]).into());
        segments.insert(0, bytes[..len].to_vec());
    }
    let header = Header { joints: 6, period_us: 3_000, next, ..Header::default() };
    (file(&header, &knots[..held]), segments)
}

fn extend(bench: &mut Bench, bytes: &[u8]) -> Result<usize, Refusal> {
    let now = bench.instant();
    bench.controller.extend(now, HOST, bytes)
}

fn started(file: &[u8]) -> Bench {
    let mut bench = Bench::ready(Options::default(), &CENTRE_RAD);
    bench.start(file);
    bench.run_until(100_000, |bench| bench.kind() == StateKind::Running);
    bench
}

#[test]
fn path_of_a_minute_is_followed_to_its_end_through_a_ring_of_256_knots() {
    let (knots, held) = (2_401, KNOTS_MAX);
    let (file, segments) = path(knots, held);
    let mut bench = started(&file);
    let begun = bench.now;
    let mut sent = 0;
    while bench.kind() == StateKind::Running {
        bench.run_for(20_000);
        while let Some(bytes) = segments.get(sent) {
            match extend(&mut bench, bytes) {
                Ok(_) => sent += 1,
                Err(refusal) => {
                    assert_eq!(refusal, Refusal::of(Cause::SegmentEarly));
                    break;
                }
            }
        }
        assert!(bench.now < begun + 65_000_000, "it ends");
    }
    assert_eq!((bench.kind(), sent), (StateKind::Ready, segments.len()));
    assert!((59_900_000..61_500_000).contains(&(bench.now - begun)), "{} us", bench.now - begun);
    // Where the plan ends, by the formula of the path, and where the drives stand.
    for (i, centre_rad) in CENTRE_RAD.into_iter().enumerate() {
        assert!((bench.drives[i].q - centre_rad).abs() < 1e-3, "joint {i}");
    }
}

/// The drives stay on the formula, also on knots that came in flight.
#[test]
fn drives_are_where_the_formula_of_the_path_is_at_each_time() {
    let (file, segments) = path(401, 200);
    let mut bench = started(&file);
    let mut sent = 0;
    let mut seen = 0;
    while bench.kind() == StateKind::Running {
        bench.run_for(10_000);
        if let Some(bytes) = segments.get(sent) {
            sent += usize::from(extend(&mut bench, bytes).is_ok());
        }
        let now = bench.instant();
        let t_s = f64::from(bench.controller.take_sample(now).path_us) * 1e-6;
        if t_s > 0.1 && t_s < 9.9 {
            seen += 1;
            for i in 0..6 {
                let off_rad = bench.drives[i].q - on_path(i, t_s, 10.0).0;
                assert!(off_rad.abs() < 0.012, "joint {i} is {off_rad} off at {t_s}");
            }
        }
    }
    assert!(seen > 900, "{seen}");
    assert_eq!(bench.kind(), StateKind::Ready);
}

#[test]
fn segment_that_does_not_come_is_a_stop_along_the_path_with_its_cause() {
    let (file, segments) = path(801, 100);
    for given in [0, 10, 40] {
        let mut bench = started(&file);
        for bytes in &segments[..given] {
            while extend(&mut bench, bytes).is_err() {
                bench.run_for(10_000);
            }
        }
        let known_s = f64::from((99 + 4 * given as u32) * STEP_US) * 1e-6;
        bench.run_until(20_000_000, |bench| bench.kind() == StateKind::Stopping);
        let mut reached_s = 0.0_f64;
        while bench.kind() == StateKind::Stopping {
            let now = bench.instant();
            let t_s = f64::from(bench.controller.take_sample(now).path_us) * 1e-6;
            reached_s = reached_s.max(t_s);
            for i in 0..6 {
                let off_rad = bench.drives[i].q - on_path(i, t_s, 20.0).0;
                assert!(off_rad.abs() < 0.02, "joint {i} leaves the path by {off_rad} at {t_s}");
            }
            bench.run_for(1_000);
        }
        assert_eq!(bench.kind(), StateKind::Fault);
        assert_eq!(bench.controller.state().fault().map(|fault| fault.cause), Some(Cause::PathRanDry));
        assert!(reached_s > known_s - 1.3 && reached_s < known_s, "stood at {reached_s} of {known_s}");
    }
}

#[test]
fn only_the_segment_that_follows_is_taken_and_a_refusal_changes_nothing() {
    let (file, segments) = path(801, 200);
    let mut bench = Bench::ready(Options::default(), &CENTRE_RAD);
    assert_eq!(extend(&mut bench, &segments[0]), Err(Refusal::of(Cause::OrderNotNow)), "nothing runs");
    bench.start(&file);
    bench.run_for(100_000);
    let room = extend(&mut bench, &segments[0]).unwrap();
    assert_eq!(room, KNOTS_MAX - 204);
    // An answer was lost: the same again.
    assert_eq!(extend(&mut bench, &segments[0]), Ok(room));
    let mut changed = segments[1].clone();
    changed[40] ^= 1;
    let (_, of_another) = path(961, 204);
    for wrong in [&segments[2], &changed, &of_another[0], &vec![0; 255], &Vec::new()] {
        assert_eq!(extend(&mut bench, wrong), Err(Refusal::of(Cause::SegmentOther)));
    }
    let now = bench.instant();
    let stranger = bench.controller.extend(now, Peer::new(43), &segments[1]);
    assert_eq!(stranger, Err(Refusal::of(Cause::OtherHost)));
    assert_eq!(extend(&mut bench, &segments[1]), Ok(room - 4));
    bench.order(Order::Stop).unwrap();
    assert_eq!(extend(&mut bench, &segments[2]), Err(Refusal::of(Cause::OrderNotNow)), "it stops");
}

/// The host chooses the content; the controller checks the limits.
#[test]
fn segment_beyond_a_limit_is_refused_with_joint_and_knot_and_the_plan_stops_on_its_path() {
    let limits = Settings::powercube6();
    let end_s = 20.0;
    type Spoil = fn(&mut [Knot]);
    let bad: [(Cause, Spoil); 6] = [
        (Cause::FileNumbers, |k| k[2].state.0[1].0 = f32::NAN),
        (Cause::FileTime, |k| k[2].t_us = k[1].t_us + 1_000),
        (Cause::FileTime, |k| k[2].t_us = k[1].t_us - 1),
        (Cause::PlanVelocity, |k| k[2].state.0[1].1 = 3.0),
        (Cause::PlanAcceleration, |k| k[2].state.0[1].0 += 0.01),
        (Cause::PlanPosition, |k| k[2].state.0[1].0 = 4.0),
    ];
    for (cause, spoil) in bad {
        let mut knots: Vec<Knot> = (200..204).map(|k| knot(k, end_s)).collect();
        spoil(&mut knots);
        let mut bytes = [0; segment::LEN_MAX];
        let len = segment::encode(Some(&[7; 32]), &knots, 6, &mut bytes).unwrap();
        let next = Some(Sha256::digest(&bytes[..len]).into());
        let held: Vec<Knot> = (0..200).map(|k| knot(k, end_s)).collect();
        let header = Header { joints: 6, period_us: 3_000, next, ..Header::default() };
        let mut bench = started(&file(&header, &held));
        let refusal = extend(&mut bench, &bytes[..len]).unwrap_err();
        let of_joint = !matches!(cause, Cause::FileTime);
        assert_eq!((refusal.cause, refusal.index), (cause, 2));
        assert_eq!(refusal.joint, of_joint.then(|| joint(1)), "{cause:?}");
        bench.run_until(5_000_000, |bench| bench.kind() == StateKind::Fault);
        for i in 0..6 {
            let limits = limits.joint.at(joint(i));
            assert!((f64::from(limits.q_min_rad)..f64::from(limits.q_max_rad)).contains(&bench.drives[i].q));
        }
    }
    // The last segment must end at rest.
    let (file, segments) = path(202, 200);
    let mut moving = segments[0].clone();
    let speed = moving.len() - 4;
    moving[speed..].copy_from_slice(&0.1_f32.to_le_bytes());
    let mut bench = started(&file);
    assert_eq!(extend(&mut bench, &moving), Err(Refusal::of(Cause::SegmentOther)));
}

#[test]
fn file_that_goes_on_must_last_as_long_as_a_stop_along_it() {
    let (file, _) = path(401, 40);
    let mut bench = Bench::ready(Options::default(), &CENTRE_RAD);
    let at = bench.instant();
    for (k, piece) in file.chunks(256).enumerate() {
        bench.controller.upload(at, HOST, 256 * k, piece).unwrap();
    }
    let name = FileName { crc64: Crc64::of(&file), len: file.len() as u32 };
    assert_eq!(bench.order(Order::Commit(name)), Err(Refusal::of(Cause::FileTime)));
}

/// After a run the knots of the file are no longer there; the next arming loads them again.
#[test]
fn same_path_runs_again_from_its_begin_after_a_whole_run_and_after_a_stop() {
    let (file, segments) = path(161, 80);
    let mut bench = Bench::ready(Options::default(), &CENTRE_RAD);
    let name = bench.upload(&file);
    bench.order(Order::Commit(name)).unwrap();
    for _ in 0..3 {
        bench.arm(name);
        bench.order(Order::Run(name)).unwrap();
        let mut sent = 0;
        while bench.kind() == StateKind::Running {
            bench.run_for(20_000);
            if let Some(bytes) = segments.get(sent) {
                sent += usize::from(extend(&mut bench, bytes).is_ok());
            }
        }
        assert_eq!((bench.kind(), sent), (StateKind::Ready, segments.len()));
    }
    // The run is stopped on its way; from there the begin of the path is far away.
    bench.arm(name);
    bench.order(Order::Run(name)).unwrap();
    bench.run_for(700_000);
    bench.order(Order::Stop).unwrap();
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Stopped);
    let valid = protocol::Duration::from_secs(5);
    let offer = bench.order(Order::ArmPrepare { crc64: name.crc64, valid }).unwrap();
    let firmware::orders::Done::Offer { token, .. } = offer else { panic!("{offer:?}") };
    bench.run_for(1_000_000);
    let refusal = bench.order(Order::ArmConfirm { token, valid }).unwrap_err();
    assert_eq!(refusal.cause, Cause::NotAtStart);
}

struct Raw<'a>(&'a [u8]);

impl Encode for Raw<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.bytes(self.0);
    }
}

#[test]
fn segments_come_as_commands_over_the_bus_and_are_answered_with_the_room_that_is_left() {
    let (file, segments) = path(601, 200);
    let mut host = Host::new();
    for (drive, q) in host.bench.drives.iter_mut().zip(CENTRE_RAD) {
        drive.place(q);
    }
    host.run(800_000, |_, _| {});
    let name = host.arm(&file);
    let run = command::Run {
        trajectory_crc64: name.trajectory_crc64,
        length_bytes: name.length_bytes,
        start_us: 0,
    };
    assert_eq!(host.command(command::RUN, &run).0, Status::SUCCESS);
    // If they came at once, 38 frames would keep the drives off the bus for longer than a period.
    host.gap_us = 1_000;
    let mut rooms = Vec::new();
    for bytes in &segments {
        loop {
            let (status, output) = host.command(command::EXTEND, &Raw(bytes));
            if status == Status::SUCCESS {
                rooms.push(Room::from_bytes(&output).unwrap().knots);
                break;
            }
            let refusal = command::Refusal::from_bytes(&output).unwrap();
            let fault = host.bench.controller.core().state().fault();
            assert_eq!((status, refusal.cause, fault), (Status::FAILURE, Cause::SegmentEarly.code(), None));
            host.run(20_000, |_, _| {});
        }
    }
    assert!(rooms.iter().any(|room| *room < 4) && rooms.iter().all(|room| *room < 56), "{rooms:?}");
}
