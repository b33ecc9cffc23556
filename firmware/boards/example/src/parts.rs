//! The parts of the board, as drivers: what a port to a chip replaces.

use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

use embedded_can::ErrorKind;
use embedded_can::nb::Can;
use embedded_hal::digital::{ErrorType, OutputPin};
use firmware::runner::Clock;
use protocol::{Frame, Instant};

use crate::lab::Lab;

/// CAN controller. `Frame` may be the frame type of your driver: the runner converts.
pub(crate) struct LabCan(pub(crate) Rc<RefCell<Lab>>);

impl Can for LabCan {
    type Frame = Frame;
    type Error = ErrorKind;

    /// `Ok(Some(frame))`: another frame lost its mailbox to this one. `WouldBlock`: no room.
    fn transmit(&mut self, frame: &Frame) -> nb::Result<Option<Frame>, ErrorKind> {
        if self.0.borrow_mut().send(*frame) { Ok(None) } else { Err(nb::Error::WouldBlock) }
    }

    fn receive(&mut self) -> nb::Result<Frame, ErrorKind> {
        self.0.borrow_mut().receive().ok_or(nb::Error::WouldBlock)
    }
}

/// A timer that counts microseconds.
pub(crate) struct LabClock(pub(crate) Rc<RefCell<Lab>>);

impl Clock for LabClock {
    fn now(&mut self) -> Instant {
        self.0.borrow().now()
    }
}

/// An output pin that prints its level and keeps it.
#[derive(Clone)]
pub(crate) struct LabPin {
    name: &'static str,
    levels: Rc<RefCell<Vec<bool>>>,
}

impl LabPin {
    /// A pin without a level yet.
    pub(crate) fn new(name: &'static str) -> Self {
        Self { name, levels: Rc::default() }
    }

    /// Levels it had, in order.
    pub(crate) fn levels(&self) -> Vec<bool> {
        self.levels.borrow().clone()
    }

    fn put(&self, high: bool) {
        println!("pin {}: {}", self.name, if high { "high" } else { "low" });
        self.levels.borrow_mut().push(high);
    }
}

impl ErrorType for LabPin {
    type Error = Infallible;
}

impl OutputPin for LabPin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.put(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.put(true);
        Ok(())
    }
}
