//! HTML report of catching a ball.

use nalgebra::Vector3;
use operator::ball_catch::trial::{CatchOutcome, Moment, Outcome, Pair};
use planner::catch::Joints;
use planner::catch::arm::CUP_BODY;
use planner::catch::online::Decision;
use planner::catch::task::Mode;
use robot_model::Pose;
use robot_model::collision::BodyBox;

use super::chart::{Chart, Curve, Pen};
use super::page::{Answer, Page, Tone, cell};
use super::scene;

const BALL: usize = 1;
const CUP: usize = 0;
const AGAIN: &str = "throw it otherwise (`--ball`), or try another seed";
/// The picture shows so much above the last joint, m.
const HAND_M: f64 = 0.2;

/// A decision as text.
#[must_use]
pub fn decision_word(decision: &Decision) -> String {
    match decision {
        Decision::Declined(why) => format!("declined: {why}"),
        Decision::MovedClear(why) => format!("declined, moves out of the way: {why}"),
        Decision::Begun => "begun".to_owned(),
        Decision::Corrected => "corrected".to_owned(),
        Decision::Kept => "kept".to_owned(),
        Decision::NotCorrected(why) => format!("kept, no better: {why}"),
        Decision::GivenUp(why) => format!("given up: {why}"),
        Decision::Frozen => "frozen".to_owned(),
    }
}

/// Page of one catch.
#[must_use]
pub fn one(pair: &Pair, outcome: &Outcome, jerk: bool) -> String {
    let mut page = Page::new("Catching a ball", &subtitle(pair, outcome), &answer(outcome, AGAIN));
    body(&mut page, pair, outcome, jerk);
    page.finish()
}

/// What the hand does while the ball falls into its cup.
#[must_use]
pub fn mode_text(mode: Mode) -> &'static str {
    match mode {
        Mode::Matched => "moves with the ball",
        Mode::Hold => "at rest",
    }
}

/// The line below the title: arms, tracker, hand.
#[must_use]
pub fn subtitle(pair: &Pair, outcome: &Outcome) -> String {
    let court = &pair.court;
    let apart_m = (court.arms[1].x_wb.pos - court.arms[0].x_wb.pos).norm();
    let others = if court.alone { String::new() } else { format!(" · arms {apart_m:.1} m apart") };
    let hand = outcome.choice.as_ref().map_or("no catch", |choice| mode_text(choice.mode));
    format!(
        "{}{others} · tracker {:.0} Hz, {:.1} mm, {:.0} ms · hand: {hand}",
        court.arms[1].model.name(),
        1.0 / court.tracker.period.as_secs_f64(),
        court.tracker.noise_mm,
        1e3 * court.tracker.latency.as_secs_f64()
    )
}

/// Whether the ball was caught, why, and what to do; `again`: how to throw another ball.
#[must_use]
pub fn answer(outcome: &Outcome, again: &str) -> Answer {
    let missed = outcome.crossing.map(|c| {
        let (miss_mm, speed_m_s) = (c.miss_m * 1e3, c.speed_m_s);
        format!("at the mouth the ball was {miss_mm:.1} mm off the axis of the cup, at {speed_m_s:.2} m/s against it")
    });
    let unseen = if outcome.by_tracker {
        "by what the tracker shows; nobody measured how the ball crossed the mouth of the cup"
    } else {
        "the ball did not reach the mouth of the cup"
    };
    let seen = missed.unwrap_or_else(|| unseen.to_owned());
    match (outcome.caught, outcome.reported) {
        (true, _) => Answer::new("caught: the ball rests in the cup", Tone::Good, seen, again),
        (_, CatchOutcome::Declined(why)) => Answer::new("declined", Tone::Warn, why.to_string(), again),
        (_, CatchOutcome::NothingThrown) => {
            Answer::new("nothing thrown", Tone::Warn, "the tracker saw no ball fly", again)
        }
        (_, CatchOutcome::Halted) => {
            let next = "`cubectl doctor` shows the fault and what to do";
            Answer::new("the arm stopped because of a fault", Tone::Bad, seen, next)
        }
        _ => Answer::new("not caught", Tone::Bad, seen, "see Decisions for when the forecast was off"),
    }
}

