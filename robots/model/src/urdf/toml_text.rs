//! Writes a robot file.

use std::fmt::Write;

use nalgebra::Vector3;
use toml_reader::quoted;

use super::parts::{Axis, BALL_RADIUS_M, Body, Draft, Effort, UrdfOptions};
use crate::family::Family;
use crate::load::{SCHEMA_VERSION, turn_z_to};
use crate::pose::Pose;
use crate::survey::ASSUMED;
use crate::uses::{DRIVE_LOOP, GENERIC_DRIVES};

/// The robot file for a chain of axes.
pub(super) fn robot_file(draft: &Draft<'_>, options: &UrdfOptions) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_robot(&mut out, draft, options);
    out
}

fn write_robot(out: &mut String, draft: &Draft<'_>, options: &UrdfOptions) -> std::fmt::Result {
    let Draft { name, file, base, axes, end_effector, release, notes, .. } = draft;
    writeln!(
        out,
        "# Made from the URDF file {}. `cubectl robot check` lists the values with a mark. Notes:",
        file.replace(['\n', '\r'], " ")
    )?;
    for note in notes {
        writeln!(out, "# - {}", note.replace(['\n', '\r'], " "))?;
    }
    writeln!(out, "schema = {SCHEMA_VERSION}\nname = {}", quoted(name))?;
    writeln!(out, "description = {}", quoted(&format!("{name}, from URDF")))?;
    writeln!(out, "family = {}", quoted(family(axes, end_effector).name()))?;
    writeln!(out, "frame_convention = \"fixed_axis\"\n")?;
    let given = options.floor_z_m.is_some() || draft.floor_z_m == 0.0;
    let lower = if given { String::new() } else { format!("  {ASSUMED} so low that the arm is free of it") };
    writeln!(out, "[world]\ngravity_m_s2 = 9.81\nfloor_z_m = {:?}{lower}", draft.floor_z_m)?;
    for (axis, effort) in axes.iter().zip(&draft.efforts) {
        write_joint(out, axis, effort, options)?;
    }
    write_drives(out, draft)?;
    writeln!(out, "\n[end_effector]\n{}", pose_keys(end_effector, "\n"))?;
    let column = |k: usize| triple(&release.rot.column(k).into());
    writeln!(out, "\n[gripper]\nrelease_x_axis = {}\nrelease_y_axis = {}", column(0), column(1))?;
    writeln!(out, "release_z_axis = {}  {ASSUMED} the ball leaves across the tool", column(2))?;
    writeln!(
        out,
        "release_origin_m = {}  {ASSUMED} the ball is held in front of the hand, free of its boxes",
        triple(&release.pos)
    )?;
    writeln!(out, "ball_radius_m = {BALL_RADIUS_M}  {ASSUMED} URDF has no ball")?;
    writeln!(out, "ball_mass_kg = 0  {ASSUMED} URDF has no ball; 0 leaves its mass out of torques")?;
    let link_distance_min = 2.min(axes.len());
    writeln!(
        out,
        "\n[collision]\nlink_distance_min = {link_distance_min}\nfloor_from_link = {}",
        draft.floor_from_link
    )?;
    if !draft.untested.is_empty() {
        let name = |link: usize| link.checked_sub(1).map_or("base", |k| axes[k].body.name.as_str());
        let pair = |[a, b]: &[usize; 2]| format!("[{}, {}]", quoted(name(*a)), quoted(name(*b)));
        let pairs: Vec<String> = draft.untested.iter().map(pair).collect();
        writeln!(out, "untested = [{}]", pairs.join(", "))?;
    }
    // Box names must be unique in a robot; URDF does not require that.
    let mut count = 0;
    writeln!(out, "\n[base]")?;
    write_boxes(out, base, &mut count)?;
    for axis in axes {
        writeln!(out, "\n[[link]]\nname = {}", quoted(&axis.body.name))?;
        if let Some(i) = &axis.body.inertial {
            let t = &i.about_com;
            writeln!(
                out,
                "inertial = {{ mass_kg = {:?}, com_m = {}, moments_kg_m2 = {}, products_kg_m2 = {} }}",
                i.mass_kg,
                triple(&i.com_m),
                triple(&t.diagonal()),
                triple(&Vector3::new(t[(0, 1)], t[(0, 2)], t[(1, 2)]))
            )?;
        }
        write_boxes(out, &axis.body, &mut count)?;
    }
    Ok(())
}

