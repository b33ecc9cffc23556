//! From planned motions to the trajectory file of a controller: the only step from f64 to f32.

use firmware::authority::sha256;
use firmware::controller::KEPT_US;
use firmware::envelope::Envelope;
use firmware::events::{Action, EVENTS_MAX, PlanEvent, PlanEvents};
use firmware::joints::PerJoint;
use firmware::segment;
use firmware::settings::Settings;
use firmware::spline::{DURATION_MAX_US, Knot, Spline, knots_max};
use firmware::trajectory_format::{self, FILE_LEN_MAX, Header};
use protocol::JointIndex;

pub use crate::bus::settings::robot_crc32;
use planner::motion::{GripperEvent, Motion};
use planner::plan::Joints;

/// How long a controller keeps knots that are past, s.
const KEPT_S: f64 = KEPT_US as f64 * 1e-6;

/// Why a motion makes no trajectory file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// Too long, or too many knots.
    #[error("a motion of {knots} knots and {duration_s:.1} s is too long for a controller")]
    TooLong { knots: usize, duration_s: f64 },
    /// More events than a controller has places for.
    #[error("a motion with {events} events is too much for a controller, which takes {EVENTS_MAX}")]
    TooManyEvents { events: usize },
    /// A path of many points: the link is too slow for its segments.
    #[error(
        "the path has more points up to {t_s:.1} s than the bus carries beside the drives' frames: {carried_per_s:.0} a second"
    )]
    TooDense { t_s: f64, carried_per_s: f64 },
    /// A check of the controller fails; reported before anything is sent.
    #[error("{}", refused(*.cause, *.joint, *.place))]
    Refused {
        cause: firmware::fault::Cause,
        /// Which joint, from 1.
        joint: Option<usize>,
        /// Segment or knot.
        place: u16,
    },
}

impl TrajectoryError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::TooManyEvents { .. } => "fewer events".to_owned(),
            Self::TooDense { .. } => "more time between the points, or a slower path".to_owned(),
            Self::Refused { cause, .. } => return cause.info().map(|info| info.recovery.to_owned()),
            _ => return None,
        })
    }
}

fn refused(cause: firmware::fault::Cause, joint: Option<usize>, place: u16) -> String {
    let joint = joint.map_or(String::new(), |joint| format!("joint {joint}: "));
    match cause.info() {
        Some(info) => {
            format!("{joint}{} (segment {place}, fault {})", info.what, info.code)
        }
        None => format!("{joint}cause {}", cause.code()),
    }
}

/// A trajectory file that stands at `q_rad` (one angle per joint, rad) for `length_us` and takes new end states within the
/// limits of `settings`; `None` if it does not fit a file.
#[must_use]
pub fn standing(settings: &Settings, q_rad: &[f64], length_us: u32) -> Option<Vec<u8>> {
    standing_within(settings, Envelope::widest(settings), q_rad, length_us)
}

/// The same within a narrower envelope.
#[must_use]
pub fn standing_within(
    settings: &Settings,
    envelope: Envelope,
    q_rad: &[f64],
    length_us: u32,
) -> Option<Vec<u8>> {
    let mut pose = PerJoint::<f32>::default();
    for (joint, q) in settings.joints().zip(q_rad) {
        pose.set(joint, *q as f32);
    }
    let header = Header {
        joints: u8::try_from(q_rad.len()).ok()?,
        period_us: settings.cycle_period_us,
        robot_crc32: settings.robot_crc32,
        envelope: Some(envelope),
        ..Header::default()
    };
    let mut bytes = vec![0; FILE_LEN_MAX];
    let len = trajectory_format::encode(&header, &trajectory_format::rest(pose, length_us), &mut bytes)?;
    bytes.truncate(len);
    Some(bytes)
}

/// A motion as a controller takes it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Encoded {
    pub file: Vec<u8>,
    /// The segments with which it continues while it runs; empty for a motion that fits a file.
    pub segments: Vec<Segment>,
}

/// A part of a motion that a controller takes while it runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    pub bytes: Vec<u8>,
    /// Time of the plan from which on the controller has room for it, µs modulo 2^32.
    pub room_us: u32,
}

impl From<Vec<u8>> for Encoded {
    fn from(file: Vec<u8>) -> Self {
        Self { file, segments: Vec::new() }
    }
}

