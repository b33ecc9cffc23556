//! A drive, as simple as possible.

use protocol::ModuleId;
use protocol::powercube::{
    Broadcast, Config, CubeState, Dio, MotionCommand, MotionKind, MotionPosition, Parameter, PosStateDio,
    Reply, Request, SimpleCommand, Value,
};
use protocol::units::Radians;

/// Fault of the positions of a drive, or of the drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Wrong {
    /// Reported positions stay at this position.
    Frozen(f64),
    /// Reported positions move in the opposite direction from this position on.
    Reversed(f64),
    /// Reported positions move with this share of the speed from this position on.
    Creeping(f64, f64),
    /// Reported positions have this error.
    Offset(f64),
    /// Motions are acknowledged and not executed: the joint brakes and stays.
    Deaf,
}

/// Ramp generator in front of a position loop (wn 320 rad/s, zeta 0.8), position in steps of 0.02 degrees.
#[derive(Clone, Debug)]
pub(crate) struct BenchDrive {
    pub module: ModuleId,
    pub q: f64,
    pub v: f64,
    pub q_gen: f64,
    pub v_gen: f64,
    pub v_ramp: f64,
    pub a_ramp: f64,
    pub target: Option<f64>,
    /// Speed and acceleration as written; the next motion takes them.
    written: (f64, f64),
    pub state: CubeState,
    pub config: Config,
    pub dio: u8,
    pub current_a: f32,
    /// Answers nothing and starts nothing new.
    pub silent: bool,
    /// Replies to drop, counted down.
    pub drop_replies: u32,
    pub watchdog_seen: Option<u64>,
    pub watchdog_us: u64,
    /// Every frame to the drive refreshes its watchdog, not only the sign of life.
    pub any_frame_is_life: bool,
    /// A watchdog that runs continues after a reset. Otherwise the next sign of life starts it.
    pub reset_keeps_watchdog: bool,
    /// What the drive shows once its watchdog has expired.
    pub watchdog_shows: CubeState,
    pub wrong: Option<Wrong>,
    /// Speed of a motion without an order, rad/s; a halt ends it.
    pub creep_rad_s: f64,
    /// Speed of a motion from outside, which the drive does not report, rad/s: a hand, or a brake that slips.
    pub slips_rad_s: f64,
    /// Halts that have no effect, counted down.
    pub deaf_to_halts: u32,
    /// Stays halted whatever order comes.
    pub stays_halted: bool,
    /// Time at which homing ends.
    homing_until: Option<u64>,
    pub home_takes_us: u64,
    pub max_cur: f32,
    /// Gripper writes that do not reach it, counted down.
    pub misses_gripper_writes: u32,
    /// Ideal drive: position follows the generator exactly and is not quantised.
    pub ideal: bool,
    at_us: u64,
}

impl BenchDrive {
    pub(super) fn new(module: u8) -> Self {
        Self {
            module: ModuleId::new(module).unwrap(),
            q: 0.0,
            v: 0.0,
            q_gen: 0.0,
            v_gen: 0.0,
            v_ramp: 0.5,
            a_ramp: 1.0,
            target: None,
            written: (0.5, 1.0),
            state: CubeState::HOME_OK.union(CubeState::RAMP_END),
            config: Config::EMPTY,
            dio: 0,
            current_a: 1.0,
            silent: false,
            drop_replies: 0,
            watchdog_seen: None,
            watchdog_us: 50_000,
            any_frame_is_life: false,
            reset_keeps_watchdog: false,
            watchdog_shows: CubeState::ERROR.union(CubeState::COMM_ERROR).union(CubeState::HALTED),
            wrong: None,
            creep_rad_s: 0.0,
            slips_rad_s: 0.0,
            deaf_to_halts: 0,
            stays_halted: false,
            homing_until: None,
            home_takes_us: 300_000,
            max_cur: 30.0,
            misses_gripper_writes: 0,
            ideal: false,
            at_us: 0,
        }
    }

