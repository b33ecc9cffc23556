//! Homing, watchdog, timing, unsolicited frames, and every habit of the known clients.

use crate::drive_rig::{GET, MS, PUT, Rig, frame, id, text};
use hil_sim::drive::options::{HomeWhenHalted, SignOfLife, StateFrames};
use protocol::Duration;
use protocol::powercube::{
    Broadcast, Channel, Config, CubeState, MotionCommand, MotionRequest, Parameter, Reply, Request,
    ShortState, SimpleCommand, Value,
};
use protocol::units::Radians;

// ---- Homing ----

#[test]
fn homing_finds_the_zero_in_the_direction_of_the_velocitys_sign() {
    for (start, velocity) in [(0.3, -0.3), (-0.4, 0.3), (-0.03, -0.3)] {
        let mut rig = Rig::bench(0x4614, |o| o.start_q_rad = Some(vec![start]));
        rig.set_f(Parameter::HomeVel, velocity);
        // Coming from below, the first edge is the cam's lower one.
        let edge = if velocity > 0.0 { -5_f64.to_radians() } else { 0.0 };
        rig.set_f(Parameter::HomeOffset, edge);
        assert!(rig.simple(SimpleCommand::Home).is_some(), "acknowledged at once");
        assert!(!rig.state().contains(CubeState::HOME_OK));
        assert!(rig.state().contains(CubeState::MOTION));
        rig.run_ms(4_000);
        let state = rig.state();
        assert!(state.contains(CubeState::HOME_OK | CubeState::RAMP_END), "start {start}: {state}");
        assert!(!state.intersects(CubeState::ERROR | CubeState::MOTION), "{state}");
        let (believed, truth) = (rig.get(Parameter::ActPos), rig.q(0));
        assert!((believed - truth).abs() < 3e-5, "start {start}: {believed} against {truth}");
    }
}

#[test]
fn homing_away_from_the_switch_turns_at_the_limit_switch() {
    let mut rig = Rig::bench(0x4614, |o| o.start_q_rad = Some(vec![-2.9]));
    rig.set_f(Parameter::HomeVel, -0.6);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(9_000);
    let state = rig.state();
    assert!(state.contains(CubeState::HOME_OK) && !state.intersects(CubeState::CAUSES), "{state}");
}

#[test]
fn homing_without_any_switch_ends_halted_without_home() {
    let mut rig = Rig::bench(0x4614, |_| ());
    let config = Config::from_bits(rig.get(Parameter::Config) as u32).difference(Config::SWR_ENABLED);
    rig.set(Parameter::Config, Value::U32(config.bits()));
    rig.set_f(Parameter::HomeVel, -2.0);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(8_000);
    let state = rig.state();
    assert!(state.contains(CubeState::HALTED) && !state.contains(CubeState::HOME_OK), "{state}");
}

#[test]
fn home_offset_is_what_the_module_reads_at_the_edge() {
    let mut rig = Rig::bench(0x4614, |_| ());
    rig.set_f(Parameter::HomeOffset, 0.7);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(3_000);
    assert!((rig.get(Parameter::ActPos) - rig.q(0) - 0.7).abs() < 3e-5);
}

#[test]
fn zero_move_goes_to_zero_after_homing() {
    let mut rig = Rig::bench(0x4614, |_| ());
    rig.add_config(Config::ZERO_MOVE_AFTER_HOK);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(5_000);
    assert!(rig.state().contains(CubeState::HOME_OK | CubeState::RAMP_END));
    assert!(rig.get(Parameter::ActPos).abs() < 2e-4, "{}", rig.get(Parameter::ActPos));
}

#[test]
fn index_makes_homing_repeatable_and_the_bare_switch_scatters() {
    let spread = |index: bool| {
        let errors: Vec<f64> = (0..12)
            .map(|seed| {
                let options = hil_sim::CellOptions::default();
                let mut rig = Rig::of(hil_sim::Cell::bench(1, 0x4614, &options, seed).unwrap());
                rig.run_ms(150);
                if !index {
                    let config = Config::from_bits(rig.get(Parameter::Config) as u32);
                    let config = config.difference(Config::SWR_WITH_ENCODERZERO);
                    rig.set(Parameter::Config, Value::U32(config.bits()));
                }
                rig.simple(SimpleCommand::Home);
                rig.run_ms(3_000);
                let now = rig.now;
                rig.drive().believed_q_rad(now) - rig.q(0)
            })
            .collect();
        let mean = errors.iter().sum::<f64>() / 12.0;
        (errors.iter().map(|e| (e - mean) * (e - mean)).sum::<f64>() / 12.0).sqrt()
    };
    assert!(spread(true) < 1e-9);
    // Standard deviation 0.2 mrad; twelve draws.
    assert!((5e-5..5e-4).contains(&spread(false)), "{}", spread(false));
}