/// The controller's file, for a control period and the robot whose checksum is `robot_crc32`.
///
/// Times are rounded to microseconds, angles and speeds to single precision: 0.3 µrad at 4 rad.
///
/// # Errors
/// [`TrajectoryError::TooLong`]; with `settings` also everything that a controller with them would refuse.
pub fn encode(
    motion: &Motion,
    period_us: u32,
    robot_crc32: u32,
    settings: Option<&Settings>,
) -> Result<Vec<u8>, TrajectoryError> {
    let encoded = encode_any(motion, period_us, robot_crc32, settings)?;
    if encoded.segments.is_empty() { Ok(encoded.file) } else { Err(too_long(motion)) }
}

fn too_long(motion: &Motion) -> TrajectoryError {
    TrajectoryError::TooLong { knots: motion.knots.len(), duration_s: motion.duration_s() }
}

/// Checks that the segments of a motion come in time over a link that takes `segment_s` for each, if the controller
/// needs `ahead_s` of the path ahead.
///
/// # Errors
/// [`TrajectoryError::TooDense`] with the time at which the controller would stop.
pub fn require_supply(motion: &Motion, segment_s: f64, ahead_s: f64) -> Result<(), TrajectoryError> {
    let (joints, knots) = (motion.start_rad().len(), &motion.knots);
    let (most, piece) = (knots_max(joints), segment::knots_max(joints));
    let held = knots.iter().take(most).take_while(|knot| 1e6 * knot.t_s <= DURATION_MAX_US.into()).count();
    let mut free_s = 0.0_f64;
    for first in (held..knots.len()).step_by(piece) {
        let last = (first + piece).min(knots.len()) - 1;
        let room_s = (last + 1).checked_sub(most).map_or(0.0, |behind| knots[behind].t_s + KEPT_S);
        free_s = free_s.max(room_s) + segment_s;
        let t_s = knots[first - 1].t_s;
        if free_s + ahead_s > t_s {
            return Err(TrajectoryError::TooDense { t_s, carried_per_s: piece as f64 / segment_s });
        }
    }
    Ok(())
}

/// As [`encode`], of any length: knots that do not fit the file are in segments.
///
/// # Errors
/// As [`encode`]; [`TrajectoryError::TooLong`] for a time that is not a number, or for events after the knots of the file.
pub fn encode_any(
    motion: &Motion,
    period_us: u32,
    robot_crc32: u32,
    settings: Option<&Settings>,
) -> Result<Encoded, TrajectoryError> {
    let too_long = || too_long(motion);
    let us = |t_s: f64| {
        let us = (t_s * 1e6).round();
        (0.0..1e15).contains(&us).then_some(us as u64)
    };
    let joints = motion.start_rad().len();
    let (mut knots, mut held) = (Vec::with_capacity(motion.knots.len()), 0);
    for knot in &motion.knots {
        let mut state = PerJoint::default();
        for joint in JointIndex::first(joints) {
            state.set(joint, (knot.q_rad[joint.get()] as f32, knot.qd_rad_s[joint.get()] as f32));
        }
        let t_us = us(knot.t_s).ok_or_else(too_long)?;
        if knots.len() < knots_max(joints) && t_us <= DURATION_MAX_US.into() {
            held += 1;
        }
        // Those of the segments are modulo 2^32.
        knots.push(Knot { t_us: t_us as u32, state });
    }
    let (in_file, in_segments) = knots.split_at(held);
    // From the last to the first: each has the digest of the one that follows.
    let (mut segments, mut next) = (Vec::new(), None);
    let mut after = knots.len();
    for piece in in_segments.chunks(segment::knots_max(joints)).rev() {
        let room_us = after.checked_sub(knots_max(joints)).map_or(0, |left| knots[left].t_us);
        after -= piece.len();
        let mut bytes = [0; segment::LEN_MAX];
        let len = segment::encode(next.as_ref(), piece, joints, &mut bytes).ok_or_else(too_long)?;
        let bytes = bytes.get(..len).unwrap_or_default();
        next = Some(sha256(bytes));
        segments.push(Segment { bytes: bytes.to_vec(), room_us: room_us.wrapping_add(KEPT_US as u32) });
    }
    segments.reverse();
    let mut events = PlanEvents::NONE;
    for (t_s, event) in &motion.events {
        let action = match event {
            GripperEvent::Open => Action::Open,
            GripperEvent::Close => Action::Close,
        };
        let t_us = us(*t_s).and_then(|us| u32::try_from(us).ok()).ok_or_else(too_long)?;
        if !events.push(PlanEvent { t_us, action }) {
            return Err(TrajectoryError::TooManyEvents { events: motion.events.len() });
        }
    }
    let header = Header { joints: joints as u8, period_us, events, robot_crc32, envelope: None, next };
    let mut file = vec![0; FILE_LEN_MAX];
    let len = trajectory_format::encode(&header, in_file, &mut file).ok_or_else(too_long)?;
    file.truncate(len);
    check(&file, settings)?;
    Ok(Encoded { file, segments })
}

