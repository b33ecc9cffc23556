//! Bus time, frames about the release, cycles and answer times.

use super::super::chart::Curve;
use super::super::page::{Block, Page, cell, number, table};
use super::super::timeline::{self, Timeline};
use super::RunReport;
use operator::analysis::bus::STEP_S;
use operator::analysis::collect::Reading;
use operator::analysis::coverage::{Coverage, JointCoverage};
use operator::analysis::distribution::Distribution;

/// Identifiers shown of the bus.
const IDS_SHOWN: usize = 14;

impl RunReport<'_> {
    pub(super) fn bus(&self, page: &mut Page) {
        let Some(bus) = &self.analysis.bus else { return };
        page.detail(
            "Bus",
            &format!(
                "Every frame with its exact length, stuff bits and interframe space included, at {:.0} kbit/s.",
                bus.bit_rate_bit_s / 1e3
            ),
        );
        let mut steps = Vec::with_capacity(2 * bus.over_time.len());
        for r in &bus.over_time {
            steps.extend([(r.t_s, r.value * 100.0), (r.t_s + STEP_S, r.value * 100.0)]);
        }
        let load =
            self.time_chart("Utilisation in steps of 10 ms", "share in %", vec![Curve::line("", 0, steps)]);
        let ids = bus.ids.iter().take(IDS_SHOWN).map(|id| {
            let what = cell(timeline::name(id.traffic));
            vec![cell(&id.id), what, cell(id.frames), number(id.share * 100.0, 2)]
        });
        let mut rows: Vec<_> = ids.collect();
        if let Some(rest) = bus.ids.get(IDS_SHOWN..).filter(|rest| !rest.is_empty()) {
            let frames: u64 = rest.iter().map(|id| id.frames).sum();
            let share: f64 = rest.iter().map(|id| id.share).sum();
            let name = cell(format!("{} more", rest.len()));
            rows.push(vec![name, cell("others"), cell(frames), number(share * 100.0, 2)]);
        }
        page.push(Block::Beside(vec![Block::Chart(load), table(&["id", "what", "frames", "share %"], rows)]));
        let lanes: Vec<(u8, String)> = self
            .analysis
            .joints
            .iter()
            .filter_map(|joint| Some((joint.module?, &joint.name)))
            .map(|(module, name)| (module, format!("{name} (drive {module})")))
            .collect();
        let period = self.analysis.cycles.period_s.map_or(3e-3, |p| p.median).clamp(1e-3, 40e-3);
        let fault = self.analysis.fault.as_ref();
        let normal =
            self.ran.release_s().map_or((0.5 * self.ran.end_s(), "middle of the motion"), |s| (s, "release"));
        let (middle, what) = fault.map_or(normal, |f| (f.t_s, "first fault"));
        let (from, to) = (middle - 2.0 * period, middle + 1.0 * period);
        page.push(Block::Timeline(Timeline::of(&bus.slots, from, to, &lanes)));
        page.note(&format!("Three control cycles about the {what}. Point at a frame to read it."));
    }

    /// Each interval and delay of the run beside the range that the gains are certified for.
    fn certified_timing(&self, page: &mut Page, coverage: &Coverage) {
        let certified = &coverage.certified;
        let end = (0.0, self.ran.end_s());
        let (low_s, high_s) = certified.intervals_s();
        let curves = |limits: &[f64], scale: f64, of: &dyn Fn(&JointCoverage) -> &[Reading]| {
            let joints = coverage.joints.iter().zip(&self.analysis.joints).enumerate();
            let measured = joints.map(|(j, (timing, joint))| {
                let points = of(timing).iter().map(|r| (r.t_s, r.value * scale)).collect();
                Curve::line(joint.name.clone(), j, points)
            });
            measured.chain(limits.iter().map(|limit| Curve::limit(end, limit * scale))).collect()
        };
        page.charts([
            self.time_chart(
                "Time between two commands to a drive; red: certified",
                "interval in ms",
                curves(&[low_s, high_s], 1e3, &|joint| &joint.command_intervals),
            ),
            self.time_chart(
                "From a measurement to its command; red: certified",
                "share of the interval in %",
                curves(&certified.delay_shares(), 1e2, &|joint| &joint.delay_shares),
            ),
        ]);
    }

    pub(super) fn timing(&self, page: &mut Page) {
        let a = self.analysis;
        page.part(
            "Timing",
            "Cycles are the times between two orders to the same drive. An answer's time runs from the end of its request to \
             its own end on the bus.",
        );
        let mut rows = Vec::new();
        let mut row = |what: String, d: Option<Distribution>| {
            rows.extend(d.map(|d| {
                let times = [d.min, d.median, d.p99, d.max].map(|s| number(s * 1e3, 3));
                [cell(what), cell(d.count)].into_iter().chain(times).collect()
            }));
        };
        row("control cycle".to_owned(), a.cycles.period_s);
        row("its distance from the median".to_owned(), a.cycles.deviation_s);
        if let Some(answers) = &a.answers {
            row("answers, all drives".to_owned(), answers.latency_s);
            for (module, name) in a.joints.iter().filter_map(|joint| Some((joint.module?, &joint.name))) {
                let of_module = answers.by_module.get(&module).copied();
                row(format!("answers of {name} (drive {module})"), of_module);
            }
        }
        page.table(&["what", "number", "least ms", "median ms", "99 % ms", "largest ms"], rows);
        match &a.coverage {
            Some(coverage) => {
                self.certified_timing(page, coverage);
                page.note(&coverage.sentence());
            }
            None => page.note(operator::job::summary::NOT_COMPARED),
        }
        let nominal = a.cycles.nominal_s.map_or(String::new(), |s| format!("Set period {:.3} ms. ", s * 1e3));
        match &a.answers {
            Some(answers) => page.note(&format!(
                "{nominal}{} requests without an answer, {} answers nobody had asked for.",
                answers.unanswered, answers.unasked
            )),
            None => page.note(&nominal),
        }
    }
}
