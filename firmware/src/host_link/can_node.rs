//! Controllers as nodes of a CAN bus, for groups whose packets are CAN frames.

use core::borrow::BorrowMut;

use protocol::{Frame, Instant, Node};

use super::{ControllerNode, Port};
use crate::controller::Controller;
use crate::group::DriveGroup;
use crate::spline::Spline;
use crate::store::Storage;

/// Drives without a host link: all frames are those of the group.
impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup<Packet = Frame>> Node for Controller<S, M, G> {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.handle_packet(now, frame);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.handle_deadline(now);
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.poll_packet()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.poll_deadline()
    }
}

/// Drives and host link on one bus.
impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup<Packet = Frame>> Node for ControllerNode<S, M, G> {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        match Port::on_one_bus(frame) {
            Port::Host => self.handle_host_frame(now, frame),
            Port::Drives => self.handle_packet(now, frame),
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.handle_deadline(now);
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.poll_packet().or_else(|| self.poll_host_frame())
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.poll_deadline()
    }
}
