//! Openings and moving targets: planned, and checked by the independent verifier and by flights of the simulator.

use nalgebra::Vector3;
use planner::flight::Course;
use planner::plan::file::PlanFile;
use planner::plan::opening::Opening;
use planner::plan::problem::{Options, Problem, ProblemError};
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::statistics::{Noise, landing_with_delay};
use planner::plan::{Arm, seeds};
use planner::verify;

fn arm() -> Arm {
    Arm::load("powercube6").expect("built in")
}

/// Without limits of the landing's shift: a small search finds those throws.
fn options() -> Options {
    Options { delay_windows: Vec::new(), ..Options::best() }
}

fn plan(arm: &Arm, target: [f64; 3], options: Options) -> PlanFile {
    let problem = Problem::new(arm, Vector3::from(target), options).expect("valid");
    let budget = Budget { starts: 16, ..Budget::default() };
    let best = Planner::new(&problem)
        .search(&seeds::built_in(arm), &budget, &Watch::default())
        .unwrap_or_else(|e| panic!("{target:?}: {e}"));
    // Nulling holds against the target, wherever it is and however its plane stands.
    let landed = |ms: f64| landing_with_delay(&problem, &best.found.throw, 1e-3 * ms).expect("passes");
    assert!((landed(0.0) - problem.aim().centre()).norm() < 1e-6, "{target:?}");
    let slope = (landed(0.1) - landed(-0.1)).norm() / 0.2e-3;
    // What a central difference leaves of the third order; a throw without nulling has a metre per second.
    assert!(slope < 0.01, "{target:?}: {slope} m/s");
    let plan = PlanFile::of(&problem, &best, "powercube6", 1, &Noise::default(), None).expect("it lands");
    let read = PlanFile::from_json("plan".as_ref(), &plan.to_json()).expect("reads its own file");
    assert_eq!(read, plan);
    plan
}

fn refused(arm: &Arm, plan: &PlanFile) -> Vec<String> {
    let report = verify::check(arm, plan);
    report.findings.into_iter().filter(|f| f.enforced && !f.ok).map(|f| f.what).collect()
}

#[test]
fn a_ball_passes_upright_tilted_and_lying_openings_within_angle_and_rim() {
    let arm = arm();
    for (target, normal, radius_m, incidence_deg) in [
        ([1.6, 0.2, -0.3], [-1.0, 0.0, 0.0], 0.08, 45.0_f64),
        ([1.2, -0.9, -0.5], [-0.6, 0.5, 0.7], 0.06, 30.0),
        ([1.3, 0.4, -0.8], [0.0, 0.0, 1.0], 0.05, 35.0),
    ] {
        let opening = Opening {
            normal: Vector3::from(normal),
            radius_m,
            incidence_max_rad: incidence_deg.to_radians(),
        };
        let plan = plan(&arm, target, Options { opening: Some(opening), ..options() });
        assert_eq!(refused(&arm, &plan), Vec::<String>::new(), "{target:?}");
        let kept = plan.target.opening.expect("it has one");
        assert!(kept.incidence_rad <= opening.incidence_max_rad + 1e-6);
        assert!(kept.rim_clearance_m >= 0.005, "{kept:?}");
        // The verifier sees a rim that is too narrow, an angle that is too steep, and the wrong side.
        let changed = |change: &dyn Fn(&mut planner::plan::file::OpeningInfo)| {
            let mut other = plan.clone();
            change(other.target.opening.as_mut().expect("it has one"));
            refused(&arm, &other)
        };
        assert!(!changed(&|o| o.radius_m = 0.03).is_empty());
        assert!(!changed(&|o| o.incidence_max_rad = 0.5 * o.incidence_rad).is_empty());
        assert!(!changed(&|o| o.normal = o.normal.map(|n| -n)).is_empty());
    }
}

#[test]
fn a_moving_target_is_met_where_it_is_then() {
    let arm = arm();
    let target = [1.3, -0.3, -0.6];
    for course in [vec![[0.3, 0.5, 0.0]], vec![[-0.4, 0.2, 0.3], [0.2, -0.3, -0.4]]] {
        let moving = Course::new(&course).expect("at most five");
        let plan = plan(&arm, target, Options { course: moving, ..options() });
        assert_eq!(refused(&arm, &plan), Vec::<String>::new(), "{course:?}");
        let met = Vector3::from(plan.landing.position_m);
        let there = Vector3::from(target) + moving.way_m(plan.landing.flight_s);
        assert!((met - there).norm() < 1e-6, "{course:?}: {met} {there}");
        assert!((met - Vector3::from(target)).norm() > 0.05, "{course:?}: it has moved");
        let mut slower = plan.clone();
        slower.target.course[0][1] += 0.01;
        assert!(!refused(&arm, &slower).is_empty(), "the verifier moves the target too");
    }
}

#[test]
fn a_target_moving_upright_opening_in_heavy_air_is_met() {
    let arm = arm();
    let opening = Opening { normal: Vector3::new(-1.0, 0.3, 0.2), radius_m: 0.09, incidence_max_rad: 0.7 };
    let options = Options {
        opening: Some(opening),
        course: Course::new(&[[0.2, -0.3, 0.1]]).expect("one"),
        drag_per_m: 0.1,
        ..options()
    };
    let plan = plan(&arm, [1.3, 0.3, -0.4], options);
    assert_eq!(refused(&arm, &plan), Vec::<String>::new());
}

#[test]
fn openings_that_no_ball_passes_are_refused_by_name() {
    let arm = arm();
    let with = |opening: Opening| {
        let options = Options { opening: Some(opening), ..options() };
        Problem::new(&arm, Vector3::new(1.3, 0.3, -0.4), options).expect_err("refused")
    };
    let sound = Opening { normal: -Vector3::x(), radius_m: 0.1, incidence_max_rad: 0.7 };
    assert_eq!(with(Opening { normal: Vector3::zeros(), ..sound }), ProblemError::OpeningNormal);
    assert_eq!(
        with(Opening { normal: Vector3::from_element(f64::NAN), ..sound }),
        ProblemError::OpeningNormal
    );
    assert!(matches!(with(Opening { radius_m: 0.034, ..sound }), ProblemError::OpeningNarrow { .. }));
    for wrong in [f64::NAN, -0.1, 2.0] {
        let e = with(Opening { incidence_max_rad: wrong, ..sound });
        assert!(matches!(e, ProblemError::Option { .. }), "{e}");
    }
}
