//! `[cell]`, `[drive]`, `[mechanics]`, `[supply]`, `[gripper]`, `[scatter]`: options of the simulated cell.
//!
//! Every key is optional; a missing key keeps the default that its type documents. Options are built as whole
//! structs, so that a field without a key in the file does not compile.

use protocol::Duration;
use protocol::powercube::{BaudRate, Config};
use toml_reader::Value;

use super::values::{degrees, seconds};
use super::{Problem, ScenarioError, Section};
use crate::cell::{CellOptions, Mounting};
use crate::drive::options::{
    BeyondMaximum, BeyondSoftLimit, DriveOptions, HomeWhenHalted, InternalCommand, Persistence, RefusedReply,
    SignOfLife, StateFrames, StepPath, UnknownRequest,
};
use crate::mechanics::{Elasticity, GripperOptions, MechanicsOptions, Scatter, SupplyOptions};

const MAX_S: f64 = 1e6;

/// Reads the tables of the cell from the root; `bit_rate_bit_s` is that of the bus.
pub(super) fn cell(root: &Section<'_>, bit_rate_bit_s: u32) -> Result<CellOptions, ScenarioError> {
    let default = CellOptions::default();
    let rates = [BaudRate::Kbit125, BaudRate::Kbit250, BaudRate::Kbit500, BaudRate::Kbit1000];
    let bit_rate = rates.into_iter().find(|rate| rate.bit_per_s() == bit_rate_bit_s).ok_or_else(|| {
        let problem =
            format!("{bit_rate_bit_s} bit/s: the drives know 125 000, 250 000, 500 000 and 1 000 000");
        root.error("bus", Problem::Invalid(problem))
    })?;
    let mut options = CellOptions {
        drive: part(root, "drive", drive)?,
        mechanics: part(root, "mechanics", mechanics)?,
        supply: part(root, "supply", supply)?,
        gripper: part(root, "gripper", gripper)?,
        finger_release: default.finger_release,
        scatter: part(root, "scatter", scatter)?,
        step: default.step,
        start_q_rad: default.start_q_rad,
        mounting: default.mounting,
        bit_rate,
        cold_start: default.cold_start,
        logic_on_motor_supply: default.logic_on_motor_supply,
        servos_extrapolate: default.servos_extrapolate,
    };
    if let Some(table) = root.optional("cell", Value::section)? {
        options.step = table.or("step_s", options.step, |v| seconds(v, 0.005))?;
        options.start_q_rad = start_pose(&table)?;
        options.mounting = mounting(&table)?;
        options.finger_release = table.or("finger_release", options.finger_release, Value::boolean)?;
        options.cold_start = table.or("cold_start", options.cold_start, Value::boolean)?;
        options.logic_on_motor_supply =
            table.or("logic_on_motor_supply", options.logic_on_motor_supply, Value::boolean)?;
        options.servos_extrapolate =
            table.or("servos_extrapolate", options.servos_extrapolate, Value::boolean)?;
        table.finish()?;
    }
    Ok(options)
}

/// Options of one table; the default if it is not there.
fn part<T: Default>(
    root: &Section<'_>,
    key: &'static str,
    read: fn(&Section<'_>) -> Result<T, ScenarioError>,
) -> Result<T, ScenarioError> {
    match root.optional(key, Value::section)? {
        None => Ok(T::default()),
        Some(table) => {
            let options = read(&table)?;
            table.finish()?;
            Ok(options)
        }
    }
}

fn start_pose(table: &Section<'_>) -> Result<Option<Vec<f64>>, ScenarioError> {
    let list = |value: &Value<'_>, max: f64| -> Result<Vec<f64>, ScenarioError> {
        value.items()?.iter().map(|item| item.number_in(-max, max)).collect()
    };
    let deg = table.optional("start_q_deg", |v| list(v, 7200.0))?;
    let rad = table.optional("start_q_rad", |v| list(v, 125.0))?;
    match (deg, rad) {
        (Some(_), Some(_)) => {
            Err(table.error("start_q_deg", Problem::Invalid("start_q_rad is given too".to_owned())))
        }
        (Some(deg), None) => Ok(Some(deg.iter().map(|q| q.to_radians()).collect())),
        (None, rad) => Ok(rad),
    }
}

