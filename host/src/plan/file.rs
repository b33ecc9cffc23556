//! The plan file: a throw with everything needed to run it and to judge it.
//!
//! JSON, versioned, units in the names of the keys; described in `host/schemas/plan.schema.json`. Numbers are written
//! so that they read back to the same bits.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix4, Vector2};
use serde::{Deserialize, Serialize};

use super::cuts::CLEARANCE_EXTRA_M;
use super::margins::Margins;
use super::paper::PaperParameters;
use super::problem::{Form, Problem, Weights};
use super::scan::{RELEASE_BLIND_S, Scanner};
use super::search::Best;
use super::statistics::{Noise, Region, landing_with_delay, predict};
use super::throw::{Arm, JOINTS, Throw};
use crate::store::robot_fingerprint;

/// Version of the format that this program writes, and the newest it reads.
pub const VERSION: u32 = 2;
/// First field of every plan file.
pub const FORMAT: &str = "cubectl-plan";

/// A plan file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanFile {
    /// Always [`FORMAT`].
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// Kind of motion; always `throw` so far.
    pub kind: String,
    /// Which robot.
    pub robot: RobotId,
    /// What the throw is for.
    pub target: Target,
    /// How it was found.
    pub search: Search,
    /// The paper's parameters of the throw; for a free spin ω is the part about the throw.
    pub parameters: PaperParameters,
    /// Polynomials, one list per joint.
    pub joints: Vec<JointPlan>,
    /// When the gripper opens, in s from the start of the motion.
    pub release_time_s: f64,
    /// When the motion ends, in s.
    pub end_time_s: f64,
    /// State at the release.
    pub release: Release,
    /// Release frame in the end-effector frame, row by row.
    pub t_ball: [[f64; 4]; 4],
    /// Objective (1).
    pub objective: Objective,
    /// Flight and landing.
    pub landing: LandingInfo,
    /// What is left of every limit.
    pub margins: MarginsInfo,
    /// Largest currents.
    pub currents: Currents,
    /// What was checked, with which tolerance.
    pub checks: Vec<CheckInfo>,
}

/// Which robot a plan is for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotId {
    /// Name in the robot file.
    pub name: String,
    /// What was given to `--robot`.
    pub source: String,
    /// Fingerprint of everything a throw depends on, hexadecimal.
    pub fingerprint: String,
}

/// The target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Point in the world.
    pub position_m: [f64; 3],
    /// Region that counts as a hit.
    pub region: Option<Region>,
}

/// How a throw was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Search {
    /// Form.
    pub form: Form,
    /// Starts that were run.
    pub starts: usize,
    /// Starts that found a throw.
    pub solved: usize,
    /// Seed.
    pub seed: u64,
    /// Whether it was stopped early.
    pub interrupted: bool,
    /// Part of the acceleration limits that was available.
    pub acceleration_use: f64,
}

/// The motion of one joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointPlan {
    /// Name in the robot file.
    pub name: String,
    /// Segments without gaps.
    pub segments: Vec<Segment>,
}

/// One polynomial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Segment {
    /// Begin in s.
    pub t_start_s: f64,
    /// End in s.
    pub t_end_s: f64,
    /// `q(t) = c₀ t³ + c₁ t² + c₂ t + c₃` in rad, t in s from the start of the motion (absolute).
    pub coefficients_rad: Vec<f64>,
}

/// State at the release.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Release {
    /// Joint angles in rad.
    pub q_rad: [f64; JOINTS],
    /// Joint speeds in rad/s.
    pub qd_rad_s: [f64; JOINTS],
    /// Joint accelerations in rad/s².
    pub qdd_rad_s2: [f64; JOINTS],
    /// Ball in m.
    pub position_m: [f64; 3],
    /// Ball in m/s.
    pub velocity_m_s: [f64; 3],
}

/// Objective with its terms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Objective {
    /// Sum.
    pub value: f64,
    /// Weight of time times the duration.
    pub time: f64,
    /// Weight of the ratio times the ratio.
    pub braking: f64,
    /// Weight of jerk times its squared integral.
    pub jerk: f64,
    /// The weights.
    pub weights: Weights,
}

