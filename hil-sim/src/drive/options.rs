//! Behaviour of a module where its sources have gaps, and its speeds: options with defaults.
//!
//! No manufacturer's manual and no real module was at hand (`powercube-protocol` section 10). Each enum here is one
//! open question; its default is the choice that works with every known host.

use protocol::{Duration, ModuleId};
use robot_model as robot;

/// Treatment of a number beyond its limit: SET of a parameter, velocity or current of a motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BeyondMaximum {
    /// The nearest allowed number acts, and the answer says accepted. (Hosts write round numbers above the maximum
    /// and expect the module to continue.)
    #[default]
    Clip,
    /// Nothing changes; the answer is that of [`RefusedReply`].
    Refuse,
}

/// What becomes of a ramp or step to a position beyond the soft limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BeyondSoftLimit {
    /// The target is taken as it is; if the axis gets beyond the limit it stops with BEYOND_SOFT, as in a velocity
    /// motion. The throwing paper commands "actual position ± 3 rad" to get pure acceleration, which only works where
    /// targets beyond the limits are taken unchanged: a nearer target makes a ramp brake earlier.
    #[default]
    Run,
    /// The module goes to the limit and ends there.
    Clip,
    /// The motion is not executed.
    Refuse,
}

/// Answer to a request that is understood but not executed: gate closed, read-only, value refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RefusedReply {
    /// Not at all; hosts take silence for a time-out.
    #[default]
    Silence,
    /// SET and simple motions: the usual three bytes with this third byte instead of 0x64. Reads stay unanswered.
    Code(u8),
}

/// Answer to a frame for this module that is not a known request: unknown command, parameter or motion, wrong
/// length, and TOGGLEHOME, of which only the name is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UnknownRequest {
    /// Nothing; hosts take it for a time-out.
    #[default]
    Silence,
    /// The same bytes, after the usual delay.
    Echo,
}

/// What becomes of written parameters at power-off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Persistence {
    /// Lost unless SAVE PARAMETERS was sent: the command exists, and modules count their writes to flash.
    #[default]
    OnSave,
    /// Every accepted write is permanent.
    AtOnce,
}

/// What the command INTERNAL (0x04, meaning unknown) gets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InternalCommand {
    /// The same eight bytes: the manufacturer's library waits for eight of any content.
    #[default]
    Echo,
    Silence,
}

/// What HOME does in the state HALTED.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HomeWhenHalted {
    /// HALTED is cleared and homing starts: a widespread driver sends HALT and then HOME, and this works with real modules.
    #[default]
    Accept,
    /// Acknowledged, not executed.
    Refuse,
}

/// What keeps the watchdog quiet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SignOfLife {
    #[default]
    Refresh,
    /// Every frame to this module or to all.
    AnyFrame,
}

/// When a module sends its state word unasked (id 0x060 + address).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StateFrames {
    /// Never: the library listens for it and no host needs it.
    #[default]
    Never,
    /// When the state word differs from the one sent last, checked in this interval (at least 100 µs).
    OnChange { every: Duration },
    /// In a fixed interval while the config bit SYNC_TRANSMIT is set (firmware 36xx; the meaning of the bit is a guess).
    SyncTransmit {
        /// Interval (at least 100 µs).
        every: Duration,
    },
}

/// Path of a step motion (position in a given time).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StepPath {
    /// Constant velocity: a stream of equal steps becomes an even motion.
    #[default]
    Linear,
    /// Cubic that leaves with the present velocity and arrives at rest.
    Cubic,
}

