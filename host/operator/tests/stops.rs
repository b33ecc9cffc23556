//! A stop that the program did not send ends its job at any time. Judged by the ball and the joints of the simulated cell.

use hil_sim::scenario::Action;
use hil_sim::scenario::ScriptedHost;
use operator::bus::args::Cell;
use operator::bus::period::settings_with_gains;
use operator::bus::{BusArgs, Session};
use operator::job::{
    Answer, Extent, JobError, Judge, OnProgress, Order, Outcome, Program, Progress, Question, Record, Step,
    default_tolerance_m, perform,
};
use operator::port::{BallSeen, InProcess, OnBus, Operator};
use planner::motion::{Knot, Motion};
use planner::plan::file::PlanFile;
use planner::plan::{Arm, Joints};
use planner::way::Travel;
use protocol::cyphal::id::NodeId;
use protocol::{Duration, ExtendedId, Frame, Instant, JointIndex, ModuleId, StandardId};

use crate::common::{homed, plan};

/// The stop message of node 99, and the halt broadcast to the drives.
fn stops() -> [Frame; 2] {
    let message = Frame::from_array(ExtendedId::from_low_bits(0x0063_E863), [1, 4, 0, 0, 0xE0]);
    [message, Frame::from_array(StandardId::from_low_bits(0x100), [0x02])]
}

fn cell(plan: &PlanFile, homed: bool, stop: Option<(f64, Frame)>) -> Cell {
    let mut cell = BusArgs::default().cell.load().unwrap();
    cell.setup.cell.drive.starts_homed = homed;
    cell.setup.cell.gripper.landing_z_m = Some(plan.target.position_m[2]);
    cell.setup.actions.extend(stop.map(|(at_s, frame)| Action {
        at: Instant::from_micros((1e6 * at_s) as u64),
        frames: vec![frame],
        every: None,
        count: None,
    }));
    cell
}

struct Thrown {
    record: Record,
    ball: BallSeen,
    /// Joint angles of the plant when the job ended.
    stands_rad: Vec<f64>,
}

fn throw(operator: &mut dyn Operator, arm: &Arm, plan: &PlanFile, answers: OnProgress<'_>) -> Record {
    let order = Order { extent: Extent::Back, ..Order::throw(arm, plan, Travel::default()) };
    perform(operator, &order, answers)
}

fn on_a_bus(arm: &Arm, plan: &PlanFile, cell: &Cell) -> Thrown {
    on_a_bus_with(arm, plan, cell, &mut |_| Answer::Yes)
}

fn on_a_bus_with(arm: &Arm, plan: &PlanFile, cell: &Cell, answers: OnProgress<'_>) -> Thrown {
    let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    let mut session = BusArgs::default().open_cell(cell, Some(&settings)).unwrap();
    let record = throw(&mut OnBus::new(&mut session, None), arm, plan, answers);
    let cell = session.sim().unwrap().cell();
    Thrown { record, ball: BallSeen::of(cell), stands_rad: angles(cell) }
}

fn in_process(arm: &Arm, plan: &PlanFile, cell: &Cell) -> Thrown {
    in_process_with(arm, plan, cell, &mut |_| Answer::Yes)
}

fn in_process_with(arm: &Arm, plan: &PlanFile, cell: &Cell, answers: OnProgress<'_>) -> Thrown {
    let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    let mut operator = InProcess::new(&cell.robot, &cell.setup, cell.seed, &settings).unwrap();
    let record = throw(&mut operator, arm, plan, answers);
    let cell = operator.cell();
    Thrown { record, ball: BallSeen::of(cell), stands_rad: angles(cell) }
}

fn angles(cell: &hil_sim::Cell) -> Vec<f64> {
    (0..6).map(|joint| cell.plant().link_q_rad(joint)).collect()
}

/// It was reported as a stop, by another node or with a cause that names one.
fn is_reported(thrown: &Thrown, what: &str) {
    let Record { ended, verdict, .. } = &thrown.record;
    let Some(JobError::Operator(error)) = ended else { panic!("{what}: {}", verdict.text) };
    assert!(error.is_stop_by_other(), "{what}: {error}");
    assert_eq!(verdict.outcome, Outcome::Stopped, "{what}: {}", verdict.text);
}

#[test]
fn a_stop_while_nothing_moves_ends_the_throw_on_every_link_and_nothing_is_thrown() {
    let (arm, plan) = plan();
    let links: [fn(&Arm, &PlanFile, &Cell) -> Thrown; 2] = [on_a_bus, in_process];
    for frame in stops() {
        for at_s in [0.03, 0.2, 7.345, 7.36, 7.37, 7.39] {
            for (link, run) in links.iter().enumerate() {
                let what = format!("{frame:?} at {at_s} s, link {link}");
                let thrown = run(&arm, &plan, &cell(&plan, false, Some((at_s, frame))));
                assert_eq!(thrown.ball.released_at, None, "{what}: thrown");
                is_reported(&thrown, &what);
            }
        }
    }
}

