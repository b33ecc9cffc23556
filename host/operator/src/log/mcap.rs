//! The MCAP log: opens in the usual viewers, with every number of drives, joints and group as a plot, and events as
//! a list.
//!
//! | topic | schema | when |
//! |---|---|---|
//! | `/bus/frames` | `cubectl.Frame` | each frame |
//! | `/bus/errors` | `cubectl.BusError` | each error of the bus |
//! | `/module/N` | `cubectl.ModuleState` | drive N reported its position or current |
//! | `/group` | `cubectl.GroupState` | the controller reported its state |
//! | `/joint/N` | `cubectl.JointState` | the controller reported joint N, from 1 |
//! | `/events` | `foxglove.Log` | something happened |
//! | `/freeze` | `cubectl.FreezeFrame` | a fault or stop came that was not there before |
//! | `/joints` | `foxglove.JointStates` | all drives have reported their angle: once per control cycle |
//! | `/tf` | `foxglove.FrameTransforms` | as `/joints` |
//! | `/ball` | `foxglove.SceneUpdate` | a ball flies or lies somewhere: a simulated one, or what a tracker has seen, in a file of its own |
//! | `/disc` | `foxglove.SceneUpdate` | the same of a disc |
//! | `/scene` | `foxglove.SceneUpdate` | bodies and ball, whole, at the start and when the gripper closes or opens |

use std::collections::BTreeMap;
use std::io::{self, BufWriter, Seek, Write};

use can_link::BusError;
use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions, Writer};
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::cubecell::joint_state::{JointFlags, JointSample};
use protocol::powercube::{CubeState, Parameter, Reply, ShortState, Value};
use protocol::{Duration, Frame, Instant};
use robot_model::Pose;

use super::arm_view::{Angles, ArmView, Thrown, room_at, thrown_at, timestamp};
use super::facts::{Fact, position};
use super::schema::{self, Message};
use super::watch::{FreezeFrame, LogEvent, Severity, Watch};
use crate::machine::Machine;
use crate::tap::Way;

/// Writes the file. The publish time and `time_us` of a message are the session's time, which is monotonic; its log time is that of
/// the wall clock, or the session's where it is virtual.
pub struct Log<W: Write + Seek> {
    writer: Writer<BufWriter<W>>,
    watch: Watch,
    arm: Option<ArmView>,
    schemas: Schemas,
    channels: BTreeMap<String, u16>,
    sequence: u32,
    zero_unix: Duration,
    /// State of the controller heard last.
    state: Option<State>,
}

#[derive(Clone, Copy)]
struct Schemas {
    frame: u16,
    error: u16,
    module: u16,
    group: u16,
    joint: u16,
    event: u16,
    freeze: u16,
    joints: u16,
    transforms: u16,
    scene: u16,
}

/// What a reader cannot see in the messages: who wrote them, of which robot, and what the times are.
fn about(zero_unix: Duration, machine: Option<&Machine>) -> Metadata {
    let times = if zero_unix == Duration::ZERO {
        "virtual time from zero"
    } else {
        "log time: wall clock; publish time: since the session began"
    };
    let mut metadata = BTreeMap::from([
        ("program".to_owned(), concat!("cubectl ", env!("CARGO_PKG_VERSION")).to_owned()),
        ("times".to_owned(), times.to_owned()),
    ]);
    metadata.extend(machine.map(|machine| ("robot".to_owned(), machine.robot.clone())));
    Metadata { name: "recording".to_owned(), metadata }
}

impl<W: Write + Seek> Log<W> {
    /// Begins the file. `zero_unix` is the Unix time at the session's time zero; zero in virtual time. Without a machine there are
    /// no joints, frames and bodies.
    pub fn new(out: W, zero_unix: Duration, machine: Option<Machine>) -> io::Result<Self> {
        let mut writer = WriteOptions::new()
            .compression(None)
            .profile("")
            .library(concat!("cubectl ", env!("CARGO_PKG_VERSION")))
            .create(BufWriter::new(out))
            .map_err(io_error)?;
        let own = schema::descriptor_set();
        let mut schema = |name: &str, set: &[u8]| writer.add_schema(name, "protobuf", set).map_err(io_error);
        let schemas = Schemas {
            frame: schema(schema::FRAME, &own)?,
            error: schema(schema::BUS_ERROR, &own)?,
            module: schema(schema::MODULE_STATE, &own)?,
            group: schema(schema::GROUP_STATE, &own)?,
            joint: schema(schema::JOINT_STATE, &own)?,
            event: schema(schema::EVENT, schema::PUBLIC)?,
            freeze: schema(schema::FREEZE_FRAME, &own)?,
            joints: schema(schema::JOINT_STATES, schema::PUBLIC)?,
            transforms: schema(schema::TRANSFORMS, schema::PUBLIC)?,
            scene: schema(schema::SCENE, schema::PUBLIC)?,
        };
        let about = about(zero_unix, machine.as_ref());
        writer.write_metadata(&about).map_err(io_error)?;
        let names = machine.as_ref().map(Machine::names).unwrap_or_default();
        let mut log = Self {
            writer,
            watch: Watch::new(names),
            arm: machine.map(ArmView::new),
            schemas,
            channels: BTreeMap::new(),
            sequence: 0,
            zero_unix,
            state: None,
        };
        // There from the start, so that a viewer lists them although nothing came.
        for (topic, schema) in
            [("/bus/frames", schemas.frame), ("/bus/errors", schemas.error), ("/events", schemas.event)]
        {
            log.channel(topic, schema)?;
        }
        Ok(log)
    }

