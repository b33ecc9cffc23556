//! `cubectl identify` on the simulated cell: what the simulator was given comes back within the interval, and a
//! blocked joint or drowned data are refused.

use super::experiment::{Bounds, ExperimentError};
use super::joint::{JointError, JointExperiments, identify};
use crate::bus::args::CellArgs;
use crate::bus::{BusArgs, Session};
use hil_sim::fault::{FaultTarget, PhysicalFault, Place};
use protocol::ModuleId;
use robot_model::RobotModel;
use tuner::identify::findings::Findings;

/// Table III of the paper, joint 2.
const K_B_A_S_RAD: f64 = 2.9116;
const K_M_A_NM: f64 = 0.1419;
/// So wide that one seed in a thousand misses it by chance; the share of hits at 95 % is what the bench measures.
const LEVEL: f64 = 0.999;

fn session(seed: u64, noise_a: f64) -> Session {
    let mut cell = CellArgs { seed: Some(seed), ..CellArgs::default() }.load().unwrap();
    cell.setup.cell.drive.starts_homed = true;
    cell.setup.cell.drive.current_noise_a = noise_a;
    BusArgs::default().open_cell(&cell, None).unwrap()
}

fn run(session: &mut Session, joint: usize) -> Result<Findings, JointError> {
    let bounds = Bounds { current_share: 0.8, speed_share: 0.8, bit_rate_bit_s: 1e6 };
    let robot = RobotModel::load("powercube6").unwrap();
    identify(session, &robot, &JointExperiments { joint, bounds, level: LEVEL }, &mut |_, _| {})
}

#[test]
fn constants_of_the_simulator_come_back_within_the_interval() {
    let findings = run(&mut session(3, 0.05), 2).unwrap();
    let (k_b, k_m) = (findings.k_b.as_ref().unwrap(), findings.k_m.as_ref().unwrap().as_ref().unwrap());
    assert!(k_b.k.covers(K_B_A_S_RAD) && k_m.k.covers(K_M_A_NM), "{}", findings.text());
    // An interval that covers everything says nothing.
    assert!(
        k_b.k.half_width < 0.05 * K_B_A_S_RAD && k_m.k.half_width < 0.05 * K_M_A_NM,
        "{}",
        findings.text()
    );
    assert!(
        k_b.k.half_width > 1e-4 * K_B_A_S_RAD && k_m.k.half_width > 1e-4 * K_M_A_NM,
        "{}",
        findings.text()
    );
    // 0.2 ms +- 0.1 ms is what the simulated modules take.
    let time = findings.answer_time.unwrap();
    assert!((1.5e-4..2.5e-4).contains(&time.mean_s) && time.max_s < 4e-4, "{time:?}");
    let lag_s = findings.answer.as_ref().unwrap().total_lag_s;
    assert!((4e-3..8e-3).contains(&lag_s.value), "{lag_s:?}");
    let patch = findings.patch();
    assert!(patch.contains("name = \"joint2\"") && toml::from_str::<toml::Table>(&patch).is_ok(), "{patch}");
}

#[test]
fn joint_without_load_keeps_its_torque_constant() {
    let findings = run(&mut session(1, 0.05), 6).unwrap();
    assert!(findings.k_b.as_ref().unwrap().k.covers(0.1572), "{}", findings.text());
    assert!(findings.k_m.is_none() && findings.no_load().is_some() && findings.refusals().is_empty());
}

#[test]
fn drowned_currents_are_refused_with_the_reason() {
    let findings = run(&mut session(1, 40.0), 6);
    // Readings beyond the bound end the experiment first, or the regression refuses: nothing is concluded either way.
    match findings {
        Ok(findings) => {
            assert!(findings.k_b.is_err() && !findings.refusals().is_empty(), "{}", findings.text());
        }
        Err(JointError::Experiment(ExperimentError::OverCurrent { joint: 6, .. })) => {}
        Err(other) => panic!("{other}"),
    }
}

#[test]
fn blocked_joint_is_refused_and_halted() {
    let mut session = session(1, 0.05);
    let module = ModuleId::new(2).unwrap();
    let block = session.sim().unwrap().world().with_participants(|participants, now| {
        participants.0.0.0.begin_fault(now, Place::Module(module), &PhysicalFault::Blocked)
    });
    block.unwrap().unwrap();
    let error = run(&mut session, 2).unwrap_err();
    assert!(
        matches!(
            error,
            JointError::Experiment(
                ExperimentError::Blocked { joint: 2, .. }
                    | ExperimentError::Drive { joint: 2, .. }
                    | ExperimentError::OverCurrent { joint: 2, .. }
            )
        ),
        "{error}"
    );
    assert!(error.to_string().contains("next:"), "{error}");
}