    pub(crate) fn place(&mut self, q: f64) {
        (self.q, self.q_gen, self.v, self.v_gen) = (q, q, 0.0, 0.0);
    }

    /// A new bench begins at zero; a watchdog that runs keeps running.
    pub(crate) fn restart_clock(&mut self) {
        self.at_us = 0;
        self.watchdog_seen = self.watchdog_seen.map(|_| 0);
    }

    /// True speed, rad/s.
    pub(crate) fn speed(&self) -> f64 {
        self.v + self.slips_rad_s + if self.refuses() { 0.0 } else { self.creep_rad_s }
    }

    fn stop_hard(&mut self) {
        // Emergency stop: brakes with what its own limit allows, and ends a homing.
        self.homing_until = None;
        self.a_ramp = 20.0;
        self.target = Some(self.q_gen + 0.5 * self.v_gen * self.v_gen.abs() / self.a_ramp);
    }

    pub(crate) fn advance(&mut self, to_us: u64) {
        const STEP: u64 = 20;
        while self.at_us + STEP <= to_us {
            self.at_us += STEP;
            let dt = STEP as f64 * 1e-6;
            if let Some(target) = self.target {
                let d = target - self.q_gen;
                let braking =
                    d * self.v_gen > 0.0 && self.v_gen * self.v_gen / (2.0 * self.a_ramp) >= d.abs();
                let wanted = if braking || d == 0.0 { 0.0 } else { d.signum() * self.v_ramp };
                let dv = (wanted - self.v_gen).clamp(-self.a_ramp * dt, self.a_ramp * dt);
                self.q_gen += dt * (self.v_gen + 0.5 * dv);
                self.v_gen += dv;
                if self.v_gen.abs() < 2.0 * self.a_ramp * dt && d.abs() < 1e-6 {
                    (self.q_gen, self.v_gen, self.target) = (target, 0.0, None);
                }
            }
            let creeps = if self.refuses() { 0.0 } else { self.creep_rad_s };
            let pushed = dt * (creeps + self.slips_rad_s);
            (self.q, self.q_gen) = (self.q + pushed, self.q_gen + pushed);
            let moving = self.v_gen.abs() > 1e-4 || creeps != 0.0;
            self.state = self.state.with(CubeState::MOTION, moving).with(CubeState::RAMP_END, !moving);
            if self.ideal {
                (self.q, self.v) = (self.q_gen, self.v_gen);
            } else {
                let (wn, zeta) = (320.0, 0.8);
                // Damping on the speed itself: the position is 2 zeta / wn behind, as in `drive_lag_us`.
                let a = wn * wn * (self.q_gen - self.q) - 2.0 * zeta * wn * self.v;
                self.v += dt * a;
                self.q += dt * self.v;
            }
        }
        if let Some(until) = self.homing_until.filter(|&until| until <= to_us) {
            let _ = until;
            self.homing_until = None;
            self.state = self.state.with(CubeState::HOME_OK, true);
        }
        if self.homing_until.is_some() {
            self.state = self.state.with(CubeState::MOTION, true);
        }
        let expired = self.config.contains(Config::WATCHDOG_ENABLE)
            && self.watchdog_seen.is_some_and(|seen| to_us > seen + self.watchdog_us);
        if expired && !self.state.contains(CubeState::COMM_ERROR) {
            self.state = self.state.union(self.watchdog_shows);
            self.watchdog_seen = None;
            self.stop_hard();
        }
    }

    fn q_reported(&self) -> f32 {
        if self.ideal {
            return self.q as f32;
        }
        let step = 0.02f64.to_radians();
        let q = match self.wrong {
            Some(Wrong::Frozen(at)) => at,
            Some(Wrong::Reversed(at)) => 2.0 * at - self.q,
            Some(Wrong::Creeping(at, share)) => at + share * (self.q - at),
            Some(Wrong::Offset(by)) => self.q + by,
            Some(Wrong::Deaf) | None => self.q,
        };
        ((q / step).round() * step) as f32
    }

