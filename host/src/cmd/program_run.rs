//! A program on an arm, as often as asked: `cubectl run FILE.toml --repeat N`.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::atomic::Ordering;

use operator::interrupt::interrupt;
use operator::job::{Answer, Extent, Order, Progress};
use operator::port::{OnBus, Operator as _};
use planner::plan::Joints;
use planner::store::robot_fingerprint;
use protocol::{Duration, Instant};
use serde_json::json;

use super::connected::Connected;
use super::controlled::tell_warnings;
use super::ended::outcome_last;
use super::folder::Folder;
use super::program_file::{ArmProgram, Part, Step};
use super::progress::Ui;
use super::report::BIT_RATE;
use super::rows::Rows;
use super::run::Args;
use super::{fixed, print_json};
use crate::error::ExpectedError;
use crate::exit;

/// Time between two looks for a signal, a stop and an answer.
const LOOK: Duration = Duration::from_millis(20);

/// Runs the verb for a program.
pub(super) fn run(args: &Args) -> Result<(), ExpectedError> {
    args.retime.require_none()?;
    if args.start_in.is_some() {
        return Err(ExpectedError::bad_input("--start-in is for one motion; a program has many")
            .next("leave --start-in out"));
    }
    let mut ui = args.moving.ui("The arm does the program. Nobody near?", true)?;
    let mut on = args.moving.on.clone();
    let (program, arm) = ArmProgram::read(&args.file, on.bus.cell.robot.as_deref())?;
    on.bus.cell.robot = Some(program.robot.clone());
    let folder = Folder::recording(args.out.as_deref(), &mut on.bus)?;
    let mut table = folder.as_ref().map(|folder| Table::create(folder, arm.n())).transpose()?;
    let mut session = on.session()?;
    let fingerprint = format!("{:016x}", robot_fingerprint(&arm));
    let operator = OnBus::new(&mut session, on.controller, BIT_RATE);
    let mut performed = Performed::default();
    let mut connected = Connected::new(operator, &arm, &fingerprint);
    let outcome = perform(
        &mut connected,
        &program,
        args,
        &mut ui,
        &mut |row| {
            if let Some(table) = &mut table {
                table.write(row);
            }
        },
        &mut performed,
    );
    ui.progress.quiet();
    tell_warnings(&mut session);
    let wrong = outcome.err().map(|error| match performed.at {
        Some((cycle, step)) => error.at(format!("cycle {cycle}, step {step}")),
        None => error,
    });
    let finished = session.finish().map_err(ExpectedError::from);
    let written = table.map_or(Ok(()), |table| table.0.finish());
    let summary = performed.summary(args.repeat, wrong.as_ref());
    let kept =
        folder.as_ref().map_or(Ok(()), |folder| folder.write("summary.json", &format!("{summary:#}\n")));
    if args.moving.json {
        print_json(&summary);
    } else {
        performed.say(args.repeat);
        if let Some(folder) = &folder {
            console::line!("results in {}", folder.path.display());
        }
    }
    outcome_last(wrong, finished.and(written).and(kept), folder.as_ref().map(|folder| folder.path.as_path()))
}

/// What was done.
#[derive(Default)]
struct Performed {
    /// Whole turns through the program.
    cycles: u32,
    steps: u32,
    /// Cycle and step at work, from 1.
    at: Option<(u32, usize)>,
    begun: Option<Instant>,
    duration: Duration,
    /// Largest distance of a joint from its motion, rad.
    off_rad: f64,
    /// Measured less planned angles after each step when it was done first, and how far later ones were from them, rad.
    first: BTreeMap<usize, Joints>,
    drift_rad: Option<f64>,
}

/// A step that was done.
struct Row {
    cycle: u32,
    step: usize,
    what: &'static str,
    begun_s: f64,
    duration_s: f64,
    /// Largest distance of a joint from the motion, from its end, rad, and which joint, from 1.
    off: Option<(f64, f64, usize)>,
    q_rad: Joints,
}

/// All cycles. What was done until an error is in `performed`.
fn perform(
    arm: &mut Connected<'_, '_>,
    program: &ArmProgram,
    args: &Args,
    ui: &mut Ui,
    keep: &mut dyn FnMut(&Row),
    performed: &mut Performed,
) -> Result<(), ExpectedError> {
    let from = arm.ready(args.moving.home, &mut |step| ui.answer(step))?;
    let cycles = program.cycles(arm.robot, from, args.repeat)?;
    ui.agree(&mut arm.operator)?;
    performed.begun = Some(arm.operator.now());
    for (parts, cycle) in cycles.iter().zip(1..) {
        for part in &**parts {
            performed.at = Some((cycle, part.number));
            let begun = arm.operator.now();
            let off = carry_out(arm, &part.step, args, ui)?;
            let now = arm.operator.now();
            let q_rad = Joints::from_slice(&arm.operator.pose()?);
            performed.take(part, &q_rad, off.map(|(off, ..)| off));
            let since = |at: Instant| at.saturating_since(performed.begun.unwrap_or(at)).as_secs_f64();
            keep(&Row {
                cycle,
                step: part.number,
                what: part.step.name(),
                begun_s: since(begun),
                duration_s: now.saturating_since(begun).as_secs_f64(),
                off,
                q_rad,
            });
            performed.duration = now.saturating_since(performed.begun.unwrap_or(now));
        }
        performed.cycles = cycle;
        ui.progress.cycle(cycle, args.repeat);
    }
    performed.at = None;
    Ok(())
}

