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
use super::page::{Answer, Page, Tile, Tone, cell, number};
use super::scene::{self, Space, Step};

const BALL: usize = 1;
const CUP: usize = 0;
const AGAIN: &str = "throw it otherwise (`--ball`), or try another seed";
/// The picture shows so much above the last joint, m.
const HAND_M: f64 = 0.2;

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
    let again = if outcome.by_tracker { "throw it again" } else { AGAIN };
    let mut page = Page::new("Catching a ball", &subtitle(pair, outcome), &answer(outcome, again));
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
    let cell = &pair.cell;
    let apart_m = (cell.arms[1].x_wb.pos - cell.arms[0].x_wb.pos).norm();
    let others = if cell.alone { String::new() } else { format!(" · arms {apart_m:.1} m apart") };
    let hand = outcome.choice.as_ref().map_or("no catch", |choice| mode_text(choice.mode));
    format!(
        "{}{others} · tracker {:.0} Hz, {:.1} mm, {:.0} ms · hand: {hand}",
        cell.arms[1].model.name(),
        1.0 / cell.tracker.period.as_secs_f64(),
        cell.tracker.noise_mm,
        1e3 * cell.tracker.latency.as_secs_f64()
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
        tiles.push(Tile::new(format!("{:.3}", choice.t_s - release_s), "s", "catch after the release"));
        tiles.push(Tile::new(format!("{:.0}", choice.used * 100.0), "%", "of the acceleration"));
    }
    let predicted = predicted_mm(outcome);
    tiles.extend(predicted.map(|mm| Tile::new(format!("{mm:.1}"), "mm", "predicted miss")));
    if let Some(c) = outcome.crossing {
        let miss = Tile::new(format!("{:.1}", c.miss_m * 1e3), "mm", "actual miss at the mouth");
        tiles.push(miss.toned(Tone::of(outcome.caught)));
        tiles.push(Tile::new(format!("{:.2}", c.speed_m_s), "m/s", "ball against hand"));
    }
    page.tiles(tiles);
    let zero = match (outcome.by_tracker, pair.cell.alone) {
        (true, true) => "Time 0 is when the tracker saw the ball fly first.",
        _ => "Time 0 is the planned release.",
    };
    let (arms, plane) = if pair.cell.alone {
        ("The arm and the ball", "Ball and middle of the cup's mouth, seen along y.")
    } else {
        ("Both arms and the ball", "Ball and middle of the cup's mouth in the plane through both arms.")
    };
    page.section(arms, &format!("{zero} The box at the hand that catches is its cup."));
    page.scene(space(pair, outcome, jerk), None);
    page.part("Paths", plane);
    page.charts([side(pair, outcome, jerk), distance(pair, outcome, jerk)]);
    page.part(
        "Decisions",
        "Predicted probability of the catch and standard deviation of the ball's place across its flight, as the samples come in. Forecasts that changed nothing are not in the table.",
    );
    page.charts([probability(outcome), sigma(outcome)]);
    let mut log: Vec<_> = outcome.log.iter().filter(|l| !matches!(l.decision, Decision::Kept)).collect();
    // A catch that is frozen stays so.
    log.dedup_by(|b, a| [a, b].iter().all(|l| matches!(l.decision, Decision::Frozen)));
    let rows = log.into_iter().map(|l| {
        let mm = |m: f64| number(m.is_finite().then_some(m * 1e3), 1);
        vec![
            number(l.at_s - release_s, 3),
            cell(decision_word(&l.decision)),
            number(l.catch_s.map(|t| t - release_s), 3),
            number(l.probability, 2),
            mm(l.sigma_m),
            mm(l.off_m),
            cell(l.count.judged),
        ]
    });
    let head = [
        "s after release",
        "decision",
        "catch at s",
        "probability",
        "sigma mm",
        "ball off the axis mm",
        "candidates judged",
    ];
    page.table(&head, rows.collect());
    page.part("Joints of the catcher", "As executed.");
    page.charts([joints(outcome)]);
}

fn mark(outcome: &Outcome) -> Option<(f64, &'static str)> {
    outcome.choice.as_ref().map(|choice| (choice.t_s - outcome.planned_s.0, "catch"))
}

fn mouths(pair: &Pair, outcome: &Outcome, jerk: bool) -> Vec<Vector3<f64>> {
    let arm = pair.catcher(jerk);
    flown(outcome).map(|m| arm.mouth(&m.q[1], &Joints::zeros(6)).0).collect()
}

