//! One Damiao motor with an inertia at its shaft, driven by frames.

use hil_sim::drive::bench::ShaftMotor as _;
use hil_sim::drive::mit::{MitMotor, MitOptions};
use hil_sim::mechanics::AxisState;
use hil_sim::participants::BusConnection;
use protocol::mit::{
    Command, Mit, MotorId, Ranges, Register, RegisterAnswer, RegisterRequest, RegisterValue, State, Status,
};
use protocol::{Duration, FdFlags, Instant, Node, StandardId};

const STEP_US: u64 = 50;
const INERTIA_KG_M2: f64 = 0.1;

struct Rig {
    motor: MitMotor,
    now: Instant,
    q_rad: f64,
    v_rad_s: f64,
    answers: Vec<State>,
    registers: Vec<RegisterValue>,
    asked: Option<RegisterRequest>,
    ranges: Ranges,
}

fn id() -> MotorId {
    MotorId::new(3).unwrap()
}

fn master() -> StandardId {
    StandardId::new(0x13).unwrap()
}

impl Rig {
    fn at(q_rad: f64) -> Self {
        let options = MitOptions::of("8009", id(), master()).unwrap();
        Self {
            motor: MitMotor::new(options, q_rad),
            now: Instant::ZERO,
            q_rad,
            v_rad_s: 0.0,
            answers: Vec::new(),
            registers: Vec::new(),
            asked: None,
            ranges: options.motor.ranges,
        }
    }

    fn read_answers(&mut self) {
        while let Some(frame) = self.motor.poll_frame() {
            let register =
                self.asked.and_then(|asked| RegisterAnswer::decode(&frame, id(), master(), &asked));
            match register {
                Some(answer) => self.registers.push(answer.value),
                None => {
                    self.answers.push(State::decode(&frame, id(), master(), &self.ranges).expect("a state"));
                }
            }
        }
    }

    fn command(&mut self, command: Command) {
        let (frame, _) = command.encode(id(), &self.ranges).unwrap();
        self.motor.handle_frame(self.now, &frame);
        self.read_answers();
    }

    fn ask(&mut self, request: RegisterRequest) -> Option<RegisterValue> {
        self.asked = Some(request);
        self.motor.handle_frame(self.now, &request.encode(id()));
        self.run_s(0.001);
        self.asked = None;
        self.registers.pop()
    }

    fn write(&mut self, register: Register, value: RegisterValue) {
        assert_eq!(self.ask(RegisterRequest::Write(register, value)), Some(value));
    }

    fn run_s(&mut self, duration_s: f64) {
        for _ in 0..(duration_s * 1e6) as u64 / STEP_US {
            let (input, dt_s) = (self.motor.input(), STEP_US as f64 * 1e-6);
            let wanted = input.torque_nm + input.stiffness_nm_rad * (input.reference_rad - self.q_rad)
                - input.damping_nms_rad * self.v_rad_s;
            let torque_nm = wanted.clamp(-input.torque_max_nm, input.torque_max_nm);
            self.v_rad_s += torque_nm / INERTIA_KG_M2 * dt_s;
            self.q_rad += self.v_rad_s * dt_s;
            let axis = AxisState {
                q_rad: self.q_rad,
                v_rad_s: self.v_rad_s,
                drive_torque_nm: torque_nm,
                ..AxisState::default()
            };
            self.motor.tick(axis, dt_s);
            self.now += Duration::from_micros(STEP_US);
            if self.motor.poll_timeout().is_some_and(|at| at <= self.now) {
                self.motor.handle_timeout(self.now);
                assert!(self.motor.poll_timeout().is_none_or(|at| at > self.now), "a deadline stays");
            }
            self.read_answers();
        }
    }

    fn state(&mut self) -> State {
        self.command(Command::Mit(Mit::default()));
        self.run_s(0.001);
        self.answers.pop().expect("an answer")
    }
}

fn hold(p_rad: f32, kp_nm_rad: f32, kd_nm_s_rad: f32) -> Command {
    Command::Mit(Mit { p_rad, kp_nm_rad, kd_nm_s_rad, ..Mit::default() })
}

