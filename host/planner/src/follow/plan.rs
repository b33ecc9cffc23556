//! The plan of a throw that follows the flight: everything needed to command it and to judge it.
//!
//! JSON with units in the names of the keys. One step per set point of the controller, each with position and speed: knots at
//! equal times. Times count from the first.

use std::path::Path;

use nalgebra::{Rotation3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::best::HandFreedom;
use super::clear::Margins;
use super::found::{Found, SearchSize};
use super::landing;
use super::limits::{AXES, Arm, Axes, LimitSource, Limits};
use super::motion::{FollowMotion, Peaks, differences};
use super::parabola::Parabola;
use super::posture::Posture;
use super::setting::Setting;
use crate::plan::file::{
    FILE_MAX_BYTES, FORMAT, Kind, PlanFileError, RobotId, VERSION, fields, first_difference, parse,
    require_robot, tagged_json,
};

/// Lags that differ by less are taken as the same, s.
const LAG_SAME_S: f64 = 0.001;
/// Longest lag that is one, s.
const LAG_MAX_S: f64 = 1.0;
/// An aim that is nearer to the target is the target, m.
const AIM_SAME_M: f64 = 1e-9;

/// What the arm does at a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// From rest to the parabola.
    Accelerate,
    /// On the parabola; the gripper opens.
    Follow,
    /// To rest.
    Decelerate,
}

/// One set point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// Time from the first step in s.
    pub t_s: f64,
    /// Phase.
    pub phase: Phase,
    /// Angles that the arm shall have, in rad.
    pub q_rad: [f64; AXES],
    /// Speeds that the arm shall have, in rad/s.
    pub qd_rad_s: [f64; AXES],
    /// Commands that make a first-order lag execute `q_rad`; equal to it if the plan assumes no lag.
    pub command_rad: [f64; AXES],
}

/// How the plan was made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// Grid search of the paper; the hand does not turn.
    Paper,
    /// Longest window found without a grid.
    Best(HandFreedom),
}

/// The flight of the ball.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FlightInfo {
    /// Ball centre at the first followed point, in m, world frame.
    pub p0_m: [f64; 3],
    /// Its velocity there, in m/s.
    pub v0_m_s: [f64; 3],
    /// Gravity in m/s².
    pub gravity_m_s2: f64,
    /// Angle of the velocity at the release to the horizontal, in deg.
    pub beta_release_deg: f64,
    /// Speed at the release in m/s.
    pub speed_release_m_s: f64,
    /// Time from the first step to the target in s.
    pub landing_time_s: f64,
}

/// Largest change of the commanded acceleration between two steps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Leap {
    /// Size in deg/s².
    pub size_deg_s2: f64,
    /// Axis, from 1.
    pub axis: usize,
    /// Time of the first of the two steps, in s.
    pub t_s: f64,
}

/// How long and how wide the search was.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SearchInfo {
    /// Time of the search in s.
    pub time_s: f64,
    /// What was searched.
    pub size: SearchSize,
}

/// The commands of a plan lead by another lag than the axes have.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "the plan leads by a lag of {planned_ms:.0} ms, the robot is described with {lag_ms:.0} ms: the ball would land {off_mm:.0} mm off at best"
)]
pub struct OtherLag {
    /// What the commands lead by, ms.
    pub planned_ms: f64,
    /// First-order lag of the axes, ms.
    pub lag_ms: f64,
    /// Root mean square distance of the landings from the target with the best opening, mm.
    pub off_mm: f64,
}

/// A plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FollowPlan {
    /// Always [`FORMAT`].
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// Which robot.
    pub robot: RobotId,
    /// How it was made.
    pub form: Form,
    /// Target in m, world frame.
    pub target_m: [f64; 3],
    /// End of the parabola, in m, world frame, if it is not the target: a lag that the commands do not compensate
    /// brings the ball to the target instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aim_m: Option<[f64; 3]>,
    /// Time between two steps in s.
    pub period_s: f64,
    /// First-order lag that the commands allow for, in s.
    pub lag_s: f64,
    /// Which limits the commands keep.
    pub limits: LimitSource,
    /// Distances that are kept.
    pub margins: Margins,
    /// The flight.
    pub flight: FlightInfo,
    /// When the gripper shall open (jaws no longer touch the ball), in s: the middle of the window, or another instant that
    /// [`FollowPlan::opened_for`] found.
    pub release_time_s: f64,
    /// Index of the first and the last step on the parabola.
    pub window: [usize; 2],
    /// Number of steps on the parabola.
    pub followed_points: usize,
    /// First criterion (paper 000, equation 6) at the release of the search, in rad²/s².
    pub j1: f64,
    /// Second criterion (equation 8).
    pub j2: f64,
    /// Largest leap of the commanded acceleration.
    pub leap: Leap,
    /// Largest use of the limits of speed, acceleration and jerk by the commands; 1 is the limit.
    pub used: [f64; 3],
    /// The search.
    pub search: SearchInfo,
    /// The set points.
    pub steps: Vec<Step>,
}

