//! Whether the timing of a run stayed within what the certificate of its gains covers, from the frames alone.
//!
//! The certificate covers a loop that measures, computes and acts. Here the measurement of a joint is the begin of
//! its answer (drives measure just before), and a command acts between the end of its frame and the next
//! measurement. So two commands in a row give three numbers:
//!
//! | number | from | to |
//! |---|---|---|
//! | command interval | end of a motion command | end of the next one |
//! | measurement interval | measurement after the first | measurement after the second |
//! | delay | measurement after the first | end of the second |
//!
//! Both intervals must be within the certified share of the period. The delay's share of its measurement interval
//! must be within the certified bounds, and is at most all of the interval. A command without an answer counts as
//! outside.

use serde::{Deserialize, Serialize};

use super::collect::{Heard, JointLog, Reading};
use tuner::gains::gains_file::{CertificateTable, GainsFile};

/// Timing that the certificate of all joints covers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Certified {
    /// Control period, s.
    pub period_s: f64,
    /// Share of the period by which intervals may differ from it.
    pub jitter_ratio: f64,
    /// Smallest delay from measurement to action, s, at the nominal period.
    pub delay_min_s: f64,
    /// Largest, s.
    pub delay_max_s: f64,
}

impl Certified {
    /// The narrowest of all joints; `None` without joints, or with a certificate without sampling (Theorem 1).
    #[must_use]
    pub fn of(gains: &GainsFile) -> Option<Self> {
        let sampled = |c: &CertificateTable| matches!(c, CertificateTable::Saturated { .. });
        if gains.joint.is_empty() || !gains.joint.iter().all(|joint| sampled(&joint.certificate)) {
            return None;
        }
        let all = |least: f64, pick: &dyn Fn(f64, f64) -> f64, of: &dyn Fn(usize) -> f64| {
            (0..gains.joint.len()).map(of).fold(least, pick)
        };
        let problem = |i: usize| &gains.joint[i].problem;
        Some(Self {
            period_s: gains.period_s,
            jitter_ratio: all(f64::INFINITY, &f64::min, &|i| problem(i).period_jitter_ratio),
            delay_min_s: all(0.0, &f64::max, &|i| problem(i).delay_min_s),
            delay_max_s: all(f64::INFINITY, &f64::min, &|i| problem(i).delay_max_s),
        })
    }

    fn covers(&self, interval_s: f64) -> bool {
        // Frames are known to a microsecond.
        (interval_s - self.period_s).abs() <= self.jitter_ratio * self.period_s + 1e-6
    }

    /// Least and largest share of an interval that the delay may be.
    #[must_use]
    pub fn delay_shares(&self) -> [f64; 2] {
        [self.delay_min_s, self.delay_max_s].map(|delay_s| delay_s / self.period_s)
    }

    /// Least and largest interval, s.
    #[must_use]
    pub fn intervals_s(&self) -> (f64, f64) {
        let room_s = self.jitter_ratio * self.period_s;
        (self.period_s - room_s, self.period_s + room_s)
    }
}

/// Least and largest of some times.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Range {
    /// Least, s.
    pub min_s: f64,
    /// Largest, s.
    pub max_s: f64,
}

impl Range {
    fn take(range: &mut Option<Self>, s: f64) {
        let old = range.unwrap_or(Self { min_s: s, max_s: s });
        *range = Some(Self { min_s: old.min_s.min(s), max_s: old.max_s.max(s) });
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct JointCoverage {
    /// Time between two motion commands.
    pub command_interval_s: Option<Range>,
    /// Time between two measurements.
    pub measurement_interval_s: Option<Range>,
    /// Least and largest time from a measurement to the command computed from it.
    pub delay_s: Option<Range>,
    /// Pairs of commands.
    pub intervals: usize,
    /// Those with a number that is not certified.
    pub outside: usize,
    /// Each command interval, s, at its end.
    #[serde(skip)]
    pub command_intervals: Vec<Reading>,
    /// Each delay from a measurement to the command computed from it, as a share of its measurement interval.
    #[serde(skip)]
    pub delay_shares: Vec<Reading>,
}

/// What left the certified range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    /// Time between two commands.
    CommandInterval,
    /// Time between two measurements.
    MeasurementInterval,
    /// Time from a measurement to the next command.
    Delay,
    /// A command without an answer.
    Unanswered,
}

/// The number farthest outside.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Worst {
    /// Joint, from 1.
    pub joint: usize,
    /// Time of the plan, s.
    pub t_s: f64,
    pub what: What,
    pub value_s: f64,
}

