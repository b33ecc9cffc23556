//! Frames of a tracker to a target, without a socket: what came and when are arguments.

use protocol::{Duration, Instant};
use tracker_protocol::dtrack::{DataFrame, DayClock, FrameGate, Verdict};
use tracker_protocol::vrpn::{VrpnClient, VrpnItem};

use super::target::{Estimator, Frame, NoTarget, Target, TargetRequest};

/// Longest wait for the first and for the next frame.
pub const FRAME_LIMIT: Duration = Duration::from_secs(3);
/// A fall of the frame counter by more than this means that the tracker was started again.
const RESTART_AFTER: u64 = 1_000;
/// Older frames in a row whose numbers rise: a tracker that was started again soon after its first start.
const RISING_OLD: u32 = 10;
/// A tracker that is started again more often than this in one measurement is not waited for.
const RESTARTS_MAX: u32 = 3;
/// Unreadable datagrams in a row after which another sender is assumed. One alone is a torn frame.
const UNREADABLE_MAX: u32 = 10;

const NO_TIME: &str = "frames have no time; switch `ts` on in the output settings";

/// No target comes of these frames.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// Nothing comes.
    #[error("no frame within {} s", FRAME_LIMIT.as_secs_f64())]
    Silent,
    #[error("{0}")]
    Unreadable(String),
    /// Frames come, but the target cannot be used.
    #[error(transparent)]
    NoTarget(#[from] NoTarget),
}

#[derive(Clone, Debug)]
pub struct DTrackFrames {
    wish: TargetRequest,
    gate: FrameGate,
    clock: DayClock,
    estimator: Estimator,
    /// When the last new frame came.
    heard: Instant,
    /// Last of the frames since that are not newer, and how many of them in a row rise.
    old: Option<(u64, u32)>,
    restarts: u32,
    /// Unreadable datagrams in a row.
    unreadable: u32,
    /// The tracker ends its lines, also the last one of a datagram.
    ends_lines: bool,
    /// The tracker sends the line `ts2`; another clock than that of `ts`.
    sends_ts2: bool,
}

impl DTrackFrames {
    /// For a wish; the wait for the first frame begins `now`.
    #[must_use]
    pub fn new(wish: TargetRequest, now: Instant) -> Self {
        Self {
            wish,
            gate: FrameGate::new(RESTART_AFTER),
            clock: DayClock::new(),
            estimator: Estimator::new(wish),
            heard: now,
            old: None,
            restarts: 0,
            unreadable: 0,
            ends_lines: false,
            sends_ts2: false,
        }
    }

    /// Takes the next datagram; the target once there are enough.
    pub fn push(&mut self, now: Instant, datagram: &[u8]) -> Result<Option<Target>, FrameError> {
        let frame = match DataFrame::parse(datagram) {
            Ok(frame) => frame,
            Err(error) => return self.unreadable(now, error.to_string()),
        };
        if frame.ts_s.is_none() && frame.ts2.is_none() {
            return self.unreadable(now, NO_TIME.to_owned());
        }
        let ended = datagram.ends_with(b"\n") || datagram.ends_with(b"\r") || datagram.ends_with(b"\0");
        if self.ends_lines && !ended {
            // The last number may be the beginning of a longer one: another frame, another time.
            return self.unreadable(now, "the last line is cut off".to_owned());
        }
        if self.sends_ts2 && frame.ts2.is_none() {
            return self.unreadable(now, "the line `ts2` is cut off".to_owned());
        }
        (self.unreadable, self.ends_lines, self.sends_ts2) = (0, ended, frame.ts2.is_some());
        match self.gate.judge(frame.frame) {
            // Not a sign of life: a tracker that hangs may repeat its last frame without end.
            Verdict::Old => {
                let rising = match self.old {
                    Some((before, rising)) if frame.frame > before => rising + 1,
                    _ => 1,
                };
                self.old = Some((frame.frame, rising));
                if rising < RISING_OLD {
                    self.wait(now)?;
                    return Ok(None);
                }
                self.gate = FrameGate::new(RESTART_AFTER);
                self.gate.judge(frame.frame);
                self.restart()?;
            }
            Verdict::Restart => self.restart()?,
            Verdict::First | Verdict::New { .. } => {}
        }
        (self.heard, self.old) = (now, None);
        let no_time = || FrameError::Unreadable(NO_TIME.to_owned());
        let stamp = frame.stamp(&mut self.clock).ok_or_else(no_time)?;
        let body = self.wish.body;
        let pose = frame
            .pose(body, &mut self.clock)
            .map_err(|error| NoTarget::NotAPose { body, what: error.to_string() })?;
        Ok(self.estimator.push(&Frame { arrived: now, stamp, pose })?)
    }

