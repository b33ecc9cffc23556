//! Trajectory file: what a host uploads. Both sides use this code.
//!
//! | offset | bytes | version 1 | version 2 |
//! |---|---|---|---|
//! | 0 | 4 | `CTRJ` | the same |
//! | 4 | 1 | version | the same |
//! | 5 | 1 | joints J, 1..=8 | the same |
//! | 6 | 2 | number of knots N, 2..=256; at most 221 with seven joints, 195 with eight | the same |
//! | 8 | 4 | control period the plan and gains were checked for, µs | the same |
//! | 12 | 4 | time of release since the start, µs; 0xFFFFFFFF: no release | number of events E, 0..=8; flags, bit 0: it has an envelope; two bytes 0 |
//! | 16 | 4 | CRC-32 of the robot file | the same |
//! | 20 | 4 | 0 | the same |
//! | 24 | 8 E | - | events: time since the start, µs; action ([`Action::number`]); three bytes 0 |
//! | | 16 J | - | envelope, if there is one: smallest and largest position (rad), speed (rad/s), acceleration (rad/s²) of each joint |
//! | | N (4 + 8 J) | knots: time since the start, µs, then J times position (rad) and velocity (rad/s) | the same |
//! | last | 4 | CRC-32 of all before | the same |
//!
//! Little endian; u32 and binary32. Between knots each joint follows the cubic that the four numbers at
//! its ends determine ([`crate::spline`]). A two-segment throw of six joints is 184 bytes. A plan with no envelope and no event
//! but one opening is written as version 1, which older controllers read too.

use protocol::{JOINTS_MAX, JointIndex};

use crate::crc::Crc32;
use crate::envelope::Envelope;
use crate::events::{Action, EVENTS_MAX, PlanEvent, PlanEvents};
use crate::fault::{Cause, Refusal};
use crate::joints::PerJoint;
use crate::retarget::JointEnvelope;
use crate::settings::Settings;
use crate::spline::{DURATION_MAX_US, Knot, SEGMENT_MIN_US, Spline, WORDS_MAX, knots_max};

/// Name of a trajectory file: what a commit and a run refer to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileName {
    /// CRC-64/WE of the whole file.
    pub crc64: u64,
    /// Bytes.
    pub len: u32,
}

/// First four bytes.
pub const MAGIC: [u8; 4] = *b"CTRJ";
/// Newest version of the layout.
pub const VERSION: u8 = 2;
/// Version without a list of events and without an envelope.
const VERSION_OF_ONE_RELEASE: u8 = 1;
/// Bytes before the events.
pub const HEADER_LEN: usize = 24;
/// Bytes of an event.
const EVENT_LEN: usize = 8;
/// Bytes of the envelope of a joint.
const JOINT_ENVELOPE_LEN: usize = 16;
/// Flag: the file has an envelope.
const HAS_ENVELOPE: u8 = 1;
/// Bytes after the last knot.
pub const TRAILER_LEN: usize = 4;
/// Bytes of the longest file.
pub const FILE_LEN_MAX: usize =
    HEADER_LEN + EVENTS_MAX * EVENT_LEN + JOINTS_MAX * JOINT_ENVELOPE_LEN + 4 * WORDS_MAX + TRAILER_LEN;
/// Largest speed at the ends of a plan that counts as rest, rad/s.
pub const REST_RAD_S: f32 = 1e-3;
/// Share above a limit that is put down to the rounding to single precision.
const ROUNDING: f32 = 1.001;

const NO_RELEASE: u32 = u32::MAX;

/// What the file says beside its knots.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Header {
    /// Joints described.
    pub joints: u8,
    /// Control period the plan was checked for, µs.
    pub period_us: u32,
    /// What happens to outputs, within the duration of the plan.
    pub events: PlanEvents,
    /// If there is one, new end states are taken over while the plan runs, and this is what they must stay in.
    pub envelope: Option<Envelope>,
    /// CRC-32 of the robot file; 0: for any.
    pub robot_crc32: u32,
}

/// Bytes of one knot.
pub const fn knot_len(joints: usize) -> usize {
    4 + 8 * joints
}

/// Bytes of a file of version 1.
pub const fn file_len(joints: usize, knots: usize) -> usize {
    HEADER_LEN + knots * knot_len(joints) + TRAILER_LEN
}

/// Layout of what lies between header and knots.
#[derive(Clone, Copy)]
struct Extras {
    events: usize,
    has_envelope: bool,
}

impl Extras {
    const NONE: Self = Self { events: 0, has_envelope: false };

    const fn len(self, joints: usize) -> usize {
        let envelope = if self.has_envelope { joints * JOINT_ENVELOPE_LEN } else { 0 };
        self.events * EVENT_LEN + envelope
    }
}

