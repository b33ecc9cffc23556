//! Things that are no balls: thrown so that they arrive with an attitude, checked by the independent verifier.

use nalgebra::{Rotation3, Vector3};
use planner::plan::attitude::{Arrived, arrived_with_delay, monte_carlo_attitude, predict_attitude};
use planner::plan::file::PlanFile;
use planner::plan::problem::{Options, Problem, ProblemError};
use planner::plan::rng::SplitMix64;
use planner::plan::search::{Best, Budget, Planner, Watch};
use planner::plan::statistics::Noise;
use planner::plan::{Arm, Attitude, Cone, NoThrow, seeds};
use planner::store::Index;
use planner::verify;
use robot_model::RobotModel;

fn arm() -> Arm {
    Arm::load("powercube6").expect("built in")
}

fn cone(direction: [f64; 3], deg: f64) -> Cone {
    Cone { direction_w: Vector3::from(direction), angle_max_rad: deg.to_radians(), either_sign: false }
}

/// A disc whose axis is that of the last joint, with nothing asked of it.
fn disc() -> Attitude {
    Attitude { axis_e: Vector3::z(), inertia_ratio: 1.8, axis: None, spin: None, spin_min_rad_s: 1.0 }
}

/// A stick across the hand.
fn stick() -> Attitude {
    Attitude { axis_e: Vector3::x(), inertia_ratio: 0.02, ..disc() }
}

fn options(attitude: Attitude) -> Options {
    Options { attitude: Some(attitude), delay_windows: Vec::new(), ..Options::best() }
}

fn search<const N: usize>(
    problem: &Problem<'_, N>,
    index: &Index<N>,
    starts: usize,
) -> Result<Best<N>, NoThrow> {
    Planner::new(problem).search(index, &Budget { starts, ..Budget::default() }, &Watch::default())
}

fn refused<const N: usize>(arm: &RobotModel<N>, plan: &PlanFile) -> Vec<String> {
    let report = verify::check(arm, plan);
    report
        .findings
        .into_iter()
        .filter(|f| f.enforced && !f.ok)
        .map(|f| format!("{}: {}", f.what, f.worst))
        .collect()
}

/// The plan, written and read, with every check kept.
fn sound<const N: usize>(problem: &Problem<'_, N>, best: &Best<N>) -> PlanFile {
    let plan = PlanFile::of(problem, best, "arm", 1, &Noise::default(), None).expect("it lands");
    let read = PlanFile::from_json("plan".as_ref(), &plan.to_json()).expect("reads its own file");
    assert_eq!(read, plan);
    assert_eq!(refused(problem.arm(), &plan), Vec::<String>::new());
    plan
}

#[test]
fn things_arrive_with_their_axis_and_their_spin_as_asked_for() {
    let arm = arm();
    let index = seeds::built_in(&arm);
    let mut rotating = 0;
    let both_ways = Cone { either_sign: true, ..cone([0.0, 0.0, -1.0], 15.0) };
    // The hand turns about y, and so does the disc about its own axis.
    let like_a_wheel = Attitude { axis_e: Vector3::y(), spin: Some(cone([0.0, 1.0, 0.0], 20.0)), ..disc() };
    for (target, attitude) in [
        ([1.2, 0.3, -0.8], Attitude { axis: Some(cone([0.0, 0.0, -1.0], 15.0)), ..disc() }),
        ([1.2, 0.3, -0.8], Attitude { spin: Some(cone([0.0, 1.0, 0.0], 20.0)), ..disc() }),
        ([1.2, 0.3, -0.8], like_a_wheel),
        ([-0.7, 1.0, -0.9], Attitude { axis: Some(both_ways), ..stick() }),
    ] {
        let problem = Problem::new(&arm, Vector3::from(target), options(attitude)).expect("valid");
        let best = search(&problem, &index, 16).unwrap_or_else(|e| panic!("{target:?}: {e}"));
        let plan = sound(&problem, &best);
        let arrived = arrived_with_delay(&problem, &best.found.throw, 0.0).expect("lands");
        assert!(arrived.excess_rad(&attitude) < 1e-6, "{target:?}: {arrived:?}");
        let told = plan.target.attitude.as_ref().expect("it has one");
        assert!(
            told.arrival.delay_turns.iter().all(|t| t.axis_rad.is_some_and(|turn| turn > 0.0)),
            "{told:?}"
        );
        assert!(told.arrival.axis_sigma_rad.is_some_and(|s| s > 1e-4 && s < 0.5), "{told:?}");
        // The verifier sees a narrower angle, another body and another axis in the hand.
        let changed = |change: &dyn Fn(&mut planner::plan::file::AttitudeInfo)| {
            let mut other = plan.clone();
            change(other.target.attitude.as_mut().expect("it has one"));
            refused(&arm, &other)
        };
        let narrow = changed(&|a| {
            let angles = arrived.angles_rad(&attitude);
            for (wanted, angle) in [&mut a.axis, &mut a.spin].into_iter().zip(angles) {
                if let (Some(wanted), Some(angle)) = (wanted.as_mut(), angle) {
                    wanted.angle_max_rad = angle - 1e-3;
                }
            }
        });
        assert_eq!(narrow.len(), 1, "{narrow:?}");
        // The inertia counts as far as the thing rotates about its axis.
        let along_rad_s = arrived.momentum_rad_s.dot(&arrived.axis_w) / attitude.inertia_ratio;
        if along_rad_s.abs() > 1e-2 {
            assert!(!changed(&|a| a.inertia_ratio = 0.5).is_empty(), "{along_rad_s}");
            rotating += 1;
        }
        let [x, y, z] = attitude.axis_e.into();
        assert!(!changed(&|a| a.axis_e = [y, z, x]).is_empty());
        assert!(!changed(&|a| a.arrival.axis_w[0] += 1e-3).is_empty());
    }
    assert!(rotating > 0, "the wheel rotates about its axis");
}

