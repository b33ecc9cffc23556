//! HTML report of catching a disc: figures 4 to 8 of paper 001, and the same within the joint limits.

use nalgebra::Vector3;
use operator::disc::Judged;
use planner::disc::Joints;
use planner::disc::arm::DiscArm;
use planner::disc::flight::Path;
use planner::disc::intercept::Plan;
use planner::disc::paper::Run;
use planner::disc::witness::Verdict;

use super::chart::{Chart, Curve, Pen};
use super::page::{Answer, Cell, Page, Tile, Tone, cell, number};
use super::scene::{self, Space, Step};

/// A planned catch and what the witness saw of it.
#[derive(Clone, Copy)]
pub struct Caught<'a> {
    pub plan: &'a Plan,
    /// The witness.
    pub verdict: &'a Verdict,
    /// The same as a controller and its drives did it.
    pub executed: Option<&'a Judged>,
}

/// One motion of the arm against the disc, for charts.
struct Shown<'a> {
    name: &'a str,
    /// Time and joint angles.
    points: Vec<(f64, Joints)>,
    caught_s: Option<f64>,
}

/// Colour of the disc's path, and of the gripper's.
const DISC: usize = 1;
const GRIPPER: usize = 0;

/// What the gripper has at the end of the paper's rule.
#[must_use]
pub fn witness_of_rule(run: &Run, verdict: &Verdict) -> String {
    if let Some((_, seen)) = verdict.caught {
        return format!("the tip is {:.1} mm from the disc's axis of symmetry", seen.tip_to_axis_m * 1e3);
    }
    let short = run.steps.last().filter(|s| !s.reached).map(|s| {
        format!("not caught: the terminal point is {:.1} cm short of where it should be", s.short_m() * 100.0)
    });
    let touch = verdict
        .touched
        .as_ref()
        .map(|t| format!("the disc touches the {} at step {:.0}", t.body, t.t_s * 100.0));
    let parts: Vec<String> = short.into_iter().chain(touch).collect();
    if parts.is_empty() { "not caught".to_owned() } else { parts.join("; ") }
}

