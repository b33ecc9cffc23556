//! First UART of the machine (STM32 USART1): received bytes are taken by interrupt into a ring, because the emulated
//! receiver holds one byte.

use core::sync::atomic::{AtomicU8, AtomicUsize, Ordering};

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

const RING: usize = 1024;
static BYTES: [AtomicU8; RING] = [const { AtomicU8::new(0) }; RING];
static HEAD: AtomicUsize = AtomicUsize::new(0);
static TAIL: AtomicUsize = AtomicUsize::new(0);

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
    // SAFETY: reading the data register is what ends the interrupt.
    unsafe {
        while STATUS.read_volatile() & RECEIVE_FULL != 0 {
            let byte = DATA.read_volatile() as u8;
            let head = HEAD.load(Ordering::Relaxed);
            // A full ring drops the byte: the line is then not a frame and is ignored.
            if head.wrapping_sub(TAIL.load(Ordering::Acquire)) < RING
                && let Some(place) = BYTES.get(head % RING)
            {
                place.store(byte, Ordering::Relaxed);
                HEAD.store(head.wrapping_add(1), Ordering::Release);
            }
        }
    }
}

/// Next received byte.
pub fn receive() -> Option<u8> {
    let tail = TAIL.load(Ordering::Relaxed);
    if tail == HEAD.load(Ordering::Acquire) {
        return None;
    }
    let byte = BYTES.get(tail % RING)?.load(Ordering::Relaxed);
    TAIL.store(tail.wrapping_add(1), Ordering::Release);
    Some(byte)
}

/// Sleeps until an interrupt, unless a byte is there.
pub fn sleep_unless_received() {
    // With interrupts masked one that comes between the look and the sleep stays pending, and ends the sleep at once.
    cortex_m::interrupt::free(|_| {
        if TAIL.load(Ordering::Relaxed) == HEAD.load(Ordering::Acquire) {
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