#[test]
fn each_command_has_one_answer_and_nothing_else_has_one() {
    let mut rig = Rig::at(0.5);
    rig.run_s(0.1);
    assert!(rig.answers.is_empty());
    for command in
        [hold(0.5, 10.0, 1.0), Command::Enable, hold(0.5, 10.0, 1.0), Command::Disable, Command::ClearFault]
    {
        rig.command(command);
        assert!(rig.answers.is_empty(), "before its time");
        rig.run_s(0.01);
        assert_eq!(rig.answers.drain(..).count(), 1, "{command:?}");
    }
    // Another motor's command, and a set point of a mode that is not set.
    let (other, _) = Command::Enable.encode(MotorId::new(4).unwrap(), &rig.ranges).unwrap();
    rig.motor.handle_frame(rig.now, &other);
    rig.command(Command::PositionVelocity { p_rad: 1.0, v_max_rad_s: 1.0 });
    rig.command(Command::Velocity { v_rad_s: 1.0 });
    rig.run_s(0.01);
    assert!(rig.answers.is_empty() && rig.motor.status() == Status::Disabled);
}

#[test]
fn a_step_of_position_is_the_closed_form_of_a_critically_damped_inertia() {
    let mut rig = Rig::at(0.0);
    let (omega_rad_s, p_rad) = (20.0_f64, 0.2_f64);
    let (kp, kd) = (INERTIA_KG_M2 * omega_rad_s * omega_rad_s, 2.0 * INERTIA_KG_M2 * omega_rad_s);
    rig.command(Command::Enable);
    rig.command(hold(p_rad as f32, kp as f32, kd as f32));
    for _ in 0..40 {
        rig.run_s(0.005);
        let wt = omega_rad_s * rig.now.as_secs_f64();
        let wanted_rad = p_rad * (1.0 - (1.0 + wt) * (-wt).exp());
        // Half a step of position is 0.2 mrad. A velocity of 0 has no raw value: half a step of 22 mrad/s, times kd over kp, is
        // 1.1 mrad; gains are rounded, too.
        assert!((rig.q_rad - wanted_rad).abs() < 1.5e-3, "{} {wanted_rad}", rig.q_rad);
    }
    let state = rig.state();
    assert!(
        (f64::from(state.p_rad) - rig.q_rad).abs() < 1e-3 && state.status == Status::Enabled,
        "{state:?}"
    );
}

#[test]
fn torque_ends_at_the_peak_and_at_the_speed_without_load() {
    let mut rig = Rig::at(0.0);
    rig.command(Command::Enable);
    rig.command(Command::Mit(Mit { t_nm: 54.0, ..Mit::default() }));
    rig.run_s(0.005);
    assert!((rig.v_rad_s - 40.0 / INERTIA_KG_M2 * 0.005).abs() < 0.15, "peak, not range: {}", rig.v_rad_s);
    rig.run_s(1.0);
    assert!((16.5..=16.8).contains(&rig.v_rad_s), "{}", rig.v_rad_s);
}

#[test]
fn without_a_time_out_the_last_command_is_kept_for_ever() {
    let mut rig = Rig::at(0.0);
    rig.command(Command::Enable);
    rig.command(Command::Mit(Mit { v_rad_s: 2.0, kd_nm_s_rad: 5.0, ..Mit::default() }));
    rig.run_s(10.0);
    assert!(rig.motor.status() == Status::Enabled && (rig.v_rad_s - 2.0).abs() < 0.02, "{}", rig.v_rad_s);
}

#[test]
fn a_time_out_takes_the_torque_until_a_person_clears_it() {
    let mut rig = Rig::at(0.0);
    rig.write(Register::TimeOut, RegisterValue::Whole(2000));
    rig.command(Command::Enable);
    for _ in 0..20 {
        rig.command(hold(0.0, 10.0, 1.0));
        rig.run_s(0.05);
    }
    assert_eq!(rig.motor.status(), Status::Enabled);
    rig.run_s(0.049);
    assert_eq!(rig.motor.status(), Status::Enabled);
    rig.run_s(0.002);
    assert_eq!(rig.motor.status(), Status::LinkLost);
    assert_eq!(rig.motor.input().torque_max_nm, 0.0);
    // Neither commands alone nor enabling bring it back.
    rig.command(Command::Enable);
    assert_eq!(rig.state().status, Status::LinkLost);
    rig.command(Command::ClearFault);
    assert_eq!(rig.state().status, Status::Disabled);
    rig.command(Command::Enable);
    assert_eq!(rig.state().status, Status::Enabled);
}

