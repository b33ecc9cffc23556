//! A stop that the program did not give ends its job at any time. The ball and the joints of the simulated cell judge it.

use hil_sim::scenario::Action;
use hil_sim::scenario::ScriptedHost;
use operator::bus::args::Cell;
use operator::bus::period::settings_with_gains;
use operator::bus::{BusArgs, Session};
use operator::job::{
    Answer, Extent, JobError, OnProgress, Order, Outcome, Progress, Question, Record, Step,
    default_tolerance_m, perform,
};
use operator::port::{BallSeen, InProcess, OnBus, Operator};
use operator::way::Travel;
use planner::motion::Motion;
use planner::plan::Arm;
use planner::plan::file::PlanFile;
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
    let settings = settings_with_gains(&cell.robot).unwrap();
    let mut session = BusArgs::default().open_cell(cell, Some(&settings)).unwrap();
    let record =
        throw(&mut OnBus::new(&mut session, None, cell.setup.bus.bit_rate_bit_s), arm, plan, answers);
    let cell = session.sim().unwrap().cell();
    Thrown { record, ball: BallSeen::of(cell), stands_rad: angles(cell) }
}

fn in_process(arm: &Arm, plan: &PlanFile, cell: &Cell) -> Thrown {
    in_process_with(arm, plan, cell, &mut |_| Answer::Yes)
}

fn in_process_with(arm: &Arm, plan: &PlanFile, cell: &Cell, answers: OnProgress<'_>) -> Thrown {
    let settings = settings_with_gains(&cell.robot).unwrap();
    let mut operator = InProcess::new(&cell.robot, &cell.setup, cell.seed, &settings).unwrap();
    let record = throw(&mut operator, arm, plan, answers);
    let cell = operator.cell();
    Thrown { record, ball: BallSeen::of(cell), stands_rad: angles(cell) }
}

fn angles(cell: &hil_sim::Cell) -> Vec<f64> {
    (0..6).map(|joint| cell.plant().link_q_rad(joint)).collect()
}

/// It was reported as a stop, by somebody else or with a cause that names one.
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
        // Reported once: what must follow is not ended by it.
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
