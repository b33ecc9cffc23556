use super::*;
use proptest::prelude::*;

fn throw() -> (Header, Vec<Knot>) {
    let header = Header {
        joints: 6,
        period_us: 3_000,
        events: PlanEvents::release(Some(560_000)),
        robot_crc32: 7,
        ..Header::default()
    };
    let mut knots = rest(PerJoint::splat(0.1), 920_000).to_vec();
    // Up to 0.6 rad/s in 0.56 s and back to rest in 0.36 s.
    let middle = PerJoint::splat((0.1 + 2.0 / 3.0 * 0.6 * 0.56, 0.6));
    knots.insert(1, Knot { t_us: 560_000, state: middle });
    knots[2].state = PerJoint::splat((middle.0[0].0 + 2.0 / 3.0 * 0.6 * 0.36, 0.0));
    (header, knots)
}

fn file(header: &Header, knots: &[Knot]) -> Vec<u8> {
    let mut out = vec![0; FILE_LEN_MAX];
    let len = encode(header, knots, &mut out).unwrap();
    out.truncate(len);
    out
}

fn read(file: &[u8]) -> Result<(Header, Box<Spline>), Refusal> {
    let mut spline = Box::new(Spline::empty());
    let header = decode(
        file.len(),
        |offset, out| {
            let from = file.get(offset..offset + out.len()).ok_or(Refusal::of(Cause::FileIncomplete))?;
            out.copy_from_slice(from);
            Ok(())
        },
        &mut spline,
    )?;
    Ok((header, spline))
}

#[test]
fn throw_round_trips_and_passes_every_check() {
    let (header, knots) = throw();
    let bytes = file(&header, &knots);
    assert_eq!(bytes.len(), 184);
    let (got, spline) = read(&bytes).unwrap();
    assert_eq!((got, spline.knot(1).map(|knot| knot.t_us)), (header, Some(560_000)));
    assert_eq!(check(&got, &spline, &Settings::powercube6()), Ok(()));
}

#[test]
fn layout_is_the_documented_one() {
    let (header, knots) = throw();
    let bytes = file(&header, &knots);
    assert_eq!(&bytes[..8], b"CTRJ\x01\x06\x03\x00");
    assert_eq!(bytes[8..12], 3_000u32.to_le_bytes());
    assert_eq!(bytes[12..16], 560_000u32.to_le_bytes());
    assert_eq!(bytes[24 + 52..24 + 56], 560_000u32.to_le_bytes());
    assert_eq!(bytes[28..32], 0.1f32.to_le_bytes());
}

fn events(list: &[(u32, Action)]) -> PlanEvents {
    let mut events = PlanEvents::NONE;
    for &(t_us, action) in list {
        assert!(events.push(PlanEvent { t_us, action }));
    }
    events
}

#[test]
fn events_and_envelope_round_trip_in_version_2_and_pass_every_check() {
    let settings = Settings::powercube6();
    let (mut header, knots) = throw();
    header.events = events(&[(100_000, Action::Close), (560_000, Action::Open), (900_000, Action::Close)]);
    header.envelope = Some(Envelope::widest(&settings));
    let bytes = file(&header, &knots);
    assert_eq!(bytes.len(), 184 + 3 * 8 + 6 * 16);
    assert_eq!(&bytes[..8], b"CTRJ\x02\x06\x03\x00");
    assert_eq!(&bytes[12..16], [3, 1, 0, 0]);
    assert_eq!(bytes[24..28], 100_000u32.to_le_bytes());
    let (got, spline) = read(&bytes).unwrap();
    assert_eq!((got, spline.knot(1).map(|knot| knot.t_us)), (header, Some(560_000)));
    assert_eq!(check(&got, &spline, &settings), Ok(()));
    // Each one alone, too.
    header.envelope = None;
    assert_eq!(read(&file(&header, &knots)).unwrap().0, header);
    header.events = PlanEvents::NONE;
    header.envelope = Some(Envelope::widest(&settings));
    assert_eq!(read(&file(&header, &knots)).unwrap().0, header);
}

#[test]
fn unknown_events_too_many_and_unknown_flags_are_refused_with_their_place() {
    let (mut header, knots) = throw();
    header.events = events(&[(100_000, Action::Close), (560_000, Action::Open)]);
    let sealed = |spoil: fn(&mut Vec<u8>)| {
        let mut bytes = file(&header, &knots);
        spoil(&mut bytes);
        let at = bytes.len() - 4;
        let crc = Crc32::of(&bytes[..at]);
        bytes[at..].copy_from_slice(&crc.to_le_bytes());
        read(&bytes).unwrap_err()
    };
    assert_eq!(sealed(|b| b[36] = 2), Refusal::in_file(Cause::FileEvent, None, 1));
    assert_eq!(sealed(|b| b[12] = 9), Refusal::of(Cause::FileEvent));
    assert_eq!(
        sealed(|b| b[13] = 3),
        Refusal::of(Cause::FileEvent),
        "an envelope and a segment that follows"
    );
    assert_eq!(sealed(|b| b[13] = 4), Refusal::of(Cause::FileEvent));
    assert_eq!(sealed(|b| b[13] = 2), Refusal::of(Cause::FileKnots), "a digest that is not there");
    assert_eq!(sealed(|b| b[13] = 1), Refusal::of(Cause::FileKnots), "an envelope that is not there");
    assert_eq!(sealed(|b| b[4] = 3), Refusal::of(Cause::FileVersion));
    assert_eq!(sealed(|b| b[34] = 0xFF), Refusal::in_file(Cause::FileRelease, None, 1));
}

