//! Segment: continuation of a plan that is longer than a controller holds. Host and controller both use this code.
//!
//! | offset | bytes | |
//! |---|---|---|
//! | 0 | 32 | SHA-256 of the segment that follows; zeros: the plan ends at rest with this one |
//! | 32 | n (4 + 8 J) | knots as in a trajectory file ([`crate::trajectory_format`]), n from 1; times modulo 2^32 µs |
//!
//! A segment is the parameter of one command, at most [`LEN_MAX`] bytes. The file that begins the plan contains the
//! digest of the first segment, and each segment contains the digest of the next. So the digest of the file, which
//! a host commits and arms with its key, covers the whole plan. A segment from another source, of another plan or
//! out of order is refused, without a code of its own.

use protocol::JointIndex;

use crate::credentials::{DIGEST_LEN, Digest};
use crate::fault::{Cause, Refusal};
use crate::settings::Settings;
use crate::spline::{Cubic, DURATION_MAX_US, Knot, SEGMENT_MIN_US, Spline};
use crate::trajectory_format::{check_cubic, check_numbers, check_rest, knot_len, knot_of, put_knot};

/// Bytes of the longest segment: the parameter of a command.
pub const LEN_MAX: usize = 255;
/// No segment follows.
const LAST: Digest = [0; DIGEST_LEN];

/// Most knots of a segment for a number of joints: four for six joints.
pub const fn knots_max(joints: usize) -> usize {
    (LEN_MAX - DIGEST_LEN) / knot_len(joints)
}

/// Writes a segment into `out` and returns its length; `None` if it has no knots or too many. `next` is the digest
/// of the following segment.
pub fn encode(
    next: Option<&Digest>,
    knots: &[Knot],
    joints: usize,
    out: &mut [u8; LEN_MAX],
) -> Option<usize> {
    if !(1..=knots_max(joints)).contains(&knots.len()) {
        return None;
    }
    let mut len = 0;
    let mut put = |bytes: &[u8]| {
        for (to, from) in out.iter_mut().skip(len).zip(bytes) {
            *to = *from;
        }
        len += bytes.len();
    };
    put(next.unwrap_or(&LAST));
    for knot in knots {
        put_knot(knot, joints, &mut put);
    }
    Some(len)
}

/// Appends the knots of a segment to the plan that runs, all of them or nothing; returns the digest of the following segment.
///
/// # Errors
///
/// The first check that fails, with joint and knot: length, room ([`Cause::SegmentEarly`]), numbers, times, limits, and rest at the end
/// of the plan.
pub(crate) fn append(
    bytes: &[u8],
    settings: &Settings,
    spline: &mut Spline,
) -> Result<Option<Digest>, Refusal> {
    let joints = spline.joints();
    let malformed = Refusal::of(Cause::FileKnots);
    let (next, knots) = bytes.split_first_chunk::<DIGEST_LEN>().ok_or(malformed)?;
    let count = knots.len() / knot_len(joints);
    if !(1..=knots_max(joints)).contains(&count) || knots.len() != count * knot_len(joints) {
        return Err(malformed);
    }
    if spline.room() < count {
        return Err(Refusal::of(Cause::SegmentEarly));
    }
    let next = (*next != LAST).then_some(*next);
    let mut before = spline.last().ok_or(malformed)?;
    for (index, row) in knots.chunks_exact(knot_len(joints)).enumerate() {
        let wire = knot_of(row);
        let knot = Knot { t_us: spline.since_base_us(wire.t_us), ..wire };
        check_numbers(&knot, joints, index)?;
        let h_us = knot.t_us.saturating_sub(before.t_us);
        if !(SEGMENT_MIN_US..=DURATION_MAX_US).contains(&h_us) {
            return Err(Refusal::in_file(Cause::FileTime, None, index));
        }
        for joint in JointIndex::first(joints) {
            let ((q0_rad, qd0_rad_s), (q1_rad, qd1_rad_s)) = (*before.state.at(joint), *knot.state.at(joint));
            let cubic = Cubic { h_s: h_us as f32 * 1e-6, q0_rad, qd0_rad_s, q1_rad, qd1_rad_s };
            check_cubic(&cubic, settings, joint, index)?;
        }
        before = knot;
    }
    if next.is_none() {
        check_rest(&before, joints, count - 1)?;
    }
    for row in knots.chunks_exact(knot_len(joints)) {
        // There is room, and time grows: both were checked.
        if !spline.extend(&knot_of(row)) {
            return Err(malformed);
        }
    }
    Ok(next)
}