#[test]
fn absolute_encoder_comes_up_homed_and_home_is_done_at_once() {
    let mut rig = Rig::bench(0x4614, |o| o.drive.absolute_encoder = true);
    assert!(rig.state().contains(CubeState::HOME_OK));
    rig.simple(SimpleCommand::Home);
    assert!(rig.state().contains(CubeState::HOME_OK) && !rig.state().contains(CubeState::MOTION));
    // HOME leads out of HALTED, with the loop closed.
    rig.simple(SimpleCommand::Halt);
    rig.run_ms(50);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(150);
    rig.move_to(0.3);
    rig.run_ms(1_500);
    assert!((rig.q(0) - 0.3).abs() < 1e-3);
}

#[test]
fn home_while_halted_is_accepted_or_refused_by_option() {
    for (choice, homed) in [(HomeWhenHalted::Accept, true), (HomeWhenHalted::Refuse, false)] {
        let mut rig = Rig::bench(0x4614, |o| o.drive.home_when_halted = choice);
        rig.simple(SimpleCommand::Halt);
        assert!(rig.simple(SimpleCommand::Home).is_some());
        rig.run_ms(3_000);
        assert_eq!(rig.state().contains(CubeState::HOME_OK), homed);
    }
}

// ---- Watchdog ----

#[test]
fn watchdog_is_silent_until_the_first_refresh_and_stops_the_module_after_its_time_out() {
    let mut rig = Rig::homed(|_| ());
    rig.add_config(Config::WATCHDOG_ENABLE);
    rig.run_ms(500);
    assert!(!rig.state().contains(CubeState::COMM_ERROR), "enabled alone stops nothing");
    rig.velocity(0.3);
    for _ in 0..20 {
        rig.offer(&Broadcast::Watchdog.encode());
        rig.run_ms(40);
    }
    assert!(!rig.state().contains(CubeState::ERROR), "refreshed every 40 ms");
    rig.offer(&Broadcast::Watchdog.encode());
    let refreshed = rig.now;
    rig.run_until(refreshed + Duration::from_micros(49_999));
    let now = rig.now;
    assert!(!rig.drive().state_word(now).contains(CubeState::COMM_ERROR), "49.999 ms");
    rig.run_until(refreshed + Duration::from_micros(50_000));
    let now = rig.now;
    let state = rig.drive().state_word(now);
    assert!(state.contains(CubeState::COMM_ERROR | CubeState::ERROR | CubeState::HALTED), "50 ms: {state}");
    rig.run_ms(500);
    let stopped = rig.q(0);
    rig.run_ms(500);
    assert!((rig.q(0) - stopped).abs() < 1e-6);
    rig.simple(SimpleCommand::Reset);
    rig.run_ms(300);
    assert!(!rig.state().intersects(CubeState::ERROR | CubeState::HALTED), "disarmed until refreshed again");
}

#[test]
fn other_traffic_is_no_sign_of_life_unless_the_option_says_so() {
    for (choice, stopped) in [(SignOfLife::Refresh, true), (SignOfLife::AnyFrame, false)] {
        let mut rig = Rig::homed(|o| o.drive.sign_of_life = choice);
        rig.add_config(Config::WATCHDOG_ENABLE);
        rig.offer(&Broadcast::Watchdog.encode());
        for _ in 0..10 {
            rig.run_ms(10);
            rig.get(Parameter::ActPos);
        }
        assert_eq!(rig.state().contains(CubeState::COMM_ERROR), stopped);
    }
}

#[test]
fn watchdog_refresh_sent_to_one_module_counts_too() {
    let mut rig = Rig::homed(|_| ());
    rig.add_config(Config::WATCHDOG_ENABLE);
    for _ in 0..10 {
        rig.offer(&frame(PUT, &[0x07]));
        rig.run_ms(40);
    }
    assert!(!rig.state().contains(CubeState::COMM_ERROR));
    rig.run_ms(60);
    assert!(rig.state().contains(CubeState::COMM_ERROR));
}

