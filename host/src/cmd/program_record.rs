//! What was done of a program: `cycles.csv` step by step, `summary.json`, and what the report shows.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use operator::job::Record;
use planner::motion::Motion;
use planner::plan::Joints;
use planner::plan::file::RobotId;
use protocol::{Duration, Instant};
use serde_json::json;

use super::fixed;
use super::folder::Folder;
use super::program_file::Part;
use super::rows::Rows;
use crate::error::ExpectedError;
use crate::exit;
use crate::report::program::{Cycle, CycleDone, JointDone, Moved, ProgramDone, StepDone};

/// What was done.
pub(super) struct Performed {
    /// Whole turns through the program.
    pub(super) cycles: u32,
    steps: u32,
    /// Cycle and step at work, from 1.
    pub(super) at: Option<(u32, usize)>,
    pub(super) begun: Option<Instant>,
    duration: Duration,
    /// Largest distance of a joint from its motion, rad.
    off_rad: f64,
    /// Measured less planned angles after each step when it was done first, and how far later ones were from them, rad.
    first_error_rad: BTreeMap<usize, Joints>,
    drift_rad: Option<f64>,
    /// The first cycle, the last whole one, and the one at work.
    first: Cycle,
    last: Option<Cycle>,
    now: Cycle,
    now_begun: Instant,
    off_in_now_rad: Joints,
    drift_in_now_rad: Joints,
    done: Vec<CycleDone>,
}

/// A part that was done.
pub(super) struct Done<'a> {
    pub(super) part: &'a Part,
    pub(super) begun: Instant,
    pub(super) ended: Instant,
    /// Where the arm stands, rad.
    pub(super) q_rad: Joints,
    pub(super) record: Option<(&'a Motion, Record)>,
}

impl Performed {
    /// Nothing yet, of an arm with so many joints.
    pub(super) fn nothing(joints: usize) -> Self {
        Self {
            cycles: 0,
            steps: 0,
            at: None,
            begun: None,
            duration: Duration::ZERO,
            off_rad: 0.0,
            first_error_rad: BTreeMap::new(),
            drift_rad: None,
            first: Cycle::default(),
            last: None,
            now: Cycle::default(),
            now_begun: Instant::ZERO,
            off_in_now_rad: Joints::zeros(joints),
            drift_in_now_rad: Joints::zeros(joints),
            done: Vec::new(),
        }
    }

    pub(super) fn begin_cycle(&mut self, number: u32, now: Instant) {
        self.now = Cycle { number, ..Cycle::default() };
        self.now_begun = now;
        let joints = self.off_in_now_rad.len();
        (self.off_in_now_rad, self.drift_in_now_rad) = (Joints::zeros(joints), Joints::zeros(joints));
    }

    /// Takes what was done; its row of `cycles.csv`.
    pub(super) fn take(&mut self, done: Done<'_>) -> String {
        let Done { part, begun, ended, q_rad, record } = done;
        self.steps += 1;
        let reached = record.as_ref().and_then(|(_, record)| record.reached.clone());
        self.off_rad = self.off_rad.max(reached.as_ref().map_or(0.0, |reached| reached.off_rad));
        let since = |at: Instant| at.saturating_since(self.begun.unwrap_or(at)).as_secs_f64();
        let (begun_s, duration_s) = (since(begun), ended.saturating_since(begun).as_secs_f64());
        self.duration = ended.saturating_since(self.begun.unwrap_or(ended));
        if part.is_last {
            self.take_end(part, &q_rad);
        }
        let mut joints = Vec::new();
        if let Some((motion, analysis)) = record.and_then(|(motion, record)| Some((motion, record.analysis?)))
        {
            joints.extend(analysis.joints.iter().map(|joint| JointDone {
                off_rad: joint.position_error_rad.max,
                current_a: joint.current_peak_a,
                temperature_c: joint.temperature_peak_c,
            }));
            for (most, joint) in self.off_in_now_rad.iter_mut().zip(&joints) {
                *most = most.max(joint.off_rad);
            }
            let start_s = analysis.start_log_s - self.now_begun.as_secs_f64();
            self.now.moved.push(Moved::new(start_s, motion.clone(), &analysis.joints));
        }
        let what = part.step.name();
        let off = reached.as_ref().map_or(",,".to_owned(), |reached| {
            format!(
                "{},{},{}",
                fixed(reached.off_rad, 6),
                fixed(reached.end_off_rad, 6),
                reached.off_joint + 1
            )
        });
        let mut row = format!("{},{},{what}", self.now.number, part.number);
        row += &format!(",{},{},{off}", fixed(begun_s, 3), fixed(duration_s, 3));
        let n = q_rad.len();
        let columns = |of: &dyn Fn(&JointDone) -> Option<f64>, digits: usize| -> String {
            let value = |j: usize| joints.get(j).and_then(of).map_or(String::new(), |x| fixed(x, digits));
            (0..n).map(|j| format!(",{}", value(j))).collect()
        };
        row.extend(q_rad.iter().map(|q_rad| format!(",{}", fixed(*q_rad, 6))));
        row += &columns(&|joint| Some(joint.off_rad), 6);
        row += &columns(&|joint| joint.current_a, 3);
        row += &columns(&|joint| joint.temperature_c, 0);
        let end_off_rad = reached.map(|reached| reached.end_off_rad);
        self.now.steps.push(StepDone {
            number: part.number,
            what: what.into(),
            duration_s,
            end_off_rad,
            joints,
        });
        row + "\n"
    }

