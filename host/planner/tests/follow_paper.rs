//! The form of the paper: published numbers, its rules on the arms, and what it refuses.

use std::f64::consts::PI;
use std::sync::LazyLock;

use nalgebra::{Matrix3, Vector3};
use planner::follow::clear::{Clear, Contact, Margins, Scenes};
use planner::follow::found::Found;
use planner::follow::hand::HandLaw;
use planner::follow::landing;
use planner::follow::limits::{AXES, Arm, Axes, LimitSource, Limits};
use planner::follow::motion::{FollowMotion, Peaks, RampPlan, Ramps};
use planner::follow::paper::{Criterion, GridAxis, PaperOptions, RampTiming, j1, j2, plan};
use planner::follow::parabola::Parabola;
use planner::follow::posture::{Posture, Reach};
use planner::follow::ramp::RampShape;
use planner::follow::setting::Setting;

fn kr16() -> Arm {
    Arm::load("kr16_2").expect("built in")
}

fn deg(values: [f64; AXES]) -> Axes {
    Axes::from(values.map(f64::to_radians))
}

/// The reference throw with eight points at 2.5 m and 0.6 m height: last point and its flight.
struct Reference {
    first: Posture,
    window: Vec<Posture>,
    flight: Parabola,
}

const LAST_Q_DEG: [f64; AXES] = [45.688, -49.659, 41.878, -18.370, -48.516, 9.312];

fn reference(arm: &Arm) -> Reference {
    let last = Parabola {
        p0: Vector3::new(1.0356, -1.1820, 1.5336),
        v0: Vector3::new(2.7753, 2.2402, 0.8188),
        gravity_m_s2: 9.81,
    };
    // The hand has one rotation on all points: the one of the last.
    let rot: Matrix3<f64> = arm.ball(&arm.fk(&deg(LAST_Q_DEG))).rot;
    let reach = Reach::new(arm);
    let flight = last.from_time(-7.0 * 0.012);
    let mut q = deg(LAST_Q_DEG);
    let mut window = Vec::new();
    for k in (0..8).rev() {
        let mut state = HandLaw::constant(0.0).at(&flight, f64::from(k) * 0.012);
        state.x_wb.rot = rot;
        q = reach.near(&state.x_wb, &q).expect("in reach");
        window.push(reach.rates(q, &state).expect("regular"));
    }
    window.reverse();
    Reference { first: window[0], window, flight }
}

/// Printed with three decimals of a degree and four of a metre, and the rotation comes from the printed angles.
#[test]
fn the_reference_throw_has_its_published_joints() {
    let arm = kr16();
    let reference = reference(&arm);
    let close = |name: &str, got: &Axes, want: [f64; AXES], most: f64| {
        let off = (got.map(f64::to_degrees) - Axes::from(want)).amax();
        assert!(off < most, "{name}: off by {off} deg: {}", got.map(f64::to_degrees));
    };
    let last = &reference.window[7];
    close("last q", &last.q, LAST_Q_DEG, 0.02);
    close("last qd", &last.qd, [-148.63, 48.13, -149.94, -131.83, 50.21, 229.40], 0.15);
    close("first q", &reference.first.q, [58.231, -49.251, 50.035, -7.725, -54.052, -8.826], 0.03);
    close("first qd", &reference.first.qd, [-147.65, -58.06, -44.00, -118.05, 81.29, 197.66], 0.15);
    assert!((reference.flight.time_to(&Vector3::new(2.5, 0.0, 0.6)) - 7.0 * 0.012 - 0.528).abs() < 1e-3);
    let plan = RampPlan { shape: RampShape { blend_s: 0.0, fade_s: 0.0 }, together: 1.0 };
    let limits = Limits::of(&arm, LimitSource::ControllerModel);
    let (start, stop) = (Ramps::start(&reference.first, plan, &limits), Ramps::stop(last, plan, &limits));
    assert!((start.duration_s() - 1.655).abs() < 0.02, "{}", start.duration_s());
    assert!((stop.duration_s() - 229.40 / 120.0).abs() < 0.01, "{}", stop.duration_s());
    let second = |w: &[Posture]| ((w[2].q - w[1].q * 2.0 + w[0].q) / (0.012 * 0.012)).amax();
    let peak = reference.window.windows(3).map(second).fold(0.0, f64::max);
    assert!((peak.to_degrees() - 1293.0).abs() < 10.0, "acceleration {} deg/s2", peak.to_degrees());
}

