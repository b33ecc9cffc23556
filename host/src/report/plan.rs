//! Summary and HTML report of a plan file.

use std::fmt::Write as _;
use std::time::Duration;

use nalgebra::{Matrix2, Vector3};

use super::chart::{Chart, Curve, Pen};
use super::page::{Answer, Cell, Page, Tile, Tone, cell};
use super::{landing as landing_chart, scene};
use operator::analysis::release::flight;
use planner::flight::landing;
use planner::plan::file::PlanFile;
use planner::verify::{self, motion};
use robot_model::RobotModel;

/// A few lines for the terminal.
#[must_use]
pub fn summary(plan: &PlanFile, took: Duration) -> String {
    let [x, y, z] = plan.target.position_m;
    let l = &plan.landing;
    let covariance = Matrix2::new(
        l.covariance_m2[0][0],
        l.covariance_m2[0][1],
        l.covariance_m2[1][0],
        l.covariance_m2[1][1],
    );
    let (a, b, _) = landing::ellipse(&covariance);
    let speed = Vector3::from(plan.release.velocity_m_s).norm();
    let [dx, dy] = l.delay_sensitivity_mm_per_ms;
    let mut out = format!(
        "throw to ({x}, {y}, {z}) m: J = {:.4} (time {:.2}, braking {:.2}, jerk {:.2})\n",
        plan.objective.value, plan.objective.time, plan.objective.braking, plan.objective.jerk
    );
    let _ = writeln!(
        out,
        "  release after {:.3} s of {:.3} s at {speed:.2} m/s, flight {:.3} s",
        plan.release_time_s, plan.end_time_s, l.flight_s
    );
    let _ = writeln!(
        out,
        "  landing 1σ {:.1} × {:.1} mm; a late release shifts it by {:.2} mm per ms",
        a * 1e3,
        b * 1e3,
        dx.hypot(dy)
    );
    if l.noise.release_nodes.is_some() {
        let _ = writeln!(
            out,
            "  release delays as measured, 1σ {:.2} ms about their mean",
            1e3 * l.noise.release_time_s
        );
    }
    if let Some(f) = &l.fingers {
        let [x, y] = f.shift_m;
        let c = f.covariance_m2;
        let (a, b, _) = landing::ellipse(&Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]));
        let _ = writeln!(
            out,
            "  with fingers that open: {:.1} ms late, landing moved by ({:.1}, {:.1}) mm, 1σ {:.1} × {:.1} mm{}",
            f.late_s * 1e3,
            x * 1e3,
            y * 1e3,
            a * 1e3,
            b * 1e3,
            f.hit_probability.map_or_else(String::new, |p| format!(", a hit {:.1} %", p * 100.0))
        );
    }
    if let Some(o) = &plan.target.opening {
        let _ = writeln!(
            out,
            "  passes the opening of {:.0} mm radius at {:.1} deg to its axis, {:.1} mm clear of the rim",
            o.radius_m * 1e3,
            o.incidence_rad.to_degrees(),
            o.rim_clearance_m * 1e3
        );
    }
    if !plan.target.course.is_empty() {
        let [x, y, z] = l.position_m;
        let _ = writeln!(out, "  meets the moving target at ({x:.3}, {y:.3}, {z:.3}) m");
    }
    if let Some(p) = l.hit_probability {
        let _ = writeln!(out, "  probability of a hit {:.1} %", p * 100.0);
    }
    let share = |v: &[f64]| v.iter().copied().fold(f64::INFINITY, f64::min) * 100.0;
    let m = &plan.margins;
    let _ = writeln!(
        out,
        "  least margin: position {:.3} rad, speed {:.0} %, acceleration {:.0} %, jerk {:.0} %{}",
        m.position_rad.iter().copied().fold(f64::INFINITY, f64::min),
        share(&m.speed_share),
        share(&m.acceleration_share),
        share(&m.jerk_share),
        m.clearance_m.map_or_else(String::new, |c| format!(", clearance {:.1} mm", c * 1e3)),
    );
    if m.ball_clearance_m < 0.0 {
        let _ = writeln!(
            out,
            "  the released ball touches the arm, up to {:.1} mm deep: this form does not forbid it, `--clean-release true` does",
            -m.ball_clearance_m * 1e3
        );
    }
    for s in &plan.currents.supply_peak {
        let _ = writeln!(out, "  supply \"{}\": peak {:.1} A of {:.0} A", s.name, s.peak_a, s.limit_a);
    }
    let _ = writeln!(
        out,
        "  {} of {} starts ended in a throw, {:.1} ms",
        plan.search.solved,
        plan.search.starts,
        took.as_secs_f64() * 1e3
    );
    if let Some(c) = plan.search.confidence.filter(|c| c.random_starts > 0) {
        let _ = writeln!(
            out,
            "  {} starts ended at this price; chance that one more random start finds a better throw: about {:.1} %, expected gain {:.2} %",
            c.at_best,
            c.better_chance * 1e2,
            c.gap_share * 1e2
        );
    }
    if !plan.search.stored.is_empty() {
        let _ = writeln!(out, "  started from {}", plan.search.stored.join(", "));
    }
    out
}