    /// A datagram that cannot be read is left out, unless nothing else comes.
    fn unreadable(&mut self, now: Instant, what: String) -> Result<Option<Target>, FrameError> {
        self.unreadable += 1;
        if self.unreadable > UNREADABLE_MAX {
            return Err(FrameError::Unreadable(what));
        }
        self.wait(now)?;
        Ok(None)
    }

    /// The tracker was started again: its earlier data do not count.
    fn restart(&mut self) -> Result<(), FrameError> {
        self.restarts += 1;
        if self.restarts > RESTARTS_MAX {
            let what = format!("their counter begins again, {} times so far", self.restarts);
            return Err(NoTarget::Stale { what }.into());
        }
        self.estimator.restart();
        self.clock = DayClock::new();
        Ok(())
    }

    /// Whether it makes sense to wait longer.
    ///
    /// # Errors
    /// No new frame has come for too long.
    pub fn wait(&self, now: Instant) -> Result<(), FrameError> {
        let silent = now.saturating_since(self.heard);
        if silent < FRAME_LIMIT {
            return Ok(());
        }
        Err(match self.old {
            Some((frame, _)) => NoTarget::Stale {
                what: format!(
                    "no new one for {:.1} s, and frame {frame} comes again and again",
                    silent.as_secs_f64()
                ),
            }
            .into(),
            None => FrameError::Silent,
        })
    }
}

/// The stream of a VRPN server.
#[derive(Clone, Debug)]
pub struct VrpnFrames {
    wish: TargetRequest,
    client: VrpnClient,
    estimator: Estimator,
    heard: Instant,
}

impl VrpnFrames {
    /// For a wish and the tracker of that name; the wait for the first frame begins `now`.
    #[must_use]
    pub fn new(wish: TargetRequest, tracker: &str, now: Instant) -> Self {
        Self { wish, client: VrpnClient::new(tracker), estimator: Estimator::new(wish), heard: now }
    }

    /// Takes the next piece of the stream; the target once there are enough poses.
    pub fn push(&mut self, now: Instant, piece: &[u8]) -> Result<Option<Target>, FrameError> {
        let items = self.client.push(piece).map_err(|error| FrameError::Unreadable(error.to_string()))?;
        let body = self.wish.body;
        for item in items {
            let pose = match item {
                VrpnItem::Pose(pose) if pose.body == body => pose,
                VrpnItem::NotAPose { sensor } if u32::try_from(sensor) == Ok(body) => {
                    let what = "its pose has NaN or no valid rotation".to_owned();
                    return Err(NoTarget::NotAPose { body, what }.into());
                }
                _ => continue,
            };
            self.heard = now;
            let frame = Frame { arrived: now, stamp: pose.stamp, pose: Some(pose) };
            if let Some(target) = self.estimator.push(&frame)? {
                return Ok(Some(target));
            }
        }
        self.wait(now)?;
        Ok(None)
    }

    /// Whether it makes sense to wait longer. For a lost body the server simply sends no more reports.
    pub fn wait(&self, now: Instant) -> Result<(), FrameError> {
        if now.saturating_since(self.heard) < FRAME_LIMIT {
            return Ok(());
        }
        Err(match self.estimator.frames() {
            0 => FrameError::Silent,
            seen => NoTarget::Lost { body: self.wish.body, seen, missing: 0 }.into(),
        })
    }
}
