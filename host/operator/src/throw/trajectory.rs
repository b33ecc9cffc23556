//! From planned motions to the trajectory file of a controller: the only step from f64 to f32.

use firmware::joints::PerJoint;
use firmware::settings::Settings;
use firmware::spline::{Knot, Spline};
use firmware::trajectory_format::{self, FILE_LEN_MAX, Header};
use protocol::JointIndex;

pub use crate::bus::settings::robot_crc32;
use planner::plan::file::{JointPlan, PlanFile};
use planner::plan::{JOINTS, Joints};

/// Breaks of two joints nearer than this are one, s.
const SAME_TIME_S: f64 = 1e-7;

/// State of the joints at one time of a motion; between two of them each joint follows the cubic they determine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionKnot {
    /// Time since the start, s.
    pub t_s: f64,
    /// Angles, rad.
    pub q_rad: Joints,
    /// Speeds, rad/s.
    pub qd_rad_s: Joints,
}

/// A motion of all joints from rest to rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// At least two, times ascending from 0.
    pub knots: Vec<MotionKnot>,
    /// When the ball shall be free, s since the start.
    pub release_s: Option<f64>,
}

/// Why a motion makes no trajectory file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// Polynomials that a controller cannot follow exactly.
    #[error(
        "{joint}: a segment has {coefficients} coefficients; controllers follow cubics (4)\n  next: plan with this version of cubectl"
    )]
    NotCubic {
        /// Name of the joint.
        joint: String,
        /// How many.
        coefficients: usize,
    },
    /// Too long, or too many knots.
    #[error("a motion of {knots} knots and {duration_s:.1} s is too long for a controller")]
    TooLong {
        /// Knots.
        knots: usize,
        /// Duration, s.
        duration_s: f64,
    },
    /// A check of the controller fails; told before anything is sent.
    #[error("{}", refused(*.cause, *.joint, *.place))]
    Refused {
        /// What.
        cause: firmware::fault::Cause,
        /// Which joint, from 1.
        joint: Option<usize>,
        /// Segment or knot.
        place: u16,
    },
}

fn refused(cause: firmware::fault::Cause, joint: Option<usize>, place: u16) -> String {
    let joint = joint.map_or(String::new(), |joint| format!("joint {joint}: "));
    match cause.info() {
        Some(info) => {
            format!("{joint}{} (segment {place}, fault {})\n  next: {}", info.what, info.code, info.recovery)
        }
        None => format!("{joint}cause {}", cause.code()),
    }
}

impl Motion {
    /// Motion of a plan: exact, because its segments are cubics.
    ///
    /// # Errors
    /// [`TrajectoryError::NotCubic`].
    pub fn of_plan(plan: &PlanFile) -> Result<Self, TrajectoryError> {
        for joint in &plan.joints {
            if let Some(segment) = joint.segments.iter().find(|s| s.coefficients_rad.len() > 4) {
                let coefficients = segment.coefficients_rad.len();
                return Err(TrajectoryError::NotCubic { joint: joint.name.clone(), coefficients });
            }
        }
        let mut times: Vec<f64> = plan
            .joints
            .iter()
            .flat_map(|joint| joint.segments.iter().flat_map(|s| [s.t_start_s, s.t_end_s]))
            .collect();
        times.sort_by(f64::total_cmp);
        times.dedup_by(|late, early| *late - *early <= SAME_TIME_S);
        let knots = times.into_iter().map(|t_s| {
            let at = |j: usize| plan.joints.get(j).map_or((0.0, 0.0), |joint| state_at(joint, t_s));
            MotionKnot {
                t_s,
                q_rad: Joints::from_fn(|j, _| at(j).0),
                qd_rad_s: Joints::from_fn(|j, _| at(j).1),
            }
        });
        Ok(Self { knots: knots.collect(), release_s: Some(plan.release_time_s) })
    }

