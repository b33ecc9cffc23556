//! Small application behind the Cyphal services: one register of every type, a file, two commands.
//!
//! Used by the tests of the node core and by the demo node for the interop stage.
#![allow(dead_code, reason = "each user needs a part of it")]

use std::cell::Cell;
use std::rc::Rc;

use protocol::Instant;
use protocol::cyphal::bits::Writer;
use protocol::cyphal::cubecell::stop;
use protocol::cyphal::cubecell::{TRAJECTORY_PATH, command as cell_command};
use protocol::cyphal::id::NodeId;
use protocol::cyphal::rx::{Port, Transfer};
use protocol::cyphal::server::{Application, NodeStatus, Register};
use protocol::cyphal::uavcan::command::Status;
use protocol::cyphal::uavcan::file::FileError;
use protocol::cyphal::uavcan::heartbeat::{Health, Mode};
use protocol::cyphal::uavcan::info::{NodeInfo, Version};
use protocol::cyphal::uavcan::value::{Value, ValueBuf, ValueType};
use protocol::cyphal::upload::UploadBank;

/// Largest file: the 7 680 bytes of a throw with some room.
pub(crate) const FILE_LEN_MAX: usize = 8192;
/// Answers with the parameter turned round.
pub(crate) const COMMAND_REVERSE: u16 = 100;
/// Answers with the CRC-64/WE of the file, eight bytes little endian; `FAILURE` if it is incomplete.
pub(crate) const COMMAND_FILE_CRC: u16 = 101;

struct Entry {
    name: &'static str,
    mutable: bool,
    persistent: bool,
    value: ValueBuf,
}

/// The application.
pub(crate) struct DemoApp {
    registers: Vec<Entry>,
    /// The file at [`TRAJECTORY_PATH`].
    pub(crate) file: UploadBank<FILE_LEN_MAX>,
    /// Stop messages heard.
    pub(crate) stops: u32,
    /// Commands carried out.
    pub(crate) executed: Vec<u16>,
    /// Frames that the bus in front of this node lost on purpose; a register shows it.
    pub(crate) frames_lost: Rc<Cell<u32>>,
}

fn wire(tag: u8, data: &[u8]) -> ValueBuf {
    let mut bytes = vec![tag];
    bytes.extend(data);
    <Value as protocol::cyphal::bits::Decode>::from_bytes(&bytes).expect("a valid value").into()
}

impl DemoApp {
    /// Registers at their first values, no file.
    pub(crate) fn new() -> Self {
        let echo = |name, value| Entry { name, mutable: true, persistent: true, value };
        let fixed = |name, value| Entry { name, mutable: false, persistent: false, value };
        let registers = vec![
            echo("uavcan.node.description", Value::string("demo").unwrap().into()),
            echo("demo.unstructured", Value::unstructured(&[1, 2, 3]).unwrap().into()),
            echo(
                "demo.bit",
                ValueBuf::bits(&[true, false, true, false, false, false, false, false, true]).unwrap(),
            ),
            echo("demo.integer64", ValueBuf::try_from([i64::MIN, 0, i64::MAX].as_slice()).unwrap()),
            echo("demo.integer32", ValueBuf::try_from([i32::MIN, 0, i32::MAX].as_slice()).unwrap()),
            echo("demo.integer16", ValueBuf::try_from([i16::MIN, 0, i16::MAX].as_slice()).unwrap()),
            echo("demo.integer8", ValueBuf::try_from([i8::MIN, 0, i8::MAX].as_slice()).unwrap()),
            echo("demo.natural64", ValueBuf::try_from([0, u64::MAX].as_slice()).unwrap()),
            echo("demo.natural32", ValueBuf::try_from([0, u32::MAX].as_slice()).unwrap()),
            echo("demo.natural16", ValueBuf::try_from([0, u16::MAX].as_slice()).unwrap()),
            echo("demo.natural8", ValueBuf::try_from([0, u8::MAX].as_slice()).unwrap()),
            echo("demo.real64", ValueBuf::try_from([0.1_f64, -1e300].as_slice()).unwrap()),
            echo("demo.real32", ValueBuf::try_from([0.1_f32; 64].as_slice()).unwrap()),
            echo("demo.real16", wire(14, &[2, 0x00, 0x3C, 0x00, 0xC0])),
            fixed("demo.constant", ValueBuf::from(42_u8)),
            fixed("file.length_bytes", ValueBuf::from(0_u32)),
            fixed("file.crc64", ValueBuf::from(0_u64)),
            fixed("demo.frames_lost", ValueBuf::from(0_u32)),
            fixed("demo.stops_heard", ValueBuf::from(0_u32)),
        ];
        Self {
            registers,
            file: UploadBank::new(),
            stops: 0,
            executed: Vec::new(),
            frames_lost: Rc::default(),
        }
    }

