//! The controller against the simulated cell in virtual time: the published throw (`robot-models` 1.6) with drives that
//! have friction, gravity, lag and steps in their position, answer late, and let go of the ball.
//!
//! # What bounds the speed error
//!
//! A command holds one acceleration for a period T. Where the reference's acceleration jumps by Δ within a period (start and end
//! of a throw: 9 and 14 rad/s² at joint 6) the speed is off by up to Δ T / 4: 60 mrad/s at 17 ms, 11 mrad/s at 3 ms,
//! whatever the law. In between it is the step of the measured position, 0.35 mrad: its difference over 17 ms is 20 mrad/s,
//! and k_rate T of it, two thirds, reach the next command.

mod cycle;
mod gains_change;
mod halts;
mod lab;
mod residual;

use cell_tests::published_throw::{self, HA_S, HB_S, reference};
use firmware::settings::Settings;
use firmware::state::StateKind;
use lab::{Lab, Situation};
use protocol::JointIndex;

#[derive(Debug, Default)]
struct Outcome {
    /// Largest position error per joint, rad; from 0.35 s on if the start is beside the path.
    position: [f64; 6],
    /// Largest speed error per joint from 0.35 s on, rad/s.
    speed: [f64; 6],
    below_50_mrad_s: f64,
    release_position: f64,
    release_speed: f64,
    landing_mm: f64,
    cycles_late: u16,
    utilisation: f64,
}

fn throw(mut settings: Settings, offset_rad: f64, seed: u64) -> Outcome {
    for joint in JointIndex::first(6) {
        settings.joint.at_mut(joint).start_tolerance_rad = 0.15;
    }
    let mut lab = Lab::new(&settings, &Situation { offset_rad, ..Situation::nominal(seed) });
    let t0 = lab.start();
    let mut outcome = Outcome::default();
    loop {
        lab.run(1_000);
        let t = lab.world.participants().0.grid().as_secs_f64() - t0.as_secs_f64();
        if t > HA_S + HB_S || lab.kind() != StateKind::Running {
            break;
        }
        let cell = &lab.world.participants().0;
        let (mut e_worst, mut de_worst) = (0.0f64, 0.0f64);
        for i in 0..6 {
            let (q, qd) = reference(i, t);
            let (e, de) = ((cell.plant().link_q_rad(i) - q).abs(), (cell.plant().axis(i).v_rad_s - qd).abs());
            (e_worst, de_worst) = (e_worst.max(e), de_worst.max(de));
            if t > 0.35 || offset_rad == 0.0 {
                outcome.position[i] = outcome.position[i].max(e);
            }
            if t > 0.35 {
                outcome.speed[i] = outcome.speed[i].max(de);
            }
        }
        if e_worst > 0.05 {
            outcome.below_50_mrad_s = t;
        }
        // The first look at or after the release.
        if t >= HA_S && outcome.release_speed == 0.0 {
            (outcome.release_position, outcome.release_speed) = (e_worst, de_worst);
        }
    }
    assert!(
        matches!(lab.kind(), StateKind::Running),
        "{:?} {:?}",
        lab.controller().state(),
        lab.controller().freeze_frame()
    );
    outcome.utilisation = lab.world.bus_report().utilisation;
    lab.run(600_000);
    assert_eq!(lab.kind(), StateKind::Ready, "{:?}", lab.controller().state());
    outcome.cycles_late = lab.controller().counters().cycles_late;
    let landing = lab.world.participants().0.throw().landing.expect("the ball was released");
    assert_eq!(lab.findings(), Vec::<String>::new());
    outcome.landing_mm = 1e3 * published_throw::miss_m([landing.p_m.x, landing.p_m.y]);
    outcome
}

fn worst(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

#[test]
fn published_throw_from_rest_on_the_path_stays_within_bounds_and_lands() {
    for (name, settings, position, landing) in
        [("17 ms", Settings::powercube6_paper(), 4e-3, 12.0), ("3 ms", Settings::powercube6(), 3e-3, 8.0)]
    {
        let outcome = throw(settings, 0.0, 1);
        println!("{name}, from zero: {outcome:?}");
        assert!((1e-5..position).contains(&worst(&outcome.position)), "{name}");
        assert!((1e-3..landing).contains(&outcome.landing_mm), "{name}");
    }
}

#[test]
fn published_throw_from_a_tenth_of_a_radian_beside_comes_back_to_the_path_and_lands() {
    for (name, settings) in [("17 ms", Settings::powercube6_paper()), ("3 ms", Settings::powercube6())] {
        let outcome = throw(settings, 0.1, 1);
        println!("{name}, from 0.1 rad: {outcome:?}");
        assert!((0.02..0.25).contains(&outcome.below_50_mrad_s), "{name}");
        // The paper: below 0.05 rad and 0.1 rad/s after its transient.
        assert!(worst(&outcome.position) < 0.05 && worst(&outcome.speed) < 0.1, "{name}");
        assert!((1e-3..15.0).contains(&outcome.landing_mm), "{name}");
    }
}

/// The plant is never the nominal one twice: chances of answer times and noise by seed. Printed, with a bound that a
/// broken loop would miss.
#[test]
fn throws_of_many_seeds_land_near_each_other() {
    for (name, settings) in [("17 ms", Settings::powercube6_paper()), ("3 ms", Settings::powercube6())] {
        let mut landings: Vec<f64> = (1..=20).map(|seed| throw(settings, 0.0, seed).landing_mm).collect();
        landings.sort_by(f64::total_cmp);
        println!("{name}, 20 seeds: landing median {:.1} mm, worst {:.1} mm", landings[10], landings[19]);
        assert!((0.01..12.0).contains(&landings[19]), "{name}: {landings:?}");
    }
}
