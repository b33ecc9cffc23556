//! What a robot file still lacks for each use: to plan, to simulate, to move drives on a real bus.
//!
//! A file that loads is enough to plan. What the other uses need is checked here, each with the lines to add.

use toml_reader::{Source, Value};

use crate::error::{LoadError, Problem};
use crate::model::RobotModel;

type Section<'a> = toml_reader::Section<'a, Problem>;

/// What a robot file is used for, beside planning.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// In the simulated cell.
    Simulate,
    /// With drives on a bus.
    RealBus,
}

/// Something that a use needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Missing {
    /// The use that needs the key.
    pub purpose: Use,
    /// Key, such as `joint[2].drive`.
    pub key: String,
    /// Why it is needed.
    pub what: String,
    /// Lines to add; `…` stands for a value to look up.
    pub lines: String,
}

/// Drives computed from speed and torque of the joints: key, value, why. Their voltage comes before.
pub(crate) const GENERIC_DRIVES: [(&str, &str, &str); 3] = [
    ("efficiency", "0.8", "motor and gear at full torque and top speed"),
    ("motor_speed_max_rad_s", "314", "3000 rpm at top speed of the joint"),
    ("encoder_slots", "2000", "a usual encoder"),
];
/// The position loop of such drives.
pub(crate) const DRIVE_LOOP: [(&str, &str, &str); 5] = [
    ("natural_frequency_rad_s", "320", "50 Hz, a stiff position loop"),
    ("damping_ratio", "0.8", "little overshoot"),
    ("coulomb_friction_rad_s2", "2", "friction that stops a joint from 2 rad/s in 1 s"),
    ("position_resolution_deg", "0.01", "a usual encoder behind the gear"),
    ("delay_periods", "1", "a command acts one period later"),
];

/// What is missing in the text of a robot file that loads as `robot`.
///
/// # Errors
/// The text is not TOML.
pub fn missing(robot: &RobotModel, file: &str, text: &str) -> Result<Vec<Missing>, LoadError> {
    let source = Source { file, text };
    let document = source.parse()?;
    let root: Section<'_> = source.root(&document);
    let mut out = Vec::new();
    let generic = root.has("generic_drives");
    let mut add = |purpose, key: String, what: String, lines: String| {
        out.push(Missing { purpose, key, what, lines });
    };
    // The tables of motors and servos say what the cell and the bus need.
    let described = robot.drives().is_none() && robot.addresses().is_some();
    if robot.drives().is_none() && !described {
        for (k, joint) in robot.joints().iter().enumerate().filter(|(_, j)| j.limits.torque_max_nm.is_none())
        {
            let what = format!("the generic drive of `{}` follows from it", joint.name);
            let lines = "torque_max_nm = …  # the data sheet: largest torque at the joint".to_owned();
            add(Use::Simulate, format!("joint[{k}].torque_max_nm"), what, lines);
        }
        let lines = format!("[generic_drives]\nvoltage_v = 48\n{}", lines_of(&GENERIC_DRIVES));
        let what = "the simulated cell moves drives; generic ones follow from speed and torque of the joints";
        add(Use::Simulate, "generic_drives".to_owned(), what.to_owned(), lines);
    }
    if (robot.drives().is_none() || generic) && !described {
        for (k, section) in root.sections("joint")?.iter().enumerate() {
            let what = format!("the module that moves `{}`", section.or("name", "?", Value::text)?);
            let lines = format!(
                "[joint.drive]\nmodule = …         # type as printed on it\naddress = {}\nfirmware = …       # `cubectl status` shows \
                 it\ngear_ratio = …\nencoder_slots = …\ncurrent_max_a = …\nk_b_a_s_rad = …    # `cubectl arm identify` measures both\n\
                 k_m_a_nm = …",
                k + 1
            );
            add(Use::RealBus, format!("joint[{k}].drive"), what, lines);
        }
        let joints: Vec<String> = robot.joints().iter().map(|joint| format!("{:?}", joint.name)).collect();
        let lines = format!(
            "[[supply]]\nname = \"arm\"\nvoltage_v = …\ncurrent_max_a = …\njoints = [{}]",
            joints.join(", ")
        );
        let instead = if generic { ", instead of [generic_drives]" } else { "" };
        add(Use::RealBus, "supply".to_owned(), format!("what the drives hang on{instead}"), lines);
    }
    if robot.drive_loop().is_none() {
        for purpose in [Use::Simulate, Use::RealBus] {
            let what = "lag and friction of the drives, for which gains are designed".to_owned();
            add(purpose, "drive_loop".to_owned(), what, format!("[drive_loop]\n{}", lines_of(&DRIVE_LOOP)));
        }
    }
    Ok(out)
}

fn lines_of(keys: &[(&str, &str, &str)]) -> String {
    let mark = crate::survey::ASSUMED;
    keys.iter()
        .map(|(key, value, why)| format!("{key} = {value}  {mark} {why}"))
        .collect::<Vec<_>>()
        .join("\n")
}
