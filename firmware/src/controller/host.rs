//! Doors for a host: orders, stop, heartbeat, registers, upload.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant};

use super::Controller;
use crate::fault::{Cause, Fault, Reaction, Refusal};
use crate::orders::{Done, Order, OrderKind};
use crate::registers::{self, Number, Numbers, Writable};
use crate::spline::Spline;
use crate::state::{State, StateKind};
use crate::store::{self, Storage};
use crate::trace::Event;

impl<S: Storage, M: BorrowMut<Spline>> Controller<S, M> {
    /// Takes an order.
    ///
    /// # Errors
    ///
    /// Why it was refused; nothing has changed then.
    pub fn order(&mut self, now: Instant, order: Order) -> Result<Done, Refusal> {
        self.now = now;
        let kind = order.kind();
        let outcome = if kind.is_legal_in(self.kind()) {
            self.take_order(now, order)
        } else {
            Err(Refusal::of(Cause::OrderNotNow))
        };
        match outcome {
            // A jog comes many times a second.
            Ok(_) if kind == OrderKind::Jog => {}
            Ok(_) => self.note(now, Event::Order(kind)),
            Err(refusal) => self.note(now, Event::Refused(kind, refusal.cause)),
        }
        self.pump(now);
        outcome
    }

    fn take_order(&mut self, now: Instant, order: Order) -> Result<Done, Refusal> {
        match order {
            Order::ArmPrepare { crc64, valid } => return self.order_prepare(now, crc64, valid),
            Order::ArmConfirm { token, valid } => return self.order_confirm(now, token, valid),
            Order::Run(name) => return self.order_run(now, name),
            Order::Disarm => {
                self.offer = None;
                if matches!(self.machine.state(), State::Armed { .. }) {
                    self.machine.transition_to_ready(now, &mut self.trace);
                }
            }
            Order::Stop => self.fail(now, Fault::group(Cause::StopOrdered)),
            Order::ClearFault { code } => self.order_clear(now, code)?,
            Order::Home { mask } => self.order_home(now, mask)?,
            Order::Jog { joint, qd_rad_s, hold } => self.order_jog(now, joint, qd_rad_s, hold)?,
            Order::Commit(name) => {
                self.offer = None;
                self.store.commit(&mut self.storage, name, &self.settings, self.spline.borrow_mut())?;
            }
            Order::Gripper { open } => self.set_gripper(now, open),
            Order::SaveSettings => store::save_settings(&mut self.storage, &self.settings)?,
        }
        Ok(Done::Taken)
    }

    fn order_clear(&mut self, now: Instant, code: u16) -> Result<(), Refusal> {
        let State::Fault { fault } = *self.machine.state() else { return Ok(()) };
        if fault.cause.code() != code {
            return Err(Refusal { cause: Cause::OtherFault, joint: fault.joint, index: fault.cause.code() });
        }
        if self.any_moves(now) {
            return Err(Refusal::of(Cause::StillMoving));
        }
        self.freeze = None;
        self.start_boot(now, true);
        Ok(())
    }

    /// A stop message: the halt broadcast is the next frame out, whatever the state.
    pub fn stop_now(&mut self, now: Instant) {
        self.now = now;
        let fault = Fault::group(Cause::StopMessage);
        match self.kind() {
            // Said again, because somebody asks again.
            StateKind::Stopped | StateKind::Fault => {
                self.transmit.halt();
                self.counters.halts = self.counters.halts.saturating_add(1);
            }
            _ => self.react(now, fault, Reaction::Halt),
        }
    }

    /// Sign of life of the host that gives orders.
    pub const fn host_heartbeat(&mut self, now: Instant) {
        self.host_seen = Some(now);
    }

    /// When the host's last sign of life came.
    pub(crate) const fn host_heartbeat_at(&self) -> Option<Instant> {
        self.host_seen
    }

    /// Puts back what [`Self::host_heartbeat_at`] said.
    pub(crate) const fn set_host_heartbeat_at(&mut self, at: Option<Instant>) {
        self.host_seen = at;
    }

    /// Name of what is in the upload bank so far.
    pub fn uploaded(&self) -> Option<store::FileName> {
        self.store.uploaded()
    }

    /// A frame that takes bus time but is not for the drives or from them.
    pub(crate) const fn count_foreign(&mut self, frame: &protocol::Frame) {
        self.count_bits(frame);
    }

    /// Numbers of register number `index` ([`registers::TABLE`]); `None` if there is none.
    pub fn register(&self, index: usize) -> Option<Numbers> {
        registers::read(&self.settings, index)
    }

    /// [`Self::write_register_at`], by name.
    ///
    /// # Errors
    ///
    /// As [`Self::write_register_at`]; [`Cause::BadValue`] for an unknown name.
    pub fn write_register(&mut self, now: Instant, name: &str, numbers: &[Number]) -> Result<(), Refusal> {
        let index = registers::find(name).ok_or(Refusal::of(Cause::BadValue))?;
        self.write_register_at(now, index, numbers)
    }

    /// Writes a register: all numbers or none. Gains take over without a bump, also during a motion.
    ///
    /// # Errors
    ///
    /// As [`registers::write`]; [`Cause::OrderNotNow`] while the register must not change; [`Cause::GainPeriod`] for gains
    /// of another period during a motion.
    pub fn write_register_at(
        &mut self,
        now: Instant,
        index: usize,
        numbers: &[Number],
    ) -> Result<(), Refusal> {
        self.now = now;
        let unknown = Refusal::of(Cause::BadValue);
        let writable = registers::TABLE.get(index).map(|info| info.writable).ok_or(unknown)?;
        let at_rest = matches!(
            self.kind(),
            StateKind::Boot | StateKind::Idle | StateKind::Ready | StateKind::Stopped | StateKind::Fault
        );
        if writable != Writable::Always && !at_rest {
            return Err(Refusal::of(Cause::OrderNotNow));
        }
        let before = registers::read(&self.settings, index).ok_or(unknown)?;
        registers::write(&mut self.settings, index, numbers)?;
        let running = matches!(self.kind(), StateKind::Running | StateKind::Stopping);
        if running && self.settings.gains_period_us != self.settings.cycle_period_us {
            // What was there fits.
            let _ = registers::write(&mut self.settings, index, before.as_slice());
            return Err(Refusal::of(Cause::GainPeriod));
        }
        let blend = if running {
            self.settings.gains_blend_us.checked_div(self.settings.cycle_period_us).unwrap_or(0)
        } else {
            0
        };
        for joint in self.joints() {
            let gains = self.settings.joint.at(joint).gains();
            let track = self.track.at_mut(joint);
            if track.gains.target() != gains {
                track.gains.change(gains, u16::try_from(blend).unwrap_or(u16::MAX));
            }
        }
        if writable == Writable::NextStart && before.as_slice() != numbers {
            // Drives and joints are assigned at start-up: look for them again with the new assignment.
            self.start_boot(now, false);
        }
        Ok(())
    }

    /// Takes a piece of a trajectory file into the inactive bank.
    ///
    /// # Errors
    ///
    /// As [`store::TrajectoryStore::write`]; [`Cause::BankBusy`] while armed or moving.
    pub fn upload(&mut self, now: Instant, offset: usize, data: &[u8]) -> Result<(), Refusal> {
        self.now = now;
        if self.kind().may_move() || self.kind() == StateKind::Armed {
            return Err(Refusal::of(Cause::BankBusy));
        }
        self.offer = None;
        self.store.write(&mut self.storage, offset, data)
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
