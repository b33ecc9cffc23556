//! Motions for trials, and the table that compares gains on the simulated cell.

use std::fmt::Write as _;

use firmware::settings::Settings;
use robot_model::RobotModel;

use super::apply::InForce;
use operator::bus::settings::crc32_of;
use planner::plan::file::PlanFile;
use tuner::gains::gains_file::{GainsFile, JointGains};
use tuner::gains::lqr;
use tuner::gains::machine::ReferenceProfile;
use tuner::gains::problem::PhaseInput;
use tuner::gains::saturated::Gains;
use tuner::gains::trial::{JOINTS, Trial, TrialMotion, run, settings};

/// Error at the start of a trial, rad: the paper's.
const OFFSET_RAD: f64 = 0.1;
/// Seed of the simulated cell.
const SEED: u64 = 1;
/// Run-up and braking of the motion without a plan, s.
const HA_HB_S: (f64, f64) = (0.7, 0.5);
/// Weights of the plain LQR: rad/s and rad/s2 that cost as much as a radian.
const LQR_WEIGHTS: (f64, f64) = (20.0, 600.0);

/// Largest accelerations of a plan before and after its release.
pub(super) fn demands(plan: &PlanFile) -> ReferenceProfile {
    let motion: planner::motion::Motion = plan.motion.to_motion();
    // The acceleration of a cubic is largest at an end.
    let largest = |j: usize, early: bool| {
        let side =
            motion.accelerations().filter(|((t_s, _), _)| (*t_s < plan.release_time_s - 1e-9) == early);
        side.map(|((_, from), (_, to))| from[j].abs().max(to[j].abs())).fold(0.0, f64::max)
    };
    let phases = (0..plan.motion.joints.len()).map(|j| {
        vec![
            PhaseInput { duration_s: Some(plan.release_time_s), reference_max_rad_s2: largest(j, true) },
            PhaseInput { duration_s: None, reference_max_rad_s2: largest(j, false) },
        ]
    });
    ReferenceProfile { robot: plan.robot.name.clone(), phases: phases.collect() }
}

/// The throw of a plan.
pub(super) fn of_plan(plan: &PlanFile) -> TrialMotion {
    let motion: planner::motion::Motion = plan.motion.to_motion();
    let at = |numbers: &[f64], j: usize| numbers.get(j).copied().unwrap_or(0.0);
    let knots = motion
        .knots
        .iter()
        .map(|knot| (knot.t_s, std::array::from_fn(|j| (at(&knot.q_rad, j), at(&knot.qd_rad_s, j)))));
    TrialMotion {
        knots: knots.collect(),
        release_s: Some(plan.release_time_s),
        target_m: Some(plan.target.position_m),
    }
}

/// Without a plan: every joint swings through the middle of its range and uses `share` of its acceleration.
pub(super) fn of_share(robot: &RobotModel, share: f64) -> TrialMotion {
    let (ha, hb) = HA_HB_S;
    let mut through = [(0.0, 0.0); JOINTS];
    for (state, joint) in through.iter_mut().zip(robot.joints()) {
        let limits = &joint.limits;
        let v = (0.5 * share * limits.a_control_max_rad_s2 * hb).min(0.9 * limits.v_max_rad_s);
        *state = (0.5 * (limits.q_min_rad + limits.q_max_rad), v);
    }
    let rest = |way: f64| through.map(|(q, v)| (q + 2.0 / 3.0 * v * way, 0.0));
    let knots = vec![(0.0, rest(-ha)), (ha, through), (ha + hb, rest(hb))];
    TrialMotion { knots, release_s: None, target_m: None }
}

/// Gains of the firmware's built-in settings.
pub(super) fn built_in() -> InForce {
    InForce::of(&Settings::powercube6())
}

fn rows(gains: &InForce) -> Option<[Gains; JOINTS]> {
    let row = |i: usize| Some([*gains.k_pos_1_s2.get(i)?, *gains.k_vel_1_s.get(i)?, *gains.k_last.get(i)?]);
    let rows: Vec<Gains> = (0..JOINTS).filter_map(row).collect();
    rows.try_into().ok()
}

/// What the design is compared with, for gains of all joints: Theorem 1 of the paper for the same data, and plain LQR,
/// which the drives clip.
fn yardsticks(after: &InForce, file: &GainsFile) -> Vec<(&'static str, InForce)> {
    let with = |rows: Vec<Gains>| {
        let column = |which: usize| rows.iter().map(|row| row[which]).collect();
        let (k_pos_1_s2, k_vel_1_s, k_last) = (column(0), column(1), column(2));
        let whole = rows.len() == JOINTS;
        whole.then(|| InForce { certificate_crc32: 0, k_pos_1_s2, k_vel_1_s, k_last, ..after.clone() })
    };
    let theorem_1 = |joint: &JointGains| joint.theorem_1(file.period_s, file.estimator);
    let paper = with(file.joint.iter().filter_map(theorem_1).collect());
    let (velocity_per_rad, input_per_rad) = LQR_WEIGHTS;
    let row = lqr::gains(file.period_s, file.period_s, velocity_per_rad, input_per_rad);
    let lqr = row.and_then(|row| with(vec![row; JOINTS]));
    [("Theorem 1", paper), ("LQR, no certificate", lqr)]
        .into_iter()
        .filter_map(|(name, gains)| Some((name, gains?)))
        .collect()
}