/// Flight and landing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LandingInfo {
    /// Gravity in m/s².
    pub gravity_m_s2: f64,
    /// Drag in 1/m.
    pub drag_per_m: f64,
    /// Magnus vector in 1/s.
    pub magnus_rad_s: [f64; 3],
    /// Time of flight in s.
    pub flight_s: f64,
    /// Where an exact throw lands, in m.
    pub position_m: [f64; 3],
    /// Velocity there in m/s.
    pub velocity_m_s: [f64; 3],
    /// Mean of the landing with the noise below, x and y in m.
    pub mean_m: [f64; 2],
    /// Covariance of the landing in m², row by row.
    pub covariance_m2: [[f64; 2]; 2],
    /// `dL/dδ` for a gripper that opens δ late, in mm per ms.
    pub delay_sensitivity_mm_per_ms: [f64; 2],
    /// How far the landing moves for a late or early gripper; empty in files of version 1.
    #[serde(default)]
    pub delay_shifts: Vec<DelayShift>,
    /// Noise that the covariance is for.
    pub noise: Noise,
    /// Probability of a hit, if a region was given.
    pub hit_probability: Option<f64>,
}

/// Shift of the landing when the gripper opens late or early.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DelayShift {
    /// Delay, and equally advance, of the release in s.
    pub delay_s: f64,
    /// Larger of the two shifts in m; none if the ball then does not come down on the plane of the target.
    pub shift_m: Option<f64>,
    /// Limit that the plan keeps in m, if there is one.
    pub limit_m: Option<f64>,
}

/// What is left of every limit: rad for positions, m for clearances, otherwise a share of the full limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarginsInfo {
    /// Positions.
    pub position_rad: [f64; JOINTS],
    /// Speeds.
    pub speed_share: [f64; JOINTS],
    /// Accelerations.
    pub acceleration_share: [f64; JOINTS],
    /// Jerks.
    pub jerk_share: [f64; JOINTS],
    /// Motor currents at the release.
    pub motor_current_share: Option<[f64; JOINTS]>,
    /// Supply currents at the release.
    pub supply_current_share: Vec<f64>,
    /// Smallest clearance of the arm; bodies that are far apart are not measured.
    pub clearance_m: Option<f64>,
    /// Smallest clearance of the released ball.
    pub ball_clearance_m: f64,
}

/// Largest currents over the motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Currents {
    /// Motors at the release in A (with the paper's simplification τ(q, q̇, 0)).
    pub motor_release_a: Option<[f64; JOINTS]>,
    /// Motors over the motion in A.
    pub motor_peak_a: Option<[f64; JOINTS]>,
    /// Supplies over the motion.
    pub supply_peak: Vec<SupplyPeak>,
}

/// Largest current of a supply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SupplyPeak {
    /// Name.
    pub name: String,
    /// Largest current over the motion in A.
    pub peak_a: f64,
    /// Limit in A.
    pub limit_a: f64,
}

/// One check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckInfo {
    /// What.
    pub what: String,
    /// Whether it was part of the plan's constraints.
    pub enforced: bool,
    /// Tolerance with unit.
    pub tolerance: String,
}

/// A plan file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PlanFileError {
    /// Reading or writing failed.
    #[error("plan {path}: {source}")]
    Io {
        /// File.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not JSON, or not a plan.
    #[error("plan {path} is damaged or not a plan file: {reason}")]
    Damaged {
        /// File.
        path: PathBuf,
        /// Where and why.
        reason: String,
    },
    /// From a newer program.
    #[error(
        "plan {path} has version {found}, this program reads up to {VERSION}: update cubectl or plan again"
    )]
    Newer {
        /// File.
        path: PathBuf,
        /// Its version.
        found: u64,
    },
    /// For another robot.
    #[error(
        "plan {path} is for robot \"{found}\" ({found_fingerprint}), not for \"{wanted}\" ({wanted_fingerprint}): plan again, or name the robot with --robot"
    )]
    OtherRobot {
        /// File.
        path: PathBuf,
        /// Robot in the file.
        found: String,
        /// Its fingerprint.
        found_fingerprint: String,
        /// Robot in use.
        wanted: String,
        /// Its fingerprint.
        wanted_fingerprint: String,
    },
}