    /// A frame to this drive or to all drives has come.
    pub(super) fn hear(&mut self, now_us: u64) {
        if self.any_frame_is_life && self.watchdog_seen.is_some() {
            self.watchdog_seen = Some(now_us);
        }
    }

    pub(super) fn broadcast(&mut self, now_us: u64, broadcast: Broadcast) {
        match broadcast {
            Broadcast::Halt if self.deaf_to_halts > 0 => self.deaf_to_halts -= 1,
            Broadcast::Halt => {
                self.state = self.state.union(CubeState::HALTED);
                self.stop_hard();
            }
            Broadcast::Reset => self.reset(),
            Broadcast::Watchdog => self.watchdog_seen = Some(now_us),
            _ => {}
        }
    }

    fn reset(&mut self) {
        let gone = CubeState::ERROR
            .union(CubeState::HALTED)
            .union(CubeState::COMM_ERROR)
            .union(CubeState::TOW_ERROR);
        self.state = self.state.difference(gone).with(CubeState::HALTED, self.stays_halted);
        if !self.reset_keeps_watchdog {
            self.watchdog_seen = None;
        }
    }

    fn refuses(&self) -> bool {
        self.state.intersects(CubeState::ERROR.union(CubeState::HALTED))
    }

    pub(super) fn answer(&mut self, now_us: u64, request: Request) -> Option<Reply> {
        let short = self.state.short();
        Some(match request {
            Request::Simple(simple) => {
                match simple {
                    SimpleCommand::Halt => self.broadcast(now_us, Broadcast::Halt),
                    SimpleCommand::Reset => self.reset(),
                    SimpleCommand::Home => {
                        self.state = self.state.with(CubeState::HOME_OK, false);
                        self.homing_until = Some(now_us + self.home_takes_us);
                    }
                    _ => {}
                }
                Reply::Simple(simple)
            }
            Request::Get(parameter) => Reply::Value(
                parameter,
                match parameter {
                    Parameter::DefVersion => Value::U16(0x4614),
                    Parameter::Config => Value::U32(self.config.bits()),
                    Parameter::CubeState => Value::U32(self.state.bits()),
                    Parameter::Cur => Value::F32(self.current_a),
                    Parameter::MaxCur => Value::F32(self.max_cur),
                    Parameter::ActPos => Value::F32(self.q_reported()),
                    Parameter::PosStateDio => Value::PosStateDio(PosStateDio {
                        position_rad: self.q_reported(),
                        short_state: short,
                        dio: Dio(self.dio),
                    }),
                    _ => return None,
                },
            ),
            Request::Set(Parameter::DioData, _) if self.misses_gripper_writes > 0 => {
                self.misses_gripper_writes -= 1;
                return None;
            }
            Request::Set(parameter, value) => {
                match (parameter, value) {
                    (Parameter::TargetVel, Value::F32(v)) => self.written.0 = v.into(),
                    (Parameter::TargetAcc, Value::F32(a)) => self.written.1 = a.into(),
                    (Parameter::Config, Value::U32(bits)) => self.config = Config::from_bits(bits),
                    (Parameter::MaxCur, Value::F32(a)) => self.max_cur = a,
                    (Parameter::DioData, Value::U32(bits)) => self.dio = bits as u8 & 0xF0,
                    _ => {}
                }
                Reply::SetAck { parameter, code: Some(0x64) }
            }
            Request::Move(motion) => {
                let MotionCommand::Ramp { target } = motion.command() else { return None };
                let position = MotionPosition::Radians(Radians::new(self.q_reported()));
                if self.wrong == Some(Wrong::Deaf) {
                    self.target = Some(self.q_gen + 0.5 * self.v_gen * self.v_gen.abs() / self.a_ramp);
                } else if !self.refuses() {
                    (self.v_ramp, self.a_ramp) = self.written;
                    self.target = Some(target.get().into());
                }
                Reply::MotionExtended {
                    kind: MotionKind::Ramp,
                    position,
                    short_state: short,
                    dio: Dio(self.dio),
                }
            }
            _ => return None,
        })
    }
}