impl Header {
    /// The release, if a file of version 1 can say all that happens.
    fn one_release(&self) -> Option<u32> {
        match (self.envelope, self.events.as_slice()) {
            (None, []) => Some(NO_RELEASE),
            (None, [PlanEvent { t_us, action: Action::Open }]) if *t_us != NO_RELEASE => Some(*t_us),
            _ => None,
        }
    }
}

/// Writes a file into `out` and returns its length; `None` if it does not fit or counts are out of
/// range. Limits are the reader's business ([`check`] is public for a host to ask first).
pub fn encode(header: &Header, knots: &[Knot], out: &mut [u8]) -> Option<usize> {
    let joints = usize::from(header.joints);
    let count = u16::try_from(knots.len()).ok()?;
    if !(1..=JOINTS_MAX).contains(&joints) || !(2..=knots_max(joints)).contains(&knots.len()) {
        return None;
    }
    let (version, extras, word) = match header.one_release() {
        Some(release_us) => (VERSION_OF_ONE_RELEASE, Extras::NONE, release_us.to_le_bytes()),
        None => {
            let has_envelope = header.envelope.is_some();
            let events = header.events.as_slice().len();
            (VERSION, Extras { events, has_envelope }, [events as u8, u8::from(has_envelope), 0, 0])
        }
    };
    let len = file_len(joints, knots.len()) + extras.len(joints);
    let body_len = len - TRAILER_LEN;
    let out = out.get_mut(..len)?;
    let mut at = 0;
    let mut put = |bytes: &[u8]| {
        for (to, from) in out.iter_mut().skip(at).zip(bytes) {
            *to = *from;
        }
        at += bytes.len();
    };
    put(&MAGIC);
    put(&[version, header.joints]);
    put(&count.to_le_bytes());
    put(&header.period_us.to_le_bytes());
    put(&word);
    put(&header.robot_crc32.to_le_bytes());
    put(&[0; 4]);
    for event in header.events.as_slice().iter().take(extras.events) {
        put(&event.t_us.to_le_bytes());
        put(&[event.action.number(), 0, 0, 0]);
    }
    if let Some(envelope) = header.envelope {
        for joint in JointIndex::first(joints) {
            let JointEnvelope { q_min_rad, q_max_rad, v_max_rad_s, a_max_rad_s2 } = *envelope.joint.at(joint);
            for number in [q_min_rad, q_max_rad, v_max_rad_s, a_max_rad_s2] {
                put(&number.to_le_bytes());
            }
        }
    }
    for knot in knots {
        put(&knot.t_us.to_le_bytes());
        for joint in JointIndex::first(joints) {
            let (q_rad, qd_rad_s) = *knot.state.at(joint);
            put(&q_rad.to_le_bytes());
            put(&qd_rad_s.to_le_bytes());
        }
    }
    let crc = Crc32::of(out.get(..body_len)?);
    for (to, from) in out.iter_mut().skip(body_len).zip(crc.to_le_bytes()) {
        *to = from;
    }
    Some(len)
}