#[test]
fn an_envelope_wider_than_the_limits_less_their_reserve_is_refused() {
    let settings = Settings::powercube6();
    let (mut header, knots) = throw();
    let mut envelope = Envelope::widest(&settings);
    envelope.joint.0[2].a_max_rad_s2 = settings.joint.0[2].a_max_rad_s2;
    header.envelope = Some(envelope);
    let (header, spline) = read(&file(&header, &knots)).unwrap();
    let refused = check(&header, &spline, &settings).unwrap_err();
    assert_eq!(refused, Refusal::at(Cause::FileEnvelope, JointIndex::new(2).unwrap()));
}

type Spoil = fn(&mut Header, &mut Vec<Knot>);

#[test]
fn each_defect_of_a_plan_is_named_with_joint_and_place() {
    let fourth = JointIndex::new(3).ok();
    let table: &[(Cause, Option<JointIndex>, usize, Spoil)] = &[
        (Cause::FileJoints, None, 0, |h, _| h.joints = 5),
        (Cause::FileOtherRobot, None, 0, |h, _| h.robot_crc32 = 8),
        (Cause::FilePeriod, None, 0, |h, _| h.period_us = 17_000),
        (Cause::FileRelease, None, 0, |h, _| h.events = PlanEvents::release(Some(920_001))),
        (Cause::FileNumbers, fourth, 1, |_, k| k[1].state.0[3].0 = f32::NAN),
        (Cause::FileNumbers, fourth, 1, |_, k| k[1].state.0[3].1 = f32::INFINITY),
        (Cause::FileTime, None, 1, |_, k| k[1].t_us = SEGMENT_MIN_US - 1),
        (Cause::FileTime, None, 2, |_, k| k[2].t_us = DURATION_MAX_US + 1),
        (Cause::FileTime, None, 0, |_, k| k[0].t_us = 1),
        (Cause::FileEnds, fourth, 0, |_, k| k[0].state.0[3].1 = 0.01),
        (Cause::FileEnds, fourth, 2, |_, k| k[2].state.0[3].1 = -0.01),
        (Cause::PlanVelocity, fourth, 0, |_, k| k[1].state.0[3].1 = 2.7),
        (Cause::PlanAcceleration, fourth, 0, |_, k| k[1].state.0[3].0 += 0.5),
        (Cause::PlanPosition, fourth, 0, |_, k| k[0].state.0[3].0 = -3.2),
    ];
    let mut settings = Settings::powercube6();
    settings.robot_crc32 = 7;
    for (cause, joint, index, spoil) in table {
        let (mut header, mut knots) = throw();
        spoil(&mut header, &mut knots);
        let refused = match read(&file(&header, &knots)) {
            Err(refused) => refused,
            Ok((header, spline)) => check(&header, &spline, &settings).unwrap_err(),
        };
        assert_eq!((refused.cause, refused.joint, usize::from(refused.index)), (*cause, *joint, *index));
    }
}

#[test]
fn file_shorter_than_its_head_is_incomplete_and_a_head_alone_has_no_knots() {
    let (header, knots) = throw();
    let whole = file(&header, &knots);
    for (len, cause) in [
        (0, Cause::FileIncomplete),
        (HEADER_LEN + TRAILER_LEN - 1, Cause::FileIncomplete),
        (HEADER_LEN + TRAILER_LEN, Cause::FileKnots),
    ] {
        assert_eq!(read(&whole[..len]).unwrap_err().cause, cause, "{len} bytes");
    }
}

#[test]
fn position_between_knots_is_checked_too() {
    // The ends are well inside the limits, the curve between them outside.
    let at_first = |q_rad: f32, qd_rad_s: f32| {
        let mut state = PerJoint::default();
        state.0[0] = (q_rad, qd_rad_s);
        state
    };
    let times = [0, 500_000, 1_500_000, 2_000_000];
    let states = [at_first(3.0, 0.0), at_first(3.1, 1.0), at_first(3.1, -1.0), at_first(3.0, 0.0)];
    let knots: Vec<Knot> = times.into_iter().zip(states).map(|(t_us, state)| Knot { t_us, state }).collect();
    let header = Header { joints: 6, period_us: 3_000, ..Header::default() };
    let (header, spline) = read(&file(&header, &knots)).unwrap();
    let refused = check(&header, &spline, &Settings::powercube6()).unwrap_err();
    assert_eq!((refused.cause, refused.index), (Cause::PlanPosition, 1));
}

proptest! {
    #[test]
    fn any_single_changed_byte_is_noticed(at in 0usize..184, flip in 1u8..=255) {
        let (header, knots) = throw();
        let mut bytes = file(&header, &knots);
        bytes[at] ^= flip;
        prop_assert!(read(&bytes).is_err());
    }

    #[test]
    fn any_bytes_are_refused_or_read_without_harm(mut bytes in proptest::collection::vec(any::<u8>(), 0..400), fix: bool) {
        if fix && bytes.len() > 28 {
            bytes[..8].copy_from_slice(b"CTRJ\x01\x01\x02\x00");
            bytes.truncate(file_len(1, 2).min(bytes.len()));
            let crc = Crc32::of(&bytes[..bytes.len() - 4]);
            let at = bytes.len() - 4;
            bytes[at..].copy_from_slice(&crc.to_le_bytes());
        }
        if let Ok((header, spline)) = read(&bytes) {
            let _ = check(&header, &spline, &Settings::powercube6());
        }
    }
}