/// Both sets of gains and the yardsticks on the simulated cell: beside the path and on it.
///
/// # Errors
/// In words, why there is nothing to compare.
pub(super) fn compare(
    robot: &RobotModel,
    before: &InForce,
    file: &GainsFile,
    motion: &TrialMotion,
) -> Result<String, String> {
    if robot.n() != JOINTS {
        return Err("the firmware's built-in settings are for an arm of six joints".to_owned());
    }
    let after = before.with(file, crc32_of(robot)).map_err(|e| e.to_string())?;
    let mut text = format!(
        "on the simulated cell (seed {SEED}), every joint {OFFSET_RAD} rad beside its start | on its start\n\
         gains                period ms  below {} rad after s, joint 1 to 6     after 0.35 s mrad  release mrad, mrad/s  \
         landing mm\n",
        0.5 * OFFSET_RAD
    );
    let mut table = vec![("in the controller", before.clone()), ("this design", after.clone())];
    table.extend(yardsticks(&after, file));
    for (name, gains) in &table {
        let rows = rows(gains).ok_or("the controller does not hold gains of six joints")?;
        let settings = settings(&rows, f64::from(gains.period_us) * 1e-6, gains.estimator());
        let beside = run(robot, &settings, motion, OFFSET_RAD, SEED);
        let on = run(robot, &settings, motion, 0.0, SEED);
        let _ = match (beside, on) {
            (Ok(beside), Ok(on)) => {
                writeln!(
                    text,
                    "{name:<20} {:>9.1}  {}",
                    f64::from(gains.period_us) * 1e-3,
                    cells(&beside, &on)
                )
            }
            (Err(e), _) | (_, Err(e)) => writeln!(text, "{name:<20} {e}"),
        };
    }
    Ok(text)
}

fn cells(beside: &Trial, on: &Trial) -> String {
    let times: Vec<String> = beside.halved_s.iter().map(|t| format!("{t:.3}")).collect();
    let pair = |a: f64, b: f64, digits: usize| format!("{a:.digits$} | {b:.digits$}");
    let landing = match (beside.landing_m, on.landing_m) {
        (Some(a), Some(b)) => pair(1e3 * a, 1e3 * b, 1),
        _ => "-".to_owned(),
    };
    let release = if beside.release.0.is_nan() {
        "-".to_owned()
    } else {
        format!(
            "{:.2}, {:.1} | {:.2}, {:.1}",
            1e3 * beside.release.0,
            1e3 * beside.release.1,
            1e3 * on.release.0,
            1e3 * on.release.1
        )
    };
    format!(
        "{}  {:>16}  {release:>20}  {landing:>10}",
        times.join(" "),
        pair(1e3 * beside.late_max_rad, 1e3 * on.late_max_rad, 2)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use tuner::gains::design::{Design, tune};
    use tuner::gains::gains_file::FORMAT;
    use tuner::gains::machine::{Demand, Machine, inputs};
    use tuner::model::Estimator;

    #[test]
    fn built_in_gains_are_the_certified_ones_of_their_file() {
        let file = include_str!("../../../tuner/gains/powercube6-3ms.toml");
        let file = GainsFile::from_toml(file, "powercube6").unwrap();
        assert_eq!(built_in().with(&file, built_in().robot_crc32).unwrap(), built_in());
    }

    #[test]
    fn motion_without_a_plan_uses_its_share_of_the_acceleration_and_begins_and_ends_at_rest() {
        let robot = RobotModel::load("powercube6").unwrap();
        let motion = of_share(&robot, 0.5);
        assert!(motion.knots[0].1.iter().chain(&motion.knots[2].1).all(|(_, v)| *v == 0.0));
        // Joint 1 brakes with half of 10.4 rad/s2: 2 v / hb.
        let v = motion.knots[1].1[0].1;
        assert!((2.0 * v / HA_HB_S.1 - 5.2).abs() < 1e-12, "{v}");
    }

    #[test]
    fn certified_gains_hold_in_the_simulated_cell_with_the_firmware_at_either_period() {
        let robot = RobotModel::load("powercube6").unwrap();
        let machine = Machine::from_robot(&robot).unwrap();
        let motion = ReferenceProfile::with_share(&machine, 0.5);
        for period_s in [0.017, 0.003] {
            let data = inputs(&machine, &motion, &Demand::with_period(period_s)).unwrap();
            let joint = data.iter().map(|i| tune(i, Design::Saturated).unwrap().entry()).collect();
            let estimator = Estimator::usual(period_s);
            let file = GainsFile { format: FORMAT, robot: "powercube6".into(), period_s, estimator, joint };
            let text = compare(&robot, &built_in(), &file, &of_share(&robot, 0.5)).unwrap();
            console::line!("{text}");
            let rows = rows(&built_in().with(&file, built_in().robot_crc32).unwrap()).unwrap();
            let found =
                run(&robot, &settings(&rows, period_s, estimator), &of_share(&robot, 0.5), OFFSET_RAD, SEED)
                    .unwrap();
            // With all of 22.3 rad/s2 and the reference's help joint 6 needs 0.055 s.
            assert!(found.halved_s.iter().all(|t| (0.04..0.25).contains(t)), "{found:?}");
            assert!((1e-5..0.05).contains(&found.late_max_rad), "{found:?}");
        }
    }
}
