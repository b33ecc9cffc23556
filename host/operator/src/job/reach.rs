//! The judge of a motion that throws nothing: by its samples the arm followed it, and stands at its end.

use serde::Serialize;

use super::record::Record;
use super::verdict::Outcome;
use crate::analysis::{POSITION_BOUND_RAD, Run, RunAnalysis, analyse, start};
use crate::port::Operator;
use planner::motion::Motion;
use planner::plan::Arm;

/// An arm that stands is at most so far from the end of its motion, rad, and its joints move by less than that from one sample to the
/// next.
const END_RAD: f64 = 0.01;
/// The run has come to rest so long after its planned end, s: the controller holds the end until then.
pub(super) const REST_S: f64 = 0.25;

/// What the samples say of a motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Reached {
    /// Largest distance of a joint from the motion, rad, and which joint, from 0.
    pub off_rad: f64,
    pub off_joint: usize,
    /// Largest distance of a joint from the end of the motion at the end, rad, and which joint, from 0.
    pub end_off_rad: f64,
    pub end_off_joint: usize,
    /// Samples that were compared.
    pub samples: usize,
}

/// What the samples say of a motion that was the last to run; nothing if they do not suffice.
pub(super) fn observe(operator: &mut dyn Operator, arm: &Arm, motion: &Motion, record: &mut Record) {
    let samples = operator.take_samples(arm, record.drives.clone());
    let (gripper_opening, certified, analysis) =
        (record.gripper_opening, record.certified, &mut record.analysis);
    let analysed = operator.meanwhile(&mut || {
        *analysis = samples.as_ref().and_then(|samples| {
            let start = Some(samples.begun.or_else(|| start::find(&samples.group).pop())?);
            let run = Run { samples, motion, throw: None, arm, start, gripper_opening, certified };
            analyse(&run).ok()
        });
    });
    // What fails on the link now has no say in what was done before.
    drop(analysed);
    record.reached = record.analysis.as_ref().and_then(|analysis| reached(analysis, motion));
}

fn reached(analysis: &RunAnalysis, motion: &Motion) -> Option<Reached> {
    let end = motion.stop_rad();
    let largest = |of: &dyn Fn(usize) -> Option<f64>| {
        let all: Option<Vec<f64>> = (0..analysis.joints.len()).map(of).collect();
        all?.into_iter().enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b))
    };
    let (off_joint, off_rad) = largest(&|j| Some(analysis.joints[j].position_error_rad.max))?;
    let (end_off_joint, end_off_rad) =
        largest(&|j| analysis.joints[j].samples.last().map(|sample| (sample.q_rad - end[j]).abs()))?;
    let samples = analysis.joints.iter().map(|joint| joint.samples_in_plan).sum();
    Some(Reached { off_rad, off_joint, end_off_rad, end_off_joint, samples })
}

pub(super) fn verdict(record: &Record) -> (Outcome, String) {
    if record.pose.is_some() {
        return (Outcome::Reached, "the arm stands and is ready to move".to_owned());
    }
    if record.steps.iter().all(|(step, ..)| *step != super::Step::Run) {
        return (Outcome::Stored, "stored and committed".to_owned());
    }
    let Some(Reached { off_rad, off_joint, end_off_rad, end_off_joint, .. }) = record.reached else {
        let text = "ran to its end, by the controller; too few samples were heard to compare the arm with the motion";
        return (Outcome::Reached, text.to_owned());
    };
    let follows = format!("at most {:.1} mrad from the motion (joint {})", 1e3 * off_rad, off_joint + 1);
    let stands = format!("{:.1} mrad from its end (joint {})", 1e3 * end_off_rad, end_off_joint + 1);
    if off_rad <= POSITION_BOUND_RAD && end_off_rad <= END_RAD {
        (Outcome::Reached, format!("reached: {follows}; the arm stands {stands}"))
    } else {
        (Outcome::NotReached, format!("not reached: {follows}, {stands}"))
    }
}