#[test]
fn switching_the_watchdog_off_disarms_it() {
    let mut rig = Rig::homed(|_| ());
    rig.add_config(Config::WATCHDOG_ENABLE);
    rig.offer(&Broadcast::Watchdog.encode());
    let config = Config::from_bits(rig.get(Parameter::Config) as u32).difference(Config::WATCHDOG_ENABLE);
    rig.set(Parameter::Config, Value::U32(config.bits()));
    rig.run_ms(200);
    assert!(!rig.state().contains(CubeState::COMM_ERROR));
}

// ---- Timing, queue, unsolicited frames ----

#[test]
fn answers_come_in_order_after_the_processing_delay_with_its_jitter() {
    let mut rig = Rig::homed(|_| ());
    let mut delays = Vec::new();
    for _ in 0..300 {
        rig.frames.clear();
        let asked = rig.now;
        rig.offer(&frame(GET, &[0x0A, 0x3C]));
        rig.run_ms(1);
        delays.push(rig.frames[0].0.saturating_since(asked).as_micros());
    }
    let (least, most) = (delays.iter().min().unwrap(), delays.iter().max().unwrap());
    assert!((100..=110).contains(least) && (290..=300).contains(most), "{least} to {most} µs");
    rig.frames.clear();
    for parameter in [0x3C, 0x41, 0x4D, 0x27] {
        rig.offer(&frame(GET, &[0x0A, parameter]));
    }
    rig.run_ms(3);
    let order: Vec<u8> = rig.frames.iter().map(|(_, f)| f.data()[1]).collect();
    assert_eq!(order, [0x3C, 0x41, 0x4D, 0x27]);
}

#[test]
fn requests_beyond_the_queue_are_lost_and_counted() {
    let mut rig = Rig::homed(|o| o.drive.queue_depth = 3);
    rig.frames.clear();
    for _ in 0..10 {
        rig.offer(&frame(GET, &[0x0A, 0x3C]));
    }
    rig.run_ms(10);
    assert_eq!((rig.frames.len(), rig.drive().counters().overflowed), (3, 7));
}

#[test]
fn state_frames_come_on_change_when_the_option_says_so() {
    let mut rig = Rig::homed(|o| o.drive.state_frames = StateFrames::OnChange { every: MS });
    rig.run_ms(5);
    rig.frames.clear();
    rig.run_ms(50);
    assert_eq!(rig.frames, [], "nothing changes");
    rig.offer(&Broadcast::Halt.encode());
    rig.run_ms(3);
    let (at, first) = rig.frames[0];
    assert_eq!(first.id(), Channel::State.id(id(1)));
    assert_eq!(first.dlc(), 4, "32-bit state word, no command byte");
    let Ok((_, Reply::State(state))) = Reply::decode(&first) else { panic!() };
    assert!(state.contains(CubeState::HALTED) && rig.now.saturating_since(at) <= Duration::from_millis(3));
}

#[test]
fn sync_transmit_sends_state_frames_in_a_fixed_interval() {
    let mut rig =
        Rig::homed(|o| o.drive.state_frames = StateFrames::SyncTransmit { every: Duration::from_millis(10) });
    rig.run_ms(50);
    assert_eq!(rig.frames, []);
    rig.add_config(Config::SYNC_TRANSMIT);
    rig.frames.clear();
    rig.run_ms(100);
    assert!((9..=11).contains(&rig.frames.len()), "{}", rig.frames.len());
}

// ---- Habits of the known clients ----

#[test]
fn request_on_the_other_channel_is_answered_all_the_same() {
    let mut rig = Rig::homed(|_| ());
    // One host polls the address on the PUT id and reads parameters on the GET id.
    assert_eq!(text(&rig.exchange(&frame(PUT, &[0x0A, 0x20]))), ["0A1#0A2001"]);
    assert_eq!(text(&rig.exchange(&frame(GET, &[0x00]))), ["0A1#00"]);
}

#[test]
fn scan_of_all_addresses_finds_the_modules_that_are_there() {
    let robot = robot_model::RobotModel::load("powercube6").unwrap();
    let mut rig = Rig::of(hil_sim::Cell::new(&robot, &hil_sim::CellOptions::default(), 1).unwrap());
    let found: Vec<u8> = protocol::ModuleId::all()
        .filter(|module| rig.ask_module(*module, Request::Get(Parameter::DefVersion)).is_some())
        .map(protocol::ModuleId::get)
        .collect();
    assert_eq!(found, [1, 2, 3, 4, 5, 6]);
}

