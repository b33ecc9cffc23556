//! Trajectory file that a host uploads. Host and controller both use this code.
//!
//! | offset | bytes | version 1 | version 2 |
//! |---|---|---|---|
//! | 0 | 4 | `CTRJ` | the same |
//! | 4 | 1 | version | the same |
//! | 5 | 1 | joints J, 1..=8 | the same |
//! | 6 | 2 | number of knots N, 2..=256; at most 221 with seven joints, 195 with eight | the same |
//! | 8 | 4 | control period the plan and gains were checked for, µs | the same |
//! | 12 | 4 | time of release since the start, µs; 0xFFFFFFFF: no release | number of events E, 0..=8; flags, bit 0: it has an envelope, bit 1: a segment follows; two bytes 0 |
//! | 16 | 4 | CRC-32 of the robot file | the same |
//! | 20 | 4 | 0 | the same |
//! | 24 | 8 E | - | events: time since the start, µs; action ([`Action::number`]); three bytes 0 |
//! | | 16 J | - | envelope, if there is one: smallest and largest position (rad), speed (rad/s), acceleration (rad/s²) of each joint |
//! | | 32 | - | if flag 1: SHA-256 of the segment that follows ([`crate::segment`]); the last knot may move |
//! | | N (4 + 8 J) | knots: time since the start, µs, then J times position (rad) and velocity (rad/s) | the same |
//! | last | 4 | CRC-32 of all before | the same |
//!
//! Little endian; u32 and binary32. Between knots each joint follows the cubic that the four numbers at
//! its ends determine ([`crate::spline`]). A two-segment throw of six joints is 184 bytes. A plan with no envelope and no event
//! but one opening is written as version 1, which older controllers read too.

use protocol::{JOINTS_MAX, JointIndex};

use crate::crc::Crc32;
use crate::credentials::{DIGEST_LEN, Digest};
use crate::envelope::Envelope;
use crate::events::{Action, EVENTS_MAX, PlanEvent, PlanEvents};
use crate::fault::{Cause, Refusal};
use crate::joints::PerJoint;
use crate::retarget::JointEnvelope;
use crate::settings::Settings;
use crate::spline::{Cubic, DURATION_MAX_US, Knot, SEGMENT_MIN_US, Spline, WORDS_MAX, knots_max};

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
/// Flag: a segment follows.
const HAS_NEXT: u8 = 2;
/// Time that a plan that goes on must have ahead of the path time, in addition to the longest stop along the path,
/// µs: for the lag of the drives and for late periods.
pub const AHEAD_MARGIN_US: u32 = 200_000;
/// Bytes after the last knot.
pub const TRAILER_LEN: usize = 4;
/// Bytes of the longest file.
pub const FILE_LEN_MAX: usize =
    HEADER_LEN + EVENTS_MAX * EVENT_LEN + JOINTS_MAX * JOINT_ENVELOPE_LEN + 4 * WORDS_MAX + TRAILER_LEN;
/// Largest speed at the ends of a plan that counts as rest, rad/s.
pub const REST_RAD_S: f32 = 1e-3;
/// Factor on a limit that allows for rounding to single precision.
const ROUNDING: f32 = 1.001;

const NO_RELEASE: u32 = u32::MAX;

/// Content of the file beside its knots.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Header {
    /// Joints described.
    pub joints: u8,
    /// Control period the plan was checked for, µs.
    pub period_us: u32,
    /// What happens to outputs, within the duration of the plan.
    pub events: PlanEvents,
    /// If present, the controller accepts new end states while the plan runs, within these limits.
    pub envelope: Option<Envelope>,
    /// SHA-256 of the following segment, if there is one. Excludes an envelope.
    pub next: Option<Digest>,
    /// CRC-32 of the robot file; 0: any robot.
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
    has_next: bool,
}

impl Extras {
    const NONE: Self = Self { events: 0, has_envelope: false, has_next: false };

