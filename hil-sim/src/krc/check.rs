//! Whether options, configuration file and robot fit together.

use robot_model::RobotModel;
use rsi_protocol::{Config, Generation, Internal, Ipoc, Protocol, RobotData, RobotWriter, Source, ValueType};

use super::monitor::Monitor;
use super::options::{KrcOptions, Space};

/// The monitor of a program run that starts at `start_deg`.
pub(super) fn monitor(options: &KrcOptions, model: &RobotModel, start_deg: [f64; 6]) -> Monitor {
    let joints = model.joints();
    let velocity = std::array::from_fn(|i| joints[i].limits.v_max_rad_s.to_degrees());
    Monitor::new(options.cut_out, velocity, range_deg(model), options.cycle, start_deg)
}

fn range_deg(model: &RobotModel) -> [(f64, f64); 6] {
    let (low, high) = (model.q_min(), model.q_max());
    std::array::from_fn(|i| (low[i].to_degrees(), high[i].to_degrees()))
}

/// Number and type of the object input of the finger sensor; `None`: no sensor is wired.
pub(super) fn sensor(config: &Config, options: &KrcOptions) -> Result<Option<(u8, ValueType)>, String> {
    let Some(name) = &options.sensor_name else { return Ok(None) };
    let entry = config.send.iter().find(|entry| entry.tag.to_string() == *name);
    match entry.map(|entry| (entry.source, entry.kind)) {
        Some((Source::Object(index), kind @ (ValueType::Bool | ValueType::Long))) => Ok(Some((index, kind))),
        _ => Err(format!("the gripper's sensor {name} is no BOOL or LONG element of SEND with an index")),
    }
}

/// Checks whether the controller can serve this; returns the places of the correction in the configuration file.
pub(super) fn servable(
    config: &Config,
    options: &KrcOptions,
    model: &RobotModel,
) -> Result<[usize; 6], String> {
    if config.length_prefix {
        return Err("PROTCOLLENGTH is On: the format of that length is not known; set it to Off".to_owned());
    }
    if options.generation == Generation::KrC4 && config.protocol == Protocol::Tcp {
        return Err("PROTOCOL is TCP: a KR C4 has UDP only".to_owned());
    }
    let unserved = config.send.iter().find(|entry| {
        matches!(
            entry.source,
            Source::Internal(Internal::Technology | Internal::MessageText | Internal::Other)
        )
    });
    if let Some(entry) = unserved {
        return Err(format!(
            "the simulated controller has no value for DEF_{}; remove it from SEND",
            entry.tag
        ));
    }
    if options.cycle.is_zero() || !options.cycle.as_micros().is_multiple_of(1000) {
        return Err(format!("a cycle of {} is not a whole number of milliseconds", options.cycle));
    }
    if options.window.is_zero() || options.window > options.cycle {
        return Err(format!("a window of {} is not within the cycle of {}", options.window, options.cycle));
    }
    if options.lag.dead_time < options.cycle {
        return Err(format!(
            "a dead time of {} is below one cycle of {}",
            options.lag.dead_time, options.cycle
        ));
    }
    let limits = options.correction.lower.iter().zip(options.correction.upper);
    if limits.clone().any(|(low, high)| !(*low <= 0.0 && high >= 0.0)) {
        return Err("limits of the correction object must include zero".to_owned());
    }
    let ranges = options.start_deg.iter().zip(range_deg(model)).zip(1..);
    for ((start, (low, high)), axis) in ranges {
        if !(low..=high).contains(start) {
            return Err(format!("start pose: A{axis} = {start} deg is outside {low:.1} to {high:.1} deg"));
        }
    }
    let longest = [-1234.0; 6];
    let data = RobotData {
        rist_mm_deg: longest,
        rsol_mm_deg: longest,
        aipos_deg: longest,
        aspos_deg: longest,
        macur: longest,
        delay: u64::MAX,
    };
    let trial = RobotWriter::new(config, options.decimals).write(Ipoc::new(u64::MAX), &data, |_| None);
    trial.map_err(|error| format!("telegrams with these entries are too long: {error}"))?;
    let (places, names) = match options.correction.space {
        Space::Axes => (config.axis_correction(), "A1 to A6"),
        Space::Base | Space::Tool => (config.cartesian_correction(), "X, Y, Z, A, B, C"),
    };
    match places {
        Some(places) => Ok(places),
        None if config.only_send => Ok([usize::MAX; 6]),
        None => Err(format!("RECEIVE has no element with attributes {names} of type DOUBLE")),
    }
}
