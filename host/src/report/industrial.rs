//! HTML report of a throw with an industrial robot (paper 000, figures 7 to 9): path in space, commanded against actual axes,
//! the throw as an animation, the bottle hit or missed, and what the opening time would have done.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use planner::follow::landing::Sensitivity;
use planner::follow::limits::{AXES, Arm, Axes, Limits};
use planner::follow::parabola::Parabola;
use planner::follow::plan::{FollowPlan, Phase};
use robot_model::Pose;
use serde_json::Value;

use super::chart::{Chart, Curve, Pen};
use super::follow::{JITTER_S, PHASES, opening_chart, path, path_charts, releases, sensitivities};
use super::frame::{cause, foot, head, reported_outcome, tone};
use super::motion::Row;
use super::page::{Answer, Cell, Tile, Tone, cell, number};
use super::scene;
use operator::job::Outcome;

/// Half height of the bottle, m.
const BOTTLE_HALF_M: f64 = 0.12;
/// The robot is shown for so long before the plan begins and after it ends, s.
const AROUND_S: f64 = 0.25;
/// Longest lag that is looked for, ms.
const LAG_MAX_MS: u32 = 300;
/// Colour of measured curves.
const ACTUAL: usize = 6;

/// A point of space on a chart.
type View = fn(&Vector3<f64>) -> (f64, f64);

/// What a run left.
pub struct RobotRun<'a> {
    pub arm: &'a Arm,
    pub plan: &'a FollowPlan,
    /// What the commands keep.
    pub limits: &'a Limits,
    /// Set and actual axes, time from the start of the plan.
    pub rows: &'a [Row],
    /// `summary.json`.
    pub summary: &'a Value,
    /// Files behind the report: name, bytes, checksum.
    pub files: &'a [(String, u64, String)],
}

/// How the ball flew.
struct Flown {
    /// When it left the hand, s from the start of the plan.
    release_s: f64,
    flight: Parabola,
    /// Until it is at the height of the target.
    flight_s: f64,
    /// Seen, or computed from the measured axes.
    seen: bool,
}

