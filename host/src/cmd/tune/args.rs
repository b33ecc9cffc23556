//! The command line of `cubectl tune`.

use std::path::PathBuf;

use tuner::gains::machine::START_ERROR;

use crate::cmd::request::{self, readers};
use crate::cmd::target::Target;

/// Which design to use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DesignArg {
    /// Theorem 1 of the paper: continuous time, never saturates.
    Paper,
    /// Discrete time with delay and drive lag, saturation certified.
    Saturated,
}

/// Joints to tune: `all` or a number from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Joints {
    All,
    /// One, from 1.
    One(usize),
}

impl std::str::FromStr for Joints {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self::All),
            _ => match text.parse() {
                Ok(n) if n >= 1 => Ok(Self::One(n)),
                _ => Err("expected `all` or a joint number from 1".into()),
            },
        }
    }
}

/// Arguments of `cubectl tune`.
#[derive(Clone, Debug, clap::Args, serde::Deserialize)]
#[command(
    after_help = "Examples:\n  cubectl tune --plan throw.json --out gains.toml --report gains.html\n  cubectl tune --period-ms 17 --joint 2 --design paper\n  cubectl tune --plan throw.json --apply --bus can0\n  cubectl tune --rollback gains-before.toml --bus can0\n  cubectl tune --compare a.toml b.toml --log throw1\n\nThe exit code is 9 if the errors asked for cannot be certified; the gains are then for the largest that can be, and are not\napplied.\n--apply keeps the gains from before in --backup; the controller takes gains only while nothing moves\nand nothing is armed."
)]
pub struct Args {
    /// The controller; `--robot` names the robot model.
    #[command(flatten)]
    #[serde(skip, default = "request::usual")]
    pub on: Target,
    /// Joint number from 1, or `all`.
    #[arg(long, default_value = "all")]
    #[serde(deserialize_with = "joints_of")]
    pub joint: Joints,
    /// Command period in ms; the firmware refuses gains for another one.
    #[arg(long, alias = "period", default_value_t = 3.0, value_name = "MS", allow_negative_numbers = true, value_parser = milliseconds)]
    #[serde(deserialize_with = "milliseconds_of")]
    pub period_ms: f64,
    /// Relative jitter of the period that the certificate covers [default: 2 ms, at least 0.1 and at most 0.25].
    #[arg(long, value_name = "RATIO", allow_negative_numbers = true)]
    pub jitter: Option<f64>,
    /// Largest delay from position sample to action of the command in ms [default: one period].
    #[arg(long, alias = "delay", value_name = "MS", allow_negative_numbers = true, value_parser = milliseconds)]
    #[serde(default, deserialize_with = "milliseconds_of")]
    pub delay_ms: Option<f64>,
    /// Smallest delay in ms [default: the largest less the jitter].
    #[arg(long, alias = "delay-min", value_name = "MS", allow_negative_numbers = true, value_parser = milliseconds)]
    #[serde(default, deserialize_with = "milliseconds_of")]
    pub delay_min_ms: Option<f64>,
    /// Weight of a measurement on the position error in the controller's estimator, above 0 to 1 [default: 0.6, from a
    /// period of 10 ms on 1].
    #[arg(long, value_name = "WEIGHT", allow_negative_numbers = true)]
    pub estimator_alpha: Option<f64>,
    /// Weight on the rate of the error [default: 0.2, from a period of 10 ms on 1].
    #[arg(long, value_name = "WEIGHT", allow_negative_numbers = true)]
    pub estimator_beta: Option<f64>,
    /// Plan whose accelerations are set aside for the reference (file of `cubectl plan throw`).
    #[arg(long, value_name = "PLAN", conflicts_with = "reference_share")]
    pub plan: Option<PathBuf>,
    /// Without a plan: share of the acceleration for control that a motion uses.
    #[arg(long, default_value_t = 0.8, value_name = "RATIO", allow_negative_numbers = true)]
    pub reference_share: f64,
    /// Initial errors to recover from: position in rad and velocity in rad/s, one number for both or two. The default is how
    /// far from its start the controller starts a plan. If they cannot be certified, the largest ones that can be are designed
    /// for, and the exit code is 9.
    #[arg(long, num_args = 1..=2, default_values_t = [START_ERROR], value_names = ["RAD", "RAD_S"], allow_negative_numbers = true)]
    pub error: Vec<f64>,
    /// Design.
    #[arg(long, value_enum, default_value_t = DesignArg::Saturated)]
    pub design: DesignArg,
    /// Gains file to write.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub out: Option<PathBuf>,
    /// Page with the answer, the loop and the certificate of each joint as pictures.
    #[arg(long, value_name = "FILE.html")]
    #[serde(skip)]
    pub report: Option<PathBuf>,
    /// Compare the gains of two files in the same throws instead of designing: those of --log and --plan, or a swing.
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with_all = ["apply", "out", "report", "rollback", "no_trial", "joint", "error"])]
    #[serde(skip)]
    pub compare: Vec<PathBuf>,
    /// Folder of a recorded throw to compare in, as often as there are throws: simulated with both, and as measured.
    #[arg(long, value_name = "FOLDER", requires = "compare")]
    #[serde(skip)]
    pub log: Vec<PathBuf>,
    /// Print the tables as JSON.
    #[arg(long)]
    #[serde(skip)]
    pub json: bool,
    /// Do not try the gains on the simulated cell.
    #[arg(long)]
    #[serde(skip)]
    pub no_trial: bool,
    /// Write the gains to the controller on the bus, and read them back.
    #[arg(long)]
    #[serde(skip)]
    pub apply: bool,
    /// Where --apply keeps the gains from before.
    #[arg(long, value_name = "FILE", default_value = "gains-before.toml")]
    #[serde(rename = "-backup")]
    pub backup: PathBuf,
    /// Put the gains of such a file back; nothing is designed.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["apply", "out", "report", "plan"])]
    #[serde(skip)]
    pub rollback: Option<PathBuf>,
}

readers! {
    joints_of: str::parse => Joints;
    milliseconds_of: milliseconds => f64;
}

/// A time in ms. One that can only be meant in seconds is refused here; the rest is judged with the machine.
fn milliseconds(text: &str) -> Result<f64, String> {
    let ms: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if ms > 0.0 && ms < 0.1 {
        return Err(format!("times are given in ms; {ms} s would be {}", 1e3 * ms));
    }
    Ok(ms)
}
