//! Plays a script of calls from a file of the host, through semihosting. No clock and no interrupts, so every run
//! is the same.

use core::hint::black_box;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_semihosting::syscall;
use firmware::authority::sha256;
use firmware::registers::run_digest;
use firmware::state::StateKind;
use protocol::{ExtendedId, Frame, Id, Instant, Node as _, StandardId};

use crate::{CORE_MHZ, Node, stack};

pub(crate) const RECORD: usize = 24;
/// Records per read and write: the buffers are on the stack that is measured.
const RECORDS: usize = 8;
pub(crate) const DEADLINE: u32 = 1 << 29;

/// The timer has 24 bits.
const TICKS: u32 = 0x00FF_FFFF;

/// Emulated time of an instruction with `-icount shift=3`, ns.
const INSTRUCTION_NS: u32 = 8;

/// File of the host.
pub(crate) struct File(usize);

impl File {
    /// `name` ends with a zero byte. Mode as in the semihosting specification: 1 reads, 5 writes bytes.
    pub(crate) fn open(name: &[u8], mode: usize) -> Option<Self> {
        // SAFETY: the block is the one OPEN wants: name, mode, length without the zero.
        let handle = unsafe { syscall!(OPEN, name.as_ptr(), mode, name.len() - 1) };
        (handle as isize >= 0).then_some(Self(handle))
    }

    /// Bytes read.
    pub(crate) fn read(&self, buffer: &mut [u8]) -> usize {
        // SAFETY: READ fills at most the length given, and returns how much it did not.
        let left = unsafe { syscall!(READ, self.0, buffer.as_mut_ptr(), buffer.len()) };
        buffer.len().saturating_sub(left)
    }

    pub(crate) fn write(&self, buffer: &[u8]) -> bool {
        // SAFETY: WRITE reads the length given, and returns how much it did not take.
        unsafe { syscall!(WRITE, self.0, buffer.as_ptr(), buffer.len()) == 0 }
    }
}

/// Open files of a run.
pub struct Script {
    script: File,
    frames: File,
}

/// Instructions that take this many SysTick periods.
pub(crate) const fn instructions(ticks: u32) -> u32 {
    const { assert!(1_000 / INSTRUCTION_NS == 125) };
    ticks.saturating_mul(125) / CORE_MHZ
}

/// Costs of one kind of call, in SysTick periods.
#[derive(Default)]
struct Cost {
    calls: u32,
    ticks: u32,
    worst: u32,
}

impl Cost {
    fn note(&mut self, ticks: u32) {
        self.calls += 1;
        self.ticks = self.ticks.wrapping_add(ticks);
        self.worst = self.worst.max(ticks);
    }

    fn time<T>(&mut self, call: impl Fn() -> T) {
        let before = SYST::get_current();
        black_box(call());
        self.note(before.wrapping_sub(SYST::get_current()) & TICKS);
    }

    fn print(&self, name: &[u8]) {
        print(name);
        print_number(self.calls);
        print(b" calls, instructions mean ");
        print_number(instructions(self.ticks / self.calls.max(1)));
        print(b", worst ");
        print_number(instructions(self.worst));
        print(b"\n");
    }
}

impl Script {
    /// The script, if there is one.
    pub fn open() -> Option<Self> {
        let script = File::open(b"script.bin\0", 1)?;
        Some(Self { script, frames: File::open(b"frames.bin\0", 5)? })
    }

