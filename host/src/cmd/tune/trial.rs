//! Motions for trials, and what gains do in them: on the simulated cell, and in recorded throws.

use std::fmt::Write as _;

use firmware::settings::Settings;
use rayon::prelude::*;
use robot_model::RobotModel;
use serde::Serialize;

use super::apply::InForce;
use crate::report::tune::Table;
use operator::analysis::RunAnalysis;
use planner::plan::file::PlanFile;
use tuner::gains::gains_file::{GainsFile, JointGains};
use tuner::gains::lqr;
use tuner::gains::machine::ReferenceProfile;
use tuner::gains::problem::PhaseInput;
use tuner::gains::saturated::Gains;
use tuner::gains::trial::{LATE_S, Trial, TrialMotion, run, settings};

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

pub(super) fn of_plan(plan: &PlanFile) -> TrialMotion {
    let motion: planner::motion::Motion = plan.motion.to_motion();
    let joints = plan.motion.joints.len();
    let at = |numbers: &[f64], j: usize| numbers.get(j).copied().unwrap_or(0.0);
    let knots = motion
        .knots
        .iter()
        .map(|knot| (knot.t_s, (0..joints).map(|j| (at(&knot.q_rad, j), at(&knot.qd_rad_s, j))).collect()));
    TrialMotion {
        knots: knots.collect(),
        release_s: Some(plan.release_time_s),
        target_m: Some(plan.target.position_m),
    }
}

/// Without a plan: every joint swings through the middle of its range and uses `share` of its acceleration.
pub(super) fn of_share(robot: &RobotModel, share: f64) -> TrialMotion {
    let (ha, hb) = HA_HB_S;
    let middle = robot.joints().iter().map(|joint| {
        let limits = &joint.limits;
        let v = (0.5 * share * limits.a_control_max_rad_s2 * hb).min(0.9 * limits.v_max_rad_s);
        (0.5 * (limits.q_min_rad + limits.q_max_rad), v)
    });
    let through: Vec<(f64, f64)> = middle.collect();
    let rest = |way: f64| through.iter().map(|(q, v)| (q + 2.0 / 3.0 * v * way, 0.0)).collect();
    let knots = vec![(0.0, rest(-ha)), (ha, through.clone()), (ha + hb, rest(hb))];
    TrialMotion { knots, release_s: None, target_m: None }
}

/// Gains under a name.
pub(super) struct Named {
    pub(super) name: String,
    pub(super) gains: InForce,
}

/// A motion under a name.
#[derive(Clone, Debug)]
pub(super) struct Throw {
    pub(super) name: String,
    pub(super) motion: TrialMotion,
}

/// What gains did in one throw; [`COLUMNS`] explains the numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Row {
    pub(super) gains: String,
    pub(super) throw: String,
    /// Where the joints stood when it began, and who saw it.
    pub(super) start: String,
    pub(super) period_ms: f64,
    pub(super) halved_s: Vec<f64>,
    pub(super) late_max_mrad: Option<f64>,
    pub(super) release_mrad: Option<f64>,
    pub(super) release_mrad_s: Option<f64>,
    pub(super) landing_mm: Option<f64>,
    /// Why there are no numbers.
    pub(super) failed: Option<String>,
}

/// Columns of the table and what they mean.
const COLUMNS: [(&str, &str); 6] = [
    (
        "start",
        "where every joint stood when the throw began: beside its start (beyond what is certified), or on it",
    ),
    ("late mrad", "largest position error of any joint after 0.35 s"),
    ("release mrad", "largest position error of any joint when the hand opens"),
    ("mrad/s", "largest velocity error of any joint then"),
    ("landing mm", "from the target to where the ball lands"),
    (
        "halved s",
        "from the order to run until the position error of a joint stays below half of its start, joint by joint",
    ),
];
const _: () = assert!(LATE_S == 0.35);

impl Row {
    fn new(gains: &str, throw: &str, start: &str, period_us: u32) -> Self {
        let [late_max_mrad, release_mrad, release_mrad_s, landing_mm] = [None; 4];
        Self {
            gains: gains.to_owned(),
            throw: throw.to_owned(),
            start: start.to_owned(),
            period_ms: f64::from(period_us) * 1e-3,
            halved_s: Vec::new(),
            late_max_mrad,
            release_mrad,
            release_mrad_s,
            landing_mm,
            failed: None,
        }
    }

    fn with(self, trial: Trial) -> Self {
        let there = |x: f64| (!x.is_nan()).then_some(1e3 * x);
        Self {
            halved_s: trial.halved_s,
            late_max_mrad: there(trial.late_max_rad),
            release_mrad: there(trial.release.0),
            release_mrad_s: there(trial.release.1),
            landing_mm: trial.landing_m.and_then(there),
            ..self
        }
    }
}