/// Directions near those that a throw without the wish has, and any azimuth: each is reached.
#[test]
fn random_targets_with_random_attitudes_in_reach_are_found_and_verified() {
    let arm = arm();
    let index = seeds::built_in(&arm);
    let mut rng = SplitMix64::new(7);
    for k in 0..4 {
        let azimuth = std::f64::consts::TAU * rng.unit();
        let range = 0.8 + 0.6 * rng.unit();
        let target = Vector3::new(range * azimuth.cos(), range * azimuth.sin(), -0.9 + 0.5 * rng.unit());
        let body = if k % 2 == 0 { disc() } else { stick() };
        let free = Problem::new(&arm, target, options(body)).expect("valid");
        let Ok(any) = search(&free, &index, 8) else { continue };
        let arrived = arrived_with_delay(&free, &any.found.throw, 0.0).expect("lands");
        // Turned by 40 degrees about a random axis, half of that allowed.
        let about = Vector3::new(rng.normal(), rng.normal(), rng.normal()).cross(&arrived.axis_w).normalize();
        let direction = Rotation3::new(about * 40_f64.to_radians()) * arrived.axis_w;
        let attitude = Attitude { axis: Some(cone(direction.into(), 20.0)), ..body };
        assert!(arrived.excess_rad(&attitude) > 0.3, "the free throw does not have it");
        let problem = Problem::new(&arm, target, options(attitude)).expect("valid");
        let best = search(&problem, &index, 16).unwrap_or_else(|e| panic!("{target}: {e}"));
        sound(&problem, &best);
    }
}

#[test]
fn an_arm_of_four_joints_and_one_of_seven_throw_with_an_attitude() {
    let pincher = robot_model::built_in_text("pincher4").expect("built in");
    let pincher = RobotModel::<4>::from_toml("pincher4", pincher).expect("loads");
    throws_of(&pincher, [0.45, 0.1, 0.05]);
    let iiwa = RobotModel::<7>::from_toml("iiwa7", include_str!("data/iiwa7.toml")).expect("loads");
    throws_of(&iiwa, [1.3, 0.2, -0.7]);
}

/// From no stored throw, without nulling: a disc that looks along the throw is to arrive 12 degrees steeper or flatter than it does by
/// itself, 8 degrees are allowed.
fn throws_of<const N: usize>(arm: &RobotModel<N>, target: [f64; 3]) {
    let plain = |attitude| Options { null_delay: false, ..options(attitude) };
    let body = Attitude { axis_e: arm.gripper().x_eb.rot.column(2).into(), ..disc() };
    let free = Problem::new(arm, Vector3::from(target), plain(body)).expect("valid");
    let any = search(&free, &Index::default(), 16).unwrap_or_else(|e| panic!("{e}"));
    let arrived = arrived_with_delay(&free, &any.found.throw, 0.0).expect("lands");
    let (_, v) = any.found.throw.ball_at_release(arm);
    let lateral = Vector3::z().cross(&v);
    let lateral = (lateral - arrived.axis_w * arrived.axis_w.dot(&lateral)).normalize();
    let mut thrown = 0;
    for sign in [1.0, -1.0] {
        let direction = Rotation3::new(lateral * (sign * 12_f64.to_radians())) * arrived.axis_w;
        let attitude = Attitude { axis: Some(cone(direction.into(), 8.0)), ..body };
        assert!(arrived.excess_rad(&attitude) > 0.03, "the free throw does not have it");
        let problem = Problem::new(arm, Vector3::from(target), plain(attitude)).expect("valid");
        if let Ok(best) = search(&problem, &Index::default(), 16) {
            sound(&problem, &best);
            thrown += 1;
        }
    }
    assert!(thrown > 0, "steeper or flatter, one of them is possible");
}