/// The motion of a controller's file; `None` if no controller would accept it. Events are not needed to follow it.
#[must_use]
pub fn motion_of(bytes: &[u8]) -> Option<Motion> {
    let (header, spline) = decoded(bytes).ok()?;
    let n = usize::from(header.joints);
    let joint = |knot: &Knot, k: usize| JointIndex::new(k).map_or((0.0, 0.0), |joint| knot.state.get(joint));
    let knots = (0..spline.len()).map_while(|index| spline.knot(index)).map(|knot| planner::motion::Knot {
        t_s: f64::from(knot.t_us) * 1e-6,
        q_rad: Joints::from_fn(n, |k| joint(&knot, k).0.into()),
        qd_rad_s: Joints::from_fn(n, |k| joint(&knot, k).1.into()),
    });
    Some(Motion { knots: knots.collect(), events: Vec::new() })
}

fn decoded(bytes: &[u8]) -> Result<(Header, Box<Spline>), firmware::fault::Refusal> {
    use firmware::fault::{Cause, Refusal};
    let mut spline = Box::new(Spline::empty());
    let read = |offset: usize, out: &mut [u8]| {
        let from = bytes.get(offset..offset + out.len()).ok_or(Refusal::of(Cause::FileIncomplete))?;
        out.copy_from_slice(from);
        Ok(())
    };
    let header = trajectory_format::decode(bytes.len(), read, &mut spline)?;
    Ok((header, spline))
}

