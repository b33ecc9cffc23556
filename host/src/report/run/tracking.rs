//! Errors against the bounds of the paper, references against measurements, currents per supply.

use serde_json::Value;

use super::super::chart::{Chart, Curve, Pen};
use super::super::page::{Page, Tone, cell, number};
use super::RunReport;
use operator::analysis::collect::Reading;
use operator::analysis::tracking::JointTracking;
use operator::analysis::{AFTER_S, BEFORE_S, POSITION_BOUND_RAD, SPEED_BOUND_RAD_S, TRANSIENT_S};

impl RunReport<'_> {
    pub(super) fn tracking(&self, page: &mut Page) {
        page.part(
            "Tracking",
            "Reference minus measurement. The green bands are the bounds that the paper reports for its arm after a \
             transient of 0.1 s (figure 3): 0.05 rad and 0.1 rad/s. Speeds are estimated from the change of the errors.",
        );
        let end = self.ran.end_s();
        let joints = &self.analysis.joints;
        let overview = |title: &str,
                        y_label: &str,
                        bound: f64,
                        value: &dyn Fn(&JointTracking) -> Vec<(f64, f64)>| {
            let curves =
                joints.iter().enumerate().map(|(j, joint)| Curve::line(joint.name.clone(), j, value(joint)));
            let mut chart = self.time_chart(title, y_label, curves.collect());
            chart.band = Some([TRANSIENT_S, end, -bound, bound]);
            chart
        };
        page.charts([
            overview("Position errors", "error in rad", POSITION_BOUND_RAD, &|joint| {
                joint.samples.iter().map(|s| (s.t_s, s.error_rad)).collect()
            }),
            overview("Speed errors", "error in rad/s", SPEED_BOUND_RAD_S, &|joint| {
                joint.samples.iter().map(|s| (s.t_s, s.error_rad_s)).collect()
            }),
        ]);
        let rows = joints.iter().map(|joint| {
            let (q, v) = (&joint.position_error_rad, &joint.speed_error_rad_s);
            let judged =
                |value: f64, bound: f64, digits| (number(value * 1e3, digits).0, Tone::of(value <= bound));
            let release = |at: Option<f64>, digits: usize| {
                cell(at.map_or("–".to_owned(), |e| format!("{:+.digits$}", e * 1e3).replace('-', "−")))
            };
            let drive = joint.module.map(|module| format!("\u{a0}(drive\u{a0}{module})"));
            vec![
                cell(format!("{}{}", joint.name, drive.unwrap_or_default())),
                number(q.max * 1e3, 2),
                judged(q.max_after_transient, POSITION_BOUND_RAD, 2),
                number(q.rms * 1e3, 2),
                release(q.at_release, 2),
                number(v.max * 1e3, 0),
                judged(v.max_after_transient, SPEED_BOUND_RAD_S, 0),
                number(v.rms * 1e3, 0),
                release(v.at_release, 0),
                cell(joint.samples_in_plan),
                cell(joint.commands_at_limit),
            ]
        });
        let head = [
            "joint",
            "position max mrad",
            "after 0.1 s",
            "rms",
            "at release",
            "speed max mrad/s",
            "after 0.1 s",
            "rms",
            "at release",
            "answers",
            "commands at limit",
        ];
        page.table(&head, rows.collect());
        page.charts((0..joints.len()).map(|j| self.error_chart(j)));
        page.detail("Each joint", "References against what was measured.");
        page.charts((0..joints.len()).flat_map(|j| self.motion_charts(j)));
        self.control(page);
    }

    /// Position error of one joint at its own scale, mrad.
    fn error_chart(&self, j: usize) -> Chart {
        let joint = &self.analysis.joints[j];
        let points = joint.samples.iter().map(|s| (s.t_s, s.error_rad * 1e3)).collect();
        self.time_chart(
            &format!("{}: position error", joint.name),
            "error in mrad",
            vec![Curve::line("", j, points)],
        )
    }

    /// What the feedback adds, beside what is left for it.
    fn control(&self, page: &mut Page) {
        let joints = &self.analysis.joints;
        if joints.iter().all(|joint| joint.controls.is_empty()) {
            return;
        }
        page.detail(
            "Feedback",
            "u: what the feedback adds to the acceleration of the reference (paper, eq. 11), as the orders to the drive amount \
             to it. Red: what is left for it, ±v_max − q̈ of the reference (eq. 12). Where u meets the red line, the command is \
             clipped.",
        );
        let charts =
            joints.iter().enumerate().filter(|(_, joint)| !joint.controls.is_empty()).map(|(j, joint)| {
                let a_max = self.arm.joints()[j].limits.a_control_max_rad_s2;
                let bound = |side: f64| {
                    let points = joint.controls.iter().map(|c| (c.t_s, side * a_max - c.qdd_ref_rad_s2));
                    Curve::line("", 7, points.collect()).drawn(Pen::Limit)
                };
                let u = joint.controls.iter().map(|c| (c.t_s, c.u_rad_s2())).collect();
                self.time_chart(
                    &format!("{}: u, v_max {a_max:.1} rad/s²", joint.name),
                    "u in rad/s²",
                    vec![bound(1.0), bound(-1.0), Curve::line("", j, u)],
                )
            });
        page.charts(charts);
    }

    fn motion_charts(&self, j: usize) -> [Chart; 2] {
        let joint = &self.analysis.joints[j];
        let limits = self.arm.joints()[j].limits;
        let samples = || joint.samples.iter();
        let target = joint.commands.iter().map(|c| (c.t_s, c.target_rad)).collect();
        let shown = (-BEFORE_S, self.ran.end_s() + AFTER_S);
        let q = self.time_chart(
            &format!("{}: position", joint.name),
            "angle in rad",
            vec![
                Curve::line("target of the ramps", 7, target).beside(),
                Curve::line("reference", 6, samples().map(|s| (s.t_s, s.q_ref_rad)).collect())
                    .drawn(Pen::Dashed),
                Curve::line("measured", j, samples().map(|s| (s.t_s, s.q_rad)).collect()),
            ],
        );
        let v = self.time_chart(
            &format!("{}: speed", joint.name),
            "speed in rad/s",
            vec![
                Curve::line("reference", 6, samples().map(|s| (s.t_s, s.qd_ref_rad_s)).collect())
                    .drawn(Pen::Dashed),
                Curve::line("estimated", j, samples().map(|s| (s.t_s, s.qd_rad_s)).collect()),
                Curve::limit(shown, limits.v_max_rad_s),
                Curve::limit(shown, -limits.v_max_rad_s),
            ],
        );
        [q, v]
    }

    pub(super) fn currents(&self, page: &mut Page) {
        if self.analysis.supplies.is_empty() {
            return;
        }
        page.part(
            "Currents",
            "Sum of the magnitudes of the motors on each supply: dashed as the model of the robot file predicts them for \
             the plan (eq. 8 and 9), dots as read from the drives during the run. The model knows no friction.",
        );
        let points = |readings: &[Reading]| readings.iter().map(|r| (r.t_s, r.value)).collect::<Vec<_>>();
        let charts = self.analysis.supplies.iter().enumerate().map(|(i, supply)| {
            let mut curves = vec![
                Curve::line("predicted", 6, points(&supply.predicted)).drawn(Pen::Dashed),
                Curve::line("measured", i, points(&supply.measured)).drawn(Pen::Dots),
            ];
            // A limit far away would make the curves flat; the heading names it anyway.
            let peak = supply.measured_peak_a.unwrap_or(0.0).max(supply.predicted_peak_a);
            if peak > 0.25 * supply.limit_a {
                let shown = (-BEFORE_S, self.ran.end_s() + AFTER_S);
                curves.push(Curve::limit(shown, supply.limit_a));
            }
            let fed = supply.joints.join(", ");
            let title = format!("Supply \"{}\" ({fed}), limit {:.0} A", supply.name, supply.limit_a);
            self.time_chart(&title, "current in A", curves)
        });
        page.charts(charts);
        let rows = self.analysis.supplies.iter().map(|s| {
            let over = s.measured_peak_a.is_some_and(|peak| peak > s.limit_a);
            let tone = if over { Tone::Bad } else { Tone::Plain };
            vec![
                cell(&s.name),
                number(s.predicted_peak_a, 2),
                (number(s.measured_peak_a, 2).0, tone),
                number(s.difference_rms_a, 2),
                number(s.limit_a, 0),
                cell(s.readings),
            ]
        });
        let head =
            ["supply", "predicted peak A", "measured peak A", "rms difference A", "limit A", "readings"];
        page.table(&head, rows.collect());
    }

    /// How near each joint stayed to a motion that throws nothing, beside what was allowed.
    pub(super) fn tolerances(&self, page: &mut Page) {
        let joints = self.in_summary("/reached/joints").and_then(Value::as_array);
        let Some(joints) = joints.filter(|joints| !joints.is_empty()) else { return };
        let rows = joints.iter().map(|joint| {
            let mrad = |key: &str| 1e3 * joint.get(key).and_then(Value::as_f64).unwrap_or(f64::NAN);
            let beside = |off: &str, most: &str| {
                let (off, most) = (mrad(off), mrad(most));
                [(number(off, 2).0, Tone::of(off <= most)), number(most, 1)]
            };
            let name = joint.get("name").and_then(Value::as_str).unwrap_or("?");
            let [off, most] = beside("off_rad", "path_tolerance_rad");
            let [end_off, end_most] = beside("end_off_rad", "goal_tolerance_rad");
            let at_s = joint.get("off_at_s").and_then(Value::as_f64);
            vec![cell(name), off, number(at_s, 2), most, end_off, end_most]
        });
        let goal_s = self.in_summary("/reached/goal_time_s").and_then(Value::as_f64).unwrap_or(0.0);
        page.part(
            "Tolerances",
            &format!(
                "Farthest from the motion and when, and from its end {goal_s:.2} s after the planned end, in mrad, each beside its tolerance."
            ),
        );
        page.table(&["joint", "path", "at s", "tolerance", "end", "tolerance"], rows.collect());
    }
}
