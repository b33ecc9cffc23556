//! Result of the measurements of one joint: constants with intervals or the reason why there is no result, as text
//! and as a patch of the robot file.

use std::fmt::Write as _;

use super::current::{CurrentConstant, HoldSample, k_b, k_m};
use super::lag::{DriveAnswer, identify};
use super::regression::{Estimate, RegressionError};
use super::samples::{HOLD_READINGS, Speeds, Steps};
use crate::model::DriveLag;

/// Relative half width beyond which a load is not measured.
const WORTH: f64 = 0.25;
/// Relative half width of the natural frequency up to which it and the damping are stated and go into the patch.
const SHARP: f64 = 0.05;

/// Whether natural frequency and damping may be relied on.
fn is_sharp(answer: &DriveAnswer) -> bool {
    answer.wn_rad_s.half_width < SHARP * answer.wn_rad_s.value
}

/// The joint and the values in its robot file.
#[derive(Clone, Debug, PartialEq)]
pub struct Subject {
    pub robot: String,
    /// Bus on which was measured.
    pub bus: String,
    /// Joint number from 1.
    pub joint: usize,
    pub name: String,
    pub module: String,
    pub address: u8,
    /// Which angles of the joints the drives read, and the source of this.
    pub mounting: String,
    /// K_B of the file, A s/rad.
    pub k_b_a_s_rad: f64,
    /// K_M of the file, A/(N m).
    pub k_m_a_nm: f64,
    /// Position loop of the file.
    pub drive: DriveLag,
}

/// Holding currents, or the reason why there are none.
#[derive(Clone, Debug, PartialEq)]
pub enum Holds {
    Measured {
        samples: Vec<HoldSample>,
        /// Largest load that the arm can put on the joint, N m.
        largest_nm: f64,
    },
    /// Gravity does not load this joint.
    NotLoaded,
    /// It does, but the current of that load drowns in the noise.
    BelowNoise {
        /// Largest load that the arm can put on the joint, N m.
        largest_nm: f64,
        /// Current of that load by the robot file, A.
        expected_a: f64,
        /// Standard deviation of a reading, A.
        scatter_a: f64,
    },
}

impl Holds {
    /// Whether loads of up to `largest_nm` should be measured with a mean of `readings` readings of `scatter_a`
    /// each: a rough forecast of the interval of K_M.
    pub fn are_worth(largest_nm: f64, k_m_a_nm: f64, scatter_a: f64, holds: usize) -> bool {
        // Loads spread evenly from end to end have a standard deviation of 0.6 of the largest; Student's factor is 2.3.
        let error_a = scatter_a / (HOLD_READINGS as f64).sqrt();
        2.3 * error_a / (0.6 * largest_nm * (holds as f64).sqrt()) < WORTH * k_m_a_nm
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    pub speeds: Speeds,
    /// Mean |load| over the stretch of the steady speeds, N m.
    pub speed_load_nm: f64,
    /// Largest speed of the joint, rad/s.
    pub speed_max_rad_s: f64,
    pub holds: Holds,
    /// Steps of acceleration.
    pub steps: Steps,
}

/// A share in percent, to a tenth.
fn percent(share: f64) -> f64 {
    (1e3 * share).round() / 10.0
}

/// Smallest, mean and largest time from a question to its answer, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnswerTime {
    /// Smallest.
    pub min_s: f64,
    pub mean_s: f64,
    /// Largest.
    pub max_s: f64,
    pub count: usize,
}

/// Conclusions.
#[derive(Clone, Debug, PartialEq)]
pub struct Findings {
    /// About what.
    pub subject: Subject,
    /// Confidence level of every interval.
    pub level: f64,
    pub measured: Measured,
    /// K_B, A s/rad.
    pub k_b: Result<CurrentConstant, RegressionError>,
    /// K_M, A/(N m); `None` if the arm cannot load the joint.
    pub k_m: Option<Result<CurrentConstant, RegressionError>>,
    /// Position loop.
    pub answer: Result<DriveAnswer, RegressionError>,
    /// Answer delay; `None` without answers.
    pub answer_time: Option<AnswerTime>,
}

impl Findings {
    /// Concludes with confidence `level`.
    pub fn of(subject: Subject, measured: Measured, level: f64) -> Self {
        let k_b = k_b(&measured.speeds.samples, measured.speed_max_rad_s, level);
        let k_m = match &measured.holds {
            Holds::Measured { samples, largest_nm } => Some(k_m(samples, *largest_nm, level)),
            Holds::NotLoaded | Holds::BelowNoise { .. } => None,
        };
        let steps = &measured.steps;
        let answer = identify(&steps.samples, steps.acceleration_rad_s2, (1e-3, subject.drive), level);
        let answers = &steps.answers_s;
        let answer_time = (!answers.is_empty()).then(|| AnswerTime {
            min_s: answers.iter().copied().fold(f64::INFINITY, f64::min),
            mean_s: answers.iter().sum::<f64>() / answers.len() as f64,
            max_s: answers.iter().copied().fold(0.0, f64::max),
            count: answers.len(),
        });
        Self { subject, level, measured, k_b, k_m, answer, answer_time }
    }

    /// Current that overcomes friction, A: what the regression of the steady speeds leaves at speed zero, less the
    /// mean load.
    pub fn friction_a(&self) -> Option<Estimate> {
        let k_b = self.k_b.as_ref().ok()?;
        let (k_m, k_m_half_width) = match &self.k_m {
            Some(Ok(k_m)) => (k_m.k.value, k_m.k.half_width),
            _ => (self.subject.k_m_a_nm, 0.0),
        };
        let load_nm = self.measured.speed_load_nm;
        Some(Estimate {
            value: k_b.friction_a.value - k_m * load_nm,
            half_width: k_b.friction_a.half_width.hypot(k_m_half_width * load_nm),
        })
    }