/// What was seen from the release on: a ball that nobody holds begins its flight there.
fn flown(outcome: &Outcome) -> impl Iterator<Item = &Moment> {
    outcome.trace.iter().filter(|m| m.t_s >= outcome.planned_s.0)
}

/// What the last forecast before the catch said about the miss.
#[must_use]
pub fn predicted_mm(outcome: &Outcome) -> Option<f64> {
    outcome.off_m.filter(|off| off.is_finite()).map(|off| off * 1e3)
}

/// All sections of one catch.
pub fn body(page: &mut Page, pair: &Pair, outcome: &Outcome, jerk: bool) {
    let release_s = outcome.planned_s.0;
    let mut tiles = Vec::new();
    if let Some(choice) = &outcome.choice {
        tiles.push((
            format!("{:.3}", choice.t_s - release_s),
            "s",
            "catch after the release".to_owned(),
            Tone::Plain,
        ));
        tiles.push((
            format!("{:.0}", choice.used * 100.0),
            "%",
            "of the acceleration".to_owned(),
            Tone::Plain,
        ));
    }
    if let Some(predicted) = predicted_mm(outcome) {
        tiles.push((format!("{predicted:.1}"), "mm", "predicted miss".to_owned(), Tone::Plain));
    }
    if let Some(c) = outcome.crossing {
        let tone = if outcome.caught { Tone::Good } else { Tone::Bad };
        tiles.push((format!("{:.1}", c.miss_m * 1e3), "mm", "actual miss at the mouth".to_owned(), tone));
        tiles.push((format!("{:.2}", c.speed_m_s), "m/s", "ball against hand".to_owned(), Tone::Plain));
    }
    page.tiles(&tiles);
    page.section(
        "Both arms and the ball",
        "Time 0 is the planned release. The box at the hand that catches is its cup.",
    );
    page.scene(space(pair, outcome, jerk), "");
    page.part("Paths", "Ball and middle of the cup's mouth in the plane through both arms.");
    page.charts(&[side(pair, outcome, jerk), distance(pair, outcome, jerk)]);
    page.part(
        "Decisions",
        "Predicted probability of the catch and standard deviation of the ball's place across its flight, as the samples come in. Forecasts that changed nothing are not in the table.",
    );
    page.charts(&[probability(outcome), sigma(outcome)]);
    let mut log: Vec<_> = outcome.log.iter().filter(|l| !matches!(l.decision, Decision::Kept)).collect();
    // A catch that is frozen stays so.
    log.dedup_by(|b, a| [a, b].iter().all(|l| matches!(l.decision, Decision::Frozen)));
    let rows: Vec<Vec<(String, Tone)>> = log
        .into_iter()
        .map(|l| {
            vec![
                cell(format!("{:.3}", l.at_s - release_s)),
                cell(decision_word(&l.decision)),
                cell(l.catch_s.map_or_else(|| "–".to_owned(), |t| format!("{:.3}", t - release_s))),
                cell(format!("{:.2}", l.probability)),
                cell(if l.sigma_m.is_nan() { "–".to_owned() } else { format!("{:.1}", l.sigma_m * 1e3) }),
                cell(if l.off_m.is_finite() { format!("{:.1}", l.off_m * 1e3) } else { "–".to_owned() }),
                cell(l.count.judged.to_string()),
            ]
        })
        .collect();
    page.table(
        &[
            "s after release",
            "decision",
            "catch at s",
            "probability",
            "sigma mm",
            "ball off the axis mm",
            "candidates judged",
        ],
        &rows,
    );
    page.part("Joints of the catcher", "As executed.");
    page.charts(&[joints(outcome)]);
}

fn mark(outcome: &Outcome) -> Option<(f64, String)> {
    outcome.choice.as_ref().map(|choice| (choice.t_s - outcome.planned_s.0, "catch".to_owned()))
}

fn mouths(pair: &Pair, outcome: &Outcome, jerk: bool) -> Vec<Vector3<f64>> {
    let arm = pair.catcher(jerk);
    flown(outcome).map(|m| arm.mouth(&m.q[1], &Joints::zeros(6)).0).collect()
}