/// A run beside the certificate of its gains.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Coverage {
    pub certified: Certified,
    /// No interval is outside.
    pub inside: bool,
    /// Pairs of commands of all joints.
    pub intervals: usize,
    /// Those with a number that is not certified.
    pub outside: usize,
    /// Command intervals that differ from the period by more than 2, 5 and 10 %.
    pub beyond_2_5_10_percent: [usize; 3],
    /// The number farthest outside.
    pub worst: Option<Worst>,
    pub joints: Vec<JointCoverage>,
}

impl Coverage {
    /// One sentence for people; a warning if the run left the certificate.
    #[must_use]
    pub fn sentence(&self) -> String {
        let (low_s, high_s) = self.certified.intervals_s();
        let certified = format!("certified {:.2} to {:.2} ms", 1e3 * low_s, 1e3 * high_s);
        let seen = self.joints.iter().filter_map(|joint| joint.command_interval_s);
        let range = seen.reduce(|a, b| Range { min_s: a.min_s.min(b.min_s), max_s: a.max_s.max(b.max_s) });
        let Some(range) = range else {
            return "the timing is not known: the log holds no two commands to a drive".to_owned();
        };
        let Some(worst) = self.worst else {
            return format!(
                "timing inside the certificate of the gains: {} intervals between commands, {:.2} to {:.2} ms ({certified})",
                self.intervals,
                1e3 * range.min_s,
                1e3 * range.max_s
            );
        };
        let [least, most] = self.certified.delay_shares();
        let what = match worst.what {
            What::CommandInterval => format!("{:.2} ms between two commands", 1e3 * worst.value_s),
            What::MeasurementInterval => format!("{:.2} ms between two measurements", 1e3 * worst.value_s),
            What::Delay => {
                format!("a command {:.2} ms after the measurement it is computed from", 1e3 * worst.value_s)
            }
            What::Unanswered => "a command without an answer".to_owned(),
        };
        format!(
            "warning: the timing left what the gains are certified for in {} of {} intervals; worst: joint {} at {:.3} s, \
             {what} ({certified}, delay {:.0} to {:.0} % of the interval)",
            self.outside,
            self.intervals,
            worst.joint,
            worst.t_s,
            1e2 * least,
            1e2 * most
        )
    }
}

/// Compares the commands and answers while the plan ran.
#[must_use]
pub fn coverage(heard: &Heard, end_t_s: f64, certified: Certified) -> Coverage {
    let mut all = Coverage {
        certified,
        inside: true,
        intervals: 0,
        outside: 0,
        beyond_2_5_10_percent: [0; 3],
        worst: None,
        joints: Vec::new(),
    };
    let mut largest_excess_s = 0.0;
    for (index, drive) in heard.joints.iter().enumerate() {
        let joint = one(
            drive,
            end_t_s,
            &certified,
            &mut all.beyond_2_5_10_percent,
            |t_s, what, value_s, excess_s| {
                // Of two that are equal but for rounding the first counts.
                if excess_s > largest_excess_s + 1e-9 {
                    largest_excess_s = excess_s;
                    all.worst = Some(Worst { joint: index + 1, t_s, what, value_s });
                }
            },
        );
        all.intervals += joint.intervals;
        all.outside += joint.outside;
        all.joints.push(joint);
    }
    all.inside = all.outside == 0;
    all
}

