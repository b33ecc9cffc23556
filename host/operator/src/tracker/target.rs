//! A point on a tracked body as a target: mean over some frames with its scatter, or the reason why there is no target.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use protocol::{Duration, Instant};
use tracker_protocol::TrackedPose;

/// Longest time in which all frames come late.
const LATE_MAX: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetRequest {
    pub body: u32,
    /// The point on the body, m, in its frame.
    pub offset_m: [f64; 3],
    /// Frames in which the body must be seen, at least 6.
    pub frames: usize,
    /// Largest scatter of a target at rest, m.
    pub scatter_max_m: f64,
    /// A step from frame to frame that no body at rest makes, m.
    pub jump_max_m: f64,
    /// Frames in a row without the body after which it is lost.
    pub missing_max: usize,
    /// Oldest frame that counts as present, by the age that the tracker reports and by its delay compared with the fastest
    /// frame.
    pub age_max: Duration,
}

impl TargetRequest {
    /// Body 0, its origin, one second of a 60 Hz tracker. A tracker scatters by 0.1 to 0.3 mm.
    #[must_use]
    pub fn new(body: u32) -> Self {
        Self {
            body,
            offset_m: [0.0; 3],
            frames: 60,
            scatter_max_m: 0.003,
            jump_max_m: 0.02,
            missing_max: 10,
            age_max: Duration::from_millis(250),
        }
    }
}

/// Where a target is, in the room of the tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Mean of the point over the frames, m.
    pub mean_m: [f64; 3],
    /// Root mean square distance of the frames from the mean, m.
    pub scatter_m: f64,
    /// Standard error of the mean, m.
    pub error_m: f64,
    /// Frames that count.
    pub frames: usize,
    /// Time from the first to the last of them, s.
    pub span_s: f64,
    /// Frames in between that did not show the body.
    pub missing: usize,
}

/// There is no target.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoTarget {
    /// Frames come, the body was never in them.
    #[error("body {body} was not seen in {frames} frames")]
    NotSeen { body: u32, frames: usize },
    /// It was seen and then lost.
    #[error("body {body} was lost after {seen} frames: it is missing in {missing} frames in a row")]
    Lost {
        body: u32,
        /// Frames with it.
        seen: usize,
        /// Frames without it.
        missing: usize,
    },
    /// Frames are old, or their time stands.
    #[error("the frames of the tracker are stale: {what}")]
    Stale { what: String },
    /// From one frame to the next farther than a body at rest comes.
    #[error("body {body} jumps by {by_mm:.1} mm from one frame to the next")]
    Jumps {
        body: u32,
        /// How far.
        by_mm: f64,
    },
    /// It does not stand.
    #[error("body {body} moves: {what}")]
    Moves { body: u32, what: String },
    /// Its pose is not valid.
    #[error("body {body}: {what}")]
    NotAPose { body: u32, what: String },
}

impl NoTarget {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::NotSeen { .. } => {
                "free the view of the cameras, switch the body on, or name another one with --tracker-body"
                    .to_owned()
            }
            Self::Lost { .. } => "free the view of the cameras".to_owned(),
            Self::Stale { .. } => "check its network and start its measurement again".to_owned(),
            Self::Jumps { .. } => {
                "look for a second body with a similar arrangement of spheres, or for reflections".to_owned()
            }
            Self::Moves { .. } => "fix it; a target that moves is not thrown at".to_owned(),
            Self::NotAPose { .. } => "calibrate the body in the tracker again".to_owned(),
        })
    }
}

/// One frame as the tracker sent it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// When it came, on this machine's clock.
    pub arrived: Instant,
    /// When the cameras saw it, on the tracker's clock.
    pub stamp: Instant,
    /// The body, if the frame shows it.
    pub pose: Option<TrackedPose>,
}

/// Collects frames. Frames that are not newer than the last one must be left out by the caller.
#[derive(Clone, Debug)]
pub struct Estimator {
    wish: TargetRequest,
    points: Vec<(Instant, Vector3<f64>)>,
    frames: usize,
    missing_in_row: usize,
    missing: usize,
    last_stamp: Option<Instant>,
    /// Least difference so far between the clocks of this machine and of the tracker, us: from the frame with the least delay.
    fastest_us: Option<i64>,
    /// When the last frame came that was young enough.
    fresh_at: Option<Instant>,
}

impl Estimator {
    #[must_use]
    pub fn new(wish: TargetRequest) -> Self {
        Self {
            wish,
            points: Vec::new(),
            frames: 0,
            missing_in_row: 0,
            missing: 0,
            last_stamp: None,
            fastest_us: None,
            fresh_at: None,
        }
    }

    /// Frames seen so far, with the body or without.
    #[must_use]
    pub const fn frames(&self) -> usize {
        self.frames
    }

    /// Forgets everything: the tracker was started again.
    pub fn restart(&mut self) {
        *self = Self::new(self.wish);
    }

