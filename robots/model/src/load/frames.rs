//! Joint frames in the conventions of robot files, converted to one form.
//!
//! Inside, every joint turns about the z axis of its joint frame, and that frame is the frame of its link. The
//! file's own link frame may differ (standard DH puts it at the far end, a fixed axis may be x or -y), so its pose
//! in the joint frame is kept: boxes and inertias of the file are given in it.

use nalgebra::{Matrix3, Vector3};
use toml_reader::Value;

use super::Section;
use crate::error::{LoadError, Problem};
use crate::pose::Pose;

/// Frames of all joints.
pub(super) struct JointFrames {
    /// Joint frame in the joint frame before, at q = 0.
    pub(super) x_pj: Vec<Pose>,
    /// The file's link frame in the joint frame.
    pub(super) x_jl: Vec<Pose>,
}

#[derive(Clone, Copy)]
enum Convention {
    /// Craig: T(i-1,i) = RotX(alpha) TransX(a) RotZ(q + offset) TransZ(d).
    ModifiedDh,
    /// T(i-1,i) = RotZ(q + offset) TransZ(d) TransX(a) RotX(alpha).
    StandardDh,
    /// Fixed pose, then a turn about a given axis (as in URDF).
    FixedAxis,
}

pub(super) fn read(root: &Section<'_>, joints: &[Section<'_>]) -> Result<JointFrames, LoadError> {
    const CONVENTIONS: [(&str, Convention); 3] = [
        ("modified_dh", Convention::ModifiedDh),
        ("standard_dh", Convention::StandardDh),
        ("fixed_axis", Convention::FixedAxis),
    ];
    let convention = root.required("frame_convention", |v| v.word(&CONVENTIONS))?;
    let mut frames = JointFrames { x_pj: Vec::new(), x_jl: Vec::new() };
    // The file's frame of the link before, in the joint frame before.
    let mut x_before = Pose::identity();
    for joint in joints {
        let section = joint.required("frame", Value::section)?;
        let (x_lj, x_jl) = match convention {
            Convention::ModifiedDh => {
                let dh = read_dh(&section)?;
                (dh.rot_x * dh.trans_x * dh.trans_z * dh.rot_z, Pose::identity())
            }
            Convention::StandardDh => {
                let dh = read_dh(&section)?;
                (dh.rot_z, dh.trans_z * dh.trans_x * dh.rot_x)
            }
            Convention::FixedAxis => {
                let turn = z_to(&section)?;
                (read_pose_keys(&section)? * turn, turn.inverse())
            }
        };
        section.finish()?;
        frames.x_pj.push(x_before * x_lj);
        frames.x_jl.push(x_jl);
        x_before = x_jl;
    }
    Ok(frames)
}

/// A pose given as `xyz_m` and `rpy_deg` (fixed axes; both default to zero).
pub(super) fn read_pose(section: &Section<'_>) -> Result<Pose, LoadError> {
    let pose = read_pose_keys(section)?;
    section.finish()?;
    Ok(pose)
}

fn read_pose_keys(section: &Section<'_>) -> Result<Pose, LoadError> {
    let xyz = section.or("xyz_m", [0.0; 3], Value::numbers)?;
    let rpy = section.or("rpy_deg", [0.0; 3], Value::numbers)?;
    Ok(Pose::from_rpy(rpy.map(f64::to_radians), xyz.into()))
}

struct Dh {
    rot_x: Pose,
    trans_x: Pose,
    trans_z: Pose,
    rot_z: Pose,
}

fn read_dh(section: &Section<'_>) -> Result<Dh, LoadError> {
    Ok(Dh {
        rot_x: Pose::rot_x(section.required("alpha_deg", Value::number)?.to_radians()),
        trans_x: Pose::translation(section.required("a_m", length)?, 0.0, 0.0),
        trans_z: Pose::translation(0.0, 0.0, section.required("d_m", length)?),
        rot_z: Pose::rot_z(section.or("offset_deg", 0.0, Value::number)?.to_radians()),
    })
}

/// A length between joints; the bound detects millimetres in a key in metres.
fn length(value: &Value<'_, Problem>) -> Result<f64, LoadError> {
    value.number_in(-LENGTH_MAX_M, LENGTH_MAX_M)
}

/// Longer than any arm, in m.
const LENGTH_MAX_M: f64 = 20.0;

fn z_to(section: &Section<'_>) -> Result<Pose, LoadError> {
    let axis = Vector3::from(section.required("axis", Value::numbers::<3>)?);
    turn_z_to(&axis).ok_or_else(|| section.error("axis", Problem::ZeroAxis))
}

/// A rotation whose z axis is along `axis`; `None` if the axis has no direction.
///
/// Exact for the six coordinate directions.
pub(crate) fn turn_z_to(axis: &Vector3<f64>) -> Option<Pose> {
    let z = axis.try_normalize(1e-9)?;
    // The coordinate axis least along z gives the best conditioned x axis; for the usual axes the result is exact.
    let x_hint = if z.z.abs() > 0.9 { Vector3::x() } else { Vector3::z() };
    let y = z.cross(&x_hint).normalize();
    let x = y.cross(&z);
    Some(Pose::new(Matrix3::from_columns(&[x, y, z]), Vector3::zeros()))
}
