//! HTML report of a program that was done again and again: hand, tracking and steps of its first and last cycle, and what changed between.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::chart::{Chart, Curve};
use super::frame::{cause, foot, head};
use super::hand::{HandPath, Led, measured};
use super::page::{Answer, Page, Tone, cell, number};
use super::scene;
use operator::analysis::POSITION_BOUND_RAD;
use operator::analysis::tracking::{JointTracking, Sample};
use planner::motion::Motion;
use planner::plan::file::RobotId;
use planner::throw::{Arm, Joints};

/// Points of the path of the hand.
const HAND_STEPS: u32 = 1_200;

/// A motion of a cycle.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Moved {
    /// When it began, s since the begin of the cycle.
    pub start_s: f64,
    #[serde(with = "as_info")]
    pub motion: Motion,
    /// Of each joint, time of the motion, s, and reference minus measured, rad.
    pub errors: Vec<Vec<(f64, f64)>>,
}

impl Moved {
    /// A motion that began `start_s` after its cycle, with what the samples say of each joint.
    #[must_use]
    pub fn new(start_s: f64, motion: Motion, joints: &[JointTracking]) -> Self {
        // To the microsecond and to a tenth of a microradian.
        let round = |value: f64, per_unit: f64| (value * per_unit).round() / per_unit;
        let error = |s: &Sample| (round(s.t_s, 1e6), round(s.error_rad, 1e7));
        let errors = joints.iter().map(|joint| joint.samples.iter().map(error).collect()).collect();
        Self { start_s, motion, errors }
    }
}

/// A motion in a file.
mod as_info {
    use planner::motion::Motion;
    use planner::plan::file::MotionInfo;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(super) fn serialize<S: Serializer>(motion: &Motion, to: S) -> Result<S::Ok, S::Error> {
        let names = (1..=motion.start_rad().len()).map(|number| number.to_string());
        MotionInfo::of(names, motion).serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Motion, D::Error> {
        MotionInfo::deserialize(from).map(|info| info.to_motion())
    }
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct StepDone {
    /// In the program, from 1.
    pub number: usize,
    pub what: Cow<'static, str>,
    pub duration_s: f64,
    /// Largest distance from its end, rad; `None` without a motion.
    pub end_off_rad: Option<f64>,
    /// Of each joint, as far as samples say it.
    pub joints: Vec<JointDone>,
}

/// What a joint did in a step.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct JointDone {
    /// Largest distance from the motion, rad.
    pub off_rad: f64,
    /// Largest current and temperature that its drive reported, A and degrees Celsius.
    pub current_a: Option<f64>,
    pub temperature_c: Option<f64>,
}

/// One turn through the program.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Cycle {
    /// From 1.
    pub number: u32,
    pub duration_s: f64,
    pub moved: Vec<Moved>,
    pub steps: Vec<StepDone>,
}

/// What is kept of every cycle.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct CycleDone {
    pub number: u32,
    pub duration_s: f64,
    /// Largest distance of each joint from its motions, rad.
    pub off_rad: Vec<f64>,
    /// How much the distance of each joint from the plan after a step differs from that in the first cycle, at most, rad.
    pub drift_rad: Vec<f64>,
}

/// What was done of a program, as its folder keeps it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ProgramDone {
    /// Name of the program's file.
    pub name: String,
    pub robot: RobotId,
    pub first: Cycle,
    /// The last whole cycle, if it is another one.
    pub last: Option<Cycle>,
    pub cycles: Vec<CycleDone>,
}

/// What a report is about.
pub struct ProgramReport<'a> {
    pub arm: &'a Arm,
    pub done: &'a ProgramDone,
    pub summary: &'a Value,
    /// Files behind the report: name, bytes, checksum.
    pub files: &'a [(String, u64, String)],
}

impl Cycle {
    /// Angles at a time of the cycle, by the motion at work, or the one before, and the time of its plan.
    fn at(&self, t_s: f64, angles: impl Fn(&Moved, f64) -> Joints) -> Joints {
        let begun = self.moved.partition_point(|moved| moved.start_s <= t_s).max(1);
        let of = |moved: &Moved| angles(moved, (t_s - moved.start_s).clamp(0.0, moved.motion.duration_s()));
        self.moved.get(begun - 1).map_or_else(|| Joints::zeros(1), of)
    }

