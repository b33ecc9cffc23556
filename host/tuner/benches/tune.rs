//! Gain design measured: time of one design per joint, and the designs compared on the reference throw.
//!
//! `cargo bench -p tuner --bench tune`. Prints tables; nothing is asserted. The throw is the published
//! one re-optimised (tests/oracle/throw_j31699.py prints its numbers).

use nix::time::{ClockId, clock_gettime};
use robot_model::RobotModel;
use tuner::gains::compare::{Tracking, tracking};
use tuner::gains::design::{Design, Tuned, tune};
use tuner::gains::machine::{Demand, Machine, ReferenceProfile, inputs};
use tuner::gains::plant::{FeedForwardLaw, Plant, Setup, Throw, track};
use tuner::gains::problem::PhaseInput;
use tuner::gains::{lqr, saturated::Gains};
use tuner::model::Estimator;

/// Position feedback that is always at the bound of the command.
const FULL: Gains = [-1e5, 0.0, 0.0];
/// Release velocities of the joints, rad/s.
const RELEASE_RAD_S: [f64; 6] = [1.701605, -1.384494, 0.476686, -0.159952, -0.78971, 2.545101];
/// Run-up and braking, s.
const HA_HB_S: (f64, f64) = (0.6 * 1.1849, 0.4 * 1.1849);
/// Landing point (x, y) over joint angle and joint velocity at the release, m/rad and m s/rad.
const LANDING_Q: [[f64; 6]; 2] = [
    [-1.0, 0.3063, -0.140576, -0.345178, -0.344152, 0.0],
    [1.0, -0.673307, 0.55434, 0.26082, -0.270597, 0.0],
];
const LANDING_QD: [[f64; 6]; 2] = [
    [-0.140505, -0.238096, 0.199918, 0.025969, -0.153307, 0.0],
    [0.445519, -0.146295, 0.09578, 0.140265, 0.012475, 0.0],
];

/// Bound of the landing error if every joint's release error points the worst way, m.
fn landing_bound_m(joints: &[Tracking]) -> f64 {
    let axis = |a: usize| -> f64 {
        let of = |(j, t): (usize, &Tracking)| {
            LANDING_Q[a][j].abs() * t.event_position_rad + LANDING_QD[a][j].abs() * t.event_velocity_rad_s
        };
        joints.iter().enumerate().map(of).sum()
    };
    axis(0).hypot(axis(1))
}

fn row(name: &str, period_s: f64, joints: &[Tracking]) {
    let worst = |f: fn(&Tracking) -> f64| joints.iter().map(f).fold(0.0, f64::max);
    println!(
        "| {name} | {:.1} | {:.3} / {:.3} | {:.1} | {:.2} | {:.2}, {:.1} | {:.1} |",
        period_s * 1e3,
        joints[1].halved_after_s,
        worst(|t| t.halved_after_s),
        1e3 * worst(|t| t.late_max_rad),
        1e3 * worst(|t| t.late_max_from_rest_rad),
        1e3 * worst(|t| t.event_position_rad),
        1e3 * worst(|t| t.event_velocity_rad_s),
        1e3 * landing_bound_m(joints)
    );
}

/// Time until half of `error_rad` is first passed if the command is at its bound from the first sample on, for the
/// worse sign: with delay, lag and the acceleration that the reference leaves, no law can be faster, s.
fn bound_s(plant: &Plant, throw: &Throw, period_s: f64, error_rad: f64) -> f64 {
    let one_way = |start_error_rad: f64| {
        let estimator = Estimator::usual(period_s);
        let setup =
            Setup { period_s, delay_s: period_s, law: FeedForwardLaw::Aligned, estimator, start_error_rad };
        let run = track(plant, throw, FULL, &setup);
        let passed = run.position_rad.iter().position(|e| e.abs() < 0.5 * error_rad);
        passed.map_or(f64::INFINITY, |i| run.t_s[i])
    };
    one_way(error_rad).max(one_way(-error_rad))
}

