//! From a throw to its plan.

use nalgebra::Matrix4;
use robot_model::JointVec;

use super::{
    CheckInfo, Currents, DelayShift, FORMAT, FingerLandingInfo, GoalName, LandingInfo, MarginsInfo,
    MotionInfo, Objective, ObstacleInfo, OpeningInfo, PlanFile, Release, RobotId, Search, SupplyPeak, Target,
    VERSION,
};
use crate::flight::Landing;
use crate::motion::Motion;
use crate::plan::finger_release::predict_with_fingers;
use crate::plan::goal::Goal;
use crate::plan::margins::Margins;
use crate::plan::opening::nearest_to_rim;
use crate::plan::options::HAND_CLEARANCE_M;
use crate::plan::paper::PaperParameters;
use crate::plan::problem::{CLEARANCE_EXTRA_M, Obstacle, Problem};
use crate::plan::scan::{RELEASE_BLIND_S, Scanner};
use crate::plan::search::Best;
use crate::plan::statistics::{Noise, Region, landing_with_delay, predict};
use crate::throw::Throw;

impl PlanFile {
    /// Puts together the plan of a throw.
    ///
    /// Returns `None` only if the ball of the throw never comes down on the plane of the target, or stays in the
    /// fingers although their release was requested.
    #[must_use]
    pub fn of(
        problem: &Problem<'_>,
        best: &Best,
        robot_source: &str,
        seed: u64,
        noise: &Noise,
        region: Option<Region>,
    ) -> Option<Self> {
        let (arm, throw) = (problem.arm, &best.found.throw);
        let (p, v) = throw.ball_at_release(arm);
        let landed = problem.flight.meet(&p, &v, &problem.aim, 0.0)?;
        let prediction = predict(problem, throw, noise)?;
        let c = prediction.covariance_m2;
        let aim = problem.aim.centre();
        let fingers = match arm.fingers().filter(|_| problem.options.finger_release) {
            None => None,
            Some(fingers) => {
                let landing = predict_with_fingers(problem, throw, fingers, noise)?;
                let c = landing.covariance_m2;
                Some(FingerLandingInfo {
                    late_s: landing.late_s,
                    shift_m: landing.shift_m.into(),
                    mean_m: landing.mean_m.into(),
                    covariance_m2: [[c[(0, 0)], c[(0, 1)]], [c[(1, 0)], c[(1, 1)]]],
                    hit_probability: region
                        .map(|r| landing.prediction(&prediction).hit_probability(&aim, &r)),
                })
            }
        };
        let margins = Margins::of(problem, throw);
        let [time, braking, jerk] = problem.objective_terms(throw);
        // All limits are measured, also those that were not enforced.
        let mut all = problem.clone();
        all.options.avoid_collisions = true;
        all.options.clean_release = true;
        let scan = Scanner::new(&all).scan(&all, throw);
        Some(Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            robot: RobotId::of(robot_source, arm),
            target: Target {
                position_m: problem.target.into(),
                region,
                opening: opening_info(problem, &landed),
                course: problem.options.course.coefficients_m(),
            },
            obstacles: problem.options.obstacles.iter().map(obstacle).collect(),
            search: Search {
                form: problem.options.form,
                goal: goal_name(&problem.options.goal),
                starts: best.starts,
                solved: best.solved,
                seed,
                interrupted: best.interrupted,
                speed_use: problem.options.speed_use,
                acceleration_use: problem.options.acceleration_use,
                clearance_m: problem.options.clearance_m,
                hand_clearance_m: if problem.options.clean_release { HAND_CLEARANCE_M } else { 0.0 },
                touch_allowed: problem.options.touch_allowed,
                confidence: Some(best.confidence),
                stored: Vec::new(),
            },
            parameters: PaperParameters::of(arm, &problem.shoulder, throw),
            motion: MotionInfo::of(arm.joints().iter().map(|joint| joint.name.clone()), &Motion::from(throw)),
            release_time_s: throw.ha_s,
            end_time_s: throw.duration_s(),
            release: Release {
                q_rad: numbers(&throw.q_rad),
                qd_rad_s: numbers(&throw.qd_rad_s),
                qdd_rad_s2: numbers(&throw.qdd_rad_s2),
                position_m: p.into(),
                velocity_m_s: v.into(),
            },
            t_ball: rows_of(&arm.gripper().x_eb.to_matrix()),
            objective: Objective {
                value: time + braking + jerk,
                time,
                braking,
                jerk,
                weights: problem.options.weights,
            },
            landing: LandingInfo {
                gravity_m_s2: problem.flight.gravity_m_s2(),
                drag_per_m: problem.flight.drag_per_m(),
                magnus_rad_s: (*problem.flight.magnus_rad_s()).into(),
                flight_s: landed.time_s,
                position_m: landed.p.into(),
                velocity_m_s: landed.v.into(),
                mean_m: prediction.mean_m.into(),
                covariance_m2: [[c[(0, 0)], c[(0, 1)]], [c[(1, 0)], c[(1, 1)]]],
                delay_sensitivity_mm_per_ms: prediction.delay_sensitivity_m_s.into(),
                delay_shifts: delay_shifts(problem, throw),
                noise: *noise,
                hit_probability: region.map(|r| prediction.hit_probability(&aim, &r)),
                fingers,
            },
            margins: MarginsInfo {
                position_rad: numbers(&margins.position_rad),
                speed_share: numbers(&margins.speed),
                acceleration_share: numbers(&margins.acceleration),
                jerk_share: numbers(&margins.jerk),
                motor_current_share: margins.motor.as_ref().map(numbers),
                supply_current_share: margins.supply.clone(),
                clearance_m: scan.clearance_m.is_finite().then_some(scan.clearance_m),
                ball_clearance_m: scan.ball_clearance_m,
            },
            currents: currents(problem, throw, &margins),
            checks: checks(problem),
        })
    }
}

