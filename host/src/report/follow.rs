//! Summary and HTML report of a throw that follows the flight of the ball (paper 000, figures 7 and 8).

use std::fmt::Write as _;

use nalgebra::Vector3;

use super::chart::{Chart, Curve, Pen};
use super::page::{Answer, Page, Tile, Tone, cell};
use planner::follow::landing::{Release, Sensitivity};
use planner::follow::limits::{AXES, Arm, Axes, Limits};
use planner::follow::motion::differences;
use planner::follow::plan::{FollowPlan, Form, Phase};
use planner::follow::verify::Report;

/// Jitter of the gripper for which landings are shown, in s.
pub(super) const JITTER_S: f64 = 0.010;
/// Colours of the three phases, of the parabola, and of limits.
pub(super) const PHASES: [(Phase, &str, usize); 3] = [
    (Phase::Accelerate, "accelerate", 0),
    (Phase::Follow, "follow the parabola", 2),
    (Phase::Decelerate, "decelerate", 1),
];
const PARABOLA: usize = 6;

/// The throw without following and the plan, each opened as `cubectl throw` opens it for axes that lag by a first order of `lag_s`.
pub(super) fn releases(arm: &Arm, plan: &FollowPlan, limits: &Limits, lag_s: f64) -> [Release; 2] {
    let through = plan.without_following(limits).opened_for(arm, lag_s, JITTER_S);
    [through.release(lag_s), plan.release(lag_s)]
}

