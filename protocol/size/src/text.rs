//! Text formats: candump, SLCAN, socketcand.

use core::hint::black_box;

use protocol::text::candump::Record;
use protocol::text::{BusName, slcan, socketcand};
use protocol::{Frame, Instant};

/// Every byte goes to every assembler, every line to every decoder, and the frame to every encoder.
pub fn exercise(now: Instant, frame: &Frame) {
    let line: [u8; 64] = black_box([0; 64]);
    if let Ok(record) = black_box(Record::parse(&line)) {
        black_box(record.encode());
    }
    if let Ok(bus) = BusName::new(black_box("can0")) {
        black_box(Record { at: now, bus, frame: *frame, direction: black_box(None) }.encode());
        black_box(socketcand::Command::Open(bus).encode());
    }
    let mut lines = black_box(slcan::Assembler::new());
    let mut messages = black_box(socketcand::Assembler::new());
    for byte in line {
        if let Some(slcan::Assembled::Line(line)) = lines.push(byte) {
            if let Ok(command) = black_box(slcan::Command::parse(line)) {
                black_box(command.encode());
            }
            if let Ok(reply) = black_box(slcan::Reply::parse(line)) {
                black_box(reply.encode());
            }
        }
        if let Some(socketcand::Assembled::Message(text)) = messages.push(byte) {
            if let Ok(command) = black_box(socketcand::Command::parse(text)) {
                black_box(command.encode());
            }
            if let Ok(message) = black_box(socketcand::Message::parse(text)) {
                black_box(message.encode());
            }
        }
    }
}