    /// Why the loads were not measured.
    pub fn no_load(&self) -> Option<String> {
        match self.measured.holds {
            Holds::Measured { .. } => None,
            Holds::NotLoaded => Some(
                "gravity does not load this joint in any pose; K_M of the file stays (measure a module of the same \
                 type at a joint that carries load)"
                    .to_owned(),
            ),
            Holds::BelowNoise { largest_nm, expected_a, scatter_a } => Some(format!(
                "gravity loads this joint with at most {largest_nm:.2} N m, {expected_a:.4} A, while a reading scatters \
                 by {scatter_a:.3} A; K_M of the file stays (mount a known mass on the hand and put it into the robot \
                 file to measure it)"
            )),
        }
    }

    /// Everything that was to be concluded and was not.
    pub fn refusals(&self) -> Vec<String> {
        let mut list = Vec::new();
        let mut add = |what: &str, refusal: Option<&RegressionError>| {
            list.extend(refusal.map(|refusal| format!("{what}: {refusal}")));
        };
        add("K_B", self.k_b.as_ref().err());
        add("K_M", self.k_m.as_ref().and_then(|k_m| k_m.as_ref().err()));
        add("position loop", self.answer.as_ref().err());
        list
    }

    /// For the terminal.
    pub fn text(&self) -> String {
        let s = &self.subject;
        let mut t = format!(
            "{}: joint {} ({}, module {}) on {}; intervals hold with {} %\n  joint angles: {}\n",
            s.robot,
            s.joint,
            s.module,
            s.address,
            s.bus,
            percent(self.level),
            s.mounting
        );
        let mut line = |name: &str, e: &Estimate, unit: &str, file: Option<f64>| {
            let in_file = file.map_or(String::new(), |f| format!("   robot file {f}"));
            let _ = writeln!(t, "  {name:<22} {:>10.5} +- {:<9.5} {unit:<8}{in_file}", e.value, e.half_width);
        };
        if let Ok(k_b) = &self.k_b {
            line("K_B", &k_b.k, "A s/rad", Some(s.k_b_a_s_rad));
        }
        if let Some(Ok(k_m)) = &self.k_m {
            line("K_M", &k_m.k, "A/(N m)", Some(s.k_m_a_nm));
        }
        if let Some(friction) = self.friction_a() {
            line("friction, moving", &friction, "A", None);
        }
        if let Some(Ok(k_m)) = &self.k_m {
            line("friction, holding", &k_m.friction_a, "A", None);
        }
        if let Ok(answer) = &self.answer {
            let ms = |e: &Estimate| Estimate { value: 1e3 * e.value, half_width: 1e3 * e.half_width };
            if is_sharp(answer) {
                line("natural frequency", &answer.wn_rad_s, "rad/s", Some(s.drive.wn_rad_s));
                line("damping ratio", &answer.zeta, "", Some(s.drive.zeta));
            }
            line("delay of the command", &ms(&answer.delay_s), "ms", None);
            line("delay + lag", &ms(&answer.total_lag_s), "ms", None);
            if !is_sharp(answer) {
                let _ = writeln!(
                    t,
                    "  (a natural frequency of {:.1} rad/s and a damping ratio of {:.2} fit best, but friction and the\n   \
                     pose's inertia, which the fit leaves out, bend both: no interval is stated for them;\n   \
                     delay + lag, which the control counts on, stays)",
                    answer.wn_rad_s.value, answer.zeta.value
                );
            }
        }
        if let Some(time) = self.answer_time {
            let _ = writeln!(
                t,
                "  {:<22} {:>10.3} ms mean, {:.3} to {:.3} ms, {} answers",
                "answer delay",
                1e3 * time.mean_s,
                1e3 * time.min_s,
                1e3 * time.max_s,
                time.count
            );
        }
        if let Some(why) = self.no_load() {
            let _ = writeln!(t, "  K_M not measured: {why}");
        }
        for refusal in self.refusals() {
            let _ = writeln!(t, "  refused: {refusal}");
        }
        t
    }

    /// Keys of the robot file that the measurements change, with their intervals as comments.
    pub fn patch(&self) -> String {
        let s = &self.subject;
        let mut t = format!(
            "# Measured by `cubectl arm identify` on {}: joint {} ({}), {} % intervals.\n# Replace the same keys in the \
             file of robot {}.\n\n[[joint]]\nname = \"{}\"\n",
            s.bus,
            s.joint,
            s.module,
            percent(self.level),
            s.robot,
            s.name
        );
        let key = |t: &mut String, name: &str, e: &Estimate| {
            let _ = writeln!(t, "{name} = {:.6} # +- {:.6}", e.value, e.half_width);
        };
        let k_m = self.k_m.as_ref().and_then(|k_m| k_m.as_ref().ok());
        if self.k_b.is_ok() || k_m.is_some() {
            t += "\n[joint.drive]\n";
        }
        if let Ok(k_b) = &self.k_b {
            key(&mut t, "k_b_a_s_rad", &k_b.k);
        }
        if let Some(k_m) = k_m {
            key(&mut t, "k_m_a_nm", &k_m.k);
        }
        // Only a sharp result may replace the file's.
        if let Ok(answer) = &self.answer
            && is_sharp(answer)
        {
            t += "\n[drive_loop]\n";
            key(&mut t, "natural_frequency_rad_s", &answer.wn_rad_s);
            key(&mut t, "damping_ratio", &answer.zeta);
        }
        t
    }
}
