//! Streams of commands over the wire, in the simulated cell. The plant judges: angles and speeds of its joints, which no node on
//! the bus can read, and the distance between the bodies there.

use hil_sim::witness::Trace;
use nalgebra::{Vector3, Vector6};
use operator::bus::Session;
use operator::port::{OnBus, Operator as _};
use operator::servo::{Keeps, Next, Stream, Streamed, follow};
use planner::plan::rng::SplitMix64;
use planner::plan::{Arm, Joints};
use planner::servo::{Command, DISTANCE_M, Limited, Refused, Servo, bounds_of};
use protocol::{Duration, Instant};
use robot_model::Pose;
use robot_model::collision::{CollisionChecker, Obb, Scene};

use crate::common::homed;

const SHARE: f64 = 0.4;
const HOLD_S: f64 = 0.2;

/// Commands at their times, and what was made of them.
struct Listed {
    commands: Vec<(f64, Command)>,
    next: usize,
    refused: Vec<Refused>,
    limited: Vec<Limited>,
}

impl Listed {
    fn new(commands: Vec<(f64, Command)>) -> Self {
        Self { commands, next: 0, refused: Vec::new(), limited: Vec::new() }
    }
}

impl Stream for Listed {
    fn next(&mut self, t_s: f64) -> Next {
        match self.commands.get(self.next) {
            None => Next::End,
            Some((due_s, _)) if *due_s > t_s => Next::Nothing,
            Some((_, command)) => {
                self.next += 1;
                Next::Command(*command)
            }
        }
    }

    fn refused(&mut self, _t_s: f64, why: Refused) {
        self.refused.push(why);
    }

    fn ticked(&mut self, _t_s: f64, _servo: &Servo<'_>, limited: Option<&Limited>) {
        self.limited.extend(limited.cloned());
    }
}

fn arm() -> Arm {
    Arm::load("powercube6").unwrap()
}

fn scene_with(obstacle: Option<Obb>) -> Scene {
    Scene { obstacles: obstacle.map(|obb| ("post".to_owned(), obb)).into_iter().collect(), ball_held: false }
}

/// Follows a stream; what came of it, and how the joints moved.
fn followed(
    session: &mut Session,
    keeps: &Keeps,
    listed: &mut Listed,
) -> (Streamed, Trace, (Instant, Instant)) {
    let traced = |session: &mut Session| {
        session.sim().unwrap().world().with_participants(|all, _| all.0.0.0.take_trace()).unwrap()
    };
    session.sim().unwrap().world().with_participants(|all, _| all.0.0.0.record_trace()).unwrap();
    let from = session.now();
    let mut operator = OnBus::new(session, None);
    operator.connect().unwrap();
    let streamed = follow(&mut operator, &arm(), keeps, listed).unwrap();
    session.pass(Duration::from_millis(300)).unwrap();
    let to = session.now();
    (streamed, traced(session).unwrap(), (from, to))
}

/// Speeds, accelerations and joint ranges, and the least distance between bodies, by the plant.
fn judge(trace: &Trace, (from, to): (Instant, Instant), keeps: &Keeps) -> f64 {
    let (arm, bounds) = (arm(), bounds_of(&arm(), keeps.share));
    let mut checker = CollisionChecker::new(&arm, &keeps.scene);
    let (first, last) = (trace.index_at(from), trace.index_at(to));
    let window = (20_000 / trace.step().as_micros()) as usize;
    let mut nearest_m = f64::INFINITY;
    for index in (first + window..last).step_by(4) {
        let (now, before) = (trace.sample(index), trace.sample(index - window));
        for (k, ([q, v], [_, v_before])) in now.iter().zip(before).enumerate() {
            let limits = &arm.joints()[k].limits;
            assert!((limits.q_min_rad..=limits.q_max_rad).contains(q), "joint {k} at {q}");
            // The loop of a drive overshoots a step of the speed.
            assert!(v.abs() <= 1.1 * bounds[k].v_rad_s.min(keeps.v_max_rad_s), "joint {k}: {v} rad/s");
            let a = (v - v_before).abs() / 0.02;
            // The controller's feedback and the loop of the drive add theirs.
            assert!(a <= 1.2 * bounds[k].a_rad_s2 + 0.5, "joint {k}: {a} rad/s2");
        }
        if index % 20 == 0 {
            let q = Joints::from_fn(now.len(), |k| now[k][0]);
            nearest_m = nearest_m.min(checker.clearance(&arm.fk(&q)).distance_m);
        }
    }
    nearest_m
}

