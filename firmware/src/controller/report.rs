//! Samples for a host.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant, JointIndex};

use super::Controller;
use crate::fault::{Cause, Fault};
use crate::group::{DriveGroup, GroupCounters};
use crate::spline::Spline;
use crate::state::{State, StateKind};
use crate::store::Storage;
use crate::telemetry::{Counters, GroupSample, JointFlags, JointSample};

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// True once per telemetry period; ask after each `handle_*` call.
    pub fn take_telemetry_due(&mut self, now: Instant) -> bool {
        let due = self.telemetry_due <= now;
        if due {
            self.telemetry_due = now + Duration::from_micros(self.settings.telemetry_period_us.into());
        }
        due
    }

    /// Counts since start-up.
    pub fn counters(&self) -> Counters {
        let GroupCounters { motions, foreign, .. } = self.group.counters();
        Counters { motions, foreign_requests: foreign, ..self.counters }
    }

    /// New end states taken in this run or the last one.
    pub const fn targets_taken(&self) -> u16 {
        self.targets_taken
    }

    /// Control steps since start-up.
    pub const fn cycles(&self) -> u32 {
        self.counters.cycles
    }

    /// True while an answer of a drive is missing in this cycle. Other frames must wait then.
    pub fn needs_wire(&self) -> bool {
        self.group.needs_wire(&self.settings)
    }

    /// State of the group at `now`; the jitter is measured anew from here.
    pub fn take_sample(&mut self, now: Instant) -> GroupSample {
        let jitter = core::mem::take(&mut self.jitter);
        let homed_mask = self
            .joints()
            .filter(|&joint| self.group.is_homed(joint))
            .fold(0, |mask: u8, joint| mask | 1 << joint.get());
        let path_us = match *self.machine.state() {
            State::Running { clock, .. } | State::Stopping { clock, .. } => clock.at(now).0,
            _ => 0,
        };
        let fault = self.machine.state().fault();
        let differs = self.group.difference().filter(|&(joint, _)| {
            fault == Some(Fault { cause: Cause::DriveSettingsDiffer, joint: Some(joint) })
        });
        GroupSample {
            at: now,
            state: self.kind(),
            fault,
            homed_mask,
            uploaded: self.store.uploaded(),
            committed: self.store.committed().map(|committed| committed.name),
            host_alive: self.host_is_alive(now),
            gripper_open: self.gripper.is_open(),
            limits_unlocked: self.is_unlocked(),
            keyed: self.is_keyed(),
            cycle: self.settings.cycle_period(),
            jitter,
            counters: self.counters(),
            bus_bits: self.group.counters().bits.wrapping_add(self.foreign_bits),
            path_us: path_us.max(0) as u32,
            arming_left: self.arming_left(now),
            start_left: self.start_left(now),
            targets_taken: self.targets_taken,
            differs: differs.map(|(_, what)| what).unwrap_or_default(),
        }
    }

    /// One joint as of its last measurement.
    pub fn joint_sample(&self, joint: JointIndex) -> JointSample {
        let (tracker, readings) = (self.trackers.at(joint), self.group.readings(joint));
        let tracking = matches!(self.kind(), StateKind::Running | StateKind::Stopping);
        let flags = [
            (tracker.is_missed(), JointFlags::REPLY_MISSED),
            (self.group.is_homed(joint), JointFlags::HOMED),
            (readings.error, JointFlags::DRIVE_ERROR),
            (readings.halted, JointFlags::HALTED),
            (tracking && tracker.is_saturated(), JointFlags::ACCELERATION_CLIPPED),
            (tracking && readings.speed_limited, JointFlags::SPEED_LIMITED),
            (tracking && readings.position_limited, JointFlags::POSITION_LIMITED),
        ];
        let mut sample = JointSample {
            q_rad: self.group.position(joint).map_or(0.0, |position| position.q_rad),
            current_a: readings.current_a.unwrap_or(f32::NAN),
            drive_state_byte: readings.short_state,
            flags: flags
                .into_iter()
                .filter(|(on, _)| *on)
                .fold(JointFlags::NONE, |all, (_, flag)| all.with(flag)),
            ..JointSample::default()
        };
        if tracking {
            sample.qd_rad_s = tracker.qd_rad_s();
            sample.error_q_rad = -tracker.error().e_rad();
            sample.error_qd_rad_s = -tracker.error().de_rad_s();
            sample.qdd_command_rad_s2 = readings.qdd_command_rad_s2;
        }
        sample
    }
}
