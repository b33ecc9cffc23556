//! `[cell]`, `[drive]`, `[mechanics]`, `[supply]`, `[gripper]`, `[scatter]`: options of the simulated cell.
//!
//! Every key is optional; what is left out keeps the default that its type documents.

use protocol::Duration;
use protocol::powercube::{BaudRate, Config};

use super::reader::{Problem, ScenarioError, Table};
use crate::cell::CellOptions;
use crate::drive::options::{
    BeyondMaximum, BeyondSoftLimit, DriveOptions, HomeWhenHalted, InternalCommand, Refusal, SignOfLife,
    StateFrames, StepPath,
};
use crate::mechanics::{Elasticity, GripperOptions, MechanicsOptions, Scatter, SupplyOptions};

const MAX_S: f64 = 1e6;
const MAX: f64 = f64::MAX;

/// Reads the tables of the cell from the root; `bit_rate_bit_s` is that of the bus.
pub(super) fn cell(root: &Table<'_>, bit_rate_bit_s: u32) -> Result<CellOptions, ScenarioError> {
    let mut options = CellOptions::default();
    let rates = [BaudRate::Kbit125, BaudRate::Kbit250, BaudRate::Kbit500, BaudRate::Kbit1000];
    options.bit_rate =
        rates.into_iter().find(|rate| rate.bit_per_s() == bit_rate_bit_s).ok_or_else(|| {
            let problem =
                format!("{bit_rate_bit_s} bit/s: the drives know 125 000, 250 000, 500 000 and 1 000 000");
            root.error("bus", Problem::Invalid(problem))
        })?;
    if let Some(table) = root.table("cell")? {
        if let Some(step) = table.seconds("step_s", 0.005)? {
            options.step = step;
        }
        options.start_q_rad = start_pose(&table)?;
        set(&mut options.cold_start, table.boolean("cold_start")?);
        set(&mut options.logic_on_motor_supply, table.boolean("logic_on_motor_supply")?);
        table.finish()?;
    }
    if let Some(table) = root.table("drive")? {
        options.drive = drive(&table)?;
    }
    if let Some(table) = root.table("mechanics")? {
        options.mechanics = mechanics(&table)?;
    }
    if let Some(table) = root.table("supply")? {
        options.supply = supply(&table)?;
    }
    if let Some(table) = root.table("gripper")? {
        options.gripper = gripper(&table)?;
    }
    if let Some(table) = root.table("scatter")? {
        options.scatter = scatter(&table)?;
    }
    Ok(options)
}

fn set<T>(place: &mut T, value: Option<T>) {
    if let Some(value) = value {
        *place = value;
    }
}

fn start_pose(table: &Table<'_>) -> Result<Option<Vec<f64>>, ScenarioError> {
    let deg = table.numbers("start_q_deg", -7200.0, 7200.0)?;
    let rad = table.numbers("start_q_rad", -125.0, 125.0)?;
    match (deg, rad) {
        (Some(_), Some(_)) => {
            Err(table.error("start_q_deg", Problem::Invalid("start_q_rad is given too".to_owned())))
        }
        (Some(deg), None) => Ok(Some(deg.iter().map(|q| q.to_radians()).collect())),
        (None, rad) => Ok(rad),
    }
}

fn drive(table: &Table<'_>) -> Result<DriveOptions, ScenarioError> {
    let mut o = DriveOptions::default();
    let clip = [("clip", BeyondMaximum::Clip), ("refuse", BeyondMaximum::Refuse)];
    set(&mut o.beyond_maximum, table.word("beyond_maximum", &clip)?);
    let soft =
        [("clip", BeyondSoftLimit::Clip), ("refuse", BeyondSoftLimit::Refuse), ("run", BeyondSoftLimit::Run)];
    set(&mut o.beyond_soft_limit, table.word("beyond_soft_limit", &soft)?);
    if let Some(code) = table.integer("refusal_code", 0, 255)? {
        o.refusal = Refusal::Code(code as u8);
    }
    let internal = [("echo", InternalCommand::Echo), ("silence", InternalCommand::Silence)];
    set(&mut o.internal, table.word("internal_command", &internal)?);
    let home = [("accept", HomeWhenHalted::Accept), ("refuse", HomeWhenHalted::Refuse)];
    set(&mut o.home_when_halted, table.word("home_when_halted", &home)?);
    let life = [("refresh", SignOfLife::Refresh), ("any-frame", SignOfLife::AnyFrame)];
    set(&mut o.sign_of_life, table.word("sign_of_life", &life)?);
    let path = [("linear", StepPath::Linear), ("cubic", StepPath::Cubic)];
    set(&mut o.step_path, table.word("step_path", &path)?);
    o.state_frames = state_frames(table)?;
    set(&mut o.watchdog_timeout, table.seconds("watchdog_timeout_s", MAX_S)?);
    set(&mut o.processing_delay, table.seconds("processing_delay_s", 1.0)?);
    set(&mut o.processing_jitter, table.seconds("processing_jitter_s", 1.0)?);
    set(&mut o.queue_depth, table.integer("queue_depth", 1, 4_096)?.map(|depth| depth as usize));
    set(&mut o.boot_time, table.seconds("boot_time_s", MAX_S)?);
    if let Some(deg) = table.number("position_resolution_deg", 0.0, 10.0)? {
        o.position_resolution_rad = Some(deg.to_radians());
    }
    if let Some(deg) = table.number("home_switch_noise_deg", 0.0, 10.0)? {
        o.home_switch_noise_rad = deg.to_radians();
    }
    set(&mut o.absolute_encoder, table.boolean("absolute_encoder")?);
    set(&mut o.starts_homed, table.boolean("starts_homed")?);
    set(&mut o.brake, table.boolean("brake")?);
    set(
        &mut o.config,
        table.integer("config", 0, u32::MAX.into())?.map(|bits| Config::from_bits(bits as u32)),
    );
    set(&mut o.ambient_c, table.number("ambient_c", -50.0, 150.0)?);
    table.finish()?;
    Ok(o)
}

