//! The judge of a motion without a throw: by its samples the arm followed it, and stands at its end.

use protocol::Instant;
use serde::Serialize;

use super::order::{Order, Tolerances};
use super::record::Record;
use super::verdict::Outcome;
use crate::analysis::{PlanClock, Run, RunAnalysis, analyse, start};
use crate::port::Operator;
use crate::samples::Samples;
use planner::motion::Motion;

/// Largest distance of a standing arm from the end of its motion, rad, by default.
pub(super) const GOAL_RAD: f64 = 0.01;
/// The run has come to rest this long after its planned end, s: the controller holds the end until then.
pub(super) const REST_S: f64 = 0.25;

/// Result of the samples of a motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reached {
    /// Largest distance of a joint from the motion, rad, and which joint, from 0.
    pub off_rad: f64,
    pub off_joint: usize,
    /// Largest distance of a joint from the end of the motion at the end, rad, and which joint, from 0.
    pub end_off_rad: f64,
    pub end_off_joint: usize,
    /// Samples that were compared.
    pub samples: usize,
    /// When the end is judged, s after the planned end.
    pub goal_time_s: f64,
    pub joints: Vec<JointReached>,
}

/// Result of the samples of a joint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointReached {
    pub name: String,
    /// Largest distance from the motion, rad, when, in time of the motion, s, and what is allowed.
    pub off_rad: f64,
    pub off_at_s: f64,
    pub path_tolerance_rad: f64,
    /// Distance from the end of the motion at the end, rad, and what is allowed.
    pub end_off_rad: f64,
    pub goal_tolerance_rad: f64,
}

impl JointReached {
    /// What is not allowed.
    fn broken(&self) -> Vec<String> {
        let mrad = |rad: f64| 1e3 * rad;
        let mut broken = Vec::new();
        // Written so that NaN is not allowed.
        let is_within = |off_rad: f64, most_rad: f64| off_rad <= most_rad;
        if !is_within(self.off_rad, self.path_tolerance_rad) {
            let (off, at_s, most) = (mrad(self.off_rad), self.off_at_s, mrad(self.path_tolerance_rad));
            broken.push(format!(
                "{} was {off:.2} mrad from the motion at {at_s:.2} s (tolerance {most:.2})",
                self.name
            ));
        }
        if !is_within(self.end_off_rad, self.goal_tolerance_rad) {
            let (off, most) = (mrad(self.end_off_rad), mrad(self.goal_tolerance_rad));
            broken.push(format!("{} stood {off:.2} mrad from the end (tolerance {most:.2})", self.name));
        }
        broken
    }
}

/// Result of the samples of the motion that ran last; `None` if they do not suffice.
pub(super) fn observe(operator: &mut dyn Operator, order: &Order<'_>, record: &mut Record) {
    let (arm, motion, tolerances) = (order.arm, order.program.motion(), &order.tolerances);
    let samples = operator.take_samples(arm, record.drives.clone());
    let (gripper_opening, certified) = (record.gripper_opening, record.certified);
    let mut found = None;
    let analysed = operator.meanwhile(&mut || {
        found = samples.as_ref().and_then(|samples| {
            let begun = samples.begun.or_else(|| start::find(&samples.group).pop())?;
            let start = Some(begun);
            let run = Run { samples, motion, throw: None, arm, start, gripper_opening, certified };
            let analysis = analyse(&run).ok()?;
            let reached = reached(&analysis, samples, begun, motion, tolerances);
            Some((analysis, reached))
        });
    });
    // A failure of the link now does not change what was done before.
    drop(analysed);
    if let Some((analysis, reached)) = found {
        (record.analysis, record.reached) = (Some(analysis), reached);
    }
}

fn reached(
    analysis: &RunAnalysis,
    samples: &Samples,
    begun: Instant,
    motion: &Motion,
    tolerances: &Tolerances,
) -> Option<Reached> {
    let (end, end_s, clock) = (motion.stop_rad(), motion.duration_s(), PlanClock::starting(begun));
    let goal_time_s = tolerances.goal_time.as_secs_f64();
    let joint = |j: usize| {
        let joint = &analysis.joints[j];
        let in_plan = joint.samples.iter().filter(|sample| (0.0..=end_s).contains(&sample.t_s));
        let farthest = in_plan.max_by(|a, b| a.error_rad.abs().total_cmp(&b.error_rad.abs()))?;
        let positions = &samples.joints.get(j)?.positions;
        let last = positions.iter().rev().find(|at| clock.t_s(at.at) <= end_s + goal_time_s)?;
        Some(JointReached {
            name: joint.name.clone(),
            off_rad: farthest.error_rad.abs(),
            off_at_s: farthest.t_s,
            path_tolerance_rad: tolerances.path_rad[j],
            end_off_rad: (last.value - end[j]).abs(),
            goal_tolerance_rad: tolerances.goal_rad[j],
        })
    };
    let joints = (0..analysis.joints.len()).map(joint).collect::<Option<Vec<_>>>()?;
    let largest = |of: fn(&JointReached) -> f64| {
        joints.iter().map(of).enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b))
    };
    let (off_joint, off_rad) = largest(|joint| joint.off_rad)?;
    let (end_off_joint, end_off_rad) = largest(|joint| joint.end_off_rad)?;
    let samples = analysis.joints.iter().map(|joint| joint.samples_in_plan).sum();
    Some(Reached { off_rad, off_joint, end_off_rad, end_off_joint, samples, goal_time_s, joints })
}

pub(super) fn verdict(record: &Record) -> (Outcome, String) {
    if record.pose.is_some() {
        return (Outcome::Reached, "the arm stands and is ready to move".to_owned());
    }
    if record.steps.iter().all(|(step, ..)| *step != super::Step::Run) {
        return (Outcome::Stored, "stored and committed".to_owned());
    }
    let Some(Reached { off_rad, off_joint, end_off_rad, end_off_joint, joints, .. }) = &record.reached else {
        let text = "ran to its end, by the controller; too few samples were heard to compare the arm with the motion";
        return (Outcome::Reached, text.to_owned());
    };
    let broken: Vec<String> = joints.iter().flat_map(JointReached::broken).collect();
    if broken.is_empty() {
        let follows = format!("at most {:.2} mrad from the motion (joint {})", 1e3 * off_rad, off_joint + 1);
        let stands = format!("{:.2} mrad from its end (joint {})", 1e3 * end_off_rad, end_off_joint + 1);
        (Outcome::Reached, format!("reached: {follows}; the arm stands {stands}"))
    } else {
        (Outcome::NotReached, format!("not reached: {}", broken.join("; ")))
    }
}