impl PlanFile {
    /// Puts together the plan of a throw.
    ///
    /// Returns `None` only if the ball of the throw never comes down on the plane of the target.
    #[must_use]
    pub fn of(
        problem: &Problem<'_>,
        best: &Best,
        robot_source: &str,
        seed: u64,
        noise: &Noise,
        region: Option<Region>,
    ) -> Option<Self> {
        let (arm, throw) = (problem.arm, &best.found.throw);
        let (p, v) = throw.ball_at_release(arm);
        let landed = problem.flight.land(&p, &v, problem.target.z)?;
        let prediction = predict(problem, throw, noise)?;
        let c = prediction.covariance_m2;
        let aim = Vector2::new(problem.target.x, problem.target.y);
        let margins = Margins::of(problem, throw);
        let [time, braking, jerk] = problem.objective_terms(throw);
        // Everything is measured, whatever was enforced.
        let mut all = problem.clone();
        all.options.avoid_collisions = true;
        all.options.clean_release = true;
        let scan = Scanner::new(&all).scan(&all, throw);
        Some(Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            kind: "throw".to_owned(),
            robot: RobotId {
                name: arm.name().to_owned(),
                source: robot_source.to_owned(),
                fingerprint: format!("{:016x}", robot_fingerprint(arm)),
            },
            target: Target { position_m: problem.target.into(), region },
            search: Search {
                form: problem.options.form,
                starts: best.starts,
                solved: best.solved,
                seed,
                interrupted: best.interrupted,
                acceleration_use: problem.options.acceleration_use,
            },
            parameters: PaperParameters::of(arm, &problem.shoulder, throw),
            joints: (0..JOINTS).map(|j| joint_plan(arm, throw, j)).collect(),
            release_time_s: throw.ha_s,
            end_time_s: throw.duration_s(),
            release: Release {
                q_rad: throw.q_rad.into(),
                qd_rad_s: throw.qd_rad_s.into(),
                qdd_rad_s2: throw.qdd_rad_s2.into(),
                position_m: p.into(),
                velocity_m_s: v.into(),
            },
            t_ball: rows_of(&arm.gripper().x_eb.to_matrix()),
            objective: Objective {
                value: time + braking + jerk,
                time,
                braking,
                jerk,
                weights: problem.options.weights,
            },
            landing: LandingInfo {
                gravity_m_s2: problem.flight.gravity_m_s2(),
                drag_per_m: problem.flight.drag_per_m(),
                magnus_rad_s: (*problem.flight.magnus_rad_s()).into(),
                flight_s: landed.time_s,
                position_m: landed.p.into(),
                velocity_m_s: landed.v.into(),
                mean_m: prediction.mean_m.into(),
                covariance_m2: [[c[(0, 0)], c[(0, 1)]], [c[(1, 0)], c[(1, 1)]]],
                delay_sensitivity_mm_per_ms: prediction.delay_sensitivity_m_s.into(),
                delay_shifts: delay_shifts(problem, throw),
                noise: *noise,
                hit_probability: region.map(|r| prediction.hit_probability(&aim, &r)),
            },
            margins: MarginsInfo {
                position_rad: margins.position_rad.into(),
                speed_share: margins.speed.into(),
                acceleration_share: margins.acceleration.into(),
                jerk_share: margins.jerk.into(),
                motor_current_share: margins.motor.map(Into::into),
                supply_current_share: margins.supply.clone(),
                clearance_m: scan.clearance_m.is_finite().then_some(scan.clearance_m),
                ball_clearance_m: scan.ball_clearance_m,
            },
            currents: currents(problem, throw, &margins),
            checks: checks(problem),
        })
    }

    /// Writes the file; it appears complete or not at all.
    ///
    /// # Errors
    /// If the folder or file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), PlanFileError> {
        let fail = |source| PlanFileError::Io { path: path.to_owned(), source };
        let part = path.with_extension("part");
        std::fs::write(&part, self.to_json() + "\n").map_err(fail)?;
        std::fs::rename(&part, path).map_err(fail)
    }

    /// As JSON.
    #[must_use]
    pub fn to_json(&self) -> String {
        // Every field is a number, text or list of them; writing those to a string cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`PlanFileError`] for a file that cannot be read, is damaged, or is of a newer version.
    pub fn read(path: &Path) -> Result<Self, PlanFileError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| PlanFileError::Io { path: path.to_owned(), source })?;
        Self::from_json(path, &text)
    }

    /// Reads JSON; `path` is for messages.
    ///
    /// # Errors
    /// As [`PlanFile::read`].
    pub fn from_json(path: &Path, text: &str) -> Result<Self, PlanFileError> {
        let damaged = |reason: String| PlanFileError::Damaged { path: path.to_owned(), reason };
        let value: serde_json::Value = serde_json::from_str(text).map_err(|e| damaged(e.to_string()))?;
        if value.get("format").and_then(|f| f.as_str()) != Some(FORMAT) {
            return Err(damaged(format!("the field \"format\" is not \"{FORMAT}\"")));
        }
        // The version comes before the fields: those of a newer version may be anything.
        match value.get("version").and_then(serde_json::Value::as_u64) {
            Some(v) if v > u64::from(VERSION) => {
                return Err(PlanFileError::Newer { path: path.to_owned(), found: v });
            }
            Some(1..) => {}
            _ => return Err(damaged("the field \"version\" is not a positive whole number".to_owned())),
        }
        let plan: Self = serde_json::from_str(text).map_err(|e| damaged(e.to_string()))?;
        plan.sound().map_err(damaged)?;
        Ok(plan)
    }

    /// Refuses the plan for any other robot than the one it was made for.
    ///
    /// # Errors
    /// [`PlanFileError::OtherRobot`].
    pub fn require_robot(&self, path: &Path, arm: &Arm) -> Result<(), PlanFileError> {
        let wanted = format!("{:016x}", robot_fingerprint(arm));
        if self.robot.fingerprint == wanted {
            return Ok(());
        }
        Err(PlanFileError::OtherRobot {
            path: path.to_owned(),
            found: self.robot.name.clone(),
            found_fingerprint: self.robot.fingerprint.clone(),
            wanted: arm.name().to_owned(),
            wanted_fingerprint: wanted,
        })
    }

    /// What the types cannot say.
    fn sound(&self) -> Result<(), String> {
        if self.joints.len() != JOINTS {
            return Err(format!("{} joints, expected {JOINTS}", self.joints.len()));
        }
        let inside = self.release_time_s > 0.0 && self.release_time_s < self.end_time_s;
        if !inside {
            return Err(format!(
                "release at {} s is not inside the motion of {} s",
                self.release_time_s, self.end_time_s
            ));
        }
        for joint in &self.joints {
            let mut t = 0.0;
            if joint.segments.is_empty() {
                return Err(format!("{} has no segments", joint.name));
            }
            for segment in &joint.segments {
                let follows = (segment.t_start_s - t).abs() <= 1e-9 && segment.t_end_s > segment.t_start_s;
                if !follows {
                    return Err(format!(
                        "{}: a segment from {} to {} s does not follow {t} s",
                        joint.name, segment.t_start_s, segment.t_end_s
                    ));
                }
                if segment.coefficients_rad.is_empty() || segment.coefficients_rad.len() > 8 {
                    return Err(format!("{}: {} coefficients", joint.name, segment.coefficients_rad.len()));
                }
                t = segment.t_end_s;
            }
            if (t - self.end_time_s).abs() > 1e-9 {
                return Err(format!("{} ends at {t} s, the motion at {} s", joint.name, self.end_time_s));
            }
        }
        Ok(())
    }
}

