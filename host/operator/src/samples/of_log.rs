//! Samples of the frames of a bus: one pass over a log, each frame decoded once.

use protocol::bits;
use protocol::powercube::{MotionCommand, Parameter, Reply, Request, Value};
use protocol::{Duration, Instant};

use super::drives::Drives;
use super::{At, BitTimes, BusLog, Freeze, GroupTold, JointFreeze, JointSamples, RampOrder, Samples};
use crate::drives::{self, Measured, Seen};
use crate::log::candump::Line;
use crate::log::facts::{Fact, position};
use crate::log::watch::{FreezeFrame, Watch};
use planner::throw::Arm;

/// Time of the first frame of a state message at 1 Mbit/s: extended, eight bytes, few stuff bits.
const FIRST_FRAME: Duration = Duration::from_micros(bits::best_case(true, 8).frame() as u64);

impl Samples {
    /// Samples of a log in ascending time; `drives` are those of the joints of `arm`.
    ///
    /// A position is measured where the answer that carries it begins: drives measure just before they answer. What differs in a family
    /// is in its file of `drives`. Motors other than PowerCubes are those of the robot file.
    #[must_use]
    pub fn of_log(frames: Vec<Line>, drives: Drives, arm: &Arm, bit_rate_bit_s: u32) -> Self {
        let data_bit_rate_bit_s = arm.data_bit_rate_bit_s();
        let bus = BusLog { frames, bit_times: BitTimes::of(bit_rate_bit_s, data_bit_rate_bit_s), drives };
        let samples = read(&bus, arm);
        Self { bus: Some(bus), ..samples }
    }
}

/// Samples without the frames.
fn read(bus: &BusLog, arm: &Arm) -> Samples {
    let drives = &bus.drives;
    let names =
        drives.address.iter().zip(arm.joints()).map(|(address, joint)| (*address, joint.name.clone()));
    let mut watch = Watch::new(names.collect());
    let mut reader = Reader {
        drives,
        motors: drives::reader(arm),
        samples: Samples {
            joints: vec![JointSamples::default(); drives.address.len()],
            ..Samples::default()
        },
        ramps: vec![Ramp::default(); drives.address.len()],
    };
    for Line { at, frame, .. } in &bus.frames {
        let notes = watch.take(*at, frame);
        reader.samples.events.extend(notes.events);
        reader.samples.freezes.extend(notes.freeze.map(|freeze| frozen(&freeze, drives)));
        let begun = at.saturating_sub(Duration::from_secs_f64(bus.bit_times.frame_s(bits::length(frame))));
        if let Some(fact) = notes.fact {
            reader.take(*at, begun, &fact);
        }
        reader.take_frame(Seen { begun, at: *at, frame });
    }
    reader.samples
}

/// Speed and acceleration that were written last, of the joint.
#[derive(Clone, Copy, Default)]
struct Ramp {
    v_rad_s: Option<f64>,
    a_rad_s2: Option<f64>,
}

struct Reader<'a> {
    drives: &'a Drives,
    /// Reads the frames of motors other than PowerCubes.
    motors: Option<Box<dyn drives::Reader + 'a>>,
    samples: Samples,
    ramps: Vec<Ramp>,
}

impl Reader<'_> {
    fn take(&mut self, at: Instant, begun: Instant, fact: &Fact) {
        match fact {
            Fact::Request { module, request } => {
                if let Request::Set(Parameter::DioData, _) = request {
                    self.samples.gripper_ordered.push(at);
                }
                if let Some(joint) = self.drives.joint_of(*module) {
                    self.ordered(at, joint, *request);
                }
            }
            Fact::Reply { module, reply } => {
                if let Some(joint) = self.drives.joint_of(*module) {
                    self.answered(begun, joint, reply);
                }
            }
            Fact::Group { first_at, state, .. } => {
                let made_by = first_at.saturating_sub(FIRST_FRAME);
                self.samples.group.push(GroupTold { at, made_by, state: *state });
            }
            Fact::Joints { joints, .. } => {
                for (number, sample) in joints {
                    let joint = usize::from(*number).wrapping_sub(1);
                    let Some(of_joint) = self.samples.joints.get_mut(joint) else { continue };
                    of_joint.reported.push((at, *sample));
                    if let Some(motors) = &mut self.motors {
                        motors.align(joint, f64::from(sample.q_rad));
                    }
                }
            }
            _ => {}
        }
    }

    fn take_frame(&mut self, seen: Seen<'_>) {
        let joint_rad = |joint, drive_rad| self.drives.joint_rad(joint, drive_rad);
        let measured = self.motors.as_mut().and_then(|motors| motors.take(seen, &joint_rad));
        if let Some(Measured { joint, at, q_rad, temperature_c }) = measured {
            let Some(of_joint) = self.samples.joints.get_mut(joint) else { return };
            of_joint.positions.push(At { at, value: q_rad });
            of_joint.temperatures.extend(temperature_c.map(|value| At { at, value }));
        }
    }

    fn ordered(&mut self, at: Instant, joint: usize, request: Request) {
        let ramp = &mut self.ramps[joint];
        match request {
            Request::Set(Parameter::TargetVel, Value::F32(v)) => ramp.v_rad_s = Some(v.into()),
            Request::Set(Parameter::TargetAcc, Value::F32(a)) => ramp.a_rad_s2 = Some(a.into()),
            Request::Move(motion) => {
                if let MotionCommand::Ramp { target } = motion.command() {
                    let target_rad = self.drives.joint_rad(joint, target.get().into());
                    let Ramp { v_rad_s, a_rad_s2 } = *ramp;
                    self.samples.joints[joint].orders.push(RampOrder { at, target_rad, v_rad_s, a_rad_s2 });
                }
            }
            _ => {}
        }
    }

    fn answered(&mut self, at: Instant, joint: usize, reply: &Reply) {
        let of_joint = &mut self.samples.joints[joint];
        if let Some((q_rad, _)) = position(reply) {
            of_joint.positions.push(At { at, value: self.drives.joint_rad(joint, q_rad) });
        }
        if let Reply::Value(Parameter::Cur, Value::F32(a)) = reply {
            of_joint.currents.push(At { at, value: self.drives.turned(joint, f64::from(*a)) });
        }
    }
}

/// What was known of the drives, as what is known of the joints.
fn frozen(freeze: &FreezeFrame, drives: &Drives) -> Freeze {
    let joint = |(j, address): (usize, &u8)| {
        let heard = freeze.drives.get(address).copied().unwrap_or_default();
        JointFreeze {
            position: heard.position.map(|(at, rad)| At { at, value: drives.joint_rad(j, rad) }),
            current_a: heard.current_a.map(|a| drives.turned(j, a)),
            ramp_a_rad_s2: heard.ramp_a_rad_s2,
            ramp_target_rad: heard.ramp_target_rad.map(|rad| drives.joint_rad(j, rad)),
        }
    };
    Freeze {
        at: freeze.at,
        group: freeze.group,
        before: freeze.before,
        joints: drives.address.iter().enumerate().map(joint).collect(),
        frames: freeze.frames.iter().map(|(at, frame)| (*at, frame.to_string())).collect(),
    }
}
