//! First UART of the machine (STM32 USART1): received bytes are taken by interrupt into a ring, because the emulated
//! receiver holds one byte.

use core::cell::RefCell;

use critical_section::Mutex;
use heapless::Deque;

const BASE: usize = 0x4001_1000;
const STATUS: *const u32 = BASE as *const u32;
const DATA: *mut u32 = (BASE + 0x04) as *mut u32;
const CONTROL1: *mut u32 = (BASE + 0x0C) as *mut u32;

const TRANSMIT_EMPTY: u32 = 1 << 7;
const RECEIVE_FULL: u32 = 1 << 5;
/// USART, transmitter, receiver and its interrupt on.
const ENABLE: u32 = 1 << 13 | 1 << 5 | 1 << 3 | 1 << 2;
/// Number of the interrupt.
const IRQ: u16 = 37;
/// Interrupts of the chip.
const IRQS: usize = 82;

unsafe extern "C" {
    fn DefaultHandler();
}

/// The chip's part of the vector table: one entry is ours.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [unsafe extern "C" fn(); IRQS] = {
    let mut table = [DefaultHandler as unsafe extern "C" fn(); IRQS];
    table[IRQ as usize] = take_bytes;
    table
};

static RECEIVED: Mutex<RefCell<Deque<u8, 1024>>> = Mutex::new(RefCell::new(Deque::new()));

#[derive(Clone, Copy)]
struct Interrupt;

// SAFETY: the number is that of USART1 on this machine.
unsafe impl cortex_m::interrupt::InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        IRQ
    }
}

/// Switches the UART and its interrupt on.
pub fn start() {
    // SAFETY: this module alone uses the UART; unmasking happens after the ring exists.
    unsafe {
        CONTROL1.write_volatile(ENABLE);
        cortex_m::peripheral::NVIC::unmask(Interrupt);
    }
}

/// The UART's interrupt.
unsafe extern "C" fn take_bytes() {
    with_received(|received| {
        // SAFETY: reading the data register is what ends the interrupt.
        while unsafe { STATUS.read_volatile() } & RECEIVE_FULL != 0 {
            let byte = unsafe { DATA.read_volatile() } as u8;
            // A full queue drops the byte: the line is then not a frame and is ignored.
            let _ = received.push_back(byte);
        }
    });
}

/// Acts on the queue with interrupts off; the queue is never borrowed twice, because nothing in here calls this.
fn with_received<R>(act: impl FnOnce(&mut Deque<u8, 1024>) -> R) -> Option<R> {
    critical_section::with(|cs| {
        RECEIVED.borrow(cs).try_borrow_mut().ok().map(|mut received| act(&mut received))
    })
}

/// Next received byte.
pub fn receive() -> Option<u8> {
    with_received(Deque::pop_front).flatten()
}

/// Sleeps until an interrupt, unless a byte is there.
pub fn sleep_unless_received() {
    // With interrupts off, an interrupt between the check and the sleep stays pending, and ends the sleep at once.
    critical_section::with(|_| {
        if with_received(|received| received.is_empty()).unwrap_or(false) {
            cortex_m::asm::wfi();
        }
    });
}

/// Sends bytes; waits for the transmitter.
pub fn send(bytes: &[u8]) {
    for byte in bytes {
        // SAFETY: this module alone uses the UART.
        unsafe {
            while STATUS.read_volatile() & TRANSMIT_EMPTY == 0 {}
            DATA.write_volatile(u32::from(*byte));
        }
    }
}
