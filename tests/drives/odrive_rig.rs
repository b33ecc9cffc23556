//! Six axes of ODrives and the controller.

use firmware::groups::odrive::{Axis, Endpoints, Home, Odrive, Options};
use firmware::settings::Settings;
use hil_sim::drive::odrive::{OdriveAxis, OdriveOptions};
use protocol::odrive::{NodeId, Order, Version};
use protocol::{Duration, Instant};

use crate::six::{JOINTS, Six, settings_at, stands_rad};

pub(crate) const PERIOD_US: u64 = 3_000;
pub(crate) const TIME_OUT_US: u32 = 50_000;
pub(crate) const GEAR: f32 = 8.0;
/// Of the rig alone: each firmware has its own numbers.
const NUMBERS: [u16; 7] = [210, 211, 212, 300, 301, 402, 403];

pub(crate) type Rig = Six<Odrive, OdriveAxis>;

pub(crate) fn node(index: usize) -> NodeId {
    NodeId::new(index as u8 + 9).unwrap()
}

pub(crate) fn settings() -> Settings {
    settings_at(PERIOD_US, TIME_OUT_US)
}

pub(crate) fn endpoints() -> Endpoints {
    Endpoints { firmware: [0, 6, 10], numbers: NUMBERS }
}

/// What the robot file would say of a joint.
pub(crate) fn axis(index: usize, version: Version, home: Home) -> Axis {
    Axis {
        node: node(index),
        version,
        gear: GEAR,
        home,
        current_max_a: 40.0,
        position_gain_1_s: 30.0,
        // With 0.2 kg m2 behind the gear: 100 rad/s of the velocity loop.
        velocity_gain_nm_s: if home == Home::Joint { 16.0 } else { 2.0 },
        integral_gain_nm: 0.0,
    }
}

impl Rig {
    pub(crate) fn with(
        settings: &Settings,
        version: Version,
        home: Home,
        endpoints: Option<Endpoints>,
        change: impl Fn(usize, &mut OdriveOptions),
    ) -> Self {
        Self::of_axes(settings, core::array::from_fn(|i| axis(i, version, home)), endpoints, change)
    }

    pub(crate) fn of_axes(
        settings: &Settings,
        axes: [Axis; JOINTS],
        endpoints: Option<Endpoints>,
        change: impl Fn(usize, &mut OdriveOptions),
    ) -> Self {
        let options = Options::new(&axes).unwrap();
        let options = match endpoints {
            Some(endpoints) => options.with_endpoints(endpoints),
            None => options,
        };
        let motor = |i| {
            let Axis { version, home, gear, .. } = axes[i];
            let mut options = OdriveOptions {
                gear: gear.into(),
                counted: if home == Home::Joint { 1.0 } else { gear.into() },
                watchdog: Some(Duration::from_micros(TIME_OUT_US.into())),
                estimates: None,
                endpoints: Some(NUMBERS),
                ..OdriveOptions::new(node(i), version)
            };
            change(i, &mut options);
            OdriveAxis::new(options, stands_rad(i))
        };
        Self::six(settings, Odrive::new(options), (0..JOINTS).map(motor).collect(), OdriveAxis::shaft_rad)
    }

    pub(crate) fn new() -> Self {
        Self::with(&settings(), Version::V06, Home::Joint, None, |_, _| {})
    }

    pub(crate) fn ready() -> Self {
        Self::new().made_ready(1_500)
    }

    pub(crate) fn moving() -> Self {
        Self::ready().moved_on()
    }

    /// Orders to an axis since `from`, with the time at which the frame ended.
    pub(crate) fn orders(&self, index: usize, from: Instant) -> Vec<(Instant, Order)> {
        let order = |frame: &protocol::Frame| {
            Order::decode(frame, Version::V06).filter(|(to, _)| *to == node(index)).map(|(_, order)| order)
        };
        let frames = self.frames(from, |frame| order(frame).is_some()).into_iter();
        frames.filter_map(|(at, frame)| Some((at, order(&frame)?))).collect()
    }
}
