//! What the simulated robot does with corrections, against closed forms.

use crate::krc_rig::{ARM, Answer, MS, Rig, config, fault, running, wide};
use hil_sim::krc::KrcEvent;
use hil_sim::krc::drives::Drives;
use hil_sim::krc::options::{KrcOptions, LagOptions, Space};
use proptest::prelude::*;
use protocol::{Duration, Instant};
use robot_model::{JointVec, Pose};
use rsi_protocol::Generation;

const C2: Generation = Generation::KrC2;
const C4: Generation = Generation::KrC4;

fn on_a1(deg: f64) -> Answer {
    Answer { correction: [deg, 0.0, 0.0, 0.0, 0.0, 0.0], ..Answer::default() }
}

/// A set point steps by 1 deg at the cycle of 24 ms: a line over the 12 ms before 24 ms + 96 ms, then a lag of 24 ms.
#[test]
fn step_response_is_dead_time_line_and_first_order_lag() {
    let mut bench = Rig::new(wide(C2)).start(|_| on_a1(1.0));
    let (cycle, lag, reached) = (0.012, 0.024, 0.024 + 0.096);
    let closed = |t: f64| {
        // Response of the lag to a ramp of slope 1 that starts at zero.
        let ramp = |t: f64| if t <= 0.0 { 0.0 } else { t - lag * (1.0 - (-t / lag).exp()) };
        (ramp(t - reached + cycle) - ramp(t - reached)) / cycle
    };
    for ms in 0..400 {
        bench.run(MS(ms));
        let actual = bench.krc.actual(bench.now());
        let t = ms as f64 * 1e-3;
        assert!((actual.q_deg[0] - closed(t)).abs() < 1e-9, "{ms} ms: {} {}", actual.q_deg[0], closed(t));
        let numeric = (closed(t + 1e-6) - closed(t - 1e-6)) / 2e-6;
        let corner = [0.108, 0.120].iter().any(|corner: &f64| (corner - t).abs() < 1e-5);
        assert!(corner || (actual.qd_deg_s[0] - numeric).abs() < 1e-3, "{ms} ms: velocity");
        assert_eq!(actual.q_deg[1], -90.0);
    }
    // 63 % of the step is reached one time constant after the middle of the line, which is 6 ms early.
    assert!((closed(reached - 0.006 + lag) - 0.632).abs() < 0.01);
}

#[test]
fn ramp_lags_by_dead_time_plus_time_constant_in_both_generations() {
    for (generation, cycle_ms) in [(C2, 12), (C4, 4)] {
        let step = 30.0 * f64::from(cycle_ms) * 1e-3;
        let mut bench = Rig::new(wide(generation)).start(move |k| on_a1(step * (k as f64 + 1.0)));
        bench.run(MS(1200));
        let (set, actual) = (bench.krc.set_deg()[0], bench.krc.actual(bench.now()).q_deg[0]);
        // 30 deg/s times 120 ms; the transient has fallen to e^-40.
        assert!((set - actual - 3.6).abs() < 1e-9, "{generation:?}: {}", set - actual);
    }
}

#[test]
fn smoothing_delays_a_ramp_by_half_its_length_more() {
    let mut options = wide(C2);
    options.lag.smoothing_cycles = 5;
    let mut bench = Rig::new(options).start(|k| on_a1(0.36 * (k as f64 + 1.0)));
    bench.run(MS(1200));
    let lag = bench.krc.set_deg()[0] - bench.krc.actual(bench.now()).q_deg[0];
    assert!((lag - 30.0 * (0.120 + 0.5 * 4.0 * 0.012)).abs() < 1e-9, "{lag}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn times_of_looking_change_nothing(
        sets in prop::collection::vec(-30.0..30.0_f64, 1..20),
        looks in prop::collection::vec(1..40_000_u64, 1..20),
        dead_ms in 12..100_u64, lag_ms in 0..50_u64,
    ) {
        let options = LagOptions {
            dead_time: Duration::from_millis(dead_ms),
            time_constant: Duration::from_millis(lag_ms),
            smoothing_cycles: 1,
            noise_deg: 0.0,
        };
        let cycle = Duration::from_millis(12);
        let mut looked = Drives::new(options, Instant::ZERO, [0.0; 6]);
        let mut plain = looked.clone();
        let mut looks = looks.into_iter();
        for (k, set) in (1..).zip(&sets) {
            let at = Instant::ZERO + cycle * k;
            for drives in [&mut looked, &mut plain] {
                drives.set_point(at, cycle, &[*set; 6]);
            }
            // No later than the next set point.
            if let Some(us) = looks.next() {
                looked.advance(at + Duration::from_micros(us % 12_000));
            }
        }
        let end = Instant::ZERO + cycle * (sets.len() as u64 + 20);
        let (a, b) = (looked.state_at(end), plain.state_at(end));
        prop_assert!((a.q_deg[0] - b.q_deg[0]).abs() < 1e-9, "{} {}", a.q_deg[0], b.q_deg[0]);
        prop_assert!((a.qd_deg_s[0] - b.qd_deg_s[0]).abs() < 1e-6);
        // The axes never leave the hull of the set points.
        let hull = sets.iter().fold((0.0_f64, 0.0_f64), |(low, high), s| (low.min(*s), high.max(*s)));
        prop_assert!(a.q_deg[0] >= hull.0 - 1e-9 && a.q_deg[0] <= hull.1 + 1e-9);
    }
}