    /// Writes a frame, and its content; true if it has changed the state of the controller.
    pub fn frame(&mut self, at: Instant, way: Way, frame: &Frame) -> io::Result<bool> {
        let before = self.state;
        let sent = way == Way::Sent;
        self.put("/bus/frames", self.schemas.frame, at, frame_message(at, sent, frame))?;
        let notes = self.watch.pass(at, way, frame);
        match notes.fact {
            Some(Fact::Reply { module, reply }) => {
                let state = Message::default().uint(1, at.as_micros()).uint(2, module.get().into());
                if let Some(state) = module_fields(state, &reply) {
                    let topic = format!("/module/{}", module.get());
                    self.put(&topic, self.schemas.module, at, state)?;
                }
                if let Some((q_rad, _)) = position(&reply) {
                    self.angle(at, module.get(), q_rad)?;
                }
            }
            Some(Fact::Group { from, state, .. }) => {
                self.state = Some(state.state);
                self.put("/group", self.schemas.group, at, group_message(at, from.get(), &state))?;
                let unix = at + self.zero_unix;
                let ball = self.arm.as_mut().and_then(|arm| arm.ball(state.gripper_open, unix));
                if let Some(ball) = ball {
                    self.put("/scene", self.schemas.scene, at, ball)?;
                }
            }
            Some(Fact::Joints { joints, .. }) => {
                for (number, sample) in joints {
                    let message = joint_message(at, number.into(), &sample);
                    self.put(&format!("/joint/{number}"), self.schemas.joint, at, message)?;
                }
            }
            _ => {}
        }
        for event in &notes.events {
            self.put("/events", self.schemas.event, at, event_message(event, self.zero_unix))?;
        }
        if let Some(freeze) = notes.freeze {
            self.put("/freeze", self.schemas.freeze, at, freeze_message(&freeze))?;
        }
        Ok(self.state != before)
    }

    /// A drive reported its angle: at the end of a cycle the arm is shown.
    fn angle(&mut self, at: Instant, address: u8, q_rad: f64) -> io::Result<()> {
        let cycle = self.arm.as_mut().and_then(|arm| arm.take(address, q_rad));
        cycle.map_or(Ok(()), |angles| self.arm_at(at, &angles))
    }

    /// Writes the angles of all joints, rad, with frames and bodies of the arm; nothing without a machine.
    pub fn joints(&mut self, at: Instant, q_rad: &[f64]) -> io::Result<()> {
        self.arm_at(at, &q_rad.iter().copied().map(Some).collect())
    }

    fn arm_at(&mut self, at: Instant, angles: &Angles) -> io::Result<()> {
        let unix = at + self.zero_unix;
        let Some(arm) = &mut self.arm else { return Ok(()) };
        let (joints, transforms) = (arm.joint_states(angles, unix), arm.transforms(angles, unix));
        let bodies = transforms.is_some().then(|| arm.bodies(unix)).flatten();
        self.put("/joints", self.schemas.joints, at, joints)?;
        if let Some(transforms) = transforms {
            self.put("/tf", self.schemas.transforms, at, transforms)?;
        }
        if let Some(bodies) = bodies {
            self.put("/scene", self.schemas.scene, at, bodies)?;
        }
        Ok(())
    }

    /// Writes where a ball or disc is that flies or lies, m, in the frame `room`.
    pub fn thrown(&mut self, at: Instant, p_m: [f64; 3], shape: &Thrown) -> io::Result<()> {
        let body = thrown_at(at + self.zero_unix, p_m, shape);
        self.put(shape.topic(), self.schemas.scene, at, body)
    }

    /// Writes where the frame `room` is, seen from the base of the arm.
    pub fn room(&mut self, at: Instant, x_br: &Pose) -> io::Result<()> {
        let frames = room_at(at + self.zero_unix, x_br);
        self.put("/tf", self.schemas.transforms, at, frames)
    }

    pub fn bus_error(&mut self, at: Instant, error: &BusError) -> io::Result<()> {
        let message = Message::default()
            .uint(1, at.as_micros())
            .uint(2, error.class.into())
            .bytes(3, error.to_string().as_bytes());
        self.put("/bus/errors", self.schemas.error, at, message)
    }

