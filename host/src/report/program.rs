//! HTML report of a program that was done again and again: hand, tracking and steps of its first and last cycle, and what changed between.

use serde_json::Value;

use super::chart::{Chart, Curve};
use super::frame::{cause, foot, head};
use super::hand::{HandPath, Led, measured};
use super::page::{Answer, Page, Tone, cell};
use super::scene;
use operator::analysis::POSITION_BOUND_RAD;
use operator::analysis::tracking::JointTracking;
use planner::motion::Motion;
use planner::plan::file::RobotId;
use planner::throw::{Arm, Joints};

/// Points of the path of the hand, and of a curve over time.
const HAND_STEPS: u32 = 1_200;
const CURVE_POINTS: usize = 500;

/// A motion of a cycle.
#[derive(Debug, Clone)]
pub struct Moved {
    /// When it began, s since the begin of the cycle.
    pub start_s: f64,
    pub motion: Motion,
    /// What the samples say of it, one per joint.
    pub joints: Vec<JointTracking>,
}

/// A step that was done.
#[derive(Debug, Clone)]
pub struct StepDone {
    /// In the program, from 1.
    pub number: usize,
    pub what: &'static str,
    pub duration_s: f64,
    /// Largest distance from its end, rad; `None` without a motion.
    pub end_off_rad: Option<f64>,
    /// Of each joint, as far as samples say it.
    pub joints: Vec<JointDone>,
}

/// What a joint did in a step.
#[derive(Debug, Clone, Copy)]
pub struct JointDone {
    /// Largest distance from the motion, rad.
    pub off_rad: f64,
    /// Largest current and temperature that its drive reported, A and degrees Celsius.
    pub current_a: Option<f64>,
    pub temperature_c: Option<f64>,
}

/// One turn through the program.
#[derive(Debug, Clone, Default)]
pub struct Cycle {
    /// From 1.
    pub number: u32,
    pub duration_s: f64,
    pub moved: Vec<Moved>,
    pub steps: Vec<StepDone>,
}

/// What is kept of every cycle.
#[derive(Debug, Clone)]
pub struct CycleDone {
    pub number: u32,
    pub duration_s: f64,
    /// Largest distance of each joint from its motions, rad.
    pub off_rad: Joints,
    /// How much the distance of each joint from the plan after a step differs from that in the first cycle, at most, rad.
    pub drift_rad: Joints,
}

/// What a report is about.
pub struct ProgramReport<'a> {
    /// Name of the program's file.
    pub name: &'a str,
    pub arm: &'a Arm,
    pub robot: &'a RobotId,
    pub summary: &'a Value,
    pub first: &'a Cycle,
    /// The last whole cycle, if it is another one.
    pub last: Option<&'a Cycle>,
    pub cycles: &'a [CycleDone],
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
        self.at(t_s, |moved, t_s| measured(&moved.motion, &moved.joints, t_s))
    }

    /// Distance of a joint from its motions over the cycle, mrad.
    fn errors(&self, j: usize) -> Vec<(f64, f64)> {
        let all = self.moved.iter().flat_map(|moved| {
            let in_plan = 0.0..=moved.motion.duration_s();
            let samples = moved.joints.get(j).map_or(&[][..], |joint| &joint.samples);
            let samples = samples.iter().filter(move |sample| in_plan.contains(&sample.t_s));
            samples.map(|sample| (moved.start_s + sample.t_s, 1e3 * sample.error_rad))
        });
        thinned(&all.collect::<Vec<_>>())
    }
}