#[test]
fn object_limit_clamps_without_a_word() {
    let mut options = wide(C2);
    options.correction.lower[0] = -3.0;
    options.correction.upper[0] = 5.0;
    for (wanted, reached) in [(4.0, 4.0), (5.0, 5.0), (7.0, 5.0), (-3.0, -3.0), (-50.0, -3.0)] {
        let mut bench = Rig::new(options.clone()).start(move |_| on_a1(wanted));
        bench.run_cycles(100);
        let actual = bench.krc.actual(bench.now()).q_deg[0];
        assert!((actual - reached).abs() < 1e-9, "{wanted}: {actual}");
        assert!(
            running(&bench)
                && bench.events.iter().all(|e| matches!(e, KrcEvent::Started { .. } | KrcEvent::Cycle(_)))
        );
    }
}

#[test]
fn overall_limit_stops_the_robot_only_where_the_object_limit_is_wider() {
    let run = |object_deg: f64, wanted_deg: f64| {
        let mut options = wide(C4);
        options.correction.upper = [object_deg; 6];
        options.correction.overall_axis_deg = 6.0;
        let mut bench = Rig::new(options).start(move |k| on_a1(wanted_deg.min(0.05 * k as f64)));
        bench.run_cycles(200);
        fault(&bench.events).map(|(_, cause)| cause.name())
    };
    assert_eq!(run(5.0, 9.0), None, "the default object limit is inside the overall limit");
    assert_eq!(run(100.0, 6.0), None);
    assert_eq!(run(100.0, 6.001), Some("overall-limit"));
}

/// After a missing answer a value that is not held becomes zero: an absolute correction then asks for the start pose
/// in one cycle.
#[test]
fn absolute_correction_without_hold_returns_to_the_start_and_trips() {
    let run = |hold: bool, options: KrcOptions| {
        let mut rig = Rig::new(options);
        rig.config = config("UDP", Space::Axes, hold);
        // Slowly to 4 deg, then one answer is missing.
        let mut bench = rig.start(|k| Answer { silent: k == 600, ..on_a1((0.01 * k as f64).min(4.0)) });
        bench.run_cycles(602);
        // Window of telegram 600 is over, its successor is sent.
        let at_loss = bench.krc.set_deg()[0];
        bench.run_cycles(100);
        (at_loss, fault(&bench.events).map(|(at, cause)| (at, cause.name())), bench.krc.set_deg()[0])
    };
    let limits = KrcOptions::new(C2);
    let (at_loss, tripped, end) = run(false, limits.clone());
    // 4 deg in 12 ms are 333 deg/s: more than A1 can do. The refused set point is not taken.
    assert_eq!(tripped, Some((MS(12 + 601 * 12), "velocity")));
    assert!((at_loss - 4.0).abs() < 1e-9 && (end - 4.0).abs() < 1e-9, "{at_loss} {end}");
    let (at_loss, tripped, end) = run(true, limits);
    assert_eq!((at_loss, tripped, end), (4.0, None, 4.0));
    let (at_loss, tripped, end) = run(false, wide(C2));
    assert_eq!((at_loss, tripped, end), (0.0, None, 4.0), "without limits it jumps to the start and back");
}

#[test]
fn relative_correction_adds_up_and_goes_on_while_held() {
    let run = |hold: bool| {
        let mut options = wide(C2);
        options.correction.relative = true;
        let mut rig = Rig::new(options);
        rig.config = config("UDP", Space::Axes, hold);
        let mut bench =
            rig.start(|k| Answer { silent: (10..20).contains(&k), ..on_a1(if k < 20 { 0.1 } else { 0.0 }) });
        bench.run_cycles(60);
        bench.krc.set_deg()[0]
    };
    // Ten answers of 0.1 deg, then ten missing ones.
    assert!((run(true) - 2.0).abs() < 1e-9, "{}", run(true));
    assert!((run(false) - 1.0).abs() < 1e-9, "{}", run(false));
}