    fn path(path: &[u8]) -> Result<(), FileError> {
        if path == TRAJECTORY_PATH { Ok(()) } else { Err(FileError::NOT_FOUND) }
    }
}

impl Application for DemoApp {
    fn info(&self) -> NodeInfo<'_> {
        NodeInfo {
            protocol: Version::new(1, 0),
            hardware: Version::new(2, 1),
            software: Version::new(0, 1),
            software_vcs_revision: 0x0123_4567_89AB_CDEF,
            unique_id: *b"demo-node-000001",
            name: b"org.cubecell.demo",
            software_image_crc: Some(0xFEDC_BA98_7654_3210),
            certificate: &[],
        }
    }

    fn status(&self) -> NodeStatus {
        NodeStatus { health: Health::Advisory, mode: Mode::MAINTENANCE, vendor_status: 7 }
    }

    fn subscriptions(&self) -> &[Port] {
        const PORTS: [Port; 1] = [stop::port(stop::SUBJECT)];
        &PORTS
    }

    fn register_count(&self) -> u16 {
        self.registers.len() as u16
    }

    fn register_name(&self, index: u16) -> &[u8] {
        self.registers.get(usize::from(index)).map_or(&[], |entry| entry.name.as_bytes())
    }

    fn register_read(&self, index: u16) -> Option<Register> {
        let entry = self.registers.get(usize::from(index))?;
        let value = match entry.name {
            "file.length_bytes" => ValueBuf::from(self.file.contents().len() as u32),
            "file.crc64" => ValueBuf::from(self.file.complete().unwrap_or(0)),
            "demo.frames_lost" => ValueBuf::from(self.frames_lost.get()),
            "demo.stops_heard" => ValueBuf::from(self.stops),
            _ => entry.value.clone(),
        };
        Some(Register { mutable: entry.mutable, persistent: entry.persistent, value })
    }

    fn register_write(&mut self, _: Instant, _: NodeId, index: u16, value: &Value<'_>) {
        let Some(entry) = self.registers.get_mut(usize::from(index)) else { return };
        let old = entry.value.as_value();
        let free_length = matches!(value.kind(), ValueType::String | ValueType::Unstructured);
        if value.kind() == old.kind() && (free_length || value.len() == old.len()) {
            entry.value = (*value).into();
        }
    }

    fn is_urgent(&self, command: u16) -> bool {
        command == cell_command::STOP
    }

    fn execute(
        &mut self,
        _: Instant,
        _: NodeId,
        command: u16,
        parameter: &[u8],
        output: &mut Writer<'_>,
    ) -> Status {
        self.executed.push(command);
        match command {
            COMMAND_REVERSE => {
                for byte in parameter.iter().rev() {
                    output.u8(*byte);
                }
                Status::SUCCESS
            }
            COMMAND_FILE_CRC => match self.file.complete() {
                Some(crc) => {
                    output.u64(crc);
                    Status::SUCCESS
                }
                None => Status::FAILURE,
            },
            cell_command::STOP => Status::SUCCESS,
            cell_command::RUN => Status::BAD_STATE,
            _ => Status::BAD_COMMAND,
        }
    }

    fn file_name(&self, index: u32) -> &[u8] {
        if index == 0 { TRAJECTORY_PATH } else { &[] }
    }

    fn file_write(
        &mut self,
        _: Instant,
        _: NodeId,
        path: &[u8],
        offset: u64,
        data: &[u8],
    ) -> Result<(), FileError> {
        Self::path(path)?;
        self.file.write(offset, data)
    }

    fn file_read(&mut self, path: &[u8], offset: u64, data: &mut [u8]) -> Result<usize, FileError> {
        Self::path(path)?;
        Ok(self.file.read(offset, data))
    }

    fn message(&mut self, _: Instant, _: &Transfer<'_>) {
        self.stops += 1;
    }
}
