//! Parameters of the simulated controller.

use protocol::Duration;
use rsi_protocol::Generation;

use crate::mechanics::GripperOptions;

/// Which quantity a correction changes, and in which frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Space {
    /// Axes, degrees.
    Axes,
    /// Pose of the tool in the base frame, mm and degrees.
    Base,
    /// Pose of the tool in its own frame at the start, mm and degrees.
    Tool,
}

impl Space {
    /// As scenarios spell it.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Axes => "axes",
            Self::Base => "base",
            Self::Tool => "tool",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectionOptions {
    pub space: Space,
    /// `false`: a value is the offset from the start pose. `true`: a value is added in every cycle.
    pub relative: bool,
    /// Lower limits of the correction object, from the start pose; a smaller offset is clamped silently.
    pub lower: [f64; 6],
    pub upper: [f64; 6],
    /// Overall limit: a larger offset of an axis is a fault, degrees.
    pub overall_axis_deg: f64,
    /// Overall limit of a position, mm.
    pub overall_mm: f64,
    /// Overall limit of an orientation, degrees.
    pub overall_rotation_deg: f64,
}

/// When late answers stop the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LateOptions {
    /// More late answers than this stop the robot.
    pub limit: u64,
    /// Count late answers in a row instead of all.
    pub consecutive: bool,
    /// Warn when more than this share of the last `field_of_view` answers is late, percent.
    pub percent: f64,
    /// Length of that window, cycles.
    pub field_of_view: usize,
    /// Over `percent` the robot stops.
    pub percent_stops: bool,
}

/// How actual axes follow set points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LagOptions {
    /// Pure delay; at least one cycle, because set points are joined by straight lines.
    pub dead_time: Duration,
    /// Time constant of the first-order lag behind it.
    pub time_constant: Duration,
    /// Number of cycles over which set points are averaged; 1: no smoothing.
    pub smoothing_cycles: usize,
    /// Standard deviation of the axis readings, degrees.
    pub noise_deg: f64,
}

/// What the drives do not follow: the robot stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutOut {
    /// Largest velocity of a set point; `None`: the velocities of the robot file.
    pub velocity_deg_s: Option<[f64; 6]>,
    /// Acceleration and jerk are differences over this time: one cycle of a KR C2, three of a KR C4.
    pub base: Duration,
    pub acceleration_deg_s2: [f64; 6],
    pub jerk_deg_s3: [f64; 6],
    /// Deceleration of the fastest axis after a fault or stop; the others slow down with it.
    pub braking_deg_s2: f64,
}

/// The gripper behind an output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandOptions {
    /// Bit of the output value (0 to 31) that opens it while set; `None`: no gripper is wired.
    pub output_bit: Option<u8>,
    /// Delay of valve and fingers, jitter, drag of the ball, height of landings.
    pub gripper: GripperOptions,
}

#[derive(Clone, Debug, PartialEq)]
pub struct KrcOptions {
    /// Generation of the interface.
    pub generation: Generation,
    /// Time between two telegrams.
    pub cycle: Duration,
    /// Time after a telegram in which its answer counts; at most the cycle.
    pub window: Duration,
    /// Number of the first telegram.
    pub ipoc_start: u64,
    pub decimals: u8,
    /// Line feeds after each telegram on TCP.
    pub tcp_line_feeds: usize,
    /// Refuse answers without `Type`.
    pub strict_type: bool,
    /// Start pose of the first program run, degrees.
    pub start_deg: [f64; 6],
    pub correction: CorrectionOptions,
    pub late: LateOptions,
    pub lag: LagOptions,
    /// Limits of the drives.
    pub cut_out: CutOut,
    pub hand: HandOptions,
    /// Scalar of the configuration file that sets outputs.
    pub outputs_name: String,
    /// Scalar that ends the sensor motion.
    pub stop_name: String,
    /// Scalar that the robot sends: 1 while the fingers are open; `None`: no finger sensor is wired.
    pub sensor_name: Option<String>,
}

impl KrcOptions {
    /// Defaults of a generation. Unpublished numbers are chosen; each can be set in a scenario.
    #[must_use]
    pub fn new(generation: Generation) -> Self {
        let kr_c2 = generation == Generation::KrC2;
        let (cycle_ms, window_ms) = if kr_c2 { (12, 10) } else { (4, 4) };
        let reach = if kr_c2 { 100.0 } else { 5.0 };
        let overall = if kr_c2 { 100.0 } else { 6.0 };
        Self {
            generation,
            cycle: Duration::from_millis(cycle_ms),
            window: Duration::from_millis(window_ms),
            ipoc_start: 4710,
            decimals: generation.usual_decimals(),
            tcp_line_feeds: 0,
            strict_type: true,
            start_deg: [0.0, -90.0, 90.0, 0.0, 90.0, 0.0],
            correction: CorrectionOptions {
                space: Space::Axes,
                relative: false,
                lower: [-reach; 6],
                upper: [reach; 6],
                overall_axis_deg: overall,
                overall_mm: overall,
                overall_rotation_deg: overall,
            },
            late: LateOptions {
                limit: if kr_c2 { 100 } else { 10 },
                consecutive: false,
                percent: 50.0,
                field_of_view: 1000,
                percent_stops: false,
            },
            lag: LagOptions {
                dead_time: Duration::from_millis(96),
                time_constant: Duration::from_millis(24),
                smoothing_cycles: 1,
                noise_deg: 0.0,
            },
            cut_out: CutOut {
                velocity_deg_s: None,
                base: Duration::from_millis(12),
                acceleration_deg_s2: [2000.0; 6],
                jerk_deg_s3: [1.5e5; 6],
                braking_deg_s2: 600.0,
            },
            hand: HandOptions {
                output_bit: Some(0),
                gripper: GripperOptions {
                    output: None,
                    // Fingers 10 ms, valve 10 ms.
                    delay: Duration::from_millis(20),
                    jitter: Duration::ZERO,
                    ..GripperOptions::default()
                },
            },
            outputs_name: "DiO".to_owned(),
            stop_name: "Stop".to_owned(),
            sensor_name: None,
        }
    }
}
