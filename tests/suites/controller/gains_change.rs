//! Gains while the arm is armed or moves: refused, whoever writes them.

use firmware::fault::Cause;
use firmware::registers::Number;
use firmware::settings::Settings;
use firmware::state::StateKind;

use super::lab::{Lab, Situation};

/// Registers of a gain row.
const GAINS: [&str; 3] = ["joint.k_error_1_s2", "joint.k_rate_1_s", "joint.k_last"];

/// Control steps of a throw, seen from the arm: the position of every joint, once per millisecond.
fn path(write: bool) -> Vec<Vec<f64>> {
    let mut lab =
        Lab::new(&Settings::powercube6(), &Situation { offset_rad: 0.015, ..Situation::nominal(1) });
    lab.start();
    let mut path = Vec::new();
    for ms in 0..900 {
        lab.run(1_000);
        path.push((0..6).map(|i| lab.world.participants().0.plant().link_q_rad(i)).collect());
        if write && ms % 50 == 10 {
            assert_eq!(lab.kind(), StateKind::Running, "{:?}", lab.controller().state());
            for name in GAINS {
                let refused = lab.write(name, &[Number::Real32(-1.0); 6]).unwrap_err();
                assert_eq!(refused.cause, Cause::OrderNotNow, "{name}");
            }
        }
    }
    lab.run(1_500_000);
    assert_eq!(lab.kind(), StateKind::Ready, "{:?}", lab.controller().state());
    assert_eq!(lab.findings(), Vec::<String>::new());
    path
}

#[test]
fn gains_written_during_a_motion_are_refused_and_move_nothing() {
    assert_eq!(path(true), path(false));
}
