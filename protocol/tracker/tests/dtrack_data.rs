//! Data of DTrack: the example byte by byte, every kind of line, refusals, time and order.

use proptest::prelude::*;
use protocol::{Duration, Instant};
use tracker_protocol::dtrack::{
    Body, DataFrame, DataProblem, DayClock, FrameGate, Hybrid, HybridState, Marker, UnixStamp, Verdict,
};
use tracker_protocol::pose::{columns_of_quaternion, quaternion_of_columns};

const EXAMPLE: &str = "fr 120\r\nts 44597.741924\r\n6dcal 1\r\n6d 1 [0 1.000][2500.000 50.000 1000.000 0.0000 0.0000 90.0000][0.000000 1.000000 0.000000 -1.000000 0.000000 0.000000 0.000000 0.000000 1.000000]\r\n3d 0\r\n";

#[test]
fn example_is_read_and_written_byte_by_byte() {
    assert_eq!(EXAMPLE.len(), 187);
    let frame = DataFrame::parse(EXAMPLE.as_bytes()).unwrap();
    assert_eq!(String::from_utf8(frame.write()).unwrap(), EXAMPLE);
    assert_eq!((frame.frame, frame.ts_s, frame.calibrated), (120, Some(44597.741924), Some(1)));
    assert_eq!(
        (frame.markers.as_deref(), frame.hybrids.as_deref(), frame.skipped_lines),
        (Some(&[][..]), None, 0)
    );
    let pose = frame.pose(0, &mut DayClock::new()).unwrap().unwrap();
    assert_eq!((pose.body, pose.tracked, pose.position_m), (0, true, [2.5, 0.05, 1.0]));
    assert_eq!((pose.stamp, pose.age), (Instant::from_micros(44_597_741_924), Duration::ZERO));
    // +90 degrees about z.
    let h = 0.5_f64.sqrt();
    assert!(pose.rotation_wxyz.iter().zip([h, 0.0, 0.0, h]).all(|(a, b)| (a - b).abs() < 1e-12), "{pose:?}");
    assert_eq!(frame.pose(1, &mut DayClock::new()), Ok(None));
}

#[test]
fn every_kind_of_line_is_read_and_unknown_ones_are_skipped() {
    let text = "fr 3823\nts2 1795290599 994761 9000\n6dcal 4\n\
        6d 2 [0 1.000][1.000 2.000 3.000][1 0 0 0 1 0 0 0 1] [3 1.000][-1.5 0 0 10 20 30][1 0 0 0 1 0 0 0 1]\n\
        6di 2 [0 0 0.000][0 0 0][1 0 0 0 1 0 0 0 1] [1 3 1.500][7 8 9][1 0 0 0 1 0 0 0 1]\n\
        3d 1 [7 1.000][210.730 -90.669 -108.554]\n6df2 1 0\n6dmt2 0 0\n6dmtr 0 0\ngl 0\n6dcov 0\n6dj 0\nst whatever [x]\0";
    let frame = DataFrame::parse(text.as_bytes()).unwrap();
    assert_eq!(frame.ts2, Some(UnixStamp { s: 1_795_290_599, us: 994_761, latency_us: 9000 }));
    let bodies = frame.bodies.as_ref().unwrap();
    assert_eq!((bodies[0].id, bodies[0].angles_deg, bodies[1].id), (0, None, 3));
    assert_eq!((bodies[1].position_mm, bodies[1].angles_deg), ([-1.5, 0.0, 0.0], Some([10.0, 20.0, 30.0])));
    let hybrids = frame.hybrids.as_ref().unwrap();
    assert_eq!(
        (hybrids[0].state, hybrids[1].state, hybrids[1].error_deg),
        (HybridState::Lost, HybridState::Both, 1.5)
    );
    let marker = Marker { id: 7, quality: 1.0, position_mm: [210.730, -90.669, -108.554] };
    assert_eq!(frame.markers.as_deref(), Some(&[marker][..]));
    assert_eq!(frame.skipped_lines, 7);
    let pose = frame.pose(3, &mut DayClock::new()).unwrap().unwrap();
    assert_eq!(
        (pose.stamp, pose.age),
        (Instant::from_micros(1_795_290_599_994_761), Duration::from_millis(9))
    );
}