    fn planned(&self, t_s: f64) -> Joints {
        self.at(t_s, |moved, t_s| moved.motion.at(t_s).q)
    }

    fn measured(&self, t_s: f64) -> Joints {
        self.at(t_s, |moved, t_s| measured(&moved.motion, |j| &moved.errors[j], |error| *error, t_s))
    }

    /// Distance of a joint from its motions over the cycle, mrad.
    fn errors(&self, j: usize) -> Vec<(f64, f64)> {
        let all = self.moved.iter().flat_map(|moved| {
            let in_plan = 0.0..=moved.motion.duration_s();
            let errors = moved.errors.get(j).map_or(&[][..], |errors| errors);
            let errors = errors.iter().filter(move |(t_s, _)| in_plan.contains(t_s));
            errors.map(|(t_s, error_rad)| (moved.start_s + t_s, 1e3 * error_rad))
        });
        all.collect()
    }
}

impl ProgramReport<'_> {
    /// One self-contained HTML file.
    #[must_use]
    pub fn html(&self) -> String {
        let count = |key: &str| self.summary.get(key).and_then(Value::as_u64).unwrap_or(0);
        let number = |key: &str| self.summary.get(key).and_then(Value::as_f64);
        let (wanted, done) = (count("cycles_wanted"), count("cycles_done"));
        let cycles = format!("{done} of {wanted} cycles");
        let answer = match cause(Some(self.summary)) {
            Some((why, next)) => Answer::new(format!("ended early: {cycles}"), Tone::Bad, why, next),
            None => {
                let off = 1e3 * number("off_rad").unwrap_or(0.0);
                let drift = number("drift_rad").map_or_else(String::new, |drift| {
                    format!(
                        "; after each step it stood within {:.2} mrad of where it did in the first cycle",
                        1e3 * drift
                    )
                });
                let why = format!("a joint was at most {off:.2} mrad from its motion{drift}");
                Answer::new(
                    format!("done: {cycles}"),
                    Tone::Good,
                    why,
                    "`cycles.csv` has every step of every cycle",
                )
            }
        };
        let took_s = number("duration_s").unwrap_or(0.0);
        let title = format!("Program {}", self.done.name);
        let more = Some(format!("{} steps in {took_s:.1} s", count("steps_done")));
        let mut page = head(&title, &self.done.robot.name, Some(self.summary), more, &answer);
        if self.done.first.moved.is_empty() {
            page.note(
                "No motion is shown: the record of the link holds none of which enough samples were heard.",
            );
        } else {
            self.pictures(&mut page);
        }
        self.steps(&mut page);
        self.drift(&mut page);
        foot(&mut page, &self.done.robot, None, None, Some(self.summary), self.files);
        page.finish()
    }

    /// First and last cycle with their names, the last one last.
    fn shown(&self) -> Vec<(String, &Cycle)> {
        let named = |cycle: &Cycle| format!("cycle {}", cycle.number);
        std::iter::once(&self.done.first).chain(&self.done.last).map(|cycle| (named(cycle), cycle)).collect()
    }

    fn pictures(&self, page: &mut Page) {
        let shown = self.shown();
        let first = &self.done.first;
        let end_s = first.duration_s;
        let planned = |t_s: f64| first.planned(t_s);
        let angles: Vec<_> = shown
            .iter()
            .map(|(_, cycle)| (|t_s: f64| cycle.planned(t_s), |t_s: f64| cycle.measured(t_s)))
            .collect();
        let led = shown.iter().zip(&angles).map(|((name, cycle), (planned, measured))| Led {
            name,
            end_s: cycle.duration_s,
            planned,
            measured,
        });
        let hand = HandPath::of(self.arm, HAND_STEPS, &led.collect::<Vec<_>>());
        let [widest, next, _] = hand.seen_flat();
        page.section(
            "In space",
            "Arm and hand path (blue) as measured in the first cycle, grey dashes as planned. Drag to turn, wheel to zoom; the slider \
             moves all pictures.",
        );
        let time = |i: u32| end_s * f64::from(i) / f64::from(HAND_STEPS);
        let path = (0..=HAND_STEPS).map(|i| self.arm.ball(&self.arm.fk(&planned(time(i)))).pos).collect();
        let data = scene::data(
            self.arm,
            None,
            &scene::SceneMotion {
                q_at: &|t_s| first.measured(t_s),
                to_s: end_s,
                flight: None,
                planned: Some(path),
            },
        );
        page.scene(data, Some(widest));
        page.charts([next]);
        page.part(
            "Tracking",
            "Reference minus measurement in the first and the last cycle, from the record of the link.",
        );
        page.charts((0..self.arm.n()).map(|j| {
            // The first cycle is drawn over the last one.
            let curve = |(k, (name, cycle)): (usize, &(String, &Cycle))| {
                Curve::line(name.clone(), if k == 0 { j } else { 7 }, cycle.errors(j))
            };
            let title = format!("{}: position error", self.arm.joints()[j].name);
            let curves = shown.iter().enumerate().rev().map(curve).collect();
            Chart::new(title, "time of the cycle in s", "error in mrad", curves).over_time(None)
        }));
    }

    fn steps(&self, page: &mut Page) {
        page.section(
            "Steps",
            "Of each cycle shown: how far the joint that was farthest was from the motion and from its end, and the largest current \
             and temperature that a drive reported.",
        );
        let mut rows = Vec::new();
        for (name, cycle) in self.shown() {
            for step in &cycle.steps {
                let farthest =
                    step.joints.iter().enumerate().max_by(|a, b| a.1.off_rad.total_cmp(&b.1.off_rad));
                let mrad = |rad: Option<f64>| number(rad.map(|rad| 1e3 * rad), 2);
                let most = |of: fn(&JointDone) -> Option<f64>, digits: usize| {
                    number(step.joints.iter().filter_map(of).reduce(f64::max), digits)
                };
                let off = farthest.map(|(_, joint)| joint.off_rad);
                let tone = off.map_or(Tone::Plain, |off| Tone::of(off <= POSITION_BOUND_RAD));
                rows.push(vec![
                    cell(&name),
                    cell(step.number),
                    cell(&step.what),
                    number(step.duration_s, 3),
                    (mrad(off).0, tone),
                    cell(farthest.map_or("–".to_owned(), |(j, _)| self.arm.joints()[j].name.clone())),
                    mrad(step.end_off_rad),
                    most(|joint| joint.current_a, 1),
                    most(|joint| joint.temperature_c, 0),
                ]);
            }
        }
        let head =
            ["cycle", "step", "what", "took s", "off mrad", "joint", "end off mrad", "current A", "°C"];
        page.table(&head, rows);
    }

    fn drift(&self, page: &mut Page) {
        let cycles = &self.done.cycles;
        if cycles.len() < 2 {
            return;
        }
        page.part(
            "Over the cycles",
            "Change since the first cycle of the distance from the plan after a step, distance from the motions, and time, the largest \
             of each cycle.",
        );
        let per_joint = |of: fn(&CycleDone) -> &[f64]| -> Vec<Curve> {
            let curve = |j: usize| {
                let points = cycles.iter().map(|cycle| (f64::from(cycle.number), 1e3 * of(cycle)[j]));
                Curve::line(self.arm.joints()[j].name.clone(), j, points.collect())
            };
            (0..self.arm.n()).map(curve).collect()
        };
        let chart = |title: &str, y_label: &str, curves: Vec<Curve>| Chart {
            y_at_least: Some((0.0, 0.0)),
            ..Chart::new(title, "cycle", y_label, curves)
        };
        let times = cycles.iter().map(|cycle| (f64::from(cycle.number), cycle.duration_s)).collect();
        page.charts([
            chart("Change since the first cycle", "mrad", per_joint(|cycle| &cycle.drift_rad)),
            chart("Distance from the motions", "mrad", per_joint(|cycle| &cycle.off_rad)),
            chart("Time of a cycle", "s", vec![Curve::line("", 0, times)]),
        ]);
    }
}
