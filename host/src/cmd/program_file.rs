//! A program: steps that an arm does one after the other, again and again. A TOML file that people may edit.
//!
//! ```toml
//! schema_version = 1
//! robot = "powercube6"
//! speed_share = 0.3
//!
//! [[step]]
//! joints = "0,-60deg,-80deg,0,30deg,0"
//!
//! [[step]]
//! to = "0.5,0.15,0.45"
//! straight = true
//!
//! [[step]]
//! gripper = "close"
//!
//! [[step]]
//! wait_s = 0.5
//! ```
//!
//! A step has one of `joints`, `by`, `to`, `pose` (as the options of `cubectl move`), `path` (a file of waypoints), `gripper` and
//! `wait_s`.

use std::path::{Path, PathBuf};
use std::rc::Rc;

use operator::job::Target;
use planner::motion::Motion;
use planner::plan::{Arm, Joints};
use planner::store::file::write_whole;
use planner::way::{Travel, require_free_motion, require_free_pose, way};
use protocol::Duration;
use serde::{Deserialize, Serialize};
use toml_reader::{DESCRIPTION_MAX_BYTES, read_text};

use super::fixed;
use super::goal::{Angles, Difference, Hand};
use super::move_arm::no_way;
use super::path_file::{self, RetimeArgs};
use super::poses::Poses;
use super::target::scene;
use crate::error::ExpectedError;

const SCHEMA_VERSION: u32 = 1;
const MEND: &str = "mend the program; nothing has moved";
/// Longest pause, s.
const WAIT_MAX_S: f64 = 3_600.0;

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ProgramFile {
    schema_version: u32,
    robot: Option<String>,
    #[serde(default = "usual_share")]
    speed_share: f64,
    /// File of named poses, beside this one.
    poses: Option<PathBuf>,
    /// The hand holds the ball of the robot file when the program begins.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    holding: bool,
    /// Boxes that nothing may touch: centre and half edges, m, base frame.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    obstacles: Vec<[f64; 6]>,
    #[serde(rename = "step")]
    pub(super) steps: Vec<Written>,
}

impl ProgramFile {
    /// A program without steps.
    pub(super) fn new(robot: &str, speed_share: f64, obstacles: &[[f64; 6]]) -> Self {
        Self {
            schema_version: SCHEMA_VERSION,
            robot: Some(robot.to_owned()),
            speed_share,
            poses: None,
            holding: false,
            obstacles: obstacles.to_vec(),
            steps: Vec::new(),
        }
    }

    /// Writes the file, whole or not at all.
    pub(super) fn write(&self, path: &Path) -> Result<(), ExpectedError> {
        let text = toml::to_string(self).map_err(|error| ExpectedError::bad_input(&error))?;
        write_whole(path, text.as_bytes()).map_err(|error| ExpectedError::output(path, &error))
    }
}

const fn usual_share() -> f64 {
    0.2
}

/// A step as it is written.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Written {
    joints: Option<String>,
    by: Option<String>,
    to: Option<String>,
    pose: Option<String>,
    path: Option<PathBuf>,
    gripper: Option<Grip>,
    wait_s: Option<f64>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    straight: bool,
    speed_share: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Grip {
    Open,
    Close,
}

/// What a step asks for.
#[derive(Debug, Clone)]
enum Asked {
    Go { target: Target, share: f64 },
    Follow { motion: Motion, share: f64 },
    Grip { open: bool },
    Wait(Duration),
}

/// A part of a step, whose way is known.
#[derive(Debug, Clone)]
pub(super) struct Part {
    /// Number of the step in the file, from 1. A path has two parts: the way to its begin, and the path.
    pub(super) number: usize,
    /// The step ends with it.
    pub(super) is_last: bool,
    pub(super) step: Step,
    /// Where the arm stands afterwards, rad.
    pub(super) end: Joints,
}

/// Where a cycle begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Begin {
    pub(super) q_rad: Joints,
    /// The hand is closed.
    pub(super) holds: bool,
}

#[derive(Debug, Clone)]
pub(super) enum Step {
    /// A motion from where the step before ends.
    Move(Motion),
    /// The arm is there already.
    There,
    Grip {
        open: bool,
    },
    Wait(Duration),
}

impl Step {
    /// What it does, for people and in the table.
    pub(super) const fn name(&self) -> &'static str {
        match self {
            Self::Move(_) | Self::There => "move",
            Self::Grip { open: true } => "gripper open",
            Self::Grip { open: false } => "gripper close",
            Self::Wait(_) => "wait",
        }
    }
}

