//! The published throw (`robot-models` 1.6) in the closed form of the paper, and as a controller takes it.

use firmware::events::PlanEvents;
use firmware::joints::PerJoint;
use firmware::spline::Knot;
use firmware::trajectory_format::{self, FILE_LEN_MAX, Header};
use protocol::JointIndex;

/// Joint positions at release, rad.
pub const Q_RELEASE_RAD: [f64; 6] = [0.199_999, 0.125_428, -1.856_562, 1.004_064, 1.387_908, 1.654_417];
/// Joint velocities at release, rad/s.
pub const QD_RELEASE_RAD_S: [f64; 6] = [1.358_402, -1.675_786, 0.482_325, -0.010_697, -0.986_023, 2.548_397];
/// Time before the release, s.
pub const HA_S: f64 = 0.920 * (1.0 - 0.391);
/// Time after the release, s.
pub const HB_S: f64 = 0.920 * 0.391;
/// Target of the ball, world frame, m.
pub const TARGET_M: [f64; 3] = [1.0, 1.0, -1.0];

/// Position (rad) and velocity (rad/s) of joint `i`, 0..6, `t_s` after the start; it stands before and after.
pub fn reference(i: usize, t_s: f64) -> (f64, f64) {
    let (s, qd) = (t_s.clamp(0.0, HA_S + HB_S) - HA_S, QD_RELEASE_RAD_S[i]);
    let h = if s < 0.0 { HA_S } else { HB_S };
    (Q_RELEASE_RAD[i] + qd * (s - s * s * s / (3.0 * h * h)), qd * (1.0 - s * s / (h * h)))
}

/// Joint positions at the start, rad.
pub fn start_rad() -> [f64; 6] {
    core::array::from_fn(|i| reference(i, 0.0).0)
}

/// The throw as a trajectory file for a control period, for any robot.
pub fn file(period_us: u32) -> Vec<u8> {
    file_for(period_us, 0)
}

/// As [`file()`], for the robot whose file has this CRC-32.
pub fn file_for(period_us: u32, robot_crc32: u32) -> Vec<u8> {
    encode(period_us, robot_crc32, 1.0, true)
}

/// The way of the throw in `slower` times its time, the ball in the hand.
pub fn slow_file(period_us: u32, slower: f64) -> Vec<u8> {
    encode(period_us, 0, slower, false)
}

fn encode(period_us: u32, robot_crc32: u32, slower: f64, release: bool) -> Vec<u8> {
    let us = |t_s: f64| (t_s * slower * 1e6).round() as u32;
    let knot = |t_s: f64| {
        let mut state = PerJoint::default();
        for joint in JointIndex::first(6) {
            let (q, qd) = reference(joint.get(), t_s);
            state.set(joint, (q as f32, (qd / slower) as f32));
        }
        Knot { t_us: us(t_s), state }
    };
    let knots = [knot(0.0), knot(HA_S), knot(HA_S + HB_S)];
    let events = PlanEvents::release(release.then(|| us(HA_S)));
    let header = Header { joints: 6, period_us, events, robot_crc32, ..Header::default() };
    let mut out = vec![0; FILE_LEN_MAX];
    let len = trajectory_format::encode(&header, &knots, &mut out).unwrap_or(0);
    out.truncate(len);
    out
}

/// Distance of a landing from the target on the floor, m.
pub fn miss_m(landing_m: [f64; 2]) -> f64 {
    (landing_m[0] - TARGET_M[0]).hypot(landing_m[1] - TARGET_M[1])
}
