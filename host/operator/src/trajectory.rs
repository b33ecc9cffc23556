//! From planned motions to the trajectory file of a controller: the only step from f64 to f32.

use firmware::envelope::Envelope;
use firmware::events::{Action, EVENTS_MAX, PlanEvent, PlanEvents};
use firmware::joints::PerJoint;
use firmware::settings::Settings;
use firmware::spline::{Knot, Spline};
use firmware::trajectory_format::{self, FILE_LEN_MAX, Header};
use protocol::JointIndex;

pub use crate::bus::settings::robot_crc32;
use planner::motion::{GripperEvent, Motion};
use planner::plan::Joints;

/// Why a motion makes no trajectory file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// Too long, or too many knots.
    #[error("a motion of {knots} knots and {duration_s:.1} s is too long for a controller")]
    TooLong { knots: usize, duration_s: f64 },
    /// More events than a controller has places for.
    #[error("a motion with {events} events is too much for a controller, which takes {EVENTS_MAX}")]
    TooManyEvents { events: usize },
    /// A check of the controller fails; told before anything is sent.
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
    let too_long = || TrajectoryError::TooLong { knots: motion.knots.len(), duration_s: motion.duration_s() };
    let us = |t_s: f64| {
        let us = (t_s * 1e6).round();
        (0.0..f64::from(u32::MAX)).contains(&us).then_some(us as u32)
    };
    let mut knots = Vec::with_capacity(motion.knots.len());
    for knot in &motion.knots {
        let mut state = PerJoint::default();
        for joint in JointIndex::first(knot.q_rad.len()) {
            state.set(joint, (knot.q_rad[joint.get()] as f32, knot.qd_rad_s[joint.get()] as f32));
        }
        knots.push(Knot { t_us: us(knot.t_s).ok_or_else(too_long)?, state });
    }
    let mut events = PlanEvents::NONE;
    for (t_s, event) in &motion.events {
        let action = match event {
            GripperEvent::Open => Action::Open,
            GripperEvent::Close => Action::Close,
        };
        if !events.push(PlanEvent { t_us: us(*t_s).ok_or_else(too_long)?, action }) {
            return Err(TrajectoryError::TooManyEvents { events: motion.events.len() });
        }
    }
    let header =
        Header { joints: motion.start_rad().len() as u8, period_us, events, robot_crc32, envelope: None };
    let mut bytes = vec![0; FILE_LEN_MAX];
    let len = trajectory_format::encode(&header, &knots, &mut bytes).ok_or_else(too_long)?;
    bytes.truncate(len);
    check(&bytes, settings)?;
    Ok(bytes)
}

/// The motion of a controller's file; `None` if no controller would take it. Events do not matter to who follows it.
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

/// What a controller would refuse in a file, with its own code; without `settings` only what every one refuses.
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

    /// Found by a stop of a program near the end of a step: the short way from there was refused as too fast.
    #[test]
    fn motions_at_the_full_limits_are_taken_however_short_they_are_and_wherever_they_begin() {
        use planner::plan::rng::SplitMix64;
        use planner::timing::{Limits, Path, along, straight};
        let arm = planner::plan::Arm::load("powercube6").unwrap();
        let limits = Limits::of_arm(&arm, 1.0).unwrap();
        let settings = crate::bus::period::settings_with_gains(&arm).unwrap();
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