/// One self-contained HTML file.
#[must_use]
pub fn html(arm: &RobotModel, plan: &PlanFile) -> String {
    let checks = verify::check(arm, plan);
    let [x, y, z] = plan.target.position_m;
    let under = format!(
        "Plan for {} · form {} · J = {:.4} · {} of {} starts ended in a throw",
        plan.robot.name,
        format!("{:?}", plan.search.form).to_lowercase(),
        plan.objective.value,
        plan.search.solved,
        plan.search.starts
    );
    let answer = match checks.findings.iter().find(|finding| finding.enforced && !finding.ok) {
        None => Answer::new(
            "every check holds",
            Tone::Good,
            format!("{} checks by means that share nothing with the planner", checks.findings.len()),
            "run it: `cubectl throw --plan` with the plan file",
        ),
        Some(finding) => Answer::new(
            "a check fails",
            Tone::Bad,
            format!("{}: {}", finding.what, finding.worst),
            "plan the throw again, and do not run this plan",
        ),
    };
    let mut page = Page::new(&format!("Throw to ({x}, {y}, {z}) m").replace('-', "−"), &under, &answer);
    page.tiles(tiles(plan));
    page.section(
        "Hand path and flight",
        "The ball is held along the blue path, leaves at the release and follows the orange one. The ellipse is the \
         predicted spread of the landing (2σ). Drag to turn, wheel to zoom; the slider moves all pictures.",
    );
    let xy_m = plan.target.coordinates(plan.landing.position_m, plan.landing.flight_s);
    let exact = landing_chart::Mark { name: "exact throw".to_owned(), colour: 1, xy_m };
    page.scene(space(arm, plan), Some(landing_chart::chart(plan, &[exact])));
    page.part(
        "Joints",
        "Positions in their ranges, and speed, acceleration and jerk as shares of their limits.",
    );
    page.charts(joint_charts(arm, plan));
    let currents = current_charts(arm, plan);
    if !currents.is_empty() {
        page.part(
            "Currents",
            "Magnitudes by the model of the paper, eq. (9), for each motor, and their sum for each supply, eq. (8).",
        );
        page.charts(currents);
    }
    page.part(
        "Checks",
        "Made again by means that share nothing with the planner. What a plan does not claim is only reported.",
    );
    let rows: Vec<Vec<Cell>> = checks
        .findings
        .iter()
        .map(|f| {
            let (mark, tone) = match (f.ok, f.enforced) {
                (true, _) => ("holds", Tone::Good),
                (false, true) => ("FAILS", Tone::Bad),
                (false, false) => ("not claimed", Tone::Warn),
            };
            let at = f.at_s.map_or_else(String::new, |t| format!("{t:.3}\u{a0}s"));
            vec![cell(f.what.clone()), (mark.to_owned(), tone), cell(f.worst.clone()), cell(at)]
        })
        .collect();
    page.table(&["what", "", "worst", "at"], rows);
    page.finish()
}

fn tiles(plan: &PlanFile) -> Vec<Tile> {
    let least = |v: &[f64]| v.iter().copied().fold(f64::INFINITY, f64::min) * 100.0;
    let mm = |m: f64, what| Tile::new(format!("{:.1}", m * 1e3), "mm", what);
    let speed = Vector3::from(plan.release.velocity_m_s).norm();
    let c = &plan.landing.covariance_m2;
    let (a, b, _) = landing::ellipse(&Matrix2::new(c[0][0], c[0][1], c[1][0], c[1][1]));
    let [dx, dy] = plan.landing.delay_sensitivity_mm_per_ms;
    let m = &plan.margins;
    let release = format!("{:.3}", plan.release_time_s);
    let mut tiles = vec![
        Tile::new(release, "s", format!("release, of {:.3} s", plan.end_time_s)),
        Tile::new(format!("{speed:.2}"), "m/s", "speed of the ball"),
        Tile::new(format!("{:.3}", plan.landing.flight_s), "s", "time of flight"),
        Tile::new(format!("{:.1} × {:.1}", a * 1e3, b * 1e3), "mm", "predicted spread (1σ)"),
        Tile::new(format!("{:.2}", dx.hypot(dy)), "mm/ms", "shift by a late release"),
        Tile::new(format!("{:.0}", least(&m.acceleration_share)), "%", "least acceleration margin"),
    ];
    tiles.extend(m.clearance_m.map(|clearance_m| mm(clearance_m, "least clearance")));
    if let Some(o) = &plan.target.opening {
        tiles.push(mm(o.rim_clearance_m, "clear of the rim"));
        let angle = format!("{:.1}", o.incidence_rad.to_degrees());
        tiles.push(Tile::new(angle, "deg", "angle of incidence"));
    }
    let fingers = plan.landing.fingers.as_ref();
    tiles.extend(fingers.map(|f| mm(f.shift_m[0].hypot(f.shift_m[1]), "shift by fingers that open")));
    let hit = plan.landing.hit_probability;
    tiles.extend(hit.map(|p| Tile::new(format!("{:.1}", p * 100.0), "%", "probability of a hit")));
    tiles
}

