//! New end states and start times over the wire, in the simulated cell: a moving catch point at 120 Hz. Judged by
//! the plant: angles and speeds of its joints, which no node on the bus can read.

use firmware::envelope::Envelope;
use firmware::events::Action;
use firmware::fault::Cause;
use firmware::joints::PerJoint;
use firmware::retarget::{Course, EndState};
use firmware::settings::Settings;
use firmware::trajectory_format::{FILE_LEN_MAX, Header, encode};
use hil_sim::witness::Trace;
use operator::bus::Session;
use operator::dialogue::clock::ControllerClock;
use operator::dialogue::online::EndStates;
use operator::dialogue::operator::OperatorError;
use operator::trajectory::standing;
use protocol::cyphal::cubecell::command::Trajectory;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant, JointIndex};

use crate::common::homed;

const JOINTS: usize = 6;
/// Time between two end states.
const UPDATE: Duration = Duration::from_micros(8_333);

/// Pose of the arm as the plant has it, rad.
fn pose(session: &mut Session) -> Vec<f64> {
    let plant = session.sim().unwrap().cell().plant();
    (0..JOINTS).map(|axis| plant.link_q_rad(axis)).collect()
}

/// Uploads and arms a plan that stands where the arm stands, and takes new end states.
fn armed(session: &mut Session, node: NodeId) -> Trajectory {
    let pose = session.measured_pose(node).unwrap();
    let bytes = standing(&Settings::powercube6(), &pose, 20_000_000).unwrap();
    let name = session.upload(node, &bytes, &mut |_, _| {}).unwrap();
    session.arm(node, &name).unwrap();
    name
}

fn pass(session: &mut Session, span: Duration) {
    session.pass(span).unwrap();
}

/// Largest speed and change of speed over 10 ms of each joint between two times, and whether a soft limit was passed.
fn judge(trace: &Trace, from: Instant, to: Instant) {
    let settings = Settings::powercube6();
    let (first, last) = (trace.index_at(from), trace.index_at(to));
    let window = (10_000 / trace.step().as_micros()) as usize;
    for (axis, joint) in JointIndex::first(JOINTS).enumerate() {
        let limits = settings.joint.at(joint);
        for index in first + window..last {
            let ([q, v], [_, before]) = (trace.sample(index)[axis], trace.sample(index - window)[axis]);
            assert!(q >= limits.q_min_rad.into() && q <= limits.q_max_rad.into(), "joint {axis} at {q}");
            assert!(v.abs() <= limits.v_max_rad_s.into(), "joint {axis}: {v} rad/s");
            let a = (v - before).abs() / 0.01;
            // The position loop of a drive overshoots a step of the acceleration.
            assert!(a <= 1.2 * f64::from(limits.a_max_rad_s2), "joint {axis}: {a} rad/s2");
        }
    }
}

/// State of the joints at a time, by the plant.
fn at(trace: &Trace, t: Instant) -> Vec<[f64; 2]> {
    trace.sample(trace.index_at(t)).to_vec()
}

