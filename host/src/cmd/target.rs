//! Options that several verbs share: which controller, how the arm moves, and what it must not touch.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use nalgebra::Vector3;
use operator::bus::key_file::KeyArgs;
use operator::bus::{BusArgs, Session};
use operator::interrupt::interrupt;
use protocol::cyphal::id::NodeId;
use robot_model::Pose;
use robot_model::collision::{Obb, Scene};

use super::consent::Consent;
use super::progress::{ProgressView, Ui};
use super::web::WebArgs;
use crate::error::ExpectedError;

#[derive(Clone, Debug, clap::Args)]
pub struct Target {
    /// Bus options; on the bus `sim` a controller is in the cell.
    #[command(flatten)]
    pub bus: BusArgs,
    /// The key that the controller has now.
    #[command(flatten)]
    pub key: KeyArgs,
    /// Cyphal node-ID of the controller. Default: the one that is heard.
    #[arg(long, value_name = "NODE-ID", value_parser = super::values::node_id)]
    pub controller: Option<NodeId>,
}

impl Target {
    pub(super) fn session(&self) -> Result<Session, ExpectedError> {
        self.session_until(interrupt())
    }

    /// The same; it ends once `stop` is set.
    pub(super) fn session_until(&self, stop: Arc<AtomicBool>) -> Result<Session, ExpectedError> {
        let key = self.key.load()?;
        let mut session = self.bus.open_with_controller_until(stop)?;
        session.set_key(key);
        Ok(session)
    }

    /// The session with the key, and the controller.
    pub(super) fn open(&self) -> Result<(Session, NodeId), ExpectedError> {
        let mut session = self.session()?;
        let node = session.find_controller(self.controller)?;
        session.find_drives()?;
        Ok((session, node))
    }

    /// The same with the robot of the description, where a robot that is led is not named.
    pub(super) fn of_robot(&self) -> Result<Self, ExpectedError> {
        let mut on = self.clone();
        if let (None, Some((_, described, _))) = (&on.bus.cell.robot, super::rsi::robot_on(&on.bus)?) {
            on.bus.cell.robot = Some(described.robot);
        }
        Ok(on)
    }
}

/// An arm that moves, and the person who lets it.
#[derive(Debug, clap::Args)]
pub struct Moving {
    #[command(flatten)]
    pub on: Target,
    /// Home what is not homed first.
    #[arg(long)]
    pub home: bool,
    /// Do not ask before the arm moves.
    #[arg(long)]
    pub yes: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub web: WebArgs,
}

impl Moving {
    /// The person, who is asked `question` before the first motion, if the verb `moves` the arm.
    ///
    /// # Errors
    /// [`crate::exit::USAGE`] where a person must be asked and there is no terminal.
    pub(super) fn ui(&self, question: &'static str, moves: bool) -> Result<Ui, ExpectedError> {
        let consent = Consent::on(&self.on.bus.bus, self.yes || !moves)?;
        Ok(Ui {
            progress: ProgressView::new(self.json),
            consent,
            words: [question; 2],
            look: None,
            agreed: false,
        })
    }
}

/// How fast an arm moves, and what it must not touch.
#[derive(Debug, clap::Args)]
pub struct Bounds {
    /// Share of the robot's speeds, accelerations and jerks.
    #[arg(long, default_value_t = 0.2, value_name = "SHARE", value_parser = super::values::share)]
    pub speed_share: f64,
    /// Box that nothing may touch: centre and half edge lengths in m, base frame. May be given more than once.
    #[arg(long, value_name = "X,Y,Z,HX,HY,HZ", allow_hyphen_values = true, value_parser = super::values::numbers::<6>)]
    pub obstacle: Vec<[f64; 6]>,
    /// The ball is in the hand and must not touch anything either.
    #[arg(long)]
    pub ball: bool,
}

impl Bounds {
    pub(super) fn scene(&self) -> Scene {
        scene(&self.obstacle, self.ball)
    }
}

/// Boxes that nothing may touch (centre and half edge lengths, m, base frame), and whether a ball is in the hand.
#[must_use]
pub fn scene(obstacles: &[[f64; 6]], ball_held: bool) -> Scene {
    let named = |(b, k): (&[f64; 6], usize)| {
        let obb = Obb::new(Pose::translation(b[0], b[1], b[2]), Vector3::new(b[3], b[4], b[5]));
        (format!("obstacle {k}"), obb)
    };
    Scene { obstacles: obstacles.iter().zip(1..).map(named).collect(), ball_held }
}
