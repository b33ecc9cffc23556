//! bxCAN at 1 Mbit/s as [`embedded_can::nb::Can`]: frames in by interrupt, frames out by the three mailboxes in order of
//! priority.

use core::cell::RefCell;

use bxcan::filter::Mask32;
use bxcan::{Can, Data, Fifo, Instance, Interrupt, RegisterBlock, Rx0, Tx};
use cortex_m_rt::exception;
use critical_section::Mutex;
use embedded_can::ErrorKind;
use heapless::Deque;
use protocol::{ExtendedId, Frame, Id, StandardId};

use crate::chip;

/// 42 MHz / 3 = 14 quanta of 1 µs / 14: sample point at 85.7 %.
const BIT_TIMING: u32 = 0x001A_0002;
/// CAN1 receive interrupt, FIFO 0.
const RX0_IRQ: i16 = 20;
/// About 3 ms of a full bus.
const RING: usize = 64;

struct Can1;

// SAFETY: the address is that of CAN1, and there is one value of this type.
unsafe impl Instance for Can1 {
    const REGISTERS: *mut RegisterBlock = 0x4000_6400 as *mut RegisterBlock;
}

// SAFETY: CAN1 has the filters of both controllers: 28, of which it may use its first 14.
unsafe impl bxcan::FilterOwner for Can1 {
    const NUM_FILTER_BANKS: u8 = 14;
}

struct Received {
    fifo: Option<Rx0<Can1>>,
    ring: Deque<Frame, RING>,
    /// A frame was lost: the peripheral or the ring was full.
    overrun: bool,
}

static RECEIVED: Mutex<RefCell<Received>> =
    Mutex::new(RefCell::new(Received { fifo: None, ring: Deque::new(), overrun: false }));

#[derive(Clone, Copy)]
struct Irq;

// SAFETY: the number is that of CAN1 RX0.
unsafe impl cortex_m::interrupt::InterruptNumber for Irq {
    fn number(self) -> u16 {
        RX0_IRQ as u16
    }
}

/// All interrupts come here; only one is switched on.
#[exception]
unsafe fn DefaultHandler(number: i16) {
    if number != RX0_IRQ {
        return;
    }
    critical_section::with(|cs| {
        let Ok(mut received) = RECEIVED.borrow(cs).try_borrow_mut() else { return };
        let Received { fifo: Some(fifo), ring, overrun } = &mut *received else { return };
        // The peripheral holds three frames; an overrun loses the frames beyond them.
        for _ in 0..4 {
            match fifo.receive() {
                Ok(frame) => {
                    if let Some(frame) = from_bxcan(&frame) {
                        *overrun |= ring.push_back(frame).is_err();
                    }
                }
                Err(nb::Error::WouldBlock) => break,
                Err(nb::Error::Other(_)) => *overrun = true,
            }
        }
    });
}

/// CAN1.
pub struct Bus {
    tx: Tx<Can1>,
}

impl Bus {
    /// Starts the peripheral; it joins the bus after eleven recessive bits, and again after each bus-off.
    pub fn start() -> Self {
        chip::start_can_pins();
        let mut can =
            Can::builder(Can1).set_bit_timing(BIT_TIMING).set_automatic_retransmit(true).leave_disabled();
        can.modify_filters().enable_bank(0, Fifo::Fifo0, Mask32::accept_all());
        can.enable_interrupt(Interrupt::Fifo0MessagePending);
        // Joins while the loop already runs.
        let _ = can.enable_non_blocking();
        let (tx, fifo, _) = can.split();
        critical_section::with(|cs| {
            if let Ok(mut received) = RECEIVED.borrow(cs).try_borrow_mut() {
                received.fifo = Some(fifo);
            }
        });
        // SAFETY: the ring is ready.
        unsafe { cortex_m::peripheral::NVIC::unmask(Irq) };
        Self { tx }
    }
}

impl embedded_can::nb::Can for Bus {
    type Frame = Frame;
    type Error = ErrorKind;

    fn transmit(&mut self, frame: &Frame) -> nb::Result<Option<Frame>, ErrorKind> {
        let frame = to_bxcan(frame).ok_or(nb::Error::Other(ErrorKind::Other))?;
        let status = self.tx.transmit(&frame).map_err(|error| error.map(|never| match never {}))?;
        Ok(status.dequeued_frame().and_then(from_bxcan))
    }

    fn receive(&mut self) -> nb::Result<Frame, ErrorKind> {
        critical_section::with(|cs| {
            let mut received =
                RECEIVED.borrow(cs).try_borrow_mut().map_err(|_| nb::Error::<ErrorKind>::WouldBlock)?;
            if core::mem::take(&mut received.overrun) {
                return Err(nb::Error::Other(ErrorKind::Overrun));
            }
            received.ring.pop_front().ok_or(nb::Error::WouldBlock)
        })
    }
}

fn from_bxcan(frame: &bxcan::Frame) -> Option<Frame> {
    let id = match frame.id() {
        bxcan::Id::Standard(id) => Id::Standard(StandardId::from_low_bits(id.as_raw())),
        bxcan::Id::Extended(id) => Id::Extended(ExtendedId::from_low_bits(id.as_raw())),
    };
    match frame.data() {
        Some(data) => Frame::new(id, data).ok(),
        None => Frame::remote(id, frame.dlc().into()).ok(),
    }
}

fn to_bxcan(frame: &Frame) -> Option<bxcan::Frame> {
    let id = match frame.id() {
        Id::Standard(id) => bxcan::Id::Standard(bxcan::StandardId::new(id.get())?),
        Id::Extended(id) => bxcan::Id::Extended(bxcan::ExtendedId::new(id.get())?),
    };
    Some(bxcan::Frame::new_data(id, Data::new(frame.data())?))
}