    /// Duration, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.knots.last().map_or(0.0, |knot| knot.t_s)
    }

    /// Pose at the start, rad.
    #[must_use]
    pub fn start_rad(&self) -> Joints {
        self.knots.first().map_or_else(Joints::zeros, |knot| knot.q_rad)
    }

    /// Pose at the end, rad.
    #[must_use]
    pub fn stop_rad(&self) -> Joints {
        self.knots.last().map_or_else(Joints::zeros, |knot| knot.q_rad)
    }

    /// Angles and speeds at `t_s`, held outside the motion.
    #[must_use]
    pub fn at(&self, t_s: f64) -> (Joints, Joints) {
        let next = self.knots.iter().position(|knot| knot.t_s > t_s);
        match next {
            Some(0) => (self.start_rad(), Joints::zeros()),
            None => (self.stop_rad(), Joints::zeros()),
            Some(next) => {
                let (a, b) = (&self.knots[next - 1], &self.knots[next]);
                let h = b.t_s - a.t_s;
                let s = (t_s - a.t_s) / h;
                // Cubic Hermite basis and its derivative by s.
                let (s2, s3) = (s * s, s * s * s);
                let q = a.q_rad * (2.0 * s3 - 3.0 * s2 + 1.0)
                    + a.qd_rad_s * (h * (s3 - 2.0 * s2 + s))
                    + b.q_rad * (3.0 * s2 - 2.0 * s3)
                    + b.qd_rad_s * (h * (s3 - s2));
                let qd = (b.q_rad - a.q_rad) * ((6.0 * s - 6.0 * s2) / h)
                    + a.qd_rad_s * (3.0 * s2 - 4.0 * s + 1.0)
                    + b.qd_rad_s * (3.0 * s2 - 2.0 * s);
                (q, qd)
            }
        }
    }

    /// The controller's file, for a control period and the robot whose checksum is `robot_crc32`.
    ///
    /// Times are rounded to microseconds, angles and speeds to single precision: 0.3 µrad at 4 rad.
    ///
    /// # Errors
    /// [`TrajectoryError::TooLong`]; with `settings` also everything that a controller with them would refuse.
    pub fn encode(
        &self,
        period_us: u32,
        robot_crc32: u32,
        settings: Option<&Settings>,
    ) -> Result<Vec<u8>, TrajectoryError> {
        let too_long = || TrajectoryError::TooLong { knots: self.knots.len(), duration_s: self.duration_s() };
        let us = |t_s: f64| {
            let us = (t_s * 1e6).round();
            (0.0..f64::from(u32::MAX)).contains(&us).then_some(us as u32)
        };
        let mut knots = Vec::with_capacity(self.knots.len());
        for knot in &self.knots {
            let mut state = PerJoint::default();
            for joint in JointIndex::first(JOINTS) {
                state.set(joint, (knot.q_rad[joint.get()] as f32, knot.qd_rad_s[joint.get()] as f32));
            }
            knots.push(Knot { t_us: us(knot.t_s).ok_or_else(too_long)?, state });
        }
        let header = Header {
            joints: JOINTS as u8,
            period_us,
            release_us: self.release_s.map(|t_s| us(t_s).ok_or_else(too_long)).transpose()?,
            robot_crc32,
        };
        let mut bytes = vec![0; FILE_LEN_MAX];
        let len = trajectory_format::encode(&header, &knots, &mut bytes).ok_or_else(too_long)?;
        bytes.truncate(len);
        check(&bytes, settings)?;
        Ok(bytes)
    }
}

/// What a controller would refuse in a file, with its own code; without `settings` only what every one refuses.
fn check(bytes: &[u8], settings: Option<&Settings>) -> Result<(), TrajectoryError> {
    use firmware::fault::{Cause, Refusal};
    let mut spline = Box::new(Spline::empty());
    let read = |offset: usize, out: &mut [u8]| {
        let from = bytes.get(offset..offset + out.len()).ok_or(Refusal::of(Cause::FileIncomplete))?;
        out.copy_from_slice(from);
        Ok(())
    };
    trajectory_format::decode(bytes.len(), read, &mut spline)
        .and_then(|header| match settings {
            Some(settings) => trajectory_format::check(&header, &spline, settings),
            None => Ok(()),
        })
        .map_err(|refusal| TrajectoryError::Refused {
            cause: refusal.cause,
            joint: refusal.joint.map(|joint| joint.get() + 1),
            place: refusal.index,
        })
}