/// Choices where the sources are silent, and timing.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveOptions {
    /// Numbers beyond their limit.
    pub beyond_maximum: BeyondMaximum,
    /// Position targets beyond the soft limits.
    pub beyond_soft_limit: BeyondSoftLimit,
    /// Answers to requests that are not obeyed.
    pub refusal: RefusedReply,
    pub unknown: UnknownRequest,
    /// Written parameters at power-off.
    pub persistence: Persistence,
    /// Command 0x04.
    pub internal: InternalCommand,
    /// HOME while HALTED.
    pub home_when_halted: HomeWhenHalted,
    /// What refreshes the watchdog.
    pub sign_of_life: SignOfLife,
    /// Unsolicited STATE frames.
    pub state_frames: StateFrames,
    /// Path of step motions.
    pub step_path: StepPath,
    /// Time without refresh after which the watchdog stops the module. Not stated anywhere; hosts refresh every 20
    /// or 40 ms, so 50 ms.
    pub watchdog_timeout: Duration,
    /// Time from a request's arrival (or from the answer before, if that is later) to its effect and answer.
    pub processing_delay: Duration,
    /// The delay varies evenly by up to this much to both sides.
    pub processing_jitter: Duration,
    /// Requests that wait while one is processed; a request that finds all places taken is lost without an answer,
    /// and counted.
    pub queue_depth: usize,
    /// Time from power-on to the first answer.
    pub boot_time: Duration,
    /// Step of the reported position, rad; zero reports encoder ticks, `None` takes the machine's.
    pub position_resolution_rad: Option<f64>,
    /// Standard deviation of a current reading, A: ripple of motor and power stage, new for every answer.
    pub current_noise_a: f64,
    /// Standard deviation of the home switch's edge, rad; homing to the encoder index (the default) is free of it.
    pub home_switch_noise_rad: f64,
    /// Known position at power-on, as with absolute encoders; otherwise the module must be homed.
    pub absolute_encoder: bool,
    /// The first power-on finds the axis homed already, as if the module had been left on.
    pub starts_homed: bool,
    /// Brake fitted. It is on without power, while halted, and in POWERFAULT.
    pub brake: bool,
    /// Configuration bits of the factory besides those that follow from the other options.
    pub config: protocol::powercube::Config,
    /// Temperature of the surroundings, °C.
    pub ambient_c: f64,
}

impl Default for DriveOptions {
    fn default() -> Self {
        Self {
            beyond_maximum: BeyondMaximum::default(),
            beyond_soft_limit: BeyondSoftLimit::default(),
            refusal: RefusedReply::default(),
            unknown: UnknownRequest::default(),
            persistence: Persistence::default(),
            internal: InternalCommand::default(),
            home_when_halted: HomeWhenHalted::default(),
            sign_of_life: SignOfLife::default(),
            state_frames: StateFrames::default(),
            step_path: StepPath::default(),
            watchdog_timeout: Duration::from_millis(50),
            processing_delay: Duration::from_micros(200),
            processing_jitter: Duration::from_micros(100),
            queue_depth: 8,
            boot_time: Duration::from_millis(500),
            position_resolution_rad: None,
            current_noise_a: 0.0,
            home_switch_noise_rad: 2e-4,
            absolute_encoder: false,
            starts_homed: false,
            brake: true,
            config: protocol::powercube::Config::EMPTY,
            ambient_c: 25.0,
        }
    }
}

/// Data engraved on a module, or given by its machine. All at the joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Nameplate {
    pub address: ModuleId,
    pub module: String,
    pub serial: u32,
    /// Firmware version word, e.g. 0x4614.
    pub firmware: u16,
    /// Motor turns per joint turn.
    pub gear_ratio: f64,
    /// Encoder ticks per motor turn.
    pub ticks_per_turn: u32,
    /// Range of the joint: default soft limits, rad.
    pub q_min_rad: f64,
    /// Upper end of the range, rad.
    pub q_max_rad: f64,
    /// Hard limit beyond each soft limit, rad.
    pub hard_margin_rad: f64,
    /// Largest velocity, rad/s.
    pub v_max_rad_s: f64,
    /// Largest acceleration, rad/s².
    pub a_max_rad_s2: f64,
    /// Largest current, A.
    pub current_max_a: f64,
    /// Largest torque, N·m.
    pub torque_max_nm: f64,
    /// K_B of eq. (9) of the throwing paper, A·s/rad.
    pub k_b_a_s_rad: f64,
    /// K_M of eq. (9), A/(N·m).
    pub k_m_a_nm: f64,
    /// Inertia that the position loop is tuned for, kg·m².
    pub servo_inertia_kg_m2: f64,
    /// Natural frequency of the position loop with default gains, rad/s.
    pub servo_wn_rad_s: f64,
    /// Damping ratio of the position loop with default gains.
    pub servo_zeta: f64,
    /// Nominal voltage of the motor supply, V.
    pub supply_v: f64,
    /// Step of the reported position, rad; zero reports encoder ticks.
    pub position_resolution_rad: f64,
    /// Upper edge of the home switch's cam, rad.
    pub home_edge_rad: f64,
    /// Width of the cam below that edge, rad.
    pub home_cam_rad: f64,
    /// True position of the edge minus the position that the module assumes, rad: effect of a calibration error.
    pub home_error_rad: f64,
}