    const fn len(self, joints: usize) -> usize {
        let envelope = if self.has_envelope { joints * JOINT_ENVELOPE_LEN } else { 0 };
        self.events * EVENT_LEN + envelope + if self.has_next { DIGEST_LEN } else { 0 }
    }
}

impl Header {
    /// Time of the release, if version 1 can express all events of the plan.
    fn one_release(&self) -> Option<u32> {
        if self.envelope.is_some() || self.next.is_some() {
            return None;
        }
        match self.events.as_slice() {
            [] => Some(NO_RELEASE),
            [PlanEvent { t_us, action: Action::Open }] if *t_us != NO_RELEASE => Some(*t_us),
            _ => None,
        }
    }
}

/// Writes a file into `out` and returns its length; `None` if it does not fit or counts are out of range. The
/// reader checks the limits ([`check`] is public so that a host can check first).
pub fn encode(header: &Header, knots: &[Knot], out: &mut [u8]) -> Option<usize> {
    let joints = usize::from(header.joints);
    let count = u16::try_from(knots.len()).ok()?;
    if !(1..=JOINTS_MAX).contains(&joints) || !(2..=knots_max(joints)).contains(&knots.len()) {
        return None;
    }
    let (version, extras, word) = match header.one_release() {
        Some(release_us) => (VERSION_OF_ONE_RELEASE, Extras::NONE, release_us.to_le_bytes()),
        None => {
            let (has_envelope, has_next) = (header.envelope.is_some(), header.next.is_some());
            let events = header.events.as_slice().len();
            let flags = u8::from(has_envelope) * HAS_ENVELOPE + u8::from(has_next) * HAS_NEXT;
            (VERSION, Extras { events, has_envelope, has_next }, [events as u8, flags, 0, 0])
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
    if let Some(next) = &header.next {
        put(next);
    }
    for knot in knots {
        put_knot(knot, joints, &mut put);
    }
    let crc = Crc32::of(out.get(..body_len)?);
    for (to, from) in out.iter_mut().skip(body_len).zip(crc.to_le_bytes()) {
        *to = from;
    }
    Some(len)
}

/// Gives the bytes of a knot to `put`, a few at a time.
pub(crate) fn put_knot(knot: &Knot, joints: usize, mut put: impl FnMut(&[u8])) {
    put(&knot.t_us.to_le_bytes());
    for joint in JointIndex::first(joints) {
        let (q_rad, qd_rad_s) = *knot.state.at(joint);
        put(&q_rad.to_le_bytes());
        put(&qd_rad_s.to_le_bytes());
    }
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
        // Not both an envelope and segments: a new end state would leave the path that the segments continue.
        if usize::from(r0) > EVENTS_MAX || r1 > HAS_NEXT {
            return Err(Refusal::of(Cause::FileEvent));
        }
        Extras { events: r0.into(), has_envelope: r1 == HAS_ENVELOPE, has_next: r1 == HAS_NEXT }
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
    if extras.has_next {
        let mut digest = Digest::default();
        next(HEADER_LEN + extras.len(joint_count) - DIGEST_LEN, &mut digest)?;
        header.next = Some(digest);
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
    // Checked last: a wrong version or count says more than a wrong checksum.
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

/// A knot from its [`knot_len`] bytes.
pub(crate) fn knot_of(bytes: &[u8]) -> Knot {
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

/// Checks that the numbers of a knot are finite.
pub(crate) fn check_numbers(knot: &Knot, joints: usize, index: usize) -> Result<(), Refusal> {
    let is_lost = |joint: &JointIndex| {
        let (q_rad, qd_rad_s) = *knot.state.at(*joint);
        !q_rad.is_finite() || !qd_rad_s.is_finite()
    };
    match JointIndex::first(joints).find(is_lost) {
        Some(joint) => Err(Refusal::in_file(Cause::FileNumbers, Some(joint), index)),
        None => Ok(()),
    }
}

/// Checks that the plan may end with this knot.
pub(crate) fn check_rest(knot: &Knot, joints: usize, index: usize) -> Result<(), Refusal> {
    let moves = |joint: &JointIndex| knot.state.at(*joint).1.abs() > REST_RAD_S;
    match JointIndex::first(joints).find(moves) {
        Some(joint) => Err(Refusal::in_file(Cause::FileEnds, Some(joint), index)),
        None => Ok(()),
    }
}

fn push_checked(spline: &mut Spline, knot: &Knot, index: usize) -> Result<(), Refusal> {
    check_numbers(knot, spline.joints(), index)?;
    let follows = match spline.last() {
        None => knot.t_us == 0,
        Some(last) => knot.t_us >= last.t_us.saturating_add(SEGMENT_MIN_US) && knot.t_us <= DURATION_MAX_US,
    };
    if follows && spline.push(knot) { Ok(()) } else { Err(Refusal::in_file(Cause::FileTime, None, index)) }
}

fn check_ends(header: &Header, spline: &Spline) -> Result<(), Refusal> {
    let last = spline.len().saturating_sub(1);
    for index in [0, last] {
        let Some(knot) = spline.knot(index) else { return Err(Refusal::of(Cause::FileKnots)) };
        if index == 0 || header.next.is_none() {
            check_rest(&knot, spline.joints(), index)?;
        }
    }
    let late = header.events.as_slice().iter().position(|event| i64::from(event.t_us) > spline.end_us());
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
    if header.next.is_some() && spline.end_us() < ahead_us(settings) {
        return Err(Refusal::of(Cause::FileTime));
    }
    for segment in 0..spline.len().saturating_sub(1) {
        for joint in settings.joints() {
            let refusal = Refusal::in_file(Cause::FileKnots, Some(joint), segment);
            let cubic = spline.segment(segment, joint).ok_or(refusal)?;
            check_cubic(&cubic, settings, joint, segment)?;
        }
    }
    Ok(())
}

/// How long a plan that goes on must last beyond the path time, µs: so that a stop along the path ends on knots
/// that the controller already has.
pub(crate) fn ahead_us(settings: &Settings) -> i64 {
    i64::from(settings.stop_path_max_us) + i64::from(AHEAD_MARGIN_US)
}

/// Checks that the exact extremes of a joint on a segment are within its limits.
pub(crate) fn check_cubic(
    cubic: &Cubic,
    settings: &Settings,
    joint: JointIndex,
    segment: usize,
) -> Result<(), Refusal> {
    let (worst, limits) = (cubic.extremes(), settings.joint.at(joint));
    let refuse = |cause| Err(Refusal::in_file(cause, Some(joint), segment));
    // The comparisons are false for NaN, so NaN is refused.
    let inside = worst.q_min_rad >= limits.q_min_rad && worst.q_max_rad <= limits.q_max_rad;
    let slow_enough = worst.qd_abs_rad_s <= ROUNDING * limits.v_max_rad_s;
    let gentle_enough = worst.qdd_abs_rad_s2 <= ROUNDING * limits.a_max_rad_s2;
    if !inside {
        refuse(Cause::PlanPosition)
    } else if !slow_enough {
        refuse(Cause::PlanVelocity)
    } else if !gentle_enough {
        refuse(Cause::PlanAcceleration)
    } else {
        Ok(())
    }
}

/// Knots of a plan whose joints rest at `q_rad` for `duration_us`.
pub const fn rest(q_rad: PerJoint<f32>, duration_us: u32) -> [Knot; 2] {
    let PerJoint([a, b, c, d, e, f, g, h]) = q_rad;
    let state = PerJoint([(a, 0.0), (b, 0.0), (c, 0.0), (d, 0.0), (e, 0.0), (f, 0.0), (g, 0.0), (h, 0.0)]);
    [Knot { t_us: 0, state }, Knot { t_us: duration_us, state }]
}

#[cfg(test)]
mod tests;
