//! Samples for a host.

use core::borrow::BorrowMut;

use protocol::powercube::CubeState;
use protocol::{Duration, Instant, JointIndex};

use super::Controller;
use crate::groups::powercube::drive_model::DriveModel;
use crate::spline::Spline;
use crate::state::{State, StateKind};
use crate::store::Storage;
use crate::telemetry::{GroupSample, JointFlags, JointSample};

impl<S: Storage, M: BorrowMut<Spline>> Controller<S, M> {
    /// True once per telemetry period; ask after each `handle_*` call.
    pub fn take_telemetry_due(&mut self, now: Instant) -> bool {
        let due = self.telemetry_due <= now;
        if due {
            self.telemetry_due = now + Duration::from_micros(self.settings.telemetry_period_us.into());
        }
        due
    }

    /// What a drive should have done with its commands by now, and how far its last answer was from it.
    pub const fn drive_model(&self, joint: JointIndex) -> &DriveModel {
        &self.track.at(joint).model
    }

    /// Counts since start-up.
    pub const fn counters(&self) -> &crate::telemetry::Counters {
        &self.counters
    }

    /// True in a control cycle and in its rehearsal: the bus is for the drives until they have answered.
    pub fn is_keeping_time(&self) -> bool {
        matches!(self.kind(), StateKind::Running | StateKind::Stopping) || self.pace.is_rehearsing()
    }

    /// True if every drive has answered in this cycle: what is left of it is free for others.
    pub fn is_cycle_done(&self) -> bool {
        self.joints().all(|joint| self.schedule.is_done(joint, self.drives.at(joint)))
    }

    /// The group now; the jitter counts anew from here.
    pub fn take_sample(&mut self, now: Instant) -> GroupSample {
        let jitter = core::mem::take(&mut self.jitter);
        let homed_mask = self
            .joints()
            .filter(|&joint| self.drive_is_homed(joint))
            .fold(0, |mask: u8, joint| mask | 1 << joint.get());
        let path_us = match *self.machine.state() {
            State::Running { clock, .. } | State::Stopping { clock, .. } => clock.at(now).0,
            _ => 0,
        };
        GroupSample {
            at: now,
            state: self.kind(),
            fault: self.machine.state().fault(),
            homed_mask,
            uploaded: self.store.uploaded(),
            committed: self.store.committed().map(|committed| committed.name),
            host_alive: self.host_is_alive(now),
            gripper_open: self.gripper.is_open(),
            limits_unlocked: self.is_unlocked(),
            keyed: self.is_keyed(),
            cycle: self.settings.cycle_period(),
            jitter,
            counters: self.counters,
            bus_bits: self.bus_bits,
            path_us: u32::try_from(path_us.max(0)).unwrap_or(u32::MAX),
            arming_left: self.arming_left(now),
        }
    }

    /// One joint as of its last measurement.
    pub fn joint_sample(&self, joint: JointIndex) -> JointSample {
        let (drive, track) = (self.drives.at(joint), self.track.at(joint));
        let state = drive.state.map_or(CubeState::EMPTY, |(state, _)| state);
        let tracking = matches!(self.kind(), StateKind::Running | StateKind::Stopping);
        let flags = [
            (track.missed, JointFlags::REPLY_MISSED),
            (state.contains(CubeState::HOME_OK), JointFlags::HOMED),
            (state.intersects(CubeState::ERROR), JointFlags::DRIVE_ERROR),
            (state.intersects(CubeState::HALTED), JointFlags::HALTED),
            (tracking && track.saturated, JointFlags::ACCELERATION_CLIPPED),
            (tracking && track.command.speed_limited, JointFlags::SPEED_LIMITED),
            (tracking && track.command.position_limited, JointFlags::POSITION_LIMITED),
        ];
        let mut sample = JointSample {
            q_rad: drive.position.map_or(0.0, |position| position.q_rad),
            current_a: drive.current_a.unwrap_or(f32::NAN),
            drive_short_state: drive.short_state.bits(),
            flags: flags
                .into_iter()
                .filter(|(on, _)| *on)
                .fold(JointFlags::NONE, |all, (_, flag)| all.with(flag)),
            ..JointSample::default()
        };
        if tracking {
            sample.qd_rad_s = track.reference.qd_rad_s + track.estimator.de_rad_s();
            sample.error_q_rad = -track.estimator.e_rad();
            sample.error_qd_rad_s = -track.estimator.de_rad_s();
            sample.qdd_command_rad_s2 = track.command.qdd_rad_s2;
        }
        sample
    }
}