#[test]
fn a_stop_while_a_person_is_asked_ends_the_throw_although_the_answer_is_yes() {
    let (arm, plan) = plan();
    let clean = on_a_bus(&arm, &plan, &cell(&plan, true, None));
    let stands_at = clean.record.steps.iter().find(|(step, ..)| *step == Step::Approach).unwrap().2;
    for frame in stops() {
        for run in [on_a_bus_with, in_process_with] {
            let cell = cell(&plan, true, Some((stands_at.as_secs_f64() + 0.5, frame)));
            // The person takes two seconds.
            let mut looks = 0;
            let thrown = run(&arm, &plan, &cell, &mut |progress| match progress {
                Progress::May(Question::Throw) => {
                    looks += 1;
                    if looks > 100 { Answer::Yes } else { Answer::Waiting }
                }
                _ => Answer::Yes,
            });
            assert_eq!(thrown.ball.released_at, None, "{frame:?}: thrown");
            is_reported(&thrown, &format!("{frame:?}"));
        }
    }
}

/// A session whose controller has homed, and another node that stops it `after_s` from now.
fn session_with_stop(frame: Frame, after_s: f64) -> (Session, NodeId) {
    let (mut session, node) = homed();
    session.watch_stops();
    let at = session.now() + Duration::from_secs_f64(after_s);
    let sim = session.sim().unwrap();
    let script = |participants: &mut operator::bus::sim::SimParticipants, _| {
        let action = Action { at, frames: vec![frame], every: None, count: None };
        participants.0.0.1.node = ScriptedHost::new(&[action]);
    };
    sim.world().with_participants(script).unwrap();
    (session, node)
}

#[test]
fn a_stop_ends_a_jog_and_a_homing_and_what_follows_a_stop_at_rest() {
    let third = JointIndex::new(2).unwrap();
    for frame in stops() {
        let (mut session, node) = session_with_stop(frame, 0.3);
        let jogged = session.jog_joint(node, third, 0.1, &mut |_| true).unwrap_err();
        assert!(jogged.is_stop_by_other(), "{frame:?} in a jog: {jogged}");

        let (mut session, node) = session_with_stop(frame, 0.1);
        let limit = Duration::from_secs(30);
        let ended = session.home_joint(node, (third, ModuleId::new(3).unwrap()), limit, None).unwrap_err();
        assert!(ended.is_stop_by_other(), "{frame:?} in a homing: {ended}");

        let (mut session, node) = session_with_stop(frame, 0.1);
        session.pass(Duration::from_millis(500)).unwrap();
        let begun_rad = session.sim().unwrap().cell().plant().link_q_rad(2);
        let refused = session.jog_joint(node, third, 0.1, &mut |_| true).unwrap_err();
        assert!(refused.is_stop_by_other(), "{frame:?} before a jog: {refused}");
        let stands_rad = session.sim().unwrap().cell().plant().link_q_rad(2);
        assert!((stands_rad - begun_rad).abs() < 1e-4, "{frame:?}: it moved");
        // Reported once: work that must follow is not ended by it.
        session.register(node, "cycle.period_us").unwrap();
    }
}

#[test]
fn a_stop_in_the_flight_keeps_the_arm_where_it_is_and_says_where_the_ball_went() {
    let (arm, plan) = plan();
    let links: [fn(&Arm, &PlanFile, &Cell) -> Thrown; 2] = [on_a_bus, in_process];
    for (link, run) in links.iter().enumerate() {
        let clean = run(&arm, &plan, &cell(&plan, true, None));
        assert!(clean.record.ended.is_none(), "{}", clean.record.verdict.text);
        let begun = |step| clean.record.steps.iter().find(|(s, ..)| *s == step).unwrap().1.as_secs_f64();
        let motion: Motion = plan.motion.to_motion();
        let end_rad = motion.stop_rad();
        for frame in stops() {
            let at_s = 0.5 * (begun(Step::Flight) + begun(Step::Return));
            let what = format!("{frame:?} at {at_s} s, link {link}");
            let thrown = run(&arm, &plan, &cell(&plan, true, Some((at_s, frame))));
            is_reported(&thrown, &what);
            let off = thrown.stands_rad.iter().zip(end_rad.iter()).map(|(a, b)| (a - b).abs());
            assert!(off.fold(0.0, f64::max) < 0.02, "{what}: the arm went back");
            let landed = thrown.record.landing.expect("the cell saw it").error_m;
            assert!(landed < default_tolerance_m(&arm, &plan), "{what}: {landed}");
            let text = &thrown.record.verdict.text;
            assert!(text.contains("the ball left the hand"), "{text}");
        }
    }
}