fn numbers(joints: &JointVec) -> Vec<f64> {
    joints.iter().copied().collect()
}

fn opening_info(problem: &Problem<'_>, landed: &Landing) -> Option<OpeningInfo> {
    let opening = problem.options.opening.as_ref()?;
    let aim = &problem.aim;
    let approach = aim.approach(landed, 0.0);
    let near = nearest_to_rim(&problem.flight, aim, opening.radius_m, &landed.v, landed.time_s);
    Some(OpeningInfo {
        normal: (*aim.normal()).into(),
        axes: aim.axes().map(Into::into),
        radius_m: opening.radius_m,
        incidence_max_rad: opening.incidence_max_rad,
        incidence_rad: (-aim.normal().dot(&approach) / approach.norm()).clamp(-1.0, 1.0).acos(),
        rim_clearance_m: near.distance_m - problem.arm.gripper().ball_radius_m,
    })
}

fn obstacle(o: &Obstacle) -> ObstacleInfo {
    ObstacleInfo { name: o.name.clone(), x_wo: rows_of(&o.x_wo.to_matrix()), half_m: o.half_m.into() }
}

fn goal_name(goal: &Goal) -> GoalName {
    match goal {
        Goal::Effort => GoalName::Effort,
        Goal::Energy => GoalName::Energy,
        Goal::Spread(_) => GoalName::Spread,
        Goal::Miss(..) => GoalName::Miss,
    }
}

/// Shifts at the limits of the plan, or else at 10 and 25 ms.
fn delay_shifts(problem: &Problem<'_>, throw: &Throw) -> Vec<DelayShift> {
    let on_time = landing_with_delay(problem, throw, 0.0);
    let shift = |delay_s: f64| -> Option<f64> {
        let early = landing_with_delay(problem, throw, -delay_s)? - on_time?;
        let late = landing_with_delay(problem, throw, delay_s)? - on_time?;
        Some(early.norm().max(late.norm()))
    };
    let windows = &problem.options.delay_windows;
    let asked = windows.iter().map(|w| (w.delay_s, Some(w.shift_m)));
    let usual = [0.010, 0.025].into_iter().filter(|_| windows.is_empty()).map(|delay_s| (delay_s, None));
    asked
        .chain(usual)
        .map(|(delay_s, limit_m)| DelayShift { delay_s, shift_m: shift(delay_s), limit_m })
        .collect()
}

fn rows_of(m: &Matrix4<f64>) -> [[f64; 4]; 4] {
    std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
}

fn currents(problem: &Problem<'_>, throw: &Throw, margins: &Margins) -> Currents {
    let arm = problem.arm;
    let mut motor_peak = JointVec::zeros(arm.n());
    let mut supply_peak = vec![0.0_f64; arm.supplies().len()];
    let mut known = false;
    for i in 0..=400 {
        let sigma = f64::from(i) / 200.0 - 1.0;
        let s = throw.at_phase(sigma);
        let tau = problem.arm_at(sigma).inverse_dynamics(&s.q, &s.qd, &s.qdd);
        let Some(motor) = arm.motor_currents(&s.qd, &tau) else { break };
        known = true;
        for (peak, a) in motor_peak.iter_mut().zip(motor.iter()) {
            *peak = peak.max(*a);
        }
        for (peak, a) in supply_peak.iter_mut().zip(arm.supply_currents(&motor)) {
            *peak = peak.max(a);
        }
    }
    Currents {
        motor_release_a: margins.release_currents_a.as_ref().map(numbers),
        motor_peak_a: known.then(|| motor_peak.to_vec()),
        supply_peak: arm
            .supplies()
            .iter()
            .zip(supply_peak)
            .map(|(s, peak_a)| SupplyPeak { name: s.name.clone(), peak_a, limit_a: s.current_max_a })
            .collect(),
    }
}

fn checks(problem: &Problem<'_>) -> Vec<CheckInfo> {
    let o = &problem.options;
    let check = |what: &str, enforced: bool, tolerance: &str| CheckInfo {
        what: what.to_owned(),
        enforced,
        tolerance: tolerance.to_owned(),
    };
    let mut checks = vec![
        check("joint ranges (2), (3) over the motion", true, "1e-7 rad"),
        check("joint speed (4) over the motion", true, "1e-7 of the limit"),
        check("joint acceleration (5) over the motion", true, "1e-7 of the limit"),
        check("joint jerk (6)", true, "1e-7 of the limit"),
        check(
            "motor and supply currents (7), (8) at the release",
            !o.current_over_motion,
            "1e-7 of the limit",
        ),
        check("motor and supply currents over the motion", o.current_over_motion, "1e-3 of the limit"),
        check(
            "clearance of arm, base, floor, obstacles and held ball over the motion",
            o.avoid_collisions,
            &format!("{CLEARANCE_EXTRA_M} m"),
        ),
        check(
            &format!("clearance of the released ball, from {} ms on", RELEASE_BLIND_S * 1e3),
            o.clean_release,
            &format!("{CLEARANCE_EXTRA_M} m"),
        ),
        check("landing on the target", true, "1e-6 m"),
        check("landing unmoved by a late release, to first order", o.null_delay, "2e-3 mm per ms"),
        check(
            "shift of the landing for a late or early release",
            !o.delay_windows.is_empty(),
            "inside its limits",
        ),
    ];
    if o.opening.is_some() {
        checks.push(check(
            "passage through the opening: side, angle and rim",
            true,
            &format!("{CLEARANCE_EXTRA_M} m"),
        ));
    }
    checks
}