fn state_frames(table: &Table<'_>) -> Result<StateFrames, ScenarioError> {
    #[derive(Clone, Copy)]
    enum When {
        Never,
        OnChange,
        Sync,
    }
    let words = [("never", When::Never), ("on-change", When::OnChange), ("sync-transmit", When::Sync)];
    let when = table.word("state_frames", &words)?.unwrap_or(When::Never);
    let every_s = table.number("state_frames_every_s", 100e-6, MAX_S)?;
    let every = Duration::from_secs_f64(every_s.unwrap_or(0.01));
    Ok(match when {
        When::Never => StateFrames::Never,
        When::OnChange => StateFrames::OnChange { every },
        When::Sync => StateFrames::SyncTransmit { every },
    })
}

fn mechanics(table: &Table<'_>) -> Result<MechanicsOptions, ScenarioError> {
    let mut o = MechanicsOptions::default();
    set(&mut o.rotor_share, table.number("rotor_share", 1e-3, 10.0)?);
    set(&mut o.viscous_share, table.number("viscous_share", 0.0, 10.0)?);
    if let Some(coulomb) = table.number("coulomb_rad_s2", 0.0, 1e3)? {
        o.coulomb_rad_s2 = Some(coulomb);
    }
    set(&mut o.brake_share, table.number("brake_share", 0.0, 100.0)?);
    set(&mut o.stop_margin_rad, table.number("stop_margin_deg", 0.0, 90.0)?.map(f64::to_radians));
    set(&mut o.stop_stiffness_nm_rad, table.number("stop_stiffness_nm_rad", 1.0, 1e6)?);
    let stiffness = table.number("elasticity_stiffness_nm_rad", 1.0, 1e9)?;
    let damping = table.number("elasticity_damping_nms_rad", 0.0, 1e6)?;
    o.elasticity = match (stiffness, damping) {
        (Some(stiffness_nm_rad), damping) => {
            Some(Elasticity { stiffness_nm_rad, damping_nms_rad: damping.unwrap_or(0.0) })
        }
        (None, None) => None,
        (None, Some(_)) => {
            let problem = Problem::Invalid("needs elasticity_stiffness_nm_rad".to_owned());
            return Err(table.error("elasticity_damping_nms_rad", problem));
        }
    };
    table.finish()?;
    Ok(o)
}

fn supply(table: &Table<'_>) -> Result<SupplyOptions, ScenarioError> {
    let mut o = SupplyOptions::default();
    set(&mut o.resistance_ohm, table.number("resistance_ohm", 0.0, 100.0)?);
    set(&mut o.trip_charge_as, table.number("trip_charge_as", 0.0, MAX)?);
    set(&mut o.restore_s, table.number("restore_s", 0.0, MAX_S)?);
    table.finish()?;
    Ok(o)
}

fn gripper(table: &Table<'_>) -> Result<GripperOptions, ScenarioError> {
    let mut o = GripperOptions::default();
    let axis = table.integer("output_axis", 1, 7)?;
    let line = table.integer("output_line", 0, 3)?;
    if axis.is_some() || line.is_some() {
        let (default_axis, default_line) = o.output.unwrap_or((5, 0));
        let axis = axis.map_or(default_axis, |axis| axis as usize - 1);
        o.output = Some((axis, line.map_or(default_line, |line| line as u8)));
    }
    set(&mut o.delay, table.seconds("delay_s", 10.0)?);
    set(&mut o.jitter, table.seconds("jitter_s", 10.0)?);
    set(&mut o.drag_1_m, table.number("drag_1_m", 0.0, 100.0)?);
    if let Some(z) = table.number("landing_z_m", -100.0, 100.0)? {
        o.landing_z_m = Some(z);
    }
    table.finish()?;
    Ok(o)
}

fn scatter(table: &Table<'_>) -> Result<Scatter, ScenarioError> {
    let share = |key| table.number(key, 0.0, 0.9);
    let mut o = Scatter::default();
    set(&mut o.mass_share, share("mass_share")?);
    set(&mut o.com_m, table.number("com_m", 0.0, 0.1)?);
    set(&mut o.friction_share, share("friction_share")?);
    set(&mut o.rotor_share, share("rotor_share")?);
    set(&mut o.current_share, share("current_share")?);
    set(&mut o.delay_share, share("delay_share")?);
    set(&mut o.home_rad, table.number("home_deg", 0.0, 10.0)?.map(f64::to_radians));
    set(&mut o.gripper_delay, table.seconds("gripper_delay_s", 1.0)?);
    table.finish()?;
    Ok(o)
}
