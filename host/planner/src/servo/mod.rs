//! A stream of commands as a motion that can be stopped at any time.
//!
//! ```text
//! commands, whenever they come ──▶ Servo ──▶ states of all joints, one per tick of 20 ms
//! ```
//!
//! The motion keeps these rules, for all commands at all times:
//! * speed, acceleration and jerk of each joint are bounded ([`Bounds`]);
//! * from each state the arm can come to rest inside its joint ranges, and with the distance that it keeps, both with bounded jerk
//!   (as the servo brakes) and at once with the acceleration alone (as a controller does when nothing more comes). Both ways are
//!   proven before the state is given; if one is not free, the arm brakes on the way that was proven before;
//! * without a command for `hold_s` it comes to rest.
//!
//! Each joint moves by itself. A pose of the hand is turned into angles once, with the least motion; a speed of the
//! hand is turned into speeds of the joints at each tick, all of them scaled if one would be too fast.

mod joint;

use nalgebra::{Vector3, Vector6};
use robot_model::collision::{CollisionChecker, MotionVerdict, Scene, Travel};
use robot_model::linalg::Cholesky;
use robot_model::{JointVec, PerJoint, Pose, RobotModel};

pub use joint::{Bounds, JointGoal, JointState, Stop};

use crate::way::at_point;

/// Time between two states.
pub const TICK_S: f64 = 0.02;
/// Acceleration of braking at once, as a share of that of the servo: above 1, so that the servo's motions are within it.
pub const BRAKE_SHARE: f64 = 1.05;
/// Largest distance that is kept from everything, m.
pub const DISTANCE_M: f64 = 0.01;
/// The proof that a way is free is exact to this distance, m.
const TOLERANCE_M: f64 = 1e-3;
/// Angle that is kept from the ends of the joint ranges.
const MARGIN_RAD: f64 = 2e-3;
/// Damping of the inverse of the Jacobian: near a singularity the hand follows less and no joint races.
const DAMPING: f64 = 4e-4;

/// Commands of a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Joint angles, rad.
    Joints(JointVec),
    /// Joint speeds, rad/s.
    JointSpeeds(JointVec),
    /// The hand at a point, m, base frame, turned as comes with the least motion.
    Point(Vector3<f64>),
    /// The hand in a pose, base frame.
    Pose(Pose),
    /// Speed of the hand, m/s, and turning, rad/s, base frame.
    HandSpeed(Vector6<f64>),
}

/// Why a command is not taken. The command before it holds until its time is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    #[error("a number is not finite")]
    NotFinite,
    #[error("{given} numbers for {joints} joints")]
    Length { given: usize, joints: usize },
    #[error("the hand does not come there from where it is")]
    OutOfReach,
}

/// Why the arm does less than its command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Limited {
    /// The end of the range of a joint, from 0.
    Range(usize),
    /// Two bodies would come too near, by their names.
    Contact(String, String),
}

/// Why there is no servo.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoServo {
    #[error("joint {} is outside its range", joint + 1)]
    OutsideRange { joint: usize },
    #[error("{a} and {b} touch where the arm stands")]
    Blocked { a: String, b: String },
}

/// Bounds of all joints: a share, above 0 and at most 1, of the limits of the arm.
#[must_use]
pub fn bounds_of(arm: &RobotModel, share: f64) -> PerJoint<Bounds> {
    PerJoint::from_fn(arm.n(), |k| {
        let limits = &arm.joints()[k].limits;
        Bounds {
            q_min_rad: limits.q_min_rad + MARGIN_RAD,
            q_max_rad: limits.q_max_rad - MARGIN_RAD,
            v_rad_s: share * limits.v_max_rad_s,
            a_rad_s2: share * limits.a_max_rad_s2,
            j_rad_s3: share * limits.j_max_rad_s3,
        }
    })
}

/// The motion of a stream; see the [module](self).
#[derive(Debug)]
pub struct Servo<'a> {
    arm: &'a RobotModel,
    checker: CollisionChecker<'a>,
    bounds: PerJoint<Bounds>,
    state: PerJoint<JointState>,
    command: Option<Command>,
    /// Angles of [`Command::Joints`] and of the poses of the hand.
    goal_rad: JointVec,
    heard_s: f64,
    hold_s: f64,
}

