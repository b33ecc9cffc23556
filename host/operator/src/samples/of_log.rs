//! Samples of the frames of a bus: one pass over a log, each frame decoded once.

use std::f64::consts::TAU;

use canopen_protocol::Function;
use mit_protocol::{State, Status};
use odrive_protocol::{Report, Request as Asked};
use protocol::bits;
use protocol::powercube::{MotionCommand, Parameter, Reply, Request, Value};
use protocol::{Duration, Frame, Instant};
use robot_model::{Cia402Servo, Joint, MitMotor, OdriveAxis};

use super::drives::Drives;
use super::{
    At, BitTimes, BusFrame, BusLog, Freeze, GroupTold, JointFreeze, JointSamples, RampOrder, Samples,
};
use crate::log::candump::Line;
use crate::log::facts::{Fact, position};
use crate::log::watch::{FreezeFrame, Watch};
use planner::throw::Arm;

/// Time of the first frame of a state message at 1 Mbit/s: extended, eight bytes, few stuff bits.
const FIRST_FRAME: Duration = Duration::from_micros(bits::best_case(true, 8).frame() as u64);

/// A joint that stands a little beyond its range is not a turn away, rad.
const BESIDE_RAD: f64 = 0.1;

impl Samples {
    /// Samples of a log in ascending time; `drives` are those of the joints of `arm`.
    ///
    /// A position is measured where the answer that carries it begins: drives measure just before they answer. CANopen servos measure
    /// at the SYNC, ODrives when they are asked. Motors with MIT frames, servos and axes are those of the robot file.
    #[must_use]
    pub fn of_log(lines: Vec<Line>, drives: Drives, arm: &Arm, bit_rate_bit_s: u32) -> Self {
        let frames = lines.into_iter().map(|line| BusFrame { at: line.at, frame: line.frame }).collect();
        let data_bit_rate_bit_s = arm.data_bit_rate_bit_s();
        let bus = BusLog { frames, bit_times: BitTimes::of(bit_rate_bit_s, data_bit_rate_bit_s), drives };
        let drives = &bus.drives;
        let names =
            drives.address.iter().zip(arm.joints()).map(|(address, joint)| (*address, joint.name.clone()));
        let mut watch = Watch::new(names.collect());
        let mut reader = Reader {
            drives,
            joints: arm.joints(),
            motors: arm.mit_motors().map_or(&[], |motors| &motors.joints),
            servos: arm.cia402_servos().map_or(&[], |all| &all.servos),
            synchronized_at: None,
            axes: arm.odrive_axes().map_or(&[], |all| &all.axes),
            of_axes: vec![Axis::default(); drives.address.len()],
            samples: Self { joints: vec![JointSamples::default(); drives.address.len()], ..Self::default() },
            ramps: vec![Ramp::default(); drives.address.len()],
        };
        for BusFrame { at, frame } in &bus.frames {
            let notes = watch.take(*at, frame);
            reader.samples.events.extend(notes.events);
            reader.samples.freezes.extend(notes.freeze.map(|freeze| frozen(&freeze, drives)));
            let begun =
                at.saturating_sub(Duration::from_secs_f64(bus.bit_times.frame_s(bits::length(frame))));
            if let Some(fact) = notes.fact {
                reader.take(*at, begun, &fact);
            }
            reader.take_motor(begun, frame);
            reader.take_servo(*at, frame);
            reader.take_axis(*at, begun, frame);
        }
        let samples = reader.samples;
        Self { bus: Some(bus), ..samples }
    }
}

/// After power-up a motor knows its angle within one turn. The range of the joint decides which turn it is.
fn in_range(joint: &Joint, q_rad: f64) -> f64 {
    let (low, high) = (joint.limits.q_min_rad - BESIDE_RAD, joint.limits.q_max_rad + BESIDE_RAD);
    let turns = [q_rad, q_rad - TAU, q_rad + TAU];
    turns.into_iter().find(|q| (low..=high).contains(q)).unwrap_or(q_rad)
}

/// Speed and acceleration that were written last, of the joint.
#[derive(Clone, Copy, Default)]
struct Ramp {
    v_rad_s: Option<f64>,
    a_rad_s2: Option<f64>,
}

/// What an ODrive was asked, and what it counts.
#[derive(Clone, Copy, Default)]
struct Axis {
    /// End of the last request for estimates.
    asked_at: Option<Instant>,
    /// Last position, of the joint, if whole turns that are counted are right.
    counted_rad: Option<f64>,
    /// Whole turns by which it is wrong, rad: the controller knows the zero.
    shift_rad: f64,
}