/// A program that was read.
#[derive(Debug, Clone)]
pub(super) struct ArmProgram {
    pub(super) robot: String,
    path: PathBuf,
    steps: Vec<Asked>,
    obstacles: Vec<[f64; 6]>,
    holding: bool,
}

/// True for the name of a program.
pub(super) fn is_program(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "toml")
}

impl ArmProgram {
    /// Reads a program for `robot`, if that is given; else for the robot that it names.
    pub(super) fn read(path: &Path, robot: Option<&str>) -> Result<(Self, Arm), ExpectedError> {
        let text = read_text(path, DESCRIPTION_MAX_BYTES).map_err(|error| ExpectedError::io(path, &error))?;
        let file: ProgramFile = toml::from_str(&text).map_err(|error| {
            ExpectedError::bad_input(&format!("{}: {}", path.display(), error.to_string().trim_end()))
                .next(MEND)
        })?;
        Self::of_file(file, path, robot)
    }

    pub(super) fn of_file(
        file: ProgramFile,
        path: &Path,
        robot: Option<&str>,
    ) -> Result<(Self, Arm), ExpectedError> {
        let refused = |what: &dyn std::fmt::Display| {
            ExpectedError::bad_input(&format!("{}: {what}", path.display())).next(MEND)
        };
        if file.schema_version != SCHEMA_VERSION {
            let found = file.schema_version;
            return Err(refused(&format!("schema_version is {found}, this program reads {SCHEMA_VERSION}")));
        }
        if file.steps.is_empty() {
            return Err(refused(&"it has no step"));
        }
        let named = file.robot.as_deref().unwrap_or("powercube6");
        let robot = robot.unwrap_or(named).to_owned();
        let arm = super::robot(&robot)?;
        if file.robot.is_some() && super::robot(named)?.name() != arm.name() {
            return Err(refused(&format!("it is for {named}, not for {robot}")));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        let poses = file.poses.as_ref().map(|poses| Poses::read(&folder.join(poses))).transpose()?;
        let steps = file.steps.iter().zip(1..).map(|(step, number)| {
            let share = step.speed_share.unwrap_or(file.speed_share);
            step.asked(&arm, share, poses.as_ref(), folder)
                .map_err(|error| error.at(format!("{}: step {number}", path.display())))
                .map_err(|error| if error.next.is_empty() { error.next(MEND) } else { error })
        });
        let steps = steps.collect::<Result<_, _>>()?;
        Ok((
            Self { robot, path: path.to_owned(), steps, obstacles: file.obstacles, holding: file.holding },
            arm,
        ))
    }

    /// The parts of each of `cycles` cycles. One that begins as the one before did has the same parts.
    ///
    /// # Errors
    /// The step to which there is no way.
    pub(super) fn cycles(
        &self,
        arm: &Arm,
        from: Joints,
        cycles: u32,
    ) -> Result<Vec<Rc<[Part]>>, ExpectedError> {
        let mut begin = Begin { q_rad: from, holds: self.holding };
        let mut all: Vec<Rc<[Part]>> = Vec::new();
        let mut last = None;
        for cycle in 1..=cycles {
            let parts = match (all.last(), last) {
                (Some(parts), Some(before)) if before == begin => Rc::clone(parts),
                _ => {
                    last = Some(begin);
                    let (parts, end) = self.cycle(arm, begin).map_err(|error| match cycle {
                        1 => error,
                        _ => error.at(format!("cycle {cycle}")),
                    })?;
                    begin = end;
                    parts.into()
                }
            };
            all.push(parts);
        }
        Ok(all)
    }

    fn cycle(&self, arm: &Arm, begin: Begin) -> Result<(Vec<Part>, Begin), ExpectedError> {
        let Begin { q_rad: mut end, mut holds } = begin;
        let mut parts = Vec::new();
        for (asked, number) in self.steps.iter().zip(1..) {
            let place = |error: ExpectedError| error.at(format!("{}: step {number}", self.path.display()));
            // What the robot file says of the ball is what is in a closed hand.
            let scene = scene(&self.obstacles, holds);
            let travel = |share| Travel { share, ..Travel::default() };
            let step = match asked {
                Asked::Grip { open } => {
                    holds = !open;
                    Step::Grip { open: *open }
                }
                Asked::Wait(span) => Step::Wait(*span),
                Asked::Go { target, share } => {
                    let found = target.way(arm, &scene, &travel(*share), &end);
                    let found = found
                        .and_then(|way| match way {
                            None => require_free_pose(arm, &scene, &end).map(|()| None),
                            way => Ok(way),
                        })
                        .map_err(|error| place(no_way(&error)))?;
                    end = found.as_ref().map_or(end, Motion::stop_rad);
                    found.map_or(Step::There, Step::Move)
                }
                Asked::Follow { motion, share } => {
                    require_free_motion(arm, &scene, motion).map_err(|error| place(no_way(&error)))?;
                    let start = motion.start_rad();
                    let to_start = way(arm, &scene, &travel(*share), &end, &start);
                    let to_start = to_start.map_err(|error| place(no_way(&error)))?;
                    parts.extend(to_start.map(|way| Part {
                        number,
                        is_last: false,
                        step: Step::Move(way),
                        end: start,
                    }));
                    end = motion.stop_rad();
                    Step::Move(motion.clone())
                }
            };
            parts.push(Part { number, is_last: true, step, end });
        }
        Ok((parts, Begin { q_rad: end, holds }))
    }
}

impl Written {
    /// A motion to these angles, rad.
    pub(super) fn to(q_rad: &Joints) -> Self {
        let angles = q_rad.iter().map(|q| fixed(q.to_degrees(), 3) + "deg").collect::<Vec<_>>();
        Self { joints: Some(angles.join(",")), ..Self::default() }
    }

