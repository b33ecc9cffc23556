//! A program on an arm, as often as asked: `cubectl run FILE.toml --repeat N`.

use std::sync::atomic::Ordering;

use operator::interrupt::interrupt;
use operator::job::{Answer, Extent, Order, Progress, Record};
use planner::plan::Joints;
use planner::plan::file::RobotId;
use planner::store::fingerprint_of;
use protocol::Duration;

use super::connected::Connected;
use super::ended::outcome_last;
use super::folder::Folder;
use super::link::{Link, Machine};
use super::log::report;
use super::print_json;
use super::program_file::{ArmProgram, Step};
use super::program_record::{Done, Performed, table};
use super::progress::Ui;
use super::rows::Rows;
use super::run::Args;
use crate::error::ExpectedError;
use crate::exit;

/// Time between two looks for a signal, a stop and an answer.
const LOOK: Duration = Duration::from_millis(20);

const QUESTION: &str = "The arm does the program. Nobody near?";

/// Runs the verb for a program.
pub(super) fn run(args: &Args) -> Result<(), ExpectedError> {
    args.retime.require_none()?;
    if args.start_in.is_some() {
        return Err(ExpectedError::bad_input("--start-in-s is for one motion; a program has many")
            .next("leave --start-in-s out"));
    }
    let mut ui = args.moving.ui(QUESTION, true)?;
    let mut on = args.moving.on.of_robot()?;
    let (program, arm) = ArmProgram::read(&args.file, on.bus.cell.robot.as_deref())?;
    on.bus.cell.robot = Some(program.robot.clone());
    let machine = Machine::of(&on)?;
    let folder = Folder::recording(args.out.as_deref(), &mut on.bus)?;
    let mut table = folder.as_ref().map(|folder| table(folder, arm.n())).transpose()?;
    let link = Link::open(&on, &machine, folder.as_ref(), args.moving.json)?;
    let mut link = link.watched(&args.moving.web, &machine)?;
    let fingerprint = fingerprint_of(&arm);
    let mut performed = Performed::nothing(arm.n());
    let outcome = link.with(|operator| {
        let mut connected = Connected::new(operator, &arm, &fingerprint);
        let mut row = |row: &str| table.iter_mut().for_each(|table| table.line(row));
        let outcome = perform(&mut connected, &program, args, &mut ui, &mut row, &mut performed);
        performed.end(connected.operator.now());
        outcome
    });
    ui.progress.quiet();
    let wrong = outcome.err().map(|error| match performed.at {
        Some((cycle, step)) => error.at(format!("cycle {cycle}, step {step}")),
        None => error,
    });
    let mut ended = link.end();
    let finished = ended.keep(&machine, folder.as_ref(), None);
    let finished = std::mem::replace(&mut ended.finished, Ok(())).and(finished);
    let written = table.map_or(Ok(()), Rows::finish);
    let mut summary = performed.summary(args.repeat, wrong.as_ref());
    ended.seen.enter(&mut summary);
    if args.moving.json {
        print_json(&summary);
    } else {
        performed.say(args.repeat);
        if let Some(folder) = &folder {
            console::line!("results in {}", folder.path.display());
        }
    }
    let robot = RobotId::of(&program.robot, &arm);
    let kept = folder
        .as_ref()
        .map_or(Ok(()), |folder| report::program::keep(folder, &args.file, performed, robot, &summary));
    ended.show(if wrong.is_none() { "done" } else { "ended early" }, folder.as_ref());
    outcome_last(wrong, finished.and(written).and(kept), folder.as_ref().map(|folder| folder.path.as_path()))
}

/// Does the program of `args` on an arm that is connected; each row of `cycles.csv` goes to `keep`.
pub fn on_arm(
    arm: &mut Connected<'_, '_>,
    args: &Args,
    keep: &mut dyn FnMut(&str),
) -> Result<(), ExpectedError> {
    let (program, _) = ArmProgram::read(&args.file, args.moving.on.bus.cell.robot.as_deref())?;
    let mut ui = args.moving.ui(QUESTION, true)?;
    perform(arm, &program, args, &mut ui, keep, &mut Performed::nothing(arm.robot.n()))
}

/// All cycles. What was done until an error is in `performed`.
fn perform(
    arm: &mut Connected<'_, '_>,
    program: &ArmProgram,
    args: &Args,
    ui: &mut Ui,
    keep: &mut dyn FnMut(&str),
    performed: &mut Performed,
) -> Result<(), ExpectedError> {
    let from = arm.begin(args.moving.home, &mut |step| ui.answer(step))?;
    let cycles = program.cycles(arm.robot, from, args.repeat)?;
    for part in cycles.iter().take(2).flat_map(|parts| &**parts) {
        if let Step::Move(motion) = &part.step {
            arm.operator.require_passed(motion)?;
        }
    }
    if arm.operator.foreseen_pose().is_some() {
        arm.ready(args.moving.home, &mut |step| ui.answer(step))?;
    }
    ui.agree(arm.operator)?;
    performed.begun = Some(arm.operator.now());
    for (parts, cycle) in cycles.iter().zip(1..) {
        performed.begin_cycle(cycle, arm.operator.now());
        for part in &**parts {
            performed.at = Some((cycle, part.number));
            let begun = arm.operator.now();
            let record = carry_out(arm, &part.step, args, ui)?;
            let record = match &part.step {
                Step::Move(motion) => record.map(|record| (motion, record)),
                _ => None,
            };
            let ended = arm.operator.now();
            let q_rad = Joints::from_slice(&arm.operator.pose()?);
            keep(&performed.take(Done { part, begun, ended, q_rad, record }));
        }
        performed.end_cycle(arm.operator.now());
        ui.progress.cycle(cycle, args.repeat);
    }
    performed.at = None;
    Ok(())
}

/// One step; of a motion, what is known of it.
fn carry_out(
    arm: &mut Connected<'_, '_>,
    step: &Step,
    args: &Args,
    ui: &mut Ui,
) -> Result<Option<Record>, ExpectedError> {
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
                tolerances: args.tolerance.of(arm.robot.n())?,
                ..arm.order(motion.clone(), Extent::Run)
            };
            arm.run(&order, &mut |step| match step {
                // Begin and end of the many steps of each motion are no news.
                Progress::May(_) => ui.answer(step),
                _ => Answer::Yes,
            })
            .map(Some)
        }
    }
}