/// A step d from rest, then constant: velocity d/h, acceleration d/h^2, jerk 2 d/h^3 (the second cycle brakes).
#[test]
fn each_limit_of_the_drives_cuts_out_just_above_its_value() {
    let h = 0.012_f64;
    let cases =
        [("velocity", 150.0 * h), ("acceleration", 2000.0 * h * h), ("jerk", 1.5e5 * h * h * h / 2.0)];
    for (name, largest_deg) in cases {
        for (share, expected) in [(0.999, None), (1.001, Some(name))] {
            let mut options = wide(C2);
            match name {
                "velocity" => options.cut_out.velocity_deg_s = None,
                "acceleration" => options.cut_out.acceleration_deg_s2 = [2000.0; 6],
                _ => options.cut_out.jerk_deg_s3 = [1.5e5; 6],
            }
            let mut bench = Rig::new(options).start(move |_| on_a1(largest_deg * share));
            bench.run_cycles(20);
            assert_eq!(fault(&bench.events).map(|(_, cause)| cause.name()), expected, "{name} {share}");
        }
    }
    // The velocities are those of the robot file: A6 may do 615 deg/s.
    let mut options = wide(C2);
    options.cut_out.velocity_deg_s = None;
    let a6 = |k: u64| Answer { correction: [0.0, 0.0, 0.0, 0.0, 0.0, 7.37 * k as f64], ..Answer::default() };
    let mut bench = Rig::new(options).start(a6);
    bench.run_cycles(40);
    assert!(running(&bench), "{:?}", fault(&bench.events));
}

/// The limits are those of the motion, not of the cycle: a constant acceleration trips at the same value at 12 and 4 ms.
#[test]
fn acceleration_limit_is_the_same_in_both_generations() {
    for (generation, cycle_s) in [(C2, 0.012), (C4, 0.004)] {
        for (acceleration, expected) in [(495.0, None), (505.0, Some("acceleration"))] {
            let mut options = wide(generation);
            options.cut_out.acceleration_deg_s2 = [500.0; 6];
            let path = move |k: u64| on_a1(0.5 * acceleration * (k as f64 * cycle_s).powi(2));
            let mut bench = Rig::new(options).start(path);
            bench.run(MS(400));
            let got = fault(&bench.events).map(|(_, cause)| cause.name());
            assert_eq!(got, expected, "{generation:?} {acceleration} deg/s2");
        }
    }
}

#[test]
fn set_point_beyond_the_axis_range_stops_the_robot() {
    let mut bench = Rig::new(wide(C2)).start(|k| Answer {
        // A2 starts at -90 deg; its range ends at -155 and 35.
        correction: [0.0, -(k as f64), 0.0, 0.0, 0.0, 0.0],
        ..Answer::default()
    });
    bench.run_cycles(100);
    let (_, cause) = fault(&bench.events).unwrap();
    assert_eq!(cause.to_string(), "software limit switch A2: -156.000 deg");
}

#[test]
fn arm_brakes_straight_on_and_nothing_more_is_sent() {
    let mut rig = Rig::new(wide(C2));
    rig.robot_faults = vec![hil_sim::krc::RobotFault::CutOut { at: MS(606) }];
    // 60 deg/s on A1, 30 on A2.
    let mut bench = rig.start(|k| Answer {
        correction: [0.72 * k as f64, 0.36 * k as f64, 0.0, 0.0, 0.0, 0.0],
        ..Answer::default()
    });
    bench.run_cycles(300);
    // Set point of 600 ms: answer to telegram 48; then 60^2 / (2 * 600) deg.
    let set = bench.krc.set_deg();
    let (a1, a2) = (0.72 * 48.0 + 3.0, -90.0 + 0.36 * 48.0 + 1.5);
    assert!((set[0] - a1).abs() < 1e-9 && (set[1] - a2).abs() < 1e-9, "{set:?} {a1} {a2}");
    let actual = bench.krc.actual(bench.now());
    assert!((actual.q_deg[0] - a1).abs() < 1e-6 && actual.qd_deg_s[0].abs() < 1e-5, "{actual:?}");
    assert_eq!(bench.client.received.last().unwrap().0, MS(600));
    assert!(bench.events.contains(&KrcEvent::Standing { at: MS(600 + 108) }), "{}", bench.log());
    assert_eq!(bench.krc.poll_timeout(), None, "everything has settled");
}

