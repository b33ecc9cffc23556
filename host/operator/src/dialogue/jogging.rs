//! Jogging of one joint by a controller, while an operator holds a key.
//!
//! The order is valid for [`JOG_HOLD`] and is repeated every `JOG_PERIOD`. The joint stops without any message: an
//! order that is not repeated expires, and the drive's target is never farther than where the order ends.

use firmware::fault::Cause;
use protocol::cyphal::bits::to_bytes;
use protocol::cyphal::client::Policy;
use protocol::cyphal::cubecell::command::{JOG, Jog};
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::cubecell::stop::Reason;
use protocol::cyphal::id::NodeId;
use protocol::cyphal::uavcan::command::{CommandRequest, SERVICE};
use protocol::{Duration, Instant, JointIndex};

use super::homing::reported_since;
use super::operator::{OperatorError, stopped};
use super::registers::Numbers;
use crate::bus::session::{Ended, Session};

/// How long a jog goes on without repetition.
pub const JOG_HOLD: Duration = Duration::from_millis(200);
/// Time between two orders.
const JOG_PERIOD: Duration = Duration::from_millis(50);
/// Longest time from the end of the last order to rest.
const REST_MAX: Duration = Duration::from_secs(3);
/// This near to a soft limit the joint is at it, rad.
const AT_LIMIT_RAD: f64 = 2e-3;

/// What a jog did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jogged {
    /// Where it began, rad.
    pub from_rad: f64,
    /// Where it stands, rad.
    pub to_rad: f64,
    /// How long it was held.
    pub held: Duration,
    /// It stopped at a soft limit although it was still held.
    pub at_limit: bool,
}

/// Bytes of the order.
fn order(joint: JointIndex, qd_rad_s: f64) -> Jog {
    let hold_ms = (JOG_HOLD.as_micros() / 1_000) as u16;
    Jog { joint: joint.get() as u8, qd_rad_s: qd_rad_s as f32, hold_ms }
}

impl Session {
    /// Moves one joint while `held` returns true, at `qd_rad_s` (its sign is the direction), not beyond its soft
    /// limits if it is homed. `held` is called with the time before each order. On Ctrl-C the joint stops too; that
    /// is not an error here.
    ///
    /// # Errors
    /// [`OperatorError`]; the drives were halted, by the controller or when this session ends.
    pub fn jog_joint(
        &mut self,
        node: NodeId,
        joint: JointIndex,
        qd_rad_s: f64,
        held: &mut dyn FnMut(Instant) -> bool,
    ) -> Result<Jogged, OperatorError> {
        let from_rad = self.position_of(node, joint)?;
        let limit_rad = self.limit_ahead(node, joint, qd_rad_s)?;
        self.guard_motion();
        let begun = self.now();
        let held_at_limit = self.hold(node, joint, qd_rad_s, limit_rad, held);
        let held_for = self.now().saturating_since(begun);
        let at_limit = match held_at_limit {
            Ok(at_limit) => at_limit,
            // Ctrl-C has been obeyed below.
            Err(OperatorError::Interrupted) => false,
            Err(error) => return Err(error),
        };
        self.let_go(node, joint)?;
        self.release_motion();
        let to_rad = self.heard_position(joint).unwrap_or(from_rad);
        Ok(Jogged { from_rad, to_rad, held: held_for, at_limit })
    }

    /// Position of a joint, measured from now on, rad.
    fn position_of(&mut self, node: NodeId, joint: JointIndex) -> Result<f64, OperatorError> {
        let pose = self.measured_pose(node)?;
        pose.get(joint.get()).copied().ok_or(OperatorError::Unreadable { node })
    }

    /// Last reported position of a joint, rad.
    fn heard_position(&mut self, joint: JointIndex) -> Option<f64> {
        let (_, _, state) = self.host_node().inbox()?.joints.as_ref()?;
        state.joint(joint).map(|joint| joint.q_rad.into())
    }

    /// The soft limit in the direction of `qd_rad_s`; `None` for a joint that is not homed.
    fn limit_ahead(
        &mut self,
        node: NodeId,
        joint: JointIndex,
        qd_rad_s: f64,
    ) -> Result<Option<f64>, OperatorError> {
        if self.group().is_none_or(|group| group.homed_mask & joint.bit() == 0) {
            return Ok(None);
        }
        let name = if qd_rad_s > 0.0 { "joint.q_max_rad" } else { "joint.q_min_rad" };
        let Numbers::Real(limits) = self.register(node, name)? else {
            return Err(OperatorError::Unreadable { node });
        };
        Ok(limits.get(joint.get()).map(|limit| f64::from(*limit)))
    }