    /// Plays it; true if it could be read and written.
    pub fn play(self, node: &mut Node, mut clock: SYST) -> bool {
        // To build the node takes more stack than it needs later; both figures are printed.
        let made = stack::deepest();
        stack::paint();
        clock.set_clock_source(SystClkSource::Core);
        clock.set_reload(TICKS);
        clock.clear_current();
        clock.enable_counter();
        let (mut input, mut output) = ([0; RECORD * RECORDS], [0; RECORD * RECORDS]);
        let (mut filled, mut fine) = (0, true);
        let (mut steps, mut frames, mut others) = (Cost::default(), Cost::default(), Cost::default());
        let mut targets = Cost::default();
        loop {
            let len = self.script.read(&mut input);
            if len == 0 {
                break;
            }
            for record in input.get(..len).unwrap_or(&[]).as_chunks::<RECORD>().0 {
                let Some((now, frame)) = parse(record) else { return false };
                let cycles_before = node.controller().counters().cycles;
                let targets_before = node.controller().targets_taken();
                let before = SYST::get_current();
                match &frame {
                    Some(frame) => node.handle_frame(now, frame),
                    None => node.handle_timeout(now),
                }
                let ticks = before.wrapping_sub(SYST::get_current()) & TICKS;
                let running = node.controller().state().kind() == StateKind::Running;
                match (frame.is_some(), node.controller().counters().cycles != cycles_before) {
                    (false, true) => steps.note(ticks),
                    (true, _) if node.controller().targets_taken() > targets_before => targets.note(ticks),
                    (true, _) if running => frames.note(ticks),
                    _ => others.note(ticks),
                }
                while let Some(frame) = node.poll_frame() {
                    if let Some(place) =
                        output.get_mut(filled..).and_then(|rest| rest.first_chunk_mut::<RECORD>())
                    {
                        *place = emit(now, &frame);
                        filled += RECORD;
                    }
                    if filled == output.len() {
                        fine &= self.frames.write(&output);
                        filled = 0;
                    }
                }
            }
        }
        fine &= self.frames.write(output.get(..filled).unwrap_or(&[]));
        steps.print(b"control step of six joints: ");
        frames.print(b"frame while running:        ");
        targets.print(b"end state taken over:       ");
        others.print(b"any other call:             ");
        print(b"deepest stack, bytes:       ");
        print_number(stack::deepest() as u32);
        print(b" with the node on it, ");
        print_number(made as u32);
        print(b" while it was made\n");
        // Additional cost of an offer to arm and of an upload.
        let (mut settings, mut file) = (Cost::default(), Cost::default());
        let kibibyte = [0x5A; 1024];
        for _ in 0..8 {
            settings.time(|| run_digest(&[0; 32], black_box(node.controller().settings())));
            file.time(|| sha256(black_box(&kibibyte)));
        }
        settings.print(b"digest of the settings:     ");
        file.print(b"digest of 1 KiB of a file:  ");
        fine
    }
}

pub(crate) fn parse(record: &[u8; RECORD]) -> Option<(Instant, Option<Frame>)> {
    let (at, rest) = record.split_first_chunk::<8>()?;
    let (id, rest) = rest.split_first_chunk::<4>()?;
    let (dlc, data) = (*rest.first()?, rest.get(4..)?);
    let (now, id) = (Instant::from_micros(u64::from_le_bytes(*at)), u32::from_le_bytes(*id));
    if id & DEADLINE != 0 && id >> 31 == 0 {
        return Some((now, None));
    }
    let can_id = if id >> 31 == 1 {
        Id::Extended(ExtendedId::from_low_bits(id))
    } else {
        Id::Standard(StandardId::from_low_bits(id as u16))
    };
    let frame = Frame::new(can_id, data.get(..usize::from(dlc))?).ok()?;
    Some((now, Some(frame)))
}

pub(crate) fn emit(now: Instant, frame: &Frame) -> [u8; RECORD] {
    let id = match frame.id() {
        Id::Standard(id) => u32::from(id.get()),
        Id::Extended(id) => id.get() | 1 << 31,
    };
    let mut record = [0; RECORD];
    let head = now.as_micros().to_le_bytes().into_iter().chain(id.to_le_bytes());
    let head = head.chain([frame.dlc() as u8, 0, 0, 0]);
    for (to, from) in record.iter_mut().zip(head.chain(frame.data().iter().copied())) {
        *to = from;
    }
    record
}

/// Text on the emulator's console; without `core::fmt`, which would be most of the program.
fn print(text: &[u8]) {
    if let Some(console) = File::open(b":tt\0", 4) {
        console.write(text);
    }
}

fn print_number(mut number: u32) {
    let mut digits = [b'0'; 10];
    let mut first = digits.len() - 1;
    for (place, digit) in digits.iter_mut().enumerate().rev() {
        *digit = b'0' + (number % 10) as u8;
        first = place;
        number /= 10;
        if number == 0 {
            break;
        }
    }
    print(digits.get(first..).unwrap_or(&[]));
}
