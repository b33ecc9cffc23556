//! What the drives said during a run: tracking errors, and the state of the arm at the release.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;

use nalgebra::{Matrix2, Vector2, Vector3};
use protocol::powercube::{AddressedRequest, MotionPosition, Parameter, Reply, Request, Value};
use protocol::{Duration, Frame, Instant, ModuleId};

use super::trajectory::Motion;
use crate::bus::session::{Tap, Way};
use crate::flight::FlightModel;
use crate::plan::{Arm, JOINTS, Joints};

/// Samples this near to the release, s, before and after it, are fitted: seven at the paper's 17 ms.
const FIT_HALF_S: f64 = 0.06;
/// Fewest samples of a joint that make a fit.
const FIT_SAMPLES_MIN: usize = 5;

/// Position of a drive, as told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// End of the answer's frame.
    pub at: Instant,
    /// Who.
    pub module: ModuleId,
    /// Of the drive, rad.
    pub position_rad: f64,
}

/// Everything that is kept of what passed.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    /// Positions, in order.
    pub samples: Vec<Sample>,
    /// First write of the gripper's output with the line set, since the last [`Collector::clear`].
    pub gripper_ordered_at: Option<Instant>,
    /// Frames of all kinds.
    pub frames: u64,
}

/// Collects from the frames of a session.
#[derive(Clone, Debug, Default)]
pub struct Collector(Rc<RefCell<Heard>>);

impl Collector {
    /// What was heard since the last [`Collector::clear`].
    #[must_use]
    pub fn heard(&self) -> Heard {
        self.0.borrow().clone()
    }

    /// Forgets everything.
    pub fn clear(&self) {
        *self.0.borrow_mut() = Heard::default();
    }
}

impl Tap for Collector {
    fn frame(&mut self, at: Instant, _: Way, frame: &Frame) -> io::Result<()> {
        let mut heard = self.0.borrow_mut();
        heard.frames += 1;
        if frame.is_extended() {
            return Ok(());
        }
        if let Ok((module, reply)) = Reply::decode(frame) {
            let position_rad = match reply {
                Reply::MotionExtended { position: MotionPosition::Radians(rad), .. } => f64::from(rad.get()),
                Reply::Value(_, Value::PosStateDio(all)) => f64::from(all.position_rad),
                _ => return Ok(()),
            };
            heard.samples.push(Sample { at, module, position_rad });
        } else if let Ok(AddressedRequest {
            request: Request::Set(Parameter::DioData, Value::U32(bits)), ..
        }) = AddressedRequest::decode(frame)
            && bits & 0xF0 != 0
        {
            heard.gripper_ordered_at.get_or_insert(at);
        }
        Ok(())
    }
}

/// From drives to joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMap {
    /// Drive of each joint.
    pub modules: [ModuleId; JOINTS],
    /// The joint turns against the drive.
    pub inverted: [bool; JOINTS],
    /// Joint angle where the drive reads zero, rad.
    pub offset_rad: [f64; JOINTS],
    /// From the measurement to the end of the answer's frame.
    pub reply_age: Duration,
    /// From the order to open to the free ball.
    pub gripper_opening: Duration,
}

impl JointMap {
    fn joint_of(&self, sample: &Sample) -> Option<(usize, f64)> {
        let joint = self.modules.iter().position(|module| *module == sample.module)?;
        let turned = if self.inverted[joint] { -sample.position_rad } else { sample.position_rad };
        Some((joint, turned + self.offset_rad[joint]))
    }
}

/// How well each joint followed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tracking {
    /// Largest distance from the reference, rad.
    pub error_max_rad: [f64; JOINTS],
    /// Root of the mean square, rad.
    pub error_rms_rad: [f64; JOINTS],
    /// Answers per joint.
    pub samples: [usize; JOINTS],
}

/// Compares what was heard with `motion`, whose time 0 was at `start`.
#[must_use]
pub fn tracking(heard: &Heard, map: &JointMap, motion: &Motion, start: Instant) -> Tracking {
    let mut tracking = Tracking::default();
    for sample in &heard.samples {
        let Some((joint, q_rad)) = map.joint_of(sample) else { continue };
        let t_s = since_s(sample.at, start) - map.reply_age.as_secs_f64();
        if !(0.0..=motion.duration_s()).contains(&t_s) {
            continue;
        }
        let error_rad = q_rad - motion.at(t_s).0[joint];
        tracking.error_max_rad[joint] = tracking.error_max_rad[joint].max(error_rad.abs());
        tracking.error_rms_rad[joint] += error_rad * error_rad;
        tracking.samples[joint] += 1;
    }
    for (sum, n) in tracking.error_rms_rad.iter_mut().zip(tracking.samples) {
        *sum = (*sum / n.max(1) as f64).sqrt();
    }
    tracking
}

/// The arm at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmState {
    /// Angles, rad.
    pub q_rad: Joints,
    /// Speeds, rad/s.
    pub qd_rad_s: Joints,
}