struct Reader<'a> {
    drives: &'a Drives,
    joints: &'a [Joint],
    /// Of the joints, if they have MIT frames.
    motors: &'a [MitMotor],
    /// Of the joints, if they are CANopen servos.
    servos: &'a [Cia402Servo],
    /// Of the joints, if they are ODrives.
    axes: &'a [OdriveAxis],
    of_axes: Vec<Axis>,
    /// End of the last SYNC.
    synchronized_at: Option<Instant>,
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
                    let joint =
                        usize::from(*number).checked_sub(1).and_then(|j| self.samples.joints.get_mut(j));
                    joint.into_iter().for_each(|joint| joint.told.push((at, *sample)));
                    self.align(*number, f64::from(sample.q_rad));
                }
            }
            _ => {}
        }
    }

    /// The answer of a motor with torque: of one without, an answer of a register looks the same.
    fn take_motor(&mut self, at: Instant, frame: &Frame) {
        let state = |motor: &MitMotor| State::decode(frame, motor.id, motor.answers_on, &motor.motor.ranges);
        for ((joint, motor), of_joint) in self.motors.iter().enumerate().zip(&mut self.samples.joints) {
            if let Some(state) = state(motor).filter(|state| state.status == Status::Enabled) {
                let q_rad =
                    in_range(&self.joints[joint], self.drives.joint_rad(joint, f64::from(state.p_rad)));
                of_joint.positions.push(At { at, value: q_rad });
                let hottest_c = state.transistors_c.max(state.rotor_c);
                of_joint.temperatures.push(At { at, value: hottest_c.into() });
            }
        }
    }

    /// Process data of a servo, mapped as the controller does: status word, position in counts.
    fn take_servo(&mut self, at: Instant, frame: &Frame) {
        if self.servos.is_empty() {
            return;
        }
        let node = match Function::of_frame(frame) {
            Some(Function::Sync) => {
                self.synchronized_at = Some(at);
                return;
            }
            Some(Function::Tpdo(1, node)) => node,
            _ => return,
        };
        let joint = self.servos.iter().position(|servo| servo.node == node);
        let counts = frame.data().get(2..).and_then(|rest| rest.first_chunk::<4>());
        if let (Some(joint), Some(counts), Some(at)) = (joint, counts, self.synchronized_at) {
            let turns =
                f64::from(i32::from_le_bytes(*counts)) / f64::from(self.servos[joint].counts_per_turn);
            let q_rad = self.drives.joint_rad(joint, TAU * turns);
            self.samples.joints[joint].positions.push(At { at, value: q_rad });
        }
    }

    /// Estimates of an axis, which hold for the time of the last request.
    fn take_axis(&mut self, at: Instant, begun: Instant, frame: &Frame) {
        for (joint, axis) in self.axes.iter().enumerate() {
            let of_axis = &mut self.of_axes[joint];
            if *frame == Asked::Estimates.encode(axis.node) {
                of_axis.asked_at = Some(at);
            } else if let Some((node, Report::Estimates { rev, .. })) = Report::decode(frame, axis.version)
                && node == axis.node
            {
                let drive_rad = TAU * f64::from(rev) / axis.counted();
                let q_rad = self.drives.joint_rad(joint, drive_rad);
                of_axis.counted_rad = Some(q_rad).filter(|q_rad| q_rad.is_finite());
                let at = of_axis.asked_at.take().unwrap_or(begun);
                if let Some(q_rad) = of_axis.counted_rad {
                    let value = q_rad + of_axis.shift_rad;
                    self.samples.joints[joint].positions.push(At { at, value });
                }
            }
        }
    }

    /// Takes the zero of an axis from what the controller reports of its joint. A joint moves by less than a quarter of a turn that is counted
    /// until its report is on the bus.
    fn align(&mut self, number: u8, reported_rad: f64) {
        let joint = usize::from(number).wrapping_sub(1);
        let (Some(axis), Some(of_axis)) = (self.axes.get(joint), self.of_axes.get_mut(joint)) else { return };
        let turn_rad = TAU / axis.counted();
        if let Some(counted_rad) = of_axis.counted_rad {
            let turns = (reported_rad - counted_rad) / turn_rad;
            if (turns - turns.round()).abs() < 0.25 {
                of_axis.shift_rad = turns.round() * turn_rad;
            }
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
