//! URDF text as links and joints, checked one by one.

use nalgebra::{Matrix3, Vector3};
use roxmltree::{Document, Node};

use super::mesh::MeshFiles;
use super::mesh_boxes::boxes_around;
use crate::pose::Pose;

/// A URDF file was refused: where, and why.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{file}:{line}: {problem}")]
pub struct UrdfError {
    /// File name as given by the caller.
    pub file: String,
    /// Line (from 1).
    pub line: u32,
    /// The reason.
    pub problem: UrdfProblem,
}

/// Reason for refusing a URDF file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum UrdfProblem {
    /// Not XML.
    #[error("not valid XML: {0}")]
    Syntax(String),
    /// The outermost element is another one.
    #[error("the outermost element is `{0}`, not `robot` (a xacro file must be expanded first)")]
    NotARobot(String),
    /// An attribute or element must be there.
    #[error("{place}: `{what}` is missing")]
    Missing {
        /// Link or joint.
        place: String,
        /// Element or attribute.
        what: &'static str,
    },
    /// An attribute is not what it should be.
    #[error("{place}: `{text}` is not {expected}")]
    BadValue {
        /// Link or joint.
        place: String,
        /// Text in the file.
        text: String,
        /// What is expected.
        expected: &'static str,
    },
    /// A joint type that a serial revolute arm does not have.
    #[error("joint `{joint}` is {kind}; only revolute, continuous and fixed joints are supported")]
    JointType {
        /// The joint.
        joint: String,
        /// Its type.
        kind: String,
    },
    /// A joint that follows another one.
    #[error("joint `{0}` mimics another joint, which a serial arm cannot have")]
    Mimic(String),
    /// Two moving joints start from one body.
    #[error("the arm branches at link `{link}`: joints {} both move from it", .joints.join(" and "))]
    Branch {
        /// The link.
        link: String,
        /// The joints.
        joints: Vec<String>,
    },
    /// Names used twice.
    #[error("`{0}` is used twice")]
    Duplicate(String),
    /// A joint names a link that is not there.
    #[error("joint `{joint}` names link `{link}`, which is not there")]
    UnknownLink {
        /// The joint.
        joint: String,
        /// The link.
        link: String,
    },
    /// Not exactly one link without a parent, or a loop.
    #[error("the links are not one tree: {0}")]
    NotATree(String),
    /// A moving link without mass.
    #[error("link `{0}` moves but has no inertial (its mass and inertia are needed)")]
    NoInertial(String),
    /// No moving joint at all.
    #[error("no joint moves")]
    NoJoints,
    /// More joints in a row than an arm may have.
    #[error("{found} joints move in a row; at most {max} can be led")]
    TooManyJoints {
        /// Joints in a row.
        found: usize,
        /// Most that can be led.
        max: usize,
        /// Link behind the last joint that can be led.
        last: String,
    },
    /// The requested end effector is not a link of the file.
    #[error("`{wanted}` is not a link of this file (there: {})", .there.join(", "))]
    NoSuchEndEffector {
        /// Requested name.
        wanted: String,
        /// Links of the file.
        there: Vec<String>,
    },
}

impl UrdfProblem {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Branch { .. } => "`--end-effector LINK` names the end of the arm".to_owned(),
            Self::TooManyJoints { max, last, .. } => {
                format!("`--end-effector LINK` ends the arm at a link before (`{last}` is the {max}th)")
            }
            _ => return None,
        })
    }
}

/// Mass, centre and inertia (about the centre, axes of the link).
#[derive(Debug, Clone, Copy)]
pub(super) struct Inertial {
    pub(super) mass_kg: f64,
    pub(super) com_m: Vector3<f64>,
    pub(super) about_com: Matrix3<f64>,
}

#[derive(Debug, Clone)]
pub(super) struct CollisionBox {
    pub(super) name: String,
    pub(super) pose: Pose,
    pub(super) half_m: Vector3<f64>,
}

#[derive(Debug, Clone)]
pub(super) struct UrdfLink {
    pub(super) name: String,
    pub(super) line: u32,
    pub(super) inertial: Option<Inertial>,
    pub(super) boxes: Vec<CollisionBox>,
    pub(super) left_out: Vec<String>,
}