impl<'a> Servo<'a> {
    /// A servo for an arm that stands at `q_rad`. If no command comes for `hold_s`, the arm comes to rest.
    ///
    /// # Errors
    /// [`NoServo`].
    pub fn new(
        arm: &'a RobotModel,
        scene: &'a Scene,
        bounds: PerJoint<Bounds>,
        q_rad: &JointVec,
        hold_s: f64,
    ) -> Result<Self, NoServo> {
        let outside = |k: &usize| !(bounds[*k].q_min_rad..=bounds[*k].q_max_rad).contains(&q_rad[*k]);
        if let Some(joint) = (0..arm.n()).find(outside) {
            return Err(NoServo::OutsideRange { joint });
        }
        let mut checker = CollisionChecker::new(arm, scene);
        let nearest = checker.clearance(&arm.fk(q_rad));
        let touches = nearest.distance_m <= TOLERANCE_M;
        if touches {
            let [a, b] = [nearest.a, nearest.b].map(|body| checker.name(body).to_string());
            return Err(NoServo::Blocked { a, b });
        }
        let checker = checker.keeping(DISTANCE_M.min(0.5 * nearest.distance_m));
        let state = PerJoint::from_fn(arm.n(), |k| JointState { q_rad: q_rad[k], ..JointState::default() });
        Ok(Self { arm, checker, bounds, state, command: None, goal_rad: *q_rad, heard_s: 0.0, hold_s })
    }

    /// What each joint keeps to.
    #[must_use]
    pub const fn bounds(&self) -> &PerJoint<Bounds> {
        &self.bounds
    }

    /// States of the joints at the newest tick.
    #[must_use]
    pub const fn state(&self) -> &PerJoint<JointState> {
        &self.state
    }

    /// Angles at the newest tick, rad.
    #[must_use]
    pub fn q_rad(&self) -> JointVec {
        JointVec::from_fn(self.arm.n(), |k| self.state[k].q_rad)
    }

