//! The MCAP log: opens in the usual viewers, with position and current of each module as plots.

use std::collections::BTreeMap;
use std::io::{self, BufWriter, Seek, Write};

use can_link::BusError;
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use protocol::powercube::{MotionPosition, Parameter, Reply, ShortState, Value};
use protocol::{Frame, Instant};

use super::schema::{self, Message};
use crate::bus::session::Way;

/// Writes the file. Times are the session's, as log time and publish time.
pub struct Log<W: Write + Seek> {
    writer: Writer<BufWriter<W>>,
    frames: u16,
    errors: u16,
    modules: BTreeMap<u8, u16>,
    states: u16,
    sequence: u32,
}

impl<W: Write + Seek> Log<W> {
    /// Begins the file.
    ///
    /// # Errors
    /// The medium's.
    pub fn new(out: W) -> io::Result<Self> {
        let mut writer = WriteOptions::new()
            .compression(None)
            .profile("")
            .library(concat!("cubectl ", env!("CARGO_PKG_VERSION")))
            .create(BufWriter::new(out))
            .map_err(io_error)?;
        let descriptor = schema::descriptor_set();
        let mut schema = |name: &str| writer.add_schema(name, "protobuf", &descriptor).map_err(io_error);
        let (frame, states, error) =
            (schema(schema::FRAME)?, schema(schema::MODULE_STATE)?, schema(schema::BUS_ERROR)?);
        let none = BTreeMap::new();
        let frames = writer.add_channel(frame, "/bus/frames", "protobuf", &none).map_err(io_error)?;
        let errors = writer.add_channel(error, "/bus/errors", "protobuf", &none).map_err(io_error)?;
        Ok(Self { writer, frames, errors, modules: BTreeMap::new(), states, sequence: 0 })
    }

    /// Writes a frame, and what it says about a module.
    ///
    /// # Errors
    /// The medium's.
    pub fn frame(&mut self, at: Instant, way: Way, frame: &Frame) -> io::Result<()> {
        let message = Message::default()
            .uint(1, at.as_micros())
            .uint(2, frame.id().raw().into())
            .uint(3, frame.is_extended().into())
            .uint(4, frame.is_remote().into())
            .uint(5, (way == Way::Sent).into())
            .bytes(6, frame.data());
        self.put(self.frames, at, message)?;
        let Ok((module, reply)) = Reply::decode(frame) else { return Ok(()) };
        let state = Message::default().uint(1, at.as_micros()).uint(2, module.get().into());
        let state = match reply {
            Reply::MotionExtended { position: MotionPosition::Radians(rad), short_state, .. } => {
                state_fields(state, rad.get(), short_state)
            }
            Reply::Value(_, Value::PosStateDio(all)) => {
                state_fields(state, all.position_rad, all.short_state)
            }
            Reply::Value(Parameter::ActPos, Value::F32(rad)) => state.double(3, rad.into()),
            Reply::Value(Parameter::Cur, Value::F32(current_a)) => state.double(6, current_a.into()),
            _ => return Ok(()),
        };
        let channel = self.channel_of(module.get())?;
        self.put(channel, at, state)
    }

    /// Writes an error of the bus.
    ///
    /// # Errors
    /// The medium's.
    pub fn bus_error(&mut self, at: Instant, error: &BusError) -> io::Result<()> {
        let message = Message::default()
            .uint(1, at.as_micros())
            .uint(2, error.class.into())
            .bytes(3, error.to_string().as_bytes());
        self.put(self.errors, at, message)
    }

    /// Closes the current chunk and hands everything to the operating system.
    ///
    /// # Errors
    /// The medium's.
    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.flush().map_err(io_error)
    }

    /// Writes the summary; nothing can be added afterwards.
    ///
    /// # Errors
    /// The medium's.
    pub fn finish(&mut self) -> io::Result<()> {
        self.writer.finish().map(drop).map_err(io_error)
    }

    fn channel_of(&mut self, module: u8) -> io::Result<u16> {
        if let Some(channel) = self.modules.get(&module) {
            return Ok(*channel);
        }
        let topic = format!("/module/{module}");
        let channel =
            self.writer.add_channel(self.states, &topic, "protobuf", &BTreeMap::new()).map_err(io_error)?;
        self.modules.insert(module, channel);
        Ok(channel)
    }

    fn put(&mut self, channel_id: u16, at: Instant, message: Message) -> io::Result<()> {
        self.sequence = self.sequence.wrapping_add(1);
        let time_ns = at.as_micros().saturating_mul(1_000);
        let header =
            MessageHeader { channel_id, sequence: self.sequence, log_time: time_ns, publish_time: time_ns };
        self.writer.write_to_known_channel(&header, &message.into_bytes()).map_err(io_error)
    }
}

fn state_fields(state: Message, position_rad: f32, short: ShortState) -> Message {
    state
        .double(3, position_rad.into())
        .uint(4, short.intersects(ShortState::NOT_OK).into())
        .uint(5, short.intersects(ShortState::MOTION).into())
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}