#[test]
fn a_moving_catch_point_at_120_hz_is_met_by_the_plant_within_its_limits() {
    let (mut session, node) = homed();
    let name = armed(&mut session, node);
    let begin = pose(&mut session);
    let mut clock = ControllerClock::default();
    session.read_clock(node, &mut clock).unwrap();
    let (_, off) = clock.controller_time(session.now()).unwrap();
    println!("clock of the controller within {off}");
    assert!(off < Duration::from_millis(2));
    session.start_run(node, &name).unwrap();
    session
        .sim()
        .unwrap()
        .world()
        .with_participants(|participants, _| participants.0.0.0.record_trace())
        .unwrap();
    pass(&mut session, Duration::from_millis(100));

    let from = session.now();
    let ours = from + Duration::from_millis(640);
    let (arrive, _) = clock.controller_time(ours).unwrap();
    let catch = [(0.25, 0.6), (0.2, 0.9), (-0.1, -0.5), (0.2, 0.4), (-0.2, -0.8), (0.3, 0.9)];
    let mut answered = Vec::new();
    for update in 0..=60u32 {
        // An estimate that converges: 20 mm on half a metre at first.
        let wave =
            |i: usize| (f64::from(update) * 1.7 + i as f64).sin() * 0.04 / (1.0 + f64::from(update) / 6.0);
        let scale = if update == 60 { 0.0 } else { 1.0 };
        let end = EndStates {
            at: arrive,
            q_rad: (0..JOINTS).map(|i| begin[i] + catch[i].0 + scale * wave(i)).collect(),
            qd_rad_s: (0..JOINTS).map(|i| catch[i].1 + scale * wave(i + 6)).collect(),
            events: Vec::new(),
        };
        session.send_target(update as u8, &end).unwrap();
        pass(&mut session, UPDATE);
        answered.extend(session.target_answers(node));
    }
    pass(&mut session, Duration::from_millis(40));
    answered.extend(session.target_answers(node));
    let sequences: Vec<u8> = answered.iter().map(|answer| answer.sequence).collect();
    assert_eq!(sequences, (0..=60).collect::<Vec<u8>>(), "each is answered, in order");
    assert!(answered.iter().all(|answer| answer.outcome.is_ok()), "{answered:?}");

    session.wait_for(Duration::from_secs(5), &|state| state == State::Ready).unwrap();
    session.release_motion();
    let group = session.group().unwrap();
    assert_eq!(group.targets_taken, 61);
    let (last, to) = (pose(&mut session), session.now());
    let trace = session
        .sim()
        .unwrap()
        .world()
        .with_participants(|participants, _| participants.0.0.0.take_trace())
        .unwrap()
        .unwrap();
    judge(&trace, from, to);
    // The controller and the cell have one clock in virtual time.
    let met = at(&trace, arrive);
    let (mut worst_q, mut worst_qd) = (0.0f64, 0.0f64);
    for ((met, begin), catch) in met.iter().zip(&begin).zip(catch) {
        worst_q = worst_q.max((met[0] - begin - catch.0).abs());
        worst_qd = worst_qd.max((met[1] - catch.1).abs());
    }
    println!(
        "61 end states: at the arrival {:.2} mrad and {:.1} mrad/s off at most; {} cycles late, {} saturated, {} replies missed",
        1e3 * worst_q,
        1e3 * worst_qd,
        group.cycles_late,
        group.cycles_saturated,
        group.replies_missed
    );
    assert!(worst_q < 4e-3 && worst_qd < 0.06, "{worst_q} rad, {worst_qd} rad/s");
    // The rest is at the place of the law, computed here from the end state alone.
    let envelope = Envelope::widest(&Settings::powercube6());
    for (i, joint) in JointIndex::first(JOINTS).enumerate() {
        let end = EndState { q_rad: (begin[i] + catch[i].0) as f32, qd_rad_s: catch[i].1 as f32 };
        let start = EndState { q_rad: end.q_rad, qd_rad_s: 0.0 };
        let course = Course::solve((0, start), (600_000, end), envelope.joint.at(joint)).unwrap();
        let rest_rad = f64::from(course.pieces().last().unwrap().q_rad);
        assert!((last[i] - rest_rad).abs() < 3e-3, "joint {i} rests at {} for {rest_rad}", last[i]);
    }
    session.finish().unwrap();
}

#[test]
fn refused_end_states_come_back_with_cause_and_joint_and_the_arm_stays_where_it_is() {
    let (mut session, node) = homed();
    let name = armed(&mut session, node);
    let begin = pose(&mut session);
    session.start_run(node, &name).unwrap();
    let mut clock = ControllerClock::default();
    session.read_clock(node, &mut clock).unwrap();
    let (now, _) = clock.controller_time(session.now()).unwrap();
    let stay =
        |at: Instant| EndStates { at, q_rad: begin.clone(), qd_rad_s: vec![0.0; JOINTS], events: Vec::new() };
    let soon = now + Duration::from_millis(500);
    let mut fast = stay(soon);
    fast.qd_rad_s[4] = 8.0;
    let mut far = stay(soon);
    far.q_rad[2] += 0.9;
    let mut late_event = stay(soon);
    late_event.events.push((soon + Duration::from_secs(5), Action::Close));
    for (sequence, end) in [fast, far, late_event, stay(now)].iter().enumerate() {
        session.send_target(sequence as u8, end).unwrap();
        pass(&mut session, Duration::from_millis(30));
    }
    let got: Vec<_> = session
        .target_answers(node)
        .iter()
        .map(|answer| answer.outcome.map_err(|refusal| (refusal.cause, refusal.joint.map(JointIndex::get))))
        .collect();
    let expected = [
        Err((Cause::TargetVelocity, Some(4))),
        Err((Cause::TargetAcceleration, Some(2))),
        Err((Cause::TargetEvent, None)),
        Err((Cause::TargetTooSoon, None)),
    ];
    assert_eq!(got, expected);
    // An end state that the message cannot hold is not sent.
    let mut wide = stay(soon);
    wide.q_rad[0] = 9.0;
    assert!(matches!(session.send_target(9, &wide), Err(OperatorError::TargetNotSaid { .. })));
    for (q, before) in pose(&mut session).iter().zip(&begin) {
        assert!((q - before).abs() < 1e-3);
    }
}