fn keeps(scene: Scene) -> Keeps {
    Keeps { share: SHARE, v_max_rad_s: f64::INFINITY, hold: Duration::from_secs_f64(HOLD_S), scene }
}

/// Where a joint is at the end of the trace, and how fast.
fn at_end(trace: &Trace, to: Instant, joint: usize) -> [f64; 2] {
    trace.sample(trace.index_at(to) - 1)[joint]
}

#[test]
fn joints_follow_a_stream_of_angles_with_the_lead_and_rest_at_its_end() {
    let (mut session, _) = homed();
    let begin = session.find_controller(None).and_then(|node| session.measured_pose(node)).unwrap();
    let wave = |t_s: f64, k: usize| {
        begin[k] + 0.2 * (1.0 - (1.5 * t_s).cos()) * if k.is_multiple_of(2) { 1.0 } else { -0.5 }
    };
    let commands = (0..400).map(|i| {
        let t_s = f64::from(i) * 0.01;
        (t_s, Command::Joints(Joints::from_fn(6, |k| wave(t_s, k))))
    });
    let mut listed = Listed::new(commands.collect());
    let (streamed, trace, span) = followed(&mut session, &keeps(Scene::default()), &mut listed);
    assert_eq!((streamed.taken, streamed.refused, streamed.restarts, streamed.unsent), (400, 0, 0, 0));
    assert!(streamed.late.is_empty(), "{:?}", streamed.late);
    judge(&trace, span, &keeps(Scene::default()));
    for k in 0..6 {
        let [q, v] = at_end(&trace, span.1, k);
        // The last command is where the stream was; from there it comes to rest.
        assert!((q - wave(3.99, k)).abs() < 0.04 && v.abs() < 1e-3, "joint {k}: {q} for {}", wave(3.99, k));
        assert!((q - streamed.end_rad[k]).abs() < 3e-3);
    }
    session.finish().unwrap();
}

/// Twenty per cent lost, gaps, commands out of order, values that are not numbers, jumps of half a turn.
#[test]
fn whatever_is_streamed_the_arm_keeps_its_limits_and_its_distance() {
    let free = f64::INFINITY;
    for (seed, share, v_max_rad_s) in [
        (1, SHARE, free),
        (2, SHARE, free),
        (3, 0.05, free),
        (4, 1.0, free),
        (5, 1.0, free),
        (6, SHARE, 0.25),
    ] {
        let mut rng = SplitMix64::new(seed);
        let mut commands = Vec::new();
        let mut t_s = 0.0;
        while t_s < 6.0 {
            t_s += 0.01 * rng.unit() + if rng.unit() < 0.03 { 0.1 + 0.3 * rng.unit() } else { 0.0 };
            let number = |rng: &mut SplitMix64, most: f64| match rng.unit() {
                u if u < 0.01 => f64::NAN,
                u if u < 0.02 => f64::INFINITY,
                u if u < 0.1 => (if rng.unit() < 0.5 { 1.0 } else { -1.0 }) * std::f64::consts::PI,
                _ => most * (2.0 * rng.unit() - 1.0),
            };
            let command = match (rng.unit() * 5.0) as u32 {
                0 => Command::Joints(Joints::from_fn(6, |_| number(&mut rng, 2.0))),
                1 => Command::JointSpeeds(Joints::from_fn(6, |_| number(&mut rng, 3.0))),
                2 => Command::Point(Vector3::from_fn(|_, _| number(&mut rng, 0.8))),
                3 => Command::Pose(Pose::from_rpy(
                    [number(&mut rng, 3.0), number(&mut rng, 3.0), number(&mut rng, 3.0)],
                    Vector3::from_fn(|_, _| number(&mut rng, 0.8)),
                )),
                _ => Command::HandSpeed(Vector6::from_fn(|_, _| number(&mut rng, 1.0))),
            };
            // Each command holds for a while, so that the arm gets somewhere.
            let times = 1 + (rng.unit() * 40.0) as usize;
            for _ in 0..times {
                t_s += 0.01;
                if rng.unit() > 0.2 {
                    commands.push((t_s + 0.02 * rng.unit(), command));
                }
            }
        }
        let (mut session, _) = homed();
        let mut listed = Listed::new(commands);
        let scene = scene_with(Some(Obb::new(Pose::translation(0.5, 0.3, 0.5), Vector3::new(0.1, 0.1, 0.5))));
        let keeps = Keeps { share, v_max_rad_s, ..keeps(scene) };
        let (streamed, trace, span) = followed(&mut session, &keeps, &mut listed);
        assert!(streamed.late.is_empty() && streamed.restarts == 0, "{seed}: {streamed:?}");
        assert!(streamed.taken > 100 && !listed.refused.is_empty(), "{seed}: {streamed:?}");
        assert!(!listed.limited.is_empty(), "seed {seed}: nothing was in the way");
        let nearest_m = judge(&trace, span, &keeps);
        let travel =
            (0..6).map(|k| (at_end(&trace, span.1, k)[0] - trace.sample(trace.index_at(span.0))[k][0]).abs());
        println!(
            "seed {seed}, share {share}: {} taken, {} refused, {} ticks limited, nearest {:.1} mm, net travel {:.2} rad",
            streamed.taken,
            streamed.refused,
            streamed.limited,
            1e3 * nearest_m,
            travel.fold(0.0, f64::max)
        );
        // Tracking takes some of the distance.
        assert!(nearest_m > 0.5 * DISTANCE_M && nearest_m < 0.2, "seed {seed}: {nearest_m} m");
        assert!((0..6).all(|k| at_end(&trace, span.1, k)[1].abs() < 1e-3));
        session.finish().unwrap();
    }
}