impl FollowPlan {
    /// The plan of a found throw; `search_s` is the time of the search.
    #[must_use]
    pub fn new(
        setting: &Setting<'_>,
        limits: LimitSource,
        robot: RobotId,
        form: Form,
        found: &Found,
        search_s: f64,
    ) -> Self {
        let motion = &found.motion;
        let time = |step: usize| step as f64 * motion.period_s;
        let commands = motion.commands(setting.lag_s);
        let steps = motion.states.iter().zip(&commands).enumerate().map(|(k, (state, command))| Step {
            t_s: time(k),
            phase: match k {
                k if k < motion.first => Phase::Accelerate,
                k if k <= motion.last => Phase::Follow,
                _ => Phase::Decelerate,
            },
            q_rad: state.q.array(),
            qd_rad_s: state.qd.array(),
            command_rad: command.array(),
        });
        let middle_s = 0.5 * (time(motion.first) + time(motion.last));
        let at_release = found.flight.from_time(middle_s - time(motion.first));
        let leap = largest_leap(&commands, motion.period_s);
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            robot,
            form,
            target_m: setting.target.into(),
            aim_m: None,
            period_s: motion.period_s,
            lag_s: setting.lag_s,
            limits,
            margins: setting.margins,
            flight: FlightInfo {
                p0_m: found.flight.p0.into(),
                v0_m_s: found.flight.v0.into(),
                gravity_m_s2: found.flight.gravity_m_s2,
                beta_release_deg: at_release.beta_rad().to_degrees(),
                speed_release_m_s: at_release.v0.norm(),
                landing_time_s: time(motion.first) + found.flight.time_to(&setting.target),
            },
            release_time_s: middle_s,
            window: [motion.first, motion.last],
            followed_points: motion.last - motion.first + 1,
            j1: found.j1,
            j2: found.j2,
            leap,
            used: Peaks::of(&commands, motion.period_s).use_of(&Limits::of(setting.arm, limits)),
            search: SearchInfo { time_s: search_s, size: found.size },
            steps: steps.collect(),
        }
    }

    /// Reads a plan from JSON text; `path` is for messages.
    ///
    /// # Errors
    /// [`PlanFileError`] for other text, other formats and kinds, newer versions, and windows outside of the steps.
    pub fn from_json(path: &Path, text: &str) -> Result<Self, PlanFileError> {
        let (kind, value) = parse(path, text)?;
        if kind != Kind::Follow {
            return Err(PlanFileError::OtherKind {
                path: path.to_owned(),
                found: kind,
                wanted: Kind::Follow,
            });
        }
        let plan: Self = fields(path, value)?;
        plan.sound()
            .map_err(|reason| PlanFileError::Damaged { path: path.to_owned(), reason: reason.to_owned() })?;
        Ok(plan)
    }

    /// The first number that is not what follows from the steps, the flight and the limits, with both.
    #[must_use]
    pub fn false_claim(&self, arm: &Arm) -> Option<String> {
        let commands: Vec<Axes> = self.steps.iter().map(|step| step.command_rad.into()).collect();
        let middle_s = 0.5 * (self.window[1] - self.window[0]) as f64 * self.period_s;
        let (flight, at_release) = (self.parabola(), self.parabola().from_time(middle_s));
        let landing_time_s = self.window[0] as f64 * self.period_s + flight.time_to(&self.aim());
        let again = Self {
            leap: largest_leap(&commands, self.period_s),
            used: Peaks::of(&commands, self.period_s).use_of(&Limits::of(arm, self.limits)),
            flight: FlightInfo {
                beta_release_deg: at_release.beta_rad().to_degrees(),
                speed_release_m_s: at_release.v0.norm(),
                landing_time_s,
                gravity_m_s2: arm.world().gravity_m_s2,
                ..self.flight
            },
            ..self.clone()
        };
        first_difference(self, &again)
    }

    /// Conditions that the types cannot express.
    ///
    /// # Errors
    /// What is wrong.
    pub fn sound(&self) -> Result<(), &'static str> {
        let [first, last] = self.window;
        if first > last || last >= self.steps.len() || self.followed_points != last - first + 1 {
            return Err("its window is not inside its steps");
        }
        if !(self.period_s > 0.0 && self.period_s.is_finite()) {
            return Err("its period is not positive");
        }
        let Margins { floor_m, boxes_m, grip_slack_m } = self.margins;
        let kept = [floor_m, boxes_m, grip_slack_m].iter().all(|m| (0.0..=1.0).contains(m));
        if !kept || !(0.0..=LAG_MAX_S).contains(&self.lag_s) {
            return Err("its margins are not 0 to 1 m, or its lag is not 0 to 1 s");
        }
        if !(0.0..=(self.steps.len() - 1) as f64 * self.period_s).contains(&self.release_time_s) {
            return Err("its release is not within its motion");
        }
        if ![self.j1, self.j2, self.search.time_s].iter().all(|v| (0.0..f64::INFINITY).contains(v)) {
            return Err("a criterion or the time of its search is negative or not finite");
        }
        Ok(())
    }

    /// Refuses an arm that the plan was not made for; `path` is for messages.
    ///
    /// # Errors
    /// [`PlanFileError::OtherRobot`].
    pub fn require_robot(&self, path: &Path, arm: &Arm) -> Result<(), PlanFileError> {
        require_robot(path, &self.robot, AXES, arm)
    }

    /// As [`Self::require_robot`], and refuses numbers that do not follow from the steps.
    ///
    /// # Errors
    /// [`PlanFileError::OtherRobot`], [`PlanFileError::Damaged`].
    pub fn require_true(&self, path: &Path, arm: &Arm) -> Result<(), PlanFileError> {
        self.require_robot(path, arm)?;
        self.false_claim(arm)
            .map_or(Ok(()), |reason| Err(PlanFileError::Damaged { path: path.to_owned(), reason }))
    }

    /// Reads a plan file.
    ///
    /// # Errors
    /// As [`FollowPlan::from_json`], and if the file cannot be read.
    pub fn read(path: &Path) -> Result<Self, PlanFileError> {
        let text = toml_reader::read_text(path, FILE_MAX_BYTES)
            .map_err(|source| PlanFileError::Io { path: path.to_owned(), source })?;
        Self::from_json(path, &text)
    }

    /// The plan as JSON text.
    #[must_use]
    pub fn to_json(&self) -> String {
        tagged_json(Kind::Follow, self)
    }

    /// The motion of the plan. Accelerations are those of the differences of the speeds.
    #[must_use]
    pub fn motion(&self) -> FollowMotion {
        let speed = |k: usize| Axes::from(self.steps[k.min(self.steps.len() - 1)].qd_rad_s);
        let states = self.steps.iter().enumerate().map(|(k, step)| Posture {
            q: step.q_rad.into(),
            qd: step.qd_rad_s.into(),
            qdd: (speed(k + 1) - speed(k.saturating_sub(1))) / (2.0 * self.period_s),
        });
        FollowMotion {
            period_s: self.period_s,
            states: states.collect(),
            first: self.window[0],
            last: self.window[1],
        }
    }

    /// Refuses this plan for axes whose lag `lag_s` differs too much from that of the plan: the ball then lands
    /// farther than `tolerance_m` from the target, for every opening of the gripper ([`FollowPlan::opened_for`]). A
    /// plan of the paper's form assumes no lag, so it is never refused.
    ///
    /// # Errors
    /// [`OtherLag`].
    pub fn require_lag(
        &self,
        arm: &Arm,
        lag_s: f64,
        jitter_s: f64,
        tolerance_m: f64,
    ) -> Result<(), OtherLag> {
        if self.form == Form::Paper || (lag_s - self.lag_s).abs() < LAG_SAME_S {
            return Ok(());
        }
        let off_m = self.best_opening(arm, lag_s, jitter_s).map_or(f64::INFINITY, |opening| opening.rms_m);
        if off_m <= tolerance_m {
            return Ok(());
        }
        Err(OtherLag { planned_ms: 1e3 * self.lag_s, lag_ms: 1e3 * lag_s, off_mm: 1e3 * off_m })
    }

    /// An order to open takes effect with a telegram: half a period earlier or later.
    fn best_opening(&self, arm: &Arm, lag_s: f64, jitter_s: f64) -> Option<landing::Opening> {
        let (motion, target, spread_s) =
            (self.motion(), self.target_m.into(), jitter_s + 0.5 * self.period_s);
        landing::best_opening(arm, &motion, &target, (self.lag_s, lag_s), spread_s)
    }

    /// The same plan for axes that lag by a first order of `lag_s`, with an opening that varies by up to `jitter_s`.
    ///
    /// It is opened, and turned about the first axis, so that the ball lands nearest to the target. A plan whose commands lead
    /// by this lag is opened in the middle of its window and not turned.
    #[must_use]
    pub fn opened_for(&self, arm: &Arm, lag_s: f64, jitter_s: f64) -> Self {
        let (target, aim) = (Vector3::from(self.target_m), self.aim());
        let plain = self.turned(arm, target.y.atan2(target.x) - aim.y.atan2(aim.x));
        let motion = plain.motion();
        let time = |step: usize| step as f64 * self.period_s;
        let opening = if (lag_s - self.lag_s).abs() < LAG_SAME_S {
            None
        } else {
            plain.best_opening(arm, lag_s, jitter_s)
        };
        match opening {
            Some(opening) => Self {
                release_time_s: time(motion.first) + opening.at_s,
                ..plain.turned(arm, opening.turn_rad)
            },
            None => Self { release_time_s: 0.5 * (time(motion.first) + time(motion.last)), ..plain },
        }
    }

    /// When the gripper opens, from the first step on the parabola, in s.
    #[must_use]
    pub fn opening_s(&self) -> f64 {
        self.release_time_s - self.window[0] as f64 * self.period_s
    }

    /// Motion of the axes by the plan, and when the gripper opens: through a first-order lag of `lag_s`, or as planned if it is
    /// zero.
    #[must_use]
    pub fn release(&self, lag_s: f64) -> landing::Release {
        let (motion, opening_s) = (self.motion(), self.opening_s());
        if lag_s <= 0.0 {
            return landing::Release { motion, opening_s, target: self.aim() };
        }
        // The time of the plan is that of a robot with the part of the delay that the commands do not compensate.
        let opening_s = opening_s + lag_s - self.lag_s;
        let motion = landing::executed(&motion, self.lag_s, lag_s);
        landing::Release { motion, opening_s, target: self.target_m.into() }
    }

    /// Turned about the vertical through the origin, for arms whose first axis it is.
    fn turned(&self, arm: &Arm, turn_rad: f64) -> Self {
        let Some(sign) = landing::turn_of_first_axis(arm).filter(|_| turn_rad != 0.0) else {
            return self.clone();
        };
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), turn_rad);
        let turned = |v: [f64; 3]| -> [f64; 3] { (turn * Vector3::from(v)).into() };
        let aim = turned(self.aim().into());
        let is_target = (Vector3::from(aim) - Vector3::from(self.target_m)).norm() < AIM_SAME_M;
        let mut plan = self.clone();
        plan.aim_m = (!is_target).then_some(aim);
        (plan.flight.p0_m, plan.flight.v0_m_s) = (turned(self.flight.p0_m), turned(self.flight.v0_m_s));
        for step in &mut plan.steps {
            step.q_rad[0] += sign * turn_rad;
            step.command_rad[0] += sign * turn_rad;
        }
        plan
    }

    /// Where the parabola leads, in m, world frame.
    #[must_use]
    pub fn aim(&self) -> Vector3<f64> {
        self.aim_m.unwrap_or(self.target_m).into()
    }

    /// The same throw without following, with ramps through the middle of the window, to compare with following. It
    /// is on its flight for one step only, so the verifier does not judge it.
    #[must_use]
    pub fn without_following(&self, limits: &Limits) -> Self {
        let motion = landing::without_following(&self.motion(), limits);
        let time = |step: usize| step as f64 * motion.period_s;
        let commands = motion.commands(self.lag_s);
        let steps = motion.states.iter().zip(&commands).enumerate().map(|(k, (state, command))| Step {
            t_s: time(k),
            phase: Phase::Accelerate,
            q_rad: state.q.array(),
            qd_rad_s: state.qd.array(),
            command_rad: command.array(),
        });
        Self {
            steps: steps.collect(),
            release_time_s: time(motion.first),
            window: [motion.first, motion.last],
            followed_points: 1,
            ..self.clone()
        }
    }

    /// The flight with t = 0 at the first followed point.
    #[must_use]
    pub fn parabola(&self) -> Parabola {
        let FlightInfo { p0_m, v0_m_s, gravity_m_s2, .. } = self.flight;
        Parabola { p0: p0_m.into(), v0: v0_m_s.into(), gravity_m_s2 }
    }
}

fn largest_leap(commands: &[Axes], period_s: f64) -> Leap {
    let mut largest = Leap { size_deg_s2: 0.0, axis: 1, t_s: 0.0 };
    for k in -2..=commands.len() as isize {
        let [_, _, jerk] = differences(commands, k, period_s);
        let axis = jerk.iamax();
        let size_deg_s2 = (jerk[axis].abs() * period_s).to_degrees();
        if size_deg_s2 > largest.size_deg_s2 {
            largest = Leap { size_deg_s2, axis: axis + 1, t_s: k as f64 * period_s };
        }
    }
    largest
}