/// `inverted` and `offset_rad`, base first; joints beyond either list read what their drives read.
fn mounting(table: &Section<'_>) -> Result<Vec<Mounting>, ScenarioError> {
    let inverted: Vec<bool> =
        table.or("inverted", Vec::new(), |v| v.items()?.iter().map(Value::boolean).collect())?;
    let offset_rad: Vec<f64> = table.or("offset_rad", Vec::new(), |v| {
        v.items()?.iter().map(|item| item.number_in(-6.3, 6.3)).collect()
    })?;
    let joint = |joint: usize| Mounting {
        inverted: inverted.get(joint).copied().unwrap_or_default(),
        offset_rad: offset_rad.get(joint).copied().unwrap_or_default(),
    };
    Ok((0..inverted.len().max(offset_rad.len())).map(joint).collect())
}

fn drive(table: &Section<'_>) -> Result<DriveOptions, ScenarioError> {
    const CLIP: [(&str, BeyondMaximum); 2] =
        [("clip", BeyondMaximum::Clip), ("refuse", BeyondMaximum::Refuse)];
    const SOFT: [(&str, BeyondSoftLimit); 3] =
        [("clip", BeyondSoftLimit::Clip), ("refuse", BeyondSoftLimit::Refuse), ("run", BeyondSoftLimit::Run)];
    const UNKNOWN: [(&str, UnknownRequest); 2] =
        [("silence", UnknownRequest::Silence), ("echo", UnknownRequest::Echo)];
    const PERSISTENCE: [(&str, Persistence); 2] =
        [("on-save", Persistence::OnSave), ("at-once", Persistence::AtOnce)];
    const INTERNAL: [(&str, InternalCommand); 2] =
        [("echo", InternalCommand::Echo), ("silence", InternalCommand::Silence)];
    const HOME: [(&str, HomeWhenHalted); 2] =
        [("accept", HomeWhenHalted::Accept), ("refuse", HomeWhenHalted::Refuse)];
    const LIFE: [(&str, SignOfLife); 2] =
        [("refresh", SignOfLife::Refresh), ("any-frame", SignOfLife::AnyFrame)];
    const PATH: [(&str, StepPath); 2] = [("linear", StepPath::Linear), ("cubic", StepPath::Cubic)];
    let d = DriveOptions::default();
    Ok(DriveOptions {
        beyond_maximum: table.or("beyond_maximum", d.beyond_maximum, |v| v.word(&CLIP))?,
        beyond_soft_limit: table.or("beyond_soft_limit", d.beyond_soft_limit, |v| v.word(&SOFT))?,
        refusal: table
            .or("refusal_code", d.refusal, |v| Ok(RefusedReply::Code(v.integer(0..=255)? as u8)))?,
        unknown: table.or("unknown_request", d.unknown, |v| v.word(&UNKNOWN))?,
        persistence: table.or("persistence", d.persistence, |v| v.word(&PERSISTENCE))?,
        internal: table.or("internal_command", d.internal, |v| v.word(&INTERNAL))?,
        home_when_halted: table.or("home_when_halted", d.home_when_halted, |v| v.word(&HOME))?,
        sign_of_life: table.or("sign_of_life", d.sign_of_life, |v| v.word(&LIFE))?,
        state_frames: state_frames(table)?,
        step_path: table.or("step_path", d.step_path, |v| v.word(&PATH))?,
        watchdog_timeout: table.or("watchdog_timeout_s", d.watchdog_timeout, |v| seconds(v, MAX_S))?,
        processing_delay: table.or("processing_delay_s", d.processing_delay, |v| seconds(v, 1.0))?,
        processing_jitter: table.or("processing_jitter_s", d.processing_jitter, |v| seconds(v, 1.0))?,
        queue_depth: table.or("queue_depth", d.queue_depth, |v| Ok(v.integer(1..=4_096)? as usize))?,
        boot_time: table.or("boot_time_s", d.boot_time, |v| seconds(v, MAX_S))?,
        position_resolution_rad: table.optional("position_resolution_deg", |v| degrees(v, 10.0))?,
        current_noise_a: table.or("current_noise_a", d.current_noise_a, |v| v.number_in(0.0, 100.0))?,
        home_switch_noise_rad: table
            .or("home_switch_noise_deg", d.home_switch_noise_rad, |v| degrees(v, 10.0))?,
        absolute_encoder: table.or("absolute_encoder", d.absolute_encoder, Value::boolean)?,
        starts_homed: table.or("starts_homed", d.starts_homed, Value::boolean)?,
        brake: table.or("brake", d.brake, Value::boolean)?,
        config: table
            .or("config", d.config, |v| Ok(Config::from_bits(v.integer(0..=u32::MAX.into())? as u32)))?,
        ambient_c: table.or("ambient_c", d.ambient_c, |v| v.number_in(-50.0, 150.0))?,
    })
}