/// Opening uniform within 10 ms: ramps through the release miss by 43 mm rms and 81 mm at most, following by nothing.
#[test]
fn following_takes_the_effect_of_the_opening_time_away() {
    let arm = kr16();
    let Reference { window, flight, .. } = reference(&arm);
    let limits = Limits::of(&arm, LimitSource::ControllerModel);
    let plan = RampPlan { shape: RampShape { blend_s: 0.0, fade_s: 0.0 }, together: 1.0 };
    let (start, stop) = (Ramps::start(&window[0], plan, &limits), Ramps::stop(&window[7], plan, &limits));
    let following = FollowMotion::around(&window, &start, &stop, 0.012);
    let target = flight.position(7.0 * 0.012 + 0.528);
    let with = landing::sensitivity(&arm, &following, &target, 3.5 * 0.012, 0.010);
    assert!(with.largest_m < 1e-3 && with.missed == 0, "{with:?}");
    let through = FollowMotion::around(&window[7..], &Ramps::start(&window[7], plan, &limits), &stop, 0.012);
    let without = landing::sensitivity(&arm, &through, &target, 0.0, 0.010);
    assert!((without.rms_m - 0.043).abs() < 0.015 && (without.largest_m - 0.081).abs() < 0.03, "{without:?}");
}

/// The search that found it did not check bodies: at its start the wrist is in the floor.
#[test]
fn the_reference_throw_with_eight_points_begins_with_the_wrist_in_the_floor() {
    let arm = kr16();
    let Reference { window, flight, .. } = reference(&arm);
    let plan = RampPlan { shape: RampShape { blend_s: 0.0, fade_s: 0.0 }, together: 1.0 };
    let limits = Limits::of(&arm, LimitSource::ControllerModel);
    let (start, stop) = (Ramps::start(&window[0], plan, &limits), Ramps::stop(&window[7], plan, &limits));
    let motion = FollowMotion::around(&window, &start, &stop, 0.012);
    let scenes = Scenes::new();
    let mut clear = Clear::new(&arm, &scenes, Margins::default());
    let contact = clear.first_contact(&motion, &flight, 7.0 * 0.012 + 0.528);
    assert!(
        matches!(&contact, Some(Contact::Boxes { bodies, .. }) if bodies == &["floor", "wrist"]),
        "{contact:?}"
    );
}

fn near_known_throws() -> PaperOptions {
    PaperOptions {
        radius_m: GridAxis { from: 1.2, to: 1.7, count: 6 },
        height_m: GridAxis { from: 1.0, to: 1.7, count: 8 },
        beta_deg: GridAxis { from: 0.0, to: 40.0, count: 9 },
        ..PaperOptions::covering(1.8, 0.675, 0.0, 1.0)
    }
}

/// Result of the grid at 2.5 m and 0.6 m height; several tests use the same search.
fn found_at_2_5_m(criterion: Criterion, ramps: RampTiming) -> Found {
    let arm = kr16();
    let limits = Limits::of_paper(&arm);
    let setting = Setting::new(&arm, Vector3::new(2.5, 0.0, 0.6), limits);
    let options = PaperOptions { criterion, ramps, ..near_known_throws() };
    plan(&setting, &options).expect("feasible")
}

static LEAST_J2: LazyLock<Found> = LazyLock::new(|| found_at_2_5_m(Criterion::J2, RampTiming::Synchronised));
static MOST_POINTS: LazyLock<Found> =
    LazyLock::new(|| found_at_2_5_m(Criterion::Points, RampTiming::Synchronised));

fn points(found: &Found) -> usize {
    found.motion.last - found.motion.first + 1
}