/// Angle and speed of a joint at `t_s`, by the segment that begins there or holds it.
fn state_at(joint: &JointPlan, t_s: f64) -> (f64, f64) {
    let segment = joint.segments.iter().rev().find(|s| s.t_start_s <= t_s + SAME_TIME_S);
    let Some(segment) = segment.or(joint.segments.first()) else { return (0.0, 0.0) };
    // Horner, highest power first, with the derivative beside it.
    segment.coefficients_rad.iter().fold((0.0, 0.0), |(q, qd), c| (q * t_s + c, qd * t_s + q))
}

#[cfg(test)]
mod tests {
    use super::*;
    use planner::plan::file::Segment;

    fn motion() -> Motion {
        let knot =
            |t_s, q: f64, qd: f64| MotionKnot { t_s, q_rad: Joints::repeat(q), qd_rad_s: Joints::repeat(qd) };
        // Up to 0.6 rad/s in 0.56 s, back to rest in 0.36 s, constant jerk in each.
        let middle = 2.0 / 3.0 * 0.6 * 0.56;
        let stop = middle + 2.0 / 3.0 * 0.6 * 0.36;
        Motion {
            knots: vec![knot(0.0, 0.0, 0.0), knot(0.56, middle, 0.6), knot(0.92, stop, 0.0)],
            release_s: Some(0.56),
        }
    }

    #[test]
    fn a_motion_is_the_cubic_through_its_knots_with_matching_speed() {
        let motion = motion();
        for i in 0..=92 {
            let t = 0.01 * f64::from(i);
            let s = t - 0.56;
            let h: f64 = if s < 0.0 { 0.56 } else { 0.36 };
            let (q, qd) = motion.at(t);
            assert!((qd[2] - 0.6 * (1.0 - s * s / (h * h))).abs() < 1e-12, "{t}");
            assert!((q[2] - (2.0 / 3.0 * 0.6 * 0.56 + 0.6 * (s - s * s * s / (3.0 * h * h)))).abs() < 1e-12);
        }
        assert_eq!(motion.at(7.0), (motion.stop_rad(), Joints::zeros()));
    }

    #[test]
    fn what_a_controller_would_refuse_is_refused_before_anything_is_sent() {
        let settings = Settings::powercube6();
        assert_eq!(motion().encode(3_000, 7, Some(&settings)).unwrap().len(), 184);
        let other = motion().encode(17_000, 7, Some(&settings)).unwrap_err().to_string();
        assert!(other.contains("another control period") && other.contains("next: "), "{other}");
        let mut fast = motion();
        fast.knots[1].qd_rad_s[3] = 2.7;
        let text = fast.encode(3_000, 7, Some(&settings)).unwrap_err().to_string();
        assert!(text.starts_with("joint 4: the plan is faster"), "{text}");
        let mut long = motion();
        long.knots[2].t_s = 1e5;
        assert!(matches!(long.encode(3_000, 7, None), Err(TrajectoryError::TooLong { .. })));
    }

    #[test]
    fn polynomials_in_absolute_time_give_angle_and_speed_at_every_break() {
        let segment =
            |t_start_s, t_end_s, c: [f64; 4]| Segment { t_start_s, t_end_s, coefficients_rad: c.to_vec() };
        let joint = JointPlan {
            name: "j".to_owned(),
            segments: vec![segment(0.0, 1.0, [1.0, 0.0, 0.0, 0.5]), segment(1.0, 2.0, [0.0, 0.0, 3.0, -1.5])],
        };
        assert_eq!(state_at(&joint, 0.0), (0.5, 0.0));
        assert_eq!(state_at(&joint, 0.5), (0.625, 0.75));
        assert_eq!(state_at(&joint, 1.0), (1.5, 3.0));
        assert_eq!(state_at(&joint, 2.0), (4.5, 3.0));
    }
}