/// Both cubics of a joint in absolute time, highest power first.
fn joint_plan(arm: &Arm, throw: &Throw, j: usize) -> JointPlan {
    let (ja, jb) = throw.jerk();
    let (q, v, a) = (throw.q_rad[j], throw.qd_rad_s[j], throw.qdd_rad_s2[j]);
    // q + v s + a s²/2 + jerk s³/6 with s = t - h_a, expanded in t.
    let h = throw.ha_s;
    let expand = |jerk: f64| {
        vec![
            jerk / 6.0,
            0.5 * (a - jerk * h),
            v - a * h + 0.5 * jerk * h * h,
            q - v * h + 0.5 * a * h * h - jerk * h * h * h / 6.0,
        ]
    };
    let segment = |t_start_s, t_end_s, jerk| Segment { t_start_s, t_end_s, coefficients_rad: expand(jerk) };
    JointPlan {
        name: arm.joints()[j].name.clone(),
        segments: vec![segment(0.0, h, ja[j]), segment(h, throw.duration_s(), jb[j])],
    }
}

/// Shifts at the limits of the plan, or else at 10 and 25 ms.
fn delay_shifts(problem: &Problem<'_>, throw: &Throw) -> Vec<DelayShift> {
    let on_time = landing_with_delay(problem, throw, 0.0);
    let shift = |delay_s: f64| -> Option<f64> {
        let early = landing_with_delay(problem, throw, -delay_s)? - on_time?;
        let late = landing_with_delay(problem, throw, delay_s)? - on_time?;
        Some(early.norm().max(late.norm()))
    };
    let windows = &problem.options.delay_windows;
    let asked = windows.iter().map(|w| (w.delay_s, Some(w.shift_m)));
    let usual = [0.010, 0.025].into_iter().filter(|_| windows.is_empty()).map(|delay_s| (delay_s, None));
    asked
        .chain(usual)
        .map(|(delay_s, limit_m)| DelayShift { delay_s, shift_m: shift(delay_s), limit_m })
        .collect()
}

