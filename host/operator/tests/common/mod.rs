//! A throw to plan, and a session with a homed group.

use nalgebra::Vector3;
use operator::bus::{BusArgs, Session};
use planner::plan::file::PlanFile;
use planner::plan::problem::{Options, Problem};
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::statistics::Noise;
use planner::plan::{Arm, seeds};
use protocol::Duration;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;

/// The throw of the README, from the stored starts and two random ones.
pub(crate) fn plan() -> (Arm, PlanFile) {
    let arm = Arm::load("powercube6").expect("built in");
    let problem = Problem::new(&arm, Vector3::new(1.0, 1.0, -1.0), Options::best()).expect("valid");
    let budget = Budget { starts: 2, all: false, time: None, seed: 1 };
    let best =
        Planner::new(&problem).search(&seeds::built_in(&arm), &budget, &Watch::default()).expect("in reach");
    let file = PlanFile::of(&problem, &best, "powercube6", 1, &Noise::default(), None).expect("lands");
    (arm, file)
}

/// A session with a homed group, and the controller's node.
pub(crate) fn homed() -> (Session, NodeId) {
    let mut session = BusArgs::default().open_with_controller().unwrap();
    let node = session.find_controller(None).unwrap();
    session.wait_for(Duration::from_secs(10), &|state| state != State::Boot).unwrap();
    session.home_group(node, 0x3F, Duration::from_secs(120)).unwrap();
    (session, node)
}