    /// True if nothing moves, and nothing is ordered.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.command.is_none() && (0..self.arm.n()).all(|k| self.state[k].qd_rad_s.abs() < 1e-9)
    }

    /// Takes a command, from `now_s` on.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn take(&mut self, now_s: f64, command: Command) -> Result<(), Refused> {
        let n = self.arm.n();
        let of_joints = |q: &JointVec| {
            if q.len() != n {
                return Err(Refused::Length { given: q.len(), joints: n });
            }
            finite(q.as_slice())
        };
        let here = self.q_rad();
        match &command {
            Command::Joints(q) => {
                of_joints(q)?;
                self.goal_rad = *q;
            }
            Command::JointSpeeds(qd) => of_joints(qd)?,
            Command::Point(p) => {
                finite(p.as_slice())?;
                self.goal_rad = at_point(self.arm, p, here).ok_or(Refused::OutOfReach)?;
            }
            Command::Pose(pose) => {
                finite(pose.pos.as_slice())?;
                finite(pose.rot.as_slice())?;
                let found = self.arm.ik_from(pose, &here).filter(|q| self.arm.in_range(q, 0.0));
                self.goal_rad = found.ok_or(Refused::OutOfReach)?;
            }
            Command::HandSpeed(twist) => finite(twist.as_slice())?,
        }
        (self.command, self.heard_s) = (Some(command), now_s);
        Ok(())
    }

    /// Forgets the command: the arm comes to rest.
    pub fn release(&mut self) {
        self.command = None;
    }

    /// The next state, [`TICK_S`] later, and what limits the command. `now_s` is the time of the commands.
    pub fn tick(&mut self, now_s: f64) -> Option<Limited> {
        if now_s - self.heard_s > self.hold_s {
            self.command = None;
        }
        let goals = self.goals();
        let (state, bounds) = (self.state, self.bounds);
        let n = self.arm.n();
        let wanted = PerJoint::from_fn(n, |k| joint::next(state[k], goals[k], &bounds[k], TICK_S));
        let touched = self.touched(&wanted);
        self.state = if touched.is_some() {
            PerJoint::from_fn(n, |k| Stop::new(state[k], &bounds[k]).at(TICK_S))
        } else {
            wanted
        };
        touched.or_else(|| self.at_range(&goals))
    }

    fn goals(&mut self) -> PerJoint<JointGoal> {
        let n = self.arm.n();
        match self.command {
            None => PerJoint::default_of(n),
            Some(Command::Joints(_) | Command::Point(_) | Command::Pose(_)) => {
                PerJoint::from_fn(n, |k| JointGoal::Position(self.goal_rad[k]))
            }
            Some(Command::JointSpeeds(qd)) => PerJoint::from_fn(n, |k| JointGoal::Speed(qd[k])),
            Some(Command::HandSpeed(twist)) => {
                let qd = self.rates(&twist);
                PerJoint::from_fn(n, |k| JointGoal::Speed(qd[k]))
            }
        }
    }

    /// Joint speeds that move the hand with a twist, damped, and scaled to what the joints can do.
    fn rates(&self, twist: &Vector6<f64>) -> JointVec {
        let n = self.arm.n();
        let frames = self.arm.fk(&self.q_rad());
        let jacobian = frames.jacobian(&self.arm.ee(&frames).pos);
        let mut square = jacobian.times_transposed();
        (0..6).for_each(|i| square[(i, i)] += DAMPING);
        let Some(factors) = Cholesky::new(&square) else { return JointVec::zeros(n) };
        let qd = jacobian.tr_mul(&Vector6::from_column_slice(&factors.solve(&JointVec::from(*twist))));
        let used = (0..n).map(|k| qd[k].abs() / self.bounds[k].v_rad_s).fold(1.0, f64::max);
        qd * (1.0 / used)
    }

    /// Two bodies that would come too near on a way to rest from `state`.
    fn touched(&mut self, state: &PerJoint<JointState>) -> Option<Limited> {
        let n = self.arm.n();
        let ways = [
            Rest::of(PerJoint::from_fn(n, |k| Stop::new(state[k], &self.bounds[k]))),
            Rest::of(PerJoint::from_fn(n, |k| at_once(state[k], BRAKE_SHARE * self.bounds[k].a_rad_s2))),
        ];
        ways.iter().find_map(|way| match self.checker.check_motion(way, 0.0, way.duration_s, TOLERANCE_M) {
            MotionVerdict::Free { .. } => None,
            MotionVerdict::Contact { clearance, .. } => {
                let [a, b] = [clearance.a, clearance.b].map(|body| self.checker.name(body).to_string());
                Some(Limited::Contact(a, b))
            }
        })
    }

    /// A joint that stands at the end of its range and is ordered beyond it.
    fn at_range(&self, goals: &PerJoint<JointGoal>) -> Option<Limited> {
        let at = |k: &usize| {
            let (bounds, q_rad) = (&self.bounds[*k], self.state[*k].q_rad);
            match goals[*k] {
                JointGoal::Position(goal) => !(bounds.q_min_rad..=bounds.q_max_rad).contains(&goal),
                JointGoal::Speed(speed) => {
                    speed > 0.0 && q_rad > bounds.q_max_rad - MARGIN_RAD
                        || speed < 0.0 && q_rad < bounds.q_min_rad + MARGIN_RAD
                }
            }
        };
        (0..self.arm.n()).find(at).map(Limited::Range)
    }
}

fn finite(numbers: &[f64]) -> Result<(), Refused> {
    if numbers.iter().all(|number| number.is_finite()) { Ok(()) } else { Err(Refused::NotFinite) }
}

/// The way to rest with the acceleration alone, as a stop whose jerk is without bound.
fn at_once(state: JointState, a_rad_s2: f64) -> Stop {
    let moving = JointState { qdd_rad_s2: 0.0, ..state };
    let bounds = Bounds {
        q_min_rad: f64::NEG_INFINITY,
        q_max_rad: f64::INFINITY,
        v_rad_s: f64::INFINITY,
        a_rad_s2,
        j_rad_s3: 1e6 * a_rad_s2,
    };
    Stop::new(moving, &bounds)
}

/// The ways of all joints to rest, as one motion.
struct Rest {
    joints: PerJoint<Stop>,
    duration_s: f64,
}

impl Rest {
    fn of(joints: PerJoint<Stop>) -> Self {
        let duration_s = joints.as_slice().iter().map(Stop::duration_s).fold(0.0, f64::max);
        Self { joints, duration_s }
    }
}

impl Travel for Rest {
    fn at(&self, s: f64) -> JointVec {
        JointVec::from_fn(self.joints.len(), |k| self.joints[k].at(s).q_rad)
    }

    fn path_length(&self, s0: f64, s1: f64) -> JointVec {
        JointVec::from_fn(self.joints.len(), |k| self.joints[k].travel_rad(s0, s1))
    }
}