/// Simulates every set of gains in every throw: once from beside the start, once from the start. All settings but the gains are
/// those of the robot.
pub(super) fn simulate(
    robot: &RobotModel,
    of_robot: &Settings,
    sets: &[Named],
    throws: &[Throw],
) -> Vec<Row> {
    let starts = [(OFFSET_RAD, "100 mrad beside"), (0.0, "on it")];
    let cases: Vec<_> = throws
        .iter()
        .flat_map(|throw| {
            starts.iter().flat_map(move |start| sets.iter().map(move |set| (throw, start, set)))
        })
        .collect();
    let row = |(throw, (offset_rad, start), Named { name, gains }): (&Throw, &(f64, &str), &Named)| {
        let row = Row::new(name, &throw.name, start, gains.period_us);
        let settings = settings(of_robot, &rows(gains), f64::from(gains.period_us) * 1e-6, gains.estimator());
        match run(robot, &settings, &throw.motion, *offset_rad, SEED) {
            Ok(trial) => row.with(trial),
            Err(error) => Row { failed: Some(error.to_string()), ..row },
        }
    };
    cases.into_par_iter().map(row).collect()
}

/// What was measured in a throw.
pub(super) fn recorded(
    gains: &str,
    throw: &str,
    period_us: u32,
    seen: &RunAnalysis,
    landing_m: Option<f64>,
) -> Row {
    let largest = |of: &mut dyn Iterator<Item = f64>| of.map(|x| 1e3 * x.abs()).reduce(f64::max);
    let samples = || seen.joints.iter().flat_map(|joint| &joint.samples);
    let late = |t_s: f64| (LATE_S..=seen.end_t_s).contains(&t_s);
    Row {
        late_max_mrad: largest(&mut samples().filter(|s| late(s.t_s)).map(|s| s.error_rad)),
        release_mrad: largest(&mut seen.joints.iter().filter_map(|j| j.position_error_rad.at_release)),
        release_mrad_s: largest(&mut seen.joints.iter().filter_map(|j| j.speed_error_rad_s.at_release)),
        landing_mm: landing_m.map(|m| 1e3 * m),
        ..Row::new(gains, throw, "recorded", period_us)
    }
}

fn rows(gains: &InForce) -> Vec<Gains> {
    let columns = gains.k_pos_1_s2.iter().zip(&gains.k_vel_1_s).zip(&gains.k_last);
    columns.map(|((k_pos, k_vel), k_last)| [*k_pos, *k_vel, *k_last]).collect()
}

/// What the design is compared with, for gains of all joints: Theorem 1 of the paper for the same data, and plain LQR,
/// which the drives clip.
pub(super) fn yardsticks(after: &InForce, file: &GainsFile) -> Vec<Named> {
    let with = |rows: Vec<Gains>| {
        let column = |which: usize| rows.iter().map(|row| row[which]).collect();
        let (k_pos_1_s2, k_vel_1_s, k_last) = (column(0), column(1), column(2));
        let whole = rows.len() == after.k_pos_1_s2.len();
        whole.then(|| InForce { certificate_crc32: 0, k_pos_1_s2, k_vel_1_s, k_last, ..after.clone() })
    };
    let theorem_1 = |joint: &JointGains| joint.theorem_1(file.period_s, file.estimator);
    let paper = with(file.joint.iter().filter_map(theorem_1).collect());
    let (velocity_per_rad, input_per_rad) = LQR_WEIGHTS;
    let row = lqr::gains(file.period_s, file.period_s, velocity_per_rad, input_per_rad);
    let lqr = row.and_then(|row| with(vec![row; after.k_pos_1_s2.len()]));
    [("Theorem 1", paper), ("LQR, no certificate", lqr)]
        .into_iter()
        .filter_map(|(name, gains)| Some(Named { name: name.to_owned(), gains: gains? }))
        .collect()
}

pub(super) fn table(rows: &[Row]) -> Table<'static> {
    let head = [
        "gains",
        "throw",
        "start",
        "period ms",
        "late mrad",
        "release mrad",
        "mrad/s",
        "landing mm",
        "halved s",
    ];
    let cell = |x: Option<f64>| x.map_or_else(|| "-".to_owned(), |x| format!("{x:.2}"));
    let cells = |row: &Row| {
        let halved: Vec<String> = row.halved_s.iter().map(|s| format!("{s:.3}")).collect();
        let halved = if halved.is_empty() { "-".to_owned() } else { halved.join(" ") };
        vec![
            row.gains.clone(),
            row.throw.clone(),
            row.start.clone(),
            format!("{:.1}", row.period_ms),
            cell(row.late_max_mrad),
            cell(row.release_mrad),
            cell(row.release_mrad_s),
            cell(row.landing_mm),
            row.failed.clone().unwrap_or(halved),
        ]
    };
    Table { head: head.into(), rows: rows.iter().map(cells).collect(), columns: &COLUMNS }
}

