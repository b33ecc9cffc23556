//! Options of a scenario file for drives, mechanics, supplies and gripper.

use std::path::Path;

use crate::common::frame_bits;
use hil_sim::CellOptions;
use hil_sim::drive::options::{Persistence, UnknownRequest};
use hil_sim::scenario::{Action, Scenario, parse_frame};
use hil_sim::world::Observer;
use protocol::{Duration, Frame, Instant};

fn cell(body: &str) -> CellOptions {
    let text = format!("schema_version = 1\nduration_s = 1\n{body}");
    Scenario::from_toml("test.toml", &text).unwrap_or_else(|error| panic!("{body}: {error}")).cell
}

#[test]
fn every_key_changes_what_it_names_and_nothing_else() {
    let default = CellOptions::default();
    // Name, keys, and what puts the table back to its default.
    type Table = (&'static str, &'static [&'static str], fn(&mut CellOptions, &CellOptions));
    let tables: [Table; 6] = [
        (
            "cell",
            &[
                "step_s = 0.0005",
                "start_q_deg = [0, 0, 0, 0, 0, 0]",
                "start_q_rad = [0, 0, 0, 0, 0, 0]",
                "cold_start = true",
                "logic_on_motor_supply = true",
                "servos_extrapolate = true",
            ],
            |changed, default| {
                changed.step = default.step;
                changed.start_q_rad = None;
                (changed.cold_start, changed.logic_on_motor_supply) = (false, false);
                changed.servos_extrapolate = false;
            },
        ),
        (
            "drive",
            &[
                "beyond_maximum = 'refuse'",
                "beyond_soft_limit = 'clip'",
                "refusal_code = 1",
                "unknown_request = 'echo'",
                "persistence = 'at-once'",
                "internal_command = 'silence'",
                "home_when_halted = 'refuse'",
                "sign_of_life = 'any-frame'",
                "state_frames = 'on-change'",
                "state_frames = 'sync-transmit'\nstate_frames_every_s = 0.002",
                "step_path = 'cubic'",
                "watchdog_timeout_s = 0.02",
                "processing_delay_s = 0.001",
                "processing_jitter_s = 0",
                "queue_depth = 2",
                "boot_time_s = 0",
                "position_resolution_deg = 0.02",
                "current_noise_a = 0.05",
                "home_switch_noise_deg = 0.1",
                "absolute_encoder = true",
                "starts_homed = true",
                "brake = false",
                "config = 0x8000000",
                "ambient_c = 40",
            ],
            |changed, default| changed.drive = default.drive.clone(),
        ),
        (
            "mechanics",
            &[
                "rotor_share = 0.1",
                "viscous_share = 0.1",
                "coulomb_rad_s2 = 1",
                "brake_share = 1",
                "stop_margin_deg = 1",
                "stop_stiffness_nm_rad = 1e3",
                "elasticity_stiffness_nm_rad = 1e4\nelasticity_damping_nms_rad = 5",
            ],
            |changed, default| changed.mechanics = default.mechanics,
        ),
        ("supply", &["resistance_ohm = 1", "trip_charge_as = 1", "restore_s = 9"], |changed, default| {
            changed.supply = default.supply;
        }),
        (
            "gripper",
            &[
                "output_axis = 1",
                "output_line = 3",
                "delay_s = 0.001",
                "jitter_s = 0.002",
                "drag_1_m = 0.1",
                "landing_z_m = 0.5",
            ],
            |changed, default| changed.gripper = default.gripper,
        ),
        (
            "scatter",
            &[
                "mass_share = 0.1",
                "com_m = 0.01",
                "friction_share = 0.5",
                "rotor_share = 0.1",
                "current_share = 0.1",
                "delay_share = 0.7",
                "home_deg = 0.1",
                "gripper_delay_s = 0.002",
            ],
            |changed, default| changed.scatter = default.scatter,
        ),
    ];
    for (table, keys, undo) in tables {
        for key in keys {
            let mut changed = cell(&format!("[{table}]\n{key}"));
            assert_ne!(changed, default, "[{table}] {key}");
            undo(&mut changed, &default);
            assert_eq!(changed, default, "[{table}] {key}");
        }
    }
}

#[test]
fn open_questions_about_the_module_are_answered_as_the_words_say() {
    let drive =
        cell("[drive]\nunknown_request = 'echo'\npersistence = 'at-once'\nposition_resolution_deg = 0.02")
            .drive;
    assert_eq!((drive.unknown, drive.persistence), (UnknownRequest::Echo, Persistence::AtOnce));
    assert_eq!(drive.position_resolution_rad, Some(0.02_f64.to_radians()));
    let drive = cell("[drive]\nunknown_request = 'silence'\npersistence = 'on-save'").drive;
    assert_eq!(drive, CellOptions::default().drive);
}

fn perturbed() -> Scenario {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/perturbed_plant.toml");
    Scenario::load(&path).unwrap()
}

/// Smallest and largest of what 300 seeds draw for all joints.
fn spread(of: impl Fn(u64, usize) -> f64) -> (f64, f64) {
    let draws = (0..300).flat_map(|seed| (0..6).map(move |joint| (seed, joint)));
    draws.fold((f64::MAX, f64::MIN), |(low, high), (seed, joint)| {
        let value = of(seed, joint);
        (low.min(value), high.max(value))
    })
}

#[test]
fn perturbed_plant_draws_masses_within_a_tenth_and_friction_within_a_half() {
    let scatter = perturbed().cell.scatter;
    let (low, high) = spread(|seed, joint| scatter.draw(seed, joint).mass);
    assert!((0.9..0.901).contains(&low) && (1.099..=1.1).contains(&high), "{low} to {high}");
    let (low, high) = spread(|seed, joint| scatter.draw(seed, joint).friction);
    assert!((0.5..0.505).contains(&low) && (1.495..=1.5).contains(&high), "{low} to {high}");
    // Nothing else changes: studies vary one thing at a time.
    let d = scatter.draw(3, 2);
    assert_eq!((d.com_m, d.rotor, d.current, d.delay, d.home_rad), ([0.0; 3], 1.0, 1.0, 1.0, 0.0));
    assert_eq!(perturbed().cell.gripper.jitter, Duration::from_millis(2));
}

/// Time from the end of a request to the start of its answer, µs.
#[derive(Default)]
struct Delays {
    asked: Option<Instant>,
    us: Vec<u64>,
}

impl Observer for Delays {
    fn on_frame(&mut self, at: Instant, _: Option<usize>, frame: &Frame) {
        match frame.id().raw() {
            0x0C2 => self.asked = Some(at),
            0x0A2 => {
                let asked = self.asked.take().expect("asked first");
                // A frame is valid in its last but one bit.
                self.us.push(at.saturating_since(asked).as_micros() - u64::from(frame_bits(frame) - 1));
            }
            _ => {}
        }
    }
}

#[test]
fn perturbed_plant_answers_after_50_to_400_us_and_reaches_both_ends() {
    let mut scenario = perturbed();
    scenario.actions = vec![Action {
        at: Instant::from_micros(1_000),
        frames: vec![parse_frame("0C2#0A62").unwrap()],
        every: Some(Duration::from_millis(1)),
        count: None,
    }];
    let mut delays = Delays::default();
    let mut world = scenario.world().unwrap();
    world.run_until(Instant::ZERO + scenario.duration, &mut delays).unwrap();
    assert!(delays.us.len() > 990);
    let (low, high) = (delays.us.iter().min().unwrap(), delays.us.iter().max().unwrap());
    assert!((50..60).contains(low) && (391..=400).contains(high), "{low} to {high} us");
}