/// Angles and speeds at `at`: the reference there, and a straight line fitted to each joint's deviation from it in the
/// answers around; `None` if a joint answered too rarely.
///
/// The deviation is small and slow, so that the line may be long: finer than the resolution of a drive, and
/// without the error that a polynomial through the motion itself would have.
#[must_use]
pub fn state_at(
    heard: &Heard,
    map: &JointMap,
    (motion, start): (&Motion, Instant),
    at: Instant,
) -> Option<ArmState> {
    let (q_rad, qd_rad_s) = motion.at(since_s(at, start));
    let mut state = ArmState { q_rad, qd_rad_s };
    for joint in 0..JOINTS {
        // Normal equations of e = c0 + c1 t.
        let (mut normal, mut right, mut n) = (Matrix2::zeros(), Vector2::zeros(), 0);
        for sample in &heard.samples {
            let Some((_, q_rad)) = map.joint_of(sample).filter(|(of, _)| *of == joint) else { continue };
            let t_s = since_s(sample.at, at) - map.reply_age.as_secs_f64();
            if t_s.abs() > FIT_HALF_S {
                continue;
            }
            let row = Vector2::new(1.0, t_s);
            normal += row * row.transpose();
            right += row * (q_rad - motion.at(t_s + since_s(at, start)).0[joint]);
            n += 1;
        }
        if n < FIT_SAMPLES_MIN {
            return None;
        }
        let fit = normal.cholesky()?.solve(&right);
        state.q_rad[joint] += fit[0];
        state.qd_rad_s[joint] += fit[1];
    }
    Some(state)
}

/// Where a ball released in `state` meets the plane `z_m`; `None` if it does not.
#[must_use]
pub fn landing(arm: &Arm, flight: &FlightModel, state: &ArmState, z_m: f64) -> Option<Vector3<f64>> {
    let frames = arm.fk(&state.q_rad);
    let p = arm.ball(&frames).pos;
    let twist = frames.jacobian(&p) * state.qd_rad_s;
    let v = Vector3::new(twist[0], twist[1], twist[2]);
    Some(flight.land(&p, &v, z_m)?.p)
}

/// Seconds from `origin` to `at`, negative before it.
fn since_s(at: Instant, origin: Instant) -> f64 {
    if at >= origin {
        at.saturating_since(origin).as_secs_f64()
    } else {
        -origin.saturating_since(at).as_secs_f64()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::throw::trajectory::MotionKnot;

    fn map() -> JointMap {
        JointMap {
            modules: [1, 2, 3, 4, 5, 6].map(|n| ModuleId::new(n).unwrap()),
            inverted: [false, true, false, false, false, false],
            offset_rad: [0.0, -1.5, 0.0, 0.0, 0.0, 0.0],
            reply_age: Duration::from_micros(130),
            gripper_opening: Duration::from_millis(20),
        }
    }

    fn motion() -> Motion {
        let knot = |t_s, q: f64| MotionKnot { t_s, q_rad: Joints::repeat(q), qd_rad_s: Joints::zeros() };
        Motion { knots: vec![knot(0.0, 0.2), knot(1.0, 1.2)], release_s: None }
    }

    /// Answers every 3 ms of drives that follow exactly but for an offset, in steps of 0.02 degrees.
    fn heard(error_rad: f64, start: Instant) -> Heard {
        let mut heard = Heard::default();
        for k in 0..330_u64 {
            for (joint, module) in map().modules.into_iter().enumerate() {
                let at = start + Duration::from_micros(3_000 * k + 210 * joint as u64);
                let t_s = at.saturating_since(start).as_secs_f64() - 130e-6;
                let q = motion().at(t_s.max(0.0)).0[joint] + error_rad;
                let drive = if joint == 1 { -(q + 1.5) } else { q };
                let step = 0.02_f64.to_radians();
                let position_rad = (drive / step).round() * step;
                heard.samples.push(Sample { at, module, position_rad });
            }
        }
        heard
    }

    #[test]
    fn errors_are_those_of_the_joints_at_the_time_of_measurement() {
        let start = Instant::from_micros(5_000_000);
        let found = tracking(&heard(0.004, start), &map(), &motion(), start);
        for joint in 0..JOINTS {
            assert!((3.7e-3..4.3e-3).contains(&found.error_max_rad[joint]), "{found:?}");
            assert!((3.9e-3..4.1e-3).contains(&found.error_rms_rad[joint]), "{found:?}");
            assert!((325..=330).contains(&found.samples[joint]));
        }
    }

    #[test]
    fn the_state_at_an_instant_is_fitted_finer_than_the_resolution_of_a_drive() {
        let start = Instant::from_micros(5_000_000);
        let (motion, at) = (motion(), start + Duration::from_millis(400));
        let state = state_at(&heard(2e-3, start), &map(), (&motion, start), at).unwrap();
        let (q, qd) = motion.at(0.4);
        assert!((state.q_rad - q - Joints::repeat(2e-3)).amax() < 1e-4, "{state:?}");
        assert!((state.qd_rad_s - qd).amax() < 2e-3, "{state:?}");
        let late = start + Duration::from_secs(9);
        assert_eq!(state_at(&heard(0.0, start), &map(), (&motion, start), late), None);
    }
}