/// Reads a file of `len` bytes into `spline`, a piece at a time through `read(offset, bytes)`, and
/// checks everything that can be checked without the settings.
///
/// # Errors
///
/// The first check that fails; `spline` then holds part of the file and must not be used.
pub fn decode(
    len: usize,
    mut read: impl FnMut(usize, &mut [u8]) -> Result<(), Refusal>,
    spline: &mut Spline,
) -> Result<Header, Refusal> {
    let mut crc = Crc32::new();
    let mut head = [0; HEADER_LEN];
    spline.clear(0);
    if len < HEADER_LEN + TRAILER_LEN {
        return Err(Refusal::of(Cause::FileIncomplete));
    }
    read(0, &mut head)?;
    crc.update(&head);
    let [m0, m1, m2, m3, version, joints, n0, n1, p0, p1, p2, p3, r0, r1, r2, r3, c0, c1, c2, c3, _, _, _, _] =
        head;
    if [m0, m1, m2, m3] != MAGIC || !(VERSION_OF_ONE_RELEASE..=VERSION).contains(&version) {
        return Err(Refusal::of(Cause::FileVersion));
    }
    let mut header = Header {
        joints,
        period_us: u32::from_le_bytes([p0, p1, p2, p3]),
        robot_crc32: u32::from_le_bytes([c0, c1, c2, c3]),
        ..Header::default()
    };
    let extras = if version == VERSION_OF_ONE_RELEASE {
        let release_us = u32::from_le_bytes([r0, r1, r2, r3]);
        header.events = PlanEvents::release((release_us != NO_RELEASE).then_some(release_us));
        Extras::NONE
    } else {
        if usize::from(r0) > EVENTS_MAX || r1 & !HAS_ENVELOPE != 0 {
            return Err(Refusal::of(Cause::FileEvent));
        }
        Extras { events: r0.into(), has_envelope: r1 & HAS_ENVELOPE != 0 }
    };
    let joint_count = usize::from(joints);
    if !(1..=JOINTS_MAX).contains(&joint_count) {
        return Err(Refusal::of(Cause::FileJoints));
    }
    let knots = usize::from(u16::from_le_bytes([n0, n1]));
    if !(2..=knots_max(joint_count)).contains(&knots)
        || len != file_len(joint_count, knots) + extras.len(joint_count)
    {
        return Err(Refusal::of(Cause::FileKnots));
    }
    let mut next = |offset: usize, bytes: &mut [u8]| -> Result<(), Refusal> {
        read(offset, bytes)?;
        crc.update(bytes);
        Ok(())
    };
    for index in 0..extras.events {
        let mut bytes = [0; EVENT_LEN];
        next(HEADER_LEN + index * EVENT_LEN, &mut bytes)?;
        let [t0, t1, t2, t3, action, ..] = bytes;
        let event = Action::from_number(action)
            .map(|action| PlanEvent { t_us: u32::from_le_bytes([t0, t1, t2, t3]), action });
        if !event.is_some_and(|event| header.events.push(event)) {
            return Err(Refusal::in_file(Cause::FileEvent, None, index));
        }
    }
    if extras.has_envelope {
        let mut envelope = Envelope::default();
        for joint in JointIndex::first(joint_count) {
            let mut bytes = [0; JOINT_ENVELOPE_LEN];
            let offset = HEADER_LEN + extras.events * EVENT_LEN + joint.get() * JOINT_ENVELOPE_LEN;
            next(offset, &mut bytes)?;
            envelope.joint.set(joint, joint_envelope_of(&bytes));
        }
        header.envelope = Some(envelope);
    }
    let first_knot = HEADER_LEN + extras.len(joint_count);
    spline.clear(joint_count);
    let mut bytes = [0; knot_len(JOINTS_MAX)];
    for index in 0..knots {
        let Some(bytes) = bytes.get_mut(..knot_len(joint_count)) else {
            return Err(Refusal::of(Cause::FileJoints));
        };
        next(first_knot + index * knot_len(joint_count), bytes)?;
        let knot = knot_of(bytes);
        push_checked(spline, &knot, index)?;
    }
    let mut trailer = [0; TRAILER_LEN];
    read(len - TRAILER_LEN, &mut trailer)?;
    // Judged last of all: a wrong version or count says more than a wrong checksum.
    if u32::from_le_bytes(trailer) != crc.get() {
        return Err(Refusal::of(Cause::FileChecksum));
    }
    check_ends(&header, spline)?;
    Ok(header)
}

fn joint_envelope_of(bytes: &[u8; JOINT_ENVELOPE_LEN]) -> JointEnvelope {
    let (words, _) = bytes.as_chunks::<4>();
    let mut numbers = words.iter().map(|word| f32::from_le_bytes(*word));
    let mut number = || numbers.next().unwrap_or(f32::NAN);
    JointEnvelope { q_min_rad: number(), q_max_rad: number(), v_max_rad_s: number(), a_max_rad_s2: number() }
}

fn knot_of(bytes: &[u8]) -> Knot {
    let mut knot = Knot::default();
    let (words, _) = bytes.as_chunks::<4>();
    let mut words = words.iter();
    knot.t_us = words.next().map_or(0, |word| u32::from_le_bytes(*word));
    let mut number = || words.next().map_or(0.0, |word| f32::from_le_bytes(*word));
    for joint in JointIndex::first(bytes.len() / 8) {
        let q_rad = number();
        knot.state.set(joint, (q_rad, number()));
    }
    knot
}

fn push_checked(spline: &mut Spline, knot: &Knot, index: usize) -> Result<(), Refusal> {
    for joint in JointIndex::first(spline.joints()) {
        let (q_rad, qd_rad_s) = *knot.state.at(joint);
        if !q_rad.is_finite() || !qd_rad_s.is_finite() {
            return Err(Refusal::in_file(Cause::FileNumbers, Some(joint), index));
        }
    }
    let follows = if spline.is_empty() {
        knot.t_us == 0
    } else {
        knot.t_us >= spline.duration_us().saturating_add(SEGMENT_MIN_US) && knot.t_us <= DURATION_MAX_US
    };
    if follows && spline.push(knot) { Ok(()) } else { Err(Refusal::in_file(Cause::FileTime, None, index)) }
}