/// At most [`CURVE_POINTS`]: of neighbours the one that is farthest from zero.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let size = points.len().div_ceil(CURVE_POINTS).max(1);
    let farthest = |some: &[(f64, f64)]| some.iter().copied().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    points.chunks(size).filter_map(farthest).collect()
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
        let title = format!("Program {}", self.name);
        let more = Some(format!("{} steps in {took_s:.1} s", count("steps_done")));
        let mut page = head(&title, &self.robot.name, Some(self.summary), more, &answer);
        if self.first.moved.is_empty() {
            page.note(
                "No motion is shown: the record of the bus holds none of which enough samples were heard.",
            );
        } else {
            self.pictures(&mut page);
        }
        self.steps(&mut page);
        self.drift(&mut page);
        foot(&mut page, self.robot, None, None, Some(self.summary), self.files);
        page.finish()
    }

    /// First and last cycle with their names, the last one last.
    fn shown(&self) -> Vec<(String, &Cycle)> {
        let named = |cycle: &Cycle| format!("cycle {}", cycle.number);
        std::iter::once(self.first).chain(self.last).map(|cycle| (named(cycle), cycle)).collect()
    }

    fn pictures(&self, page: &mut Page) {
        let shown = self.shown();
        let end_s = self.first.duration_s;
        let planned = |t_s: f64| self.first.planned(t_s);
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
                q_at: &|t_s| self.first.measured(t_s),
                to_s: end_s,
                flight: None,
                planned: Some(path),
            },
        );
        page.scene(data, &format!("<figure class=\"card\">{}</figure>", widest.svg()));
        page.charts(&[next]);
        page.part(
            "Tracking",
            "Reference minus measurement in the first and the last cycle, from the record of the bus. Of each few samples the one \
             farthest from the motion is drawn.",
        );
        let charts: Vec<Chart> = (0..self.arm.n())
            .map(|j| {
                // The first cycle is drawn over the last one.
                let curve = |(k, (name, cycle)): (usize, &(String, &Cycle))| {
                    Curve::line(name.clone(), if k == 0 { j } else { 7 }, cycle.errors(j))
                };
                Chart {
                    title: format!("{}: position error", self.arm.joints()[j].name),
                    x_label: "time of the cycle in s".to_owned(),
                    y_label: "error in mrad".to_owned(),
                    curves: shown.iter().enumerate().rev().map(curve).collect(),
                    is_time: true,
                    ..Chart::default()
                }
            })
            .collect();
        page.charts(&charts);
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
                let mrad = |rad: Option<f64>| rad.map_or("–".to_owned(), |rad| format!("{:.2}", 1e3 * rad));
                let most = |of: fn(&JointDone) -> Option<f64>, digits: usize| {
                    let most = step.joints.iter().filter_map(of).reduce(f64::max);
                    cell(most.map_or("–".to_owned(), |value| format!("{value:.digits$}")))
                };
                let off = farthest.map(|(_, joint)| joint.off_rad);
                let tone = match off {
                    Some(off) if off > POSITION_BOUND_RAD => Tone::Bad,
                    Some(_) => Tone::Good,
                    None => Tone::Plain,
                };
                rows.push(vec![
                    cell(name.clone()),
                    cell(step.number.to_string()),
                    cell(step.what),
                    cell(format!("{:.3}", step.duration_s)),
                    (mrad(off), tone),
                    cell(farthest.map_or("–".to_owned(), |(j, _)| self.arm.joints()[j].name.clone())),
                    cell(mrad(step.end_off_rad)),
                    most(|joint| joint.current_a, 1),
                    most(|joint| joint.temperature_c, 0),
                ]);
            }
        }
        page.table(
            &["cycle", "step", "what", "took s", "off mrad", "joint", "end off mrad", "current A", "°C"],
            &rows,
        );
    }

    fn drift(&self, page: &mut Page) {
        if self.cycles.len() < 2 {
            return;
        }
        page.part(
            "Over the cycles",
            "Change since the first cycle of the distance from the plan after a step, distance from the motions, and time, the largest \
             of each cycle.",
        );
        let per_joint = |of: &dyn Fn(&CycleDone) -> Joints| -> Vec<Curve> {
            let curve = |j: usize| {
                let points: Vec<_> =
                    self.cycles.iter().map(|cycle| (f64::from(cycle.number), 1e3 * of(cycle)[j])).collect();
                Curve::line(self.arm.joints()[j].name.clone(), j, thinned(&points))
            };
            (0..self.arm.n()).map(curve).collect()
        };
        let chart = |title: &str, y_label: &str, curves: Vec<Curve>| Chart {
            title: title.to_owned(),
            x_label: "cycle".to_owned(),
            y_label: y_label.to_owned(),
            curves,
            y_at_least: Some((0.0, 0.0)),
            ..Chart::default()
        };
        let times: Vec<_> =
            self.cycles.iter().map(|cycle| (f64::from(cycle.number), cycle.duration_s)).collect();
        page.charts(&[
            chart("Change since the first cycle", "mrad", per_joint(&|cycle| cycle.drift_rad)),
            chart("Distance from the motions", "mrad", per_joint(&|cycle| cycle.off_rad)),
            chart("Time of a cycle", "s", vec![Curve::line("", 0, thinned(&times))]),
        ]);
    }
}
