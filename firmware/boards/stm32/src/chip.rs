//! Registers of the STM32F405 that are used, by their address (RM0090): clocks, pins, timer, watchdog.

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, OutputPin};
use firmware::authority::{SEED_LEN, Seed};
use firmware::runner;
use protocol::Instant;

const RCC: usize = 0x4002_3800;
const FLASH: usize = 0x4002_3C00;
const GPIOB: usize = 0x4002_0400;
const GPIOC: usize = 0x4002_0800;
const TIM2: usize = 0x4000_0000;
const IWDG: usize = 0x4000_3000;
const RNG: usize = 0x5006_0800;
const UNIQUE_ID: usize = 0x1FFF_7A10;

fn write(address: usize, value: u32) {
    // SAFETY: only called with the register addresses of this file; the main loop is their only user.
    unsafe { (address as *mut u32).write_volatile(value) }
}

fn read(address: usize) -> u32 {
    // SAFETY: as `write`; reading these registers has no effect.
    unsafe { (address as *const u32).read_volatile() }
}

fn modify(address: usize, clear: u32, set: u32) {
    write(address, read(address) & !clear | set);
}

fn wait_for(address: usize, bits: u32, value: u32) {
    // If the crystal never starts, the board stays here, silent, and the drives never get a sign of life.
    while read(address) & bits != value {}
}

/// 168 MHz core, 42 MHz APB1 (CAN), 84 MHz timers, from the 8 MHz crystal.
pub fn start_clocks() {
    modify(RCC, 0, 1 << 16);
    wait_for(RCC, 1 << 17, 1 << 17);
    // PLL: 8 MHz / 8 * 336 / 2 = 168 MHz; / 7 = 48 MHz.
    write(RCC + 0x04, 8 | 336 << 6 | 1 << 22 | 7 << 24);
    modify(RCC, 0, 1 << 24);
    // Five wait states, caches and prefetch on.
    write(FLASH, 5 | 1 << 8 | 1 << 9 | 1 << 10);
    // APB1 = core / 4, APB2 = core / 2.
    modify(RCC + 0x08, 7 << 10 | 7 << 13, 5 << 10 | 4 << 13);
    wait_for(RCC, 1 << 25, 1 << 25);
    modify(RCC + 0x08, 3, 2);
    wait_for(RCC + 0x08, 3 << 2, 2 << 2);
    // Ports B and C; TIM2 and CAN1.
    modify(RCC + 0x30, 0, 1 << 1 | 1 << 2);
    modify(RCC + 0x40, 0, 1 | 1 << 25);
}

/// PB8 and PB9 to CAN1 (alternate function 9), pull-up on the receiver.
pub fn start_can_pins() {
    modify(GPIOB + 0x24, 0xFF, 0x99);
    modify(GPIOB + 0x0C, 0xF << 16, 1 << 16);
    modify(GPIOB + 0x08, 0xF << 16, 0xF << 16);
    modify(GPIOB, 0xF << 16, 0b1010 << 16);
}

/// Push-pull output of port C.
pub struct Output {
    number: u32,
}

impl Output {
    /// Pin `number`, below 16. It comes up low.
    pub fn start(number: u32) -> Self {
        let mut output = Self { number };
        output.put(false);
        modify(GPIOC, 3 << (2 * number), 1 << (2 * number));
        output
    }

    fn put(&mut self, high: bool) {
        write(GPIOC + 0x18, 1 << if high { self.number } else { self.number + 16 });
    }
}

impl ErrorType for Output {
    type Error = Infallible;
}

impl OutputPin for Output {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.put(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.put(true);
        Ok(())
    }
}

/// TIM2: 32 bits, one count per microsecond.
pub fn start_timer() {
    write(TIM2 + 0x28, 84 - 1);
    write(TIM2 + 0x2C, u32::MAX);
    write(TIM2 + 0x14, 1);
    write(TIM2, 1);
}

/// Microseconds since the timer was started; must be read at least once in 71 minutes.
#[derive(Default)]
pub struct Clock {
    last: u32,
    wraps: u32,
}

impl runner::Clock for Clock {
    fn now(&mut self) -> Instant {
        let count = read(TIM2 + 0x24);
        if count < self.last {
            self.wraps += 1;
        }
        self.last = count;
        Instant::from_micros(u64::from(self.wraps) << 32 | u64::from(count))
    }
}

/// 100 ms at 32 kHz / 4.
pub fn start_watchdog() {
    write(IWDG, 0x5555);
    write(IWDG + 0x04, 0);
    write(IWDG + 0x08, 800);
    write(IWDG, 0xCCCC);
    feed_watchdog();
}

pub fn feed_watchdog() {
    write(IWDG, 0xAAAA);
}

/// Random bytes of the chip's generator (RM0090, 24). The first number after its start is not used, and no number equals
/// the one before, as FIPS 140-2 wants.
pub fn seed() -> Seed {
    let mut bytes = [0; SEED_LEN];
    // Clock of the generator, then the generator.
    modify(RCC + 0x34, 0, 1 << 6);
    write(RNG, 1 << 2);
    let mut last = next_random();
    for place in bytes.as_chunks_mut::<4>().0 {
        let mut number = next_random();
        while number == last {
            number = next_random();
        }
        *place = number.to_le_bytes();
        last = number;
    }
    write(RNG, 0);
    Seed::from_entropy(bytes)
}

fn next_random() -> u32 {
    loop {
        let status = read(RNG + 0x04);
        if status & (1 << 5 | 1 << 6) != 0 {
            // Error of the clock or of the source: the generator is started again. If it never recovers, the board
            // stays here.
            write(RNG + 0x04, 0);
            write(RNG, 0);
            write(RNG, 1 << 2);
        } else if status & 1 != 0 {
            return read(RNG + 0x08);
        }
    }
}

/// The chip's 96-bit number.
pub fn unique_id() -> [u8; 16] {
    let mut id = [0; 16];
    for (place, offset) in id.as_chunks_mut::<4>().0.iter_mut().zip([0, 4, 8]) {
        *place = read(UNIQUE_ID + offset).to_le_bytes();
    }
    id
}