#[test]
fn a_set_point_that_came_while_off_acts_at_the_enabling() {
    let mut rig = Rig::at(1.0);
    rig.command(hold(0.0, 50.0, 5.0));
    rig.run_s(0.5);
    assert_eq!((rig.q_rad, rig.v_rad_s), (1.0, 0.0));
    rig.command(Command::Enable);
    rig.run_s(0.02);
    assert!(rig.v_rad_s < -1.0, "the jump that a host must not cause: {}", rig.v_rad_s);
}

#[test]
fn a_turn_is_lost_with_the_power_and_so_is_what_was_not_stored() {
    let mut rig = Rig::at(0.0);
    rig.write(Register::TimeOut, RegisterValue::Whole(500));
    rig.ask(RegisterRequest::Store);
    rig.write(Register::Mode, RegisterValue::Whole(2));
    rig.q_rad = 4.0;
    rig.run_s(0.001);
    let before = rig.motor.shaft_rad();
    rig.motor.set_power(false);
    rig.run_s(0.01);
    assert!(rig.motor.poll_timeout().is_none());
    rig.motor.set_power(true);
    let after = rig.motor.shaft_rad();
    assert!((before - 4.0).abs() < 1e-9 && (after - (4.0 - std::f64::consts::TAU)).abs() < 1e-9, "{after}");
    assert_eq!(rig.ask(RegisterRequest::Read(Register::TimeOut)), Some(RegisterValue::Whole(500)));
    assert_eq!(rig.ask(RegisterRequest::Read(Register::Mode)), Some(RegisterValue::Whole(1)));
    rig.command(Command::ZeroHere);
    assert!(rig.state().p_rad.abs() < 1e-3);
}

#[test]
fn a_motor_that_is_on_stores_nothing() {
    let mut rig = Rig::at(0.0);
    rig.command(Command::Enable);
    rig.write(Register::TimeOut, RegisterValue::Whole(500));
    rig.ask(RegisterRequest::Store);
    rig.motor.set_power(true);
    assert_eq!(rig.ask(RegisterRequest::Read(Register::TimeOut)), Some(RegisterValue::Whole(0)));
}

#[test]
fn the_other_modes_lead_a_reference_at_most_at_their_velocity() {
    let mut rig = Rig::at(0.0);
    rig.write(Register::Mode, RegisterValue::Whole(2));
    rig.command(Command::Enable);
    rig.command(Command::PositionVelocity { p_rad: 1.0, v_max_rad_s: 2.0 });
    let mut fastest_rad_s = 0.0_f64;
    for _ in 0..100 {
        rig.run_s(0.02);
        fastest_rad_s = fastest_rad_s.max(rig.v_rad_s);
    }
    assert!(
        (rig.q_rad - 1.0).abs() < 0.01 && (1.9..2.9).contains(&fastest_rad_s),
        "{} {fastest_rad_s}",
        rig.q_rad
    );
    rig.write(Register::Mode, RegisterValue::Whole(3));
    assert_eq!(rig.motor.input().torque_max_nm, 0.0, "a change of the mode clears the set point");
    rig.command(Command::Velocity { v_rad_s: -1.0 });
    rig.run_s(2.0);
    assert!((rig.v_rad_s + 1.0).abs() < 0.05, "{}", rig.v_rad_s);
}

#[test]
fn a_change_of_the_mode_with_torque_begins_where_the_shaft_is() {
    let mut rig = Rig::at(0.0);
    rig.command(Command::Enable);
    rig.command(Command::Mit(Mit { p_rad: 0.5, kp_nm_rad: 100.0, kd_nm_s_rad: 5.0, ..Mit::default() }));
    rig.run_s(1.0);
    rig.write(Register::Mode, RegisterValue::Whole(2));
    rig.command(Command::PositionVelocity { p_rad: rig.q_rad as f32, v_max_rad_s: 1.0 });
    let mut fastest_rad_s = 0.0_f64;
    for _ in 0..100 {
        rig.run_s(0.005);
        fastest_rad_s = fastest_rad_s.max(rig.v_rad_s.abs());
    }
    assert!((rig.q_rad - 0.5).abs() < 0.02 && fastest_rad_s < 0.05, "{} {fastest_rad_s}", rig.q_rad);
}