fn check_ends(header: &Header, spline: &Spline) -> Result<(), Refusal> {
    for index in [0, spline.len().saturating_sub(1)] {
        let Some(knot) = spline.knot(index) else { return Err(Refusal::of(Cause::FileKnots)) };
        for joint in JointIndex::first(spline.joints()) {
            if knot.state.at(joint).1.abs() > REST_RAD_S {
                return Err(Refusal::in_file(Cause::FileEnds, Some(joint), index));
            }
        }
    }
    let late = header.events.as_slice().iter().position(|event| event.t_us > spline.duration_us());
    late.map_or(Ok(()), |index| Err(Refusal::in_file(Cause::FileRelease, None, index)))
}

/// Checks a plan against the settings: joints, robot, period, envelope, and the exact extremes of position,
/// velocity and acceleration on every segment.
///
/// # Errors
///
/// The first check that fails, with joint and segment.
pub fn check(header: &Header, spline: &Spline, settings: &Settings) -> Result<(), Refusal> {
    if u32::from(header.joints) != settings.joints {
        return Err(Refusal::of(Cause::FileJoints));
    }
    let any = header.robot_crc32 == 0 || settings.robot_crc32 == 0;
    if !any && header.robot_crc32 != settings.robot_crc32 {
        return Err(Refusal::of(Cause::FileOtherRobot));
    }
    if header.period_us != settings.cycle_period_us {
        return Err(Refusal::of(Cause::FilePeriod));
    }
    if let Some(envelope) = &header.envelope {
        envelope.check(settings)?;
    }
    for segment in 0..spline.len().saturating_sub(1) {
        for joint in settings.joints() {
            let limits = settings.joint.at(joint);
            let refuse = |cause| Err(Refusal::in_file(cause, Some(joint), segment));
            let Some(cubic) = spline.segment(segment, joint) else { return refuse(Cause::FileKnots) };
            let worst = cubic.extremes();
            // The comparison is false for NaN, so NaN is refused.
            let inside = worst.q_min_rad >= limits.q_min_rad && worst.q_max_rad <= limits.q_max_rad;
            let slow_enough = worst.qd_abs_rad_s <= ROUNDING * limits.v_max_rad_s;
            let gentle_enough = worst.qdd_abs_rad_s2 <= ROUNDING * limits.a_max_rad_s2;
            if !inside {
                return refuse(Cause::PlanPosition);
            } else if !slow_enough {
                return refuse(Cause::PlanVelocity);
            } else if !gentle_enough {
                return refuse(Cause::PlanAcceleration);
            }
        }
    }
    Ok(())
}

/// Knots of a plan whose joints rest at `q_rad` for `duration_us`: for tests and for holding.
pub const fn rest(q_rad: PerJoint<f32>, duration_us: u32) -> [Knot; 2] {
    let PerJoint([a, b, c, d, e, f, g, h]) = q_rad;
    let state = PerJoint([(a, 0.0), (b, 0.0), (c, 0.0), (d, 0.0), (e, 0.0), (f, 0.0), (g, 0.0), (h, 0.0)]);
    [Knot { t_us: 0, state }, Knot { t_us: duration_us, state }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn throw() -> (Header, Vec<Knot>) {
        let header = Header {
            joints: 6,
            period_us: 3_000,
            events: PlanEvents::release(Some(560_000)),
            robot_crc32: 7,
            envelope: None,
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
        header.events =
            events(&[(100_000, Action::Close), (560_000, Action::Open), (900_000, Action::Close)]);
        header.envelope = Some(Envelope::widest(&settings));
        let bytes = file(&header, &knots);
        assert_eq!(bytes.len(), 184 + 3 * 8 + 6 * 16);
        assert_eq!(&bytes[..8], b"CTRJ\x02\x06\x03\x00");
        assert_eq!(&bytes[12..16], [3, 1, 0, 0]);
        assert_eq!(bytes[24..28], 100_000u32.to_le_bytes());
        let (got, spline) = read(&bytes).unwrap();
        assert_eq!((got, spline.knot(1).map(|knot| knot.t_us)), (header, Some(560_000)));
        assert_eq!(check(&got, &spline, &settings), Ok(()));
        // Each alone, too.
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
        assert_eq!(sealed(|b| b[13] = 2), Refusal::of(Cause::FileEvent));
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
        // Ends well inside, the bow in between outside.
        let at_first = |q_rad: f32, qd_rad_s: f32| {
            let mut state = PerJoint::default();
            state.0[0] = (q_rad, qd_rad_s);
            state
        };
        let times = [0, 500_000, 1_500_000, 2_000_000];
        let states = [at_first(3.0, 0.0), at_first(3.1, 1.0), at_first(3.1, -1.0), at_first(3.0, 0.0)];
        let knots: Vec<Knot> =
            times.into_iter().zip(states).map(|(t_us, state)| Knot { t_us, state }).collect();
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
}