/// Motion that a joint allows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Turn {
    pub(super) axis: Vector3<f64>,
    /// Range in rad; `None` for a continuous joint.
    pub(super) range_rad: Option<[f64; 2]>,
    pub(super) velocity_rad_s: Option<f64>,
    pub(super) effort_nm: Option<f64>,
}

#[derive(Debug, Clone)]
pub(super) struct UrdfJoint {
    pub(super) name: String,
    pub(super) line: u32,
    pub(super) parent: usize,
    pub(super) child: usize,
    pub(super) origin: Pose,
    /// `None` for a fixed joint, and for a kind of joint that an arm does not have.
    pub(super) turn: Option<Turn>,
    /// Kind of a joint that an arm does not have, such as `prismatic` or `mimic`.
    pub(super) foreign: Option<String>,
}

#[derive(Debug, Clone)]
pub(super) struct UrdfTree {
    pub(super) name: String,
    pub(super) links: Vec<UrdfLink>,
    pub(super) joints: Vec<UrdfJoint>,
}

/// Reads text with places for error messages.
pub(super) struct Reader<'a> {
    pub(super) file: &'a str,
    pub(super) meshes: &'a MeshFiles<'a>,
}

impl Reader<'_> {
    /// Why a joint that no arm has cannot be part of one.
    pub(super) fn foreign(&self, joint: &UrdfJoint) -> Option<UrdfError> {
        let kind = joint.foreign.as_ref()?;
        let problem = match kind.as_str() {
            "mimic" => UrdfProblem::Mimic(joint.name.clone()),
            _ => UrdfProblem::JointType { joint: joint.name.clone(), kind: kind.clone() },
        };
        Some(self.error(joint.line, problem))
    }

    pub(super) fn error(&self, line: u32, problem: UrdfProblem) -> UrdfError {
        UrdfError { file: self.file.to_owned(), line, problem }
    }

    fn at(&self, node: Node<'_, '_>, problem: UrdfProblem) -> UrdfError {
        self.error(line_of(node), problem)
    }

    pub(super) fn read(&self, text: &str) -> Result<UrdfTree, UrdfError> {
        let document =
            Document::parse(text).map_err(|e| self.error(e.pos().row, UrdfProblem::Syntax(e.to_string())))?;
        let root = document.root_element();
        if root.tag_name().name() != "robot" {
            return Err(self.at(root, UrdfProblem::NotARobot(root.tag_name().name().to_owned())));
        }
        let name = root.attribute("name").unwrap_or("robot").to_owned();
        let mut links: Vec<UrdfLink> = Vec::new();
        for node in elements(root, "link") {
            let link = self.read_link(node)?;
            if links.iter().any(|l| l.name == link.name) {
                return Err(self.at(node, UrdfProblem::Duplicate(link.name)));
            }
            links.push(link);
        }
        let mut joints: Vec<UrdfJoint> = Vec::new();
        for node in elements(root, "joint") {
            let joint = self.read_joint(node, &links)?;
            if joints.iter().any(|j| j.name == joint.name) {
                return Err(self.at(node, UrdfProblem::Duplicate(joint.name)));
            }
            joints.push(joint);
        }
        Ok(UrdfTree { name, links, joints })
    }

    fn read_link(&self, node: Node<'_, '_>) -> Result<UrdfLink, UrdfError> {
        let name = self.attribute(node, "a link", "name")?.to_owned();
        let place = format!("link `{name}`");
        let inertial = match element(node, "inertial") {
            Some(part) => Some(self.read_inertial(part, &place)?),
            None => None,
        };
        let mut link =
            UrdfLink { line: line_of(node), inertial, boxes: Vec::new(), left_out: Vec::new(), name };
        let shapes = if element(node, "collision").is_some() { "collision" } else { "visual" };
        for (k, part) in elements(node, shapes).enumerate() {
            let name = match part.attribute("name").filter(|given| !given.is_empty()) {
                Some(given) => given.to_owned(),
                None => format!("{} {}", link.name, k + 1),
            };
            let pose = self.read_origin(part, &place)?;
            let shape = element(part, "geometry").and_then(|g| g.children().find(Node::is_element));
            let shape = shape.ok_or_else(|| {
                self.at(part, UrdfProblem::Missing { place: place.clone(), what: "collision geometry" })
            })?;
            if let Some(half_m) = self.half_sizes(shape, &place)? {
                link.boxes.push(CollisionBox { name, pose, half_m });
                continue;
            }
            match self.mesh_boxes(shape, &place)? {
                Ok(boxes) => link.boxes.extend(boxes.into_iter().map(|(x, half_m)| CollisionBox {
                    name: name.clone(),
                    pose: pose * x,
                    half_m,
                })),
                Err(why) => link.left_out.push(format!(
                    "{place}: {} `{name}` is left out of the collision model: {why}",
                    shape.tag_name().name()
                )),
            }
        }
        Ok(link)
    }

    /// Half sizes of a box, or of the box around a cylinder or sphere; `None` for shapes only other files describe.
    fn half_sizes(&self, shape: Node<'_, '_>, place: &str) -> Result<Option<Vector3<f64>>, UrdfError> {
        let half = match shape.tag_name().name() {
            "box" => self.triple(shape, place, "size")? * 0.5,
            "cylinder" => {
                let radius = self.number(shape, place, "radius")?;
                Vector3::new(radius, radius, self.number(shape, place, "length")? * 0.5)
            }
            "sphere" => Vector3::repeat(self.number(shape, place, "radius")?),
            _ => return Ok(None),
        };
        if half.iter().all(|h| *h > 0.0) {
            Ok(Some(half))
        } else {
            let text = format!("{} {} {}", half.x, half.y, half.z);
            let problem =
                UrdfProblem::BadValue { place: place.to_owned(), text, expected: "a size above zero" };
            Err(self.at(shape, problem))
        }
    }

    /// Boxes around a mesh, or the reason why there are no boxes.
    #[expect(clippy::type_complexity, reason = "a refusal of the file, and a reason to leave out the mesh")]
    fn mesh_boxes(
        &self,
        shape: Node<'_, '_>,
        place: &str,
    ) -> Result<Result<Vec<(Pose, Vector3<f64>)>, String>, UrdfError> {
        if !shape.has_tag_name("mesh") {
            return Ok(Err(format!("the shape `{}` is not known", shape.tag_name().name())));
        }
        let name = self.attribute(shape, place, "filename")?;
        let scale = match shape.has_attribute("scale") {
            true => self.triple(shape, place, "scale")?,
            false => Vector3::repeat(1.0),
        };
        let mesh = (self.meshes)(name).and_then(|bytes| super::mesh::triangles(name, &bytes));
        Ok(mesh.and_then(|mut triangles| {
            triangles.iter_mut().flatten().for_each(|corner| corner.component_mul_assign(&scale));
            boxes_around(&triangles).ok_or_else(|| format!("{name} has no surface"))
        }))
    }

    fn read_inertial(&self, node: Node<'_, '_>, place: &str) -> Result<Inertial, UrdfError> {
        let missing = |what| self.at(node, UrdfProblem::Missing { place: place.to_owned(), what });
        let mass = element(node, "mass").ok_or_else(|| missing("mass"))?;
        let inertia = element(node, "inertia").ok_or_else(|| missing("inertia"))?;
        let x = self.read_origin(node, place)?;
        let i = |key| self.number(inertia, place, key);
        let (ixy, ixz, iyz) = (i("ixy")?, i("ixz")?, i("iyz")?);
        let tensor = Matrix3::new(i("ixx")?, ixy, ixz, ixy, i("iyy")?, iyz, ixz, iyz, i("izz")?);
        let about_com = x.rot * tensor * x.rot.transpose();
        Ok(Inertial { mass_kg: self.number(mass, place, "value")?, com_m: x.pos, about_com })
    }

    fn read_joint(&self, node: Node<'_, '_>, links: &[UrdfLink]) -> Result<UrdfJoint, UrdfError> {
        let name = self.attribute(node, "a joint", "name")?.to_owned();
        let place = format!("joint `{name}`");
        let kind = self.attribute(node, &place, "type")?;
        let end = |what: &'static str| {
            let part = element(node, what)
                .ok_or_else(|| self.at(node, UrdfProblem::Missing { place: place.clone(), what }))?;
            let link = self.attribute(part, &place, "link")?;
            links.iter().position(|l| l.name == link).ok_or_else(|| {
                self.at(part, UrdfProblem::UnknownLink { joint: name.clone(), link: link.to_owned() })
            })
        };
        let (parent, child) = (end("parent")?, end("child")?);
        let (turn, foreign) = match kind {
            _ if element(node, "mimic").is_some() => (None, Some("mimic".to_owned())),
            "fixed" => (None, None),
            "revolute" | "continuous" => (Some(self.read_turn(node, &place, kind == "continuous")?), None),
            other => (None, Some(other.to_owned())),
        };
        let origin = self.read_origin(node, &place)?;
        Ok(UrdfJoint { name, line: line_of(node), parent, child, origin, turn, foreign })
    }

    fn read_turn(&self, node: Node<'_, '_>, place: &str, continuous: bool) -> Result<Turn, UrdfError> {
        let axis = match element(node, "axis") {
            Some(part) => self.triple(part, place, "xyz")?,
            None => Vector3::x(),
        };
        let bad_axis = || {
            let text = format!("{} {} {}", axis.x, axis.y, axis.z);
            self.at(node, UrdfProblem::BadValue { place: place.to_owned(), text, expected: "an axis" })
        };
        let axis = axis.try_normalize(1e-9).ok_or_else(bad_axis)?;
        let limit = element(node, "limit");
        let optional = |key: &'static str| match limit {
            Some(part) if part.has_attribute(key) => self.number(part, place, key).map(Some),
            _ => Ok(None),
        };
        let range_rad = if continuous {
            None
        } else {
            let part = limit.ok_or_else(|| {
                self.at(node, UrdfProblem::Missing { place: place.to_owned(), what: "limit" })
            })?;
            Some([self.number(part, place, "lower")?, self.number(part, place, "upper")?])
        };
        Ok(Turn { axis, range_rad, velocity_rad_s: optional("velocity")?, effort_nm: optional("effort")? })
    }

    fn read_origin(&self, node: Node<'_, '_>, place: &str) -> Result<Pose, UrdfError> {
        let Some(origin) = element(node, "origin") else {
            return Ok(Pose::identity());
        };
        let triple_or_zero = |key| {
            if origin.has_attribute(key) { self.triple(origin, place, key) } else { Ok(Vector3::zeros()) }
        };
        let rpy = triple_or_zero("rpy")?;
        Ok(Pose::from_rpy(rpy.into(), triple_or_zero("xyz")?))
    }

    fn attribute<'n>(
        &self,
        node: Node<'n, '_>,
        place: &str,
        what: &'static str,
    ) -> Result<&'n str, UrdfError> {
        node.attribute(what)
            .ok_or_else(|| self.at(node, UrdfProblem::Missing { place: place.to_owned(), what }))
    }

    fn number(&self, node: Node<'_, '_>, place: &str, key: &'static str) -> Result<f64, UrdfError> {
        let text = self.attribute(node, place, key)?;
        finite(text).ok_or_else(|| {
            let problem = UrdfProblem::BadValue {
                place: place.to_owned(),
                text: text.to_owned(),
                expected: "a finite number",
            };
            self.at(node, problem)
        })
    }

    fn triple(&self, node: Node<'_, '_>, place: &str, key: &'static str) -> Result<Vector3<f64>, UrdfError> {
        let text = self.attribute(node, place, key)?;
        let numbers: Option<Vec<f64>> = text.split_whitespace().map(finite).collect();
        match numbers.as_deref() {
            Some([x, y, z]) => Ok(Vector3::new(*x, *y, *z)),
            _ => {
                let problem = UrdfProblem::BadValue {
                    place: place.to_owned(),
                    text: text.to_owned(),
                    expected: "three finite numbers",
                };
                Err(self.at(node, problem))
            }
        }
    }
}

fn finite(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|v: &f64| v.is_finite())
}

fn line_of(node: Node<'_, '_>) -> u32 {
    node.document().text_pos_at(node.range().start).row
}

fn element<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> Option<Node<'a, 'i>> {
    node.children().find(|n| n.has_tag_name(name))
}

fn elements<'a, 'i: 'a>(node: Node<'a, 'i>, name: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |n| n.has_tag_name(name))
}