fn times(plan: &PlanFile, count: u32) -> Vec<f64> {
    (0..=count).map(|i| plan.end_time_s * f64::from(i) / f64::from(count)).collect()
}

fn release_mark(plan: &PlanFile) -> Option<(f64, &'static str)> {
    Some((plan.release_time_s, "release"))
}

/// Positions in their ranges, and speed, acceleration and jerk as shares of their limits.
fn joint_charts(arm: &RobotModel, plan: &PlanFile) -> Vec<Chart> {
    let t = times(plan, 200);
    let samples: Vec<_> = t.iter().map(|t| motion::at(plan, *t)).collect();
    let chart =
        |title: &str, y_label: &str, value: &dyn Fn(&motion::Sample, usize) -> f64, limits: &[f64]| {
            let mut curves: Vec<Curve> = (0..arm.n())
                .map(|j| {
                    let points = t.iter().zip(&samples).map(|(t, s)| (*t, value(s, j))).collect();
                    Curve::line(arm.joints()[j].name.clone(), j, points)
                })
                .collect();
            curves.extend(limits.iter().map(|y| Curve::limit((0.0, plan.end_time_s), *y)));
            Chart::new(title, "time in s", y_label, curves).over_time(release_mark(plan))
        };
    let l = |j: usize| arm.joints()[j].limits;
    vec![
        chart(
            "Positions within their ranges",
            "0 lower end, 1 upper end",
            &|s, j| (s.q[j] - l(j).q_min_rad) / (l(j).q_max_rad - l(j).q_min_rad),
            &[0.0, 1.0],
        ),
        chart("Speeds", "share of the limit", &|s, j| s.qd[j] / l(j).v_max_rad_s, &[-1.0, 1.0]),
        chart("Accelerations", "share of the limit", &|s, j| s.qdd[j] / l(j).a_max_rad_s2, &[-1.0, 1.0]),
        chart("Jerks", "share of the limit", &|s, j| s.jerk[j] / l(j).j_max_rad_s3, &[-1.0, 1.0]),
    ]
}

fn current_charts(arm: &RobotModel, plan: &PlanFile) -> Vec<Chart> {
    let t = times(plan, 200);
    let holding = arm.holding_ball();
    let motor: Option<Vec<_>> = t
        .iter()
        .map(|t| {
            let s = motion::at(plan, *t);
            let moved = holding.as_ref().filter(|_| *t <= plan.release_time_s).unwrap_or(arm);
            arm.motor_currents(&s.qd, &moved.inverse_dynamics(&s.q, &s.qd, &s.qdd))
        })
        .collect();
    let Some(motor) = motor else { return Vec::new() };
    arm.supplies()
        .iter()
        .map(|supply| {
            let fed = || (0..arm.n()).filter(|j| supply.feeds[*j]);
            let sum = t.iter().zip(&motor).map(|(t, i)| (*t, fed().map(|j| i[j]).sum())).collect();
            let mut curves = vec![Curve::line("sum", arm.n(), sum)];
            curves.extend(fed().map(|j| {
                let points = t.iter().zip(&motor).map(|(t, i)| (*t, i[j])).collect();
                Curve::line(arm.joints()[j].name.clone(), j, points).drawn(Pen::Dashed)
            }));
            curves.push(Curve::limit((0.0, plan.end_time_s), supply.current_max_a));
            let title = format!("Supply \"{}\", limit {:.0} A", supply.name, supply.current_max_a);
            Chart::new(title, "time in s", "current in A", curves).over_time(release_mark(plan))
        })
        .collect()
}

/// The planned motion in space.
fn space(arm: &RobotModel, plan: &PlanFile) -> scene::Space {
    let (p0, v0) = (Vector3::from(plan.release.position_m), Vector3::from(plan.release.velocity_m_s));
    let model = flight(plan);
    let ball_after = |s: f64| model.as_ref().map_or(p0, |flight| flight.fly(&p0, &v0, s).p);
    scene::data(
        arm,
        Some(&plan.into()),
        &scene::SceneMotion {
            q_at: &|t_s| motion::at(plan, t_s).q,
            to_s: plan.end_time_s,
            flight: Some(scene::Flight {
                release_s: plan.release_time_s,
                ball_after: &ball_after,
                flight_s: plan.landing.flight_s,
            }),
            planned: None,
        },
    )
}