    /// Takes the next frame; the target once there are enough.
    ///
    /// # Errors
    /// [`NoTarget`]: a target is no longer possible.
    pub fn push(&mut self, frame: &Frame) -> Result<Option<Target>, NoTarget> {
        let body = self.wish.body;
        self.frames += 1;
        if self.last_stamp.is_some_and(|last| frame.stamp <= last) {
            return Err(NoTarget::Stale { what: "their time does not go on".to_owned() });
        }
        self.last_stamp = Some(frame.stamp);
        let late = self.lateness(frame);
        if late > self.wish.age_max {
            // A frame that waited behind others in this machine is left out; when all are late, the target is seen as it was.
            let stale = self.fresh_at.is_none_or(|at| frame.arrived.saturating_since(at) >= LATE_MAX);
            let what = format!("they come {late} later than the first ones");
            return if stale { Err(NoTarget::Stale { what }) } else { Ok(None) };
        }
        self.fresh_at = Some(frame.arrived);
        let Some(pose) = frame.pose.filter(|pose| pose.tracked) else {
            self.missing_in_row += 1;
            self.missing += 1;
            if self.missing_in_row <= self.wish.missing_max {
                return Ok(None);
            }
            return Err(match self.points.len() {
                0 if self.frames < self.wish.frames => return Ok(None),
                0 => NoTarget::NotSeen { body, frames: self.frames },
                seen => NoTarget::Lost { body, seen, missing: self.missing_in_row },
            });
        };
        self.missing_in_row = 0;
        if pose.age > self.wish.age_max {
            return Err(NoTarget::Stale { what: format!("they are {} old", pose.age) });
        }
        let [w, x, y, z] = pose.rotation_wxyz;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let point = Vector3::from(pose.position_m) + rotation * Vector3::from(self.wish.offset_m);
        // Written so that NaN is refused.
        let finite = point.iter().all(|x| x.is_finite());
        if !finite {
            return Err(NoTarget::NotAPose { body, what: "a value of its pose is not a number".to_owned() });
        }
        if let Some((_, before)) = self.points.last() {
            let by_m = (point - before).norm();
            if by_m > self.wish.jump_max_m {
                return Err(NoTarget::Jumps { body, by_mm: 1e3 * by_m });
            }
        }
        self.points.push((pose.stamp, point));
        if self.points.len() < self.wish.frames.max(6) {
            return Ok(None);
        }
        self.target().map(Some)
    }

    /// How much longer a frame took than the fastest one so far. The clocks of tracker and machine differ by an unknown time, so a
    /// delay that all frames share is not seen.
    fn lateness(&mut self, frame: &Frame) -> Duration {
        let micros = |at: Instant| i64::try_from(at.as_micros()).unwrap_or(i64::MAX);
        let took_us = micros(frame.arrived).saturating_sub(micros(frame.stamp));
        let fastest_us = self.fastest_us.map_or(took_us, |fastest| fastest.min(took_us));
        self.fastest_us = Some(fastest_us);
        Duration::from_micros(took_us.saturating_sub(fastest_us).unsigned_abs())
    }

