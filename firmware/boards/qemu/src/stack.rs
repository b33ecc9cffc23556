//! Depth of the stack: filled with a pattern at start, read at the end.

use core::ptr;

const PAINT: u32 = 0xA5A5_A5A5;

unsafe extern "C" {
    /// End of the static data: the lowest place the stack may reach (cortex-m-rt).
    static mut __sheap: u32;
    /// Where the stack begins.
    static _stack_start: u32;
}

/// Paints what is free now.
#[inline(never)]
pub fn paint() {
    let low = &raw mut __sheap;
    // Left alone: this function's own frame and the caller's.
    let high = (cortex_m::register::msp::read() as usize - 256) as *mut u32;
    let mut place = low;
    while place < high {
        // SAFETY: nothing is stored between the static data and the stack pointer.
        unsafe {
            ptr::write_volatile(place, PAINT);
            place = place.add(1);
        }
    }
}

/// Bytes that were used at most.
pub fn deepest() -> usize {
    let mut place = &raw const __sheap;
    let start = &raw const _stack_start;
    // SAFETY: reads the region that `paint` has written.
    while place < start && unsafe { ptr::read_volatile(place) } == PAINT {
        place = unsafe { place.add(1) };
    }
    start as usize - place as usize
}