fn side(pair: &Pair, outcome: &Outcome, jerk: bool) -> Chart {
    let cup = mouths(pair, outcome, jerk).iter().map(|p| (p.x, p.z)).collect();
    let ball = flown(outcome).map(|m| (m.ball_m.x, m.ball_m.z)).collect();
    let cup = Curve::line("mouth of the cup", CUP, cup).drawn(Pen::Dots);
    Chart::new("From the side", "x in m", "z in m", vec![Curve::line("ball", BALL, ball), cup]).equal()
}

fn distance(pair: &Pair, outcome: &Outcome, jerk: bool) -> Chart {
    let release_s = outcome.planned_s.0;
    let points = flown(outcome).zip(mouths(pair, outcome, jerk));
    let points = points.map(|(m, cup)| (m.t_s - release_s, (m.ball_m - cup).norm() * 100.0)).collect();
    let curve = Curve::line("distance", 6, points);
    Chart::new("Ball to mouth of the cup", "time in s", "distance in cm", vec![curve])
        .over_time(mark(outcome))
}

fn probability(outcome: &Outcome) -> Chart {
    let release_s = outcome.planned_s.0;
    let points = outcome.log.iter().map(|l| (l.at_s - release_s, l.probability)).collect();
    let curve = Curve::line("probability", 2, points).drawn(Pen::Dots);
    let chart = Chart::new("Predicted probability", "time in s", "probability", vec![curve]);
    // Differences in the sixth digit mean nothing.
    Chart { y_at_least: Some((0.0, 1.0)), ..chart.over_time(mark(outcome)) }
}

fn sigma(outcome: &Outcome) -> Chart {
    let release_s = outcome.planned_s.0;
    let finite = outcome.log.iter().filter(|l| l.sigma_m.is_finite() && l.off_m.is_finite());
    let sigma = finite.clone().map(|l| (l.at_s - release_s, l.sigma_m * 1e3)).collect();
    let off = finite.map(|l| (l.at_s - release_s, l.off_m * 1e3)).collect();
    let curves = vec![
        Curve::line("standard deviation", 3, sigma),
        Curve::line("predicted miss before the decision", 4, off).drawn(Pen::Dots),
    ];
    Chart::new("Ball across its flight, at the catch", "time in s", "mm", curves).over_time(mark(outcome))
}

fn joints(outcome: &Outcome) -> Chart {
    let release_s = outcome.planned_s.0;
    let joint = |j: usize| flown(outcome).map(|m| (m.t_s - release_s, m.q[1][j].to_degrees())).collect();
    let curves = (0..6).map(|j| Curve::line(format!("joint {}", j + 1), j, joint(j))).collect();
    Chart::new("Joint angles", "time in s", "angle in degrees", curves).over_time(mark(outcome))
}

/// The boxes of a body as they are drawn: of the cup its bottom and four walls, so that it is open.
fn opened(pair: &Pair, body: &BodyBox) -> Vec<BodyBox> {
    let half_m = body.half_m;
    let thin_m = 0.5 * pair.cell.cup.shape.wall_m;
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
fn space(pair: &Pair, outcome: &Outcome, jerk: bool) -> Space {
    let catcher = pair.catcher(jerk);
    let places = [pair.cell.arms[0].x_wb, pair.cell.arms[1].x_wb];
    let models = [&pair.cell.arms[0].model, catcher.model()];
    let release_s = outcome.planned_s.0;
    let end_s = outcome.choice.as_ref().map_or(outcome.planned_s.1, |choice| choice.t_s) + 0.5;
    let shown = flown(outcome).filter(|m| m.t_s < end_s);
    let (mut steps, mut top) = (Vec::new(), 0.8_f64);
    // An arm that is not there is not drawn.
    let first = usize::from(pair.cell.alone);
    for moment in shown.step_by(2) {
        let mut links = Vec::new();
        for ((model, x_wb), q) in models.iter().zip(&places).zip(&moment.q).skip(first) {
            let placed: Vec<Pose> = model.fk(q).x_w.iter().map(|x| *x_wb * *x).collect();
            top = placed.iter().map(|x| x.pos.z + HAND_M).fold(top.max(moment.ball_m.z), f64::max);
            links.extend(placed.iter().map(scene::link));
        }
        let (t, ball) = (moment.t_s - release_s, Some(scene::point(&moment.ball_m)));
        steps.push(Step { t, ball, normal: None, links });
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
    Space {
        floor: models[0].world().floor_z_m,
        top,
        radius: pair.cell.ball.radius_m,
        last: 6 * (2 - first),
        release: Some(0.0),
        first: Some(caught_s),
        names: Some(["catch", "release"]),
        target: Some(scene::point(&target)),
        hand: scene::list(&cup),
        flight: scene::list(&flight),
        bounds: scene::list(&feet),
        boxes,
        steps,
        ..Space::default()
    }
}
