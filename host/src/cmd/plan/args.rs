//! Arguments of `cubectl plan throw`.

use std::path::PathBuf;

use super::follow_options::FollowOptions;
use super::search::SearchOptions;
use crate::cmd::meaning::Given;

#[derive(Debug, clap::Args, serde::Deserialize)]
#[command(
    after_help = "Examples:\n  cubectl plan throw --target 1.0,1.0,-1.0 --out plan.json --report plan.html\n  cubectl plan throw --target 2.0,0,0 --starts 400 --json\n  cubectl plan throw --robot kr16_2 --target 2.5,0,0.6 --form paper --report plan.html\n  cubectl plan throw --target 1.6,0.2,-0.3 --opening-normal=-1,0,0 --opening-radius-m 0.08 --out plan.json\n  cubectl plan throw --target 1.3,-0.3,-0.6 --target-velocity 0.3,0.5,0 --out plan.json"
)]
pub struct Args {
    #[command(flatten)]
    #[serde(rename = "+given")]
    pub given: Given,
    /// Where the centre of the ball comes down, in m, world frame (arm base, z up).
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = crate::cmd::values::numbers::<3>)]
    pub target: [f64; 3],
    #[command(flatten)]
    #[serde(rename = "+search")]
    pub search: SearchOptions,
    /// Plan file to write.
    #[arg(long)]
    #[serde(skip)]
    pub out: Option<PathBuf>,
    /// Report to write: one HTML file that opens offline.
    #[arg(long)]
    #[serde(skip)]
    pub report: Option<PathBuf>,
    /// Print the plan as JSON.
    #[arg(long)]
    #[serde(skip)]
    pub json: bool,
    /// Seed of the random starts.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Take the first stored throw that leads there, in about a millisecond; it may cost 8 % more than the best one. If none does, a
    /// search follows, and the answer says so.
    #[arg(long)]
    pub fast: bool,
    /// Throws that follow the flight.
    #[command(flatten)]
    #[serde(rename = "+follow")]
    pub follow: FollowOptions,
}
