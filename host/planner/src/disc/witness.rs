//! The observer: judges a catch from joint angles and disc poses, by geometry alone.
//!
//! It knows no plan and no stage. It places the boxes and the hand by the robot model, samples the surface of the
//! disc, and checks where these points are: between the fingers, in a finger, in a box of the arm. Speeds and
//! accelerations are differences of the joint angles.

use nalgebra::Vector3;
use robot_model::collision::{CollisionChecker, Scene};

use robot_model::JointVec;

use super::Joints;
use super::arm::DiscArm;
use super::flight::Path;

/// The gripper: two plates along the hand, above and below the disc. The paper gives only its length; width, gap and
/// thickness are chosen, inside the gripper box of the robot file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gripper {
    /// Half the width of the plates across the hand, m.
    pub half_width_m: f64,
    /// Half the gap between the open plates, m.
    pub half_gap_m: f64,
    /// Outer face of a plate from the middle, m.
    pub outer_m: f64,
}

impl Default for Gripper {
    fn default() -> Self {
        Self { half_width_m: 0.02, half_gap_m: 0.02, outer_m: 0.03 }
    }
}

/// When a disc counts as caught: it stays between the fingers, deep enough, for as long as they need to close.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// How far the tip must be inside the rim, m.
    pub depth_min_m: f64,
    /// How far the disc's centre may be from the hand's plane, m.
    pub lateral_max_m: f64,
    /// How long, s.
    pub dwell_s: f64,
}

impl Default for Rule {
    /// Chosen: 4 cm deep, 5 cm across, 20 ms.
    fn default() -> Self {
        Self { depth_min_m: 0.04, lateral_max_m: 0.05, dwell_s: 0.02 }
    }
}

impl Rule {
    /// The paper's end of a capture: the tip at the disc's axis of symmetry (within 5 mm), at once.
    #[must_use]
    pub fn of_paper(arm: &DiscArm) -> Self {
        Self { depth_min_m: arm.size.disc_radius_m - 0.005, lateral_max_m: 0.005, dwell_s: 0.0 }
    }
}

/// Arm and disc at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Time, s.
    pub t_s: f64,
    /// Joint angles, rad.
    pub q: Joints,
    /// Centre of the disc, m.
    pub center_m: Vector3<f64>,
    /// Unit normal of the disc.
    pub normal: Vector3<f64>,
}

/// Moments of a motion and a flight, every millisecond from 0 to `until_s`.
#[must_use]
pub fn moments(q_at: impl Fn(f64) -> Joints, path: &Path, until_s: f64) -> Vec<Moment> {
    (0..=(until_s.clamp(0.0, 60.0) / 0.001).ceil() as u32)
        .map(|k| {
            let t_s = f64::from(k) * 0.001;
            let disc = path.at(t_s);
            Moment { t_s, q: q_at(t_s), center_m: disc.p_m, normal: disc.normal }
        })
        .collect()
}

/// Where the disc is, seen from the hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Time, s.
    pub t_s: f64,
    /// Tip of the gripper inside the rim, m; negative: outside.
    pub depth_m: f64,
    /// Tip of the gripper to the disc's axis of symmetry, m.
    pub tip_to_axis_m: f64,
    /// Disc's centre above the hand's middle plane, m.
    pub height_m: f64,
    /// Disc's centre beside the hand's plane, m.
    pub lateral_m: f64,
    /// Angle between disc and hand, rad.
    pub tilt_rad: f64,
}

/// First contact of the disc before it is caught.
#[derive(Debug, Clone, PartialEq)]
pub struct Touch {
    /// Time, s.
    pub t_s: f64,
    pub body: String,
}

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// The disc at the end of the dwell, if it is caught; the index of the moment first.
    pub caught: Option<(usize, Seen)>,
    /// First contact before that.
    pub touched: Option<Touch>,
    /// The moment with the tip nearest to the disc's axis.
    pub nearest: Option<Seen>,
    /// Least distance of the arm to itself and the floor, m.
    pub clearance_m: f64,
    /// Largest joint speeds, rad/s.
    pub speed_rad_s: Joints,
    /// Largest joint accelerations, rad/s².
    pub acceleration_rad_s2: Joints,
    /// Largest distance beyond a joint range, rad; negative inside.
    pub beyond_range_rad: f64,
}

