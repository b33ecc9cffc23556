//! Six drives of one family on one bus of 1 Mbit/s.

use firmware::group::DriveGroup;
use firmware::orders::Order;
use firmware::settings::Settings;
use firmware::state::StateKind;
use hil_sim::bus::BusConfig;
use hil_sim::drive::bench::{Bench, ShaftMotor};
use protocol::{Frame, Instant, JointIndex};

use crate::arm::Arm;
use crate::rig::{plan_file, quintic};

pub(crate) const JOINTS: usize = 6;
/// At each shaft.
const INERTIA_KG_M2: f64 = 0.2;

/// Where a shaft stands at first, rad.
pub(crate) fn stands_rad(index: usize) -> f64 {
    0.05 * index as f64
}

/// Settings of the arm of PowerCubes, with another period and another time-out, joints that turn by 2 rad.
pub(crate) fn settings_at(period_us: u64, time_out_us: u32) -> Settings {
    let mut settings = Settings::powercube6();
    settings.cycle_period_us = period_us as u32;
    settings.gains_period_us = period_us as u32;
    (settings.gains_delay_min_us, settings.gains_delay_max_us) = (period_us as u32, period_us as u32);
    settings.watchdog_timeout_us = time_out_us;
    settings.watchdog_refresh_us = 10_000;
    for joint in JointIndex::first(JOINTS) {
        let limits = settings.joint.at_mut(joint);
        (limits.q_min_rad, limits.q_max_rad) = (-2.0, 2.0);
    }
    settings.gains_certificate_crc32 = firmware::registers::certificate_crc32(&settings);
    settings
}

pub(crate) type Six<G, M> = Arm<G, M, JOINTS>;

impl<G: DriveGroup<Packet = Frame>, M: ShaftMotor> Six<G, M> {
    pub(crate) fn six(settings: &Settings, group: G, motors: Vec<M>, shaft_rad: fn(&M) -> f64) -> Self {
        Self::of(BusConfig::default(), settings, group, Bench::new(motors, INERTIA_KG_M2), shaft_rad)
    }

    /// Found, and all joints at home.
    pub(crate) fn made_ready(mut self, find_ms: u64) -> Self {
        self.run_to(find_ms, StateKind::Idle);
        self.order(Order::Home { mask: 0x3F });
        self.run_to(1_500, StateKind::Ready);
        self
    }

    /// Starts the plan; when it begins.
    pub(crate) fn start(&mut self) -> Instant {
        self.run_file(&plan_file(JOINTS, self.period.as_micros() as u32, stands_rad));
        self.now() + self.controller().group().profile(self.controller().settings()).lead
    }

    pub(crate) fn moved_on(mut self) -> Self {
        self.start();
        self.in_plan()
    }

    /// Where the plan has a joint, rad.
    pub(crate) fn planned_rad(index: usize, t_s: f64) -> f64 {
        stands_rad(index) + quintic(index, t_s).0
    }

    /// Largest distance of each joint from the plan that began at `start`, rad.
    pub(crate) fn away_rad(&self, start: Instant) -> [f64; JOINTS] {
        self.away_from(start, Self::planned_rad)
    }
}
