//! Gives a controller the segments of the plan that runs, one after the other, beside everything else on the bus.

use firmware::segment::LEN_MAX;
use protocol::cyphal::bits::Decode;
use protocol::cyphal::client::{Policy, Ticket};
use protocol::cyphal::cubecell::command;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::{NodeId, Priority};
use protocol::cyphal::uavcan::command::{CommandRequest, CommandResponse, SERVICE, Status};
use protocol::{Duration, Instant};

use crate::node::host_node::{BACKGROUND_GAP, HostNode};
use crate::trajectory::Segment;

/// Longest time that a segment takes: its frames at the pace of the host node, and the answer.
pub(crate) const SEGMENT: Duration = Duration::from_micros(
    (LEN_MAX as u64).div_ceil(FRAME_BYTES) * BACKGROUND_GAP.as_micros() + ANSWER.as_micros(),
);
/// Bytes of a transfer in each frame.
const FRAME_BYTES: u64 = 7;
/// From the last frame to the next segment: the controller answers between its cycles.
const ANSWER: Duration = Duration::from_millis(20);
const POLICY: Policy =
    Policy { timeout: Duration::from_millis(400), attempts: 5, priority: Priority::Optional };
/// A segment that was not taken is sent again after this.
const AGAIN: Duration = Duration::from_millis(50);

/// See the [module](self).
pub(super) struct Extending<'a> {
    node: NodeId,
    /// Those that the controller does not have yet.
    segments: &'a [Segment],
    asked: Option<Ticket>,
    due: Instant,
}

impl<'a> Extending<'a> {
    pub(super) const fn new(node: NodeId, segments: &'a [Segment]) -> Self {
        Self { node, segments, asked: None, due: Instant::ZERO }
    }

    /// Takes the answer, and sends the next segment when it is due. One segment is in flight at a time. If the
    /// controller refuses a segment, the plan ends early: the controller stops along its path, and its state shows
    /// it.
    pub(super) fn go_on(&mut self, host_node: &mut HostNode) {
        let Some(segment) = self.segments.first() else { return };
        let now = host_node.now();
        let Some(inbox) = host_node.inbox() else { return };
        // Times of the plan begin anew after 71 minutes.
        let has_room = inbox.group.is_some_and(|(_, _, group)| {
            let since_us = group.trajectory_time_us.wrapping_sub(segment.room_us) as i32;
            group.state == State::Running && since_us >= 0
        });
        if let Some(ticket) = self.asked {
            let at = inbox.answers.iter().position(|(answered, _)| *answered == ticket);
            let Some((_, answer)) = at.and_then(|at| inbox.answers.remove(at)) else { return };
            self.asked = None;
            let taken = answer.is_ok_and(|payload| {
                CommandResponse::from_bytes(&payload).is_ok_and(|response| response.status == Status::SUCCESS)
            });
            if taken {
                self.segments = &self.segments[1..];
            } else {
                self.due = now + AGAIN;
            }
        } else if has_room && self.due <= now {
            let request = CommandRequest { command: command::EXTEND, parameter: &segment.bytes };
            let (link, now) = host_node.link();
            // If there is no room for the request, it is tried again at the next call.
            self.asked = link.request(now, self.node, SERVICE, POLICY, &request).ok();
        }
    }
}