    /// Repeats the order while it is held; true if the joint is at its limit.
    fn hold(
        &mut self,
        node: NodeId,
        joint: JointIndex,
        qd_rad_s: f64,
        limit_rad: Option<f64>,
        held: &mut dyn FnMut(Instant) -> bool,
    ) -> Result<bool, OperatorError> {
        let (mut begun, mut taken_at) = (None, None);
        while !self.is_interrupted() && held(self.now()) {
            let now = self.now();
            match self.order_jog(node, &order(joint, qd_rad_s), begun.is_none()) {
                Ok(()) => (begun, taken_at) = (begun.or(Some(now)), Some(now)),
                // A repetition came too late: the joint ramps to rest, and then begins again. Or the controller
                // stops it, and reports why.
                Err(OperatorError::Refused { refusal: Some(refusal), .. })
                    if taken_at.is_some_and(|at| now < at + REST_MAX)
                        && refusal.cause == Cause::OrderNotNow.code() =>
                {
                    begun = None;
                }
                Err(error) => return Err(error),
            }
            let ended = self.run(now + JOG_PERIOD, &mut |host_node| {
                let state = reported_since(host_node.inbox().and_then(|inbox| inbox.group), now);
                matches!(state, Some(State::Fault | State::Stopped))
            })?;
            match ended {
                Ended::Interrupted => return Err(OperatorError::Interrupted),
                Ended::Done => {
                    self.release_motion();
                    return Err(stopped(&self.group().unwrap_or_default()));
                }
                Ended::TimedOut => {}
            }
            let here_rad = self.heard_position(joint);
            if limit_rad.zip(here_rad).is_some_and(|(limit, here)| (limit - here).abs() < AT_LIMIT_RAD) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The order; only the first one of a jog has a code, because a controller with a key computes no code while it moves.
    fn order_jog(&mut self, node: NodeId, jog: &Jog, is_first: bool) -> Result<(), OperatorError> {
        if is_first {
            return self.order(node, "the jog", JOG, jog).map(drop);
        }
        let mut bytes = [0; 16];
        let len = to_bytes(jog, &mut bytes).map_err(|_| OperatorError::Unreadable { node })?;
        self.order_plain(node, "the jog", JOG, bytes.get(..len).unwrap_or_default()).map(drop)
    }

    /// Stops ordering speed, and waits until the controller reports that the joint stands. Works after Ctrl-C too;
    /// without an answer everything is halted.
    fn let_go(&mut self, node: NodeId, joint: JointIndex) -> Result<(), OperatorError> {
        let let_go_at = self.now();
        let mut bytes = [0; 16];
        let len = to_bytes(&order(joint, 0.0), &mut bytes).map_err(|_| OperatorError::Unreadable { node })?;
        let request = CommandRequest { command: JOG, parameter: bytes.get(..len).unwrap_or_default() };
        let (link, now) = self.host_node().link();
        // Lost or refused, the last order still ends by itself.
        let _ = link.request(now, node, SERVICE, Policy::default(), &request);
        while self.now() < let_go_at + JOG_HOLD + REST_MAX {
            self.pass(JOG_PERIOD)?;
            let reported = self.host_node().inbox().and_then(|inbox| inbox.group);
            match reported_since(reported, let_go_at) {
                Some(State::Ready | State::Idle) => {
                    // Positions reported from now on are those at rest.
                    return self.settle(let_go_at);
                }
                Some(State::Fault | State::Stopped) => {
                    self.release_motion();
                    return Err(stopped(&self.group().unwrap_or_default()));
                }
                _ => {}
            }
        }
        self.halt(Reason::HOST)?;
        let state = self.group().unwrap_or_default().state;
        Err(OperatorError::NoProgress { state, limit: REST_MAX })
    }

    /// Waits for a message about the joints from after the end of the motion.
    fn settle(&mut self, since: Instant) -> Result<(), OperatorError> {
        let rest_at = self.now();
        for _ in 0..20 {
            let reported =
                self.host_node().inbox().and_then(|inbox| inbox.joints.as_ref().map(|(at, ..)| *at));
            if reported.is_some_and(|at| at > rest_at.max(since)) {
                break;
            }
            self.pass(JOG_PERIOD)?;
        }
        Ok(())
    }
}