#[test]
fn an_attitude_that_no_throw_has_is_refused_by_name() {
    let arm = arm();
    let index = seeds::built_in(&arm);
    // The disc looks along the throw: it cannot arrive looking back up, and never rotates at 60 rad/s.
    let fast = Attitude { spin: Some(cone([0.0, 1.0, 0.0], 20.0)), spin_min_rad_s: 60.0, ..disc() };
    let problem = Problem::new(&arm, Vector3::new(1.2, 0.3, -0.8), options(fast)).expect("valid");
    let none = search(&problem, &index, 4).expect_err("no such throw");
    let nearest = none.attitude.clone().expect("the target itself is in reach");
    let text = none.to_string();
    assert!(text.contains(nearest.what) && text.contains("attitude asked for"), "{text}");
    assert!(none.nearest.is_none() && none.obstruction.is_none(), "{none:?}");
    // Out of reach with any attitude: the target is named, not the attitude.
    let far = Problem::new(&arm, Vector3::new(9.0, 0.0, -0.8), options(fast)).expect("valid");
    let none = search(&far, &index, 4).expect_err("out of reach");
    assert!(none.attitude.is_none() && none.nearest.is_some(), "{none:?}");
}

#[test]
fn the_spread_of_the_attitude_is_that_of_drawn_throws() {
    let arm = arm();
    for body in [disc(), stick()] {
        let problem = Problem::new(&arm, Vector3::new(1.2, 0.3, -0.8), options(body)).expect("valid");
        let best = search(&problem, &seeds::built_in(&arm), 4).expect("in reach");
        let noise = Noise::default();
        let predicted = predict_attitude(&problem, &best.found.throw, &noise).expect("lands");
        let drawn = monte_carlo_attitude(&problem, &best.found.throw, &noise, 20_000, 3);
        assert_eq!(drawn.len(), 20_000);
        let rms = |directions: Vec<Vector3<f64>>| {
            let n = directions.len() as f64;
            let mean: Vector3<f64> = directions.iter().sum::<Vector3<f64>>() / n;
            (directions.iter().map(|d| (d - mean).norm_squared()).sum::<f64>() / n).sqrt()
        };
        let axis = rms(drawn.iter().map(|a| a.axis_w).collect());
        let spin = rms(drawn.iter().filter_map(Arrived::spin_axis_w).collect());
        let of_spin = predicted.spin_rad.expect("it rotates");
        println!("axis {:.5} rad, drawn {axis:.5}; spin {of_spin:.5}, drawn {spin:.5}", predicted.axis_rad);
        // Two sets of so many draws differ by half a percent.
        assert!((predicted.axis_rad / axis - 1.0).abs() < 0.02, "{} {axis}", predicted.axis_rad);
        assert!((of_spin / spin - 1.0).abs() < 0.02, "{of_spin} {spin}");
    }
}

#[test]
fn attitudes_that_make_no_sense_are_refused_by_name() {
    let arm = arm();
    let with = |attitude: Attitude| {
        Problem::new(&arm, Vector3::new(1.2, 0.3, -0.8), options(attitude)).expect_err("refused")
    };
    let down = cone([0.0, 0.0, -1.0], 15.0);
    for none in [[0.0; 3], [f64::NAN, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0]] {
        let wrong = Cone { direction_w: Vector3::from(none), ..down };
        assert_eq!(
            with(Attitude { axis: Some(wrong), ..disc() }),
            ProblemError::NoDirection { what: "the arrival axis" }
        );
        assert_eq!(
            with(Attitude { spin: Some(wrong), ..disc() }),
            ProblemError::NoDirection { what: "the spin axis" }
        );
        let thing = Attitude { axis_e: Vector3::from(none), axis: Some(down), ..disc() };
        assert_eq!(with(thing), ProblemError::NoDirection { what: "the axis of the thing" });
    }
    for wrong in [f64::NAN, -0.1, 0.0, 4.0] {
        let axis = Some(Cone { angle_max_rad: wrong, ..down });
        assert!(matches!(with(Attitude { axis, ..disc() }), ProblemError::Option { .. }), "{wrong}");
        assert!(matches!(with(Attitude { spin: axis, ..disc() }), ProblemError::Option { .. }), "{wrong}");
    }
    for wrong in [f64::NAN, -0.1, 2.1] {
        assert!(matches!(with(Attitude { inertia_ratio: wrong, ..disc() }), ProblemError::Option { .. }));
    }
    for wrong in [f64::NAN, -1.0, 0.0, 1e3] {
        let e = with(Attitude { spin: Some(down), spin_min_rad_s: wrong, ..disc() });
        assert!(matches!(e, ProblemError::Option { .. }), "{e}");
    }
    let paper = Options { attitude: Some(Attitude { axis: Some(down), ..disc() }), ..Options::paper() };
    let e = Problem::new(&arm, Vector3::new(1.2, 0.3, -0.8), paper).expect_err("refused");
    assert_eq!(e, ProblemError::AttitudeInPaperForm);
}