#[test]
fn a_stream_that_falls_silent_leaves_a_standing_arm_after_the_time_to_hold() {
    let (mut session, _) = homed();
    let slow = Command::JointSpeeds(Joints::from_fn(6, |k| if k == 0 { 0.2 } else { 0.0 }));
    let mut commands: Vec<(f64, Command)> = (0..50).map(|i| (f64::from(i) * 0.02, slow)).collect();
    commands.extend((0..20).map(|i| (3.0 + f64::from(i) * 0.02, slow)));
    let mut listed = Listed::new(commands);
    let (streamed, trace, (from, to)) = followed(&mut session, &keeps(Scene::default()), &mut listed);
    let at = |t_s: f64| trace.sample(trace.index_at(from + Duration::from_secs_f64(t_s)))[0];
    // The stream begins when the controller runs, some tenths of a second after the call.
    assert!((at(1.2)[1] - 0.2).abs() < 0.01, "it moves: {:?}", at(1.2));
    let [q, _] = at(2.7);
    assert!((q - at(2.4)[0]).abs() < 1e-3, "it stands: {} and {q} rad", at(2.4)[0]);
    let way = q - at(0.0)[0];
    let most = 0.2 * (1.0 + HOLD_S + 0.3);
    assert!(way > 0.15 && way < most, "{way} rad of at most {most}");
    assert!(at_end(&trace, to, 0)[0] > q + 1e-3, "and goes on with the next command");
    assert_eq!(streamed.restarts, 0);
    session.finish().unwrap();
}

#[test]
fn the_hand_goes_with_the_speed_that_is_asked_for() {
    let (mut session, _) = homed();
    let node = session.find_controller(None).unwrap();
    let begin = Joints::from_slice(&session.measured_pose(node).unwrap());
    let arm = arm();
    // Away from the stretched pose first, where the hand cannot move along the arm.
    let bent = begin + Joints::from_slice(&[0.0, 0.4, 0.8, 0.0, 0.6, 0.0]);
    let go = (0..200).map(|i| (f64::from(i) * 0.02, Command::Joints(bent)));
    let twist = Command::HandSpeed(Vector6::new(0.0, 0.05, 0.0, 0.0, 0.0, 0.0));
    let along = (0..100).map(|i| (4.0 + f64::from(i) * 0.02, twist));
    let mut listed = Listed::new(go.chain(along).collect());
    let (streamed, trace, (_, to)) = followed(&mut session, &keeps(Scene::default()), &mut listed);
    assert_eq!((streamed.refused, streamed.restarts), (0, 0));
    let end = Joints::from_fn(6, |k| at_end(&trace, to, k)[0]);
    let (from, moved) = (arm.ee_at(&bent), arm.ee_at(&end));
    let way = moved.pos - from.pos;
    assert!((way.y - 0.05 * 2.0).abs() < 0.02, "{way}");
    assert!(way.x.abs() < 5e-3 && way.z.abs() < 5e-3, "{way}");
    assert!((moved.rot - from.rot).amax() < 0.02, "it keeps its orientation");
    session.finish().unwrap();
}