impl Verdict {
    /// Whether no joint passes its speed and acceleration limits or its range, by more than rounding.
    #[must_use]
    pub fn within_limits(&self, arm: &DiscArm) -> bool {
        let v = arm.model.limit(|l| l.v_max_rad_s).array().into();
        let a = arm.model.limit(|l| l.a_max_rad_s2).array().into();
        let under =
            |x: &Joints, max: &Joints| x.iter().zip(max.iter()).all(|(x, max)| *x <= max * (1.0 + 1e-6));
        self.beyond_range_rad <= 1e-9 && under(&self.speed_rad_s, &v) && under(&self.acceleration_rad_s2, &a)
    }
}

/// Points of the disc's surface relative to its centre, for a normal along z.
fn surface(radius_m: f64, half_height_m: f64) -> Vec<Vector3<f64>> {
    let mut out = vec![Vector3::z() * half_height_m, Vector3::z() * -half_height_m];
    for ring in 1..=8 {
        let r = radius_m * f64::from(ring) / 8.0;
        for k in 0..96 {
            let (s, c) = (f64::from(k) * std::f64::consts::TAU / 96.0).sin_cos();
            out.push(Vector3::new(r * c, r * s, half_height_m));
            out.push(Vector3::new(r * c, r * s, -half_height_m));
        }
    }
    out
}

/// Half the height of the paper's disc, m.
pub(crate) const HALF_HEIGHT_M: f64 = 0.005;

/// Judges a motion; moments in order of time. Checks the disc until it is caught, and the joints to the end.
#[must_use]
pub fn judge(arm: &DiscArm, gripper: &Gripper, rule: &Rule, moments: &[Moment]) -> Verdict {
    let scene = Scene::default();
    let mut checker = CollisionChecker::new(&arm.model, &scene);
    let points = surface(arm.size.disc_radius_m, HALF_HEIGHT_M);
    let mut out = Verdict {
        caught: None,
        touched: None,
        nearest: None,
        clearance_m: f64::INFINITY,
        speed_rad_s: Joints::zeros(),
        acceleration_rad_s2: Joints::zeros(),
        beyond_range_rad: f64::NEG_INFINITY,
    };
    rates(moments, &mut out);
    let (low, high) = (arm.model.q_min(), arm.model.q_max());
    let mut held_since: Option<f64> = None;
    for (index, moment) in moments.iter().enumerate() {
        let q = JointVec::from(moment.q);
        out.beyond_range_rad = out.beyond_range_rad.max((low - q).max()).max((q - high).max());
        let frames = arm.model.fk(&q);
        out.clearance_m = out.clearance_m.min(checker.clearance(&frames).distance_m);
        if out.caught.is_some() || out.touched.is_some() {
            continue;
        }
        let hand = arm.model.ee(&frames);
        let seen = observe(arm, &hand, moment);
        if out.nearest.is_none_or(|n| seen.tip_to_axis_m < n.tip_to_axis_m) {
            out.nearest = Some(seen);
        }
        // The disc's points in the hand's frame; x along the hand, y up, z across.
        let turn = turn_z_to(&moment.normal);
        let placed: Vec<Vector3<f64>> = points.iter().map(|p| moment.center_m + turn * p).collect();
        let touched = body_at(arm, gripper, &frames, &hand, &placed);
        let grips = seen.depth_m >= rule.depth_min_m && seen.lateral_m.abs() <= rule.lateral_max_m;
        let between =
            placed.iter().any(|p| plate(arm, gripper, &hand.inverse_transform_point(p)) == Some(Place::Gap));
        if let Some(body) = touched {
            out.touched = Some(Touch { t_s: moment.t_s, body });
        } else if grips && between {
            let since = *held_since.get_or_insert(moment.t_s);
            if moment.t_s - since >= rule.dwell_s - 1e-9 {
                out.caught = Some((index, seen));
            }
        } else {
            held_since = None;
        }
    }
    out
}