    /// How far the arm stands from the plan, beside the first time.
    fn take_end(&mut self, part: &Part, q_rad: &Joints) {
        let error = q_rad - part.end;
        match self.first_error_rad.entry(part.number) {
            Entry::Vacant(first) => {
                first.insert(error);
            }
            Entry::Occupied(first) => {
                let change = (error - *first.get()).abs();
                self.drift_rad = Some(self.drift_rad.unwrap_or(0.0).max(change.amax()));
                self.drift_in_now_rad = self.drift_in_now_rad.sup(&change);
            }
        }
    }

    /// A cycle is whole.
    pub(super) fn end_cycle(&mut self, now: Instant) {
        self.cycles = self.now.number;
        let cycle = self.cycle_until(now);
        self.done.push(CycleDone {
            number: cycle.number,
            duration_s: cycle.duration_s,
            off_rad: self.off_in_now_rad.as_slice().to_vec(),
            drift_rad: self.drift_in_now_rad.as_slice().to_vec(),
        });
        if cycle.number == 1 {
            self.first = cycle;
        } else {
            self.last = Some(cycle);
        }
    }

    fn cycle_until(&mut self, now: Instant) -> Cycle {
        let duration_s = now.saturating_since(self.now_begun).as_secs_f64();
        Cycle { duration_s, ..std::mem::take(&mut self.now) }
    }

    /// Nothing more is done. A first cycle that is not whole is shown as far as it came.
    pub(super) fn end(&mut self, now: Instant) {
        if self.cycles == 0 {
            self.first = self.cycle_until(now);
        }
    }

    /// What its report is made from.
    pub(super) fn into_done(self, name: String, robot: RobotId) -> ProgramDone {
        ProgramDone { name, robot, first: self.first, last: self.last, cycles: self.done }
    }

    pub(super) fn summary(&self, wanted: u32, wrong: Option<&ExpectedError>) -> serde_json::Value {
        json!({
            "format": "cubectl-program-run",
            "version": 1,
            "outcome": if wrong.is_none() { "done" } else { "ended_early" },
            "code": wrong.map_or(exit::OK, |error| error.code),
            "cause": wrong.map(ExpectedError::all_that_happened),
            "next": wrong.map(ExpectedError::all_steps).unwrap_or_default(),
            "cycles_wanted": wanted,
            "cycles_done": self.cycles,
            "steps_done": self.steps,
            "at": self.at.map(|(cycle, step)| json!({ "cycle": cycle, "step": step })),
            "duration_s": self.duration.as_secs_f64(),
            "off_rad": self.off_rad,
            "drift_rad": self.drift_rad,
        })
    }

    pub(super) fn say(&self, wanted: u32) {
        let took = fixed(self.duration.as_secs_f64(), 1);
        console::line!("{} of {wanted} cycles, {} steps in {took} s", self.cycles, self.steps);
        console::line!("a joint was at most {} mrad from its motion", fixed(1e3 * self.off_rad, 2));
        if let Some(drift_rad) = self.drift_rad {
            let drift = fixed(1e3 * drift_rad, 2);
            console::line!(
                "after each step it stood within {drift} mrad of how far it was from its plan in the first cycle"
            );
        }
    }
}

/// `cycles.csv`, a row per step, on the disk as soon as the step is done.
pub(super) fn table(folder: &Folder, joints: usize) -> Result<Rows, ExpectedError> {
    let mut rows = Rows::create(&folder.file("cycles.csv"))?;
    let columns = ["q_rad", "off_rad", "current_peak_a", "temperature_peak_c"];
    let joints: String =
        columns.iter().flat_map(|name| (1..=joints).map(move |k| format!(",{name}_{k}"))).collect();
    rows.line(&format!("cycle,step,what,begun_s,duration_s,off_rad,end_off_rad,off_joint{joints}\n"));
    Ok(rows)
}
