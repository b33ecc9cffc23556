//! A halt broadcast of another node. The protocol has one id for all broadcasts, so a halt and the sign of life of the
//! controller to the drives' watchdogs can begin at the same moment: the same id, other data. The bus knows that as a bit error of
//! the node with the recessive bit (CAN 2.0 A, section 7), both frames are destroyed, and both nodes begin again together, until the
//! controller is error-passive: then its error flag is recessive, the halt, whose bits are dominant where they differ, goes
//! through, and the controller is the one node that has not heard it. It sees it in the answers of the halted drives.
//!
//! The ids leave no way around: broadcasts have 0x100 only, and a sign of life sent to each drive would cost six frames. What
//! `cubectl` sends is not concerned: a stop message of its own id and the highest priority goes before its halt.

use firmware::fault::Cause;
use firmware::settings::Settings;
use firmware::state::StateKind;
use hil_sim::participants::Participants;
use protocol::powercube::Broadcast;
use protocol::{Duration, Instant};

use super::lab::{Lab, Situation};

/// 0.4 s into the throw.
fn running(settings: &Settings) -> Lab {
    let mut lab = Lab::new(settings, &Situation::nominal(1));
    let start = lab.start();
    let left = start.saturating_since(lab.world.now()).as_micros() + 400_000;
    lab.run(left);
    assert_eq!(lab.kind(), StateKind::Running);
    lab.watch.halt_at = None;
    lab
}

#[derive(Debug)]
struct Halted {
    /// From the wish to send the halt to its end on the bus, µs.
    sent_us: u64,
    /// To the controller's stop, µs.
    known_us: u64,
    /// To the rest of the last joint, µs.
    rest_us: u64,
    /// Attempts of the controller's node that failed.
    failed: u64,
    cause: Option<Cause>,
}

fn halted_at(settings: &Settings, at: Instant) -> Halted {
    let mut lab = running(settings);
    lab.run(at.saturating_since(lab.world.now()).as_micros());
    let port = lab.world.participants().0.len();
    let failed = |lab: &Lab| lab.world.bus().port_stats(port).failed_attempts;
    let before = failed(&lab);
    lab.foreign(Broadcast::Halt.encode());
    let mut halted = Halted { sent_us: 0, known_us: 0, rest_us: 0, failed: 0, cause: None };
    let mut moving_at = at;
    for _ in 0..6_000 {
        lab.run(50);
        let now = lab.world.now();
        if halted.known_us == 0 && lab.kind() != StateKind::Running {
            halted.known_us = now.saturating_since(at).as_micros();
            halted.cause = lab.controller().state().fault().map(|fault| fault.cause);
        }
        let plant = lab.world.participants().0.plant();
        if (0..6).any(|i| plant.axis(i).v_rad_s.abs() > 0.02) {
            moving_at = now;
        }
    }
    halted.sent_us = lab.watch.halt_at.map_or(u64::MAX, |end| end.saturating_since(at).as_micros());
    halted.rest_us = moving_at.saturating_since(at).as_micros();
    halted.failed = failed(&lab) - before;
    assert!(matches!(lab.kind(), StateKind::Fault | StateKind::Stopped), "{:?}", lab.controller().state());
    halted
}

#[test]
fn a_halt_of_another_node_beside_a_sign_of_life_stops_the_arm_and_is_found_in_the_answers() {
    for settings in [Settings::powercube6(), Settings::powercube6_paper()] {
        let mut lab = running(&settings);
        lab.watch.life_at = None;
        while lab.watch.life_at.is_none() {
            lab.run(50);
        }
        let life = lab.watch.life_at.unwrap();
        let wishes = (0..=480u64).step_by(40).map(|us| life.saturating_sub(Duration::from_micros(us)));
        let all: Vec<Halted> = wishes.map(|at| halted_at(&settings, at)).collect();
        let largest = |of: fn(&Halted) -> u64| all.iter().map(of).max().unwrap();
        let collided = all.iter().filter(|halted| halted.failed > 0).count();
        println!(
            "period {} us: {collided} of {} halts met a sign of life; on the bus after {} us, known after {} us, all at rest \
             after {} us at most",
            settings.cycle_period_us,
            all.len(),
            largest(|halted| halted.sent_us),
            largest(|halted| halted.known_us),
            largest(|halted| halted.rest_us)
        );
        assert!((1..all.len()).contains(&collided), "{all:#?}");
        for halted in &all {
            // Seventeen attempts of at most 80 bits, or the writes of a cycle, which go first.
            assert!((50..=1_500).contains(&halted.sent_us), "{halted:?}");
            // Then each drive reports it with its next answer.
            let period_us = u64::from(settings.cycle_period_us);
            assert!((50..=halted.sent_us + period_us + 500).contains(&halted.known_us), "{halted:?}");
            assert!((10_000..=300_000).contains(&halted.rest_us), "{halted:?}");
            let heard = if halted.failed == 0 { Cause::HaltedByOther } else { Cause::DriveError };
            assert_eq!(halted.cause, Some(heard), "{halted:?}");
        }
    }
}