fn side(pair: &Pair, outcome: &Outcome, jerk: bool) -> Chart {
    let cup = mouths(pair, outcome, jerk).iter().map(|p| (p.x, p.z)).collect();
    let ball = flown(outcome).map(|m| (m.ball_m.x, m.ball_m.z)).collect();
    Chart {
        title: "From the side".to_owned(),
        x_label: "x in m".to_owned(),
        y_label: "z in m".to_owned(),
        curves: vec![
            Curve::line("ball", BALL, ball),
            Curve::line("mouth of the cup", CUP, cup).drawn(Pen::Dots),
        ],
        equal: true,
        ..Chart::default()
    }
}

fn distance(pair: &Pair, outcome: &Outcome, jerk: bool) -> Chart {
    let release_s = outcome.planned_s.0;
    let points = flown(outcome).zip(mouths(pair, outcome, jerk));
    let points = points.map(|(m, cup)| (m.t_s - release_s, (m.ball_m - cup).norm() * 100.0)).collect();
    Chart {
        title: "Ball to mouth of the cup".to_owned(),
        x_label: "time in s".to_owned(),
        y_label: "distance in cm".to_owned(),
        curves: vec![Curve::line("distance", 6, points)],
        mark: mark(outcome),
        is_time: true,
        ..Chart::default()
    }
}

fn probability(outcome: &Outcome) -> Chart {
    let release_s = outcome.planned_s.0;
    let points = outcome.log.iter().map(|l| (l.at_s - release_s, l.probability)).collect();
    Chart {
        title: "Predicted probability".to_owned(),
        x_label: "time in s".to_owned(),
        y_label: "probability".to_owned(),
        curves: vec![Curve::line("probability", 2, points).drawn(Pen::Dots)],
        // Differences in the sixth digit mean nothing.
        y_at_least: Some((0.0, 1.0)),
        mark: mark(outcome),
        is_time: true,
        ..Chart::default()
    }
}

fn sigma(outcome: &Outcome) -> Chart {
    let release_s = outcome.planned_s.0;
    let finite = outcome.log.iter().filter(|l| l.sigma_m.is_finite() && l.off_m.is_finite());
    let sigma = finite.clone().map(|l| (l.at_s - release_s, l.sigma_m * 1e3)).collect();
    let off = finite.map(|l| (l.at_s - release_s, l.off_m * 1e3)).collect();
    Chart {
        title: "Ball across its flight, at the catch".to_owned(),
        x_label: "time in s".to_owned(),
        y_label: "mm".to_owned(),
        curves: vec![
            Curve::line("standard deviation", 3, sigma),
            Curve::line("predicted miss before the decision", 4, off).drawn(Pen::Dots),
        ],
        mark: mark(outcome),
        is_time: true,
        ..Chart::default()
    }
}

fn joints(outcome: &Outcome) -> Chart {
    let release_s = outcome.planned_s.0;
    let joint = |j: usize| flown(outcome).map(|m| (m.t_s - release_s, m.q[1][j].to_degrees())).collect();
    Chart {
        title: "Joint angles".to_owned(),
        x_label: "time in s".to_owned(),
        y_label: "angle in degrees".to_owned(),
        curves: (0..6).map(|j| Curve::line(format!("joint {}", j + 1), j, joint(j))).collect(),
        mark: mark(outcome),
        is_time: true,
        ..Chart::default()
    }
}

/// The boxes of a body as they are drawn: of the cup its bottom and four walls, so that it is open.
fn opened(pair: &Pair, body: &BodyBox) -> Vec<BodyBox> {
    let half_m = body.half_m;
    let thin_m = 0.5 * pair.court.cup.shape.wall_m;
    if body.name != CUP_BODY {
        return vec![body.clone()];
    }
    let part = |at: Vector3<f64>, half_m: Vector3<f64>| {
        let x_lb = body.x_lb * Pose::translation(at.x, at.y, at.z);
        BodyBox { name: body.name.clone(), link: body.link, x_lb, half_m }
    };
    let bottom = part(Vector3::z() * (thin_m - half_m.z), Vector3::new(half_m.x, half_m.y, thin_m));
    let walls = [1.0, -1.0].into_iter().flat_map(|side| {
        [
            part(Vector3::x() * (side * (half_m.x - thin_m)), Vector3::new(thin_m, half_m.y, half_m.z)),
            part(Vector3::y() * (side * (half_m.y - thin_m)), Vector3::new(half_m.x, thin_m, half_m.z)),
        ]
    });
    std::iter::once(bottom).chain(walls).collect()
}

