//! Who may order what: sessions, codes, the key, and limits beyond those of the robot.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant};

use super::{Controller, Unlock};
use crate::authority::{Code, Digest, Key, Nonce, Peer, Source, Verdict};
use crate::fault::{Cause, Refusal};
use crate::group::DriveGroup;
use crate::orders::{Done, Order, OrderKind, UNLOCK_VALID_MAX};
use crate::registers;
use crate::spline::Spline;
use crate::state::{State, StateKind};
use crate::store::{self, Storage};
use crate::trace::TraceEvent;

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// Lets an order through if its node, its time and its code allow it, and carries it out.
    pub(super) fn admit(
        &mut self,
        now: Instant,
        source: &Source<'_>,
        order: &Order,
    ) -> Result<Done, Refusal> {
        let kind = order.kind();
        if !kind.is_free() {
            self.require_session(now, source.peer)?;
        }
        if !kind.is_legal_in(self.kind()) {
            return Err(Refusal::of(Cause::OrderNotNow));
        }
        // The code of a jog was checked when it began; its repetitions need no code.
        let goes_on = kind == OrderKind::Jog && self.kind() == StateKind::Jogging;
        let needs_code = kind.needs_code() && !goes_on && self.keyring.is_keyed();
        if needs_code {
            let about = self.digest_for(order)?;
            let verdict = self.keyring.judge(now, source.peer, source.content, about)?;
            if let Verdict::Repeat(outcome) = verdict {
                return outcome;
            }
        }
        let before = self.session;
        if !kind.is_free() {
            self.session.enter(source.peer);
        }
        let outcome = self.take_order(now, source.peer, *order);
        if outcome.is_err() {
            // The host stays the host.
            self.session = before;
        }
        if needs_code {
            self.keyring.close(now, source.peer, outcome);
        }
        outcome
    }

    /// Digest of what an order refers to and others can change: of the file, or of the file and the settings of its run.
    fn digest_for(&self, order: &Order) -> Result<Option<Digest>, Refusal> {
        match order {
            Order::Commit(name) => self.store.sha256_of(*name).map(Some),
            Order::ArmConfirm { .. } => {
                let committed = self.store.committed().ok_or(Refusal::of(Cause::NoTrajectory))?;
                Ok(Some(registers::run_digest(&committed.sha256, &self.settings)))
            }
            _ => Ok(None),
        }
    }

    /// No other node holds the session.
    pub(super) fn require_session(&self, now: Instant, peer: Peer) -> Result<(), Refusal> {
        let engaged = self.kind().may_move() || self.kind() == StateKind::Armed;
        let held = engaged || self.offer.is_some_and(|offer| offer.until > now);
        if held && self.session.host().is_some_and(|host| host != peer) {
            return Err(Refusal::of(Cause::OtherHost));
        }
        Ok(())
    }

    /// Nothing moves and nothing is armed.
    pub(super) fn is_disengaged(&self) -> bool {
        !self.kind().may_move() && self.kind() != StateKind::Armed
    }

    /// The node whose orders move the group, if there is one.
    pub fn host(&self) -> Option<Peer> {
        self.session.host()
    }

    /// True if orders that can move the arm need a code.
    pub const fn is_keyed(&self) -> bool {
        self.keyring.is_keyed()
    }

    /// Time left in which limits may be wider than those of the robot; zero if they may not.
    pub fn unlock_left(&self, now: Instant) -> Duration {
        self.unlock.map_or(Duration::ZERO, |unlock| unlock.until.saturating_since(now))
    }

    /// True while limits may be, or still are, wider than those of the robot.
    pub const fn is_unlocked(&self) -> bool {
        self.unlock.is_some()
    }

    pub(super) fn is_unlocked_by(&self, now: Instant, peer: Peer) -> bool {
        self.unlock.is_some_and(|unlock| unlock.peer == peer && unlock.until > now)
    }

    pub(super) fn order_challenge(&mut self, now: Instant, peer: Peer) -> Result<Done, Refusal> {
        if !self.keyring.is_keyed() {
            return Err(Refusal::of(Cause::NoKey));
        }
        let nonce = self.tokens.next_bytes();
        self.keyring.challenge(now, peer, nonce);
        Ok(Done::Challenge(nonce))
    }

    pub(super) fn order_authorize(
        &mut self,
        now: Instant,
        peer: Peer,
        nonce: Nonce,
        code: Code,
    ) -> Result<(), Refusal> {
        if !self.keyring.is_keyed() {
            return Err(Refusal::of(Cause::NoKey));
        }
        self.keyring.authorize(now, peer, nonce, code)
    }

    pub(super) fn order_unlock(
        &mut self,
        now: Instant,
        peer: Peer,
        robot_crc32: u32,
        valid: Duration,
    ) -> Result<(), Refusal> {
        if robot_crc32 != self.ceiling.limits_robot_crc32 {
            return Err(Refusal::of(Cause::WrongRobot));
        }
        if valid > UNLOCK_VALID_MAX {
            return Err(Refusal::of(Cause::BadValue));
        }
        self.offer = None;
        if valid.is_zero() {
            self.lock_limits(now);
        } else {
            self.unlock = Some(Unlock { peer, until: now + valid });
            self.note(now, TraceEvent::Unlocked(peer));
        }
        Ok(())
    }

    /// The limits of the robot hold again. Only called while nothing moves.
    pub(super) fn lock_limits(&mut self, now: Instant) {
        self.unlock = None;
        if registers::narrow(&mut self.settings, &self.ceiling) {
            self.store.void_commit();
            self.offer = None;
            if self.kind() == StateKind::Armed {
                self.enter_standing(now, State::Ready);
            }
        }
        self.note(now, TraceEvent::LimitsPutBack);
    }

    /// Sets the key of the controller, or removes it; the change is stored at once. A controller that has a key
    /// requires a code made with the old key.
    ///
    /// # Errors
    ///
    /// [`Cause::OrderNotNow`] while anything is armed or moves, [`Cause::OtherHost`], a cause about the code,
    /// [`Cause::StorageFailed`].
    pub fn set_key(&mut self, now: Instant, source: Source<'_>, key: Option<Key>) -> Result<(), Refusal> {
        self.now = now;
        self.require_session(now, source.peer)?;
        if !self.is_disengaged() {
            return Err(Refusal::of(Cause::OrderNotNow));
        }
        if let Verdict::Repeat(outcome) = self.keyring.judge(now, source.peer, source.content, None)? {
            return outcome.map(drop);
        }
        store::save_key(&mut self.storage, key.as_ref())?;
        self.offer = None;
        self.note(now, TraceEvent::Key(key.is_some()));
        self.keyring.set(key);
        Ok(())
    }
}