#[test]
fn at_2_5_m_the_grid_follows_at_least_the_four_points_of_the_paper() {
    let arm = kr16();
    let limits = Limits::of_paper(&arm);
    let found = &*LEAST_J2;
    let motion = &found.motion;
    let points = points(found);
    assert!((4..=12).contains(&points), "{points} points");
    // Ramps: 120 deg/s² on the slowest axis, all start and stop together.
    for (from, to) in [(2, motion.first - 1), (motion.last + 1, motion.states.len() - 3)] {
        let a = (motion.states[to].qd - motion.states[from].qd) / ((to - from) as f64 * 0.012);
        assert!((a.amax().to_degrees() - 120.0).abs() < 1e-6, "{}", a.amax().to_degrees());
    }
    // The hand is across v0 at the release and does not turn while the ball is followed.
    let rotation = |k: usize| arm.ball(&arm.fk(&motion.states[k].q)).rot;
    for k in motion.first..=motion.last {
        assert!((rotation(k) - rotation(motion.first)).amax() < 1e-9);
    }
    let release = motion.first + found.release;
    let v = found.flight.velocity(motion.time_s(release));
    assert!(rotation(release).column(2).cross(&v.normalize()).norm() < 1e-9);
    assert!((found.j1 - j1(&motion.states[release].qd, &[1.0; AXES])).abs() < 1e-9);
    assert!((found.j2 - j2(found.j1, points, &[1.0; 2])).abs() < 1e-12);
    assert!(Peaks::of(&motion.commands(0.0), 0.012).use_of(&limits).iter().all(|u| *u <= 1.0));
}

#[test]
fn made_finer_around_its_best_releases_the_grid_follows_more_points() {
    let arm = kr16();
    let limits = Limits::of_paper(&arm);
    let setting = Setting::new(&arm, Vector3::new(2.5, 0.0, 0.6), limits);
    let options = PaperOptions { criterion: Criterion::Points, refinements: 5, ..near_known_throws() };
    let (grid, finer) = (points(&MOST_POINTS), points(&plan(&setting, &options).expect("feasible")));
    assert!(finer > grid && (5..=12).contains(&finer), "{grid} {finer}");
}

#[test]
fn at_1_53_m_the_grid_finds_nothing_and_says_what_refused_the_last_candidates() {
    let arm = kr16();
    let limits = Limits::of(&arm, LimitSource::ControllerModel);
    let setting = Setting::new(&arm, Vector3::new(2.5, 0.0, 1.53), limits);
    let options = near_known_throws();
    let refused = plan(&setting, &options).expect_err("no throw there");
    assert_eq!(refused.size.releases, options.size());
    let text = refused.to_string();
    assert!(text.contains("no throw found") && text.contains("refused by"), "{text}");
}

#[test]
fn criteria_are_those_of_the_paper() {
    let qd = Axes::from([1.0, -2.0, 0.0, 3.0, 0.0, 0.5]);
    assert_eq!(j1(&qd, &[1.0; AXES]), 14.25);
    assert_eq!(j1(&qd, &[2.0, 0.0, 1.0, 1.0, 1.0, 4.0]), 12.0);
    assert!((j2(3.0, 1, &[1.0, 1.0]) - (9.0 + (-2.0_f64).exp())).abs() < 1e-12);
    assert!((j2(3.0, 4, &[0.0, 1.0]) - (-32.0_f64).exp()).abs() < 1e-20);
}

#[test]
fn own_ramp_times_and_the_criterion_of_points_give_at_least_as_many_points() {
    let (least, most) = (points(&LEAST_J2), points(&MOST_POINTS));
    assert!(least <= most, "{least} {most}");
    assert!(points(&found_at_2_5_m(Criterion::Points, RampTiming::Own)) >= 6);
}

#[test]
fn a_target_elsewhere_about_a1_has_the_same_throw_turned() {
    let arm = kr16();
    let limits = Limits::of(&arm, LimitSource::ControllerModel);
    let options = PaperOptions {
        rolls: 12,
        beta_deg: GridAxis { from: 15.0, to: 30.0, count: 4 },
        ..near_known_throws()
    };
    let throw = |azimuth: f64| {
        let target = Vector3::new(2.2 * azimuth.cos(), 2.2 * azimuth.sin(), 0.6);
        plan(&Setting::new(&arm, target, limits), &options).expect("feasible")
    };
    let (ahead, turned) = (throw(0.0), throw(PI / 6.0));
    assert!((ahead.j1 - turned.j1).abs() < 1e-6, "{} {}", ahead.j1, turned.j1);
}
