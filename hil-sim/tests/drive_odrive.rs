//! One axis of an ODrive with an inertia at its joint, driven by frames.

use hil_sim::drive::bench::Bench;
use hil_sim::drive::odrive::{OdriveAxis, OdriveOptions};
use hil_sim::participants::Participants as _;
use protocol::odrive::{
    AxisState, ControlMode, Heartbeat, InputMode, NodeId, Order, Report, Request, Sdo, Version,
};
use protocol::{Duration, Instant, Node as _};

const INERTIA_KG_M2: f64 = 0.1;
const STEP: Duration = Duration::from_micros(200);

struct Rig {
    bench: Bench<OdriveAxis>,
    now: Instant,
    version: Version,
    reports: Vec<(Instant, Report)>,
}

fn node() -> NodeId {
    NodeId::new(9).unwrap()
}

impl Rig {
    fn new(version: Version, change: impl FnOnce(&mut OdriveOptions)) -> Self {
        let mut options = OdriveOptions::new(node(), version);
        change(&mut options);
        let bench = Bench::new(vec![OdriveAxis::new(options, 0.0)], INERTIA_KG_M2);
        Self { bench, now: Instant::ZERO, version, reports: Vec::new() }
    }

    fn axis(&mut self) -> &mut OdriveAxis {
        &mut self.bench.motors_mut()[0]
    }

    fn read(&mut self) {
        let (now, version) = (self.now, self.version);
        while let Some(frame) = self.axis().poll_frame() {
            let (from, report) = Report::decode(&frame, version).expect("a report");
            assert_eq!(from, node());
            self.reports.push((now, report));
        }
    }

    fn order(&mut self, order: Order) {
        let (frame, _) = order.encode(node(), self.version).unwrap();
        let now = self.now;
        self.axis().handle_frame(now, &frame);
        self.read();
    }

    fn ask(&mut self, request: Request) -> Option<Report> {
        let now = self.now;
        self.axis().handle_frame(now, &request.encode(node()));
        self.read();
        let before = self.reports.len();
        self.run_s(0.001);
        self.reports[before..].iter().map(|(_, report)| *report).next()
    }

    fn run_s(&mut self, duration_s: f64) {
        let end = self.now + Duration::from_secs_f64(duration_s);
        while self.now < end {
            self.now += STEP;
            let now = self.now;
            self.bench.advance(now);
            if self.axis().poll_timeout().is_some_and(|at| at <= now) {
                self.axis().handle_timeout(now);
                assert!(self.axis().poll_timeout().is_some_and(|at| at > now), "a deadline stays");
            }
            self.read();
        }
    }

    fn heartbeat(&mut self) -> Heartbeat {
        self.reports.clear();
        self.run_s(0.11);
        self.reports
            .iter()
            .rev()
            .find_map(|(_, report)| match report {
                Report::Heartbeat(heartbeat) => Some(*heartbeat),
                _ => None,
            })
            .expect("a heartbeat each 100 ms")
    }

    fn closed_loop(&mut self, control: ControlMode, input: InputMode) {
        self.order(Order::Mode(control, input));
        self.order(Order::State(AxisState::ClosedLoop));
        assert_eq!(self.heartbeat().state, AxisState::ClosedLoop);
    }
}

const BOTH: [Version; 2] = [Version::V05, Version::V06];

fn position(rev: f32) -> Order {
    Order::Position { rev, rev_s: 0.0, nm: 0.0 }
}

#[test]
fn heartbeats_and_estimates_come_by_themselves_at_their_rates() {
    for version in BOTH {
        let mut rig = Rig::new(version, |_| {});
        rig.run_s(1.0);
        let count = |wanted: fn(&Report) -> bool| rig.reports.iter().filter(|(_, r)| wanted(r)).count();
        assert_eq!(count(|r| matches!(r, Report::Heartbeat(_))), 10);
        assert_eq!(count(|r| matches!(r, Report::Estimates { .. })), 100);
    }
}

#[test]
fn a_position_is_reached_and_held_and_the_bus_limits_are_kept() {
    for version in BOTH {
        let mut rig = Rig::new(version, |_| {});
        rig.closed_loop(ControlMode::Position, InputMode::Direct);
        rig.order(position(4.0));
        let mut fastest = 0.0_f32;
        for _ in 0..100 {
            rig.run_s(0.02);
            if let Some(Report::Estimates { rev_s, .. }) = rig.ask(Request::Estimates) {
                fastest = fastest.max(rev_s);
            }
        }
        assert!((rig.axis().rev() - 4.0).abs() < 0.01, "{}", rig.axis().rev());
        // 20 turns/s is the limit as shipped; 4 turns away the loop asks for 80.
        assert!(fastest > 5.0 && fastest < 21.0, "{fastest}");
    }
}