/// Landing errors without and with following.
pub(super) fn sensitivities(arm: &Arm, releases: &[Release; 2]) -> [Sensitivity; 2] {
    [0, 1].map(|k| releases[k].sensitivity(arm, JITTER_S))
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(arm: &Arm, plan: &FollowPlan, limits: &Limits, verdict: &Report) -> String {
    let [x, y, z] = plan.target_m;
    let [v, a, j] = plan.used.map(|u| u * 100.0);
    let [without, with] = sensitivities(arm, &releases(arm, plan, limits, plan.lag_s));
    let whole_s = plan.steps.last().map_or(0.0, |s| s.t_s);
    let mut out = format!(
        "throw to ({x}, {y}, {z}) m: {} points of the flight followed, {:.0} ms\n",
        plan.followed_points,
        (plan.followed_points - 1) as f64 * plan.period_s * 1e3
    );
    let _ = writeln!(
        out,
        "  release after {:.3} s of {whole_s:.3} s at {:.2} m/s and {:.1} deg; j1 {:.2} rad2/s2, j2 {:.3}",
        plan.release_time_s, plan.flight.speed_release_m_s, plan.flight.beta_release_deg, plan.j1, plan.j2
    );
    let _ = writeln!(
        out,
        "  commands use {v:.0} % of the speeds, {a:.0} % of the accelerations, {j:.0} % of the jerk; largest leap {:.0} deg/s2 on axis {}",
        plan.leap.size_deg_s2, plan.leap.axis
    );
    let _ = writeln!(
        out,
        "  opening {:.0} ms early or late: landing {:.1} mm rms off; without following {:.1} mm",
        JITTER_S * 1e3,
        with.rms_m * 1e3,
        without.rms_m * 1e3
    );
    if plan.lag_s > 0.0 {
        let _ = writeln!(
            out,
            "  through a lag of {:.0} ms: landing within {:.1} mm of the target over the window",
            plan.lag_s * 1e3,
            verdict.executed_landing_m * 1e3
        );
    }
    let _ = writeln!(
        out,
        "  nearest bodies {:.1} mm apart, ball {:.1} mm from arm and hand after the window; verified from the set points",
        verdict.nearest_m * 1e3,
        verdict.ball_m * 1e3
    );
    if plan.form == Form::Paper && plan.followed_points == 1 {
        out.push_str(
            "  a single point: the smallest j2 may be there, with weights of one; --criterion points looks for the most points\n",
        );
    }
    let counts = &plan.search.size.counts;
    let _ = writeln!(
        out,
        "  {} releases, {} postures tested in {:.1} s",
        plan.search.size.releases,
        counts.total(),
        plan.search.time_s
    );
    out
}

#[must_use]
pub fn html(arm: &Arm, plan: &FollowPlan, limits: &Limits, verdict: &Report) -> String {
    let [x, y, z] = plan.target_m;
    let under =
        format!("{} to ({x}, {y}, {z}) m, set points every {:.0} ms", plan.robot.name, plan.period_s * 1e3);
    let answer = match verdict.findings.first() {
        None => Answer::new(
            "verified",
            Tone::Good,
            format!(
                "landing within {:.1} mm of the target over the window; nearest bodies {:.1} mm apart",
                verdict.landing_m.max(verdict.executed_landing_m) * 1e3,
                verdict.nearest_m * 1e3
            ),
            "run it: `cubectl throw --plan` with the plan file",
        ),
        Some(finding) => Answer::new(
            "refused",
            Tone::Bad,
            finding.to_string(),
            "plan the throw again, and do not run this plan",
        ),
    };
    let mut page = Page::new("Throw that follows the flight", &under, &answer);
    let releases = releases(arm, plan, limits, plan.lag_s);
    let [without, with] = sensitivities(arm, &releases);
    page.tiles(vec![
        Tile::new(plan.followed_points, "points", "of the flight followed"),
        Tile::new(format!("{:.2}", plan.flight.speed_release_m_s), "m/s", "speed at the release"),
        Tile::new(format!("{:.0}", plan.leap.size_deg_s2), "deg/s²", "largest leap of the acceleration"),
        Tile::new(format!("{:.1}", with.rms_m * 1e3), "mm", "landing rms, opening ±10 ms"),
        Tile::new(format!("{:.1}", without.rms_m * 1e3), "mm", "the same without following"),
    ]);
    page.section(
        "Path in space and opening time",
        "Centre of the ball in the three phases, and its flight (paper, figure 7). Landing error: if the gripper opens earlier or later \
         than planned, with and without following.",
    );
    let mut charts = path_charts(plan, &path(arm, plan));
    charts.push(opening_chart(arm, plan, &releases));
    page.charts(charts);
    page.part(
        "Set points per axis",
        "Angle, speed and acceleration as commanded (paper, figure 8); speed and acceleration by finite differences.",
    );
    page.charts((0..AXES).flat_map(|axis| axis_charts(plan, limits, axis)));
    page.detail("Search", "Postures of the tested releases by the test that ended them.");
    let counts = &plan.search.size.counts;
    let ended = planner::follow::found::Stage::ALL.into_iter().filter(|stage| counts.of(*stage) > 0);
    let rows = ended.map(|stage| vec![cell(stage.reason()), cell(counts.of(stage))]);
    page.table(&["ended by", "postures"], rows.collect());
    page.finish()
}

/// Points of the steps of one phase; the first of the next phase belongs to it, so that the curve has no gap.
fn of_phase<T>(plan: &FollowPlan, phase: Phase, point: impl Fn(usize) -> T) -> Vec<T> {
    let steps = &plan.steps;
    (0..steps.len())
        .filter(|k| steps[*k].phase == phase || (*k > 0 && steps[*k - 1].phase == phase))
        .map(point)
        .collect()
}

/// Centre of the held ball at each step.
pub(super) fn path(arm: &Arm, plan: &FollowPlan) -> Vec<Vector3<f64>> {
    plan.steps.iter().map(|s| arm.ball(&arm.fk(&Axes::from(s.q_rad))).pos).collect()
}

/// From the side and from above; `ball`: its path().
pub(super) fn path_charts(plan: &FollowPlan, ball: &[Vector3<f64>]) -> Vec<Chart> {
    let flight = plan.parabola();
    let end_s = flight.time_to(&plan.aim());
    let flown: Vec<Vector3<f64>> = (0..=60).map(|k| flight.position(f64::from(k) / 60.0 * end_s)).collect();
    let view = |title: &str, labels: [&str; 2], of: fn(&Vector3<f64>) -> (f64, f64)| {
        // The flight first: it lies under the points that follow it.
        let mut curves =
            vec![Curve::line("flight", PARABOLA, flown.iter().map(of).collect()).drawn(Pen::Dashed)];
        curves.extend(PHASES.into_iter().map(|(phase, name, colour)| {
            let points = of_phase(plan, phase, |k| of(&ball[k]));
            Curve::line(name, colour, points).drawn(if phase == Phase::Follow {
                Pen::Dots
            } else {
                Pen::Line
            })
        }));
        Chart::new(title, labels[0], labels[1], curves).equal()
    };
    vec![
        view("From the side", ["x in m", "z in m"], |p| (p.x, p.z)),
        view("From above", ["x in m", "y in m"], |p| (p.x, p.y)),
    ]
}

pub(super) fn opening_chart(arm: &Arm, plan: &FollowPlan, [through, following]: &[Release; 2]) -> Chart {
    let window_s = (plan.window[1] - plan.window[0]) as f64 * plan.period_s;
    // The whole window and a part of the ramps, on whichever side of its middle the gripper opens.
    let half_s = (0.7 * window_s).max(plan.opening_s() + 0.2 * window_s).max(0.03);
    let offsets = (0..=120).map(|k| half_s * (f64::from(k) / 60.0 - 1.0));
    let curve = |name: &str, colour, error: &dyn Fn(f64) -> Option<f64>| {
        let points = offsets.clone().filter_map(|t| Some((t * 1e3, error(t)? * 1e3)));
        // Beyond 300 mm the size of the miss is of no interest.
        Curve::line(name, colour, points.filter(|p| p.1 < 300.0).collect())
    };
    let curves = vec![
        curve("with following", 2, &|late_s| following.error_m(arm, late_s)),
        curve("ramps through the release", 1, &|late_s| through.error_m(arm, late_s)),
    ];
    let chart = Chart::new("Landing error", "opening after the planned instant in ms", "miss in mm", curves);
    Chart { mark: Some((0.0, "planned".to_owned())), ..chart }
}

fn axis_charts(plan: &FollowPlan, limits: &Limits, axis: usize) -> Vec<Chart> {
    let commands: Vec<Axes> = plan.steps.iter().map(|s| Axes::from(s.command_rad)).collect();
    let rates: Vec<[Axes; 3]> =
        (0..commands.len()).map(|k| differences(&commands, k as isize, plan.period_s)).collect();
    let whole = (0.0, plan.steps.last().map_or(0.0, |s| s.t_s));
    let chart = |title: String, unit: &str, value: &dyn Fn(usize) -> f64, limit: Option<f64>| {
        let mut curves: Vec<Curve> = PHASES
            .into_iter()
            .map(|(phase, name, colour)| {
                let points = of_phase(plan, phase, |k| (plan.steps[k].t_s, value(k).to_degrees()));
                Curve::line(name, colour, points)
            })
            .collect();
        // A limit far beyond the curve would only flatten it.
        let largest = curves.iter().flat_map(|c| &c.points).map(|p| p.1.abs()).fold(0.0, f64::max);
        if let Some(limit) = limit.map(f64::to_degrees).filter(|l| *l < 1.6 * largest) {
            curves.extend([Curve::limit(whole, limit), Curve::limit(whole, -limit)]);
        }
        Chart::new(title, "time of the plan in s", unit, curves)
            .over_time(Some((plan.release_time_s, "release")))
    };
    let name = |what: &str| format!("Axis {}: {what}", axis + 1);
    vec![
        chart(name("angle"), "deg", &|k| commands[k][axis], None),
        chart(name("speed"), "deg/s", &|k| rates[k][0][axis], Some(limits.v_max_rad_s[axis])),
        chart(name("acceleration"), "deg/s²", &|k| rates[k][1][axis], Some(limits.a_max_rad_s2[axis])),
    ]
}