fn state_frames(table: &Section<'_>) -> Result<StateFrames, ScenarioError> {
    type When = fn(Duration) -> StateFrames;
    const WORDS: [(&str, When); 3] = [
        ("never", |_| StateFrames::Never),
        ("on-change", |every| StateFrames::OnChange { every }),
        ("sync-transmit", |every| StateFrames::SyncTransmit { every }),
    ];
    let when = table.or("state_frames", WORDS[0].1, |v| v.word(&WORDS))?;
    let every_s = table.or("state_frames_every_s", 0.01, |v| v.number_in(100e-6, MAX_S))?;
    Ok(when(Duration::from_secs_f64(every_s)))
}

fn mechanics(table: &Section<'_>) -> Result<MechanicsOptions, ScenarioError> {
    let d = MechanicsOptions::default();
    let stiffness = table.optional("elasticity_stiffness_nm_rad", |v| v.number_in(1.0, 1e9))?;
    let damping = table.optional("elasticity_damping_nms_rad", |v| v.number_in(0.0, 1e6))?;
    if stiffness.is_none() && damping.is_some() {
        let problem = Problem::Invalid("needs elasticity_stiffness_nm_rad".to_owned());
        return Err(table.error("elasticity_damping_nms_rad", problem));
    }
    Ok(MechanicsOptions {
        rotor_share: table.or("rotor_share", d.rotor_share, |v| v.number_in(1e-3, 10.0))?,
        viscous_share: table.or("viscous_share", d.viscous_share, |v| v.number_in(0.0, 10.0))?,
        coulomb_rad_s2: table.optional("coulomb_rad_s2", |v| v.number_in(0.0, 1e3))?,
        brake_share: table.or("brake_share", d.brake_share, |v| v.number_in(0.0, 100.0))?,
        stop_margin_rad: table.or("stop_margin_deg", d.stop_margin_rad, |v| degrees(v, 90.0))?,
        stop_stiffness_nm_rad: table
            .or("stop_stiffness_nm_rad", d.stop_stiffness_nm_rad, |v| v.number_in(1.0, 1e6))?,
        elasticity: stiffness
            .map(|stiffness_nm_rad| Elasticity { stiffness_nm_rad, damping_nms_rad: damping.unwrap_or(0.0) }),
    })
}

fn supply(table: &Section<'_>) -> Result<SupplyOptions, ScenarioError> {
    let d = SupplyOptions::default();
    Ok(SupplyOptions {
        resistance_ohm: table.or("resistance_ohm", d.resistance_ohm, |v| v.number_in(0.0, 100.0))?,
        trip_charge_as: table.or("trip_charge_as", d.trip_charge_as, Value::non_negative)?,
        restore_s: table.or("restore_s", d.restore_s, |v| v.number_in(0.0, MAX_S))?,
    })
}

fn gripper(table: &Section<'_>) -> Result<GripperOptions, ScenarioError> {
    let d = GripperOptions::default();
    let (_, line) = d.output.unwrap_or((None, 0));
    let axis = table.optional("output_axis", |v| Ok(v.integer(1..=8)? as usize - 1))?;
    let line = table.or("output_line", line, |v| Ok(v.integer(0..=3)? as u8))?;
    Ok(GripperOptions {
        output: Some((axis, line)),
        delay: table.or("delay_s", d.delay, |v| seconds(v, 10.0))?,
        jitter: table.or("jitter_s", d.jitter, |v| seconds(v, 10.0))?,
        drag_1_m: table.optional("drag_1_m", |v| v.number_in(0.0, 100.0))?,
        landing_z_m: table.optional("landing_z_m", |v| v.number_in(-100.0, 100.0))?,
        ..d
    })
}

fn scatter(table: &Section<'_>) -> Result<Scatter, ScenarioError> {
    let share = |key| table.or(key, 0.0, |v| v.number_in(0.0, 0.9));
    Ok(Scatter {
        mass_share: share("mass_share")?,
        com_m: table.or("com_m", 0.0, |v| v.number_in(0.0, 0.1))?,
        friction_share: share("friction_share")?,
        rotor_share: share("rotor_share")?,
        current_share: share("current_share")?,
        delay_share: share("delay_share")?,
        home_rad: table.or("home_deg", 0.0, |v| degrees(v, 10.0))?,
        gripper_delay: table.or("gripper_delay_s", Duration::ZERO, |v| seconds(v, 1.0))?,
    })
}