/// Table for the terminal, with a line for each column.
pub(super) fn text(rows: &[Row]) -> String {
    let Table { head, rows, columns } = table(rows);
    let head: Vec<String> = head.into_iter().map(str::to_owned).collect();
    let all: Vec<&Vec<String>> = std::iter::once(&head).chain(&rows).collect();
    let width = |i: usize| all.iter().map(|row| row[i].chars().count()).max().unwrap_or(0);
    let mut t = String::new();
    for row in &all {
        let cells = row.iter().enumerate().map(|(i, cell)| match i {
            0..=2 => format!("{cell:<0$}", width(i)),
            8 => cell.clone(),
            _ => format!("{cell:>0$}", width(i)),
        });
        let _ = writeln!(t, "{}", cells.collect::<Vec<_>>().join("  "));
    }
    explain(&mut t, columns);
    t
}

/// One line for each column.
pub(super) fn explain(text: &mut String, columns: &[(&str, &str)]) {
    for (column, meaning) in columns {
        let _ = writeln!(text, "  {column:<15}  {meaning}");
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{args, designed};
    use super::*;
    use operator::bus::settings::{crc32_of, settings_of};
    use tuner::gains::choose::gains_for;

    #[test]
    fn built_in_gains_are_the_certified_ones_of_their_file() {
        let file = include_str!("../../../tuner/gains/powercube6-3ms.toml");
        let file = GainsFile::from_toml(file, "powercube6").unwrap();
        let built_in = InForce::of(&Settings::powercube6());
        assert_eq!(built_in.with(&file, built_in.robot_crc32).unwrap(), built_in);
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

    /// `tune` without options designed gains that were half as fast as those that `throw` takes.
    #[test]
    fn what_tune_designs_by_itself_is_no_slower_than_what_throw_takes() {
        let arm = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/robots/arm.toml");
        for (robot, period_ms) in [("powercube6", 3), ("powercube6", 17), ("pincher4", 3), (arm, 3)] {
            let (work, file) = designed(&args(&format!("--robot {robot} --period-ms {period_ms}")));
            let of_robot = settings_of(&work.robot).unwrap();
            let (shipped, _) = gains_for(&work.robot, 1_000 * period_ms).unwrap();
            let sets: Vec<Named> = [("shipped", &shipped), ("default", &file)]
                .map(|(name, file)| {
                    let gains = InForce::of(&of_robot).with(file, crc32_of(&work.robot)).unwrap();
                    Named { name: name.to_owned(), gains }
                })
                .into();
            let throws = [Throw { name: "share".to_owned(), motion: of_share(&work.robot, 0.8) }];
            let found = simulate(&work.robot, &of_robot, &sets, &throws);
            console::line!("{}", text(&found));
            // From 100 mrad beside its start the controller of pincher4 stops with either.
            let begin = if robot == "pincher4" { 2 } else { 0 };
            for pair in found[begin..].chunks(2) {
                let [shipped, default] = pair else { panic!("{pair:?}") };
                assert!(default.failed.is_none() && shipped.failed.is_none(), "{pair:?}");
                let slower = default.halved_s.iter().zip(&shipped.halved_s).any(|(d, s)| d > s);
                // At 17 ms the shipped gains are slower than what is proven today: they take 1 % longer, and errors five times
                // those of the certificate are clipped for less long with them.
                let worse = period_ms == 3 && default.late_max_mrad > shipped.late_max_mrad;
                assert!(!slower && !worse, "{robot}: {pair:?}");
            }
            if begin == 2 {
                continue;
            }
            // With all of its acceleration and the reference's help joint 6 of powercube6 needs 0.055 s; the joints of the other arm
            // have more.
            let fastest_s = if robot == "powercube6" { 0.04 } else { 0.02 };
            let Row { halved_s, late_max_mrad, .. } = &found[1];
            assert!(!halved_s.is_empty(), "{robot}");
            assert!(halved_s.iter().all(|t| (fastest_s..0.15).contains(t)), "{robot}: {halved_s:?}");
            assert!(
                late_max_mrad.is_some_and(|late| (0.01..50.0).contains(&late)),
                "{robot}: {late_max_mrad:?}"
            );
        }
    }
}