#[test]
fn faults_show_as_on_the_wire_of_a_broken_motor() {
    // A range that differs from the register: velocities are wrong by the ratio, and nothing reports it.
    let mut rig = Rig::at(0.0);
    rig.motor.faults_mut().velocity_range_factor = 0.8;
    rig.command(Command::Enable);
    rig.command(Command::Mit(Mit { v_rad_s: 2.0, kd_nm_s_rad: 5.0, ..Mit::default() }));
    rig.run_s(1.0);
    assert!((rig.v_rad_s - 1.6).abs() < 0.02, "{}", rig.v_rad_s);
    let read = rig.ask(RegisterRequest::Read(Register::VelocityMax));
    assert_eq!(read, Some(RegisterValue::Float(45.0)));
    // A time-out that nothing acts on.
    rig.motor.faults_mut().time_out_is_dead = true;
    rig.write(Register::TimeOut, RegisterValue::Whole(200));
    rig.run_s(1.0);
    assert_eq!(rig.motor.status(), Status::Enabled);
    // Every third answer stays away; the others repeat the first state.
    rig.motor.faults_mut().answer_lost_every = 3;
    rig.motor.faults_mut().answers_are_stale = true;
    rig.answers.clear();
    for _ in 0..30 {
        rig.command(hold(0.0, 0.0, 0.0));
        rig.run_s(0.002);
    }
    assert_eq!(rig.answers.len(), 20);
    assert!(rig.answers.iter().all(|state| *state == rig.answers[0]));
}

#[test]
fn a_motor_at_twice_its_rated_torque_gets_hot_and_stops() {
    let mut rig = Rig::at(0.0);
    rig.command(Command::Enable);
    rig.command(Command::Mit(Mit { t_nm: 40.0, ..Mit::default() }));
    let axis = AxisState { drive_torque_nm: 40.0, ..AxisState::default() };
    let mut held_s = 0;
    while rig.motor.status() == Status::Enabled && held_s < 3600 {
        rig.motor.tick(axis, 1.0);
        held_s += 1;
    }
    // 25 + 55 · 4 (1 - e^(-t / 300)) reaches 100 after 125 s.
    assert!((120..130).contains(&held_s) && rig.motor.status() == Status::RotorHot, "{held_s} s");
}

#[test]
fn a_motor_on_can_fd_obeys_frames_with_bit_rate_switch_and_a_classical_one_all_and_each_answers_in_its_way() {
    let request = RegisterRequest::State.encode(id());
    let without = FdFlags { brs: false, esi: false };
    for (bit_rate, frame, answers_fd) in [
        (4, request, Some(None)),
        (4, request.with_fd(FdFlags::BRS), Some(None)),
        (4, request.with_fd(without), Some(None)),
        (9, request, None),
        (9, request.with_fd(without), None),
        (9, request.with_fd(FdFlags::BRS), Some(Some(FdFlags::BRS))),
    ] {
        let options = MitOptions { bit_rate, ..MitOptions::of("8009", id(), master()).unwrap() };
        let mut motor = MitMotor::new(options, 0.0);
        motor.handle_frame(Instant::ZERO, &frame);
        motor.handle_timeout(Instant::from_micros(1_000));
        assert_eq!(motor.poll_frame().map(|answer| answer.fd()), answers_fd, "{bit_rate} {frame}");
    }
}

#[test]
fn a_bit_rate_acts_when_the_motor_gets_power_again_and_one_beside_that_of_the_bus_takes_it_off_the_bus() {
    let (fd, classical) = (Some(5_000_000), None);
    let mut motor = MitMotor::new(MitOptions::of("8009", id(), master()).unwrap(), 0.0);
    let ask = |motor: &mut MitMotor, request: RegisterRequest| {
        motor.handle_frame(Instant::ZERO, &request.encode(id()));
    };
    // 10 Mbit/s.
    ask(&mut motor, RegisterRequest::Write(Register::BitRate, RegisterValue::Whole(11)));
    assert_eq!(motor.link(1_000_000, fd), BusConnection::On);
    ask(&mut motor, RegisterRequest::Store);
    motor.set_power(false);
    assert_eq!(motor.link(1_000_000, fd), BusConnection::Off);
    motor.set_power(true);
    assert_eq!(motor.link(1_000_000, fd), BusConnection::OtherRate);
    assert_eq!(motor.link(1_000_000, Some(10_000_000)), BusConnection::On);
    // It hears a classical bus, and does not answer there.
    assert_eq!(motor.link(1_000_000, classical), BusConnection::On);
    assert_eq!(motor.link(500_000, classical), BusConnection::OtherRate);
}