/// One step; of a motion, how far the arm was from it and from its end, and which joint.
fn carry_out(
    arm: &mut Connected<'_, '_>,
    step: &Step,
    args: &Args,
    ui: &mut Ui,
) -> Result<Option<(f64, f64, usize)>, ExpectedError> {
    match step {
        Step::There => Ok(None),
        Step::Grip { open } => {
            arm.operator.heed_stops()?;
            arm.operator.set_gripper(*open)?;
            // The time that a gripper takes is what the program waits.
            Ok(None)
        }
        Step::Wait(span) => {
            let until = arm.operator.now() + *span;
            while arm.operator.now() < until {
                arm.operator.pass(LOOK.min(until.saturating_since(arm.operator.now())))?;
                arm.operator.heed_stops()?;
                if interrupt().load(Ordering::Relaxed) {
                    return Err(ExpectedError::new(exit::INTERRUPTED, "interrupted; the arm stands"));
                }
            }
            Ok(None)
        }
        Step::Move(motion) => {
            // No way of its own: an arm that is not where the motion begins is refused.
            let order = Order {
                patience: Duration::from_secs_f64(args.timeout),
                ..arm.order(motion.clone(), Extent::Run)
            };
            let record = arm.run(&order, &mut |step| match step {
                // Begin and end of the many steps of each motion are no news.
                Progress::May(_) => ui.answer(step),
                _ => Answer::Yes,
            })?;
            Ok(record.reached.map(|reached| (reached.off_rad, reached.end_off_rad, reached.off_joint + 1)))
        }
    }
}

impl Performed {
    fn take(&mut self, part: &Part, q_rad: &Joints, off_rad: Option<f64>) {
        self.steps += 1;
        self.off_rad = self.off_rad.max(off_rad.unwrap_or(0.0));
        if !part.is_last {
            return;
        }
        let error = q_rad - part.end;
        match self.first.entry(part.number) {
            Entry::Vacant(first) => {
                first.insert(error);
            }
            Entry::Occupied(first) => {
                let drift_rad = (error - *first.get()).amax();
                self.drift_rad = Some(self.drift_rad.unwrap_or(0.0).max(drift_rad));
            }
        }
    }

    fn summary(&self, wanted: u32, wrong: Option<&ExpectedError>) -> serde_json::Value {
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

    fn say(&self, wanted: u32) {
        let took = fixed(self.duration.as_secs_f64(), 1);
        console::line!("{} of {wanted} cycles, {} steps in {took} s", self.cycles, self.steps);
        console::line!("a joint was at most {} mrad from its motion", fixed(1e3 * self.off_rad, 1));
        if let Some(drift_rad) = self.drift_rad {
            let drift = fixed(1e3 * drift_rad, 2);
            console::line!(
                "after each step it stood within {drift} mrad of how far it was from its plan in the first cycle"
            );
        }
    }
}

/// `cycles.csv`, a row per step, on the disk as soon as the step is done.
struct Table(Rows);

impl Table {
    fn create(folder: &Folder, joints: usize) -> Result<Self, ExpectedError> {
        let mut rows = Rows::create(&folder.file("cycles.csv"))?;
        let angles: String = (1..=joints).map(|k| format!(",q_rad_{k}")).collect();
        rows.line(&format!("cycle,step,what,begun_s,duration_s,off_rad,end_off_rad,off_joint{angles}\n"));
        Ok(Self(rows))
    }

    fn write(&mut self, row: &Row) {
        let off = row.off.map_or(",,".to_owned(), |(off, end, joint)| {
            format!("{},{},{joint}", fixed(off, 6), fixed(end, 6))
        });
        let angles: String = row.q_rad.iter().map(|q| format!(",{}", fixed(*q, 6))).collect();
        let (begun, took) = (fixed(row.begun_s, 3), fixed(row.duration_s, 3));
        self.0.line(&format!("{},{},{},{begun},{took},{off}{angles}\n", row.cycle, row.step, row.what));
    }
}