#[test]
fn a_run_begins_at_its_time_by_the_plant_and_a_disarmed_one_does_not() {
    let (mut session, node) = homed();
    let settings = Settings::powercube6();
    let begin = session.measured_pose(node).unwrap();
    // Half a radian per second in each joint for a while, from rest to rest.
    let knot = |t_us: u32, q: f64, qd: f64| {
        let mut state = PerJoint::default();
        for (joint, from) in JointIndex::first(JOINTS).zip(&begin) {
            state.set(joint, ((from + q) as f32, qd as f32));
        }
        firmware::spline::Knot { t_us, state }
    };
    let knots = [knot(0, 0.0, 0.0), knot(300_000, 0.1, 0.5), knot(600_000, 0.2, 0.0)];
    let header = Header {
        joints: JOINTS as u8,
        period_us: settings.cycle_period_us,
        robot_crc32: settings.robot_crc32,
        ..Header::default()
    };
    let mut bytes = vec![0; FILE_LEN_MAX];
    let len = encode(&header, &knots, &mut bytes).unwrap();
    let name = session.upload(node, &bytes[..len], &mut |_, _| {}).unwrap();
    let mut clock = ControllerClock::default();
    session.read_clock(node, &mut clock).unwrap();

    // Disarmed by another node while it waits: a controller in this program accepts this order from any node.
    session.arm(node, &name).unwrap();
    let (start, _) = clock.controller_time(session.now() + Duration::from_secs(2)).unwrap();
    let error = session
        .run_trajectory_at(node, &name, Some(start), Duration::from_secs(1), &[], &mut |_, _| {})
        .unwrap_err();
    assert!(matches!(error, OperatorError::NoProgress { state: State::Armed, .. }), "{error}");
    session.disarm(node).unwrap();
    session.release_motion();
    pass(&mut session, Duration::from_secs(2));
    assert_eq!(session.group().unwrap().state, State::Ready);

    session.arm(node, &name).unwrap();
    let passed = clock.controller_time(session.now()).unwrap().0;
    let error = session
        .run_trajectory_at(node, &name, Some(passed), Duration::from_secs(1), &[], &mut |_, _| {})
        .unwrap_err();
    assert!(error.to_string().contains("has passed"), "{error}");

    session
        .sim()
        .unwrap()
        .world()
        .with_participants(|participants, _| participants.0.0.0.record_trace())
        .unwrap();
    let (start, _) = clock.controller_time(session.now() + Duration::from_millis(777)).unwrap();
    let mut shown = Vec::new();
    session
        .run_trajectory_at(node, &name, Some(start), Duration::from_secs(5), &[], &mut |_, group| {
            shown.push((group.state, group.start_in_us));
        })
        .unwrap();
    assert!(shown.iter().any(|(state, left)| *state == State::Armed && *left > 0), "{shown:?}");
    let trace = session
        .sim()
        .unwrap()
        .world()
        .with_participants(|participants, _| participants.0.0.0.take_trace())
        .unwrap()
        .unwrap();
    // Half of the way is done at half of the time.
    for (i, from) in begin.iter().enumerate() {
        let q = at(&trace, start + Duration::from_millis(300))[i][0] - from;
        assert!((q - 0.1).abs() < 3e-3, "joint {i}: {q}");
        let q = at(&trace, start)[i][0] - from;
        assert!(q.abs() < 1e-3, "joint {i}: {q}");
    }
}