/// One self-contained HTML file.
#[must_use]
pub fn html(
    arm: &DiscArm,
    path: &Path,
    rule: Option<(&Run, &Verdict)>,
    plan: Option<Caught<'_>>,
    declined: Option<String>,
) -> String {
    let executed = plan.and_then(|caught| caught.executed);
    let verdict = match (&plan, &declined, rule) {
        _ if executed.is_some_and(|run| run.executed.reported.is_err()) => {
            ("stopped by the controller", Tone::Bad)
        }
        _ if executed.is_some_and(|run| run.verdict.caught.is_none()) => {
            ("run by the controller, not caught", Tone::Bad)
        }
        _ if executed.is_some() => ("caught on the controller", Tone::Good),
        (Some(_), _, _) => ("caught within the joint limits", Tone::Good),
        (None, Some(_), _) => ("declined within the joint limits", Tone::Warn),
        (None, None, Some((_, seen))) if seen.caught.is_some() => ("captured, no joint limits", Tone::Good),
        _ => ("the rule ends, the gripper does not have the disc", Tone::Warn),
    };
    let start = path.at(0.0);
    let numbers = |v: &Vector3<f64>| format!("({:.2}, {:.2}, {:.2})", v.x, v.y, v.z).replace('-', "−");
    let under = format!(
        "{} · disc from {} m with {} m/s",
        arm.model.name(),
        numbers(&start.p_m),
        numbers(&start.v_m_s)
    );
    let rule_says =
        rule.map(|(run, seen)| format!("by the rule of the paper {}", witness_of_rule(run, seen)));
    let limits_say = declined.map(|why| format!("no catch within the joint limits: {why}"));
    let why: Vec<String> = limits_say.into_iter().chain(rule_says).collect();
    let why = if why.is_empty() { "the plan keeps every joint limit".to_owned() } else { why.join("; ") };
    let next = match (executed, verdict.1) {
        (Some(_), Tone::Good) | (_, Tone::Bad) => "see the tracking errors on the controller",
        (_, Tone::Good) => "run it on a controller: `cubectl catch --on-controller`",
        _ => "let the disc come slower or nearer: `--start`, `--velocity`",
    };
    let answer = Answer::new(verdict.0, verdict.1, why, next);
    let mut page = Page::new("Catching a disc", &under, &answer);
    page.tiles(tiles(rule, plan.as_ref()));
    let rule_shown = rule.map(|(run, seen)| Shown {
        name: "rule of the paper",
        points: run.steps.iter().map(|s| (s.t_s, s.q)).collect(),
        caught_s: seen.caught.map(|c| c.1.t_s),
    });
    let plan_shown = plan.map(|c| Shown {
        name: "within the joint limits",
        points: (0..=(c.plan.motion.end_s() / 0.004) as u32)
            .map(|k| (f64::from(k) * 0.004, c.plan.motion.q(f64::from(k) * 0.004)))
            .collect(),
        caught_s: c.verdict.caught.map(|c| c.1.t_s),
    });
    let executed_shown = executed.map(|run| Shown {
        name: "joints as the drives moved them",
        points: run.executed.moved.iter().step_by(4).map(|moved| (moved.t_s, moved.q)).collect(),
        caught_s: run.verdict.caught.as_ref().map(|c| c.1.t_s),
    });
    let shown: Vec<&Shown<'_>> = rule_shown.iter().chain(&plan_shown).chain(&executed_shown).collect();
    if let Some(last) = shown.last() {
        page.section(
            "Arm and disc",
            &format!(
                "Motion: {}. Orange: the disc's path; blue: the tip of the gripper. The gripper is drawn as the \
                 box of the robot file; its fingers are the upper and lower part of it. After the catch the disc \
                 stays in the hand; whether it does so in fact depends on the gripper's force.",
                last.name
            ),
        );
        page.scene(space(arm, path, last), None);
    }
    for motion in &shown {
        page.part(
            &format!("Paths and joints: {}", motion.name),
            "Paths of the disc's centre and of the terminal point (figures 4 and 7), joint angles (figure 5), distance \
             of both in the horizontal plane (figure 8).",
        );
        let mut charts = paths(arm, path, motion);
        charts.extend([angles(arm, motion), distance(arm, path, motion)]);
        page.charts(charts);
    }
    page.part("Joint speeds", "Demanded against allowed. The rule of the paper knows no joint limits.");
    page.charts(shown.iter().map(|motion| speeds(arm, motion)));
    speed_table(&mut page, arm, rule, plan.as_ref());
    if let (Some(caught), Some(run)) = (&plan, executed) {
        page.part(
            "On the controller",
            "Angle of the plan minus angle of the plant. The plan was uploaded as a trajectory and begun at the release of the disc.",
        );
        page.charts([tracking_errors(arm, caught.plan, run)]);
    }
    page.finish()
}

fn tiles(rule: Option<(&Run, &Verdict)>, plan: Option<&Caught<'_>>) -> Vec<Tile> {
    let mut out = Vec::new();
    if let Some((run, seen)) = rule {
        let step = |s: Option<u32>| s.map_or_else(|| "–".to_owned(), |s| s.to_string());
        let (what, tone) = match seen.caught {
            Some(_) => ("captured at step", Tone::Good),
            None => ("step of capture by the rule; refuted", Tone::Warn),
        };
        let demanded = run.speed_demanded_rad_s().max();
        out.push(Tile::new(step(run.in_reach), "", "step in reach"));
        out.push(Tile::new(step(run.captured), "", what).toned(tone));
        out.push(Tile::new(format!("{demanded:.1}"), "rad/s", "demanded by the rule"));
    }
    if let Some(Caught { plan, verdict, executed }) = plan {
        if let Some(run) = executed {
            let tip_mm = run.tracking.tip_m.1 * 1e3;
            out.push(Tile::new(format!("{tip_mm:.1}"), "mm", "tip off the plan at the catch"));
        }
        if let Some((_, seen)) = verdict.caught {
            let caught = Tile::new(format!("{:.3}", seen.t_s), "s", "caught within limits");
            out.push(caught.toned(Tone::Good));
            out.push(Tile::new(format!("{:.1}", seen.depth_m * 100.0), "cm", "tip inside the rim"));
        }
        let used = format!("{:.0} / {:.0}", plan.used.0 * 100.0, plan.used.1 * 100.0);
        out.push(Tile::new(used, "%", "of speed / acceleration"));
        let waits_ms = (plan.motion.waits_s.1 - plan.motion.waits_s.0) * 1e3;
        out.push(Tile::new(format!("{waits_ms:.0}"), "ms", "waits before the run-up"));
    }
    out
}