    fn target(&self) -> Result<Target, NoTarget> {
        let body = self.wish.body;
        let count = self.points.len();
        let mean_of = |some: &[(Instant, Vector3<f64>)]| {
            some.iter().map(|(_, p)| p).sum::<Vector3<f64>>() / some.len().max(1) as f64
        };
        let mean = mean_of(&self.points);
        let squares: f64 = self.points.iter().map(|(_, p)| (p - mean).norm_squared()).sum();
        let scatter_m = (squares / count as f64).sqrt();
        // From frame to frame a body at rest shows its noise alone, twice over.
        let steps: f64 = self.points.windows(2).map(|pair| (pair[1].1 - pair[0].1).norm_squared()).sum();
        let noise_m = (0.5 * steps / (count - 1) as f64).sqrt();
        let third = count / 3;
        let drift_m = (mean_of(&self.points[count - third..]) - mean_of(&self.points[..third])).norm();
        let (first, last) = (self.points[0].0, self.points[count - 1].0);
        let span_s = last.saturating_since(first).as_secs_f64();
        // Four times what noise makes of the difference of two means, and half a millimetre of slow noise.
        let drift_max_m = 5e-4 + 4.0 * noise_m * (2.0 / third as f64).sqrt();
        if drift_m > drift_max_m {
            let what = format!("by {:.1} mm within {span_s:.1} s", 1e3 * drift_m);
            return Err(NoTarget::Moves { body, what });
        }
        if scatter_m > self.wish.scatter_max_m {
            let what = format!(
                "its frames scatter by {:.1} mm, a target at rest by {:.1} mm at most",
                1e3 * scatter_m,
                1e3 * self.wish.scatter_max_m
            );
            return Err(NoTarget::Moves { body, what });
        }
        Ok(Target {
            mean_m: mean.into(),
            scatter_m,
            error_m: scatter_m / (count as f64).sqrt(),
            frames: count,
            span_s,
            missing: self.missing,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_US: u64 = 16_667;

    fn pose(k: u64, position_m: [f64; 3]) -> TrackedPose {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        TrackedPose {
            stamp: Instant::from_micros(1_000_000 + PERIOD_US * k),
            body: 0,
            position_m,
            // 90 degrees about z: x of the body is y of the room.
            rotation_wxyz: [half, 0.0, 0.0, half],
            tracked: true,
            age: Duration::from_millis(15),
        }
    }

    /// On another clock than the stamps, 15 ms after the flash.
    fn arrival(k: u64) -> Instant {
        Instant::from_micros(7_015_000 + PERIOD_US * k)
    }

    /// Noise of a tracker without a generator: two incommensurate sequences.
    fn noise(k: u64) -> [f64; 3] {
        let x = |a: f64| 2e-4 * (2.0 * (a * k as f64).fract() - 1.0);
        [x(0.618_034), x(0.414_214), x(0.732_051)]
    }

    fn run(frame: impl Fn(u64) -> Frame) -> Result<Option<Target>, NoTarget> {
        let mut estimator =
            Estimator::new(TargetRequest { offset_m: [0.1, 0.0, 0.0], ..TargetRequest::new(0) });
        for k in 0..200 {
            if let Some(target) = estimator.push(&frame(k))? {
                return Ok(Some(target));
            }
        }
        Ok(None)
    }

    fn seen(k: u64, p: [f64; 3]) -> Frame {
        let pose = pose(k, p);
        Frame { arrived: arrival(k), stamp: pose.stamp, pose: Some(pose) }
    }

    fn still(k: u64) -> Frame {
        let [a, b, c] = noise(k);
        seen(k, [2.5 + a, b, 0.6 + c])
    }

    #[test]
    fn mean_of_a_body_at_rest_is_within_a_tenth_of_a_millimetre_and_offset_turns_with_it() {
        let target = run(still).unwrap().unwrap();
        let away = (Vector3::from(target.mean_m) - Vector3::new(2.5, 0.1, 0.6)).norm();
        assert!(away < 1e-4, "{away}");
        assert!((1e-4..4e-4).contains(&target.scatter_m) && target.frames == 60, "{target:?}");
    }

    #[test]
    fn some_missing_frames_are_reported_and_many_in_a_row_are_a_lost_body() {
        let gap = |from: u64, length: u64| {
            move |k: u64| {
                if (from..from + length).contains(&k) { Frame { pose: None, ..still(k) } } else { still(k) }
            }
        };
        assert_eq!(run(gap(20, 5)).unwrap().unwrap().missing, 5);
        assert!(matches!(run(gap(20, 30)), Err(NoTarget::Lost { seen: 20, .. })));
        assert!(matches!(run(gap(0, 200)), Err(NoTarget::NotSeen { .. })));
    }

    #[test]
    fn bodies_that_jump_drift_or_swing_are_refused() {
        let jump = |k: u64| if k < 30 { still(k) } else { seen(k, [2.53, 0.0, 0.6]) };
        assert!(matches!(run(jump), Err(NoTarget::Jumps { by_mm, .. }) if (29.0..31.0).contains(&by_mm)));
        let drift = |k: u64| {
            let [a, b, c] = noise(k);
            seen(k, [2.5 + a + 1e-4 * k as f64, b, 0.6 + c])
        };
        assert!(matches!(run(drift), Err(NoTarget::Moves { .. })));
        let swing = |k: u64| seen(k, [2.5 + 0.01 * (0.5 * k as f64).sin(), 0.0, 0.6]);
        assert!(matches!(run(swing), Err(NoTarget::Moves { .. })));
    }

    #[test]
    fn old_frames_standing_time_and_nan_are_refused() {
        let old = |k: u64| {
            let mut frame = still(k);
            frame.pose = frame.pose.map(|pose| TrackedPose { age: Duration::from_millis(400), ..pose });
            frame
        };
        assert!(matches!(run(old), Err(NoTarget::Stale { .. })));
        let standing = |k: u64| Frame { stamp: Instant::from_micros(5), ..still(k) };
        assert!(matches!(run(standing), Err(NoTarget::Stale { .. })));
        assert!(matches!(run(|k| seen(k, [f64::NAN, 0.0, 0.0])), Err(NoTarget::NotAPose { .. })));
    }

    #[test]
    fn frames_that_queued_for_a_while_are_left_out_and_frames_that_stay_late_are_stale() {
        let later = |from: u64, length: u64, ms: u64| {
            move |k: u64| {
                let late = if (from..from + length).contains(&k) { ms } else { 0 };
                Frame { arrived: arrival(k) + Duration::from_millis(late), ..still(k) }
            }
        };
        // Half a second of frames waits, then comes at once: the first ones are old, the rest is younger than 250 ms.
        let queued = |k: u64| {
            let arrived = if (20..50).contains(&k) { arrival(50) } else { arrival(k) };
            Frame { arrived, ..still(k) }
        };
        let target = run(queued).unwrap().unwrap();
        assert_eq!((target.frames, target.missing), (60, 0));
        assert!(target.span_s > 1.1, "the old ones do not count: {}", target.span_s);
        assert!(run(later(20, 20, 200)).unwrap().is_some(), "within the bound");
        let stale = run(later(20, 200, 400));
        assert!(matches!(&stale, Err(NoTarget::Stale { what }) if what.contains("400")), "{stale:?}");
    }
}