fn one(
    drive: &JointLog,
    end_t_s: f64,
    certified: &Certified,
    beyond: &mut [usize; 3],
    mut found: impl FnMut(f64, What, f64, f64),
) -> JointCoverage {
    let mut joint = JointCoverage::default();
    let period_s = certified.period_s;
    let commands: Vec<f64> =
        drive.commands.iter().map(|c| c.t_s).filter(|t_s| (0.0..=end_t_s).contains(t_s)).collect();
    // The measurement that answers the command at `from`: before the next one, or within a period.
    let measured = |from: f64, until: f64| {
        let first = drive.positions.partition_point(|reading| reading.t_s < from);
        drive.positions.get(first).map(|reading| reading.t_s).filter(|t_s| *t_s < until)
    };
    for (i, pair) in commands.windows(2).enumerate() {
        let (first, second) = (pair[0], pair[1]);
        let third = commands.get(i + 2).copied().unwrap_or(second + period_s);
        joint.intervals += 1;
        let mut outside = false;
        let mut judge = |what, value_s: f64, excess_s: f64, is_inside: bool| {
            if !is_inside {
                outside = true;
                found(second, what, value_s, excess_s);
            }
        };
        let excess = |s: f64| (s - period_s).abs() - certified.jitter_ratio * period_s;
        let command_s = second - first;
        Range::take(&mut joint.command_interval_s, command_s);
        joint.command_intervals.push(Reading { t_s: second, value: command_s });
        for (count, share) in beyond.iter_mut().zip([0.02, 0.05, 0.1]) {
            *count += usize::from((command_s - period_s).abs() > share * period_s);
        }
        judge(What::CommandInterval, command_s, excess(command_s), certified.covers(command_s));
        match (measured(first, second), measured(second, third)) {
            (Some(before), Some(after)) => {
                let interval_s = after - before;
                Range::take(&mut joint.measurement_interval_s, interval_s);
                judge(
                    What::MeasurementInterval,
                    interval_s,
                    excess(interval_s),
                    certified.covers(interval_s),
                );
                let delay_s = second - before;
                joint.delay_shares.push(Reading { t_s: second, value: delay_s / interval_s });
                Range::take(&mut joint.delay_s, delay_s);
                let [least_s, most_s] = certified.delay_shares().map(|share| share * interval_s);
                let excess_s = (least_s - delay_s).max(delay_s - most_s);
                judge(What::Delay, delay_s, excess_s, excess_s <= 1e-6);
            }
            _ => judge(What::Unanswered, 0.0, period_s, false),
        }
        joint.outside += usize::from(outside);
    }
    joint
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::collect::Commanded;

    const CERTIFIED: Certified =
        Certified { period_s: 0.003, jitter_ratio: 0.25, delay_min_s: 0.00225, delay_max_s: 0.003 };

    /// Commands at these times, each answered 0.2 ms later.
    fn heard(commands_ms: &[f64]) -> Heard {
        let mut drive = JointLog::default();
        for ms in commands_ms {
            let t_s = 1e-3 * ms;
            drive.commands.push(Commanded { t_s, target_rad: 0.0, v_rad_s: None, a_rad_s2: None });
            drive.positions.push(Reading { t_s: t_s + 2e-4, value: 0.0 });
        }
        Heard { joints: vec![drive], ..Heard::default() }
    }

    #[test]
    fn run_whose_commands_keep_the_period_is_inside() {
        let coverage = coverage(&heard(&[1.0, 4.0, 7.1, 10.0]), 1.0, CERTIFIED);
        assert!(coverage.inside, "{coverage:?}");
        assert_eq!((coverage.intervals, coverage.beyond_2_5_10_percent), (3, [2, 0, 0]));
        assert!(coverage.sentence().starts_with("timing inside"), "{}", coverage.sentence());
    }

    #[test]
    fn run_with_one_late_command_is_outside_and_says_which() {
        let coverage = coverage(&heard(&[1.0, 4.0, 8.2, 10.0]), 1.0, CERTIFIED);
        assert_eq!((coverage.inside, coverage.outside), (false, 2));
        let worst = coverage.worst.unwrap();
        assert_eq!((worst.joint, worst.what), (1, What::CommandInterval));
        assert!((worst.value_s - 0.0042).abs() < 1e-9 || (worst.value_s - 0.0018).abs() < 1e-9, "{worst:?}");
        assert!(coverage.sentence().starts_with("warning: the timing left"), "{}", coverage.sentence());
    }

    #[test]
    fn command_without_an_answer_and_one_too_soon_after_its_measurement_are_outside() {
        let mut lost = heard(&[1.0, 4.0, 7.0]);
        lost.joints[0].positions.remove(1);
        let found = coverage(&lost, 1.0, CERTIFIED);
        assert_eq!((found.outside, found.worst.unwrap().what), (2, What::Unanswered));
        let mut slow = heard(&[1.0, 4.0, 7.0]);
        for reading in &mut slow.joints[0].positions {
            reading.t_s += 1e-3;
        }
        let found = coverage(&slow, 1.0, CERTIFIED);
        assert_eq!((found.outside, found.worst.unwrap().what), (2, What::Delay));
    }

    /// Found with gains for a third of the delay: reported inside, although every command acts 2.8 ms after its measurement.
    #[test]
    fn command_too_late_after_its_measurement_is_outside() {
        let soon = Certified { delay_min_s: 0.00075, delay_max_s: 0.001, ..CERTIFIED };
        let found = coverage(&heard(&[1.0, 4.0, 7.0]), 1.0, soon);
        let worst = found.worst.unwrap();
        assert_eq!((found.inside, found.outside, worst.what), (false, 2, What::Delay));
        assert!((worst.value_s - 0.0028).abs() < 1e-9, "{worst:?}");
        assert!(found.sentence().ends_with("delay 25 to 33 % of the interval)"), "{}", found.sentence());
    }
}