#[test]
fn cartesian_corrections_move_the_tool_in_base_and_in_its_own_frame() {
    let arm = &*ARM;
    let start = JointVec::from([0.0, -90.0, 90.0, 0.0, 90.0, 0.0].map(f64::to_radians));
    let x_start = arm.ee_at(&start);
    let offset = [5.0, -7.0, 9.0, 3.0, -2.0, 1.0];
    let turn = Pose::from_rpy([1.0, -2.0, 3.0].map(f64::to_radians), nalgebra::Vector3::zeros()).rot;
    let shift = nalgebra::Vector3::new(0.005, -0.007, 0.009);
    for (space, rot, pos) in [
        (Space::Base, turn * x_start.rot, x_start.pos + shift),
        (Space::Tool, x_start.rot * turn, x_start.pos + x_start.rot * shift),
    ] {
        let mut options = wide(C4);
        options.correction.space = space;
        let mut bench = Rig::new(options).start(move |k| Answer {
            correction: offset.map(|value| value * (k.min(100) as f64) / 100.0),
            ..Answer::default()
        });
        bench.run_cycles(300);
        assert!(running(&bench), "{:?}", fault(&bench.events));
        let q = bench.krc.actual(bench.now()).q_deg.map(f64::to_radians);
        let tool = arm.ee_at(&JointVec::from(q));
        assert!((tool.pos - pos).amax() < 1e-6 && (tool.rot - rot).amax() < 1e-6, "{space:?}: {tool:?}");
    }
}

#[test]
fn cartesian_correction_out_of_reach_stops_the_robot() {
    let mut options = wide(C4);
    options.correction.space = Space::Base;
    options.correction.upper = [1e4; 6];
    let mut bench = Rig::new(options)
        .start(|k| Answer { correction: [4.0 * k as f64, 0.0, 0.0, 0.0, 0.0, 0.0], ..Answer::default() });
    bench.run_cycles(400);
    assert_eq!(fault(&bench.events).map(|(_, cause)| cause.name()), Some("not-reachable"));
}

/// The ball leaves the hand where the arm *is*, 120 ms behind its set points.
#[test]
fn ball_leaves_the_actual_hand_after_cycle_and_delay() {
    let mut rig = Rig::new(wide(C2));
    rig.options.hand.gripper.delay = Duration::from_micros(17_300);
    let speed = 60.0;
    let step = speed * 0.012;
    let mut bench = rig.start(move |k| Answer { outputs: i32::from(k >= 99), ..on_a1(step * k as f64) });
    bench.run_cycles(200);
    // Telegram 99 goes out at 12 + 99 * 12 ms; its answer acts one cycle later.
    let free_at = MS(12 + 100 * 12) + Duration::from_micros(17_300);
    let (at, hand) = bench.krc.released().unwrap();
    assert_eq!(at, free_at);
    // On the ramp: set point 99 at 1212 ms, minus 120 ms of lag.
    let q1 = speed * (0.99 * 1.2 + (free_at.as_secs_f64() - 1.212) - 0.120);
    let arm = &*ARM;
    let q = JointVec::from([q1, -90.0, 90.0, 0.0, 90.0, 0.0].map(f64::to_radians));
    let p = arm.ball(&arm.fk(&q)).pos;
    assert!((hand.p_m - p).amax() < 1e-9, "{} {p}", hand.p_m);
    // A1 turns about -z: v = -w z x p.
    let w = -speed.to_radians();
    let v = nalgebra::Vector3::new(-w * p.y, w * p.x, 0.0);
    assert!((hand.v_m_s - v).amax() < 1e-9, "{} {v}", hand.v_m_s);
    let landing = bench.krc.landing().unwrap();
    let t = (2.0 * p.z / 9.81).sqrt();
    assert!((landing.t_s - t).abs() < 1e-9 && (landing.p_m.x - (p.x + v.x * t)).abs() < 1e-9, "{landing:?}");
    // The ball is thrown once.
    assert_eq!(bench.events.iter().filter(|e| matches!(e, KrcEvent::Released { .. })).count(), 1);
}

#[test]
fn noise_is_on_the_readings_only_and_has_its_size() {
    let mut rig = Rig::new(wide(C2));
    rig.options.lag.noise_deg = 0.01;
    let mut bench = rig.start(|_| Answer::default());
    bench.run_cycles(4000);
    let read =
        |text: &str| crate::krc_rig::between(text, "<AIPos A1=\"", "\"").and_then(|t| t.parse::<f64>().ok());
    let noise: Vec<f64> = bench.client.received.iter().filter_map(|(_, text)| read(text)).collect();
    let deviation = (noise.iter().map(|x| x * x).sum::<f64>() / noise.len() as f64).sqrt();
    // Five standard deviations of the estimate are 5 / sqrt(2 * 4000) = 5.6 %.
    assert!((0.00944..0.01056).contains(&deviation), "{deviation}");
    assert_eq!(bench.krc.actual(bench.now()).q_deg[0], 0.0);
}