fn write_joint(out: &mut String, axis: &Axis, effort: &Effort, options: &UrdfOptions) -> std::fmt::Result {
    let [low, high] = axis.turn.range_rad.map_or([-180.0, 180.0], |r| r.map(|q| whole(q.to_degrees())));
    let velocity = whole(axis.turn.velocity_rad_s.unwrap_or(options.velocity_default_rad_s).to_degrees());
    let acceleration = plain(velocity * options.acceleration_per_velocity_1_s, 1e6);
    let jerk = plain(acceleration * options.jerk_per_acceleration_1_s, 1e6);
    let frame = pose_keys(&axis.origin, ", ");
    writeln!(out, "\n[[joint]]\nname = {}", quoted(&axis.name))?;
    writeln!(out, "frame = {{ {frame}, axis = {} }}", triple(&axis.turn.axis))?;
    let mark = |given: bool, why: &str| if given { String::new() } else { format!("  {ASSUMED} {why}") };
    let range = mark(axis.turn.range_rad.is_some(), "the joint is continuous");
    writeln!(out, "range_deg = [{low:?}, {high:?}]{range}")?;
    let speed = mark(axis.turn.velocity_rad_s.is_some(), "the file gives no speed");
    writeln!(out, "velocity_max_deg_s = {velocity:?}{speed}")?;
    let (a, j) = (options.acceleration_per_velocity_1_s, options.jerk_per_acceleration_1_s);
    writeln!(
        out,
        "acceleration_max_deg_s2 = {acceleration:?}  {ASSUMED} {a} times the speed; URDF has none"
    )?;
    writeln!(out, "jerk_max_deg_s3 = {jerk:?}  {ASSUMED} {j} times the acceleration; URDF has none")?;
    let torque = mark(effort.given, "twice what gravity asks for at full stretch; the file gives no effort");
    writeln!(out, "torque_max_nm = {:?}{torque}", effort.nm)
}

/// Drives for the simulator.
fn write_drives(out: &mut String, draft: &Draft<'_>) -> std::fmt::Result {
    writeln!(
        out,
        "\n# URDF has no drives. These follow from speed and torque of each joint (robots/README.md), for simulations."
    )?;
    writeln!(out, "[generic_drives]")?;
    writeln!(out, "voltage_v = {:?}  {ASSUMED} a usual voltage of such arms", draft.voltage_v)?;
    write_assumed(out, &GENERIC_DRIVES)?;
    writeln!(out, "\n[drive_loop]")?;
    write_assumed(out, &DRIVE_LOOP)
}

fn write_assumed(out: &mut String, keys: &[(&str, &str, &str)]) -> std::fmt::Result {
    keys.iter().try_for_each(|(key, value, why)| writeln!(out, "{key} = {value}  {ASSUMED} {why}"))
}

fn write_boxes(out: &mut String, body: &Body, count: &mut usize) -> std::fmt::Result {
    if body.boxes.is_empty() {
        return Ok(());
    }
    writeln!(out, "box = [")?;
    for (name, x, half) in &body.boxes {
        *count += 1;
        writeln!(
            out,
            "  {{ name = {}, center_m = {}, rpy_deg = {}, half_m = {} }},",
            quoted(&format!("{name} #{count}")),
            triple(&x.pos),
            triple(&degrees(x)),
            triple(half)
        )?;
    }
    writeln!(out, "]")
}

/// The kinematic family of the chain, by the same rules as the loader's.
fn family(axes: &[Axis], end_effector: &Pose) -> Family {
    let mut before = Pose::identity();
    let mut x_pj = Vec::new();
    for axis in axes {
        let Some(turn) = turn_z_to(&axis.turn.axis) else { return Family::General };
        x_pj.push(before * axis.origin * turn);
        before = turn.inverse();
    }
    Family::recognise(&x_pj, &(before * *end_effector))
}

fn pose_keys(x: &Pose, separator: &str) -> String {
    format!("xyz_m = {}{separator}rpy_deg = {}", triple(&x.pos), triple(&degrees(x)))
}

/// A quarter turn in a URDF file is written with three to sixteen digits.
const QUARTER_DEG: f64 = 1e-3;
/// A whole degree likewise, with nine digits or more.
const WHOLE_DEG: f64 = 1e-6;
/// Digits that are no rounding error: 1e-13 degrees, 1e-15 m.
const DEGREES: f64 = 1e13;
const METRES: f64 = 1e15;

fn degrees(x: &Pose) -> Vector3<f64> {
    Vector3::from(x.rpy_rad()).map(|angle| {
        let deg = angle.to_degrees();
        let quarter = (deg / 90.0).round() * 90.0;
        if (deg - quarter).abs() < QUARTER_DEG { quarter } else { whole(deg) }
    })
}

fn whole(deg: f64) -> f64 {
    if (deg - deg.round()).abs() < WHOLE_DEG { deg.round() + 0.0 } else { plain(deg, DEGREES) }
}

/// A number without the digits of its rounding error; -0 becomes 0.
fn plain(v: f64, digits: f64) -> f64 {
    let rounded = (v * digits).round() / digits;
    if rounded.is_finite() { rounded + 0.0 } else { v }
}

fn triple(v: &Vector3<f64>) -> String {
    let [x, y, z] = [v.x, v.y, v.z].map(|c| plain(c, METRES));
    format!("[{x:?}, {y:?}, {z:?}]")
}