fn rows_of(m: &Matrix4<f64>) -> [[f64; 4]; 4] {
    std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
}

fn currents(problem: &Problem<'_>, throw: &Throw, margins: &Margins) -> Currents {
    let arm = problem.arm;
    let mut motor_peak = [0.0_f64; JOINTS];
    let mut supply_peak = vec![0.0_f64; arm.supplies().len()];
    let mut known = false;
    for i in 0..=400 {
        let s = throw.at_phase(f64::from(i) / 200.0 - 1.0);
        let tau = arm.inverse_dynamics(&s.q, &s.qd, &s.qdd);
        let Some(motor) = arm.motor_currents(&s.qd, &tau) else { break };
        known = true;
        for (peak, a) in motor_peak.iter_mut().zip(motor.iter()) {
            *peak = peak.max(*a);
        }
        for (peak, a) in supply_peak.iter_mut().zip(arm.supply_currents(&motor)) {
            *peak = peak.max(a);
        }
    }
    Currents {
        motor_release_a: margins.release_currents_a.map(Into::into),
        motor_peak_a: known.then_some(motor_peak),
        supply_peak: arm
            .supplies()
            .iter()
            .zip(supply_peak)
            .map(|(s, peak_a)| SupplyPeak { name: s.name.clone(), peak_a, limit_a: s.current_max_a })
            .collect(),
    }
}

fn checks(problem: &Problem<'_>) -> Vec<CheckInfo> {
    let o = &problem.options;
    let check = |what: &str, enforced: bool, tolerance: &str| CheckInfo {
        what: what.to_owned(),
        enforced,
        tolerance: tolerance.to_owned(),
    };
    vec![
        check("joint ranges (2), (3) over the motion", true, "1e-7 rad"),
        check("joint speed (4) over the motion", true, "1e-7 of the limit"),
        check("joint acceleration (5) over the motion", true, "1e-7 of the limit"),
        check("joint jerk (6)", true, "1e-7 of the limit"),
        check(
            "motor and supply currents (7), (8) at the release",
            !o.current_over_motion,
            "1e-7 of the limit",
        ),
        check("motor and supply currents over the motion", o.current_over_motion, "1e-3 of the limit"),
        check(
            "clearance of arm, base, floor, obstacles and held ball over the motion",
            o.avoid_collisions,
            &format!("{CLEARANCE_EXTRA_M} m"),
        ),
        check(
            &format!("clearance of the released ball, from {} ms on", RELEASE_BLIND_S * 1e3),
            o.clean_release,
            &format!("{CLEARANCE_EXTRA_M} m"),
        ),
        check("landing on the target", true, "1e-6 m"),
        check("landing unmoved by a late release, to first order", o.null_delay, "2e-3 mm per ms"),
        check(
            "shift of the landing for a late or early release",
            !o.delay_windows.is_empty(),
            "inside its limits",
        ),
    ]
}