fn rates(moments: &[Moment], out: &mut Verdict) {
    let mut before: Option<(f64, Joints)> = None;
    for pair in moments.windows(2) {
        let dt = pair[1].t_s - pair[0].t_s;
        let speed = (pair[1].q - pair[0].q) / dt;
        out.speed_rad_s = out.speed_rad_s.sup(&speed.abs());
        if let Some((dt0, speed0)) = before {
            let acceleration = (speed - speed0) / (0.5 * (dt + dt0));
            out.acceleration_rad_s2 = out.acceleration_rad_s2.sup(&acceleration.abs());
        }
        before = Some((dt, speed));
    }
}

fn observe(arm: &DiscArm, hand: &robot_model::Pose, moment: &Moment) -> Seen {
    let center = hand.inverse_transform_point(&moment.center_m);
    let radius = arm.size.disc_radius_m;
    // The rim where the middle line of the hand crosses it; beside the disc there is none.
    let half_chord = (radius * radius - center.z * center.z).max(0.0).sqrt();
    let tip = hand.transform_point(&Vector3::new(arm.size.gripper_m, 0.0, 0.0));
    let off = tip - moment.center_m;
    Seen {
        t_s: moment.t_s,
        depth_m: arm.size.gripper_m - (center.x - half_chord),
        tip_to_axis_m: (off - moment.normal * off.dot(&moment.normal)).norm(),
        height_m: center.y,
        lateral_m: center.z,
        // The gripper is the same upside down.
        tilt_rad: hand.rot.column(1).dot(&moment.normal).abs().min(1.0).acos(),
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Place {
    Gap,
    Plate,
}

/// Where a point in the hand's frame is, if it is in the gripper.
fn plate(arm: &DiscArm, gripper: &Gripper, p: &Vector3<f64>) -> Option<Place> {
    let inside = (0.0..=arm.size.gripper_m).contains(&p.x) && p.z.abs() <= gripper.half_width_m;
    if !inside || p.y.abs() > gripper.outer_m {
        return None;
    }
    Some(if p.y.abs() <= gripper.half_gap_m { Place::Gap } else { Place::Plate })
}

/// The first body that a point of the disc is in: a finger, or a box of the arm (the gripper's own box is the two plates).
fn body_at(
    arm: &DiscArm,
    gripper: &Gripper,
    frames: &robot_model::Frames,
    hand: &robot_model::Pose,
    placed: &[Vector3<f64>],
) -> Option<String> {
    for p in placed {
        if plate(arm, gripper, &hand.inverse_transform_point(p)) == Some(Place::Plate) {
            return Some("finger".to_owned());
        }
    }
    for body in arm.model.collision().boxes() {
        if body.link == 4 && body.name == "gripper" {
            continue;
        }
        let x_wb = match body.link.checked_sub(1) {
            Some(joint) => frames.x_w[joint] * body.x_lb,
            None => body.x_lb,
        };
        let reach = body.half_m.norm();
        for p in placed {
            if (p - x_wb.pos).norm() <= reach {
                let local = x_wb.inverse_transform_point(p).abs();
                if local.x <= body.half_m.x && local.y <= body.half_m.y && local.z <= body.half_m.z {
                    return Some(body.name.clone());
                }
            }
        }
    }
    None
}

fn turn_z_to(normal: &Vector3<f64>) -> nalgebra::Matrix3<f64> {
    let side = if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let x = (side - normal * side.dot(normal)).normalize();
    nalgebra::Matrix3::from_columns(&[x, normal.cross(&x), *normal])
}