#[test]
fn lost_body_is_missing_and_gives_no_pose() {
    let frame = DataFrame::parse(b"fr 1\r\nts 1.0\r\n6dcal 1\r\n6d 0\r\n").unwrap();
    assert_eq!(frame.bodies.as_deref(), Some(&[][..]));
    assert_eq!(frame.pose(0, &mut DayClock::new()), Ok(None));
    // A negative quality followed by zeros is not a pose either, although its matrix is not a rotation.
    let gone = b"fr 1\nts 1.0\n6d 1 [0 -1.000][0 0 0 0 0 0][0 0 0 0 0 0 0 0 0]\n";
    assert_eq!(DataFrame::parse(gone).unwrap().pose(0, &mut DayClock::new()), Ok(None));
}

#[test]
fn matrix_that_is_no_rotation_gives_no_pose() {
    for matrix in ["0 0 0 0 0 0 0 0 0", "1 0 0 0 1 0 0 0 -1", "1.1 0 0 0 1 0 0 0 1", "1 0 0 0.01 1 0 0 0 1"] {
        let text = format!("fr 1\nts 1.0\n6d 1 [0 1.000][0 0 0]{}\n", format_args!("[{matrix}]"));
        let frame = DataFrame::parse(text.as_bytes()).unwrap();
        assert!(frame.pose(0, &mut DayClock::new()).is_err(), "{matrix}");
    }
    assert!(quaternion_of_columns(&[f64::NAN; 9]).is_err());
}

#[test]
fn wrong_lines_are_refused_with_their_number() {
    let table: [(&[u8], usize, &str); 14] = [
        (b"", 1, "the first line is not the frame counter 'fr'"),
        (b"ts 1.0\nfr 1", 1, "the first line is not the frame counter 'fr'"),
        (b"fr", 1, "frame counter missing or not a count"),
        (b"fr -1", 1, "frame counter missing or not a count"),
        (b"fr 1 2", 1, "text after the last value"),
        (b"fr 1\nfr 2", 2, "second line 'fr'"),
        (b"fr 1\nts 90000", 2, "time stamp missing or not seconds of a day"),
        (b"fr 1\nts 1e3", 2, "time stamp missing or not a plain decimal"),
        (b"fr 1\nts2 1 1000000 0", 2, "microseconds missing or not below a million"),
        (b"fr 1\r\n6d 2 [0 1.0][0 0 0][1 0 0 0 1 0 0 0 1]", 2, "bracket missing or not '['"),
        (b"fr 1\r\n6d 1 [0 1.0][0 0 0 0][1 0 0 0 1 0 0 0 1]", 2, "angle missing or not a plain decimal"),
        (b"fr 1\r\n6d 1 [0 1.0][0 0 0][1 0 0 0 1 0 0 0]", 2, "rotation missing or not a plain decimal"),
        (b"fr 1\r\n3d 99999999999999", 2, "bracket missing or not '['"),
        (b"fr 1\n3d 0\xff", 2, "not ASCII text"),
    ];
    for (bytes, line, reason) in table {
        let error = DataFrame::parse(bytes).unwrap_err();
        assert_eq!((error.line, error.problem.to_string().as_str()), (line, reason), "{bytes:?}");
    }
    let long = vec![b' '; 32_769];
    assert_eq!(DataFrame::parse(&long).unwrap_err().problem, DataProblem::TooLong(32_769));
}