/// Reasons for a controller to refuse a file, by its own code; without `settings` only those of every controller.
fn check(bytes: &[u8], settings: Option<&Settings>) -> Result<(), TrajectoryError> {
    decoded(bytes)
        .and_then(|(header, spline)| match settings {
            Some(settings) => trajectory_format::check(&header, &spline, settings),
            None => Ok(()),
        })
        .map_err(|refusal| TrajectoryError::Refused {
            cause: refusal.cause,
            joint: refusal.joint.map(|joint| joint.get() + 1),
            place: refusal.index,
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use planner::motion::Knot as MotionKnot;

    fn motion() -> Motion {
        let knot = |t_s, q: f64, qd: f64| MotionKnot {
            t_s,
            q_rad: Joints::repeat(6, q),
            qd_rad_s: Joints::repeat(6, qd),
        };
        // Up to 0.6 rad/s in 0.56 s, back to rest in 0.36 s, constant jerk in each.
        let middle = 2.0 / 3.0 * 0.6 * 0.56;
        let stop = middle + 2.0 / 3.0 * 0.6 * 0.36;
        Motion {
            knots: vec![knot(0.0, 0.0, 0.0), knot(0.56, middle, 0.6), knot(0.92, stop, 0.0)],
            events: vec![(0.56, GripperEvent::Open)],
        }
    }

    #[test]
    fn what_a_controller_would_refuse_is_refused_before_anything_is_sent() {
        let settings = Settings::powercube6();
        assert_eq!(encode(&motion(), 3_000, 7, Some(&settings)).unwrap().len(), 184);
        let other = encode(&motion(), 17_000, 7, Some(&settings)).unwrap_err();
        assert!(other.to_string().contains("another control period") && other.next().is_some(), "{other}");
        let mut fast = motion();
        fast.knots[1].qd_rad_s[3] = 2.7;
        let text = encode(&fast, 3_000, 7, Some(&settings)).unwrap_err().to_string();
        assert!(text.starts_with("joint 4: the plan is faster"), "{text}");
        let mut long = motion();
        long.knots[2].t_s = 1e5;
        assert!(matches!(encode(&long, 3_000, 7, None), Err(TrajectoryError::TooLong { .. })));
    }

    #[test]
    fn path_with_more_points_than_the_link_carries_is_refused_before_it_runs() {
        let path = |per_s: f64, length_s: f64| {
            let at = |k: u32| MotionKnot { t_s: f64::from(k) / per_s, ..motion().knots[0] };
            Motion { knots: (0..=(per_s * length_s) as u32).map(at).collect(), events: Vec::new() }
        };
        // Four points in each tenth of a second.
        let supply = |per_s, length_s| require_supply(&path(per_s, length_s), 0.1, 1.2);
        for (per_s, length_s, comes) in [
            (38.0, 3_000.0, true),
            (60.0, 4.0, true),
            (60.0, 9.0, true),
            (44.0, 600.0, false),
            (100.0, 60.0, false),
            (200.0, 1.2, true),
        ] {
            assert_eq!(supply(per_s, length_s).is_ok(), comes, "{per_s} a second for {length_s} s");
        }
        let error = supply(100.0, 60.0).unwrap_err();
        assert!(
            matches!(error, TrajectoryError::TooDense { t_s, .. } if (2.5..5.0).contains(&t_s)),
            "{error}"
        );
        assert_eq!(require_supply(&path(100.0, 60.0), 0.0, 1.2), Ok(()), "in this program");
    }

    #[test]
    fn motion_that_does_not_fit_a_file_goes_on_with_segments_and_each_has_the_digest_of_the_next() {
        let mut long = motion();
        long.events.clear();
        let knots = 1_000;
        long.knots = (0..knots)
            .map(|k| MotionKnot {
                t_s: 10.0 * f64::from(k),
                q_rad: Joints::repeat(6, 1e-3 * f64::from(k)),
                qd_rad_s: Joints::repeat(6, 0.0),
            })
            .collect();
        let Encoded { file, segments } = encode_any(&long, 3_000, 7, None).unwrap();
        // By time: a file lasts 1 000 s. Then four knots in each segment.
        let (header, spline) = decoded(&file).unwrap();
        assert_eq!((spline.len(), segments.len()), (101, (knots as usize - 101).div_ceil(4)));
        let mut next = header.next;
        let mut k = 101_u64;
        for Segment { bytes, room_us } in &segments {
            // 256 knots: all but those of the last 256 must be past.
            let knots = bytes.len() / 52;
            let behind = (k + knots as u64).saturating_sub(256);
            assert_eq!(*room_us, (10_000_000 * behind + 200_000) as u32);
            assert_eq!(next, Some(sha256(bytes)));
            let (digest, rows) = bytes.split_at(32);
            for row in rows.chunks(52) {
                let t_us = u32::from_le_bytes(row[..4].try_into().unwrap());
                let q_rad = f32::from_le_bytes(row[4..8].try_into().unwrap());
                assert_eq!((t_us, q_rad), ((10_000_000 * k) as u32, (1e-3 * k as f64) as f32));
                k += 1;
            }
            next = (digest != [0; 32]).then(|| digest.try_into().unwrap());
        }
        assert_eq!((next, k), (None, knots as u64));
    }

    /// Found by a stop of a program near the end of a step: the short way from there was refused as too fast.
    #[test]
    fn motions_at_the_full_limits_are_taken_however_short_they_are_and_wherever_they_begin() {
        use planner::plan::rng::SplitMix64;
        use planner::timing::{Limits, Path, along, straight};
        let arm = planner::plan::Arm::load("powercube6").unwrap();
        let limits = Limits::of_arm(&arm, 1.0).unwrap();
        let settings = crate::bus::period::settings_with_gains(&arm, &Default::default()).unwrap();
        let mut rng = SplitMix64::new(5);
        for k in 0..120 {
            let length_rad = 2e-3 * 2000_f64.powf(rng.unit());
            let mut near = |from: &Joints| {
                Joints::from_fn(6, |j| {
                    let step = length_rad * (2.0 * rng.unit() - 1.0);
                    (from[j] + step).clamp(arm.q_min()[j] + 0.03, arm.q_max()[j] - 0.03)
                })
            };
            let from = near(&Joints::from_slice(&[0.67, -1.57, -3.4, 1.12, -1.68, 2.2]));
            let (to, last) = (near(&from), near(&from));
            let corner = Path::through(&[from.as_slice(), to.as_slice(), last.as_slice()], 0.3 * length_rad);
            for motion in
                [straight(from.as_slice(), to.as_slice(), &limits), along(&corner.unwrap(), &limits)]
            {
                let sent =
                    encode(&motion.unwrap(), settings.cycle_period_us, settings.robot_crc32, Some(&settings));
                assert!(sent.is_ok(), "motion {k} of {length_rad} rad: {}", sent.unwrap_err());
            }
        }
    }
}
