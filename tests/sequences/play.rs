//! Plays a sequence in the lab, under the eyes of the judge.

use std::panic::{AssertUnwindSafe, catch_unwind};

use hil_sim::world::RunError;
use protocol::cyphal::bits::{Encode, Writer};
use protocol::cyphal::crc::Crc64;
use protocol::cyphal::cubecell::command::{
    self, ArmConfirm, ArmPrepare, ClearFault, Gripper, Home, Jog, Run, Trajectory,
};
use protocol::cyphal::cubecell::{TRAJECTORY_PATH, stop};
use protocol::cyphal::id::{Priority, Route, ServiceId, SubjectId};
use protocol::cyphal::uavcan::command::{self as commands, CommandRequest, standard};
use protocol::cyphal::uavcan::file::{self, WriteRequest};
use protocol::cyphal::uavcan::info;
use protocol::cyphal::uavcan::register::{self, AccessRequest};
use protocol::cyphal::uavcan::value::ValueBuf;
use protocol::{Duration, Instant};

use crate::families::Family;
use crate::judge::{Judge, Order};
use crate::lab::{CLIENTS, JOINTS, Lab, SERVER, Tap, plan};
use crate::rules::{Rule, Taken, Violation};
use crate::steps::{Act, Hand, Register, Step, Who};

/// Time for the homing of absolute encoders, ms.
const HOME_MS: u16 = 500;
/// Time after the last step in which all must come to rest, ms.
const END_MS: u16 = 1_500;

/// No parameter.
struct Nothing;

impl Encode for Nothing {
    fn encode(&self, _: &mut Writer<'_>) {}
}

struct Play<F: Family> {
    lab: Lab<F>,
    judge: Judge,
    tap: Tap,
    /// Plan that was uploaded last.
    name: Trajectory,
    hand: Hand,
}

/// All that breaks a rule, and how much happened.
pub(crate) fn play<F: Family>(
    start_mrad: [i16; JOINTS],
    seed: u64,
    steps: &[Step],
) -> (Vec<Violation>, Taken) {
    let mut play = Play {
        lab: Lab::<F>::new(start_mrad, seed),
        judge: Judge::new::<F>(),
        tap: Tap::default(),
        name: Trajectory::default(),
        hand: Hand::Nothing,
    };
    let outcome = catch_unwind(AssertUnwindSafe(|| play.all(steps)));
    let what = match outcome {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("a panic".to_owned()),
    };
    let mut violations = std::mem::take(&mut play.judge.violations);
    if let Some(what) = what {
        violations.push(Violation { rule: Rule::Contract, at: play.lab.now(), what });
    }
    (violations, play.judge.taken)
}

impl<F: Family> Play<F> {
    fn all(&mut self, steps: &[Step]) -> Result<(), RunError> {
        self.wait(F::BOOT_MS)?;
        if !F::IS_POWERCUBE {
            // PowerCubes keep their zeros.
            self.act(Act::Home(3))?;
            self.wait(HOME_MS)?;
        }
        for (wait, act) in steps {
            self.wait(*wait)?;
            self.act(*act)?;
        }
        self.lab.silence(60_000)?;
        self.wait(END_MS)?;
        let now = self.lab.now();
        let plant = self.lab.plant();
        if plant.iter().any(|(_, v)| v.abs() > 0.02) {
            let what = format!("not at rest {END_MS} ms after the last sign of life: {plant:?}");
            self.judge.violations.push(Violation { rule: Rule::Motion, at: now, what });
        }
        Ok(())
    }

    fn wait(&mut self, ms: u16) -> Result<(), RunError> {
        for _ in 0..ms {
            self.tap.0.clear();
            self.lab.run(1_000, &mut self.tap)?;
            for (at, from, frame) in &self.tap.0 {
                self.judge.frame(&self.lab, *at, *from, frame);
            }
            self.judge.look(&self.lab);
        }
        Ok(())
    }

    fn request(
        &mut self,
        client: usize,
        service: ServiceId,
        message: &dyn Encode,
        order: Order,
    ) -> Result<(), RunError> {
        let route = Route::Request { service, source: CLIENTS[client], destination: SERVER };
        let id = self.lab.send(client, route, Priority::Nominal, message)?;
        self.judge.sends(client, id, service.get(), order);
        Ok(())
    }

    fn command(
        &mut self,
        client: usize,
        number: u16,
        parameter: &dyn Encode,
        order: Order,
    ) -> Result<(), RunError> {
        let mut bytes = [0; 64];
        let mut writer = Writer::new(&mut bytes);
        parameter.encode(&mut writer);
        let len = writer.finish().expect("parameters are short");
        let request = CommandRequest { command: number, parameter: &bytes[..len] };
        self.request(client, commands::SERVICE, &request, order)
    }

    fn by_host(&mut self, number: u16, parameter: &dyn Encode, order: Order) -> Result<(), RunError> {
        self.command(0, number, parameter, order)
    }

    fn run(&mut self, start: Option<Instant>) -> Result<(), RunError> {
        let Trajectory { trajectory_crc64, length_bytes } = self.name;
        let start_us = start.map_or(0, Instant::as_micros);
        let run = Run { trajectory_crc64, length_bytes, start_us };
        self.by_host(command::RUN, &run, Order::Run { start, hand: self.hand })
    }