impl RobotRun<'_> {
    #[must_use]
    pub fn html(&self) -> String {
        let plan = self.plan;
        let (outcome, text) = reported_outcome(self.summary)
            .unwrap_or((Outcome::NotThrown, "no outcome is recorded".to_owned()));
        let [x, y, z] = plan.target_m;
        let (flown, planned) = (self.flown(), path(self.arm, plan));
        let (title, robot) = (format!("Throw to ({x:.3}, {y:.3}, {z:.3}) m over RSI"), &plan.robot);
        let (why, next) = cause(Some(self.summary)).unwrap_or_else(|| self.reasons());
        let answer = Answer::new(text, tone(outcome), why, next);
        let mut page = head(&title, &robot.name, Some(self.summary), None, &answer);
        page.tiles(self.tiles(flown.as_ref()));
        page.section(
            "The throw",
            "Arm, hand and ball by the actual axes; the bottle stands at the target (paper, figure 9). Blue: way of the hand.",
        );
        page.scene(self.scene(flown.as_ref(), planned.clone()), None);
        page.part(
            "Path in space",
            "Centre of the ball in the three phases of the plan and its flight (paper, figure 7), over the actual path.",
        );
        page.charts(self.paths(&planned));
        page.part(
            "Landing",
            "Where the ball comes down at the height of the target, and what the opening time does to it.",
        );
        // By the lag that was believed: for another one the throw may be opened elsewhere in its window.
        let lag_s = self.number("/lag/time_constant_s").unwrap_or(plan.lag_s);
        let releases = releases(self.arm, plan, self.limits, lag_s);
        page.charts([self.landing(flown.as_ref()), opening_chart(self.arm, plan, &releases)]);
        let [without, with] = sensitivities(self.arm, &releases);
        let row = |name: String, off: &Sensitivity| {
            vec![cell(name), number(1e3 * off.rms_m, 1), number(1e3 * off.largest_m, 1)]
        };
        let rows = vec![
            row("ramps through the release".to_owned(), &without),
            row(format!("following {} points", plan.followed_points), &with),
        ];
        page.table(&[&format!("opening ±{:.0} ms", 1e3 * JITTER_S), "rms mm", "largest mm"], rows);
        page.detail(
            "Commanded against actual",
            "Angle, speed and acceleration of each axis (paper, figure 8). Set points in force, by phase, and the actual axes, \
             later by the lag. Speed and acceleration by differences of one cycle.",
        );
        page.charts((0..AXES).flat_map(|axis| self.axis(axis)));
        page.part("Exchange", "");
        page.table(&["what", "value"], self.exchange());
        foot(&mut page, robot, None, None, Some(self.summary), self.files);
        page.finish()
    }

    fn number(&self, path: &str) -> Option<f64> {
        self.summary.pointer(path).and_then(Value::as_f64)
    }

    /// From the actual axes at the release that was seen, else at the one that was ordered.
    fn flown(&self) -> Option<Flown> {
        let seen = self.summary.pointer("/release/velocity_m_s").is_some_and(Value::is_array);
        let release_s = if seen {
            self.plan.release_time_s + self.number("/release/late_s")?
        } else {
            let opened = self.rows.iter().find(|row| row.outputs != 0)?;
            opened.t_s + self.number("/gripper_delay_s").unwrap_or(0.0)
        };
        let (q, qd) = self.at(release_s)?;
        let frames = self.arm.fk(&q);
        let p0 = self.arm.ball(&frames).pos;
        let v0: Vector3<f64> = (frames.jacobian(&p0) * qd).fixed_rows::<3>(0).into();
        let gravity_m_s2 = self.arm.world().gravity_m_s2;
        let root = v0.z * v0.z + 2.0 * gravity_m_s2 * (p0.z - self.plan.target_m[2]);
        let flight_s = (v0.z + root.max(0.0).sqrt()) / gravity_m_s2;
        let flight = Parabola { p0, v0, gravity_m_s2 };
        (root >= 0.0 && flight_s > 0.0).then_some(Flown { release_s, flight, flight_s, seen })
    }

    /// Actual angles and speeds at a time, from the cycles around; `None` outside.
    fn at(&self, t_s: f64) -> Option<(Axes, Axes)> {
        let next = self.rows.iter().position(|row| row.t_s > t_s)?;
        let near = self.rows.get(next.checked_sub(2)?..next + 2)?;
        // Lagrange through four cycles, and its derivative.
        let (mut q, mut qd) = (Axes::zeros(6), Axes::zeros(6));
        for (i, row) in near.iter().enumerate() {
            let others = || near.iter().enumerate().filter(move |(j, _)| *j != i).map(|(_, other)| other.t_s);
            let below: f64 = others().map(|t| row.t_s - t).product();
            let weight: f64 = others().map(|t| t_s - t).product::<f64>() / below;
            let slope: f64 = others()
                .enumerate()
                .map(|(k, _)| {
                    others().enumerate().filter(|(l, _)| *l != k).map(|(_, t)| t_s - t).product::<f64>()
                })
                .sum::<f64>()
                / below;
            for axis in 0..AXES {
                q[axis] += weight * row.actual_deg[axis].to_radians();
                qd[axis] += slope * row.actual_deg[axis].to_radians();
            }
        }
        Some((q, qd))
    }

    /// Where the ball was seen to land.
    fn landed(&self) -> Option<Vector3<f64>> {
        let at = |k: usize| self.summary.pointer(&format!("/landing/position_m/{k}")).and_then(Value::as_f64);
        Some(Vector3::new(at(0)?, at(1)?, at(2)?))
    }

    fn off_m(&self, flown: Option<&Flown>) -> Option<f64> {
        let flown = flown?;
        let down = flown.flight.position(flown.flight_s);
        Some((down - Vector3::from(self.plan.target_m)).xy().norm())
    }

    fn tiles(&self, flown: Option<&Flown>) -> Vec<Tile> {
        let off_m = self.number("/landing/error_m").or(self.off_m(flown));
        let tolerance_m = self.number("/tolerance_m").unwrap_or(0.0);
        let (value, tone, what) = match off_m {
            Some(off_m) => {
                let hit = off_m <= tolerance_m;
                let what = match (hit, flown.is_some_and(|flown| flown.seen)) {
                    (true, true) => "from the target: bottle hit",
                    (false, true) => "from the target: bottle missed",
                    (_, false) => "from the target, by the measured axes",
                };
                (format!("{:.1}", 1e3 * off_m), Tone::of(hit), what)
            }
            None => ("–".to_owned(), Tone::Bad, "no landing"),
        };
        let lag = self.lag_ms().map_or("–".to_owned(), |ms| ms.to_string());
        // Zero has no sign.
        let later_ms = (1e4 * self.number("/path_delay_s").unwrap_or(0.0)).round() / 10.0 + 0.0;
        let answers = self.number("/answers").unwrap_or(0.0);
        vec![
            Tile::new(value, "mm", what).toned(tone),
            Tile::new(self.plan.followed_points, "points", "of the flight followed"),
            Tile::new(lag, "ms", "from set points to actual axes"),
            Tile::new(format!("{later_ms:.1}"), "ms", "axes later than the description of the robot says"),
            Tile::new(format!("{answers:.0}"), "answers", "to telegrams of the robot"),
        ]
    }

    /// What the axes and the release did, and what follows from it.
    fn reasons(&self) -> (String, String) {
        let late_ms = 1e3 * self.number("/release/late_s").unwrap_or(0.0);
        let lag =
            self.lag_ms().map_or_else(String::new, |ms| format!("; axes {ms} ms behind their set points"));
        let why = format!("released {late_ms:.1} ms after the planned instant{lag}").replace('-', "−");
        (why, "see Landing for what the opening time does; throw again to see the scatter".to_owned())
    }

    /// Rows of the plan and shortly before and after it.
    fn shown(&self) -> impl Iterator<Item = (usize, &Row)> {
        let end_s = self.end_s();
        let window = -AROUND_S..=end_s + AROUND_S;
        self.rows.iter().enumerate().filter(move |(_, row)| window.contains(&row.t_s))
    }

    fn end_s(&self) -> f64 {
        self.plan.steps.last().map_or(0.0, |step| step.t_s)
    }

    /// The shift in time after which set points and actual axes differ least.
    fn lag_ms(&self) -> Option<u32> {
        let set_at = |t_s: f64, axis: usize| {
            let next = self.rows.iter().position(|row| row.t_s > t_s)?;
            let (a, b) = (self.rows.get(next.checked_sub(1)?)?, &self.rows[next]);
            let share = (t_s - a.t_s) / (b.t_s - a.t_s);
            Some(a.set_deg[axis] + share * (b.set_deg[axis] - a.set_deg[axis]))
        };
        let cost = |ms: u32| {
            let mut sum = 0.0;
            for (_, row) in self.shown().step_by(3) {
                for axis in 0..AXES {
                    sum += (set_at(row.t_s - 1e-3 * f64::from(ms), axis)? - row.actual_deg[axis]).powi(2);
                }
            }
            Some(sum)
        };
        let costs = (0..=LAG_MAX_MS).step_by(4).filter_map(|ms| Some((ms, cost(ms)?)));
        costs.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(ms, _)| ms)
    }

    /// Actual angles at a time; before the first cycle those of the first, later than the last those of the last.
    fn q_at(&self, t_s: f64) -> Axes {
        let nearest = self.rows.iter().rfind(|row| row.t_s <= t_s).or(self.rows.first());
        let still = || nearest.map_or(Axes::zeros(AXES), |row| row.actual_deg.map(f64::to_radians).into());
        self.at(t_s).map_or_else(still, |(q, _)| q)
    }

    fn scene(&self, flown: Option<&Flown>, planned: Vec<Vector3<f64>>) -> scene::Space {
        let target_m = Vector3::from(self.plan.target_m);
        let radius_m = self.number("/tolerance_m").unwrap_or(0.035);
        let half_m = Vector3::new(radius_m, radius_m, BOTTLE_HALF_M);
        let bottle = scene::body(0, &Pose::translation(target_m.x, target_m.y, target_m.z), &half_m);
        let ring = circle(radius_m).into_iter().map(|(x, y)| target_m + Vector3::new(x, y, 0.0));
        let goal = scene::Goal { target_m, spread: ring.collect(), rim: None, bodies: vec![bottle] };
        let ball_after = |s: f64| flown.map_or(target_m, |flown| flown.flight.position(s));
        let flight = flown.map(|flown| scene::Flight {
            release_s: flown.release_s,
            ball_after: &ball_after,
            flight_s: flown.flight_s,
        });
        let q_at = |t_s: f64| self.q_at(t_s);
        let (to_s, planned) = (self.end_s(), Some(planned));
        scene::data(self.arm, Some(&goal), &scene::SceneMotion { q_at: &q_at, to_s, flight, planned })
    }

    fn paths(&self, planned: &[Vector3<f64>]) -> Vec<Chart> {
        let actual: Vec<Vector3<f64>> = self
            .shown()
            .map(|(_, row)| self.arm.ball(&self.arm.fk(&Axes::from(row.actual_deg.map(f64::to_radians)))).pos)
            .collect();
        let views: [View; 2] = [|p| (p.x, p.z), |p| (p.x, p.y)];
        let mut charts = path_charts(self.plan, planned);
        for (chart, view) in charts.iter_mut().zip(views) {
            // Under the plan, which it covers nearly everywhere.
            chart.curves.insert(0, Curve::line("actual", ACTUAL, actual.iter().map(view).collect()));
        }
        charts
    }

    fn landing(&self, flown: Option<&Flown>) -> Chart {
        let radius_mm = 1e3 * self.number("/tolerance_m").unwrap_or(0.035);
        let mut curves = vec![
            Curve::line("bottle", 7, circle(radius_mm)),
            Curve::line("target", 2, vec![(0.0, 0.0), (0.0, 0.0)]).drawn(Pen::Dots),
        ];
        if let Some(flown) = flown {
            let off = self.landed().unwrap_or_else(|| flown.flight.position(flown.flight_s))
                - Vector3::from(self.plan.target_m);
            let name = if flown.seen { "landing" } else { "landing by the measured axes" };
            let place = (1e3 * off.x, 1e3 * off.y);
            curves.push(Curve::line(name, 1, vec![place, place]).drawn(Pen::Dots));
        }
        Chart::new("Landing about the target", "x in mm", "y in mm", curves).equal()
    }

    /// Phase of the plan that a set point in force at `t_s` leads the axes through.
    fn phase(&self, t_s: f64) -> Phase {
        let dead_s = self.number("/lag/dead_time_s").unwrap_or(0.0);
        let [first, last] = self.plan.window.map(|k| k as f64 * self.plan.period_s);
        match t_s + dead_s {
            t if t < first - 1e-9 => Phase::Accelerate,
            t if t <= last + 1e-9 => Phase::Follow,
            _ => Phase::Decelerate,
        }
    }

    fn axis(&self, axis: usize) -> Vec<Chart> {
        let rows = self.rows;
        let differences = |k: usize, of: &dyn Fn(&Row) -> f64| -> Option<[f64; 2]> {
            let (a, b, c) = (rows.get(k.checked_sub(1)?)?, rows.get(k)?, rows.get(k + 1)?);
            let h = 0.5 * (c.t_s - a.t_s);
            (h > 0.0).then(|| [(of(c) - of(a)) / (2.0 * h), (of(c) - 2.0 * of(b) + of(a)) / (h * h)])
        };
        let value = |k: usize, what: usize, of: &dyn Fn(&Row) -> f64| match what {
            0 => rows.get(k).map(of),
            _ => differences(k, of).map(|both| both[what - 1]),
        };
        let units = [("angle", "deg"), ("speed", "deg/s"), ("acceleration", "deg/s²")];
        units
            .into_iter()
            .enumerate()
            .map(|(what, (name, unit))| {
                let mut curves: Vec<Curve> = PHASES
                    .into_iter()
                    .map(|(phase, name, colour)| {
                        let points = self
                            .shown()
                            .filter(|(k, row)| {
                                // The first of the next phase belongs to both, so that the curve has no gap.
                                let before = k.checked_sub(1).and_then(|k| rows.get(k)).unwrap_or(row);
                                self.phase(row.t_s) == phase || self.phase(before.t_s) == phase
                            })
                            .filter_map(|(k, row)| {
                                Some((row.t_s, value(k, what, &|row| row.set_deg[axis])?))
                            });
                        Curve::line(name, colour, points.collect())
                    })
                    .collect();
                let points = self
                    .shown()
                    .filter_map(|(k, row)| Some((row.t_s, value(k, what, &|row| row.actual_deg[axis])?)));
                curves.push(Curve::line("actual", ACTUAL, points.collect()));
                let mark = Some((self.plan.release_time_s, "release"));
                Chart::new(format!("A{}: {name}", axis + 1), "time of the plan in s", unit, curves)
                    .over_time(mark)
            })
            .collect()
    }

    fn exchange(&self) -> Vec<Vec<Cell>> {
        let show = |path: &str| match self.summary.pointer(path) {
            None | Some(Value::Null) => None,
            Some(Value::String(text)) => Some(text.clone()),
            Some(other) => Some(other.to_string()),
        };
        let rows = [
            ("bus", "/bus"),
            ("time", "/time"),
            ("answers", "/answers"),
            ("late answers", "/late_answers"),
            ("answers that the robot refused", "/refused_answers"),
            ("own answer time, median, us", "/answer_times/own_time_us/median"),
            ("own answer time, 99.9 %, us", "/answer_times/own_time_us/p999"),
            ("own answer time, largest, us", "/answer_times/own_time_us/max"),
            ("rights of this program", "/answer_times/real_time_rights"),
            ("dead time believed, s", "/lag/dead_time_s"),
            ("time constant believed, s", "/lag/time_constant_s"),
            ("gripper delay believed, s", "/gripper_delay_s"),
            ("what stopped the robot", "/robot_fault"),
        ];
        rows.into_iter().filter_map(|(what, path)| Some(vec![cell(what), cell(show(path)?)])).collect()
    }
}

/// A circle about the origin.
fn circle(radius: f64) -> Vec<(f64, f64)> {
    (0..=72).map(|k| (f64::from(k) * TAU / 72.0).sin_cos()).map(|(s, c)| (radius * c, radius * s)).collect()
}
