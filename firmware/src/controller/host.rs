//! Calls for a host: orders, stop, heartbeat, registers, upload.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant};

use super::Controller;
use crate::authority::{Peer, Source, Verdict};
use crate::fault::{Cause, Fault, Reaction, Refusal};
use crate::group::{Command, DriveGroup};
use crate::orders::{Done, Order, OrderKind};
use crate::registers::{self, Number, Numbers, RegisterInfo, Writable};
use crate::rest::HALT_REST_MAX;
use crate::spline::Spline;
use crate::state::{State, StateKind};
use crate::store::{self, Storage};
use crate::trace::TraceEvent;

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// Takes an order.
    ///
    /// # Errors
    ///
    /// Why the order was refused; it has changed nothing.
    pub fn order<'a>(
        &mut self,
        now: Instant,
        source: impl Into<Source<'a>>,
        order: Order,
    ) -> Result<Done, Refusal> {
        self.now = now;
        let kind = order.kind();
        let outcome = self.admit(now, &source.into(), &order);
        match outcome {
            // A jog is repeated many times a second; a challenge or a code belongs to the order that follows. They are not
            // traced.
            Ok(_) if matches!(kind, OrderKind::Jog | OrderKind::Challenge | OrderKind::Authorize) => {}
            // New end states come a hundred times a second, and each is answered: only the first of a run is traced.
            Ok(_) if kind == OrderKind::Retarget && self.targets_taken > 1 => {}
            Err(_) if kind == OrderKind::Retarget && self.targets_taken > 0 => {}
            Ok(_) => self.note(now, TraceEvent::Order(kind)),
            Err(refusal) => self.note(now, TraceEvent::Refused(kind, refusal.cause)),
        }
        self.group.flush(now, &self.settings);
        outcome
    }

    pub(super) fn take_order(&mut self, now: Instant, peer: Peer, order: Order) -> Result<Done, Refusal> {
        match order {
            Order::ArmPrepare { crc64, valid } => return self.order_prepare(now, crc64, valid),
            Order::ArmConfirm { token, valid } => return self.order_confirm(now, token, valid),
            Order::Run(name) => return self.order_run(now, name, None),
            Order::RunAt { name, start } => return self.order_run(now, name, Some(start)),
            Order::Retarget(target) => return self.order_retarget(now, &target),
            Order::Disarm => {
                self.offer = None;
                if matches!(self.machine.state(), State::Armed { .. }) {
                    self.enter_standing(now, State::Ready);
                }
            }
            Order::Stop => self.fail(now, Fault::group(Cause::StopOrdered)),
            Order::ClearFault { code } => self.order_clear(now, code)?,
            Order::Home { mask } => self.order_home(now, mask)?,
            Order::Jog { joint, qd_rad_s, hold } => self.order_jog(now, joint, qd_rad_s, hold)?,
            Order::Commit(name) => {
                self.offer = None;
                self.store.require_upload_of(peer)?;
                self.store.commit(&mut self.storage, name, &self.settings, self.spline.borrow_mut())?;
            }
            Order::Gripper { open } => self.set_gripper(now, open),
            Order::SaveSettings => store::save_settings(&mut self.storage, &self.settings)?,
            Order::Challenge => return self.order_challenge(now, peer),
            Order::Authorize { nonce, code } => self.order_authorize(now, peer, nonce, code)?,
            Order::Unlock { robot_crc32, valid } => self.order_unlock(now, peer, robot_crc32, valid)?,
        }
        Ok(Done::Taken)
    }

    fn order_clear(&mut self, now: Instant, code: u16) -> Result<(), Refusal> {
        let State::Fault { fault } = *self.machine.state() else { return Ok(()) };
        if fault.cause.code() != code {
            return Err(Refusal { cause: Cause::OtherFault, joint: fault.joint, index: fault.cause.code() });
        }
        // A reset ends the halt of the drives. A drive that does not answer cannot be measured at rest, but it has had the time
        // to stop.
        let had_time = self.halt_due + HALT_REST_MAX <= now;
        if self.any_moves(now) || !(had_time || self.all_at_rest(now)) {
            return Err(Refusal::of(Cause::StillMoving));
        }
        self.find(now, true);
        Ok(())
    }

    /// A stop message: the halt broadcast is the next frame out, whatever the state.
    pub fn stop_now(&mut self, now: Instant) {
        self.now = now;
        self.offer = None;
        let fault = Fault::group(Cause::StopMessage);
        match self.kind() {
            // The halt is repeated, because the node asks again.
            StateKind::Stopped | StateKind::Fault => {
                self.halt(now);
                self.group.command(now, &self.settings, Command::Stand { armed: false });
            }
            _ => self.react(now, fault, Reaction::Halt),
        }
    }

    /// Sign of life of a node. Only the host's heartbeat keeps a motion alive.
    pub fn host_heartbeat(&mut self, now: Instant, peer: Peer) {
        self.session.hear(now, peer);
    }

    /// A node has started again. If it is the host, its session ends: an offer and an arming become void, and a motion stops.
    pub fn host_restarted(&mut self, now: Instant, peer: Peer) {
        self.now = now;
        if self.session.host() != Some(peer) {
            return;
        }
        self.session.forget_host();
        self.offer = None;
        match self.kind() {
            StateKind::Armed => self.enter_standing(now, State::Ready),
            StateKind::Homing | StateKind::Jogging | StateKind::Running => {
                self.fail(now, Fault::group(Cause::HostLost));
            }
            _ => {}
        }
        self.group.flush(now, &self.settings);
    }

    /// Name of what is in the upload bank so far.
    pub fn uploaded(&self) -> Option<store::FileName> {
        self.store.uploaded()
    }

    /// A frame that takes bus time but is not for the drives or from them.
    pub(crate) const fn count_foreign(&mut self, bits: u32) {
        self.foreign_bits = self.foreign_bits.wrapping_add(bits);
    }

    /// Numbers of register number `index` of [`registers::all`]; `None` if there is no such register.
    pub fn register(&self, index: usize) -> Option<Numbers> {
        registers::read(&self.settings, index)
    }

    /// [`Self::register`], by name.
    pub fn register_named(&self, name: &str) -> Option<Numbers> {
        self.register(registers::find(&self.settings, name)?)
    }

    /// [`Self::write_register_at`], by name.
    ///
    /// # Errors
    ///
    /// As [`Self::write_register_at`]; [`Cause::BadValue`] for an unknown name.
    pub fn write_register<'a>(
        &mut self,
        now: Instant,
        source: impl Into<Source<'a>>,
        name: &str,
        numbers: &[Number],
    ) -> Result<(), Refusal> {
        let index = registers::find(&self.settings, name).ok_or(Refusal::of(Cause::BadValue))?;
        self.write_register_at(now, source, index, numbers)
    }

    /// Writes a register: all of its numbers, or nothing.
    ///
    /// A register that shapes motion can change only while nothing moves and nothing is armed; the change voids an
    /// offer to arm. Its [row](RegisterInfo) lists what else a change needs and voids.
    ///
    /// # Errors
    ///
    /// As [`registers::write`]; [`Cause::OrderNotNow`] while the register must not change, [`Cause::StillMoving`]
    /// while a joint moves and the register needs a new search, [`Cause::OtherHost`] while another node holds the
    /// session, [`Cause::LimitCeiling`] if the unlock is needed, or a cause about the code.
    pub fn write_register_at<'a>(
        &mut self,
        now: Instant,
        source: impl Into<Source<'a>>,
        index: usize,
        numbers: &[Number],
    ) -> Result<(), Refusal> {
        self.now = now;
        let outcome = self.take_register(now, &source.into(), index, numbers);
        if let Err(refusal) = outcome {
            let index = u8::try_from(index).unwrap_or(u8::MAX);
            self.note(now, TraceEvent::RegisterRefused(index, refusal.cause));
        }
        outcome
    }

    fn take_register(
        &mut self,
        now: Instant,
        source: &Source<'_>,
        index: usize,
        numbers: &[Number],
    ) -> Result<(), Refusal> {
        let unknown = Refusal::of(Cause::BadValue);
        let info = registers::info(&self.settings, index).ok_or(unknown)?;
        if info.writable == Writable::Never {
            return Err(Refusal::of(Cause::OrderNotNow));
        }
        self.require_session(now, source.peer)?;
        if info.shapes_motion() && !self.is_disengaged() {
            return Err(Refusal::of(Cause::OrderNotNow));
        }
        if info.writable == Writable::NextStart {
            // This write begins a search, which ends the halt of the drives. A fault must end only by the order to clear it.
            if matches!(self.kind(), StateKind::Fault | StateKind::Stopped) {
                return Err(Refusal::of(Cause::OrderNotNow));
            }
            if self.any_moves(now) {
                return Err(Refusal::of(Cause::StillMoving));
            }
        }
        if info.shapes_motion()
            && let Verdict::Repeat(outcome) = self.keyring.judge(now, source.peer, source.content, None)?
        {
            return outcome.map(drop);
        }
        let outcome = self.change_register(now, source.peer, index, info, numbers);
        if info.shapes_motion() {
            self.keyring.close(now, source.peer, outcome.map(|()| Done::Taken));
        }
        outcome
    }

    fn change_register(
        &mut self,
        now: Instant,
        peer: Peer,
        index: usize,
        info: &RegisterInfo,
        numbers: &[Number],
    ) -> Result<(), Refusal> {
        let old = self.settings;
        registers::write(&mut self.settings, index, numbers)?;
        if self.settings == old {
            return Ok(());
        }
        if !self.is_unlocked_by(now, peer)
            && let Err(refusal) = registers::check_widening(&self.settings, &old, &self.ceiling, index)
        {
            self.settings = old;
            return Err(refusal);
        }
        if info.is_proven {
            self.settings.gains_certificate_crc32 = 0;
        }
        if info.is_limit() {
            self.store.void_commit();
            self.note(now, TraceEvent::LimitsChanged);
        }
        if info.writable == Writable::NextStart {
            // Drives and joints are assigned at start-up: look for them again with the new assignment.
            self.find(now, false);
        }
        if info.shapes_motion() {
            self.offer = None;
        }
        Ok(())
    }

    /// Takes a piece of a trajectory file into the inactive bank.
    ///
    /// # Errors
    ///
    /// As [`store::TrajectoryStore::write`], for example [`Cause::UploadOfOther`]; [`Cause::BankBusy`] while armed, moving, or
    /// offered to another node.
    pub fn upload(&mut self, now: Instant, peer: Peer, offset: usize, data: &[u8]) -> Result<(), Refusal> {
        self.now = now;
        if self.kind().may_move()
            || self.kind() == StateKind::Armed
            || self.require_session(now, peer).is_err()
        {
            return Err(Refusal::of(Cause::BankBusy));
        }
        self.offer = None;
        let outcome = self.store.write(&mut self.storage, peer, offset, data);
        if outcome.is_err_and(|refusal| refusal.cause == Cause::UploadOfOther) {
            self.note(now, TraceEvent::UploadVoided(peer));
        }
        outcome
    }

    /// Reads the trajectory file back; returns the bytes filled.
    ///
    /// # Errors
    ///
    /// [`Cause::StorageFailed`].
    pub fn download(&self, offset: usize, out: &mut [u8]) -> Result<usize, Refusal> {
        self.store.read(&self.storage, offset, out)
    }

    /// Time left of an arming or an offer.
    pub(super) fn arming_left(&self, now: Instant) -> Duration {
        let until = match (self.machine.state(), self.offer) {
            (State::Armed { until, .. }, _) => *until,
            (_, Some(offer)) => offer.until,
            _ => now,
        };
        until.saturating_since(now)
    }
}