    /// Closes the current chunk and hands everything to the operating system.
    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.flush().map_err(io_error)
    }

    /// Writes the summary; nothing can be added afterwards.
    pub fn finish(&mut self) -> io::Result<()> {
        self.writer.finish().map(drop).map_err(io_error)
    }

    fn channel(&mut self, topic: &str, schema: u16) -> io::Result<u16> {
        if let Some(channel) = self.channels.get(topic) {
            return Ok(*channel);
        }
        let channel =
            self.writer.add_channel(schema, topic, "protobuf", &BTreeMap::new()).map_err(io_error)?;
        self.channels.insert(topic.to_owned(), channel);
        Ok(channel)
    }

    fn put(&mut self, topic: &str, schema: u16, at: Instant, message: Message) -> io::Result<()> {
        let channel_id = self.channel(topic, schema)?;
        self.sequence = self.sequence.wrapping_add(1);
        let ns = |time: Instant| time.as_micros().saturating_mul(1_000);
        let (log_time, publish_time) = (ns(at + self.zero_unix), ns(at));
        let header = MessageHeader { channel_id, sequence: self.sequence, log_time, publish_time };
        self.writer.write_to_known_channel(&header, &message.into_bytes()).map_err(io_error)
    }
}

fn frame_message(at: Instant, sent: bool, frame: &Frame) -> Message {
    let message = Message::default()
        .uint(1, at.as_micros())
        .uint(2, frame.id().raw().into())
        .uint(3, frame.is_extended().into())
        .uint(4, frame.is_remote().into())
        .uint(5, sent.into())
        .bytes(6, frame.data());
    match frame.fd() {
        Some(flags) => message.uint(7, 1).uint(8, flags.brs.into()).uint(9, flags.esi.into()),
        None => message,
    }
}

/// `None` for an answer with neither position nor current.
fn module_fields(state: Message, reply: &Reply) -> Option<Message> {
    if let Some((q_rad, short)) = position(reply) {
        let state = state.double(3, q_rad);
        let Some(short) = short else { return Some(state) };
        let [not_ok, moving] =
            [ShortState::NOT_OK, ShortState::MOTION].map(|bit| u64::from(short.intersects(bit)));
        return Some(state.uint(4, not_ok).uint(5, moving));
    }
    match reply {
        Reply::Value(Parameter::Cur, Value::F32(current_a)) => Some(state.double(6, (*current_a).into())),
        _ => None,
    }
}

fn group_message(at: Instant, controller: u8, state: &GroupState) -> Message {
    Message::default()
        .uint(1, at.as_micros())
        .uint(2, controller.into())
        .bytes(3, state.state.to_string().as_bytes())
        .uint(4, state.state as u64)
        .uint(5, state.fault_cause.into())
        .uint(6, state.fault_joint.into())
        .uint(7, state.homed_mask.into())
        .uint(8, state.host_alive.into())
        .uint(9, state.gripper_open.into())
        .uint(10, state.cycle_us.into())
        .uint(11, state.cycle_jitter_us.into())
        .uint(12, state.cycles_late.into())
        .uint(13, state.replies_missed.into())
        .uint(14, state.cycles_saturated.into())
        .double(15, f64::from(state.bus_load_permille) * 1e-3)
        .double(16, f64::from(state.trajectory_time_us) * 1e-6)
        .uint(17, state.uptime_us)
}

fn joint_message(at: Instant, number: u64, sample: &JointSample) -> Message {
    Message::default()
        .uint(1, at.as_micros())
        .uint(2, number)
        .double(3, sample.q_rad.into())
        .double(4, sample.qd_rad_s.into())
        .double(5, sample.error_q_rad.into())
        .double(6, sample.error_qd_rad_s.into())
        .double(7, sample.qdd_command_rad_s2.into())
        .double_if(8, Some(f64::from(sample.current_a)).filter(|a| a.is_finite()))
        .uint(9, sample.flags.has(JointFlags::ACCELERATION_CLIPPED).into())
        .uint(10, sample.flags.has(JointFlags::REPLY_MISSED).into())
}

fn event_message(event: &LogEvent, zero_unix: Duration) -> Message {
    let level = match event.severity {
        Severity::Info => 2,
        Severity::Warning => 3,
        Severity::Error => 4,
    };
    Message::default()
        .bytes(1, &timestamp(event.at + zero_unix))
        .uint(2, level)
        .bytes(3, event.text.as_bytes())
        .bytes(4, event.source.as_bytes())
}

fn freeze_message(freeze: &FreezeFrame) -> Message {
    let mut message = Message::default()
        .uint(1, freeze.at.as_micros())
        .uint(2, freeze.group.fault_cause.into())
        .uint(3, freeze.group.fault_joint.into())
        .bytes(4, freeze.before.to_string().as_bytes())
        .double(5, f64::from(freeze.group.trajectory_time_us) * 1e-6);
    for (module, heard) in &freeze.drives {
        let age = heard.position.map(|(at, _)| freeze.at.saturating_since(at).as_secs_f64());
        let drive = Message::default()
            .uint(1, (*module).into())
            .double_if(2, heard.position.map(|(_, q_rad)| q_rad))
            .double_if(3, age)
            .double_if(4, heard.current_a)
            .double_if(5, heard.ramp_target_rad)
            .double_if(6, heard.ramp_a_rad_s2)
            .uint(7, heard.state.map_or(0, CubeState::bits).into());
        message = message.bytes(6, &drive.into_bytes());
    }
    for (at, frame) in &freeze.frames {
        message = message.bytes(7, &frame_message(*at, false, frame).into_bytes());
    }
    message
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}
