//! Parameters of the simulated tracker.

use protocol::{Duration, Instant};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyMotion {
    /// Position at time zero, mm.
    pub position_mm: [f64; 3],
    /// Rotation body to room as a unit quaternion, w first.
    pub rotation_wxyz: [f64; 4],
    /// Constant velocity, mm/s.
    pub velocity_mm_s: [f64; 3],
    /// Amplitude of a sine on top, mm.
    pub swing_mm: [f64; 3],
    /// Period of that sine.
    pub swing_period: Duration,
}

impl BodyMotion {
    /// At rest, axes parallel to the room's.
    #[must_use]
    pub const fn at_rest(position_mm: [f64; 3]) -> Self {
        Self {
            position_mm,
            rotation_wxyz: [1.0, 0.0, 0.0, 0.0],
            velocity_mm_s: [0.0; 3],
            swing_mm: [0.0; 3],
            swing_period: Duration::from_secs(1),
        }
    }
}

/// A body with an arrangement of markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyOptions {
    /// Number, from 0.
    pub id: u32,
    pub motion: BodyMotion,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrackerFaultKind {
    /// The body is not seen at all.
    Lost {
        body: u32,
    },
    /// The body is seen and not recognised: its spheres are listed as single markers.
    Unrecognised {
        body: u32,
    },
    /// The body stands elsewhere.
    Moved {
        body: u32,
        /// By how much, mm.
        by_mm: [f64; 3],
    },
    /// The tracker measures wrongly: all positions are off.
    Bias {
        /// By how much, mm.
        by_mm: [f64; 3],
    },
    /// Reflections are taken for markers.
    FalseMarkers {
        count: u32,
    },
    /// Datagrams are lost on the network.
    FramesLost,
    Delayed {
        by: Duration,
    },
    /// The tracker starts again: the frame counter begins again. Its length does not matter.
    Restart,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerFault {
    pub kind: TrackerFaultKind,
    /// From this time on.
    pub from: Instant,
    /// Until this time (excluded).
    pub until: Instant,
    /// How likely in each frame.
    pub probability: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct TrackerOptions {
    /// Time between two flashes.
    pub period: Duration,
    /// From the flash to the sending of the data.
    pub latency: Duration,
    /// Up to this much is added to the latency.
    pub jitter: Duration,
    /// Standard deviation of positions, mm.
    pub noise_mm: f64,
    /// Standard deviation of rotations about each axis, degrees.
    pub noise_deg: f64,
    pub first_frame: u64,
    /// Unix time at time zero, microseconds; gives `ts` and `ts2`.
    pub unix_us: u64,
    pub send_ts: bool,
    pub send_ts2: bool,
    /// Send the line `3d`.
    pub send_markers: bool,
    /// Every n-th frame goes to the outputs.
    pub divisor: u64,
    /// The measurement runs from the beginning, without a command.
    pub running: bool,
    pub bodies: Vec<BodyOptions>,
    pub faults: Vec<TrackerFault>,
    /// Names of configurations; the first is active.
    pub configurations: Vec<String>,
}

impl Default for TrackerOptions {
    /// 60 Hz, 15 ms and up to 1 ms of latency, 0.1 mm and 0.05 deg of noise, no bodies.
    fn default() -> Self {
        Self {
            period: Duration::from_micros(16_667),
            latency: Duration::from_millis(15),
            jitter: Duration::from_millis(1),
            noise_mm: 0.1,
            noise_deg: 0.05,
            first_frame: 1,
            unix_us: 1_795_219_200_000_000,
            send_ts: true,
            send_ts2: true,
            send_markers: true,
            divisor: 1,
            running: false,
            bodies: Vec::new(),
            faults: Vec::new(),
            configurations: vec!["standard".to_owned()],
        }
    }
}