/// Data of the picture in space: both arms as one machine of twelve links.
fn space(pair: &Pair, outcome: &Outcome, jerk: bool) -> String {
    let catcher = pair.catcher(jerk);
    let places = [pair.court.arms[0].x_wb, pair.court.arms[1].x_wb];
    let models = [&pair.court.arms[0].model, catcher.model()];
    let release_s = outcome.planned_s.0;
    let end_s = outcome.choice.as_ref().map_or(outcome.planned_s.1, |choice| choice.t_s) + 0.5;
    let shown = flown(outcome).filter(|m| m.t_s < end_s);
    let (mut steps, mut top) = (Vec::new(), 0.8_f64);
    // An arm that is not there is not drawn.
    let first = usize::from(pair.court.alone);
    for moment in shown.step_by(2) {
        let mut links = Vec::new();
        for ((model, x_wb), q) in models.iter().zip(&places).zip(&moment.q).skip(first) {
            let placed: Vec<Pose> = model.fk(q).x_w.iter().map(|x| *x_wb * *x).collect();
            top = placed.iter().map(|x| x.pos.z + HAND_M).fold(top.max(moment.ball_m.z), f64::max);
            links.extend(placed.iter().map(scene::link));
        }
        steps.push(format!(
            "{{\"t\":{:.4},\"ball\":{},\"links\":[{}]}}",
            moment.t_s - release_s,
            scene::point(&moment.ball_m),
            links.join(",")
        ));
    }
    let mut boxes = Vec::new();
    for (arm, (model, x_wb)) in models.iter().zip(&places).skip(first).enumerate() {
        for b in model.collision().boxes().iter().flat_map(|b| opened(pair, b)) {
            // Bases stand in the world; links of the second arm come after those of the first.
            let (link, x) = if b.link == 0 { (0, *x_wb * b.x_lb) } else { (b.link + 6 * arm, b.x_lb) };
            boxes.push(scene::body(link, &x, &b.half_m));
        }
    }
    let flight: Vec<Vector3<f64>> =
        flown(outcome).filter(|m| m.t_s <= end_s - 0.5).map(|m| m.ball_m).collect();
    let cup = mouths(pair, outcome, jerk);
    let target = outcome.choice.as_ref().map_or_else(|| catcher.shoulder_m(), |choice| choice.p_m);
    let caught_s = end_s - 0.5 - release_s;
    // The feet, so that the picture shows the whole of each arm.
    let corner = |x_m: f64, y_m: f64| Vector3::new(x_m, y_m, models[0].world().floor_z_m);
    let corners = [corner(0.25, 0.25), corner(0.25, -0.25), corner(-0.25, 0.25), corner(-0.25, -0.25)];
    let feet: Vec<Vector3<f64>> =
        places.iter().flat_map(|x_wb| corners.map(|p| x_wb.transform_point(&p))).collect();
    format!(
        "{{\"floor\":{},\"top\":{top:.3},\"radius\":{},\"last\":{},\"release\":0,\"first\":{caught_s:.4},\"names\":[\"catch\",\"release\"],\"target\":{},\"hand\":{},\"planned\":null,\"flight\":{},\"ellipse\":null,\"bounds\":{},\"boxes\":[{}],\"steps\":[{}]}}",
        models[0].world().floor_z_m,
        pair.court.ball.radius_m,
        6 * (2 - first),
        scene::point(&target),
        scene::list(&cup),
        scene::list(&flight),
        scene::list(&feet),
        boxes.join(","),
        steps.join(",")
    )
}
