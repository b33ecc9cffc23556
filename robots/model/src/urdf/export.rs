//! Export of a robot as URDF.

use std::fmt::Write;

use nalgebra::{Matrix3, Vector3};

use crate::boxes::BodyBox;
use crate::model::{LinkInertia, RobotModel};
use crate::pose::Pose;

/// Effort for a joint whose torque limit the robot file does not know: URDF needs a number, and zero would mean "no motor".
const EFFORT_UNKNOWN_NM: f64 = 1e4;

impl RobotModel {
    /// The robot as URDF text: links with inertials, box visuals and collisions, revolute joints with limits, and the
    /// frames `ee` (end effector) and `release` (ball) as massless links at the end.
    ///
    /// Link frames are the joint frames of [`RobotModel::fk`], axes along z. Numbers are written with all their digits,
    /// so a reader gets the same model back. Currents, accelerations and supplies have no place in URDF.
    #[must_use]
    pub fn to_urdf(&self) -> String {
        let mut out = String::from("<?xml version=\"1.0\"?>\n");
        let _ = self.write_urdf(&mut out);
        out
    }

    fn write_urdf(&self, out: &mut String) -> std::fmt::Result {
        writeln!(out, "<robot name=\"{}\">", escaped(&self.name))?;
        self.write_link(out, "base_link", 0, None)?;
        let link_name = |i: usize| escaped(&self.links[i].name.replace(' ', "_"));
        for (i, joint) in self.joints.iter().enumerate() {
            let parent = if i == 0 { "base_link".to_owned() } else { link_name(i - 1) };
            let l = &joint.limits;
            writeln!(out, "  <joint name=\"{}\" type=\"revolute\">", escaped(&joint.name))?;
            writeln!(out, "    <parent link=\"{parent}\"/>\n    <child link=\"{}\"/>", link_name(i))?;
            writeln!(out, "    {}", origin(&joint.x_pj))?;
            writeln!(out, "    <axis xyz=\"0 0 1\"/>")?;
            writeln!(
                out,
                "    <limit lower=\"{}\" upper=\"{}\" effort=\"{}\" velocity=\"{}\"/>\n  </joint>",
                l.q_min_rad,
                l.q_max_rad,
                l.torque_max_nm.unwrap_or(EFFORT_UNKNOWN_NM),
                l.v_max_rad_s
            )?;
            self.write_link(out, &link_name(i), i + 1, Some(&self.links[i].inertia))?;
        }
        let last = link_name(self.n() - 1);
        write_fixed(out, "ee", &last, &self.x_ne)?;
        write_fixed(out, "release", "ee", &self.gripper.x_eb)?;
        writeln!(out, "</robot>")
    }

    fn write_link(
        &self,
        out: &mut String,
        name: &str,
        link: usize,
        inertia: Option<&LinkInertia>,
    ) -> std::fmt::Result {
        writeln!(out, "  <link name=\"{name}\">")?;
        if let Some(inertia) = inertia {
            write_inertial(out, inertia)?;
        }
        for body in self.collision.boxes().iter().filter(|b| b.link == link) {
            for kind in ["visual", "collision"] {
                write_box(out, kind, body)?;
            }
        }
        writeln!(out, "  </link>")
    }
}

fn write_inertial(out: &mut String, inertia: &LinkInertia) -> std::fmt::Result {
    let i: &Matrix3<f64> = inertia.about_com_kg_m2();
    writeln!(out, "    <inertial>")?;
    writeln!(out, "      <origin xyz=\"{}\" rpy=\"0 0 0\"/>", triple(inertia.com_m()))?;
    writeln!(out, "      <mass value=\"{}\"/>", inertia.mass_kg())?;
    writeln!(
        out,
        "      <inertia ixx=\"{}\" ixy=\"{}\" ixz=\"{}\" iyy=\"{}\" iyz=\"{}\" izz=\"{}\"/>",
        i[(0, 0)],
        i[(0, 1)],
        i[(0, 2)],
        i[(1, 1)],
        i[(1, 2)],
        i[(2, 2)]
    )?;
    writeln!(out, "    </inertial>")
}

fn write_box(out: &mut String, kind: &str, body: &BodyBox) -> std::fmt::Result {
    writeln!(out, "    <{kind} name=\"{}\">", escaped(&body.name))?;
    writeln!(out, "      {}", origin(&body.x_lb))?;
    writeln!(out, "      <geometry><box size=\"{}\"/></geometry>", triple(&(body.half_m * 2.0)))?;
    writeln!(out, "    </{kind}>")
}

fn write_fixed(out: &mut String, name: &str, parent: &str, x: &Pose) -> std::fmt::Result {
    writeln!(out, "  <joint name=\"{name}_fixed\" type=\"fixed\">")?;
    writeln!(out, "    <parent link=\"{parent}\"/>\n    <child link=\"{name}\"/>\n    {}", origin(x))?;
    writeln!(out, "  </joint>\n  <link name=\"{name}\"/>")
}

fn origin(x: &Pose) -> String {
    format!("<origin xyz=\"{}\" rpy=\"{}\"/>", triple(&x.pos), triple(&Vector3::from(x.rpy_rad())))
}

fn triple(v: &Vector3<f64>) -> String {
    // Adding zero turns -0 into 0, which reads better.
    format!("{} {} {}", v.x + 0.0, v.y + 0.0, v.z + 0.0)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