/// Start-up of the widespread ROS driver: RESET, identity, 0x62; not homed shows NOT_OK, so HALT and HOME; then it
/// waits for HOME_OK and RAMP_END, and sends the start broadcast after every group of motions.
#[test]
fn ros_driver_starts_up_homes_and_moves() {
    let mut rig = Rig::bench(0x3519, |_| ());
    assert!(rig.simple(SimpleCommand::Reset).is_some());
    for parameter in [0x1A, 0x1D, 0x01, 0x1B, 0x58] {
        assert_eq!(rig.exchange(&frame(GET, &[0x0A, parameter])).len(), 1);
    }
    let status = rig.exchange(&frame(GET, &[0x0A, 0x62]));
    assert_eq!(status[0].dlc(), 8);
    assert!(status[0].data()[6] & ShortState::NOT_OK.bits() != 0, "not homed");
    rig.simple(SimpleCommand::Halt);
    rig.simple(SimpleCommand::Home);
    let mut polls = 0;
    while !rig.state().contains(CubeState::HOME_OK | CubeState::RAMP_END) {
        polls += 1;
        assert!(polls < 1_500, "homing is limited to 15 s");
        rig.run_ms(10);
    }
    rig.simple(SimpleCommand::Halt);
    rig.run_ms(500);
    rig.simple(SimpleCommand::Reset);
    rig.run_ms(300);
    let step = Request::Move(MotionRequest::extended(MotionCommand::Step {
        target: Radians::new(0.1),
        time_ms: 300,
    }));
    let Some(Reply::MotionExtended { short_state, .. }) = rig.ask(step) else { panic!() };
    rig.all(Broadcast::StartMotion);
    assert!(!short_state.contains(ShortState::NOT_OK), "{short_state}");
    rig.run_ms(600);
    assert!((rig.get(Parameter::ActPos) - 0.1).abs() < 1e-3);
}

#[test]
fn current_in_digits_is_taken_with_two_and_with_four_bytes() {
    for data in [&[0x0B, 0x0D, 150, 0][..], &[0x0B, 0x0D, 150, 0, 0, 0][..]] {
        let mut rig = Rig::homed(|_| ());
        assert_eq!(text(&rig.exchange(&frame(PUT, data))), ["0A1#0B0D64"]);
        rig.run_ms(300);
        assert!(rig.cell.plant().axis(0).v_rad_s > 0.05);
        assert_eq!(rig.get(Parameter::CurInc), 150.0);
    }
}

#[test]
fn negative_ramp_velocity_counts_by_its_magnitude() {
    let mut rig = Rig::homed(|_| ());
    assert_eq!(rig.set(Parameter::TargetVel, Value::F32(-0.5)), Some(0x64));
    rig.move_to(0.6);
    rig.run_ms(3_000);
    assert!((rig.q(0) - 0.6).abs() < 1e-3);
}

#[test]
fn second_step_is_buffered_and_a_stream_of_steps_runs_evenly() {
    let mut rig = Rig::homed(|_| ());
    let step = |target: f32| {
        Request::Move(MotionRequest::extended(MotionCommand::Step {
            target: Radians::new(target),
            time_ms: 100,
        }))
    };
    rig.ask(step(0.15));
    let Some(Reply::MotionExtended { short_state, .. }) = rig.ask(step(0.20)) else { panic!() };
    assert!(short_state.contains(ShortState::INPROGRESS | ShortState::FULLBUFFER), "{short_state}");
    let mut speeds = Vec::new();
    for _ in 0..15 {
        rig.run_ms(10);
        speeds.push(rig.cell.plant().axis(0).v_rad_s);
    }
    // 0.05 rad in 100 ms, twice without a stop between.
    assert!(speeds[3..].iter().all(|v| (0.45..0.55).contains(v)), "{speeds:?}");
    rig.run_ms(200);
    assert!((rig.q(0) - 0.2).abs() < 1e-3);
}

#[test]
fn deadline_in_the_past_is_served_late_without_harm() {
    use hil_sim::participants::Participants;
    let mut rig = Rig::homed(|_| ());
    rig.offer(&frame(GET, &[0x0A, 0x3C]));
    let late = rig.now + Duration::from_millis(30);
    rig.cell.advance(late);
    let node = rig.cell.node(0);
    node.handle_timeout(late);
    node.handle_timeout(late);
    assert!(node.poll_frame().is_some() && node.poll_frame().is_none());
    assert_eq!(node.poll_timeout(), None);
}
