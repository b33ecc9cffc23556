//! The capture of paper 001, step by step: no limits on the joints, trajectory known, parabola.
//!
//! Stages: projection on the reach sphere; same height; parallel track; closing. What the paper leaves open is a
//! [`Reading`]; the default is the one that gives its printed captures, step 35 (flat) and step 42 (oblique):
//! - The terminal point is held `touch` = 12 + 10 cm from the disc's centre, on the radial line at the disc's height.
//! - Closing starts at the first step at which that point is in reach with a level hand. This takes precedence over the
//!   70 cm that the paper gives for the stages: with it as a condition the captures are at 36 and 43.
//! - It closes 2 cm a step, the first step included. The text says 2 cm each 0.1 s and 0.5 s in all, which does not fit
//!   steps of 0.01 s that end at 35 and 42.

use nalgebra::{Vector2, Vector3};

use super::Joints;
use super::arm::{DiscArm, LEVEL_SUM_RAD};
use super::inverse::{self, Settings};
pub use super::throw::{GRAVITY_M_S2, Throw};
use super::witness::Moment;

/// What the paper leaves open, and its constants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Time of a step, s.
    pub step_s: f64,
    /// Steps simulated; the paper's 0.5 s are 50.
    pub steps: u32,
    /// Distance kept before closing, terminal point to disc centre, m.
    pub hold_m: f64,
    /// Closing of one step, m.
    pub close_m: f64,
    /// Steps of closing.
    pub close_steps: u32,
    /// Height below which the point keeps the disc's height, m.
    pub same_height_below_m: f64,
    /// Whether closing waits until the disc is below that height.
    pub wait_for_height: bool,
    /// Steps of parallel track before closing.
    pub track_steps: u32,
}

impl Default for Reading {
    fn default() -> Self {
        Self {
            step_s: 0.01,
            steps: 50,
            hold_m: 0.22,
            close_m: 0.02,
            close_steps: 5,
            same_height_below_m: 0.70,
            wait_for_height: false,
            track_steps: 0,
        }
    }
}

/// What the arm does in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Axis 4 on the reach sphere, towards where it should be.
    Projection,
    /// Axis 4 on the reach sphere, at the disc's height.
    SameHeight,
    /// Terminal point at the hold distance.
    Track,
    /// Gripper closing in.
    Closing,
}

/// One step of the simulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Number of the step; its time is this times the step time.
    pub number: u32,
    /// Time, s.
    pub t_s: f64,
    /// Centre of the disc, m.
    pub disc_m: Vector3<f64>,
    pub stage: Stage,
    /// Where the terminal point should be, m.
    pub wanted_m: Vector3<f64>,
    /// Joint angles that the iteration found, rad.
    pub q: Joints,
    /// Where the terminal point is, m.
    pub terminal_m: Vector3<f64>,
    /// Iterations of the inverse kinematics.
    pub iterations: u32,
    /// Whether the inverse kinematics reached its tolerance.
    pub reached: bool,
}

impl Step {
    /// Terminal point to disc centre, m.
    #[must_use]
    pub fn distance_m(&self) -> f64 {
        (self.disc_m - self.terminal_m).norm()
    }

    /// From where the terminal point is to where it should be, m.
    #[must_use]
    pub fn short_m(&self) -> f64 {
        (self.wanted_m - self.terminal_m).norm()
    }
}

/// A simulated capture.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// All steps, from 0 to the capture or to the end.
    pub steps: Vec<Step>,
    /// First step with the hold point in reach.
    pub in_reach: Option<u32>,
    /// Step at which the rule of the paper ends: all closing steps are done. The rule does not check the gripper;
    /// [`super::witness`] does.
    pub captured: Option<u32>,
}

impl Run {
    /// The steps in the form for the observer; the disc is level.
    #[must_use]
    pub fn moments(&self) -> Vec<Moment> {
        let moment = |s: &Step| Moment { t_s: s.t_s, q: s.q, center_m: s.disc_m, normal: Vector3::z() };
        self.steps.iter().map(moment).collect()
    }

    /// Largest speed of each joint between two steps, rad/s.
    #[must_use]
    pub fn speed_demanded_rad_s(&self) -> Joints {
        let mut out = Joints::zeros();
        for pair in self.steps.windows(2) {
            let dt = pair[1].t_s - pair[0].t_s;
            out = out.sup(&((pair[1].q - pair[0].q).abs() / dt));
        }
        out
    }
}

/// Simulates the capture by the rules of the paper.
#[must_use]
pub fn run(arm: &DiscArm, throw: &Throw, reading: &Reading) -> Run {
    let settings = Settings::default();
    let mut bend = Vector2::new(-0.5, -0.5);
    let mut in_reach = None;
    let mut out = Run { steps: Vec::new(), in_reach: None, captured: None };
    for number in 0..=reading.steps {
        let t_s = f64::from(number) * reading.step_s;
        let disc = throw.at(t_s);
        let radial = disc.xy().norm();
        let low = disc.z < reading.same_height_below_m;
        if in_reach.is_none()
            && wrist_distance(arm, radial - reading.hold_m, disc.z) <= arm.size.reach_m()
            && (low || !reading.wait_for_height)
        {
            in_reach = Some(number);
        }
        let closing = in_reach.and_then(|first| (number + 1).checked_sub(first + reading.track_steps));
        let (stage, wrist) = match (in_reach, closing) {
            (Some(_), Some(closed)) if closed > 0 => {
                let distance = reading.hold_m - reading.close_m * f64::from(closed);
                (Stage::Closing, wrist_of(arm, radial - distance, disc.z))
            }
            (Some(_), _) => (Stage::Track, wrist_of(arm, radial - reading.hold_m, disc.z)),
            (None, _) => {
                let wrist = wrist_of(arm, radial - reading.hold_m, disc.z);
                let reach = arm.size.reach_m();
                if low && wrist.y.abs() < reach {
                    let out_m = (reach * reach - wrist.y * wrist.y).sqrt();
                    (Stage::SameHeight, Vector2::new(out_m.copysign(wrist.x), wrist.y))
                } else {
                    (Stage::Projection, wrist * (reach / wrist.norm()))
                }
            }
        };
        let solved = inverse::reduced(arm, &wrist, &bend, &settings);
        bend = solved.q;
        let turn = disc.y.atan2(disc.x);
        let q = Joints::from([turn, bend[0], bend[1], LEVEL_SUM_RAD - bend[0] - bend[1]]);
        let wanted_out = wrist.x + arm.size.hand_m;
        out.steps.push(Step {
            number,
            t_s,
            disc_m: disc,
            stage,
            wanted_m: Vector3::new(
                wanted_out * turn.cos(),
                wanted_out * turn.sin(),
                wrist.y + arm.size.base_m,
            ),
            q,
            terminal_m: arm.terminal_point(&q),
            iterations: solved.iterations,
            reached: solved.reached,
        });
        if closing == Some(reading.close_steps) {
            out.captured = Some(number);
            break;
        }
    }
    out.in_reach = in_reach;
    out
}

/// Axis 4 for a level hand with its terminal point `out_m` from axis 1 at height `z_m`, relative to axis 2.
fn wrist_of(arm: &DiscArm, out_m: f64, z_m: f64) -> Vector2<f64> {
    Vector2::new(out_m - arm.size.hand_m, z_m - arm.size.base_m)
}

fn wrist_distance(arm: &DiscArm, out_m: f64, z_m: f64) -> f64 {
    wrist_of(arm, out_m, z_m).norm()
}
