//! Segments in flight: a plan that goes on while it runs.

use core::borrow::BorrowMut;

use protocol::Instant;

use super::Controller;
use crate::authority::{Peer, sha256};
use crate::fault::{Cause, Refusal};
use crate::group::DriveGroup;
use crate::segment;
use crate::spline::Spline;
use crate::state::State;
use crate::store::Storage;
use crate::trajectory_format::ahead_us;

/// How long knots are kept after the path time has passed them, µs: late measurements are compared with them.
pub const KEPT_US: i64 = 200_000;

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// Takes the next segment of the plan that runs; returns the number of knots for which there is room
    /// afterwards. The segment that was taken last is accepted again and changes nothing, so a lost answer does no
    /// harm.
    ///
    /// # Errors
    ///
    /// [`Cause::OrderNotNow`] if nothing runs, [`Cause::OtherHost`], [`Cause::SegmentOther`],
    /// [`Cause::SegmentEarly`], and the causes about a trajectory file.
    pub fn extend(&mut self, now: Instant, peer: Peer, bytes: &[u8]) -> Result<usize, Refusal> {
        self.now = now;
        self.require_session(now, peer)?;
        let State::Running { parking: None, .. } = *self.machine.state() else {
            return Err(Refusal::of(Cause::OrderNotNow));
        };
        let digest = sha256(bytes);
        let spline = self.spline.borrow_mut();
        if self.last_segment != Some(digest) {
            if self.next_segment != Some(digest) {
                return Err(Refusal::of(Cause::SegmentOther));
            }
            self.next_segment = segment::append(bytes, &self.settings, spline)?;
            self.last_segment = Some(digest);
        }
        Ok(spline.room())
    }

    /// Forgets the knots that are past. True if a segment is missing that a stop along the path could need from now on.
    pub(super) fn runs_dry(&mut self, s_us: i64) -> bool {
        if self.next_segment.is_none() {
            return false;
        }
        let spline = self.spline.borrow_mut();
        spline.forget_before(s_us.saturating_sub(KEPT_US));
        spline.end_us().saturating_sub(s_us) < ahead_us(&self.settings)
    }
}