    pub(super) fn grip(open: bool) -> Self {
        Self { gripper: Some(if open { Grip::Open } else { Grip::Close }), ..Self::default() }
    }

    pub(super) fn wait(wait_s: f64) -> Self {
        Self { wait_s: Some(wait_s), ..Self::default() }
    }

    /// What it does, in a word or a few.
    pub(super) const fn name(&self) -> &'static str {
        match (self.gripper, self.wait_s) {
            (Some(Grip::Open), _) => "gripper open",
            (Some(Grip::Close), _) => "gripper close",
            (None, Some(_)) => "wait",
            (None, None) => "move",
        }
    }

    fn asked(
        &self,
        arm: &Arm,
        share: f64,
        poses: Option<&Poses>,
        folder: &Path,
    ) -> Result<Asked, ExpectedError> {
        let bad = |what: &str| ExpectedError::bad_input(&what.to_owned());
        let words = |what: String| ExpectedError::bad_input(&what);
        let moves = [&self.joints, &self.by, &self.to, &self.pose].into_iter().flatten().count();
        let others = [self.path.is_some(), self.gripper.is_some(), self.wait_s.is_some()];
        let all = moves + others.into_iter().filter(|is| *is).count();
        if all != 1 {
            return Err(bad("it has one of joints, by, to, pose, path, gripper and wait_s"));
        }
        if self.straight && self.to.is_none() {
            return Err(bad("straight is for to"));
        }
        if self.speed_share.is_some() && moves == 0 && self.path.is_none() {
            return Err(bad("speed_share is for motions"));
        }
        if !(share > 0.0 && share <= 1.0) {
            return Err(bad("speed_share is above 0 and at most 1"));
        }
        if let Some(grip) = self.gripper {
            return Ok(Asked::Grip { open: matches!(grip, Grip::Open) });
        }
        if let Some(wait_s) = self.wait_s {
            let fits = (0.0..=WAIT_MAX_S).contains(&wait_s);
            return fits
                .then(|| Asked::Wait(Duration::from_secs_f64(wait_s)))
                .ok_or_else(|| bad("wait_s is from 0 to 3600"));
        }
        if let Some(path) = &self.path {
            let path = folder.join(path);
            let text =
                read_text(&path, DESCRIPTION_MAX_BYTES).map_err(|error| ExpectedError::io(&path, &error))?;
            let args = RetimeArgs { retime: false, blend_rad: None, speed_share: Some(share) };
            return Ok(Asked::Follow { motion: path_file::motion(&path, &text, arm, &args)?, share });
        }
        let target = if let Some(text) = &self.joints {
            let Angles(q_rad) = text.parse().map_err(words)?;
            Target::joints(arm, &q_rad)
        } else if let Some(text) = &self.by {
            let turned: Result<Vec<Difference>, String> = text.split(',').map(str::parse).collect();
            let turned = turned.map_err(words)?;
            Target::by(arm, &turned.iter().map(|by| (by.joint - 1, by.by_rad)).collect::<Vec<_>>())
        } else if let Some(name) = &self.pose {
            let poses = poses.ok_or_else(|| bad("name the file of poses: poses = \"poses.toml\""))?;
            Target::joints(arm, poses.of(name, arm.name())?)
        } else {
            let Hand(goal) = self.to.as_deref().unwrap_or_default().parse().map_err(words)?;
            Ok(Target::Hand { goal, straight: self.straight })
        };
        Ok(Asked::Go { target: target.map_err(|error| ExpectedError::bad_input(&error))?, share })
    }
}