    fn act(&mut self, act: Act) -> Result<(), RunError> {
        let now = self.lab.now();
        match act {
            Act::Home(joint_mask) => {
                self.by_host(command::HOME, &Home { joint_mask }, Order::Home(joint_mask))
            }
            Act::Jog { joint, mrad_s, hold_ms } => {
                let v_rad_s = f64::from(mrad_s) * 1e-3;
                let hold = Duration::from_millis(hold_ms.into());
                let order = Order::Jog { joint: joint.into(), v_rad_s, hold };
                self.by_host(command::JOG, &Jog { joint, qd_rad_s: v_rad_s as f32, hold_ms }, order)
            }
            Act::LetGo(joint) => {
                let order = Order::Jog { joint: joint.into(), v_rad_s: 0.0, hold: Duration::ZERO };
                self.by_host(command::JOG, &Jog { joint, qd_rad_s: 0.0, hold_ms: 100 }, order)
            }
            Act::Stop(who) => self.command(client(who), command::STOP, &Nothing, Order::Stop),
            Act::EmergencyStop(who) => {
                self.command(client(who), standard::EMERGENCY_STOP, &Nothing, Order::EmergencyStop)
            }
            Act::Disarm(who) => self.command(client(who), command::DISARM, &Nothing, Order::Disarm),
            Act::StopMessage(who) => {
                let client = client(who);
                let route = Route::Message { subject: stop::SUBJECT, source: CLIENTS[client] };
                let id = self.lab.send(client, route, Priority::Exceptional, &stop::Stop::default())?;
                self.judge.sends(client, id, stop::SUBJECT.get(), Order::StopMessage);
                Ok(())
            }
            Act::Clear { right } => {
                let seen = self.judge.state.map_or(0, |state| state.fault_cause);
                let fault_cause = if right { seen } else { seen.wrapping_add(1) };
                self.by_host(command::CLEAR_FAULT, &ClearFault { fault_cause }, Order::Clear(fault_cause))
            }
            Act::Write(register) => self.write(register),
            Act::Upload { mrad, ms, hand } => self.upload(mrad, ms, hand),
            Act::Commit => self.by_host(command::COMMIT_TRAJECTORY, &{ self.name }, Order::Commit),
            Act::Prepare => {
                let prepare = ArmPrepare { trajectory_crc64: self.name.trajectory_crc64, valid_ms: 5_000 };
                self.by_host(command::ARM_PREPARE, &prepare, Order::Prepare)
            }
            Act::Confirm => {
                let confirm = ArmConfirm { token: self.judge.token, valid_ms: 5_000 };
                self.by_host(command::ARM_CONFIRM, &confirm, Order::Confirm)
            }
            Act::Run => self.run(None),
            Act::RunIn { ms } => self.run(Some(now + Duration::from_millis(ms.into()))),
            Act::Gripper(open) => self.by_host(command::GRIPPER, &Gripper { open }, Order::Other),
            Act::Restart(drive) => {
                self.judge.restart(now);
                self.lab.restart(drive.into())
            }
            Act::Deaf { drive, ms } => {
                self.judge.deafen(now, ms);
                self.lab.deafen(drive.into(), ms);
                Ok(())
            }
            Act::Questions(count) => {
                self.judge.disturb(now, u16::from(count));
                (0..count).try_for_each(|_| self.request(0, info::SERVICE, &Nothing, Order::Other))
            }
            Act::Babble(count) => {
                self.judge.disturb(now, u16::from(count) / 5);
                let route = Route::Message { subject: SubjectId::from_low_bits(3), source: CLIENTS[1] };
                let beat = stop::Stop::default();
                (0..count).try_for_each(|_| self.lab.send(1, route, Priority::Immediate, &beat).map(drop))
            }
            Act::Late(ms) => {
                self.judge.disturb(now, ms);
                self.lab.hold_up(ms)
            }
            Act::Silent(ms) => self.lab.silence(ms),
            Act::Wait => Ok(()),
        }
    }

    fn write(&mut self, register: Register) -> Result<(), RunError> {
        let real = |x: f32| ValueBuf::try_from(&[x; JOINTS][..]).expect("two numbers");
        let natural = |x: u32| ValueBuf::try_from(&[x][..]).expect("one number");
        let bit = |x: bool| ValueBuf::bits(&[x]).expect("one bit");
        let (name, value) = match register {
            Register::Prove(on) => ("watchdog.prove", bit(on)),
            Register::Watchdog(on) => ("watchdog.enable", bit(on)),
            Register::MonitorUs(us) => ("cycle.monitor_us", natural(us)),
            Register::TelemetryUs(us) => ("telemetry.period_us", natural(us)),
            Register::Alpha(x) => ("estimator.alpha", ValueBuf::try_from(&[x][..]).expect("one number")),
            Register::QMax(q) => ("joint.q_max_rad", real(q)),
            Register::VMax(v) => ("joint.v_max_rad_s", real(v)),
            Register::Current(a) => ("joint.current_max_a", real(a)),
        };
        let request = AccessRequest { name: name.as_bytes(), value: value.as_value() };
        self.request(0, register::ACCESS, &request, Order::Write(register))
    }

    fn upload(&mut self, mrad: [i16; JOINTS], ms: u16, hand: Hand) -> Result<(), RunError> {
        let bytes = plan(self.lab.plant().map(|(q, _)| q), mrad, ms, hand);
        self.name = Trajectory { trajectory_crc64: Crc64::of(&bytes), length_bytes: bytes.len() as u32 };
        self.hand = hand;
        for (offset, data) in [(0, &bytes[..]), (bytes.len(), &[][..])] {
            let request = WriteRequest { offset: offset as u64, path: TRAJECTORY_PATH, data };
            self.request(0, file::WRITE, &request, Order::Piece)?;
        }
        Ok(())
    }
}

fn client(who: Who) -> usize {
    match who {
        Who::Host => 0,
        Who::Other => 1,
    }
}
