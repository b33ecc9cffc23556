//! HTML report of a recorded run against its plan.
//!
//! `tracking`, `bus` and `record` hold the sections of the page; `early` is the page of a throw that ended before there
//! was a motion to show.

mod bus;
mod early;
mod ran;
mod record;
mod tracking;

use std::fmt::Write as _;

pub use early::EarlyReport;
use nalgebra::Vector3;
pub use ran::Ran;
use serde_json::Value;

use super::chart::{Chart, Curve};
use super::frame::{cause, head, reported_outcome, tone};
use super::hand::{HandPath, Led, measured};
use super::page::{Answer, Tile, Tone};
use super::{landing, scene};
use operator::analysis::release::{ReleaseMotion, flight};
use operator::analysis::tracking::JointTracking;
use operator::analysis::{POSITION_BOUND_RAD, RunAnalysis, SPEED_BOUND_RAD_S};
use operator::job::default_tolerance_m;
use planner::plan::file::PlanFile;
use planner::throw::{Arm, Joints};

/// Points of the path of the hand.
const HAND_STEPS: u32 = 400;

/// What a report is about.
pub struct RunReport<'a> {
    pub arm: &'a Arm,
    pub ran: &'a Ran,
    /// What the log says.
    pub analysis: &'a RunAnalysis,
    /// `summary.json` of the job: how it ended, where the ball landed, seeds, versions, hashes.
    pub summary: Option<&'a Value>,
    /// Files behind the report: name, bytes, checksum.
    pub files: &'a [(String, u64, String)],
}