fn paths(arm: &DiscArm, path: &Path, motion: &Shown<'_>) -> Vec<Chart> {
    let end_s = motion.caught_s.or(motion.points.last().map(|p| p.0)).unwrap_or(0.0);
    let disc: Vec<Vector3<f64>> = (0..=100).map(|k| path.at(end_s * f64::from(k) / 100.0).p_m).collect();
    let until = motion.points.iter().filter(|p| p.0 <= end_s + 1e-9);
    let hand: Vec<Vector3<f64>> = until.map(|(_, q)| arm.terminal_point(q)).collect();
    type View = (&'static str, &'static str, &'static str, fn(&Vector3<f64>) -> (f64, f64));
    let views: [View; 2] = [
        ("From above", "x in m", "y in m", |p| (p.x, p.y)),
        ("From the side", "y in m", "z in m", |p| (p.y, p.z)),
    ];
    views
        .into_iter()
        .map(|(title, x_label, y_label, pick)| {
            let hand = Curve::line("terminal point", GRIPPER, hand.iter().map(pick).collect());
            let disc = Curve::line("disc", DISC, disc.iter().map(pick).collect());
            Chart::new(title, x_label, y_label, vec![disc, hand.drawn(Pen::Dots)]).equal()
        })
        .collect()
}

/// Joint names with a value per point.
fn joint_curves(arm: &DiscArm, points: &[(f64, Joints)]) -> Vec<Curve> {
    let joint = |j: usize| points.iter().map(|(t, v)| (*t, v[j])).collect();
    (0..4).map(|j| Curve::line(arm.model.joints()[j].name.clone(), j, joint(j))).collect()
}

fn tracking_errors(arm: &DiscArm, plan: &Plan, run: &Judged) -> Chart {
    let errors: Vec<(f64, Joints)> = run
        .executed
        .moved
        .iter()
        .map(|moved| (moved.t_s, (plan.motion.q(moved.t_s) - moved.q) * 1e3))
        .collect();
    let mark = run.verdict.caught.as_ref().map(|c| (c.1.t_s, "caught"));
    Chart::new("Tracking error", "time in s", "error in mrad", joint_curves(arm, &errors)).over_time(mark)
}

fn mark(motion: &Shown<'_>) -> Option<(f64, &'static str)> {
    motion.caught_s.map(|t| (t, "caught"))
}

fn angles(arm: &DiscArm, motion: &Shown<'_>) -> Chart {
    let degrees: Vec<_> = motion.points.iter().map(|(t, q)| (*t, q.map(f64::to_degrees))).collect();
    Chart::new("Joint angles", "time in s", "angle in degrees", joint_curves(arm, &degrees))
        .over_time(mark(motion))
}

fn distance(arm: &DiscArm, path: &Path, motion: &Shown<'_>) -> Chart {
    let end_s = motion.caught_s.unwrap_or(f64::INFINITY);
    let until = motion.points.iter().filter(|p| p.0 <= end_s + 1e-9);
    let points: Vec<(f64, f64)> =
        until.map(|(t, q)| (*t, (path.at(*t).p_m - arm.terminal_point(q)).xy().norm() * 100.0)).collect();
    let last = points.last().map_or(0.0, |p| p.0);
    let size = &arm.size;
    let curves = vec![
        Curve::line("distance", 6, points),
        Curve::limit((0.0, last), size.touch_m() * 100.0),
        Curve::limit((0.0, last), size.disc_radius_m * 100.0),
    ];
    let title = "Terminal point to disc, horizontal";
    Chart::new(title, "time in s", "distance in cm", curves).over_time(mark(motion))
}

fn speeds(arm: &DiscArm, motion: &Shown<'_>) -> Chart {
    let points: Vec<(f64, Joints)> = motion
        .points
        .windows(2)
        .map(|p| (0.5 * (p[0].0 + p[1].0), (p[1].1 - p[0].1) / (p[1].0 - p[0].0)))
        .collect();
    let mut curves = joint_curves(arm, &points);
    let allowed = arm.model.limit(|l| l.v_max_rad_s).max();
    let span = (0.0, points.last().map_or(1.0, |p| p.0));
    curves.extend([Curve::limit(span, allowed), Curve::limit(span, -allowed)]);
    let title = format!("Joint speeds: {}", motion.name);
    Chart::new(title, "time in s", "speed in rad/s", curves).over_time(mark(motion))
}

fn speed_table(page: &mut Page, arm: &DiscArm, rule: Option<(&Run, &Verdict)>, plan: Option<&Caught<'_>>) {
    let demanded = rule.map(|(run, _)| run.speed_demanded_rad_s());
    let rows = arm.model.joints().iter().enumerate().map(|(j, joint)| {
        let allowed = joint.limits.v_max_rad_s;
        let toned = |speed: Option<f64>| -> Cell {
            (number(speed, 2).0, speed.map_or(Tone::Plain, |v| Tone::of(v <= allowed)))
        };
        let plan = plan.map(|c| c.verdict.speed_rad_s[j]);
        vec![cell(&joint.name), number(allowed, 2), toned(demanded.map(|d| d[j])), toned(plan)]
    });
    let head = ["joint", "allowed rad/s", "rule of the paper rad/s", "plan rad/s"];
    page.table(&head, rows.collect());
}

/// Data of the picture in space.
fn space(arm: &DiscArm, path: &Path, motion: &Shown<'_>) -> Space {
    let model = &arm.model;
    let held = motion.caught_s.map(|caught_s| {
        let q = motion.points.iter().find(|p| p.0 >= caught_s - 1e-9).map_or_else(Joints::zeros, |p| p.1);
        let (hand, disc) = (model.ee_at(&q.into()), path.at(caught_s));
        (caught_s, hand.inverse_transform_point(&disc.p_m), hand.rot.tr_mul(&disc.normal))
    });
    let mut steps = Vec::new();
    let mut tips = Vec::new();
    let mut top = arm.size.base_m;
    for (t_s, q) in &motion.points {
        let frames = model.fk(&(*q).into());
        let hand = model.ee(&frames);
        tips.push(hand.transform_point(&Vector3::new(arm.size.gripper_m, 0.0, 0.0)));
        let disc = path.at(*t_s);
        let (center, normal) = match &held {
            Some((since, center, normal)) if t_s >= since => {
                (hand.transform_point(center), hand.rot * normal)
            }
            _ => (disc.p_m, disc.normal),
        };
        top = arm.chain(q).iter().map(|p| p.z).fold(top, f64::max);
        steps.push(Step {
            t: *t_s,
            ball: Some(scene::point(&center)),
            normal: Some(scene::point(&normal)),
            links: frames.x_w.iter().map(scene::link).collect(),
        });
    }
    let end_s = motion.points.last().map_or(0.0, |p| p.0);
    let flight: Vec<Vector3<f64>> = (0..=60).map(|k| path.at(end_s * f64::from(k) / 60.0).p_m).collect();
    let meets_s = motion.caught_s.unwrap_or(end_s);
    Space {
        floor: model.world().floor_z_m,
        top,
        radius: arm.size.disc_radius_m,
        last: 4,
        release: Some(0.0),
        first: Some(meets_s),
        names: Some([if motion.caught_s.is_some() { "caught" } else { "end of the rule" }, "start"]),
        target: Some(scene::point(&path.at(meets_s).p_m)),
        hand: scene::list(&tips),
        flight: scene::list(&flight),
        boxes: scene::bodies(model).collect(),
        steps,
        ..Space::default()
    }
}
