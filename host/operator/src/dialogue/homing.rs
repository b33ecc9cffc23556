//! Homing of one joint by a controller, and the answers of its drive meanwhile.

use protocol::cyphal::cubecell::command::{HOME, Home};
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use protocol::{Duration, Instant, JointIndex, ModuleId};

use super::error::{OperatorError, stopped};
use super::presence::PRESENCE;
use super::zero_check::{ZeroCheck, ZeroOffset};
use crate::bus::session::{Ended, Session};

/// Room for the controller to report that its own bound is passed.
const REPORT: Duration = Duration::from_secs(5);

/// What a homing did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homed {
    /// How long.
    pub took: Duration,
    /// Where the joint stands now, rad.
    pub position_rad: f64,
    /// Largest current that the drive reported, A; 0 if the answers of drives are not visible.
    pub current_max_a: f64,
    /// Error of its reading before the homing, if it was measured and is clear.
    pub zero: Option<ZeroOffset>,
}

impl Session {
    /// Lets one joint, whose drive is `module`, find its zero. `limit` is the bound of the controller. `zero` gets the
    /// readings of the drive, where they are heard.
    ///
    /// # Errors
    /// [`OperatorError`]; the drives were halted, by the controller or when this session ends.
    pub fn home_joint(
        &mut self,
        node: NodeId,
        (joint, module): (JointIndex, ModuleId),
        limit: Duration,
        mut zero: Option<ZeroCheck>,
    ) -> Result<Homed, OperatorError> {
        self.guard_motion();
        let begun = self.now();
        self.order(node, "homing", HOME, &Home { joint_mask: joint.bit() })?;
        let (mut seen, mut lost, mut read_at, mut current_max_a) = (false, false, begun, 0.0_f64);
        let ended = self.run(begun + limit + REPORT, &mut |host_node| {
            if let Some(heard) = host_node.heard().get(&module).filter(|heard| heard.at > begun) {
                current_max_a = current_max_a.max(heard.current_a.map_or(0.0, |a| f64::from(a.abs())));
                if let (Some(zero), Some(q_rad), true) =
                    (&mut zero, heard.position_rad, heard.position_at > read_at)
                {
                    read_at = heard.position_at;
                    zero.take(read_at, q_rad.into());
                }
            }
            lost = host_node.silence(begun) > PRESENCE;
            let state = reported_since(host_node.inbox().and_then(|inbox| inbox.group), begun);
            seen |= state == Some(State::Homing);
            lost || matches!(state, Some(State::Fault | State::Stopped))
                || (seen && matches!(state, Some(State::Ready | State::Idle)))
        })?;
        let took = self.now().saturating_since(begun);
        let group = self.group().unwrap_or_default();
        match (ended, group.state) {
            (Ended::Interrupted, _) => return Err(OperatorError::Interrupted),
            (Ended::Done, _) if lost => return Err(OperatorError::Lost),
            (Ended::Done, State::Ready | State::Idle) => {}
            (Ended::Done, _) => {
                // The controller has halted what moved.
                self.release_motion();
                return Err(stopped(&group));
            }
            (Ended::TimedOut, state) => return Err(OperatorError::NoProgress { state, limit }),
        }
        self.release_motion();
        let pose = self.measured_pose(node)?;
        let position_rad = pose.get(joint.get()).copied().ok_or(OperatorError::Unreadable { node })?;
        Ok(Homed { took, position_rad, current_max_a, zero: zero.and_then(ZeroCheck::finish) })
    }
}

/// The state that was reported after `since`.
pub(super) fn reported_since(
    reported: Option<(Instant, NodeId, protocol::cyphal::cubecell::group_state::GroupState)>,
    since: Instant,
) -> Option<State> {
    reported.filter(|(at, ..)| *at > since).map(|(_, _, group)| group.state)
}