impl RunReport<'_> {
    /// One self-contained HTML file.
    #[must_use]
    pub fn html(&self) -> String {
        let ran = self.ran;
        let release = ran.release_s().map_or_else(String::new, |s| format!(", release at {s:.3} s"));
        let more = format!("plan {:.3} s{release}", ran.end_s());
        let mut page = head(&ran.title(), &ran.robot.name, self.summary, Some(more), &self.answer());
        let planned = |t_s: f64| ran.motion.at(t_s).q;
        let led =
            Led { name: "measured", end_s: ran.end_s(), planned: &planned, measured: &|t_s| self.q_at(t_s) };
        let hand = HandPath::of(self.arm, HAND_STEPS, &[led]);
        page.tiles(self.tiles(&hand));
        if let Some(fault) = &self.analysis.fault {
            self.fault(&mut page, fault);
        }
        let thrown = "; flight (orange); the ellipse is the predicted spread of the landing (2σ).";
        page.section(
            "In space",
            &format!(
                "Arm and hand path (blue) as measured, grey dashes as planned{} Drag to turn, wheel to zoom; the slider moves all \
                 pictures.",
                if ran.throw.is_some() { thrown } else { "." }
            ),
        );
        let beside = match &ran.throw {
            Some(plan) => landing::chart(plan, &self.landing_marks(plan)),
            None => {
                let [widest, ..] = hand.seen_flat();
                widest
            }
        };
        page.scene(self.space(), Some(beside));
        self.tolerances(&mut page);
        self.tracking(&mut page);
        self.currents(&mut page);
        self.bus(&mut page);
        self.timing(&mut page);
        if let Some(tear) = &self.analysis.torn {
            page.note(&format!("Attention: {tear}."));
        }
        page.detail("Events", "What controller, host and drives said. Time zero is the start of the plan.");
        record::events(&mut page, &self.analysis.events);
        self.repeat(&mut page);
        page.finish()
    }

    fn in_summary(&self, pointer: &str) -> Option<&Value> {
        self.summary.and_then(|summary| summary.pointer(pointer)).filter(|value| !value.is_null())
    }

    /// Where the ball landed, by whoever saw it.
    fn landed(&self) -> Option<([f64; 3], String)> {
        let position = self.in_summary("/landing/position_m")?.as_array()?;
        let source = self.in_summary("/landing/source").and_then(Value::as_str).unwrap_or("landed");
        let number = |i: usize| position.get(i)?.as_f64();
        Some(([number(0)?, number(1)?, number(2)?], source.to_owned()))
    }

    /// The release; `None` for a run that was stopped before the order to open the gripper.
    fn thrown(&self) -> Option<ReleaseMotion> {
        self.analysis.release.filter(|release| release.gripper_ordered_t_s.is_some())
    }

    fn landing_error_m(&self) -> Option<f64> {
        self.in_summary("/landing_error_m").and_then(Value::as_f64)
    }

    /// What the throw itself judged; without its summary, what the log says.
    fn verdict(&self) -> (String, Tone) {
        if let Some((outcome, text)) = self.summary.and_then(reported_outcome) {
            return (text, tone(outcome));
        }
        if let Some(fault) = &self.analysis.fault {
            return (format!("stopped: {}", fault.what), Tone::Bad);
        }
        if !self.analysis.completed {
            return ("not seen to its end".to_owned(), Tone::Warn);
        }
        match self.thrown().and_then(|release| release.landing_error_m) {
            Some(m) if m <= self.tolerance_m() => (
                format!("the measured motion sends the ball {:.1} mm from the target; not observed", m * 1e3),
                Tone::Plain,
            ),
            Some(m) => {
                (format!("missed, by the measured motion: {:.1} mm from the target", m * 1e3), Tone::Bad)
            }
            None if self.ran.throw.is_none() => ("ran to its end".to_owned(), Tone::Good),
            None => ("ran to its end; no release was ordered".to_owned(), Tone::Warn),
        }
    }

    fn answer(&self) -> Answer {
        let (verdict, tone) = self.verdict();
        let (why, next) = match &self.analysis.fault {
            Some(fault) => (
                format!(
                    "fault {}{} at {:.3} s of the plan, while {}: {}",
                    fault.code,
                    fault.joint.map_or_else(String::new, |joint| format!(" of joint {joint}")),
                    fault.t_s,
                    fault.state_before,
                    fault.what
                ),
                format!("{}; `cubectl explain {}` has more", fault.recovery, fault.code),
            ),
            None => cause(self.summary).unwrap_or_else(|| self.reasons(tone)),
        };
        Answer { verdict, tone, why, next }
    }

    /// What the arm and the release did, and what follows from it.
    fn reasons(&self, tone: Tone) -> (String, String) {
        let off_mrad = 1e3 * self.largest_error_rad();
        let mut why = format!(
            "joints at most {off_mrad:.2} mrad from the plan (bound {:.0})",
            1e3 * POSITION_BOUND_RAD
        );
        let Some(plan) = &self.ran.throw else {
            return (why, "`cubectl run` with the plan of this folder repeats the motion".to_owned());
        };
        let by_motion_m = self.thrown().and_then(|release| release.landing_error_m);
        if let Some(off_m) = by_motion_m {
            let _ =
                write!(why, "; by the measured motion the ball lands {:.1} mm from the target", 1e3 * off_m);
        }
        if let Some(late_s) = self.in_summary("/landing/release_late_s").and_then(Value::as_f64) {
            let [x, y] = plan.landing.delay_sensitivity_mm_per_ms;
            let late_ms = 1e3 * late_s;
            let moved_mm = (late_ms * x.hypot(y)).abs();
            let _ =
                write!(why, "; released {late_ms:.1} ms late, which moves the landing by {moved_mm:.1} mm");
        }
        let touched = self.in_summary("/landing/touched_arm_after_s").is_some_and(Value::is_number);
        let next = if touched {
            why += "; the ball touched the arm after its release";
            "plan the throw with `--clean-release true`"
        } else if tone != Tone::Bad {
            "throw again to see the scatter beside the predicted ellipse"
        } else if by_motion_m.is_some_and(|m| m > self.tolerance_m()) {
            "see Tracking for the joint that strays; `cubectl tune --plan` designs gains for this throw"
        } else {
            "measure when the ball leaves the hand, and set `gripper.opening_us` of the controller to it"
        };
        (why.replace('-', "−"), next.to_owned())
    }

    fn largest_error_rad(&self) -> f64 {
        let of_joint = |joint: &JointTracking| joint.position_error_rad.max_after_transient;
        self.analysis.joints.iter().map(of_joint).fold(0.0, f64::max)
    }

    fn tolerance_m(&self) -> f64 {
        let noted = self.in_summary("/tolerance_m").and_then(Value::as_f64);
        noted.or_else(|| Some(default_tolerance_m(self.arm, self.ran.throw.as_ref()?))).unwrap_or(0.0)
    }

    fn tiles(&self, hand: &HandPath) -> Vec<Tile> {
        let a = self.analysis;
        let mut tiles = Vec::new();
        if let Some(m) = self.landing_error_m() {
            let observed = self.in_summary("/landing/observed").and_then(Value::as_bool).unwrap_or(false);
            let tone = match (m <= self.tolerance_m(), observed) {
                (true, false) => Tone::Plain,
                (hit, _) => Tone::of(hit),
            };
            let what = match observed {
                true => "landing error, observed",
                false => "landing error by the measured motion, not observed",
            };
            tiles.push(Tile::new(format!("{:.1}", m * 1e3), "mm", what).toned(tone));
        }
        if self.ran.throw.is_none() {
            let what = "largest distance of the hand from its plan";
            tiles.push(Tile::new(format!("{:.2}", 1e3 * hand.error_m()), "mm", what));
        }
        let q = self.largest_error_rad();
        let v = a.joints.iter().map(|j| j.speed_error_rad_s.max_after_transient).fold(0.0, f64::max);
        let position = Tile::new(format!("{:.2}", q * 1e3), "mrad", "largest position error, after 0.1 s");
        tiles.push(position.toned(Tone::of(q <= POSITION_BOUND_RAD)));
        let speed = Tile::new(format!("{:.0}", v * 1e3), "mrad/s", "largest speed error, after 0.1 s");
        tiles.push(speed.toned(Tone::of(v <= SPEED_BOUND_RAD_S)));
        let at_release = a.joints.iter().filter_map(|j| j.position_error_rad.at_release.map(f64::abs));
        tiles.extend(
            at_release
                .reduce(f64::max)
                .map(|e| Tile::new(format!("{:.2}", e * 1e3), "mrad", "position error at the release")),
        );
        if let (Some(period), Some(deviation)) = (a.cycles.period_s, a.cycles.deviation_s) {
            let what = format!("control cycle, 99 % within ±{:.0} µs", deviation.p99 * 1e6);
            tiles.push(Tile::new(format!("{:.2}", period.median * 1e3), "ms", what));
        }
        if let Some(latency) = a.answers.as_ref().and_then(|answers| answers.latency_s) {
            let what = format!("answer time, 99 % below {:.0} µs", latency.p99 * 1e6);
            tiles.push(Tile::new(format!("{:.0}", latency.median * 1e6), "µs", what));
        }
        if let Some(bus) = &a.bus {
            let what = format!("of the bus, peak {:.0} %", bus.utilisation_peak * 100.0);
            tiles.push(Tile::new(format!("{:.0}", bus.utilisation * 100.0), "%", what));
        }
        let c = &a.counts;
        let counts = format!("{} / {} / {}", c.cycles_saturated, c.cycles_late, c.replies_missed);
        let tone = if c.cycles_late + c.replies_missed > 0 { Tone::Warn } else { Tone::Plain };
        tiles.push(Tile::new(counts, "", "saturated, late cycles, missed answers").toned(tone));
        tiles
    }

    fn landing_marks(&self, plan: &PlanFile) -> Vec<landing::Mark> {
        let mut marks = Vec::new();
        if let Some((p, name)) = self.landed() {
            let xy_m = plan.target.coordinates(p, plan.landing.flight_s);
            marks.push(landing::Mark { name, colour: 1, xy_m });
        }
        if let Some(p) = self.thrown().and_then(|release| release.landing_m) {
            marks.push(landing::Mark {
                name: "measured motion".to_owned(),
                colour: 0,
                xy_m: plan.target.coordinates(p, plan.landing.flight_s),
            });
        }
        marks
    }

    fn q_at(&self, t_s: f64) -> Joints {
        let samples = |j: usize| &self.analysis.joints[j].samples[..];
        measured(&self.ran.motion, samples, |sample| (sample.t_s, sample.error_rad), t_s)
    }

    fn space(&self) -> scene::Space {
        let (plan, end_s) = (self.ran.throw.as_ref(), self.ran.end_s());
        let thrown = self.thrown();
        let p0 = thrown.map_or_else(Vector3::zeros, |release| Vector3::from(release.position_m));
        let v0 = thrown.map_or_else(Vector3::zeros, |release| Vector3::from(release.velocity_m_s));
        let model = plan.and_then(flight);
        let landed = model
            .as_ref()
            .zip(plan)
            .and_then(|(flight, plan)| flight.meet(&p0, &v0, &plan.target.aim(), 0.0));
        let planned_s = plan.map_or(0.0, |plan| plan.landing.flight_s);
        let flight_s = landed.map_or(planned_s, |landed| landed.time_s);
        // The ball ends where it was seen to land: the difference grows with the time of flight.
        let miss = match (self.landed(), landed) {
            (Some((seen, _)), Some(landed)) => Vector3::from(seen) - landed.p,
            _ => Vector3::zeros(),
        };
        let ball_after =
            |s: f64| model.as_ref().map_or(p0, |flight| flight.fly(&p0, &v0, s).p + miss * (s / flight_s));
        let planned = (0..=120)
            .map(|i| {
                let q = self.ran.motion.at(end_s * f64::from(i) / 120.0).q;
                self.arm.ball(&self.arm.fk(&q)).pos
            })
            .collect();
        scene::data(
            self.arm,
            plan.map(scene::Goal::from).as_ref(),
            &scene::SceneMotion {
                q_at: &|t_s| self.q_at(t_s),
                to_s: end_s,
                flight: thrown.map(|release| scene::Flight {
                    release_s: release.t_s,
                    ball_after: &ball_after,
                    flight_s,
                }),
                planned: Some(planned),
            },
        )
    }

    fn time_chart(&self, title: &str, y_label: &str, curves: Vec<Curve>) -> Chart {
        let mark = self.ran.release_s().map(|s| (s, "release"));
        let fault = self.analysis.fault.as_ref().map(|fault| (fault.t_s, format!("fault {}", fault.code)));
        let chart = Chart::new(title, "time of the plan in s", y_label, curves).over_time(mark);
        Chart { fault, ..chart }
    }
}
