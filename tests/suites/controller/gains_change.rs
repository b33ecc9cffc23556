//! New gains in the middle of a motion: `cubectl tune --apply` on a moving arm.

use firmware::feedback::Gains;
use firmware::registers::Number;
use firmware::settings::Settings;
use firmware::state::StateKind;
use protocol::JointIndex;

use super::lab::{Lab, Situation};

/// Beside the path, so that the feedback has something to do when the gains change.
const OFFSET_RAD: f64 = 0.015;
/// Cycles of the plan before the change: the inputs are no longer clipped, the errors not yet gone.
const BEFORE: usize = 12;
/// Cycles looked at after it.
const AFTER: usize = 100;

/// One of the gains of a row.
type Pick = fn(Gains) -> f32;

/// Registers, the gain that each holds, and what the new one is of the old one.
const SOFTER: [(&str, Pick, f32); 3] = [
    ("joint.k_error_1_s2", |gains| gains.k_error_1_s2, 0.5),
    ("joint.k_rate_1_s", |gains| gains.k_rate_1_s, 0.7),
    ("joint.k_last", |gains| gains.k_last, 1.0),
];

/// Commanded accelerations per cycle and joint, rad/s²; the gains change after [`BEFORE`] cycles if asked for.
fn commands(blend_us: u32, change: bool) -> Vec<[f32; 6]> {
    let mut settings = Settings::powercube6();
    settings.gains_blend_us = blend_us;
    let mut lab = Lab::new(&settings, &Situation { offset_rad: OFFSET_RAD, ..Situation::nominal(1) });
    lab.start();
    let mut commands = Vec::new();
    let mut cycles = lab.controller().counters().cycles;
    while commands.len() < BEFORE + AFTER {
        lab.run(250);
        let now = lab.controller().counters().cycles;
        if now == cycles {
            continue;
        }
        assert_eq!(now, cycles + 1, "a cycle was not seen");
        cycles = now;
        assert_eq!(lab.kind(), StateKind::Running, "{:?}", lab.controller().state());
        let mut row = [0.0; 6];
        for (place, joint) in row.iter_mut().zip(JointIndex::first(6)) {
            *place = lab.controller().joint_sample(joint).qdd_command_rad_s2;
        }
        commands.push(row);
        if change && commands.len() == BEFORE {
            for (name, gain, share) in SOFTER {
                let gains: Vec<Number> = JointIndex::first(6)
                    .map(|joint| Number::Real32(share * gain(settings.joint.at(joint).gains())))
                    .collect();
                lab.write(name, &gains).unwrap();
            }
        }
    }
    lab.run(1_500_000);
    assert_eq!(lab.kind(), StateKind::Ready, "{:?}", lab.controller().state());
    assert_eq!(lab.findings(), Vec::<String>::new());
    commands
}

/// Largest change from one cycle to the next that a run has more than the one without new gains, rad/s² per joint.
fn bump(with: &[[f32; 6]], without: &[[f32; 6]]) -> [f32; 6] {
    let off: Vec<[f32; 6]> =
        with.iter().zip(without).map(|(a, b)| std::array::from_fn(|i| a[i] - b[i])).collect();
    std::array::from_fn(|i| off.windows(2).map(|pair| (pair[1][i] - pair[0][i]).abs()).fold(0.0, f32::max))
}

/// Both runs are the same up to the change, chances of the cell included, so their difference is the change's alone.
#[test]
fn gains_applied_in_the_middle_of_a_motion_take_over_without_a_bump() {
    let blend_us = Settings::powercube6().gains_blend_us;
    let without = commands(blend_us, false);
    let blended = commands(blend_us, true);
    let at_once = commands(0, true);
    assert_eq!(without[..BEFORE], blended[..BEFORE]);
    assert_eq!(without[..BEFORE], at_once[..BEFORE]);
    assert_ne!(without, blended, "the new gains did nothing");
    // The first cycles after the change: later the two runs have errors of their own.
    let window = BEFORE - 1..BEFORE + 8;
    let soft = bump(&blended[window.clone()], &without[window.clone()]);
    let hard = bump(&at_once[window.clone()], &without[window]);
    println!("largest change per cycle, rad/s²: blended {soft:.3?}, at once {hard:.3?}");
    for (joint, (soft, hard)) in soft.into_iter().zip(hard).enumerate() {
        assert!(hard > 0.5, "joint {}: {hard}: too small to show anything", joint + 1);
        assert!(soft < 0.2 * hard, "joint {}: {soft} of {hard}", joint + 1);
    }
}