/// A short motion from where the homed arm stands, with the judge of `cubectl run`.
fn short_move(arm: &Arm, plan: &PlanFile, from_rad: &[f64]) -> Order<'static> {
    let from = Joints::from_slice(from_rad);
    let knot = |t_s: f64, q_rad: Joints| Knot { t_s, q_rad, qd_rad_s: Joints::zeros(q_rad.len()) };
    let knots = vec![knot(0.0, from), knot(0.8, from.map(|q| q + 0.1))];
    let program = Program::Motion(Motion { knots, events: Vec::new() });
    let arm: &'static Arm = Box::leak(Box::new(arm.clone()));
    Order::new(arm, &plan.robot.fingerprint, program, Judge::Reach)
}

/// A homed arm, run by one of two links; a person takes a second to agree.
fn moved(
    link: usize,
    arm: &Arm,
    plan: &PlanFile,
    stop: Option<(f64, Frame)>,
) -> (Record, Vec<f64>, Vec<f64>) {
    let cell = cell(plan, true, stop);
    let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    let mut looks = 0;
    let mut answers = |progress: Progress<'_>| match progress {
        Progress::May(_) => {
            looks += 1;
            if looks > 50 { Answer::Yes } else { Answer::Waiting }
        }
        _ => Answer::Yes,
    };
    if link == 0 {
        let mut session = BusArgs::default().open_cell(&cell, Some(&settings)).unwrap();
        let stood = angles(session.sim().unwrap().cell());
        let order = short_move(arm, plan, &stood);
        let mut operator = OnBus::new(&mut session, None);
        let record = perform(&mut operator, &order, &mut answers);
        (record, stood, angles(session.sim().unwrap().cell()))
    } else {
        let mut operator = InProcess::new(&cell.robot, &cell.setup, cell.seed, &settings).unwrap();
        let stood = angles(operator.cell());
        let record = perform(&mut operator, &short_move(arm, plan, &stood), &mut answers);
        (record, stood, angles(operator.cell()))
    }
}

#[test]
fn a_motion_that_is_run_is_judged_by_its_samples_and_by_the_plant() {
    let (arm, plan) = plan();
    for link in [0, 1] {
        let (record, stood, stands) = moved(link, &arm, &plan, None);
        assert_eq!(record.verdict.outcome, Outcome::Reached, "{}", record.verdict.text);
        let reached = record.reached.expect("samples");
        println!("link {link}: {reached:?}");
        for (before, after) in stood.iter().zip(&stands) {
            assert!((after - before - 0.1).abs() < 2e-3, "{before} {after}");
        }
        // A step of a drive is 0.35 mrad; a motion without a comparison would have no error at all.
        assert!((1e-5..0.03).contains(&reached.off_rad) && reached.end_off_rad < 2e-3, "{reached:?}");
        assert!(reached.samples > 600, "{reached:?}");
    }
}

#[test]
fn a_stop_by_another_node_ends_a_run_in_every_step_and_the_arm_stands() {
    let (arm, plan) = plan();
    for link in [0, 1] {
        let (clean, ..) = moved(link, &arm, &plan, None);
        let middle = |step: Step| {
            let (_, begun, ended) = *clean.steps.iter().find(|(s, ..)| *s == step).expect("a step");
            0.5 * (begun.as_secs_f64() + ended.as_secs_f64())
        };
        let asked =
            clean.steps.iter().find(|(s, ..)| *s == Step::Gains).expect("a step").2.as_secs_f64() + 0.5;
        let places = [
            ("drives", middle(Step::Drives)),
            ("question", asked),
            ("arm", middle(Step::Arm)),
            ("run", middle(Step::Run)),
        ];
        for frame in stops() {
            for (place, at_s) in places {
                let (record, stood, stands) = moved(link, &arm, &plan, Some((at_s, frame)));
                let what = format!("link {link}, {frame:?} in {place}: {}", record.verdict.text);
                let Some(JobError::Operator(error)) = &record.ended else { panic!("{what}") };
                assert!(error.is_stop_by_other(), "{what}");
                assert_eq!(record.verdict.outcome, Outcome::Stopped, "{what}");
                let way = stood.iter().zip(&stands).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                // Along the path of 0.1 rad it stops where it is.
                assert!(if place == "run" { way < 0.095 } else { way < 1e-3 }, "{what}: {way}");
            }
        }
    }
}