#[test]
fn a_trapezoid_reports_when_it_is_done() {
    let mut rig = Rig::new(Version::V06, |_| {});
    rig.closed_loop(ControlMode::Position, InputMode::Trapezoid);
    rig.order(Order::TrapezoidVelocity(4.0));
    rig.order(Order::TrapezoidAcceleration(8.0, 8.0));
    rig.order(position(4.0));
    // 0.5 s up, 0.5 s at 4 turns/s, 0.5 s down.
    rig.run_s(1.2);
    assert!(!rig.heartbeat().trajectory_done);
    rig.run_s(0.5);
    assert!(rig.heartbeat().trajectory_done && (rig.axis().rev() - 4.0).abs() < 0.02);
}

#[test]
fn velocity_mode_turns_at_the_speed_and_keeps_it_when_the_host_dies() {
    let mut rig = Rig::new(Version::V05, |_| {});
    rig.closed_loop(ControlMode::Velocity, InputMode::Direct);
    rig.order(Order::Velocity { rev_s: 3.0, nm: 0.0 });
    rig.run_s(2.0);
    let Some(Report::Estimates { rev_s, .. }) = rig.ask(Request::Estimates) else { panic!("estimates") };
    assert!((rev_s - 3.0).abs() < 0.02, "{rev_s}");
    // The watchdog is off as shipped: minutes later it still turns.
    rig.run_s(60.0);
    assert!(rig.axis().rev() > 170.0);
    assert_eq!(rig.heartbeat().state, AxisState::ClosedLoop);
}

#[test]
fn a_watchdog_that_starves_takes_the_torque_until_errors_are_cleared() {
    for (version, bit) in [(Version::V05, 0x800), (Version::V06, 0x100_0000)] {
        let mut rig = Rig::new(version, |o| o.watchdog = Some(Duration::from_millis(150)));
        rig.order(Order::Mode(ControlMode::Position, InputMode::Direct));
        rig.order(Order::State(AxisState::ClosedLoop));
        for _ in 0..10 {
            rig.run_s(0.1);
            rig.order(position(0.5));
        }
        assert_eq!(rig.axis().state(), AxisState::ClosedLoop);
        // Requests feed nothing.
        for _ in 0..4 {
            rig.run_s(0.04);
            rig.ask(Request::Estimates);
        }
        assert_eq!((rig.axis().state(), rig.heartbeat().error), (AxisState::Idle, bit));
        rig.order(Order::State(AxisState::ClosedLoop));
        assert_eq!(rig.axis().state(), AxisState::Idle, "an error is not cleared by asking for torque");
        rig.order(Order::ClearErrors);
        rig.order(Order::State(AxisState::ClosedLoop));
        assert_eq!(rig.axis().state(), AxisState::ClosedLoop);
        rig.axis().faults_mut().watchdog_is_dead = true;
        rig.run_s(1.0);
        assert_eq!(rig.axis().state(), AxisState::ClosedLoop);
    }
}

#[test]
fn an_emergency_stop_ends_only_with_clear_errors() {
    let mut rig = Rig::new(Version::V06, |_| {});
    rig.closed_loop(ControlMode::Velocity, InputMode::Direct);
    rig.order(Order::Velocity { rev_s: 3.0, nm: 0.0 });
    rig.run_s(1.0);
    rig.order(Order::Estop);
    assert_eq!(rig.axis().state(), AxisState::Idle);
    let Some(Report::Errors(errors)) = rig.ask(Request::Errors) else { panic!("errors") };
    assert_eq!((errors.active, errors.disarm_reason), (0x200_0000, Some(0x200_0000)));
    rig.order(Order::State(AxisState::ClosedLoop));
    assert_eq!(rig.axis().state(), AxisState::Idle);
    rig.order(Order::ClearErrors);
    rig.order(Order::State(AxisState::ClosedLoop));
    assert_eq!(rig.axis().state(), AxisState::ClosedLoop);
}

#[test]
fn without_its_index_an_axis_gives_no_torque_and_after_a_reboot_it_is_lost_again() {
    for version in BOTH {
        let mut rig = Rig::new(version, |o| o.absolute = false);
        rig.order(Order::State(AxisState::ClosedLoop));
        let heartbeat = rig.heartbeat();
        assert_eq!(heartbeat.state, AxisState::Idle);
        let says = if version == Version::V05 { heartbeat.error == 1 } else { heartbeat.detail == 14 };
        assert!(says, "{heartbeat:?}");
        rig.order(Order::ClearErrors);
        rig.order(Order::State(AxisState::IndexSearch));
        assert_eq!(rig.axis().state(), AxisState::IndexSearch);
        rig.run_s(3.0);
        assert_eq!(rig.axis().state(), AxisState::Idle);
        rig.order(Order::State(AxisState::ClosedLoop));
        assert_eq!(rig.axis().state(), AxisState::ClosedLoop);
        rig.order(Order::Reboot);
        rig.order(Order::State(AxisState::ClosedLoop));
        assert_eq!(rig.axis().state(), AxisState::Idle);
    }
}