#[test]
fn time_goes_on_over_midnight_and_an_overtaken_datagram_keeps_its_place() {
    let mut clock = DayClock::new();
    let stamps = [86_399.95, 86_399.99, 0.02, 86_399.97, 0.01, 0.05, 43_200.0, 86_399.0, 1.0];
    let seconds = stamps.map(|ts| clock.unwrap_day(ts).as_secs_f64());
    let day = 86_400.0;
    let expected = [
        86_399.95,
        86_399.99,
        day + 0.02,
        86_399.97,
        day + 0.01,
        day + 0.05,
        day + 43_200.0,
        2.0 * day - 1.0,
        2.0 * day + 1.0,
    ];
    assert!(seconds.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{seconds:?}");
}

#[test]
fn frames_are_judged_by_their_counter() {
    let mut gate = FrameGate::new(100);
    let frames = [500, 501, 501, 500, 505, 404, 405, 403, 10, 11];
    let verdicts = frames.map(|frame| gate.judge(frame));
    let new = |skipped| Verdict::New { skipped };
    let old = Verdict::Old;
    assert_eq!(
        verdicts,
        [Verdict::First, new(0), old, old, new(3), Verdict::Restart, new(0), old, Verdict::Restart, new(0)]
    );
}

fn quaternion() -> impl Strategy<Value = [f64; 4]> {
    prop::array::uniform4(-1.0..1.0_f64).prop_filter_map("too short", |q| {
        let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        let sign = if q[0] < 0.0 { -1.0 } else { 1.0 };
        (norm > 0.1).then(|| q.map(|x| sign * x / norm))
    })
}

fn frame() -> impl Strategy<Value = DataFrame> {
    let position = || prop::array::uniform3(-10_000.0..10_000.0_f64);
    let body =
        (any::<u32>(), position(), prop::option::of(prop::array::uniform3(-180.0..180.0)), quaternion())
            .prop_map(|(id, position_mm, angles_deg, q)| Body {
                id,
                quality: 1.0,
                position_mm,
                angles_deg,
                rotation: columns_of_quaternion(q),
            });
    let states = [HybridState::Lost, HybridState::Inertial, HybridState::Optical, HybridState::Both];
    let hybrid = (any::<u32>(), prop::sample::select(states.to_vec()), position(), quaternion()).prop_map(
        |(id, state, position_mm, q)| Hybrid {
            id,
            state,
            error_deg: 0.5,
            position_mm,
            rotation: columns_of_quaternion(q),
        },
    );
    let marker =
        (any::<u32>(), position()).prop_map(|(id, position_mm)| Marker { id, quality: 1.0, position_mm });
    let stamp = (any::<u64>(), 0..1_000_000_u32, any::<u64>()).prop_map(|(s, us, latency_us)| UnixStamp {
        s,
        us,
        latency_us,
    });
    (
        any::<u64>(),
        prop::option::of(0.0..86_400.0_f64),
        prop::option::of(stamp),
        prop::option::of(any::<u32>()),
        prop::option::of(prop::collection::vec(body, 0..4)),
        prop::option::of(prop::collection::vec(hybrid, 0..3)),
        prop::option::of(prop::collection::vec(marker, 0..4)),
    )
        .prop_map(|(frame, ts_s, ts2, calibrated, bodies, hybrids, markers)| DataFrame {
            frame,
            ts_s,
            ts2,
            calibrated,
            bodies,
            hybrids,
            markers,
            skipped_lines: 0,
        })
}

proptest! {
    #[test]
    fn what_is_written_is_read_to_its_decimals(frame in frame()) {
        let bytes = frame.write();
        let read = DataFrame::parse(&bytes).unwrap();
        // The second writing shows every field at the resolution of the wire.
        prop_assert_eq!(read.write(), bytes);
        for (a, b) in read.bodies.iter().flatten().zip(frame.bodies.iter().flatten()) {
            prop_assert!(a.position_mm.iter().zip(b.position_mm).all(|(a, b)| (a - b).abs() <= 0.000_501));
            prop_assert!(a.rotation.iter().zip(b.rotation).all(|(a, b)| (a - b).abs() <= 0.000_000_501));
            prop_assert!(quaternion_of_columns(&a.rotation).is_ok());
        }
        prop_assert_eq!((read.frame, read.ts2, read.calibrated), (frame.frame, frame.ts2, frame.calibrated));
    }

    #[test]
    fn quaternion_and_matrix_are_inverse(q in quaternion()) {
        let back = quaternion_of_columns(&columns_of_quaternion(q)).unwrap();
        // At w = 0 both signs are the same rotation.
        let same = q.iter().zip(back).map(|(a, b)| a * b).sum::<f64>().abs();
        prop_assert!((same - 1.0).abs() < 1e-12, "{q:?} {back:?}");
    }

    #[test]
    fn no_bytes_make_the_reader_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = DataFrame::parse(&bytes);
        let mut headed = b"fr 1\n6d ".to_vec();
        headed.extend(&bytes);
        let _ = DataFrame::parse(&headed);
    }

    #[test]
    fn no_damage_to_a_datagram_makes_the_reader_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), any::<bool>()), 1..6),
    ) {
        let mut bytes = EXAMPLE.as_bytes().to_vec();
        for (at, byte, remove) in edits {
            let at = at.index(bytes.len());
            if remove { bytes.remove(at); } else { bytes[at] = byte; }
        }
        if let Ok(frame) = DataFrame::parse(&bytes) {
            let _ = frame.pose(0, &mut DayClock::new());
        }
    }
}
