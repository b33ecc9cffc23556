//! Boxes and masses of the base and the links.

use nalgebra::{Matrix3, Vector3};
use toml_reader::{Problem as DocumentProblem, Value};

use super::Section;
use crate::boxes::BodyBox;
use crate::error::{LoadError, Problem};
use crate::model::{Link, LinkInertia};
use crate::pose::Pose;

/// The links, and all boxes (base = link 0) in joint frames.
pub(super) fn read(root: &Section<'_>, x_jl: &[Pose]) -> Result<(Vec<Link>, Vec<BodyBox>), LoadError> {
    let mut boxes = Vec::new();
    if let Some(base) = root.optional("base", Value::section)? {
        read_boxes(&base, 0, &Pose::identity(), &mut boxes)?;
        base.finish()?;
    }
    let sections = root.sections("link")?;
    if sections.len() != x_jl.len() {
        return Err(root.error("link", Problem::LinkCount { joints: x_jl.len(), links: sections.len() }));
    }
    let mut links: Vec<Link> = Vec::with_capacity(sections.len());
    for (i, section) in sections.iter().enumerate() {
        let name = section.required("name", Value::text)?.to_owned();
        if links.iter().any(|l| l.name == name) {
            return Err(section.error("name", Problem::Duplicate(name)));
        }
        let masses = read_boxes(section, i + 1, &x_jl[i], &mut boxes)?;
        let inertia = read_inertia(section, &x_jl[i], &masses)?;
        section.finish()?;
        links.push(Link { name, inertia, x_jl: x_jl[i] });
    }
    Ok((links, boxes))
}

/// Most boxes of a robot. The pairs to test grow with the square; real arms have one to three boxes per link.
const BOXES_MAX: usize = 500;

struct BoxMass {
    mass_kg: Option<f64>,
    x_jb: Pose,
    half_m: Vector3<f64>,
}

fn read_boxes(
    section: &Section<'_>,
    link: usize,
    x_jl: &Pose,
    boxes: &mut Vec<BodyBox>,
) -> Result<Vec<BoxMass>, LoadError> {
    let mut masses = Vec::new();
    for part in section.sections("box")? {
        if boxes.len() == BOXES_MAX {
            let (value, max) = (boxes.len() as f64 + 1.0, BOXES_MAX as f64);
            return Err(section.error("box", DocumentProblem::OutOfRange { value, min: 0.0, max }));
        }
        let name = part.required("name", Value::text)?.to_owned();
        if boxes.iter().any(|b| b.name == name) {
            return Err(part.error("name", Problem::Duplicate(name)));
        }
        let center = Vector3::from(part.required("center_m", Value::numbers::<3>)?);
        let rpy = part.or("rpy_deg", [0.0; 3], Value::numbers)?;
        let half_m = Vector3::from(part.required("half_m", Value::numbers::<3>)?);
        if let Some(bad) = half_m.iter().find(|h| **h <= 0.0) {
            return Err(part.error("half_m", DocumentProblem::NotPositive(*bad)));
        }
        // The base does not move, so a mass there would be a number without effect.
        let mass_kg = if link == 0 { None } else { part.optional("mass_kg", Value::positive)? };
        part.finish()?;
        let x_jb = *x_jl * Pose::from_rpy(rpy.map(f64::to_radians), center);
        masses.push(BoxMass { mass_kg, x_jb, half_m });
        boxes.push(BodyBox { name, link, x_lb: x_jb, half_m });
    }
    Ok(masses)
}

fn read_inertia(section: &Section<'_>, x_jl: &Pose, boxes: &[BoxMass]) -> Result<LinkInertia, LoadError> {
    if let Some(part) = section.optional("inertial", Value::section)? {
        if boxes.iter().any(|b| b.mass_kg.is_some()) {
            return Err(section.error("inertial", Problem::MassTwice));
        }
        let mass_kg = part.required("mass_kg", Value::positive)?;
        let com = Vector3::from(part.required("com_m", Value::numbers::<3>)?);
        let moments = part.required("moments_kg_m2", Value::numbers::<3>)?;
        let [xy, xz, yz] = part.or("products_kg_m2", [0.0; 3], Value::numbers)?;
        part.finish()?;
        let [xx, yy, zz] = moments;
        let tensor = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let about_com = symmetric(x_jl.rot * tensor * x_jl.rot.transpose());
        return LinkInertia::new(mass_kg, x_jl.transform_point(&com), about_com)
            .ok_or_else(|| part.error("moments_kg_m2", Problem::ImpossibleInertia(moments)));
    }
    let masses: Option<Vec<f64>> = boxes.iter().map(|b| b.mass_kg).collect();
    let masses = masses.filter(|m| !m.is_empty()).ok_or_else(|| section.error("box", Problem::NoMass))?;
    let mass_kg: f64 = masses.iter().sum();
    let com = boxes.iter().zip(&masses).map(|(b, m)| b.x_jb.pos * *m).sum::<Vector3<f64>>() / mass_kg;
    let mut about_com = Matrix3::zeros();
    for (b, m) in boxes.iter().zip(&masses) {
        let own = b.x_jb.rot * box_inertia(*m, &b.half_m) * b.x_jb.rot.transpose();
        let arm = b.x_jb.pos - com;
        about_com += own + (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * *m;
    }
    // Boxes of positive size and mass always make a possible body.
    LinkInertia::new(mass_kg, com, symmetric(about_com)).ok_or_else(|| section.error("box", Problem::NoMass))
}

/// Inertia of a uniform box about its centre, axes along its edges, from half sizes.
fn box_inertia(mass_kg: f64, half_m: &Vector3<f64>) -> Matrix3<f64> {
    let h = half_m.component_mul(half_m);
    Matrix3::from_diagonal(&(Vector3::new(h.y + h.z, h.x + h.z, h.x + h.y) * (mass_kg / 3.0)))
}

fn symmetric(m: Matrix3<f64>) -> Matrix3<f64> {
    (m + m.transpose()) * 0.5
}