#[test]
fn setting_the_position_moves_nothing() {
    for (version, here) in [(Version::V05, Order::CountHere(8192)), (Version::V06, Order::PositionHere(1.0))]
    {
        let mut rig = Rig::new(version, |_| {});
        rig.closed_loop(ControlMode::Position, InputMode::Direct);
        rig.order(here);
        assert!((rig.axis().rev() - 1.0).abs() < 1e-3);
        rig.run_s(1.0);
        assert!((rig.axis().rev() - 1.0).abs() < 1e-3, "{}", rig.axis().rev());
    }
}

#[test]
fn faults_show_as_they_were_reported() {
    let mut rig = Rig::new(Version::V06, |_| {});
    rig.closed_loop(ControlMode::Velocity, InputMode::Direct);
    rig.order(Order::Velocity { rev_s: 2.0, nm: 0.0 });
    rig.run_s(0.5);
    rig.axis().faults_mut().estimates_are_stale = true;
    let first = rig.ask(Request::Estimates);
    rig.run_s(0.5);
    assert_eq!(rig.ask(Request::Estimates), first, "stale");
    rig.axis().faults_mut().estimates_are_nan = true;
    assert!(matches!(rig.ask(Request::Estimates), Some(Report::Estimates { rev, .. }) if rev.is_nan()));
    rig.axis().fall_idle();
    let heartbeat = rig.heartbeat();
    assert_eq!((heartbeat.state, heartbeat.error), (AxisState::Idle, 0), "idle without an error");
}

#[test]
fn two_axes_share_a_bus_and_each_hears_its_own_number() {
    let axes =
        [3, 4].map(|n| OdriveAxis::new(OdriveOptions::new(NodeId::new(n).unwrap(), Version::V06), 0.0));
    let mut bench = Bench::new(axes.to_vec(), INERTIA_KG_M2);
    let (frame, _) =
        Order::State(AxisState::ClosedLoop).encode(NodeId::new(3).unwrap(), Version::V06).unwrap();
    for axis in bench.motors_mut() {
        axis.handle_frame(Instant::ZERO, &frame);
    }
    let states: Vec<AxisState> = bench.motors_mut().iter().map(OdriveAxis::state).collect();
    assert_eq!(states, [AxisState::ClosedLoop, AxisState::Idle]);
}

#[test]
fn a_parameter_is_read_and_written_by_its_number_and_one_without_a_number_is_not_answered() {
    // Control mode: 9.
    let numbers = Some([7, 8, 20, 21, 22, 9, 23]);
    let mut rig = Rig::new(Version::V06, |options| options.endpoints = numbers);
    let read = |rig: &mut Rig, endpoint| {
        rig.reports.clear();
        rig.order(Order::Sdo(Sdo { endpoint, value: None }));
        rig.run_s(0.001);
        rig.reports.iter().find_map(|(_, report)| match report {
            Report::Sdo { endpoint: from, value } if *from == endpoint => Some(u32::from_le_bytes(*value)),
            _ => None,
        })
    };
    assert_eq!((read(&mut rig, 7), read(&mut rig, 8), read(&mut rig, 10)), (Some(10), Some(1_000), None));
    rig.order(Order::Sdo(Sdo { endpoint: 7, value: Some([0; 4]) }));
    rig.order(Order::Sdo(Sdo { endpoint: 8, value: Some(500_u32.to_le_bytes()) }));
    assert_eq!((read(&mut rig, 7), read(&mut rig, 8)), (Some(0), Some(500)));
    rig.reports.clear();
    rig.run_s(0.5);
    assert!(rig.reports.iter().all(|(_, report)| matches!(report, Report::Heartbeat(_))), "no estimates");
    // With half of the steps in a turn/s the same field is twice the speed.
    rig.closed_loop(ControlMode::Position, InputMode::Direct);
    rig.order(Order::PositionGain(1e-3));
    rig.order(Order::Position { rev: 0.0, rev_s: 1.0, nm: 0.0 });
    rig.run_s(0.5);
    let Some(Report::Estimates { rev_s, .. }) = rig.ask(Request::Estimates) else { panic!("no answer") };
    assert!((rev_s - 2.0).abs() < 0.05, "{rev_s}");
    assert_eq!(read(&mut rig, 9), Some(3));
}

#[test]
fn a_request_feeds_the_watchdog_only_where_it_is_said_to() {
    for requests_feed in [false, true] {
        let watchdog = Some(Duration::from_millis(50));
        let mut rig = Rig::new(Version::V05, |options| {
            (options.watchdog, options.requests_feed) = (watchdog, requests_feed);
        });
        rig.order(Order::State(AxisState::ClosedLoop));
        for _ in 0..20 {
            rig.ask(Request::Iq);
            rig.run_s(0.01);
        }
        assert_eq!(rig.axis().state() == AxisState::ClosedLoop, requests_feed);
    }
}
