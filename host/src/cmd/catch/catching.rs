//! How a ball is caught: options that `cubectl catch --ball` and `cubelab rally` share.

use std::path::PathBuf;

use hil_sim::two_arms::TwoArmOptions;
use operator::ball_catch::thrower::ThrowFault;
use operator::ball_catch::trial::{TrialFault, TrialOptions, WAIT_HOLD_DEG, WAIT_MATCHED_DEG};
use planner::catch::Joints;
use planner::catch::task::{Allowed, Settings};

use crate::cmd::request::readers;
use crate::error::ExpectedError;

#[derive(Debug, clap::Args, serde::Deserialize)]
pub struct Catching {
    /// A cell file: places of the arms, ball, cup, tracker; the built-in one otherwise.
    #[arg(long, value_name = "FILE", alias = "court")]
    pub cell: Option<PathBuf>,
    /// Which catches are allowed.
    #[arg(long, default_value = "either", value_name = "KIND")]
    pub hand: Hand,
    /// Keep the jerk limits as well.
    #[arg(long)]
    pub jerk: bool,
    /// Restitution of ball and cup that the catcher counts on; otherwise that of the cell, with which the ball bounces.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    #[serde(default, deserialize_with = "share_of")]
    pub restitution: Option<f64>,
    /// Something that goes wrong; may be given several times.
    #[arg(long = "fault", alias = "trouble", value_name = "KIND[:VALUE]", value_parser = fault,
        help = "Something that goes wrong; may be given several times: tracker-dead:S, frames-lost:SHARE, bias:MM, false-markers:N, drive-lost:S, thrower-stops:S, not-released (times in s after the release, thrower-stops before it)")]
    #[serde(rename = "fault", deserialize_with = "faults_of")]
    pub faults: Vec<TrialFault>,
    /// Seed of all chance.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Kinds of catches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Hand {
    /// The hand moves with the ball: at most 2 m/s between them.
    Matched,
    /// The hand stands still.
    Hold,
    /// Both; matched is preferred.
    Either,
}

readers! {
    share_of: share => f64;
}

fn faults_of<'de, D: serde::Deserializer<'de>>(data: D) -> Result<Vec<TrialFault>, D::Error> {
    let texts: Vec<String> = serde::Deserialize::deserialize(data)?;
    texts.iter().map(|text| fault(text)).collect::<Result<_, _>>().map_err(serde::de::Error::custom)
}

fn share(text: &str) -> Result<f64, String> {
    let share = text.parse().ok().filter(|share| (0.0..=1.0).contains(share));
    share.ok_or_else(|| format!("'{text}' is no number from 0 to 1"))
}

fn fault(text: &str) -> Result<TrialFault, String> {
    let (kind, value) = text.split_once(':').map_or((text, None), |(kind, value)| (kind, Some(value)));
    let number = |low: f64, high: f64| {
        let value: f64 =
            value.unwrap_or("").parse().map_err(|_| format!("{kind} needs a number: {kind}:VALUE"))?;
        if (low..=high).contains(&value) { Ok(value) } else { Err(format!("{kind}: from {low} to {high}")) }
    };
    match kind {
        "tracker-dead" => Ok(TrialFault::TrackerDead { at_s: number(-5.0, 5.0)? }),
        "frames-lost" => Ok(TrialFault::FramesLost { probability: number(0.0, 1.0)? }),
        "bias" => Ok(TrialFault::Bias { by_mm: number(-1000.0, 1000.0)? }),
        "false-markers" => Ok(TrialFault::FalseMarkers { count: number(0.0, 20.0)? as u32 }),
        "drive-lost" => Ok(TrialFault::DriveLost { at_s: number(-5.0, 5.0)? }),
        "thrower-stops" => Ok(TrialFault::Throw(ThrowFault::Stops { before_s: number(0.01, 1.0)? })),
        "not-released" => Ok(TrialFault::Throw(ThrowFault::NotReleased)),
        _ => Err(format!(
            "'{kind}' is none of tracker-dead, frames-lost, bias, false-markers, drive-lost, thrower-stops, not-released"
        )),
    }
}

impl Catching {
    pub fn trial(&self) -> TrialOptions {
        let (allowed, wait) = match self.hand {
            Hand::Matched => (Allowed::Matched, WAIT_MATCHED_DEG),
            Hand::Hold => (Allowed::Hold, WAIT_HOLD_DEG),
            Hand::Either => (Allowed::Either, WAIT_HOLD_DEG),
        };
        TrialOptions {
            settings: Settings { allowed, ..Settings::default() },
            jerk: self.jerk,
            restitution: self.restitution,
            wait: Joints::from(wait.map(f64::to_radians)),
            faults: self.faults.clone(),
            ..TrialOptions::default()
        }
    }

    /// The cell of the file, or the built-in one.
    pub fn cell(&self) -> Result<TwoArmOptions, ExpectedError> {
        let cell = self.cell.as_ref().map_or_else(TwoArmOptions::two_arms, |file| TwoArmOptions::load(file));
        cell.map_err(|why| ExpectedError::bad_input(&why))
    }
}
