//! Writes a robot file.

use std::fmt::Write;

use nalgebra::Vector3;
use toml_reader::quoted;

use super::parts::{Axis, Body, UrdfOptions};
use crate::family::Family;
use crate::load::{SCHEMA_VERSION, turn_z_to};
use crate::pose::Pose;
use crate::survey::ASSUMED;

/// The robot file for a chain of axes; `end_effector` is in the frame of the last body.
pub(super) fn robot_file(
    name: &str,
    file: &str,
    base: &Body,
    axes: &[Axis],
    end_effector: &Pose,
    notes: &[String],
    options: &UrdfOptions,
) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_robot(&mut out, name, file, base, axes, end_effector, notes, options);
    out
}

#[expect(clippy::too_many_arguments, reason = "one page of text with everything it tells")]
fn write_robot(
    out: &mut String,
    name: &str,
    file: &str,
    base: &Body,
    axes: &[Axis],
    end_effector: &Pose,
    notes: &[String],
    options: &UrdfOptions,
) -> std::fmt::Result {
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
    writeln!(out, "[world]\ngravity_m_s2 = 9.81\nfloor_z_m = {:?}", options.floor_z_m)?;
    for axis in axes {
        write_joint(out, axis, options)?;
    }
    writeln!(out, "\n[end_effector]\n{}", pose_keys(end_effector, "\n"))?;
    writeln!(out, "\n[gripper]\nrelease_x_axis = [1, 0, 0]\nrelease_y_axis = [0, 1, 0]")?;
    writeln!(out, "release_z_axis = [0, 0, 1]  {ASSUMED} the ball leaves along z of the end effector")?;
    writeln!(out, "release_origin_m = [0, 0, 0]  {ASSUMED} the ball is held at the end effector")?;
    writeln!(out, "ball_radius_m = 0.03  {ASSUMED} URDF has no ball")?;
    writeln!(out, "ball_mass_kg = 0  {ASSUMED} URDF has no ball; 0 leaves its mass out of torques")?;
    let floor_from_link = 2.min(axes.len());
    let link_distance_min = 2.min(axes.len());
    writeln!(
        out,
        "\n[collision]\nlink_distance_min = {link_distance_min}\nfloor_from_link = {floor_from_link}"
    )?;
    // Box names must be unique in a robot; URDF does not ask for that.
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

fn write_joint(out: &mut String, axis: &Axis, options: &UrdfOptions) -> std::fmt::Result {
    let [low, high] = axis.turn.range_rad.map_or([-180.0, 180.0], |r| r.map(f64::to_degrees));
    let velocity = axis.turn.velocity_rad_s.unwrap_or(options.velocity_default_rad_s).to_degrees();
    let acceleration = velocity * options.acceleration_per_velocity_1_s;
    let jerk = acceleration * options.jerk_per_acceleration_1_s;
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
    match axis.turn.effort_nm {
        Some(effort) if effort > 0.0 => writeln!(out, "torque_max_nm = {effort:?}"),
        _ => writeln!(out, "# torque_max_nm = 0  {ASSUMED} no limit; the file gives no effort"),
    }
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

fn degrees(x: &Pose) -> Vector3<f64> {
    Vector3::from(x.rpy_rad()).map(f64::to_degrees)
}

fn triple(v: &Vector3<f64>) -> String {
    format!("[{:?}, {:?}, {:?}]", v.x + 0.0, v.y + 0.0, v.z + 0.0)
}