impl Nameplate {
    /// Nameplate of joint `index` (from 0) of a robot; `None` if its file describes no drives.
    ///
    /// Not in a robot file, chosen here: serial number 1000 + address; home switch in the middle of the range, cam
    /// 5 degrees; hard limits 2 degrees beyond the soft ones; torque 1e9 N·m where the file gives none.
    pub fn of_joint(model: &robot::RobotModel, index: usize, servo_inertia_kg_m2: f64) -> Option<Self> {
        let drive = model.drives()?.get(index)?;
        let limits = &model.joints().get(index)?.limits;
        let servo = model.drive_loop();
        Some(Self {
            address: ModuleId::new(drive.address).ok()?,
            module: drive.module.clone(),
            serial: 1000 + u32::from(drive.address),
            firmware: drive.firmware,
            gear_ratio: drive.gear_ratio,
            ticks_per_turn: drive.encoder_slots,
            q_min_rad: limits.q_min_rad,
            q_max_rad: limits.q_max_rad,
            hard_margin_rad: 2_f64.to_radians(),
            v_max_rad_s: limits.v_max_rad_s,
            a_max_rad_s2: limits.a_max_rad_s2,
            current_max_a: drive.current_max_a,
            torque_max_nm: limits.torque_max_nm.unwrap_or(1e9),
            k_b_a_s_rad: drive.k_b_a_s_rad,
            k_m_a_nm: drive.k_m_a_nm,
            servo_inertia_kg_m2,
            servo_wn_rad_s: servo.map_or(320.0, |l| l.natural_frequency_rad_s),
            servo_zeta: servo.map_or(0.8, |l| l.damping_ratio),
            supply_v: model.supplies().iter().find(|s| s.feeds[index]).map_or(24.0, |s| s.voltage_v),
            position_resolution_rad: servo.map_or(0.0, |l| l.position_resolution_rad),
            home_edge_rad: 0.5 * (limits.q_min_rad + limits.q_max_rad),
            home_cam_rad: 5_f64.to_radians(),
            home_error_rad: 0.0,
        })
    }

    /// A PR-090 on a test bench: limits and constants of joint 1 of the throwing arm, range ± 180 degrees.
    pub fn bench(address: ModuleId, firmware: u16) -> Self {
        Self {
            address,
            module: "PR-090".to_owned(),
            serial: 1000 + u32::from(address.get()),
            firmware,
            gear_ratio: 161.0,
            ticks_per_turn: 2000,
            q_min_rad: -std::f64::consts::PI,
            q_max_rad: std::f64::consts::PI,
            hard_margin_rad: 2_f64.to_radians(),
            v_max_rad_s: 149_f64.to_radians(),
            a_max_rad_s2: 596_f64.to_radians(),
            current_max_a: 30.0,
            torque_max_nm: 206.0,
            k_b_a_s_rad: 2.9116,
            k_m_a_nm: 0.1419,
            servo_inertia_kg_m2: 4.0,
            servo_wn_rad_s: 320.0,
            servo_zeta: 0.8,
            supply_v: 24.0,
            position_resolution_rad: 0.0,
            home_edge_rad: 0.0,
            home_cam_rad: 5_f64.to_radians(),
            home_error_rad: 0.0,
        }
    }

    /// Encoder ticks per rad of the joint: ticks per turn × gear ratio / 2π.
    pub fn ticks_per_rad(&self) -> f64 {
        f64::from(self.ticks_per_turn) * self.gear_ratio / std::f64::consts::TAU
    }
}
