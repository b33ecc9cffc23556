//! `cubectl catch`: a disc with a four-axis arm, or a ball with a six-axis arm.

mod ball;
pub mod catching;
mod disc;
pub mod for_programs;
pub mod on_bus;
mod on_controller;
pub mod outcome;
mod over_bus;
pub mod record;
mod witness_words;

use std::path::PathBuf;

use self::catching::Catching;
use super::meaning::{Deed, Given};
use crate::error::ExpectedError;

pub use disc::DiscName;
pub use over_bus::OverBus;

#[derive(Debug, clap::Args, serde::Deserialize)]
#[command(
    after_help = "Examples:\n  cubectl catch --robot pincher4 --disc flat --report catch.html\n  cubectl catch --disc oblique --no-limits                            # only the rule of the paper\n  cubectl catch --start 0.5,-2.2,0.7 --velocity 0,3.8,1.5 --air --wind 0.5,0,0\n  cubectl catch --disc flat --on-controller\n  cubectl catch --robot powercube6 --ball 2.2,0.1,0.4,-2.6,-0.1,3.0 --report ball.html\n  cubectl catch --bus can0 --tracker 0.0.0.0:5000 --calibration room.toml      # a ball that somebody throws\n\nThe rule of the paper knows no joint limits: it shows where its steps end, what the gripper has there, and which joint\nspeeds it demands. The plan keeps the limits of the robot file. Both are judged by the geometry of disc and gripper.\n\nA ball is seen by a simulated tracker (120 Hz, 2 mm, 15 ms) and caught with a cup by an arm with the lag of its drives, in virtual\ntime. Whether it is caught is decided by the simulated contact of ball and cup.\n\nWith --bus an arm catches a ball that somebody throws, or declines: what is reported is what its tracker shows. The arm homes\nif it was not, and goes to its waiting pose free of contact with itself, the floor and what the cell has."
)]
pub struct Args {
    #[command(flatten)]
    #[serde(rename = "+given")]
    pub given: Given,
    /// Robot, by name or file: four axes for a disc (pincher4), six for a ball (powercube6).
    #[arg(long)]
    pub robot: Option<String>,
    /// A throw of the paper.
    #[arg(long, required_unless_present_any = ["start", "ball", "bus"])]
    pub disc: Option<DiscName>,
    /// Centre of the disc at time 0, m; instead of the one of `--disc`.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = crate::cmd::values::numbers::<3>)]
    pub start: Option<[f64; 3]>,
    /// Velocity of the disc at time 0, m/s; instead of the one of `--disc`.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = crate::cmd::values::numbers::<3>)]
    pub velocity: Option<[f64; 3]>,
    /// Fly the disc with lift and drag of a spinning disc instead of on a parabola.
    #[arg(long)]
    pub air: bool,
    /// Wind, m/s.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = crate::cmd::values::numbers::<3>)]
    pub wind: Option<[f64; 3]>,
    /// Spin of the disc, rad/s.
    #[arg(long, alias = "spin", default_value_t = 50.0, value_name = "RAD/S", allow_hyphen_values = true)]
    pub spin_rad_s: f64,
    /// Only the rule of the paper, without joint limits.
    #[arg(long, conflicts_with_all = ["air", "jerk"])]
    pub no_limits: bool,
    /// Run the plan on a controller with four simulated drives, in virtual time, and judge the joints as they moved.
    #[arg(long, conflicts_with_all = ["ball", "no_limits"])]
    #[serde(skip)]
    pub on_controller: bool,
    /// A ball: place (m) and velocity (m/s) at time 0 in the base frame of the arm; instead of a disc.
    #[arg(
        long,
        value_name = "X,Y,Z,VX,VY,VZ",
        allow_hyphen_values = true,
        value_parser = crate::cmd::values::numbers::<6>,
        conflicts_with_all = ["disc", "start", "velocity", "air", "no_limits"]
    )]
    pub ball: Option<[f64; 6]>,
    #[command(flatten)]
    #[serde(rename = "+catching")]
    pub catching: Catching,
    /// The catcher knows beforehand where the ball starts and how fast.
    #[arg(long, conflicts_with_all = ["disc", "start"])]
    pub cooperative: bool,
    /// Where an arm is that catches a real ball.
    #[command(flatten)]
    #[serde(rename = "+over_bus")]
    pub over_bus: OverBus,
    /// Write a report with paths, joint angles, distances and an animation.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub report: Option<PathBuf>,
    /// Print the result as JSON.
    #[arg(long)]
    #[serde(skip)]
    pub json: bool,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    args.require_meaning()?;
    match (&args.over_bus.bus, &args.over_bus.tracker, &args.ball) {
        (Some(bus), Some(tracker), _) => over_bus::run(args, bus, tracker),
        (.., Some(ball)) => ball::run(args, ball),
        _ => disc::run(args),
    }
}

impl Args {
    fn require_meaning(&self) -> Result<(), ExpectedError> {
        let asked = [(!self.air, Deed::NoAir), (self.ball.is_none(), Deed::NoBall)];
        let deeds: Vec<Deed> = asked.into_iter().filter(|(asked, _)| *asked).map(|(_, deed)| deed).collect();
        self.given.require_meaning(&deeds)
    }
}