/// Time that this thread has had of a processor, s: other programs on the machine do not count.
fn cpu_s() -> f64 {
    clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID)
        .map_or(f64::NAN, |t| t.tv_sec() as f64 + 1e-9 * t.tv_nsec() as f64)
}

fn main() {
    let machine = match RobotModel::load("powercube6").map(|r| Machine::from_robot(&r)) {
        Ok(Ok(machine)) => machine,
        other => panic!("built-in robot: {other:?}"),
    };
    let throws = RELEASE_RAD_S.map(|release_rad_s| Throw { release_rad_s, ha_s: HA_HB_S.0, hb_s: HA_HB_S.1 });
    let phases = throws.map(|t| {
        let (before, after) = t.acceleration_max_rad_s2();
        vec![
            PhaseInput { duration_s: Some(t.ha_s), reference_max_rad_s2: before },
            PhaseInput { duration_s: None, reference_max_rad_s2: after },
        ]
    });
    let motion = ReferenceProfile { robot: machine.robot.clone(), phases: phases.to_vec() };
    let follow = |gains: &[Gains], period_s: f64| -> Vec<Tracking> {
        (0..6)
            .map(|j| {
                tracking(&machine.joints[j], &throws[j], gains[j], (period_s, period_s), 0.1, throws[j].ha_s)
            })
            .collect()
    };
    let mut times = Vec::new();
    println!("Worst of six joints, start +-0.1 rad, throw of cost 31.699; certificate checked for A and B");
    println!(
        "| design | period ms | < 0.05 rad after s (joint 2 / worst) | max after 0.35 s mrad | same from rest mrad | release mrad, mrad/s | landing bound mm |"
    );
    println!("|---|---|---|---|---|---|---|");
    for period_s in [0.017, 0.003, 0.002] {
        // The paper's errors (section VI-B).
        let demand =
            Demand { error_position_rad: 0.1, error_velocity_rad_s: 0.1, ..Demand::with_period(period_s) };
        let Ok(data) = inputs(&machine, &motion, &demand) else { continue };
        for (name, design) in [("A paper", Design::Paper), ("B saturated", Design::Saturated)] {
            let start = cpu_s();
            let tuned: Result<Vec<Tuned>, _> = data.iter().map(|i| tune(i, design)).collect();
            times.push((name, period_s, (cpu_s() - start) / 6.0));
            match tuned {
                Ok(tuned) => {
                    let gains: Vec<Gains> = tuned.iter().map(|t| t.gains).collect();
                    row(name, period_s, &follow(&gains, period_s));
                    println!("  gains {gains:.3?}");
                }
                Err(e) => println!("| {name} | {:.1} | {e} |", period_s * 1e3),
            }
        }
        let bounds: Vec<f64> =
            (0..6).map(|j| bound_s(&machine.joints[j], &throws[j], period_s, 0.1)).collect();
        let worst = bounds.iter().copied().fold(0.0, f64::max);
        println!(
            "| full command from the first sample, cannot stop | {:.1} | {:.3} / {worst:.3} | | | | |",
            period_s * 1e3,
            bounds[1]
        );
        let reference = if period_s > 0.01 { [-417.0, -38.8, -0.6] } else { [-947.0, -54.7, -0.11] };
        row("LQR + clip, published row, no certificate", period_s, &follow(&[reference; 6], period_s));
        if let Some(own) = lqr::gains(period_s, period_s, 20.0, 600.0) {
            row("LQR + clip, own Riccati, no certificate", period_s, &follow(&[own; 6], period_s));
            println!("  gains {own:.3?}");
        }
    }
    println!("\nTime of one design, ms of a processor per joint (check and evidence included; aim 50):");
    for (name, period_s, seconds) in times {
        println!("  {name:<12} {:>5.1} ms period  {:>7.1}", period_s * 1e3, seconds * 1e3);
    }
}
